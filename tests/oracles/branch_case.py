"""Make a measured branch with C MuJoCo, finer than any model that will be fitted to it.

Each segment of a random 3D branch turns on a ball joint at its lower end and is itself cut into sub-links on stiff ball
joints, so that the wood bends a little. Springs are wound up so that the given pose is the equilibrium under gravity.
Writes a ``branch-gap-case/1`` folder and, outside it, the truth as JSON. Nothing of bough is imported.

    python tests/oracles/branch_case.py OUT --seed 1 --segments 3 --noise 0.03
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import yaml
from mujoco import rollout

HEADER = "t_s,fx_N,fy_N,fz_N,x_m,y_m,z_m,vx_mps,vy_mps,vz_mps"
PROFILES = ("ramp_hold_return", "pull_release", "triangle_bothways", "sweep", "steps", "pull_release")
QUIET = 0.25


@dataclass
class Branch:
    """Geometry and springs of R segments, base first; SI units, angles in degrees."""

    length: list[float]
    radius_base: list[float]
    radius_tip: list[float]
    elevation: list[float]
    azimuth: list[float]
    stiffness: list[float]
    damping: list[float]
    density: float
    grasp_distance: float
    gravity: float = 9.81
    names: list[str] = field(default_factory=list)

    def axes(self) -> np.ndarray:
        """Return the unit axes of the segments in the rest pose, shape [R, 3]."""
        el, az = np.radians(self.elevation), np.radians(self.azimuth)
        return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=1)

    def joints(self) -> np.ndarray:
        """Lower ends of the segments in the rest pose, base at the origin [m], shape [R, 3]."""
        steps = self.axes() * np.array(self.length)[:, None]
        return np.cumsum(steps, axis=0) - steps

    def grasp(self) -> np.ndarray:
        """Grasp point in the rest pose [m], shape [3]; it lies on the last segment."""
        return self.joints()[-1] + self.axes()[-1] * self.grasp_distance

    def mass(self) -> np.ndarray:
        """Masses of the frusta [kg], shape [R]."""
        return frustum_mass(np.array(self.length), self.radius_base, self.radius_tip, self.density)


def frustum_mass(length, a, b, density):
    """Mass of a solid frustum [kg]."""
    a, b = np.asarray(a), np.asarray(b)
    return density * np.pi * length * (a * a + a * b + b * b) / 3


def random_branch(rng: np.random.Generator, segments: int = 3, gravity: float = 9.81) -> Branch:
    """Draw a branch in the range of the practice cases: sizes and springs fall from segment to segment."""
    shrink = np.arange(segments)
    length = rng.uniform(0.52, 0.66) * rng.uniform(0.7, 0.85) ** shrink * rng.uniform(0.95, 1.05, segments)
    base = rng.uniform(0.0165, 0.0195) * rng.uniform(0.68, 0.76) ** shrink
    stiffness = rng.uniform(60, 130) * rng.uniform(0.32, 0.48) ** shrink * rng.uniform(0.9, 1.1, segments)
    axes = [_unit([np.cos(a := np.radians(rng.uniform(15, 45))), 0.0, np.sin(a)])]
    for _ in shrink[1:]:
        axes.append(_forked(axes[-1], np.radians(rng.uniform(17, 47)), rng))
    axes = np.array(axes)
    names = ["grandparent", "parent", "child"]
    return Branch(
        length=length.tolist(),
        radius_base=base.tolist(),
        radius_tip=(base * rng.uniform(0.85, 1.0, segments)).tolist(),
        elevation=np.degrees(np.arcsin(axes[:, 2])).tolist(),
        azimuth=np.degrees(np.arctan2(axes[:, 1], axes[:, 0])).tolist(),
        stiffness=stiffness.tolist(),
        damping=(stiffness / rng.uniform(50, 100, segments)).tolist(),
        density=float(rng.uniform(750, 920)),
        grasp_distance=float(length[-1] * rng.uniform(0.75, 0.92)),
        gravity=gravity,
        names=names[3 - segments :] if segments <= 3 else [f"segment_{i + 1}" for i in range(segments)],
    )


def _unit(v):
    return np.asarray(v) / np.linalg.norm(v)


def _forked(axis, angle, rng):
    """Turn an axis by ``angle`` towards a random side; draw again until it neither dives nor stands on end."""
    while True:
        side = _unit(np.cross(axis, rng.normal(size=3)))
        new = np.cos(angle) * axis + np.sin(angle) * side
        if 0.0 < new[2] < 0.9 and new[0] > 0.2:
            return _unit(new)


def build(branch: Branch, *, sub: int = 3, wood: float = 0.08, dt: float = 2.5e-4):
    """Compile a branch: (model, data at rest).

    Args:
        branch: What to build.
        sub: Sub-links per segment.
        wood: Bend of the stiff joints inside a segment, as a fraction of its own joint's for the same torque. The
            practice cases look like 0.08: the grasp point then moves 3 to 4 % further than on rigid segments.
        dt: Step [s].
    """
    model = mujoco.MjModel.from_xml_string(_mjcf(branch, sub, dt))
    count = sub * len(branch.length)
    stiff, damp = np.repeat([branch.stiffness, branch.damping], sub, axis=1)
    inside = np.arange(count) % sub > 0
    factor = np.where(inside, (sub - 1) / wood, 1.0)
    model.jnt_stiffness[:] = stiff * factor
    model.dof_damping[:] = np.repeat(damp * factor, 3)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # The spring's torque is stiffness * log(spring pose) at joint zero; it must carry the load.
    wind = data.qfrc_bias.reshape(count, 3) / (stiff * factor)[:, None]
    for i, turn in enumerate(wind):
        angle = np.linalg.norm(turn)
        axis = turn / angle if angle > 0 else np.array([1.0, 0.0, 0.0])
        mujoco.mju_axisAngle2Quat(model.qpos_spring[4 * i : 4 * i + 4], axis, angle)
    mujoco.mj_forward(model, data)
    return model, data


def _mjcf(branch: Branch, sub: int, dt: float) -> str:
    """Nested bodies in world orientation: at joint zero every frame is parallel to the world's."""
    axes = branch.axes()
    body, close, offset = "", "", np.zeros(3)
    for i, axis in enumerate(axes):
        step = branch.length[i] / sub
        radii = np.linspace(branch.radius_base[i], branch.radius_tip[i], sub + 1)
        for j in range(sub):
            mass = frustum_mass(step, radii[j], radii[j + 1], branch.density)
            end = _text(axis * step)
            body += (
                f'<body pos="{_text(offset)}"><joint type="ball"/><geom type="cylinder" fromto="0 0 0 {end}" '
                f'size="{(radii[j] + radii[j + 1]) / 2:.17g}" mass="{mass:.17g}" contype="0" conaffinity="0"/>'
            )
            last = i == len(axes) - 1
            along = branch.grasp_distance - j * step
            if last and (0 <= along < step or (j == sub - 1 and along >= 0)):
                body += f'<site name="grasp" pos="{_text(axis * along)}"/>'
            close, offset = close + "</body>", axis * step
    motors = "".join(
        f'<general site="grasp" refsite="world" gear="{gear} 0 0 0"/>' for gear in ("1 0 0", "0 1 0", "0 0 1")
    )
    return f"""<mujoco><option timestep="{dt!r}" gravity="0 0 {-branch.gravity!r}" integrator="implicitfast"/>
<worldbody><site name="world"/>{body}{close}</worldbody><actuator>{motors}</actuator>
<sensor><framepos objtype="site" objname="grasp"/><framelinvel objtype="site" objname="grasp"/></sensor></mujoco>"""


def _text(v) -> str:
    return " ".join(f"{x:.17g}" for x in v)


def simulate(branch: Branch, forces, rate: float, **options):
    """Drive the grasp point from rest.

    Args:
        branch: The branch.
        forces: World forces at the samples [N], linear between them, shape [N, T, 3].
        rate: Sampling rate [Hz].
        **options: Passed to `build`.

    Returns:
        Displacement [m] and velocity [m/s] of the grasp point at the samples, each of shape [N, T, 3].
    """
    model, data = build(branch, **options)
    forces = np.asarray(forces, dtype=float)
    steps = round(1 / (rate * model.opt.timestep))
    model.opt.timestep = 1 / (rate * steps)
    samples = forces.shape[1]
    # Force in the middle of each step; one more step so that the sensors see the last sample.
    middle = (np.arange((samples - 1) * steps + 1) + 0.5) / steps
    low = np.minimum(middle.astype(int), samples - 2)
    part = np.minimum(middle - low, 1.0)[None, :, None]
    control = (1 - part) * forces[:, low] + part * forces[:, low + 1]
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, state, spec)
    origin = data.sensordata[:3].copy()
    _, sensors = rollout.rollout(model, data, np.tile(state, (len(forces), 1)), control)
    sampled = sensors[:, ::steps]
    return sampled[..., :3] - origin, sampled[..., 3:]


def shape(profile: str, t: np.ndarray, duration: float, rng: np.random.Generator) -> np.ndarray:
    """Force history of a profile with peak one (sweep: 0.3), zero until ``QUIET`` and at the end, shape [T]."""
    x = t - QUIET
    span = duration - 2 * QUIET
    if profile == "ramp_hold_return":
        back = duration * rng.uniform(0.55, 0.62)
        return np.interp(x, [0, 0.25 * duration, back, back + 0.15 * duration], [0, 1, 1, 0])
    if profile == "pull_release":
        off = duration * rng.uniform(0.28, 0.36)
        return np.where(x < off, np.interp(x, [0, 0.18 * duration], [0, 1]), 0.0)
    if profile == "triangle_bothways":
        return np.interp(x / span, [0, 0.25, 0.75, 1], [0, 1, -1, 0])
    if profile == "sweep":
        u = np.clip(x / span, 0, 1)
        taper = np.minimum(1, 8 * np.minimum(u, 1 - u))
        return 0.3 * taper * np.sin(2 * np.pi * span * (0.4 * u + 1.2 * u * u))
    knots = [0.18, 0.22, 0.38, 0.42, 0.58, 0.65, 0.77, 0.88, 0.96, 1.0]
    return np.interp(x / (0.88 * duration - QUIET), knots, [0, 0.35, 0.35, 0.7, 0.7, 1, 1, -0.4, -0.4, 0])


def peak_force(branch: Branch, direction: np.ndarray, reach: float) -> float:
    """Force [N] along ``direction`` that the linear springs answer with a grasp displacement of ``reach`` [m]."""
    lever = np.cross(branch.grasp() - branch.joints(), direction)
    moved = (np.cross(lever / np.array(branch.stiffness)[:, None], branch.grasp() - branch.joints())).sum(axis=0)
    return float(reach / np.linalg.norm(moved))


def _directions(branch: Branch, rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Directions mostly across the branch; the second is the first reversed."""
    chord = _unit(branch.grasp())
    out = []
    while len(out) < count:
        v = rng.normal(size=3)
        out.append(_unit(v - 0.8 * (v @ chord) * chord))
    out[1] = -out[0]
    return out


def make_branch_case(
    folder: str | Path,
    seed: int,
    *,
    segments: int = 3,
    noise: float = 0.03,
    sub: int = 3,
    wood: float = 0.08,
    dt: float = 2.5e-4,
    rate: float | None = None,
    samples: int = 110,
    reach: float = 0.22,
) -> dict:
    """Write a case folder and ``<folder>_answer.json`` beside it; return what the JSON holds.

    Args:
        folder: Case folder to write.
        seed: Seed of everything random.
        segments: Number of segments R.
        noise: Noise on displacement and velocity as a fraction of their RMS over the case; force has half of it.
        sub: Sub-links per segment.
        wood: See `build`.
        dt: Largest step [s].
        rate: Sampling rate [Hz]; drawn from 20, 25, 40 if None.
        samples: Samples per trajectory.
        reach: Peak displacement aimed at, as a fraction of the branch's length.
    """
    rng = np.random.default_rng(seed)
    branch = random_branch(rng, segments)
    rate = rate or float(rng.choice([20.0, 25.0, 40.0]))
    t = np.arange(samples) / rate
    recordings = _plan(branch, rng, t, reach * sum(branch.length))
    forces = np.stack([r.pop("force") for r in recordings])
    forces, moved, velocity = _within_reach(branch, forces, rate, sub=sub, wood=wood, dt=dt)
    rms = [float(np.sqrt(np.mean(np.sum(c**2, axis=-1)) / 3)) for c in (forces, moved, velocity)]
    sigma = [noise / 2 * rms[0], noise * rms[1], noise * rms[2]]
    channels = [c + s * rng.normal(size=c.shape) for c, s in zip((forces, moved, velocity), sigma, strict=True)]
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    for item, table in zip(recordings, np.concatenate(channels, axis=-1), strict=True):
        rows = np.column_stack([t, table])
        np.savetxt(path / item["file"], rows, fmt="%.7g", delimiter=",", header=HEADER, comments="")
    # Through JSON, so that replicates do not become YAML aliases.
    meta = json.loads(json.dumps(_meta(branch, rate, samples, noise, recordings)))
    (path / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False))
    answer = {
        "seed": seed, "K": branch.stiffness, "D": branch.damping, "wood": wood, "sub_links": sub, "noise": noise,
        "sigma_force_N": sigma[0], "sigma_displacement_m": sigma[1], "sigma_velocity_mps": sigma[2],
        "peak_displacement_m": float(np.linalg.norm(moved, axis=-1).max()), "branch": asdict(branch),
    }  # fmt: skip
    path.with_name(path.name + "_answer.json").write_text(json.dumps(answer, indent=1))
    return answer


def _within_reach(branch: Branch, forces: np.ndarray, rate: float, **options):
    """Simulate, weakening every force history that moves the grasp point by more than a third of the branch."""
    most = sum(branch.length) / 3
    for _ in range(6):
        moved, velocity = simulate(branch, forces, rate, **options)
        peak = np.linalg.norm(moved, axis=-1).max(axis=1)
        if not np.isfinite(peak).all():
            raise RuntimeError("the branch left the finite")
        if (peak <= most).all():
            break
        forces = forces * np.minimum(1.0, 0.95 * most / peak)[:, None, None]
    return forces, moved, velocity


def _plan(branch: Branch, rng: np.random.Generator, t: np.ndarray, reach: float) -> list[dict]:
    """Six probes and replicates of the first two, each with its true force [T, 3]."""
    duration, clock, out = float(t[-1]), float(rng.uniform(0, 3)), []
    for profile, direction in zip(PROFILES, _directions(branch, rng, len(PROFILES)), strict=True):
        history = shape(profile, t, duration, rng)
        force = peak_force(branch, direction, reach * rng.uniform(0.85, 1.1)) * history[:, None] * direction
        # Linear between samples: zero only from the first sample at zero on.
        last = int(np.flatnonzero(np.abs(history) > 1e-12).max())
        spans = [[0.0, QUIET], [float(t[last + 1]), duration]] if last + 1 < len(t) else [[0.0, QUIET]]
        out.append({"profile": profile, "direction": direction.round(6).tolist(), "replicate_of": None,
                    "no_contact": spans, "force": force})  # fmt: skip
    out += [{**out[i], "replicate_of": i + 1} for i in range(2)]
    for i, item in enumerate(out):
        item.update(file=f"traj_{i + 1:02d}.csv", t_start_s=round(clock, 3))
        clock += duration + float(rng.uniform(18, 24))
    return out


def _meta(branch: Branch, rate: float, samples: int, noise: float, recordings: list[dict]) -> dict:
    axes = branch.axes()
    forks = np.degrees(np.arccos(np.clip((axes[1:] * axes[:-1]).sum(axis=1), -1, 1)))
    columns = zip(
        branch.names, branch.length, branch.radius_base, branch.radius_tip, branch.elevation, branch.azimuth,
        branch.mass().tolist(), strict=True,
    )  # fmt: skip
    keys = ("name", "length_m", "radius_base_m", "radius_tip_m", "elevation_deg", "azimuth_deg", "mass_kg")
    rounded = [[v if isinstance(v, str) else round(v, 6) for v in row] for row in columns]
    order = ("file", "profile", "direction", "t_start_s", "replicate_of", "no_contact")
    return {
        "format": "branch-gap-case/1", "sample_rate_hz": rate, "n_samples": samples, "gravity_mps2": branch.gravity,
        "planar": False, "density_kgpm3": round(branch.density, 4), "base_position_m": [0.0, 0.0, 0.0],
        "trunk_pivot_below_base_m": 1.0, "segments": [dict(zip(keys, row, strict=True)) for row in rounded],
        "fork_angles_deg": forks.round(4).tolist(),
        "grasp": {"segment": branch.names[-1], "distance_from_lower_end_m": round(branch.grasp_distance, 6)},
        "noise_nominal": noise or None, "trajectories": [{k: r[k] for k in order} for r in recordings],
        "conventions": "z up, world frame; rest pose = equilibrium under gravity",
    }  # fmt: skip


def main() -> None:
    """Write one case from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="case folder to write")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--segments", type=int, default=3)
    parser.add_argument("--noise", type=float, default=0.03, help="fraction of channel RMS")
    options = parser.parse_args()
    answer = make_branch_case(options.out, options.seed, segments=options.segments, noise=options.noise)
    print(f"{options.out}: {len(answer['K'])} segments, peak displacement {answer['peak_displacement_m']:.2f} m")


if __name__ == "__main__":
    main()
