"""What a branch's file says a little wrong, and wood that bends, as nuisance columns of every model.

Callipers, scales, protractors and mountings have errors, and segments that are modelled straight are not. Each of these
numbers gets one column: the change of the simulation by one deviation of its prior, about a fitted model. What they
can explain together is never taken for an effect, see `models.nuisance`. Gains of sensors are not among them: an error
of the force sensor's scale is an effect with a name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array
from ...sim.engine.model import Model
from ...sim.engine.simulator import Simulator
from ..cases.case import BranchCase
from ..replay.recording import Recording
from ..replay.rollout import Rollout
from ..systems.branch import LONGEST, BranchSystem, substep_of
from .diagnosis import Geometry
from .models.contest import Batch, Contest
from .models.nuisance import FARTHEST, Nuisances, joined
from .models.refit import Fits, bounded, fit

#: Links per segment in the finer branch that shows the bending of wood inside segments.
PIECES = 3
#: Bend of the wood inside a segment relative to that of its joint under the same torque: mean and standard deviation of
#: its prior, and finite-difference step of its response; and the most that it bends: as much as its joint.
WOOD, WOOD_SPREAD, WOOD_STEP, SUPPLE = 0.05, 0.03, 0.06, 1.0
#: What names of these columns begin with.
GROWN = "wood "
#: Deviations of what is measured by hand: lengths and masses of segments as shares, angles of their axes [rad]. A mass
#: is a density times a volume, of which radii are known to 2 % and the wood swells here and there.
LENGTH, MASS, ANGLE = 0.01, 0.05, np.radians(1.0)
#: Deviations of the point that is held: along and across its segment, as shares of its length. The middle of an arc of
#: 15 degrees is 3 % beside its chord.
ALONG, ACROSS = 0.01, 0.02
#: Deviations of mountings: of the tracked point from the point that is held [m], of the frames of tracker and force
#: sensor [rad], each about each axis.
OFFSET, TRACKER, CELL = 3e-3, np.radians(1.5), np.radians(1.0)
#: Twice the log Bayes factor from which the file's geometry is doubted: twenty to one.
CERTAIN = 6.0
#: Steps of a refit of a model without nuisances; of the base model with unlimited ones.
WITHOUT, UNLIMITED = 4, 8


def add_nuisances(contest: Contest, model: Batch, *, doubted: bool) -> None:
    """Set the nuisance columns of a branch, linearised about a model, a batch of one.

    With ``doubted`` those of geometry and mountings too; wood always bends.
    """
    stated = [_stated(contest, model), _tracker(contest)] if doubted else []
    contest.nuisance = joined([_wood(contest, model), *stated])


def in_doubt(contest: Contest, model: Batch, least: float) -> bool:
    """Return whether the data say, beside a model, that the file's geometry or mountings are off, and by enough.

    By the Bayes factor of uncertain geometry against the file's, in Laplace's approximation (MacKay, Information
    Theory, Inference, and Learning Algorithms (2003), section 28.1): what the nuisances explain, in noise as large as
    what is left then, less what it costs that they might have been anything. The model's parameters are free on both
    sides. What they explain must be ``least``, in units of the noise: wood bends otherwise than its columns say.
    """
    residual, derivative, _ = contest.linearise(model)
    rows, r = derivative[0].flatten(1), residual[0].flatten()
    wood, stated = contest.nuisance, joined([_stated(contest, model), _tracker(contest)])
    known = _evidence(rows, wood, r)
    loose = _evidence(rows, joined([wood, stated]), r)
    gain, noise = known[0] - loose[0], max(1.0, loose[0] / contest.num_samples)
    return gain / noise - (loose[1] - known[1]) > CERTAIN and gain > least**2 * contest.num_samples


def _evidence(own: torch.Tensor, nuisance: Nuisances, r: torch.Tensor) -> tuple[float, float]:
    """Return least squares of r [N] beside rows [P, N] and nuisances, and the log determinant of their precision.

    Rows without a prior are held by a millionth of their own weight, so that what does not act has a determinant.
    """
    rows, count = torch.cat([own, nuisance.flat]), len(own)
    normal, pull = rows @ rows.T, rows @ r
    held = 1e-6 * normal.diagonal().clamp(min=1.0)
    held[count:] = 1.0
    pull[count:] += nuisance.mean
    precision = normal + torch.diag(held)
    most = torch.cat([pull.new_full((count,), torch.inf), nuisance.high])
    least = torch.cat([pull.new_full((count,), -torch.inf), nuisance.low])
    found = bounded(precision[None], pull[None], least[None], most[None])[0]
    away = found[count:] - nuisance.mean
    return float(((r - found @ rows) ** 2).sum() + (away**2).sum()), float(torch.logdet(precision))


def _columns(contest: Contest, change: torch.Tensor, names: list[str]) -> Nuisances:
    """Return changes of the channels [M, R, T, C] by one deviation as nuisances of mean zero."""
    whitened = contest.whiten(change).flatten(2)
    mean = whitened.new_zeros(len(whitened))
    return Nuisances(whitened, mean, tuple(names), mean - FARTHEST, mean + FARTHEST)


def explained_by(contest: Contest, model: Fits, motion: float) -> Geometry:
    """Return what the nuisances of a model, a batch of one, explain; its parameters are fitted anew without them.

    ``motion`` is the rms of the motion in units of the noise. How wood bends nobody has measured, so that it cannot be
    too far off.
    """
    rigid = fit(contest.rigid(), model.batch, WITHOUT)
    gained = max(float(rigid.chi2[0] - model.chi2[0]), 0.0) / contest.num_samples
    measured = by_hand(contest.nuisance)
    name, far = _furthest(contest, model, measured)
    chance = min(1.0, len(measured) * 2.0 * float(norm.sf(far)))
    return Geometry(float(np.sqrt(gained)) / motion, f"{name}, {far:.1f} deviations off", chance)


def by_hand(nuisance: Nuisances) -> list[int]:
    """Return the columns of what somebody measured; none where the file's geometry and mountings are not in doubt."""
    return [k for k, name in enumerate(nuisance.names) if not name.startswith(GROWN)]


def alone(contest: Contest, base: Fits) -> Fits:
    """Return the base model, a batch of one, beside geometry and mountings that may be off by any amount."""
    return fit(contest.unlimited(), base.batch, UNLIMITED)


def instead(contest: Contest, base: Fits, model: Fits) -> str:
    """Return which number is how far off if such a base model leaves less than another model; else nothing."""
    name, far = _furthest(contest, base, range(len(contest.nuisance)))
    return f"{name} {far:.0f} deviations off" if base.chi2[0] < model.chi2[0] else ""


def _furthest(contest: Contest, model: Fits, among: Sequence[int]) -> tuple[str, float]:
    """Return which of some nuisances is furthest from its mean in a model, and by how many deviations."""
    away = (model.nuisance[0] - contest.nuisance.mean).abs()
    k = max(among, key=lambda k: float(away[k]))
    return contest.nuisance.names[k], float(away[k])


# ---- what the file says ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Doubt:
    """A branch whose file says one number otherwise, by one deviation."""

    name: str
    case: BranchCase
    recordings: list[Recording]


def doubts(case: BranchCase, recordings: list[Recording]) -> list[Doubt]:
    """Return a branch with each number of its geometry and of its force sensor's frame changed by one deviation."""
    out = []
    for i, name in enumerate(case.segment_name):
        one = np.eye(case.num_segments)[i]
        changed = {
            "length": case.length * (1.0 + LENGTH * one), "mass": case.mass * (1.0 + MASS * one),
            "elevation": case.elevation + ANGLE * one, "azimuth": case.azimuth + ANGLE * one,
        }  # fmt: skip
        out += [Doubt(f"{key} {name}", replace(case, **{key: x}), recordings) for key, x in changed.items()]
    for k, label in enumerate(("x across", "y across", "along")):
        out.append(Doubt(f"held point {label}", case, [_held(case, r, k) for r in recordings]))
    for k, axis in enumerate("xyz"):
        turn = Rotation.from_rotvec(CELL * np.eye(3)[k]).as_matrix()
        out.append(Doubt(f"force sensor about {axis}", case, [_turned(r, turn) for r in recordings]))
    return out


def _held(case: BranchCase, recording: Recording, axis: int) -> Recording:
    """Return a recording whose point is held elsewhere; along the segment towards its middle, where there is wood."""
    assert recording.grasp is not None
    segment, point = recording.grasp
    way = -1.0 if axis == 2 else 1.0
    step = way * (ALONG if axis == 2 else ACROSS) * case.length[segment]
    return replace(recording, grasp=(segment, point + step * np.eye(3)[axis]))


def _turned(recording: Recording, turn: Array) -> Recording:
    sensed = None if recording.sensed is None else recording.sensed @ turn
    return replace(recording, input=recording.input @ turn, sensed=sensed)


def _stated(contest: Contest, model: Batch) -> Nuisances:
    """Return the columns of the geometry, of the force sensor's frame and of the tracked point's place."""
    case = contest.case
    assert isinstance(case, BranchCase)
    values = contest.values(model)
    first = Rollout(case, contest.recordings, 1, unknowns=contest.unknowns, device=contest.device, track=True)
    middle = first(values)[0].double().clone()
    found, names = list(_beside(contest, first)), [f"tracked point {axis}" for axis in "xyz"]
    for doubt in doubts(case, contest.recordings):
        out = Rollout(doubt.case, doubt.recordings, 1, unknowns=contest.unknowns, device=contest.device)(values)
        found.append(torch.nan_to_num(out[0].double() - middle))
        names.append(doubt.name)
    return _columns(contest, torch.stack(found), names)


def _beside(contest: Contest, rollout: Rollout) -> torch.Tensor:
    """Return how points beside the one that is held move otherwise than it, as they turn with the link [3, R, T, C]."""
    poses = rollout.coordinates()[0]
    count, samples = poses.shape[:2]
    system = rollout.system
    assert isinstance(system, BranchSystem)
    worlds = Model([system.tree] * (count * samples), gravity=system.gravity, width=1, device=rollout.device)
    seen = Simulator(worlds, dt=contest.case.dt)
    seen.state.coordinate.torch[:, 0] = poses.flatten(0, 1)
    turns = seen.observe()[1].cpu().numpy().astype(np.float64).reshape(count, samples, -1, 4)
    out = contest.measured.new_zeros(3, *contest.measured.shape)
    for j, r in enumerate(contest.recordings):
        assert r.grasp is not None
        turn = turns[j, : len(r.t), system.first + r.grasp[0]]
        for k in range(3):
            point = quat_rotate(turn, OFFSET * np.eye(3)[k])
            moved = np.column_stack([point - point[:1], np.gradient(point, r.t, axis=0)])
            out[k, j, : len(r.t)] = torch.as_tensor(moved, device=contest.place)
    return out


def _tracker(contest: Contest) -> Nuisances:
    """Return the columns of a tracker whose frame is turned: what it saw, turned by one deviation about each axis.

    What was measured is taken and not what is simulated, so that they hold whatever effect acts.
    """
    seen = contest.measured.unflatten(-1, (2, 3))
    axes = torch.eye(3, dtype=seen.dtype, device=seen.device)
    turned = [torch.linalg.cross(seen, TRACKER * axis.expand_as(seen)).flatten(-2) for axis in axes]
    return _columns(contest, torch.stack(turned), [f"tracker about {axis}" for axis in "xyz"])


# ---- wood -----------------------------------------------------------------------------------------------------------


def _wood(contest: Contest, model: Batch) -> Nuisances:
    """Return the columns of wood that bends inside each segment, by how much nobody has measured."""
    case = contest.case
    assert isinstance(case, BranchCase)
    spring, damper = contest.values(model)[0, : contest.num_base].chunk(2)
    bends = WOOD * np.ones((case.num_segments + 1, case.num_segments))
    for i in range(case.num_segments):
        bends[i + 1, i] += WOOD_STEP
    out = contest.whiten(_on_pieces(contest, case, spring, damper, bends))
    columns = (out[1:] - out[:1]).flatten(2) * (WOOD_SPREAD / WOOD_STEP)
    mean = columns.new_full((len(columns),), WOOD / WOOD_SPREAD)
    names = tuple(f"{GROWN}{name}" for name in case.segment_name)
    return Nuisances(columns, mean, names, torch.zeros_like(mean), torch.full_like(mean, SUPPLE / WOOD_SPREAD))


def _on_pieces(
    contest: Contest, case: BranchCase, spring: torch.Tensor, damper: torch.Tensor, bends: Array
) -> torch.Tensor:
    """Simulate the finer branch for inside bends [S, segments]; return channels [S, R, T, C]."""
    fine = in_pieces(case)
    piece = case.length[case.grasp_segment] / PIECES
    k = min(int(case.grasp_distance / piece), PIECES - 1)
    held = (PIECES * case.grasp_segment + k, np.array([0.0, 0.0, case.grasp_distance - k * piece]))
    recordings = [replace(r, grasp=held) for r in contest.recordings]
    inside = np.arange(fine.num_segments) % PIECES > 0
    share = np.where(inside, (PIECES - 1) / np.repeat(bends, PIECES, axis=1), 1.0)
    factor = torch.as_tensor(share, device=contest.place)
    finer = 2 * int(np.ceil(LONGEST / substep_of(case)))  # they swing faster, and have no recordings that tell
    rollout = Rollout(fine, recordings, len(bends), device=contest.device, finer=finer)
    values = [x.repeat_interleave(PIECES) * factor for x in (spring, damper)]
    return rollout(torch.cat(values, 1)).double()


def in_pieces(case: BranchCase) -> BranchCase:
    """Return a branch case with every segment cut into pieces of equal length, without recordings."""
    share = np.linspace(0.0, 1.0, PIECES + 1)
    radius = case.radius[:, :1] + (case.radius[:, 1:] - case.radius[:, :1]) * share
    ends = np.stack([radius[:, :-1], radius[:, 1:]], -1)
    area = (ends**2).sum(-1) + ends.prod(-1)
    mass = case.mass[:, None] * area / area.sum(1, keepdims=True)
    names = tuple(f"{n} {k + 1}" for n in case.segment_name for k in range(PIECES))
    return replace(
        case, segment_name=names, length=np.repeat(case.length / PIECES, PIECES), radius=ends.reshape(-1, 2),
        elevation=np.repeat(case.elevation, PIECES), azimuth=np.repeat(case.azimuth, PIECES), mass=mass.ravel(),
        trajectories=(),
    )  # fmt: skip
