"""Mass, centre of mass and inertia of an MJCF body, as MuJoCo's compiler works them out.

Everything here is float64. Newton's importer keeps float32 and was measured to differ from C MuJoCo in
``settotalmass``, ``shellinertia`` and the size of boxes and ellipsoids given by ``fromto`` (where it stops with an
IndexError); only mesh geoms, whose volume integrals it does right, are taken from it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from ..base.rotation import quat_matrix, quat_multiply, quat_rotate
from ..base.types import Array
from .xml_tree import Element

Pose = tuple[Array, Array]
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}
MASSLESS = ("plane", "hfield")
SMALL = 1e-15  # mjMINVAL: less mass or inertia counts as none


@dataclass
class MassProperties:
    """Mass [kg], centre of mass [m] [3] and inertia about it [kg m^2] [3, 3] in some frame."""

    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def placed(self, pose: Pose) -> MassProperties:
        """Return the same matter seen from the frame in which its own frame has this pose."""
        R = quat_matrix(pose[1])
        return MassProperties(self.mass, pose[0] + R @ self.com, R @ self.inertia @ R.T)


def combined(parts: list[MassProperties]) -> MassProperties:
    """Mass properties of several pieces of matter given in one frame (parallel-axis theorem)."""
    mass = sum(p.mass for p in parts)
    if mass < SMALL:
        return MassProperties()
    com = sum((p.mass * p.com for p in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for p in parts:
        d = p.com - com
        inertia += p.inertia + p.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return MassProperties(float(mass), com, inertia)


def solid(kind: str, size: Array) -> tuple[np.number, Array]:
    """Volume and principal inertias at unit density of a solid primitive about its centre.

    Args:
        kind: One of ``SIZES``.
        size: MJCF's sizes [m] (radius, half length, half edges or semi-axes); complex numbers are fine.

    Returns:
        Volume [m^3] and principal inertias [m^5], shape [3].
    """
    if kind == "box" or kind == "ellipsoid":
        unit_volume, factor = (8.0, 1 / 3) if kind == "box" else (4 / 3 * np.pi, 1 / 5)
        volume = unit_volume * np.prod(size)
        return volume, volume * factor * (np.sum(size**2) - size**2)
    radius, half = size[0], (size[1] if kind != "sphere" else 0.0)
    ball = 0.0 if kind == "cylinder" else 4 / 3 * np.pi * radius**3
    barrel = 2 * np.pi * radius**2 * half
    across = barrel * (half**2 / 3 + radius**2 / 4) + ball * (0.4 * radius**2 + half**2 + 0.75 * half * radius)
    along = barrel * radius**2 / 2 + ball * 0.4 * radius**2
    return ball + barrel, np.array([across, across, along])


def shell(kind: str, size: Array) -> tuple[float, Array]:
    """Area [m^2] and principal inertias [m^4] at unit area density of the surface of a primitive.

    A shell is what the solid gains when its surface moves outwards, so both are derivatives of `solid`; the complex
    step makes them exact.
    """
    step = 1e-30
    outwards = np.array([1.0, 0.0]) if kind == "capsule" else np.ones(len(size))
    volume, inertia = solid(kind, size + 1j * step * outwards)
    return float(np.imag(volume) / step), np.imag(inertia) / step


def geom_sizes(geom: Element, kind: str, has_segment: bool) -> Array:
    """MJCF's ``size`` of a primitive [m], shape [SIZES[kind]]; with ``fromto`` the length is left at zero.

    Raises:
        InputError: A size is missing, zero or negative.
    """
    count = SIZES[kind]
    given = geom.vector("size", 3, at_least=1)
    needed = 1 if has_segment else count
    if len(given) < needed or (given[:needed] <= 0).any():
        raise geom.error(
            f"size='{geom.attrib['size']}'", f"{needed} number{'s' * (needed > 1)} above zero for a {kind}"
        )
    size = np.zeros(count)
    size[: min(count, len(given))] = given[:count]
    return size


def primitive(geom: Element, kind: str, size: Array) -> MassProperties:
    """Mass properties of a primitive geom in its own frame, from its ``mass`` or ``density``.

    Raises:
        InputError: Negative mass or density, or the shell of an ellipsoid, which has no closed form.
    """
    hollow = geom.keyword("shellinertia", "false", ("true", "false")) == "true"
    if hollow and kind == "ellipsoid":
        raise geom.error("shellinertia of an ellipsoid", "a solid ellipsoid, or an <inertial>")
    measure, inertia = shell(kind, size) if hollow else solid(kind, size)
    density = geom.positive("density", 1000.0)
    mass = geom.positive("mass") if "mass" in geom.attrib else density * float(np.real(measure))
    return MassProperties(mass, np.zeros(3), np.diag(np.real(inertia) * mass / float(np.real(measure))))


def mesh_geom(geom: Element, mesh: Element, compiler: Element) -> MassProperties:
    """Mass properties of a geom made from a mesh, in the geom's own frame, through Newton's MJCF importer (float32).

    Raises:
        InputError: Newton cannot read the mesh.
    """
    import newton  # slow to import, and only files with meshes need it

    keep = {k: v for k, v in geom.attrib.items() if k in ("type", "mesh", "mass", "density", "shellinertia")}
    dirs = {k: v for k, v in compiler.attrib.items() if k in ("meshdir", "assetdir", "strippath")}
    text = (
        f"<mujoco><compiler{_attributes(dirs)}/><asset><mesh{_attributes(mesh.attrib)}/></asset>"
        f"<worldbody><body><geom{_attributes(keep)}/></body></worldbody></mujoco>"
    )
    builder = newton.ModelBuilder()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            builder.add_mjcf(text, path_resolver=lambda _, name: str(_existing(mesh, name)))
    except Exception as e:  # Newton and the mesh readers behind it raise errors of many kinds
        raise mesh.error(f"a mesh that Newton cannot read ({e})", "a mesh file with a volume") from None
    inertia = np.array(builder.body_inertia[0], dtype=np.float64).reshape(3, 3)
    return MassProperties(float(builder.body_mass[0]), np.array(builder.body_com[0], dtype=np.float64), inertia)


def _attributes(attrib: dict[str, str]) -> str:
    return "".join(f" {key}={quoteattr(value)}" for key, value in attrib.items())


def _existing(mesh: Element, name: str) -> Path:
    path = mesh.file.parent / name
    if not path.is_file():
        raise mesh.error(f"no file {path}", "an existing mesh file")
    return path


def compose(a: Pose, b: Pose) -> Pose:
    """Pose of a frame whose pose in frame a is b."""
    return a[0] + quat_rotate(a[1], b[0]), quat_multiply(a[1], b[1])
