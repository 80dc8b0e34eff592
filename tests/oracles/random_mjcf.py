"""Random MJCF text that uses many of the language's ways to say the same thing, for tests of the importer.

Written from MuJoCo's XML reference alone; it shares nothing with the exporter or the importer under test.
"""

from __future__ import annotations

import numpy as np


def _numbers(values: object) -> str:
    return " ".join(f"{v:.6g}" for v in np.atleast_1d(values))


class RandomMjcf:
    """Write one random model; `text` is the whole file.

    Args:
        seed: Seed of the random stream.
        bodies: Number of bodies.
        multi: Whether bodies may carry several joints.
        ref: Whether joints may have a non-zero `ref`.
        frames: Whether `<frame>` elements wrap some bodies and geoms.
        plain: Whether to leave out what Newton 1.8 reads otherwise than MuJoCo: total mass, shells, boxes and
            ellipsoids by their ends.
    """

    def __init__(
        self, seed: int, bodies: int, multi: bool = True, ref: bool = True, frames: bool = True, plain: bool = False
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.bodies, self.multi, self.ref, self.frames, self.plain = bodies, multi, ref, frames, plain
        self.degrees = bool(self.rng.random() < 0.5)
        self.count = 0
        self.gravity = self.rng.normal(size=3) * 5
        self.text = self._document()

    def _chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def _angle(self, scale: float = 1.0) -> float:
        return float(self.rng.uniform(-np.pi, np.pi) * scale * (180 / np.pi if self.degrees else 1.0))

    def _document(self) -> str:
        seq = "".join(self.rng.choice(list("xyzXYZ"), 3))
        tree = "".join(self._body(self._split()) for _ in range(1 if self._chance(0.6) else 2))
        compiler = f'<compiler angle="{"degree" if self.degrees else "radian"}" eulerseq="{seq}" {self._bounds()}/>'
        if self.degrees and self._chance(0.5):
            compiler = compiler.replace('angle="degree"', "")
        return (
            f'<mujoco model="random">{compiler}<option gravity="{_numbers(self.gravity)}"/>{self._defaults()}'
            f'<worldbody><geom type="plane" size="5 5 .1"/>{tree}</worldbody></mujoco>'
        )

    def _bounds(self) -> str:
        out = 'boundmass="0.05" boundinertia="0.0004"' if self._chance(0.3) else ""
        out += ' inertiafromgeom="true"' if self._chance(0.2) else ""
        return out + (' settotalmass="3.5"' if self._chance(0.2) and not self.plain else "")

    def _split(self) -> int:
        return max(1, self.bodies // 2)

    def _defaults(self) -> str:
        r = self.rng.uniform
        return (
            f'<default><joint damping="{r(0.1, 1):.4g}" armature="{r(0, 0.01):.4g}"/>'
            f'<geom density="{r(300, 900):.4g}" rgba="1 0 0 1"/>'
            f'<default class="stiff"><joint type="ball" stiffness="{r(1, 300):.5g}"/><geom type="capsule" size=".02"/>'
            f'<default class="twig"><joint damping="{r(0.1, 1):.4g}"/><geom size=".01 .05" density="450"/></default>'
            f'</default><default class="hinge"><joint type="hinge" axis="1 2 -1" stiffness="{r(1, 50):.5g}"/></default>'
            "</default>"
        )

    def _orientation(self) -> str:
        rng, kind = self.rng, self.rng.integers(6)
        if kind == 0:
            return ""
        if kind == 1:
            return f'quat="{_numbers(rng.normal(size=4))}"'
        if kind == 2:
            return f'euler="{_numbers([self._angle() for _ in range(3)])}"'
        if kind == 3:
            return f'axisangle="{_numbers(rng.normal(size=3))} {self._angle():.6g}"'
        if kind == 4:
            return f'xyaxes="{_numbers(rng.normal(size=6))}"'
        return f'zaxis="{_numbers(rng.normal(size=3))}"'

    def _position(self, scale: float = 0.3) -> str:
        return f'pos="{_numbers(self.rng.normal(size=3) * scale)}" {self._orientation()}'

    def _geom(self) -> str:
        kind = str(self.rng.choice(["sphere", "capsule", "cylinder", "box", "ellipsoid"]))
        count = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}[kind]
        size = self.rng.uniform(0.01, 0.15, count)
        place = self._position(0.1)
        ends = ("capsule", "cylinder") if self.plain else ("capsule", "cylinder", "box", "ellipsoid")
        if kind in ends and self._chance(0.5):
            place = f'fromto="{_numbers(self.rng.normal(size=6) * 0.2)}"'
            size = size[:1] if kind in ("capsule", "cylinder") else size[:2]
            if kind in ("box", "ellipsoid"):
                size = size[:1]
        weight = self.rng.choice(
            ["", f'mass="{self.rng.uniform(0.05, 2):.5g}"', f'density="{self.rng.uniform(100, 999):.5g}"']
        )
        if self._chance(0.2):
            half = f'<geom class="twig" {place} {weight}/>' if "fromto" in place or kind != "box" else ""
            if half:
                return half
        shell = 'shellinertia="true"' if self._chance(0.1) and kind != "ellipsoid" and not self.plain else ""
        contact = 'contype="0" conaffinity="0"' if self._chance(0.2) else ""
        return f'<geom type="{kind}" size="{_numbers(size)}" {place} {weight} {shell} {contact}/>'

    def _inertial(self) -> str:
        a, b = self.rng.uniform(0.5, 1, 2) * 1e-2
        c = self.rng.uniform(abs(a - b), a + b)
        mass = self.rng.uniform(0.1, 3)
        if self._chance(0.5):
            return f'<inertial {self._position(0.1)} mass="{mass:.6g}" diaginertia="{_numbers([a, b, c])}"/>'
        q, _ = np.linalg.qr(self.rng.normal(size=(3, 3)))
        m = q @ np.diag([a, b, 0.99 * c]) @ q.T
        full = " ".join(f"{v:.12g}" for v in [m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]])
        pos = _numbers(self.rng.normal(size=3) * 0.1)
        return f'<inertial pos="{pos}" mass="{mass:.6g}" fullinertia="{full}"/>'

    def _joint(self, kind: str) -> str:
        rng = self.rng
        text = f'<joint name="j{self.count}_{rng.integers(1 << 30)}" '
        if kind == "stiff":
            text += 'class="stiff" '
        elif kind == "hinge_class":
            text += 'class="hinge" '
        else:
            text += f'type="{kind}" '
        if self._chance(0.5):
            text += f'pos="{_numbers(rng.normal(size=3) * 0.1)}" '
        if kind in ("hinge", "slide"):
            text += f'axis="{_numbers(rng.normal(size=3))}" '
        if self._chance(0.7):
            text += f'stiffness="{rng.uniform(1, 300):.6g}" '
        if self._chance(0.5):
            text += f'damping="{rng.uniform(0.01, 3):.6g}" armature="{rng.uniform(0, 0.05):.6g}" '
        scalar = kind in ("hinge", "slide", "hinge_class")
        if scalar and self._chance(0.4):
            text += f'springref="{self._angle(0.3) if kind != "slide" else rng.normal():.6g}" '
        if scalar and self.ref and self._chance(0.4):
            text += f'ref="{self._angle(0.5) if kind != "slide" else rng.normal():.6g}" '
        return text + "/>"

    def _joints(self) -> str:
        if self._chance(0.1):
            return ""
        if self.multi and self._chance(0.3):
            kinds = list(self.rng.choice(["hinge", "slide", "hinge_class"], self.rng.integers(2, 4)))
            return "".join(self._joint(k) for k in kinds)
        return self._joint(str(self.rng.choice(["ball", "stiff", "hinge", "hinge_class", "slide"])))

    def _body(self, bodies: int) -> str:
        self.count += 1
        name = f'name="body{self.count}"' if self._chance(0.9) else ""
        child = f'childclass="{self.rng.choice(["stiff", "twig", "hinge"])}"' if self._chance(0.2) else ""
        # A body needs a size of its own whatever class is in force, so one plain sphere is always there.
        inside = [f'<geom type="sphere" size="{self.rng.uniform(0.02, 0.1):.5g}" {self._position(0.1)}/>']
        inside += [self._geom() for _ in range(self.rng.integers(0, 3))]
        if self._chance(0.3):
            inside.append(self._inertial())
        if self.frames and self._chance(0.2):
            inner = f"<frame {self._orientation()}>{self._geom()}</frame>"
            inside.append(f"<frame {self._position(0.1)}>{self._geom()}{inner}</frame>")
        left = bodies - 1
        while left > 0:
            size = int(self.rng.integers(1, left + 1))
            text = self._body(size)
            inside.append(f"<frame {self._position(0.1)}>{text}</frame>" if self.frames and self._chance(0.2) else text)
            left -= size
        joints = self._joints()
        if self.frames and self._chance(0.1):
            joints = f"<frame {self._position(0.1)}>{joints}</frame>"
        return f"<body {name} {child} {self._position()}>{joints}{''.join(inside)}</body>"
