"""Scenes of reaching: a tree for every world, where it stands, and a target for the hand, drawn on the device.

Trees are grown and culled once a run, one for every world, which keeps it for good. Where a tree stands, how it is
turned, and where the target is, is drawn for chosen worlds in one launch (`kernels.tasks.reach_scene`), from counters
alone. Training and tests never share a seed (`scene.seed_sequence`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
import warp as wp

from ...kernels.tasks import reach_scene as kernels
from ...kernels.tasks import scene as planting
from ..arms.arm import Arm, forward_kinematics
from ..arms.simulator import ArmSimulator
from ..base.errors import InputError
from ..base.thread_pool import recorded
from ..base.types import Array
from ..engine.launcher import Recorded
from ..trees.fractal import grow_fractal
from ..trees.species import grow
from ..trees.stiffness import beam, hold_rest_pose, rudimentary
from ..trees.tree import Joint, Tree
from ..wood.effects import WoodEffects
from ..wood.posterior import Wood
from .scene import (
    Range,
    SceneSettings,
    arm_reach,
    cull_to_reach,
    facing,
    fork_height,
    home_capsules,
    of_wood,
    rest_capsules,
    seed_sequence,
)  # fmt: skip

TARGETS = 60
"""Fixed targets of a test set (thesis, B.3)."""

PATTERNS = (285.0, 300.0, 310.0, 315.0, 320.0)
"""Turns of unseen trees that make the five occlusion patterns [degrees]."""

_LAYOUT = 4  # seed of the fixed targets, the same for every test set


@dataclass(frozen=True)
class ReachScene:
    """Trees, where they stand, and where targets are. The arm's base is the origin, z is up; angles in degrees.

    Attributes:
        forest: Ternary species of the trees, or ``fractal`` for those of chapter 3.
        order: Order of the trees (levels of fractal ones: one more).
        most_links: Links that a tree keeps at most: those nearest to where an arm may be.
        noise: Standard deviation of the trees' parameters, relative (thesis 4.3.3: 0.1).
        scale: Metres per unit of the species' lengths.
        springs: ``rudimentary``, by branching level, or ``beam``, of equation 4.2 with E = 3 GPa.
        joint: Kind of the trees' joints, ``ball`` or ``revolute``.
        upper, lower, decay: Rudimentary springs [N m/rad]: at the trunk's level, least, factor from level to level;
            100 at level 1, halved a level.
        sigma: Standard deviation of their noise in training [N m/rad]; tests have none.
        relaxation: Damping over stiffness of rudimentary springs [s]: a fifth. Beams have a tenth (equation 4.2).
        least_stiffness, least_damping: Of any joint, [N m/rad] and [N m s/rad].
        wood, effects: Of a measured branch instead (`sim.wood`); empty for none.
        strength: Bending stress at which a joint's wood breaks for good [MPa]; 0 is wood that never does. Green wood of
            temperate trees has 30 to 75 (modulus of rupture; Wood Handbook, USDA FPL-GTR-282, table 5-3a).
        distance: Horizontal distance of the trunk from the arm's base [m].
        away: What is added to that distance once trees are culled [m]: 10 leaves targets free.
        bearing: Half-range of the trunk's direction about the way the arm faces at home; 0 in tests.
        height: Height of the trunk's upper end, the first fork, above the arm's base [m].
        reach: Distance of targets from the shoulder [m].
        spread: Half-range of the targets' direction about that of the trunk, seen from above.
        rise: Range of the targets' elevation above the shoulder's level.
        gap: Free space between arm and branches at the start [m].
        free: Free space between a target and all wood [m].
        least_way: Least distance of a target from the hand at home [m].
        attempts: Proposals a place is chosen from.
    """

    forest: Literal["Ta", "Tb", "Tc", "Td", "fractal"] = "Ta"
    order: int = 3
    most_links: int = 40
    noise: float = 0.1
    scale: float = 0.004
    springs: Literal["rudimentary", "beam"] = "rudimentary"
    joint: Literal["ball", "revolute"] = "ball"
    upper: float = 200.0
    lower: float = 2.0
    decay: float = 0.5
    sigma: float = 1.0
    relaxation: float = 0.2
    least_stiffness: float = 2.0
    least_damping: float = 1.0
    wood: Wood = ()
    effects: WoodEffects = ()
    strength: float = 0.0
    distance: Range = (0.35, 0.50)
    away: float = 0.0
    bearing: float = 10.0
    height: Range = (-0.25, 0.0)
    reach: Range = (0.40, 0.80)
    spread: float = 45.0
    rise: Range = (-25.0, 60.0)
    gap: float = 0.02
    free: float = 0.03
    least_way: float = 0.15
    attempts: int = 256

    def check(self, reach: float = np.inf) -> ReachScene:
        """Return self if a scene can be made of it for an arm that reaches ``reach`` metres from its shoulder.

        Raises:
            InputError: A range is empty or out of bounds.
        """
        for name in ("distance", "height", "reach", "rise"):
            low, high = getattr(self, name)
            _need(low <= high, name, f"{low:g} to {high:g}", "a range from low to high")
        for name in ("order", "attempts"):
            _need(getattr(self, name) >= 1, name, str(getattr(self, name)), "1 or more")
        _need(self.most_links >= 2, "most_links", str(self.most_links), "2 or more")
        _need(self.strength >= 0.0, "strength", f"{self.strength:g} MPa", "0 or more")
        _need(self.distance[0] > 0.0, "distance", f"{self.distance[0]:g} m", "above zero")
        _need(self.reach[0] >= 0.0 and self.reach[1] <= reach, "reach", f"{self.reach[1]:g} m from the shoulder",
              f"within the arm's reach of {reach:.3g} m")  # fmt: skip
        _need(self.rise[0] >= -90.0 and self.rise[1] <= 90.0, "rise", f"{self.rise}", "-90 to 90 degrees")
        return self

    @property
    def culling(self) -> SceneSettings:
        """What of it trees are culled by."""
        return SceneSettings(most_links=self.most_links, distance=self.distance, height=self.height,
                             wood=self.wood, effects=self.effects)  # fmt: skip


def _need(ok: bool, place: str, found: str, allowed: str) -> None:
    if not ok:
        raise InputError("scene", place, found, allowed)


def grow_reach_trees(settings: ReachScene, arm: Arm, worlds: int, *, seed: int, domain: str) -> list[Tree]:
    """Grow a tree for every world: trunk fixed, springs that hold the rest pose, culled to what the arm reaches.

    Tree i depends on settings, arm, seed, domain and i alone.

    Raises:
        InputError: The settings (`ReachScene.check`), or a tree out of reach from every side.
    """
    shoulder, reach = arm_reach(arm)
    settings.check(reach)
    words = seed_sequence(seed, domain).generate_state(2, np.uint64)
    seeds = np.random.SeedSequence(int(words[0])).spawn(worlds)
    rng = np.random.default_rng(int(words[1]))
    sigma = settings.sigma if domain == "training" else 0.0
    out = []
    for i, own in enumerate(seeds):
        tree = cull_to_reach(_grown(settings, own, i), settings.culling, float(shoulder[2]), reach)
        out.append(hold_rest_pose(_sprung(tree, settings, sigma, rng)))
    return out


def _grown(s: ReachScene, seed: Any, i: int) -> Tree:
    joint = Joint.SPHERICAL if s.joint == "ball" else Joint.REVOLUTE
    name = f"{s.forest}_{i:04d}"
    if s.forest == "fractal":
        return grow_fractal(s.order + 1, children=3, length=0.8, radius=0.02, noise=s.noise, seed=seed, name=name,
                            joint=joint, fixed_base=True)  # fmt: skip
    return grow(s.forest, s.order, noise=s.noise, seed=seed, scale=s.scale, name=name, joint=joint, fixed_base=True)


def _sprung(tree: Tree, s: ReachScene, sigma: float, rng: np.random.Generator) -> Tree:
    if s.wood:
        return of_wood(tree, s.culling)
    if s.springs == "beam":
        out = beam(tree)
    else:
        out = rudimentary(tree, upper=s.upper, lower=s.lower, decay=s.decay, sigma=sigma, rng=rng)
        out = out.with_(damping=np.where(out.joint == Joint.FIXED, out.damping, s.relaxation * out.stiffness))
    moves = out.joint != Joint.FIXED
    return out.with_(
        stiffness=np.where(moves, np.maximum(out.stiffness, s.least_stiffness), out.stiffness),
        damping=np.where(moves, np.maximum(out.damping, s.least_damping), out.damping),
    )


def joint_strength(tree: Tree, strength: float) -> Array:
    """Return the moment that breaks each joint of a tree [N m], [L]: M = s pi r^3 / 4 of a round section.

    Args:
        tree: The tree; r is the radius at the start of a joint's link, and links without a shape never break.
        strength: Bending stress s that the wood bears [MPa].
    """
    radius = np.full(tree.num_links, np.inf)
    for link, (start, _) in zip(tree.shape_link[::-1], tree.shape_radius[::-1], strict=True):
        radius[link] = start
    return 1.0e6 * strength * np.pi * radius**3 / 4.0


def fixed_targets(settings: ReachScene, arm: Arm) -> Array:
    """Return the targets of tests in the arm's base frame [m], [`TARGETS`, 3]: always the same for a scene.

    They fill the part of the shell that training draws from, by a Halton sequence of three primes.
    """
    shoulder, _ = arm_reach(arm)
    u = np.stack([_radical_inverse(np.arange(_LAYOUT, _LAYOUT + TARGETS), base) for base in (2, 3, 5)])
    low, high = settings.reach
    far = np.cbrt(low**3 + (high**3 - low**3) * u[0])
    side = facing(arm) + np.radians(settings.spread) * (2.0 * u[1] - 1.0)
    up_low, up_high = np.sin(np.radians(settings.rise))
    up = up_low + (up_high - up_low) * u[2]
    level = np.sqrt(1.0 - up**2)
    out: Array = shoulder + far[:, None] * np.stack([level * np.cos(side), level * np.sin(side), up], axis=1)
    return out


def _radical_inverse(numbers: np.ndarray, base: int) -> Array:
    out, share, left = np.zeros(len(numbers)), 1.0 / base, numbers.copy()
    while left.any():
        out, left, share = out + share * (left % base), left // base, share / base
    return out


class ReachPlaces:
    """Places trees and targets of a simulator's worlds.

    Attributes:
        root, turn: Foot of each world's trunk [m] and its turn as w, x, y, z, torch views [worlds, 3] and [worlds, 4].
        target: Where the hand is to go [m], [worlds, 3].
        breach: How far each world's place breaks a rule [m], 0 where it breaks none, [worlds].
        pattern: Number of each world's occlusion pattern (`PATTERNS`) in tests, int64 [worlds], -1 in training.
    """

    def __init__(
        self, simulator: ArmSimulator, trees: list[Tree], settings: ReachScene, *, seed: int, domain: str,
        first: int = 0,
    ) -> None:  # fmt: skip
        """Allocate everything; place nothing yet.

        In tests world w has pattern w mod 5 and target (w / 5) mod 60.

        Args:
            simulator: Worlds made of the trees.
            trees: What `grow_reach_trees` returned.
            settings: The ranges.
            seed: Seed of all places.
            domain: ``training`` or ``test``.
            first: Number of the first world in its test set.
        """
        self._first = first
        self.settings, self._simulator, self.device = settings, simulator, simulator.model.device
        words = seed_sequence(seed, domain).generate_state(4)[2:]
        self._key = wp.vec2ui(int(words[0]), int(words[1]))
        kinds: dict[str, Any] = {"root": wp.vec3, "turn": wp.vec4, "target": wp.vec3, "breach": wp.float32}
        self._drawn = {name: wp.zeros(len(trees), dtype=kind, device=self.device) for name, kind in kinds.items()}
        for name, array in self._drawn.items():
            setattr(self, name, wp.to_torch(array))
        arrays = simulator.model.arrays
        self._fields = {name: arrays[name].entries() for name in ("offset", "turn")}
        self._nominal = {name: wp.clone(field) for name, field in self._fields.items()}
        self._forest = self._constants(trees, domain == "test")
        self._ranges = self._rules(domain == "test")
        self._place = Recorded(self._record)

    root: torch.Tensor
    turn: torch.Tensor
    target: torch.Tensor
    breach: torch.Tensor
    pattern: torch.Tensor

    @property
    def target_array(self) -> wp.array:
        """The targets as the kernels' memory, vec3 [worlds]."""
        return self._drawn["target"]

    def _constants(self, trees: list[Tree], test: bool) -> Any:
        out, arm, worlds = kernels.Forest(), self._simulator.arm, len(trees)
        rows = [rest_capsules(tree) for tree in trees]
        most = max(len(row[0]) for row in rows)
        for k, name in enumerate(("start", "end")):
            padded = np.zeros((worlds, most, 3), np.float32)
            for w, row in enumerate(rows):
                padded[w, : len(row[k])] = row[k]
            setattr(out, name, wp.array(padded, dtype=wp.vec3, device=self.device))
        radius = np.zeros((worlds, most), np.float32)
        for w, row in enumerate(rows):
            radius[w, : len(row[2])] = row[2]
        out.radius = wp.array(radius, dtype=wp.float32, device=self.device)
        out.count = wp.array([len(row[0]) for row in rows], dtype=wp.int32, device=self.device)
        out.fork = wp.array([fork_height(tree) for tree in trees], dtype=wp.float32, device=self.device)
        out.tree = wp.array(np.arange(worlds), dtype=wp.int32, device=self.device)
        start, end, thick = home_capsules(arm)
        used = thick > 0.0
        out.home_start = wp.array(start[used].astype(np.float32), dtype=wp.vec3, device=self.device)
        out.home_end = wp.array(end[used].astype(np.float32), dtype=wp.vec3, device=self.device)
        out.home_radius = wp.array(thick[used].astype(np.float32), dtype=wp.float32, device=self.device)
        out.hand, out.shoulder = wp.vec3(*forward_kinematics(arm, arm.home)[2][0]), wp.vec3(*arm_reach(arm)[0])
        self._fix(out, worlds, test)
        return out

    def _fix(self, out: Any, worlds: int, test: bool) -> None:
        """Write what is not drawn: turns and targets of tests."""
        number = self._first + np.arange(worlds)
        pattern = number % len(PATTERNS) if test else np.full(worlds, -1)
        self.pattern = torch.as_tensor(pattern, device=wp.device_to_torch(self.device))
        turn = np.radians(np.array(PATTERNS))[pattern] if test else np.full(worlds, -1.0)
        targets = fixed_targets(self.settings, self._simulator.arm)[number // len(PATTERNS) % TARGETS]
        out.turn = wp.array(turn.astype(np.float32), dtype=wp.float32, device=self.device)
        out.fixed = wp.array(targets.astype(np.float32), dtype=wp.vec3, device=self.device)
        out.is_fixed = int(test)

    def _rules(self, test: bool) -> Any:
        s, out = self.settings, kernels.Ranges()
        for name in ("height", "reach"):
            setattr(out, name, wp.vec2(*getattr(s, name)))
        out.distance = wp.vec2(s.distance[0] + s.away, s.distance[1] + s.away)
        half = 0.0 if test else np.radians(s.bearing)
        middle = facing(self._simulator.arm)
        out.bearing, out.rise = wp.vec2(middle - half, middle + half), wp.vec2(*np.radians(s.rise))
        out.spread, out.gap, out.free, out.least = float(np.radians(s.spread)), s.gap, s.free, s.least_way
        out.attempts = s.attempts
        return out

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return all that a placing has written, by name, as views: copying back what was copied undoes it."""
        drawn = {name: getattr(self, name) for name in self._drawn}
        return drawn | {f"model {name}": wp.to_torch(field) for name, field in self._fields.items()}

    def place(self, mask: wp.array, episode: wp.array) -> None:
        """Draw a new place for the masked worlds (bool, [worlds]) of the given episodes (int, [worlds]).

        Writes the trees' roots and the targets; call the simulator's ``reset`` with the same mask afterwards.
        """
        self._place(mask, episode)

    def _record(self, mask: wp.array, episode: wp.array) -> list[Any]:
        sim, d, f, n = self._simulator, self._drawn, self._fields, self._nominal
        inputs = [mask, episode, self._forest, self._ranges, self._key, d["root"], d["turn"], d["target"], d["breach"]]
        plant = [mask, sim._slot_world, sim.model.kernel.parent, d["root"], d["turn"], n["offset"], n["turn"],
                 f["offset"], f["turn"]]  # fmt: skip
        return [
            recorded(kernels.place_reach, len(self.breach), inputs, self.device),
            recorded(planting.plant_roots, f["turn"].shape[:2], plant, self.device),
        ]
