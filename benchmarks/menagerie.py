"""Which arms of mujoco_menagerie bough reads, what it leaves out of them, and how their motion compares with C MuJoCo.

    python benchmarks/menagerie.py CHECKOUT [--page docs/menagerie.md]

CHECKOUT is a checkout of github.com/google-deepmind/mujoco_menagerie; nothing of it is kept. The arms are those of its
README (arms, dual arms, mobile manipulators); of each, the model that its first scene includes. A model that is refused
is read again with the words that the refusal asks for. Then both simulators start from the same random pose and rates,
MuJoCo (implicitfast) with contacts, constraints, actuators, tendons, fluid and gravity compensation switched off:

- acceleration: largest difference of the joint accelerations of one step of 1 ms, over the largest of them,
- motion: largest distance of a body from MuJoCo's after half a second, in float64.

A difference is marked "free" where a body floats, whose momentum bough keeps and MuJoCo's integrator lets drift with
the step, and "stiff" where springs are too stiff for the step. Prints the table; --page writes it into a page, between
the marks. Exits with 1 if an unmarked difference of accelerations is above `BOUND`.
"""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from bough.sim.base.errors import InputError
from bough.sim.base.mujoco_log import without_log
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.engine.trajectory import own_bodies
from bough.sim.formats.import_mjcf import Mechanism, load_mjcf

SECTIONS = ("Arms", "Dual Arms", "Mobile Manipulators")
DT, STEPS, SPREAD = 1e-3, 500, 0.3  # step [s], its number, and spread of the start [rad, rad/s]
BOUND = 1e-7
MARKS = ("<!-- menagerie -->", "<!-- /menagerie -->")


@dataclass
class Row:
    """What became of one model: its degrees of freedom, words that it needs, what they left out, and differences.

    ``rubbing`` joints have dry friction, which bough simulates; ``note`` says why the differences are no rounding.
    """

    name: str
    dofs: int = 0
    words: str = ""
    left_out: str = ""
    obstacle: str = ""
    acceleration: float = np.nan
    motion: float = np.nan
    rubbing: int = 0
    note: str = ""

    def line(self) -> str:
        """Return the row of the table."""
        if self.obstacle:
            return f"| {self.name} | no | {self.obstacle} | | |"
        how = f"`--ignore {self.words}`" if self.words else "as it is"
        rubs = f", with the friction of {self.rubbing} joints" if self.rubbing else ""
        return (
            f"| {self.name}, {self.dofs} dof | {how}{rubs} | {self.left_out or 'nothing'} "
            f"| {self.acceleration:.0e}{self.note} | {1e3 * self.motion:.0e} |"
        )


def models(checkout: Path) -> list[Path]:
    """Return the models of the README's arms, as their scenes include them."""
    text, out = (checkout / "README.md").read_text(), []
    for section in SECTIONS:
        part = re.search(rf"^\*\*{section}\.\*\*$(.*?)(?=^\*\*|\Z)", text, re.MULTILINE | re.DOTALL)
        for folder in re.findall(r"\]\(([a-z0-9_]+)/LICENSE\)", part[1] if part else ""):
            scene = min((checkout / folder).glob("scene*.xml"))
            out.append(scene.parent / re.findall(r'<include file="([^"]+)"', scene.read_text())[0])
    return out


def read(path: Path, row: Row) -> Mechanism | None:
    """Read a model, with the words that it needs; note why where it cannot be read."""
    words: tuple[str, ...] = ()
    for _ in range(2):
        try:
            mechanism = load_mjcf(path, words)
        except InputError as e:
            asked = re.search(r"--ignore ([a-z,]+)", e.allowed)
            words = tuple(asked[1].split(",")) if asked else ()
            row.obstacle = f"{e.place}: {e.found}".replace("|", "/")
            if not words:
                return None
        else:
            row.obstacle, row.words, row.left_out = "", ",".join(words), ", ".join(mechanism.ignored)
            return mechanism
    return None


def stripped(path: Path) -> Any:
    """Return C MuJoCo's model of a file without what bough leaves out."""
    with without_log():
        model = mujoco.MjModel.from_xml_path(str(path))
    off = mujoco.mjtDisableBit
    for flag in (off.mjDSBL_CONTACT, off.mjDSBL_CONSTRAINT, off.mjDSBL_ACTUATION, off.mjDSBL_AUTORESET):
        model.opt.disableflags |= int(flag)
    for name in ("tendon_stiffness", "tendon_damping", "tendon_armature", "body_gravcomp"):
        getattr(model, name)[:] = 0.0
    model.opt.density = model.opt.viscosity = 0.0
    model.opt.timestep, model.opt.integrator = DT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def compare(mechanism: Mechanism, path: Path, row: Row) -> None:
    """Start both simulators alike and note how far they part."""
    model, rng = stripped(path), np.random.default_rng(0)
    data = mujoco.MjData(model)
    move = SPREAD * rng.standard_normal(model.nv)
    mujoco.mj_integratePos(model, data.qpos, move, 1.0)
    data.qvel[:] = SPREAD * rng.standard_normal(model.nv)
    simulator = Simulator(Model(mechanism.tree, gravity=mechanism.gravity, precision=64), dt=DT, threads=1)
    simulator.state.set_qpos(data.qpos)
    simulator.state.set_qvel(data.qvel)
    simulator.refresh()
    row.dofs, row.rubbing = model.nv, int(np.count_nonzero(mechanism.friction))
    if simulator.model.has_free_trees:
        row.note = " (free)"
    elif simulator.implicit_worlds():
        row.note = " (stiff)"
    before = data.qvel.copy()
    for steps in (1, STEPS - 1):
        simulator.step(steps)
        mujoco.mj_step(model, data, steps)
        if steps == 1:
            want = (data.qvel - before) / DT
            apart = np.abs(simulator.state.qvel()[0] - data.qvel).max() / DT
            row.acceleration = float(apart / max(np.abs(want).max(), 1e-9))
    mujoco.mj_kinematics(model, data)
    position = simulator.observe()[0][0, own_bodies(mechanism.tree)].cpu().numpy()
    row.motion = float(np.linalg.norm(position - data.xpos[1:], axis=1).max())


def main(argv: list[str] | None = None) -> int:
    """Print the table, and write it into a page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args(argv)
    rows = []
    for path in models(options.checkout):
        row = Row(str(path.relative_to(options.checkout)))
        mechanism = read(path, row)
        if mechanism is not None:
            compare(mechanism, path, row)
        rows.append(row)
        print(row.line(), flush=True)
    head = "| model | loads | left out, or what stands in the way | acceleration | motion [mm] |\n|---|---|---|---|---|"
    if options.page is not None:
        text = options.page.read_text()
        begin, end = text.index(MARKS[0]) + len(MARKS[0]), text.index(MARKS[1])
        table = "\n".join([head, *(row.line() for row in rows)])
        options.page.write_text(f"{text[:begin]}\n{table}\n{text[end:]}")
    return int(any(not row.obstacle and not row.note and not row.acceleration < BOUND for row in rows))


if __name__ == "__main__":
    sys.exit(main())
