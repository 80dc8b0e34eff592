"""Quaternions w, x, y, z on host arrays, batched over leading axes."""

from __future__ import annotations

import numpy as np

from .tree import Array


def multiply(p: Array, q: Array) -> Array:
    """Return the product p q, shape [..., 4]."""
    pw, px, py, pz = np.moveaxis(np.asarray(p), -1, 0)
    qw, qx, qy, qz = np.moveaxis(np.asarray(q), -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy + py * qw + pz * qx - px * qz,
            pw * qz + pz * qw + px * qy - py * qx,
        ],
        axis=-1,
    )


def conjugate(q: Array) -> Array:
    """Return the inverse of unit quaternions, shape [..., 4]."""
    return np.asarray(q) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: Array, v: Array) -> Array:
    """Return vectors [..., 3] turned by unit quaternions [..., 4]."""
    w, u = np.asarray(q)[..., :1], np.asarray(q)[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def about(axis: Array, angle: Array) -> Array:
    """Return the quaternions of turns by ``angle`` [rad, shape ...] about unit axes [..., 3]."""
    half = 0.5 * np.asarray(angle)[..., None]
    return np.concatenate([np.cos(half), np.sin(half) * np.asarray(axis)], axis=-1)


def from_matrix(m: Array) -> Array:
    """Return unit quaternions of rotation matrices [..., 3, 3] (scipy's, with w first)."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(np.reshape(m, (-1, 3, 3))).as_quat()
    return np.roll(flat, 1, axis=-1).reshape(*np.shape(m)[:-2], 4)
