"""The loop of a probing: what it does where the branch pulls harder than allowed."""

import pytest
from bough.learn.gap.diagnosis import Settings
from bough.learn.probing.folder import Folder
from bough.learn.probing.hand import ForceError, Hand, Ways
from bough.learn.probing.loop import GENTLER, Budget, Prober
from bough.learn.probing.rounds import Finding
from bough.learn.probing.structure import read_structure
from bough.learn.robot.limits import default_limits
from bough.learn.robot.stepped import SteppedRobot
from bough.learn.robot.twin_branch import BranchTwin
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError

ARM = jaco2()


@pytest.fixture
def prober(tmp_path):
    """Return a probing of a branch that is begun, what it says, and its folder."""
    twin, said, folder = BranchTwin(ARM, seed=4, segments=1), [], Folder(tmp_path / "out")
    twin.write_structure(tmp_path / "branch.yaml")
    folder.begin({}, resume=False)
    folder.zero = {"rest_m": [0.0, 0.0, 0.0], "stiffness_scale": 1.0}
    robot = SteppedRobot(twin, default_limits(ARM))
    own = Prober(robot, ARM, read_structure(tmp_path / "branch.yaml"), folder, ways=Ways(), budget=Budget(2),
                 settings=Settings(), say=said.append)  # fmt: skip
    return own, said, folder


def pulling(monkeypatch, bearable):
    """Let every pull above a force fail, and return the largest forces that were tried [N]."""
    tried = []

    def pull(hand, push, path):
        tried.append(hand.largest)
        if hand.largest > bearable:
            raise ForceError("the branch pulls with 16 N where 10 N are allowed")
        path.write_text("whole")

    monkeypatch.setattr(Hand, "pull", pull)
    return tried


def test_a_branch_that_pulls_too_hard_is_pulled_by_half(prober, monkeypatch):
    """Repeat a pull with half of the force until the branch bears it; later pulls and another process stay gentle."""
    own, said, folder = prober
    own._prepare()
    whole = own._hand.largest
    tried = pulling(monkeypatch, 0.3 * whole)
    plan = own._planned(1, 0)
    assert own._pulled(1, plan) == plan["recordings"]
    assert tried[:3] == pytest.approx([whole, whole / 2.0, whole / 4.0]) and set(tried[3:]) <= {tried[2]}
    assert sum("again with half" in line for line in said) == 2
    assert folder.zero["share"] == 0.25 and folder.recording(1, 1).exists()
    own._hand.share = 1.0
    own._prepare()
    assert own._hand.largest == pytest.approx(whole / 4.0)


def test_a_branch_that_pulls_too_hard_always_ends_it(prober, monkeypatch):
    """Give up after so many halvings, with what was wrong; nothing is taken for a recording."""
    own, _, folder = prober
    own._prepare()
    tried = pulling(monkeypatch, 0.0)
    with pytest.raises(ForceError, match="10 N are allowed"):
        own._pulled(1, own._planned(1, 0))
    assert len(tried) == GENTLER + 1 and not folder.recording(1, 1).exists()


def test_pulls_of_other_menus_are_refused(prober):
    """Name the file of a plan, or of a round, with a pull that this arm does not have."""
    own, _, folder = prober
    own._prepare()
    plan = {**own._planned(1, 0), "pull": "a leap"}
    with pytest.raises(InputError, match=r"plan_1\.json: pull: found 'a leap'; allowed: "):
        own._pulled(1, plan)
    folder.set_finding(1, Finding(2, "effects", propose="a leap"))
    with pytest.raises(InputError, match=r"round_1\.json: propose: found 'a leap'; allowed: "):
        own._planned(2, 2)
