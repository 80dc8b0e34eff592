"""What tests of effects share."""

import pytest
from bough.learn.systems import branch


@pytest.fixture
def same_steps(monkeypatch):
    """Take the same steps whatever force a case has recorded, so that two of them differ by rounding alone."""
    monkeypatch.setattr(branch, "substep_of", lambda case: 2.5e-3)
