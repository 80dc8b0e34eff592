"""Scalar types of the kernels: IEEE arithmetic on every lane, series against NumPy, rotations against SciPy."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from bough.kernels.lanes.algebra import (  # noqa: F401, Warp resolves operators on structs to add, div, mul and sub
    about_axis,
    add,
    div,
    exponential,
    half_angle_log,
    mul,
    renormalised,
    shifted_inverse,
    sub,
    types_of,
)
from bough.kernels.lanes.real import (
    SOURCE,
    any_neg,
    atan_excess,
    atan_ratio,
    cos_root,
    fma,
    fnma,
    lane,
    lane_neg,
    real_type,
    round_,
    sin_ratio,
    sqrt_,
    where_neg,
)
from bough.sim.engine.arrays import LaneArray
from scipy.spatial.transform import Rotation

KINDS = [(1, 32), (8, 32), (16, 32), (1, 64)]
EPS = {32: 2.0**-24, 64: 2.0**-53}
OPERATIONS = ("add", "sub", "mul", "div", "fma", "fnma", "sqrt", "round", "where", "plus", "minus", "over")


@cache
def arithmetic(width: int, precision: int):
    """Make the kernel that writes every operation on a, b, c, and the lane predicates of c."""
    Real, W = real_type(width, precision), width

    @wp.kernel(enable_backward=False, module="unique")
    def operate(x: wp.array2d(dtype=Real), out: wp.array2d(dtype=Real), flags: wp.array2d(dtype=int)):
        tag = SOURCE  # noqa: F841
        e = wp.tid()
        a = x[e, 0]
        b = x[e, 1]
        c = x[e, 2]
        out[e, 0] = a + b
        out[e, 1] = a - b
        out[e, 2] = a * b
        out[e, 3] = a / b
        out[e, 4] = fma(a, b, c)
        out[e, 5] = fnma(a, b, c)
        out[e, 6] = sqrt_(a * a)
        out[e, 7] = round_(a)
        out[e, 8] = where_neg(c, a, b)
        out[e, 9] = 0.75 + a
        out[e, 10] = 0.75 - a
        out[e, 11] = 0.75 / a
        for k in range(W):
            flags[e * W + k, 0] = wp.where(any_neg(c), 1, 0)
            flags[e * W + k, 1] = wp.where(lane_neg(c, k), 1, 0)
            flags[e * W + k, 2] = wp.where(lane(c, k) == lane(c, k), 0, 1)

    return operate


@cache
def functions(width: int, precision: int):
    """Make the kernel that writes the series of u, and rotations of the angle, vector, quaternion and tensor given."""
    t = types_of(width, precision)
    Real, Vec, Quat, Sym = t.Real, t.Vec, t.Quat, t.Sym

    @wp.kernel(enable_backward=False, module="unique")
    def rotate_all(
        u: wp.array2d(dtype=Real),
        v: wp.array2d(dtype=Vec),
        q: wp.array2d(dtype=Quat),
        a: wp.array2d(dtype=Sym),
        series: wp.array2d(dtype=Real),
        log: wp.array2d(dtype=Vec),
        turns: wp.array2d(dtype=Quat),
        inverse: wp.array2d(dtype=Sym),
    ):
        tag = SOURCE  # noqa: F841
        e = wp.tid()
        series[e, 0] = sin_ratio(u[e, 0])
        series[e, 1] = cos_root(u[e, 0])
        series[e, 2] = atan_ratio(u[e, 0])
        series[e, 3] = atan_excess(u[e, 0])
        p = q[e, 0]
        log[e, 0] = Vec(p.x, p.y, p.z) * half_angle_log(p)
        turns[e, 0] = exponential(v[e, 0], p)
        turns[e, 1] = about_axis(v[e, 1], u[e, 1], p)
        turns[e, 2] = renormalised(p)
        inverse[e, 0] = shifted_inverse(a[e, 0], u[e, 2])

    return rotate_all


def scalar(precision: int) -> type:
    return np.float64 if precision == 64 else np.float32


def array(kind: str, values: np.ndarray, width: int, precision: int) -> LaneArray:
    """Put values [worlds, places, components] into lanes."""
    out = LaneArray(kind, len(values) // width, values.shape[1], width=width, precision=precision, device="cpu")
    out.assign(values)
    return out


def operated(x: np.ndarray, width: int, precision: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Run `arithmetic` on x [worlds, 3]."""
    out = array("Real", np.full((len(x), len(OPERATIONS), 1), np.nan), width, precision)
    flags = wp.full((len(x), 3), -1, dtype=int, device="cpu")
    given = array("Real", x[:, :, None], width, precision)
    inputs = [given.kernel, out.kernel, flags]
    wp.launch(arithmetic(width, precision), dim=len(x) // width, inputs=inputs, device="cpu")
    columns = out.numpy()[:, :, 0].astype(scalar(precision))
    return dict(zip(OPERATIONS, columns.T, strict=True)), flags.numpy()


def numbers(precision: int, seed: int = 0) -> np.ndarray:
    """Draw [worlds, 3] numbers of many magnitudes and both signs."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(256, 3)) * 10.0 ** rng.uniform(-6, 6, (256, 3))
    x[:4, 0] = [0.5, 1.5, -2.5, 3.0]
    return x.astype(scalar(precision)).astype(np.float64)


@pytest.mark.parametrize(("width", "precision"), KINDS)
def test_arithmetic_is_ieee(width, precision):
    """Get the bits that NumPy gets from every operation, on every lane."""
    x = numbers(precision)
    got, _ = operated(x, width, precision)
    a, b, c = x.astype(scalar(precision)).T
    point75 = scalar(precision)(0.75)
    want = {"add": a + b, "sub": a - b, "mul": a * b, "div": a / b, "sqrt": np.sqrt(a * a), "round": np.rint(a),
            "where": np.where(c < 0, a, b), "plus": point75 + a, "minus": point75 - a, "over": point75 / a}  # fmt: skip
    for name, values in want.items():
        np.testing.assert_array_equal(got[name], values, err_msg=name)


def test_fused_product_is_rounded_once():
    """Compare fma with the sum in extended precision: within half a unit in the last place, unlike a * b + c.

    The product of two float32 numbers is exact in 64 bits of mantissa; their sum with c is rounded once more there,
    which can move the result by at most 2^-40 units.
    """
    rng = np.random.default_rng(1)
    x = rng.normal(size=(4096, 3))
    x[:, 2] = -x[:, 0] * x[:, 1] * (1.0 + 1e-4 * rng.normal(size=4096))  # cancellation shows a rounded product
    x = x.astype(np.float32).astype(np.float64)
    a, b, c = x.astype(np.longdouble).T
    for width in (1, 8, 16):
        got, _ = operated(x, width, 32)
        for name, exact in (("fma", a * b + c), ("fnma", c - a * b)):
            unit = np.spacing(np.abs(exact).astype(np.float32)).astype(np.longdouble)
            assert (np.abs(got[name].astype(np.longdouble) - exact) <= 0.5001 * unit).all()
    twice = (x[:, 0].astype(np.float32) * x[:, 1].astype(np.float32) + x[:, 2].astype(np.float32)).astype(np.longdouble)
    assert (np.abs(twice - (a * b + c)) > 10 * np.spacing(np.abs(a * b + c).astype(np.float32))).any()


@pytest.mark.parametrize(("width", "precision"), KINDS)
def test_predicates_of_lanes(width, precision):
    """Tell which lane is negative and whether any is; NaN is neither negative nor chosen by where_neg."""
    x = np.ones((64, 3))
    x[:, 0], x[:, 1] = 5.0, 7.0
    x[[3, 40], 2], x[20, 2], x[21, 2] = -1.0, np.nan, -0.0
    got, flags = operated(x, width, precision)
    negative = np.isin(np.arange(64), [3, 40])
    groups = negative.reshape(-1, width).any(axis=1).repeat(width)
    np.testing.assert_array_equal(flags[:, 0], groups)
    np.testing.assert_array_equal(flags[:, 1], negative)
    np.testing.assert_array_equal(np.flatnonzero(flags[:, 2]), [20])
    np.testing.assert_array_equal(got["where"], np.where(negative, 5.0, 7.0))


def evaluated(width: int, precision: int, **given: np.ndarray) -> dict[str, np.ndarray]:
    """Run `functions` on u [worlds, 3], v [worlds, 2, 3], q [worlds, 4], a [worlds, 6]; missing ones are ones."""
    n = len(next(iter(given.values())))
    rest = {"u": np.ones((n, 3)), "v": np.ones((n, 2, 3)), "q": np.ones((n, 4)), "a": np.eye(6)[[0] * n] + 1.0}
    x = {k: np.asarray(given.get(k, v), np.float64) for k, v in rest.items()}
    kinds = {"series": ("Real", 4), "log": ("Vec", 1), "turns": ("Quat", 3), "inverse": ("Sym", 1)}
    size = {"Real": 1, "Vec": 3, "Quat": 4, "Sym": 6}
    out = {k: array(s, np.full((n, p, size[s]), np.nan), width, precision) for k, (s, p) in kinds.items()}
    shapes = {"u": x["u"][:, :, None], "v": x["v"], "q": x["q"][:, None], "a": x["a"][:, None]}
    names = {"u": "Real", "v": "Vec", "q": "Quat", "a": "Sym"}
    inputs = [array(names[k], v, width, precision) for k, v in shapes.items()]
    launch = [i.kernel for i in inputs] + [o.kernel for o in out.values()]
    wp.launch(functions(width, precision), dim=n // width, inputs=launch, device="cpu")
    return {k: o.numpy() for k, o in out.items()}


@pytest.mark.parametrize(("width", "precision"), KINDS)
def test_series_are_the_functions(width, precision):
    """Compare sin(x)/x and cos(x) on half turns [0, pi/2], atan(x)/x and its excess on [0, 1] with NumPy.

    float32: the polynomials leave 4e-10 (Taylor, pi/2) and 2.5e-9 (Chebyshev), below its rounding; Horner's rule adds
    a rounding or two. The argument itself is rounded to u = x^2.
    """
    x = np.linspace(0.0, np.pi / 2, 320)
    u = (x * x).astype(scalar(precision)).astype(np.float64)
    t = np.linspace(0.0, 1.0, 320)
    w = (t * t).astype(scalar(precision)).astype(np.float64)
    smooth = evaluated(width, precision, u=np.stack([u, u, u], axis=1))["series"][:, :, 0]
    arc, excess = evaluated(width, precision, u=np.stack([w, w, w], axis=1))["series"][:, 2:, 0].T
    bound = 4 * EPS[precision] + (3e-9 if precision == 32 else 0)
    np.testing.assert_allclose(smooth[:, 0], np.sinc(np.sqrt(u) / np.pi), rtol=0, atol=bound)
    np.testing.assert_allclose(smooth[:, 1], np.cos(np.sqrt(u)), rtol=0, atol=bound)
    root = np.sqrt(w)
    want = np.where(root > 0, np.arctan(root) / np.where(root > 0, root, 1.0), 1.0)
    np.testing.assert_allclose(arc, want, rtol=0, atol=bound)
    far = w > 0.05  # below, NumPy's difference loses its digits: there -1/3 + w/5 - w^2/7 + w^3/9 - w^4/11
    taylor = np.polyval([-1 / 11, 1 / 9, -1 / 7, 1 / 5, -1 / 3], w)
    # the difference of the ratios' 2.5e-9 over w, 1e-12 of rounding over it, and the series' next term, w^5 / 13
    spread = bound + (6e-7 if precision == 32 else 2e-15 / 0.05)
    np.testing.assert_allclose(excess[far], ((want - 1.0) / np.where(far, w, 1.0))[far], rtol=0, atol=spread)
    np.testing.assert_allclose(excess[~far], taylor[~far], rtol=0, atol=spread + 0.05**5 / 13)


def turned(vectors: np.ndarray) -> np.ndarray:
    """Quaternions w, x, y, z of rotation vectors [n, 3]."""
    return np.roll(Rotation.from_rotvec(vectors).as_quat(), 1, axis=1)


def directions(n: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize(("width", "precision"), KINDS)
def test_logarithm_of_a_quaternion(width, precision):
    """Recover rotation vectors from 0 to 3.14 rad; q and -q have the same logarithm to the bit.

    A quaternion rounded to eps tells its rotation vector to 2 eps (and half a turn to 2 eps / sin(pi/2)).
    """
    angle = np.concatenate([[0.0, 1e-7, 1e-3], np.linspace(0.01, 3.14, 157)])
    vectors = directions(160, 2) * angle[:, None]
    q = turned(vectors)
    got, flipped = (evaluated(width, precision, q=s * q)["log"][:, 0] for s in (1, -1))
    np.testing.assert_allclose(got, vectors, rtol=0, atol=10 * EPS[precision] + 1.3e-8 * (precision == 32))
    np.testing.assert_array_equal(got, flipped)


@pytest.mark.parametrize(("width", "precision"), KINDS)
def test_exponential_of_a_rotation_vector(width, precision):
    """Turn by up to half a turn a step, and about an axis by any angle of many turns (equal up to sign).

    A float32 angle of 40 rad is itself only known to 2e-6.
    """
    vectors = directions(160, 3) * np.linspace(0.0, np.pi, 160)[:, None]
    axis, angle = directions(160, 4), np.linspace(-40.0, 40.0, 160)
    u = np.stack([np.ones(160), angle, np.ones(160)], axis=1)
    got = evaluated(width, precision, v=np.stack([vectors, axis], axis=1), u=u)["turns"]
    np.testing.assert_allclose(got[:, 0], turned(vectors), rtol=0, atol=6 * EPS[precision] + 5e-9)
    want = turned(axis * angle[:, None])
    sign = np.sign(np.sum(want * got[:, 1], axis=1, keepdims=True))
    np.testing.assert_allclose(sign * got[:, 1], want, rtol=0, atol=60 * EPS[precision] + 5e-9)


def test_renormalised_removes_the_error_to_second_order():
    """Scale a unit quaternion by 1 + d: its length comes back to 1 - 3/2 d^2 (Newton's step for 1/sqrt at one)."""
    scale = 1.0 + np.array([1e-2, -1e-2, 1e-3, -1e-3, 0.0, 1e-5, 1e-1, -1e-1])
    q = turned(directions(8, 5)) * scale[:, None]
    length = np.linalg.norm(evaluated(1, 64, q=q)["turns"][:, 2], axis=1)
    np.testing.assert_allclose(length, scale * (1.5 - 0.5 * scale**2), rtol=1e-14)
    np.testing.assert_array_less(np.abs(length - 1.0), 2.0 * (scale - 1.0) ** 2 + 1e-14)


@pytest.mark.parametrize(("width", "precision"), KINDS)
def test_inverse_of_a_shifted_tensor(width, precision):
    """Invert A + k 1 for random positive A; cofactors lose the condition number, here below 100."""
    rng = np.random.default_rng(6)
    frames = Rotation.random(64, rng).as_matrix()
    full = np.einsum("nij,nj,nkj->nik", frames, rng.uniform(0.1, 3.0, (64, 3)), frames)
    k = rng.uniform(0.0, 1.0, 64)
    entries = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    got = evaluated(width, precision, a=entries, u=np.stack([k, k, k], axis=1))["inverse"][:, 0]
    want = np.linalg.inv(full + k[:, None, None] * np.eye(3))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_allclose(got, want, rtol=0, atol=200 * EPS[precision] * np.abs(want).max())


def test_lanes_have_the_bits_of_one_world():
    """Evaluate every function at widths 1, 8 and 16: bit for bit the same numbers."""
    rng = np.random.default_rng(7)
    given = {
        "u": np.stack([rng.uniform(0, 1, 320), rng.normal(0, 9, 320), rng.uniform(0, 1, 320)], axis=1),
        "v": rng.normal(size=(320, 2, 3)),
        "q": turned(rng.normal(size=(320, 3))),
        "a": np.abs(rng.normal(size=(320, 6))) * [1, 0.1, 0.1, 1, 0.1, 1] + [1, 0, 0, 1, 0, 1],
    }
    one = evaluated(1, 32, **given)
    for width in (8, 16):
        for name, values in evaluated(width, 32, **given).items():
            np.testing.assert_array_equal(values, one[name], err_msg=f"{name}, {width} lanes")


@pytest.mark.parametrize(("width", "precision"), [(8, 64), (4, 32), (1, 16), (0, 32)])
def test_no_other_scalars(width, precision):
    """Refuse widths and precisions that no kernel exists for."""
    with pytest.raises(ValueError, match=f"no real of {precision} bit with {width} worlds"):
        real_type(width, precision)
