"""Weight of a chain of segments in torch, for unknown densities and rest angles; quaternions are w, x, y, z."""

from __future__ import annotations

import torch


def multiply(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Hamilton product of quaternions [..., 4], broadcast."""
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(-1, keepdim=True)
    cross = torch.linalg.cross(*torch.broadcast_tensors(a[..., 1:], b[..., 1:]))
    return torch.cat([w, a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + cross], -1)


def conjugate(q: torch.Tensor) -> torch.Tensor:
    """Inverse of unit quaternions [..., 4]."""
    return torch.cat([q[..., :1], -q[..., 1:]], -1)


def rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Vectors [..., 3] turned by unit quaternions [..., 4], broadcast."""
    axis, v = torch.broadcast_tensors(q[..., 1:], v)
    t = 2.0 * torch.linalg.cross(axis, v)
    return v + q[..., :1] * t + torch.linalg.cross(axis, t)


def turned_chain(world: torch.Tensor, tilt: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Raise every segment of a chain by an angle about its own horizontal axis.

    Args:
        world: Orientation of every segment, z along it and y horizontal, shape [R, 4].
        tilt: Angles added to the elevations [rad], shape [S, R].

    Returns:
        Orientations in the world and in the segment below, both [S, R, 4].
    """
    half, zero = tilt / 2, torch.zeros_like(tilt)
    turned = multiply(world, torch.stack([half.cos(), zero, -half.sin(), zero], -1))
    relative = multiply(conjugate(turned[:, :-1]), turned[:, 1:])
    return turned, torch.cat([turned[:, :1], relative], 1)


def holding_torque(
    mass: torch.Tensor, com: torch.Tensor, length: torch.Tensor, world: torch.Tensor, gravity: float
) -> torch.Tensor:
    """Torque at each joint that holds a chain against gravity along -z.

    Joint i carries the weight of segments i to R-1; the torque is the negative of its moment about the joint.

    Args:
        mass: Masses [kg], shape [S, R].
        com: Centres of mass in the segments' frames [m], shape [R, 3].
        length: Lengths [m], shape [R].
        world: Orientations of the segments in the world, shape [S, R, 4].
        gravity: Gravity [m/s^2].

    Returns:
        Torques in the segments' frames [N m], shape [S, R, 3].
    """
    along = rotate(world, torch.nn.functional.pad(length[:, None], (2, 0)))
    start = along.cumsum(1) - along
    first = mass[..., None] * (start + rotate(world, com))
    carried, moment = (x.flip(1).cumsum(1).flip(1) for x in (mass, first))
    arm = moment - carried[..., None] * start
    down = torch.tensor([0.0, 0.0, -gravity], dtype=mass.dtype, device=mass.device)
    return -rotate(conjugate(world), torch.linalg.cross(arm, down.expand_as(arm)))
