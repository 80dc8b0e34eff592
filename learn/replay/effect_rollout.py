"""Arrays and kernel of a rollout with effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.effects.rollout import effect_rollout_kernels
from ...kernels.effects.structs import PARAMETERS, effect_types
from ...kernels.effects.terms import GROUPS, acts, memory_row
from ...sim.base.errors import InputError
from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array
from ...sim.effects import terms_of
from ...sim.engine.arrays import LaneArray
from ...sim.engine.model import Model
from ..cases.case import BranchCase
from ..systems.acting import FIELD
from ..systems.branch import BranchSystem
from .midstep import driving
from .recording import Recording, recordings
from .worlds import ReplayWorlds


def midway_arrays(model: Model) -> dict[str, LaneArray]:
    """Return what the steps of a branch remember of each other, by its name in `kernels.tree.midway`."""
    return {"before": model.field("Vec"), "gain": model.field("Vec"), "ahead": model.field("Quat")}


class EffectArrays:
    """Parameters and memories of the effects in every world.

    Attributes:
        terms: Of all effects that can act, as kernels are built with them.
        arrays: By name, the parameters as `Write` addresses them.
        kernel: The Warp struct that kernels take.
    """

    def __init__(self, rollout: ReplayWorlds) -> None:
        m, acting = rollout.model, rollout.system.acting
        stride, count = m.places + 1, len(acting.names)
        self.terms = terms_of(acting.names, acting.form)
        vectors = memory_row(self.terms, count)
        self.arrays: dict[str, LaneArray] = {
            FIELD: m.field("Real", places=count * PARAMETERS * stride),
            "memory": m.field("Vec", places=max(1, vectors * stride)),
            "settle": m.field("Real", places=1),
            **{name: m.field("Vec") for name in ("effort", "hold", "wind", "swirl", "course", "centre", "end")},
            **midway_arrays(m),
            **{name: m.field("Real") for name in ("damping", "area", "crown")},
        }
        self.kernel = effect_types(m.width, m.precision).Effects()
        self.kernel.parameter = self.arrays[FIELD].kernel
        self.kernel.settle = self.arrays["settle"].column()
        for name in self.arrays.keys() - {FIELD, "settle"}:
            setattr(self.kernel, name, self.arrays[name].kernel)
        self.kernel.stride = stride
        self.kernel.active = wp.zeros((m.groups, count + len(GROUPS)), dtype=int, device=m.device)
        self.kernel.bent = wp.zeros((m.groups, stride), dtype=int, device=m.device)
        self.kernel.lag = wp.zeros((m.groups, 2), dtype=int, device=m.device)
        self._neutral = torch.tensor(acting.neutral()).repeat_interleave(stride).to(self.arrays[FIELD].torch)
        self.arrays[FIELD].torch[..., 0] = self._neutral
        bending = [(acts(term, "joint"), term.per_joint) for term in self.terms]
        self._at_one = torch.tensor([bends and own for bends, own in bending], device=self._neutral.device)
        self._at_all = torch.tensor([bends and not own for bends, own in bending], device=self._neutral.device)
        self._tip(rollout)
        self._areas(rollout)

    def _tip(self, rollout: ReplayWorlds) -> None:
        """Put what hangs at the tip, a mass or a crown, at the upper end of the last link."""
        m, system = rollout.model, rollout.system
        last = system.tree.num_links - 1
        self.kernel.tip = int(m.link_place[last])
        leaf = np.zeros((m.groups, m.places + 1), dtype=np.int32)
        if isinstance(system, BranchSystem):
            leaf[:, self.kernel.tip] = 1
            end = m.links.in_link_frame(last, np.array([0.0, 0.0, system.branch.length[-1]]))
            self.arrays["end"].torch[:, :, self.kernel.tip] = torch.as_tensor(end).to(self.arrays["end"].torch)
        self.kernel.leaf = wp.array(leaf, dtype=int, device=m.device)

    def _areas(self, rollout: ReplayWorlds) -> None:
        """Give every segment its projected area, a trapezium, and that one's centre, and the crown all of the areas."""
        m, system = rollout.model, rollout.system
        if not isinstance(system, BranchSystem):
            return
        branch = system.branch
        a, b = branch.radius[:, 0], branch.radius[:, 1]
        area, height = branch.length * (a + b), branch.length * (a + 2.0 * b) / (3.0 * (a + b))
        self.arrays["crown"].torch[:, :, self.kernel.tip, 0] = float(area.sum())
        for i in range(branch.num_segments):
            place, link = int(m.link_place[system.first + i]), system.first + i
            local = m.links.in_link_frame(link, np.array([0.0, 0.0, height[i]]))
            self.arrays["area"].torch[:, :, place, 0] = float(area[i])
            self.arrays["centre"].torch[:, :, place] = torch.as_tensor(local).to(self.arrays["centre"].torch)

    def track(self, rollout: ReplayWorlds) -> LaneArray:
        """Return memory for the joints' coordinates at every sample, of one entry where they are not tracked."""
        m = rollout.model
        samples = rollout._output.torch.shape[2] // 6
        self.arrays["track"] = m.field("Quat", places=samples * (m.places + 1) if rollout.track else 1)
        return self.arrays["track"]

    def refresh(self, rollout: ReplayWorlds, values: torch.Tensor) -> None:
        """Take over the dampers that the system has just been given and mark the worlds that rest under a load."""
        self.arrays["damping"].torch.copy_(rollout.simulator._damping.torch)
        acting = rollout.system.acting
        columns = values[:, values.shape[1] - len(acting.parameters) :]
        self._lags(rollout, columns)
        marks = acting.marks(columns)
        rollout.place_marks(self.arrays["settle"], marks)
        on, terms = acting.switched_on(columns), self.terms
        of_kind = ([acts(x, "link") for x in terms], [x.lasting for x in terms], [x.holds is not None for x in terms],
                   [x.precedes for x in terms])  # fmt: skip
        kinds = [(on & torch.tensor(k, device=on.device)).any(1, keepdim=True) for k in of_kind]
        sets = torch.cat([on, *kinds, marks[:, None] != 0.0, acting.changes("crown", columns)[:, None]], 1)
        groups = sets.view(rollout.blocks, rollout.model.width, -1).any(1)
        active = wp.to_torch(self.kernel.active).view(-1, *groups.shape)
        active.copy_(groups.expand_as(active))
        self._bend(rollout)

    def _bend(self, rollout: ReplayWorlds) -> None:
        """Mark the joints at which a law of a group's worlds acts: where a parameter of one is not neutral."""
        own = self.arrays[FIELD].torch.unflatten(0, (rollout.chains, rollout.blocks))[0, ..., 0]
        changed = (own != self._neutral).unflatten(-1, (len(self.terms), PARAMETERS, -1)).any(3).any(1)
        groups = changed[:, self._at_one].any(1) | changed[:, self._at_all, 0].any(1, keepdim=True)
        bent = wp.to_torch(self.kernel.bent).view(-1, *groups.shape)
        bent.copy_(groups.expand_as(bent))

    def _lags(self, rollout: ReplayWorlds, columns: torch.Tensor) -> None:
        """Note by how many samples the sensors of each group's worlds are late, at least and at most."""
        acting = rollout.system.acting
        if acting.has("time_delay"):
            late = acting.value("time_delay", "lag_s", columns).view(rollout.blocks, -1) / rollout.case.dt
            ends = torch.stack([late.amin(1).floor(), late.amax(1).ceil()], 1)
            lags = wp.to_torch(self.kernel.lag).view(-1, *ends.shape)
            lags.copy_(ends.expand_as(lags))


def prepare(rollout: ReplayWorlds) -> tuple[EffectArrays, Callable[[], None]]:
    """Return the arrays of a rollout's effects and what replays its recordings with them."""
    m, sim, system = rollout.model, rollout.simulator, rollout.system
    fx = EffectArrays(rollout)
    kernels = effect_rollout_kernels(m.width, m.precision, fx.terms)
    before: list[Any] = [sim._dynamics, sim.state.kernel, sim.load.kernel, fx.kernel]
    if isinstance(system, BranchSystem):
        before += _branch_arguments(rollout)
        kernel = kernels.point
    else:
        before += rollout.joint_arguments()
        before += _recorded(rollout, rollout.recordings)
        kernel = kernels.joint
    after = [rollout.substeps, sim.dt / rollout.substeps, sim.max_speed, rollout.allocate_output().kernel]
    if isinstance(system, BranchSystem):
        after += [int(rollout.track), fx.track(rollout).kernel]
    return fx, sim._launcher.prepare(kernel, before, after)


def _recorded(rollout: ReplayWorlds, sequence: Sequence[Recording]) -> list[Any]:
    """Return what each group replays, how long that is, when it begins, and what acts, for joints."""
    device = rollout.device
    which = np.repeat(np.arange(len(sequence)), rollout.blocks)
    return [
        wp.array(which, dtype=int, device=device),
        wp.array([len(r.t) for r in sequence], dtype=int, device=device),
        wp.array([r.t_start for r in sequence], dtype=wp.float64, device=device),
        wp.array(_stacked(driving(rollout.case, sequence)), dtype=wp.float64, device=device),
    ]


def _branch_arguments(rollout: ReplayWorlds) -> list[Any]:
    system, m, device, case = rollout.system, rollout.model, rollout.device, rollout.case
    assert isinstance(system, BranchSystem) and isinstance(case, BranchCase)
    rollout.channels = 6
    sequence = history(rollout) if rollout.chained else rollout.recordings
    chains = 1 if rollout.chained else len(sequence)
    first = np.repeat(np.arange(chains), rollout.blocks)
    last = first + 1 if not rollout.chained else np.full_like(first, len(sequence))
    longest = max(len(r.t) for r in rollout.recordings)
    starts = [r.t_start for r in rollout.recordings]
    offset = np.zeros(len(sequence), dtype=int)
    if rollout.chained:
        offset[:] = [starts.index(r.t_start) * longest if r.t_start in starts else -1 for r in sequence]
    held = [system.first + _grasp(r)[0] for r in sequence]
    inputs = _stacked([_felt(r) for r in sequence])
    return [
        wp.array([int(m.link_place[i]) for i in held], dtype=int, device=device),
        wp.array(np.stack([_grip(rollout, r) for r in sequence]), dtype=wp.float64, device=device),
        wp.array(first, dtype=int, device=device),
        wp.array(last, dtype=int, device=device),
        wp.array([len(r.t) for r in sequence], dtype=int, device=device),
        wp.array([r.t_start for r in sequence], dtype=wp.float64, device=device),
        wp.array(offset, dtype=int, device=device),
        wp.array([case.lead * r.sways for r in sequence], dtype=int, device=device),
        wp.array(inputs, dtype=wp.float64, device=device),
        wp.array(_courses(sequence), dtype=wp.float64, device=device),
    ]


def _courses(sequence: Sequence[Recording]) -> Array:
    """Return the courses of gusts [recordings, lead and longest, 2], zero where there is none; of length 1 without."""
    known = [r.course for r in sequence if r.course is not None]
    out = np.zeros((len(sequence), max([1, *map(len, known)]), 2))
    for j, r in enumerate(sequence):
        if r.course is not None:
            out[j, : len(r.course)] = r.course
    return out


def _felt(r: Recording) -> Array:
    """Force [N], whether the gripper holds, what the sensor read [N], that it read anything, `together`, [T, 9]."""
    sensed, ones = r.input if r.sensed is None else r.sensed, np.ones(len(r.t))
    return np.column_stack([r.input, r.contact.astype(np.float64), sensed, ones, ones * r.together])


def history(rollout: ReplayWorlds) -> list[Recording]:
    """Return the chosen recordings and all that the case has before the last of them, in time order.

    Raises:
        InputError: Two of the chosen recordings begin at the same time.
    """
    chosen = {r.t_start: r for r in rollout.recordings}
    if len(chosen) < len(rollout.recordings):
        raise InputError(rollout.case.folder / "meta.yaml", "t_start_s", "one time for two trajectories", "a time each")
    left = {t.t_start for t in rollout.case.trajectories if t.t_start < max(chosen)} - chosen.keys()
    before = [r for r in recordings(rollout.case) if r.t_start in left] if left else []
    return sorted([*before, *chosen.values()], key=lambda r: r.t_start)


def _grasp(recording: Recording) -> tuple[int, Array]:
    assert recording.grasp is not None
    return recording.grasp


def _grip(rollout: ReplayWorlds, recording: Recording) -> Array:
    """Where a branch is held.

    Returns:
        Grasp point [m] and segment's axis in the link's frame, the way down (negative) and up to its ends [m], the
        point in the world in the given pose [m], the recording's largest force [N], where it stands before [m], what
        the sensor reads of an open gripper [N], and where the gripper faces, shape [21].
    """
    system = rollout.system
    assert isinstance(system, BranchSystem)
    segment, point = _grasp(recording)
    branch = system.branch
    link, links = system.first + segment, rollout.model.links
    inverse = links.frame[link] * [1.0, -1.0, -1.0, -1.0]
    along = quat_rotate(inverse, np.array([0.0, 0.0, 1.0]))
    return np.concatenate([
        links.in_link_frame(link, point), along, [-point[2], branch.length[segment] - point[2]],
        branch.lower_end[segment] + point[2] * branch.axis[segment], [np.linalg.norm(recording.input, axis=1).max()],
        recording.off, recording.opened, recording.heading,
    ])  # fmt: skip


def _stacked(rows: Sequence[Array]) -> Array:
    """Return inputs of all recordings [recordings, longest, columns], zero past their ends."""
    out = np.zeros((len(rows), max(len(r) for r in rows), max(1, rows[0].shape[1])))
    for j, r in enumerate(rows):
        out[j, : len(r), : r.shape[1]] = r
    return out
