"""Scenes: trees grown once on the host, and where tree and line of every world stand, drawn on the device.

A scene is one tree within an arm's reach and a target (a power line, say) that its branches cover. Trees are grown and
culled once a run, one for every world, which keeps it for good. A place of tree and target is drawn for chosen worlds
in one launch (`kernels.tasks.scene`), from counters alone: seed, world and episode give the same place whenever it is
asked for.

Training and tests never share a seed: both the trees and the device's key come from ``SeedSequence([domain, seed])``,
whose first word names the domain (`DOMAINS`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tasks import scene as kernels
from ..arms.arm import Arm, forward_kinematics
from ..arms.arrays import arm_capsules
from ..arms.simulator import ArmSimulator
from ..base.errors import InputError
from ..base.rotation import quat_rotate
from ..base.thread_pool import recorded
from ..base.types import Array, IntArray
from ..engine import arrays
from ..engine.launcher import Recorded
from ..formats.export_mesh import shape_ends
from ..trees.cull import keep_links
from ..trees.pose import rest_pose
from ..trees.species import grow_forest
from ..trees.stiffness import hold_rest_pose, rudimentary, toppling_stiffness
from ..trees.tree import Joint, Tree
from ..wood.effects import WoodEffects
from ..wood.posterior import SpringPosterior, Wood

Range = tuple[float, float]

DOMAINS = {"training": 0x7472_6169, "test": 0x7465_7374}
"""First word of the seed's sequence: "trai" and "test" in ASCII."""

_PUSH = 0.1  # way that wood must give to be pushed aside [m]
_RUNS = 64  # threads that share the attempts of a world on a GPU; of so many at once one is found nearly always
_ALONG = 9  # points on a capsule's axis that are asked whether the arm reaches them


@dataclass(frozen=True)
class Target:
    """What the branches cover, and the region around it to clear: a surface around one axis, or several side by side.

    Attributes:
        length: Range of the axis' length [m]; 0 for a ball.
        clearance: Distance of the region's surface from the axis [m]: the radius of a cylinder or ball.
        rounded: Whether the surface is a ball around the axis' start instead of a cylinder's side.
        strips: Number of parallel axes over the width; with several, the region is a panel.
        width: Width that the strips share [m].
        radius: Radius of the solid along the middle axis, which arm and branches collide with [m].
    """

    length: Range = (0.6, 1.0)
    clearance: float = 0.05
    rounded: bool = False
    strips: int = 1
    width: float = 0.0
    radius: float = 0.01


@dataclass(frozen=True)
class SceneSettings:
    """Ranges of a scene. The arm's base is the origin, z is up; angles in degrees, the rest in SI units.

    Attributes:
        species: Ternary species of the trees (`sim.trees.species`).
        order: Order of the trees: 2 has 17 links before culling, 3 has 53.
        most_links: Links that a tree keeps at most: those nearest to where an arm may be.
        distinct: Number of different trees, which the worlds have in turn; None grows one for every world.
        noise: Standard deviation of the trees' parameters, relative (thesis 5.4.1: 0.1).
        scale: Metres per unit of the species' lengths.
        upper, lower, decay: Springs as in `stiffness.rudimentary` [N m/rad]; the defaults are its own.
        wood: Wood of a measured branch that gives the springs and dampers instead (`SpringPosterior.wood`); empty for
            none.
        effects: What else the branches of that wood do (`sim.wood.effects.wood_effects`).
        firm: Level force on the middle of a link above which it counts as too firm to be pushed 0.1 m aside [N]; such
            wood occludes nothing at the start.
        target: The target.
        distance: Horizontal distance of the trunk from the arm's base [m].
        bearing: Half-range of the trunk's direction about the way the arm faces at home.
        height: Height of the trunk's upper end, the first fork, above the arm's base [m].
        tilt: Greatest angle of the line to the horizontal axis through trunk and arm base (thesis 5.4.1: 15).
        side: Greatest slope of the way from the covering branch to the line, seen along the line: 0 puts the line
            beside the branch, level with it; 90 also above and below.
        shift: Greatest shift of the line along itself, as a share of its length.
        depth: How far the covering branch reaches into the region whose points count as occluding [m]; clearing takes a
            push of at least that.
        reach: Distance from the shoulder of the covered part of the line, and of the branch that covers it [m].
        near: Distance of a branch point from a point of the target at which the pair counts as occluding (d_th) [m].
        pairs: Number of such pairs expected at the start, of ``points`` x ``points`` points. A score of 1 takes 200;
            with many more the score does not change until most of the way is done.
        branches: Least number of branches (links) that reach into the region whose points count as occluding.
        feasible: Whether to leave out what one arm can hardly clear: firm wood or branches deeper than ``depth`` in
            that region, more than the upper bound of ``pairs``. `Scene.left_out` tells where that is so.
        points: Points of each cloud.
        gap: Free space between arm and branches at the start [m].
        target_gap: Free space between arm and the target's axis at the start [m].
        stiffness, damping: Factors on stiffness and on relaxation time, uniform in the logarithm.
        friction: Coulomb friction of contacts.
        attempts: Proposals a place is chosen from.
    """

    species: str = "Ta"
    order: int = 2
    most_links: int = 40
    distinct: int | None = None
    noise: float = 0.1
    scale: float = 0.004
    upper: float = 120.0
    lower: float = 5.0
    decay: float = 1.0 / 3.0
    wood: Wood = ()
    effects: WoodEffects = ()
    firm: float = 20.0
    target: Target = Target()
    distance: Range = (0.50, 0.65)
    bearing: float = 10.0
    height: Range = (-0.35, -0.05)
    tilt: float = 15.0
    side: float = 60.0
    shift: float = 0.25
    depth: Range = (0.02, 0.10)
    reach: Range = (0.30, 0.75)
    near: float = 0.10
    pairs: Range = (150.0, 450.0)
    branches: int = 3
    feasible: bool = True
    points: int = 512
    gap: float = 0.02
    target_gap: float = 0.10
    stiffness: Range = (0.7, 1.4)
    damping: Range = (0.7, 1.4)
    friction: Range = (0.3, 0.7)
    attempts: int = 2048

    def check(self, reach: float = np.inf) -> SceneSettings:
        """Return self if a scene can be made of it for an arm that reaches ``reach`` metres from its shoulder.

        Raises:
            InputError: A range is empty or out of bounds, the target's shape is unknown, the line is out of reach.
        """
        for name in ("distance", "height", "depth", "reach", "pairs", "stiffness", "damping", "friction"):
            low, high = getattr(self, name)
            _need(low <= high, name, f"{low:g} to {high:g}", "a range from low to high")
        for name in ("stiffness", "damping", "distance", "pairs"):
            low = getattr(self, name)[0]
            _need(low > 0.0, name, f"{low:g}", "above zero")
        _need(self.distinct is None or self.distinct >= 1, "distinct", str(self.distinct), "1 or more trees")
        _need(self.branches >= 1, "branches", str(self.branches), "1 or more")
        _need(self.attempts >= 1, "attempts", str(self.attempts), "1 or more")
        _need(self.most_links >= 2, "most_links", str(self.most_links), "2 or more")
        _need(0.0 <= self.tilt < 90.0, "tilt", f"{self.tilt:g} degrees", "0 to below 90")
        _need(self.target.strips >= 1, "target strips", str(self.target.strips), "1 or more")
        low, high = self.target.length
        _need(0.0 <= low <= high, "target length", f"{low:g} to {high:g} m", "a range from 0 or more")
        wide = self.target.clearance + self.near
        _need(self.depth[1] < wide, "depth", f"{self.depth[1]:g} m", f"below clearance + near = {wide:g} m")
        found = f"{self.reach[0]:g} to {self.reach[1]:g} m from the shoulder"
        _need(self.reach[1] <= reach, "line", found, f"within the arm's reach of {reach:.3g} m")
        return self


def _need(ok: bool, place: str, found: str, allowed: str) -> None:
    if not ok:
        raise InputError("scene", place, found, allowed)


def seed_sequence(seed: int, domain: str) -> np.random.SeedSequence:
    """Return the source of all of a run's scene seeds: ``SeedSequence([domain, seed])``."""
    return np.random.SeedSequence([DOMAINS[domain], seed])


def arm_reach(arm: Arm) -> tuple[Array, float]:
    """Return the arm's shoulder (joint 2, or 1 if it has one, at home) [m] and its reach from there, stretched [m]."""
    first = min(1, arm.num_dofs - 1)
    shoulder = forward_kinematics(arm, arm.home)[0][first]
    lengths = np.linalg.norm(arm.tree.position[first + 1 : arm.end_link + 1], axis=1)
    return shoulder, float(lengths.sum() + np.linalg.norm(arm.end_position))


def grow_trees(
    settings: SceneSettings, arm: Arm, worlds: int, *, seed: int, domain: str = "training"
) -> list[Tree]:  # fmt: skip
    """Grow the trees of a run: trunk fixed, springs that hold the rest pose, culled to what the arm reaches.

    Tree i depends on settings, arm, seed, domain and i alone. Order 2 takes about 2 ms a tree on one core, order 3
    about 4.

    Args:
        settings: Their number is ``distinct``, at most one a world.
        arm: The arm that is to reach them.
        worlds: Number of worlds.
        seed: Seed of the run.
        domain: ``training`` or ``test`` (`DOMAINS`).

    Raises:
        InputError: The settings (`SceneSettings.check`), a tree out of reach from every side, or wood too soft for it.
    """
    shoulder, reach = arm_reach(arm)
    settings.check(reach)
    grown, springs = seed_sequence(seed, domain).generate_state(2, np.uint64)
    _need(worlds >= 1, "worlds", str(worlds), "1 or more")
    forest = grow_forest(
        settings.species, min(settings.distinct or worlds, worlds), settings.order,
        noise=settings.noise, seed=int(grown), scale=settings.scale, fixed_base=True,
    )  # fmt: skip
    rng = np.random.default_rng(int(springs))
    return [_finished(cull_to_reach(tree, settings, float(shoulder[2]), reach), settings, rng) for tree in forest]


def _finished(tree: Tree, settings: SceneSettings, rng: np.random.Generator) -> Tree:
    if settings.wood:
        return hold_rest_pose(of_wood(tree, settings))
    spring = {"upper": settings.upper, "lower": settings.lower, "decay": settings.decay}
    return hold_rest_pose(rudimentary(tree, rng=rng, **spring))


def of_wood(tree: Tree, settings: SceneSettings) -> Tree:
    """Return the tree with the springs and dampers of the settings' wood, none of which its weight may topple."""
    out = SpringPosterior.from_wood(settings.wood).apply(tree, 0)
    turns = out.joint != Joint.FIXED
    softest = settings.stiffness[0] * out.stiffness[turns]
    stands = softest >= 2.0 * toppling_stiffness(out)[turns]  # as `rudimentary` has it
    _need(bool(stands.all()), "wood", f"{tree.name} toppling under its own weight", "stiffer wood")
    return out


def cull_to_reach(tree: Tree, settings: SceneSettings, shoulder: float, reach: float) -> Tree:
    """Keep what an arm reaches from some place of the tree, however its trunk is turned; the mass of the rest stays.

    A point at height z and radius r from the trunk's axis is hypot(r - d, z - h) away from a shoulder at height h that
    looks from its side of the tree, d from the trunk (as `sim.trees.cull` for one place).
    """
    start, end, radius = rest_capsules(tree)
    share = np.linspace(0.0, 1.0, _ALONG)[:, None, None]
    points = start + share * (end - start)
    span, rise = np.hypot(points[..., 0], points[..., 1]), points[..., 2] - fork_height(tree) - shoulder
    aside = span - np.clip(span, *settings.distance)
    above = rise + np.clip(-rise, *settings.height)
    away = (np.hypot(aside, above) - radius).min(axis=0)
    _need(bool((away <= reach).any()), "tree", f"{tree.name} with no link within reach", f"a link within {reach:.3g} m")
    keep = _carried_and(tree, away <= reach)
    for bound in np.sort(away)[::-1]:
        if keep.sum() <= settings.most_links:
            break
        keep = _carried_and(tree, away < min(bound, reach))
    return keep_links(tree, keep)


def _carried_and(tree: Tree, shapes: np.ndarray) -> np.ndarray:
    """Links of the chosen capsules and those that carry them, shape [L]."""
    keep = np.zeros(tree.num_links, dtype=bool)
    keep[tree.shape_link[shapes]] = True
    for i in reversed(range(tree.num_links)):
        if keep[i] and tree.parent[i] >= 0:
            keep[tree.parent[i]] = True
    return keep


def fork_height(tree: Tree) -> float:
    """Height of the trunk's upper end above its foot, joints at zero [m]."""
    turned = quat_rotate(tree.rotation[0], np.stack([tree.shape_start[0], tree.shape_end[0]]))
    return float((tree.position[0] + turned)[:, 2].max())


def share_trees(distinct: list[Tree], worlds: int) -> tuple[list[Tree], IntArray]:
    """Return one tree a world and its number: tree w mod n for world w.

    Raises:
        InputError: There is no world.
    """
    _need(worlds >= 1, "worlds", str(worlds), "1 or more")
    index = np.arange(worlds) % len(distinct)
    return [distinct[i] for i in index], index


@dataclass(frozen=True)
class Axes:
    """Ends of axes [m], Warp arrays of vec3."""

    start: wp.array
    end: wp.array


class Scene:
    """Places trees and targets of a simulator's worlds.

    Attributes:
        root, turn: Foot of each world's trunk [m] and its turn as w, x, y, z, torch views [worlds, 3] and [worlds, 4].
        target: Ends of the axes around which the region to clear lies, for perception, Warp arrays [worlds, strips].
        stiffness, damping: Factors drawn for each world, [worlds].
        breach: How far each world's place breaks a rule [m], 0 where it breaks none, [worlds].
        crowd: What is at each world's target (`kernels.tasks.scene`): metres of firm wood and of too deep
            branches, expected pairs, number of branches, [worlds, 4].
    """

    def __init__(
        self, simulator: ArmSimulator, distinct: list[Tree], index: IntArray, settings: SceneSettings,
        *, seed: int, domain: str = "training",
    ) -> None:  # fmt: skip
        """Allocate everything; place nothing yet.

        Args:
            simulator: Worlds made of `share_trees`'s trees.
            distinct: What `grow_trees` returned.
            index: What `share_trees` returned.
            settings: The ranges.
            seed: Seed of all places.
            domain: ``training`` or ``test`` (`DOMAINS`).

        Raises:
            InputError: The settings (`SceneSettings.check`).
        """
        self.settings, self._simulator = settings, simulator
        self.device = simulator.model.device
        shoulder, reach = arm_reach(simulator.arm)
        settings.check(reach)
        self._arrays = _scene_arrays(distinct, index, simulator.arm, shoulder, settings, self.device)
        self._rules = _scene_rules(settings, simulator.arm)
        words = seed_sequence(seed, domain).generate_state(4)[2:]
        self._key = wp.vec2ui(int(words[0]), int(words[1]))
        self._allocate(len(index))

    root: torch.Tensor
    turn: torch.Tensor
    stiffness: torch.Tensor
    damping: torch.Tensor
    breach: torch.Tensor
    crowd: torch.Tensor

    def left_out(self) -> dict[str, torch.Tensor]:
        """Return by rule in which worlds the place is one that ``feasible`` leaves out, bool [worlds] on the device."""
        firm, deep, pairs = self.crowd[:, 0] > 0.0, self.crowd[:, 1] > 0.0, self.crowd[:, 2] > self.settings.pairs[1]
        return {"firm wood": firm, "deep branches": deep, "many pairs": pairs, "any": firm | deep | pairs}

    def _allocate(self, worlds: int) -> None:
        kinds: dict[str, Any] = {"root": wp.vec3, "turn": wp.vec4, "crowd": wp.vec4}
        kinds |= dict.fromkeys(("stiffness", "damping", "breach"), wp.float32)
        self._drawn = {name: wp.zeros(worlds, dtype=kind, device=self.device) for name, kind in kinds.items()}
        for name, array in self._drawn.items():
            setattr(self, name, wp.to_torch(array))
        shape = (worlds, self.settings.target.strips)
        self.target = Axes(*(wp.zeros(shape, dtype=wp.vec3, device=self.device) for _ in range(2)))
        sim = self._simulator
        own = sim.model.arrays
        self._fields = {name: own[name].entries() for name in ("offset", "turn", "stiffness", "damping")}
        # the stepping adds the springs' implicit share to its own copy; relaxation times far above the step need none
        self._fields["damping in effect"] = sim._damping.entries()
        self._nominal = {name: wp.clone(field) for name, field in self._fields.items()}
        runs = min(_RUNS, self.settings.attempts) if arrays.link_major(self.device) else 1
        self._place = Recorded(self._record)
        self._tried = (
            wp.zeros((worlds, runs), dtype=wp.int32, device=self.device),
            wp.zeros((worlds, runs), dtype=wp.float32, device=self.device),
        )
        self._first = wp.full(worlds, kernels.NO_ATTEMPT, dtype=wp.int32, device=self.device)
        self._same = wp.full(worlds, 1.0, dtype=wp.float32, device=self.device)

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return all that a placing has written, by name, as views: copying back what was copied undoes it."""
        sim = self._simulator
        lines = {"line start": sim.line_start, "line end": sim.line_end, "friction": sim.friction}
        lines |= {"strip start": wp.to_torch(self.target.start), "strip end": wp.to_torch(self.target.end)}
        drawn = {name: getattr(self, name) for name in self._drawn}
        return lines | drawn | {f"model {name}": wp.to_torch(field) for name, field in self._fields.items()}

    def place(self, mask: wp.array, episode: wp.array) -> None:
        """Draw a new place for the masked worlds (bool, [worlds]) of the given episodes (int, [worlds]).

        Writes the trees' roots, the target's axis, springs, dampers and friction; call the simulator's ``reset`` with
        the same mask afterwards.
        """
        self._place(mask, episode)

    def _record(self, mask: wp.array, episode: wp.array) -> list[Any]:
        sim, d = self._simulator, self._drawn
        outputs = [
            d["root"], d["turn"], sim.line.start, sim.line.end, self.target.start, self.target.end,
            d["stiffness"], d["damping"], wp.from_torch(sim.friction), d["breach"], d["crowd"],
        ]  # fmt: skip
        inputs = [mask, episode, self._arrays, self._rules, self._key, *self._tried]
        return [
            self._launch(kernels.try_places, self._tried[0].shape, [*inputs, self._first]),
            self._launch(kernels.place_scene, len(self.breach), [*inputs, *outputs, self._first]),
            self._plant(mask),
            self._scale("stiffness", mask, self._same),
            self._scale("damping", mask, d["damping"]),
            self._scale("damping in effect", mask, d["damping"]),
        ]

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any]) -> Any:
        return recorded(kernel, dim, inputs, self.device)

    def _plant(self, mask: wp.array) -> Any:
        sim, f, n = self._simulator, self._fields, self._nominal
        inputs = [mask, sim._slot_world, sim.model.kernel.parent, self._drawn["root"], self._drawn["turn"]]
        inputs += [n["offset"], n["turn"], f["offset"], f["turn"]]
        return self._launch(kernels.plant_roots, f["turn"].shape[:2], inputs)

    def _scale(self, name: str, mask: wp.array, second: wp.array) -> Any:
        field = self._fields[name]
        inputs = [mask, self._simulator._slot_world, self._drawn["stiffness"], second, self._nominal[name], field]
        return self._launch(kernels.scale_joints, field.shape[:2], inputs)


def _scene_arrays(
    distinct: list[Tree], index: IntArray, arm: Arm, shoulder: Array, settings: SceneSettings, device: Any
) -> Any:  # fmt: skip
    """Return the kernels' constant arrays: branches in their trees' frames, the arm at home."""
    yields, firm = [side_compliance(tree) for tree in distinct], settings.firm
    rows = [(*rest_capsules(tree), c < _PUSH / firm) for tree, c in zip(distinct, yields, strict=True)]
    most = max(len(row[0]) for row in rows)
    out = kernels.SceneArrays()
    for k, name in enumerate(("start", "end")):
        padded = np.stack([np.pad(row[k], ((0, most - len(row[k])), (0, 0))) for row in rows])
        setattr(out, name, wp.array(padded.astype(np.float32), dtype=wp.vec3, device=device))
    soft = [np.flatnonzero(c >= _PUSH / firm if settings.feasible else c > 0.0) for c in yields]
    for tree, free in zip(distinct, soft, strict=True):
        _need(len(free) > 0, "firm", f"{tree.name} with no link that {firm:g} N push aside", "softer or smaller wood")
    out.num_soft = wp.array([len(free) for free in soft], dtype=wp.int32, device=device)
    out.soft = wp.array(np.stack([np.pad(free, (0, most - len(free))) for free in soft]), dtype=wp.int32, device=device)
    for k, name, dtype in ((2, "radius", wp.float32), (3, "firm", wp.int32)):
        padded = np.stack([np.pad(row[k], (0, most - len(row[k]))) for row in rows])
        setattr(out, name, wp.array(padded, dtype=dtype, device=device))
    out.count = wp.array([len(row[0]) for row in rows], dtype=wp.int32, device=device)
    out.fork = wp.array([fork_height(tree) for tree in distinct], dtype=wp.float32, device=device)
    out.tree = wp.array(index, dtype=wp.int32, device=device)
    start, end, radius = home_capsules(arm)
    out.home_start = wp.array(start.astype(np.float32), dtype=wp.vec3, device=device)
    out.home_end = wp.array(end.astype(np.float32), dtype=wp.vec3, device=device)
    out.home_radius = wp.array(radius.astype(np.float32), dtype=wp.float32, device=device)
    out.shoulder = wp.vec3(*shoulder)
    return out


def rest_capsules(tree: Tree) -> tuple[Array, Array, Array]:
    """Axes and greatest radii of a tree's capsules, joints at zero."""
    start, end = shape_ends(tree)
    return start, end, tree.shape_radius.max(axis=1)


def side_compliance(tree: Tree) -> Array:
    """How far a level force of 1 N moves the middle of each capsule in its stiffest direction [m/N], shape [S].

    The joints between it and the ground in series, C = sum_j (|r_j|^2 I - r_j r_j^T) / K_j.
    """
    poses = rest_pose(tree)
    carries = np.zeros((tree.num_links, tree.num_links), bool)  # [i, j]: whether joint j moves link i
    for i, p in enumerate(tree.parent):
        carries[i] = carries[p] if p >= 0 else False
        carries[i, i] = tree.joint[i] != Joint.FIXED
    lever = np.mean(shape_ends(tree, poses), axis=0)[:, None] - poses[0]
    with np.errstate(divide="ignore"):
        soft = np.where(carries[tree.shape_link], 1.0 / tree.stiffness, 0.0)
    total = np.einsum("sl,sli,sli->s", soft, lever, lever)[:, None, None] * np.eye(3)
    total = total - np.einsum("sl,sli,slj->sij", soft, lever, lever)
    least: Array = np.linalg.eigvalsh(total[:, :2, :2])[:, 0]
    return least


def home_capsules(arm: Arm) -> tuple[Array, Array, Array]:
    """Axes [C, 3], [C, 3] and radii [C] of an arm's capsules at home, those of its static base included [m]."""
    start, end = arm_capsules(arm, arm.home)
    return start, end, np.concatenate([arm.base_radius, arm.tree.shape_radius.max(axis=1)])


def facing(arm: Arm) -> float:
    """Direction in which the arm's hand is at home, seen from above [rad]; 0 if it is over the base."""
    end = forward_kinematics(arm, arm.home)[2][0]
    return float(np.arctan2(end[1], end[0])) if np.hypot(end[0], end[1]) > 0.05 else 0.0


def _scene_rules(settings: SceneSettings, arm: Arm) -> Any:
    out = kernels.SceneRules()
    for name in ("distance", "height", "depth", "reach", "pairs", "stiffness", "damping", "friction"):
        setattr(out, name, wp.vec2(*getattr(settings, name)))
    middle, half = facing(arm), np.radians(settings.bearing)
    out.bearing = wp.vec2(middle - half, middle + half)
    out.tilt, out.side = float(np.radians(settings.tilt)), float(np.radians(settings.side))
    for name in ("shift", "near", "gap", "target_gap"):
        setattr(out, name, float(getattr(settings, name)))
    target = settings.target
    out.length, out.clearance, out.width = wp.vec2(*target.length), target.clearance, target.width
    out.strips, out.rounded = target.strips, int(target.rounded)
    out.branches, out.feasible = float(settings.branches), int(settings.feasible)
    out.points, out.attempts = float(settings.points), settings.attempts
    return out
