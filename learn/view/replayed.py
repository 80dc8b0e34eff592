"""Where the grasp point of a case's branch goes: as measured, with a model, with many sets of springs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..cases.case import BranchCase, load_case
from ..priors.earlier import read_particles
from ..replay.recording import recordings
from ..replay.rollout import Rollout
from ..systems.acting import Acting
from ..systems.branch import BranchSystem, Kind, Unknowns
from ..systems.model_file import BranchModel, blown_by, check_fits, read_model

KINDS: dict[str, Kind] = {
    "stiffness": "stiffness",
    "damping": "damping",
    "density": "density",
    "rest angle": "rest_angle",
}


@dataclass(frozen=True)
class Told:
    """A model's account of a case.

    Attributes:
        name: What it is called on the page.
        moved: Displacement of the grasp point [m], shape [R, T, 3]; zero past a recording's end.
        stiffness: Springs [N m/rad], shape [segments].
    """

    name: str
    moved: Array
    stiffness: Array


def branch_case(folder: Path) -> BranchCase:
    """Read a branch's case.

    Raises:
        InputError: What `load_case` refuses, or a case of joints.
    """
    case = load_case(folder)
    if not isinstance(case, BranchCase):
        allowed = "branch-gap-case/1: joints measured directly have no branch to show"
        raise InputError(folder / "meta.yaml", "format", "joint-gap-case/1", allowed)
    return case


def nominal_springs(case: BranchCase) -> Array:
    """Return springs of typical green wood [N m/rad], shape [segments]."""
    return BranchSystem(case).tree.stiffness.copy()


def nominal(case: BranchCase) -> Told:
    """Return what springs of typical green wood make of a case."""
    system = BranchSystem(case)
    model = BranchModel(case.name, case.segment_name, system.tree.stiffness, system.tree.damping)
    return told(case, model, "nominal springs")


def told(case: BranchCase, model: BranchModel, name: str) -> Told:
    """Return what a model makes of a case, replayed as identification and diagnosis do."""
    chosen = recordings(blown_by(model, case))
    rollout = Rollout(case, chosen, 1, unknowns=Unknowns(effects=model.effects))
    moved = rollout(torch.tensor(model.values[None]))[0, :, :, :3].double().cpu().numpy()
    return Told(name, moved, model.stiffness)


def model_in(folder: Path, case: BranchCase, name: str = "model.yaml") -> BranchModel:
    """Read a model of a diagnosis.

    Raises:
        InputError: It is missing, faulty or another branch's.
    """
    model = read_model(folder / name)
    check_fits(model, case, folder / name)
    return model


def before_and_after(case: BranchCase, diagnosis: Path) -> list[Told]:
    """Return what the models of a diagnosis make of a case: before repair, where the folder has that, and after.

    Raises:
        InputError: What `model_in` refuses.
    """
    after = model_in(diagnosis, case)
    names = " + ".join(a.label for a in after.effects) or "springs and dampers"
    out = [told(case, after, f"after repair: {names}")]
    if (diagnosis / "base.yaml").exists():
        out.insert(0, told(case, model_in(diagnosis, case, "base.yaml"), "before: springs and dampers"))
    return out


def effects_beside(file: Path) -> tuple[Acting, ...]:
    """Return the effects of the ``model.yaml`` beside a posterior; none where there is no such file."""
    model = file.parent / "model.yaml"
    return read_model(model).effects if model.exists() else ()


@dataclass(frozen=True)
class Drawn:
    """Members of a posterior: names of their parameters, values [P, n] in SI units, and effects that act."""

    names: tuple[str, ...]
    values: Array
    effects: tuple[Acting, ...] = ()

    def unknowns(self) -> Unknowns:
        """Return which unknowns of a branch they have."""
        found = [(kind, label) for label, kind in KINDS.items() if any(self._is(n, label) for n in self.names)]
        shared = tuple(kind for kind, label in found if label in self.names)
        free = set(self.names)
        effects = tuple(
            Acting(a.name, a.joint, {k: v for k, v in a.known.items() if f"{a.label} {k}" not in free})
            for a in self.effects
        )
        return Unknowns(infer=tuple(k for k, _ in found), shared=shared, effects=effects)

    @staticmethod
    def _is(name: str, label: str) -> bool:
        return name == label or name.startswith(f"{label} ")


def drawn_from(file: Path, count: int, seed: int, effects: tuple[Acting, ...] = ()) -> Drawn:
    """Draw members of a ``posterior.npz``, no member twice.

    Raises:
        InputError: It cannot be read or is no posterior.
    """
    names, _, particles = read_particles(file)
    chosen = np.random.default_rng(seed).permutation(len(particles))[:count]
    return Drawn(tuple(names), particles[np.sort(chosen)], effects)


def cloud(case: BranchCase, drawn: Drawn, source: Path) -> Array:
    """Return the displacement of the grasp point for every member [m], shape [P, R, T, 3].

    Raises:
        InputError: The members are of another branch.
    """
    rollout = Rollout(case, recordings(case), len(drawn.values), unknowns=drawn.unknowns())
    wanted = [p.name for p in rollout.system.parameters]
    missing = [name for name in wanted if name not in drawn.names]
    if missing:
        raise InputError(source, "names", ", ".join(drawn.names), f"{', '.join(missing)} too, for this case")
    columns = [drawn.names.index(name) for name in wanted]
    values = torch.tensor(np.ascontiguousarray(drawn.values[:, columns]))
    return np.asarray(rollout(values)[..., :3].double().cpu().numpy())
