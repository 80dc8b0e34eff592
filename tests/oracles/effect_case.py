"""Small cases on which one effect shows by itself, and worlds in which all effects are compiled but few are on."""

from pathlib import Path

import numpy as np
import torch
import yaml
from bough.learn.cases.case import load_case
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.sim.effects import effects
from oracles.mujoco_tree import held_torque
from scipy.optimize import root
from scipy.spatial.transform import Rotation

#: Spring [N m/rad] and damper [N m s/rad] of a stick, and a force that bends it [N].
KS, DS = 20.0, 0.4
FORCE = np.array([2.0, -3.0, 1.5])


def swing_case(folder: Path, starts, *, torque=None, inertia=2.0, dt=0.01, duration=3.0):
    """Write and load a case of one hinge with unknown spring and damper, a run for each start angle and rate.

    ``torque`` is a function of time [s], the same in all runs; the runs start at the given angle and rate whatever
    they do then, and run k at 10 k seconds on the absolute clock.
    """
    folder.mkdir(parents=True, exist_ok=True)
    t = np.arange(round(duration / dt) + 1) * dt
    effort = np.zeros_like(t) if torque is None else torque(t)
    for k, (q0, v0) in enumerate(starts):
        rows = [f"{a:.6f},{b:.9f},{q0 + v0 * a:.9f},{v0:.9f}" for a, b in zip(t, effort, strict=True)]
        (folder / f"run_{k}.csv").write_text("\n".join(["time_s,torque,angle,rate", *rows]) + "\n")
    joint = {"name": "hinge", "type": "revolute", "inertia": inertia, "stiffness": None, "damping": None}
    outputs = [{"joint": "hinge", "quantity": q, "column": c, "scale": 1.0}
               for q, c in (("position", "angle"), ("velocity", "rate"))]  # fmt: skip
    runs = [{"file": f"run_{k}.csv", "t_start_s": 10.0 * k, "replicate_of": None} for k in range(len(starts))]
    given = None if torque is None else {"joint": "hinge", "column": "torque", "scale": 1.0, "hold": "linear"}
    meta = {"format": "joint-gap-case/1", "name": "swing", "mechanism": {"joints": [joint]}, "input": given,
            "outputs": outputs, "trajectories": runs, "noise_nominal": None}  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return load_case(folder)


def stick_case(folder: Path, forces, *, gravity=9.81, dt=0.02, elevation=35.0, azimuth=20.0, opened=(), starts=None):
    """Write and load a branch of one segment, 0.5 m long, held at 0.4 m; ``forces`` are arrays [T, 3], one a run.

    ``opened`` lists intervals [s] without contact, the same in all runs; ``starts`` absolute times, 20 s apart if None.
    """
    folder.mkdir(parents=True, exist_ok=True)
    header = "t_s,fx_N,fy_N,fz_N,x_m,y_m,z_m,vx_mps,vy_mps,vz_mps"
    items = []
    for k, force in enumerate(forces):
        rows = np.column_stack([np.arange(len(force)) * dt, force, np.zeros((len(force), 6))])
        rows[:, 4] = 1e-3 * np.sin(rows[:, 0])  # something to scale priors by
        text = "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows)
        (folder / f"run_{k}.csv").write_text(f"{header}\n{text}\n")
        begin = 20.0 * k if starts is None else starts[k]
        items.append({"file": f"run_{k}.csv", "profile": "any", "t_start_s": begin, "no_contact": [*map(list, opened)]})
    a, b, density = 0.012, 0.010, 800.0
    mass = float(density * np.pi * 0.5 * (a * a + a * b + b * b) / 3)
    segment = {"name": "stick", "length_m": 0.5, "radius_base_m": a, "radius_tip_m": b, "elevation_deg": elevation,
               "azimuth_deg": azimuth, "mass_kg": mass}  # fmt: skip
    meta = {"format": "branch-gap-case/1", "sample_rate_hz": 1.0 / dt, "n_samples": len(forces[0]),
            "gravity_mps2": gravity, "planar": False, "density_kgpm3": density, "base_position_m": [0.0, 0.0, 1.0],
            "trunk_pivot_below_base_m": 0.6, "segments": [segment], "noise_nominal": None, "trajectories": items,
            "grasp": {"segment": "stick", "distance_from_lower_end_m": 0.4}}  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return load_case(folder)


def simulate(case, stiffness, damping, *, start=None, chosen=None, form="joint", without=(), **on):
    """Simulate a case with every effect of its form compiled in; ``on`` gives values, {effect: {parameter: value}}.

    Effects at joints act at joint 0. The output is poisoned first. Returns channels [R, T, C].
    """
    rows = [e for e in effects() if getattr(e, form) is not None and e.name not in without]
    acting = tuple(Acting(e.name, 0 if e.law(form).per_joint else None) for e in rows)
    picked = recordings(case) if chosen is None else chosen
    rollout = Rollout(case, picked, 1, unknowns=Unknowns(effects=acting))
    offsets = sum(p.name.startswith("offset ") for p in rollout.system.parameters)
    values = [*np.atleast_1d(stiffness), *np.atleast_1d(damping), *[0.0] * offsets]
    for effect in rows:
        given = dict(on.get(effect.name, {}))
        values += [given.pop(p.name, p.neutral) for p in effect.law(form).parameters]
        assert not given, f"{effect.name} has no {given}"
    assert set(on) <= {e.name for e in rows}
    rollout._output.torch.fill_(torch.nan)
    first = None if start is None else torch.tensor(start, dtype=torch.float64).reshape(1, len(picked), 1, 2)
    return rollout(torch.tensor([values], dtype=torch.float64), first)[0].double().numpy().copy()


def held(n=200, force=FORCE):
    """Return a force that rises in 0.4 s and stays."""
    return np.interp(np.arange(n), [5, 25], [0.0, 1.0])[:, None] * force


def stick(case, damping=DS, **on):
    """Simulate a stick with everything but the trunk compiled in; `KS` and a damper hold it."""
    return simulate(case, KS, damping, form="branch", without=("base_compliance",), **on)


def settled(out):
    """Return the displacement at the end, at rest there."""
    assert np.abs(out[-1, 3:]).max() < 2e-3
    return out[-1, :3]


def resting(branch, spring, force, *, point=0.4, seen=0.4, more=None, lost=0.0):
    """Return the displacement [3] from the grasp point where a stick rests, by a root of the moments about its base.

    ``spring(phi)`` is the torque of the joint in the stick's frame, ``force(R)`` what acts at ``point`` [m] along it
    (world axes, R from rest to now), ``more(R)`` a further moment about the base (world axes); ``seen`` [m] is the
    point whose displacement is wanted. Weight counts, and the pre-load holds the rest pose, less a share ``lost``.
    """
    axis, across = branch.axis[0], np.array([-np.sin(branch.azimuth[0]), np.cos(branch.azimuth[0]), 0.0])
    rest = Rotation.from_matrix(np.column_stack([np.cross(across, axis), across, axis]))
    a, b = branch.radius[0]
    com = axis * branch.length[0] * (a * a + 2 * a * b + 3 * b * b) / (4 * (a * a + a * b + b * b))
    weight = np.array([0.0, 0.0, -branch.gravity * branch.mass[0]])
    preload = (1.0 - lost) * rest.inv().apply(-np.cross(com, weight))

    def moment(phi):
        turn = rest * Rotation.from_rotvec(phi) * rest.inv()  # R of the world vectors
        out = (rest * Rotation.from_rotvec(phi)).apply(held_torque(preload, phi) + spring(phi))
        out = out + np.cross(turn.apply(com), weight) + np.cross(turn.apply(axis * point), force(turn))
        return out if more is None else out + more(turn)

    phi = root(moment, np.zeros(3), tol=1e-13).x
    assert np.abs(moment(phi)).max() < 1e-9
    return (rest * Rotation.from_rotvec(phi) * rest.inv()).apply(axis * seen) - axis * 0.4
