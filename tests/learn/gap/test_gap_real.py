"""Diagnoses of real measurements. The cases are in shared/data; without it these are left out."""

from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
import yaml
from bough.learn.cases.case import load_case
from bough.learn.gap.diagnose import find_missing
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.run import Run
from bough.learn.runs.threads import one_thread
from oracles.double_pendulum import write_dfki

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="measured data folder shared/data is not there")


def diagnosed(folder, most=2):
    """Return the diagnosis of a case."""
    with one_thread():
        return find_missing(load_case(folder), Run(Settings(particles=0, max_effects=most)))


def test_pendulum_rubs():
    """Name dry friction, not drag, and predict the third run from the first two to the 0.6 degrees wanted."""
    found = diagnosed(DATA / "pendulum", most=1)
    assert [a.name for a in found.effects] == ["dry_friction"], found.sentence
    assert found.gap.test == (2,)
    assert np.degrees(found.gap.repaired) < 0.6 < 4.0 < np.degrees(found.gap.base)


def write_silverbox(folder):
    """Copy the silverbox with one of its five realisations of a multisine, 8,692 samples; the arrow is whole."""
    copytree(DATA / "silverbox", folder)
    multisine = folder / "silverbox_multisine.csv"
    rows = multisine.read_text().splitlines(keepends=True)
    multisine.write_text("".join(rows[: 1 + 8692]))
    return folder


def test_silverbox_stiffens(tmp_path):
    """Name the cubic spring from one of five realisations, and predict the arrow in free run to the 1.8 mV wanted."""
    found = diagnosed(write_silverbox(tmp_path / "silverbox"), most=1)
    assert [a.name for a in found.effects] == ["cubic_stiffness"], found.sentence
    assert found.gap.test == (1,)
    assert found.gap.repaired < 1.8e-3 < 13e-3 < found.gap.base


def test_double_pendulum_rubs_at_both_joints(tmp_path):
    """Name dry friction at both joints, and leave no more of the torques than the 0.175 and 0.122 N m wanted."""
    found = diagnosed(write_dfki(tmp_path / "arm", ["damping", "com", "inertia", "length"]))
    assert sorted((a.name, a.joint) for a in found.effects) == [("dry_friction", 0), ("dry_friction", 1)]
    measured = np.stack([r.output for r in found.recordings])
    left = np.sqrt(np.mean((measured - found.best_output[:, : measured.shape[1]]) ** 2, axis=(0, 1)))
    assert left[0] < 0.175 and left[1] < 0.122, left


def write_tree(folder, tree):
    """Write the pull of a live tree as a joint case: moment about the root plate in, its inclination out, 2 Hz."""
    table = np.genfromtxt(DATA / "mangrove" / "mangrove_pull.csv", delimiter=",", names=True, dtype=None, encoding=None)
    own = table[table["tree_id"] == tree]
    own = own[np.isfinite(own["moment_at_base_Nm"]) & np.isfinite(own["root_inclination_deg"])]
    t = np.arange(own["time_s"][0], own["time_s"][-1], 0.5)
    columns = [np.interp(t, own["time_s"], own[c]) for c in ("moment_at_base_Nm", "root_inclination_deg")]
    folder.mkdir()
    np.savetxt(folder / "pull.csv", np.column_stack([t, *columns]), fmt="%.6g", delimiter=",", comments="",
               header="time_s,moment_Nm,angle_deg")  # fmt: skip
    joint = {"name": "root", "type": "revolute", "inertia": None, "stiffness": None, "damping": None}
    meta = {
        "format": "joint-gap-case/1", "name": f"tree_{tree}", "mechanism": {"joints": [joint]},
        "input": {"joint": "root", "column": "moment_Nm", "scale": 1.0, "hold": "linear"},
        "outputs": [{"joint": "root", "quantity": "position", "column": "angle_deg", "scale": np.pi / 180}],
        "trajectories": [{"file": "pull.csv", "t_start_s": 0.0, "replicate_of": None}], "noise_nominal": None,
    }  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return folder


@pytest.mark.parametrize("tree", [5, 6, 19, 22, 23, 24, 25, 29, 30])
def test_trees_yield_or_have_hysteresis(tmp_path, tree):
    """Name hysteresis or set, with no static law in its place, where a loop loses much of the work (0.13 to 0.44)."""
    found = diagnosed(write_tree(tmp_path / "tree", tree))
    names = {a.name for a in found.effects}
    assert names & {"hysteresis_boucwen", "plastic_set"}, found.sentence
