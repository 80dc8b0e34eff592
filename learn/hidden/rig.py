"""A branch compiled for MuJoCo, with a finer discretisation than the fitted models.

Each segment turns on a ball joint at its lower end and is itself cut into sub-links on stiff ball joints, so that the
wood bends a little. Springs are wound up so that the given pose is the equilibrium under gravity.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .branch import TRUNK_PIVOT, Array, Branch, frustum_mass, unit


def engine() -> tuple[ModuleType, ModuleType]:
    """Return the modules ``mujoco`` and ``mujoco.rollout``, which are slow to import."""
    import mujoco
    from mujoco import rollout

    return mujoco, rollout


@dataclass(frozen=True)
class Trunk:
    """A post on a ball joint `TRUNK_PIVOT` below the base: its spring [N m/rad], damper [N m s/rad] and mass [kg]."""

    stiffness: float
    damping: float
    mass: float


@dataclass(frozen=True)
class Rig:
    """A compiled branch at rest.

    Attributes:
        branch: What was compiled.
        model: MjModel.
        data: MjData at rest; ``qpos`` of the joints are quaternions from the rest pose.
        joints: Number of the MuJoCo joint at each segment's lower end, shape [R].
        frames: Frame of each segment in its rest pose as rows, two across it and one along it, shape [R, 3, 3]; at
            joint zero all body frames are parallel to the world's.
    """

    branch: Branch
    model: Any
    data: Any
    joints: NDArray[np.int64]
    frames: Array

    @property
    def held(self) -> int:
        """Return the number of the body that carries the grasp point."""
        return int(self.model.site("grasp").bodyid[0])


def build(
    branch: Branch,
    *,
    sub: int = 3,
    wood: float = 0.08,
    dt: float = 2.5e-4,
    trunk: Trunk | None = None,
    tip_mass: float = 0.0,
) -> tuple[Any, Any]:
    """Compile a branch: (MjModel, MjData at rest).

    Args:
        branch: What to build.
        sub: Sub-links per segment.
        wood: Bend of the stiff joints inside a segment, as a fraction of its own joint's for the same torque; zero
            welds them. The practice cases look like 0.08: the grasp point then moves 3 to 4 % further than on rigid
            segments.
        dt: Step [s].
        trunk: A trunk that gives way, if the base is not fixed.
        tip_mass: Mass of a small ball at the upper end of the last segment [kg].
    """
    mujoco, _ = engine()
    model = mujoco.MjModel.from_xml_string(_mjcf(branch, sub if wood else -sub, dt, trunk, tip_mass))
    stiff, damp = _springs(branch, sub if wood else 1, wood, trunk)
    model.jnt_stiffness[:] = stiff
    model.dof_damping[:] = np.repeat(damp, 3)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # The spring's torque is stiffness * log(spring pose) at joint zero; it must carry the load.
    wind = data.qfrc_bias.reshape(len(stiff), 3) / stiff[:, None]
    for i, turn in enumerate(wind):
        angle = np.linalg.norm(turn)
        axis = turn / angle if angle > 0 else np.array([1.0, 0.0, 0.0])
        mujoco.mju_axisAngle2Quat(model.qpos_spring[4 * i : 4 * i + 4], axis, angle)
    mujoco.mj_forward(model, data)
    return model, data


def _springs(branch: Branch, sub: int, wood: float, trunk: Trunk | None) -> tuple[Array, Array]:
    """Springs and dampers of all ball joints, the trunk's first."""
    stiff, damp = np.repeat([branch.stiffness, branch.damping], sub, axis=1)
    inside = np.arange(sub * len(branch.length)) % sub > 0
    factor = np.where(inside, (sub - 1) / wood if wood else 1.0, 1.0)
    stiff, damp = stiff * factor, damp * factor
    if trunk:
        stiff, damp = np.r_[trunk.stiffness, stiff], np.r_[trunk.damping, damp]
    return stiff, damp


def rig(branch: Branch, *, sub: int = 3, wood: float = 0.08, trunk: Trunk | None = None, **options: float) -> Rig:
    """Compile a branch and note where its segments' joints are; options are those of `build`."""
    model, data = build(branch, sub=sub, wood=wood, trunk=trunk, **options)
    joints = np.arange(len(branch.length), dtype=np.int64) * (sub if wood else 1) + (trunk is not None)
    return Rig(branch, model, data, joints, np.array([_frame(axis) for axis in branch.axes()]))


def _frame(axis: Array) -> Array:
    """Rows: a horizontal axis across the segment, the one across both, the segment's own."""
    side = unit(np.cross([0.0, 0.0, 1.0], axis)) if abs(axis[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    return np.array([side, np.cross(axis, side), axis])


def _mjcf(branch: Branch, sub: int, dt: float, trunk: Trunk | None, tip_mass: float) -> str:
    """Nested bodies in world orientation: at joint zero every frame is parallel to the world's."""
    base = _post(trunk) if trunk else ""
    body, close, offset = base, "</body>" if base else "", np.array([0.0, 0.0, TRUNK_PIVOT if base else 0.0])
    for i, axis in enumerate(branch.axes()):
        links, offset = _segment(branch, i, axis, offset, sub, i == len(branch.length) - 1)
        body, close = body + links, close + "</body>" * abs(sub)
    if tip_mass > 0:
        body += f'<body pos="{_text(offset)}"><geom type="sphere" size="0.004" mass="{tip_mass:.17g}" {_FREE}/></body>'
    motors = "".join(
        f'<general site="grasp" refsite="world" gear="{gear} 0 0 0"/>' for gear in ("1 0 0", "0 1 0", "0 0 1")
    )
    site = 'objtype="site" objname="grasp"/>'
    return f"""<mujoco><option timestep="{dt!r}" gravity="0 0 {-branch.gravity!r}" integrator="implicitfast"/>
<worldbody><site name="world"/>{body}{close}</worldbody><actuator>{motors}</actuator>
<sensor><framepos {site}<framelinvel {site}<framequat {site}</sensor></mujoco>"""


#: Nothing collides.
_FREE = 'contype="0" conaffinity="0"'


def _post(trunk: Trunk) -> str:
    radius = 0.03
    return (
        f'<body pos="0 0 {-TRUNK_PIVOT!r}"><joint type="ball"/><geom type="cylinder" '
        f'fromto="0 0 0 0 0 {TRUNK_PIVOT!r}" size="{radius!r}" mass="{trunk.mass:.17g}" {_FREE}/>'
    )


def _segment(branch: Branch, i: int, axis: Array, offset: Array, sub: int, last: bool) -> tuple[str, Array]:
    """Open the bodies of one segment, welded together if ``sub`` is negative; the offset of what follows."""
    count, text = abs(sub), ""
    step = branch.length[i] / count
    radii = np.linspace(branch.radius_base[i], branch.radius_tip[i], count + 1)
    holds = min(int(branch.grasp_distance / step), count - 1) if last else -1
    for j in range(count):
        mass = frustum_mass(step, radii[j], radii[j + 1], branch.density)
        joint = '<joint type="ball"/>' if j == 0 or sub > 0 else ""
        text += (
            f'<body pos="{_text(offset)}">{joint}<geom type="cylinder" fromto="0 0 0 {_text(axis * step)}" '
            f'size="{(radii[j] + radii[j + 1]) / 2:.17g}" mass="{mass:.17g}" {_FREE}/>'
        )
        if j == holds:
            text += f'<site name="grasp" pos="{_text(axis * (branch.grasp_distance - j * step))}"/>'
        offset = axis * step
    return text, offset


def _text(v: Array) -> str:
    return " ".join(f"{x:.17g}" for x in v)
