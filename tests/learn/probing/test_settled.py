"""When a probing ends: two rounds that agree, clearly; nothing to add; sensitivity where nothing is found."""

import pytest
from bough.learn.probing.rounds import Finding
from bough.learn.probing.settled import settled


def named(name, lead, recordings=3, width=0.2):
    return Finding(recordings, "effects", (f"{name}@1",), (name,), ("tip_mass",), lead, 0.0, width, None, "pull", 50.0)


NONE = Finding(3, "none", power={"a": 0.99, "b": 0.95, "c": 0.2})
UNKNOWN = Finding(3, "unknown", names=(), propose="pull", gain=3.0)


@pytest.mark.parametrize(
    ("findings", "words"),
    [
        ([named("dry_friction", 20)], None),
        ([named("dry_friction", 20), named("dry_friction", 30)], "dry_friction@1 twice in a row, ahead of tip_mass by"),
        ([named("dry_friction", 20), named("dry_friction", 11)], None),
        ([named("dry_friction", 11), named("dry_friction", 20)], None),
        ([named("dry_friction", 20), named("backlash", 20)], None),
        ([named("dry_friction", 20), Finding(4, "unknown", reason="too noisy")], None),
        ([NONE, NONE], "nothing twice in a row; 5 % of the motion would have been seen by 2 laws; not so sure of c"),
        ([NONE, Finding(4, "none", power={"a": 0.99, "b": 0.5, "c": 0.2})], None),
        ([UNKNOWN, UNKNOWN], "no pull would tell more"),
        ([UNKNOWN, Finding(4, "unknown", propose="pull", gain=30.0)], None),
    ],
)  # fmt: skip
def test_two_rounds_that_agree(findings, words):
    """End where two rounds in a row say the same and what each kind of verdict needs is there."""
    found = settled(findings)
    assert found is None if words is None else words in found


def test_an_interval_that_is_asked_for():
    """Go on while the interval is wider than asked."""
    rounds = [named("dry_friction", 20), named("dry_friction", 30, width=0.3)]
    assert settled(rounds, 0.29) is None and settled(rounds, 0.31)


def test_a_finding_survives_its_file():
    """Read back what was written, an infinite interval too."""
    for finding in (named("dry_friction", 20), NONE, UNKNOWN):
        assert Finding.of_json(finding.as_json(), "round_1.json") == finding
