"""What a round proposes once the name is clear."""

from types import SimpleNamespace

import pytest
from bough.learn.probing import rounds
from bough.learn.probing.loop import because, spoken
from bough.learn.probing.rounds import Finding


def test_the_pull_that_adds_most_a_recording_narrows(monkeypatch):
    """By hand: half a deviation adds three times what was known, 0.4 of it 5.25 times, at the cost of three pulls."""
    pulls = {"once": SimpleNamespace(pushes=(1,)), "thrice": SimpleNamespace(pushes=(1, 2, 3))}
    for shares, best in (((0.5, 0.4), "once"), ((0.9, 0.4), "thrice")):
        monkeypatch.setattr(rounds, "narrowing", lambda contest, model, probes, own=shares: list(own))
        found = rounds._narrowest(SimpleNamespace(contest=None), None, pulls)
        assert found == (best, shares[best == "thrice"])


@pytest.mark.parametrize(("narrows", "words"), [(0.62, "leaves 62 % of the interval"), (1.0, "adds 40 in twice")])
def test_a_plan_says_why(narrows, words):
    """Name what a pull is for: what it leaves of the interval, or what it adds against the rival; files keep both."""
    found = Finding(3, "effects", ("tip_mass",), ("tip_mass",), lead=50.0, propose="pull", gain=40.0, narrows=narrows)
    assert words in because(found) and because(found) in spoken(found)
    assert Finding.of_json(found.as_json()) == found
