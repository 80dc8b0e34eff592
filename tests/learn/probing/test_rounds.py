"""Which pull comes next, of what a round has found."""

from types import SimpleNamespace

import pytest
from bough.learn.probing import rounds
from bough.learn.probing.loop import because, spoken
from bough.learn.probing.menu import PLAIN, menu
from bough.learn.probing.rounds import CLEAR, Finding, _next

MODEL, RIVAL = "model", "rival"
PULLS = menu(releases=True)


@pytest.fixture
def asked(monkeypatch):
    """Return the pairs of models that were asked to be told apart; pulls are worth more, or narrow more, by name."""
    pairs, names = [], {id(pull): name for name, pull in PULLS.items()}

    def worths(contest, model, rival, probes):
        pairs.append((model, rival))
        return [SimpleNamespace(evidence=300.0 if names[id(p)] in ("thrice", "pull") else 1.0) for p in probes]

    def narrowing(contest, model, probes):
        return [0.4 if names[id(p)] == PLAIN[1] else 0.7 for p in probes]

    monkeypatch.setattr(rounds, "worths", worths)
    monkeypatch.setattr(rounds, "narrowing", narrowing)
    return pairs


def test_a_name_that_leads_is_confirmed_by_a_plain_pull(asked):
    """Take the plain pull that narrows most; nothing is to be told apart."""
    assert _next(SimpleNamespace(contest=None), "effects", MODEL, RIVAL, CLEAR, PULLS) == (PLAIN[1], 0.0)
    assert asked == []


@pytest.mark.parametrize(("verdict", "pair"), [("effects", (MODEL, RIVAL)), ("unknown", (MODEL, RIVAL)),
                                               ("none", (RIVAL, MODEL))])  # fmt: skip
def test_what_is_not_clear_is_told_apart(asked, verdict, pair):
    """Take the pull that adds most for each recording: 300 for one beats 300 for three."""
    assert _next(SimpleNamespace(contest=None), verdict, MODEL, RIVAL, CLEAR - 0.1, PULLS) == ("pull", 300.0)
    assert set(asked) == {pair}


def test_without_plain_pulls_a_leading_name_is_told_apart(asked):
    """Go on where all plain pulls were done, or the user allows none of them."""
    left = {name: pull for name, pull in PULLS.items() if name not in PLAIN}
    assert _next(SimpleNamespace(contest=None), "effects", MODEL, RIVAL, 99.0, left) == ("pull", 300.0)


@pytest.mark.parametrize(("gain", "words"), [(0.0, "a plain pull, to confirm"), (40.0, "adds 40 in twice")])
def test_a_plan_says_why(gain, words):
    """Name what a pull is for: it confirms, or adds against the rival; a line of progress says the same."""
    found = Finding(3, "effects", ("tip_mass",), ("tip_mass",), lead=50.0, propose="pull", gain=gain)
    assert words in because(found) and because(found) in spoken(found)
    assert Finding.of_json(found.as_json(), "round_1.json") == found
