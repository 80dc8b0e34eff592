"""The ray tracer against closed forms and brute force: distances, Lambert's law, shadows, hidden sky, views."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from bough.kernels.points import raytrace
from bough.sim.pictures.tracer import Ground, Solids, Sunlight, View, trace

DARK = (0.0, 0.0, 0.0)
SUN_ONLY = {"zenith": DARK, "horizon": DARK, "inside": DARK, "glow": DARK, "sun": (2.0, 2.0, 2.0), "softness": 0.0}
GRAY = Ground(color=(0.5, 0.5, 0.5))


@wp.kernel
def cast(
    solids: raytrace.Solids, origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3),
    item_out: wp.array(dtype=int), distance_out: wp.array(dtype=float), normal_out: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Return what each ray meets first."""
    i = wp.tid()
    hit = raytrace.first_hit(solids, origin[i], direction[i], 0.0)
    item_out[i] = hit.item
    distance_out[i] = hit.distance
    normal_out[i] = hit.normal


@wp.kernel
def hide(
    a: wp.array(dtype=wp.vec4), b: wp.array(dtype=wp.vec4), normal: wp.array(dtype=wp.vec3),
    out: wp.array(dtype=float),
):  # fmt: skip
    """Return the form factor of each cone on a face at the origin."""
    i = wp.tid()
    out[i] = raytrace.occlusion(a[i], b[i], wp.vec3(0.0), normal[i])


def _there(values, kind):
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=kind)


def _solids(start, end, radius, side=None, ground=-100.0):
    """Return the kernel's solids in tight boxes, and what must live as long."""
    count = len(start)
    host = Solids(*(np.asarray(a, float) for a in (start, end, radius)), np.ones((count, 3)),
                  np.zeros((count, 3)) if side is None else np.asarray(side, float), np.zeros(count))  # fmt: skip
    bvh = wp.Bvh(*(_there(c, wp.vec3) for c in host.boxes()))
    out = raytrace.Solids()
    out.start = _there(np.column_stack([host.start, host.radius[:, 0]]), wp.vec4)
    out.end = _there(np.column_stack([host.end, host.radius[:, 1]]), wp.vec4)
    out.side, out.seen, out.ground = _there(host.side, wp.vec3), bvh.id, ground
    return out, bvh


def _cast(solids, origin, direction):
    n = len(direction)
    out = [wp.full(n, -9, dtype=int), wp.full(n, float("nan"), dtype=float), wp.full(n, wp.vec3(float("nan")))]
    rays = [_there(np.broadcast_to(a, (n, 3)), wp.vec3) for a in (origin, direction)]
    wp.launch(cast, dim=n, inputs=[solids, *rays], outputs=out)
    return [a.numpy() for a in out]


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


CONES = {  # ends, radii
    "capsule": ([0, 0, 0], [0.3, 0.2, 1.0], [0.2, 0.2]),
    "tapered": ([0, 0, 0], [0.3, 0.2, 1.0], [0.4, 0.1]),
    "steep": ([0, 0, 0], [0.0, 0.0, 0.5], [0.05, 0.45]),
    "one ball in the other": ([0, 0, 0], [0.0, 0.1, 0.0], [0.5, 0.2]),
    "ball": ([0, 0, 0], [0, 0, 0], [0.3, 0.3]),
}


@pytest.mark.parametrize("name", CONES)
def test_rays_meet_a_round_cone_where_the_hull_of_two_balls_is(name):
    """Meet the convex hull of two finely triangulated balls, from all around.

    An icosphere of 5 subdivisions has edges up to e = 0.04 radii and lies up to e^2 / 6 = 3e-4 radii inside the ball;
    rays that fall in at up to 75 degrees travel four times that further: 5e-4 m at 0.45 m.
    """
    start, end, radius = CONES[name]
    ball = trimesh.creation.icosphere(subdivisions=5).vertices
    hull = trimesh.Trimesh(np.concatenate([np.array(c) + r * ball for c, r in zip((start, end), radius, strict=True)]))
    hull = hull.convex_hull
    rng = np.random.default_rng(0)
    origin = 5.0 * _unit(rng.normal(size=(400, 3)))
    inside = np.array(start) + rng.uniform(size=(400, 1)) * np.subtract(end, start)
    direction = _unit(inside + rng.uniform(-0.5, 0.5, (400, 3)) - origin)
    solids, _keep = _solids([start], [end], [radius])
    item, distance, normal = _cast(solids, origin, direction)
    enter, face, leave = _convex(hull, origin, direction)
    meets, clear = enter < leave, -np.sum(hull.face_normals[face] * direction, axis=1) > np.cos(np.radians(75.0))
    assert (meets & clear).sum() > 80
    assert (item[meets] == 0).all()
    np.testing.assert_allclose(distance[meets & clear], enter[meets & clear], atol=6e-4)
    # A face's normal is off by its radius of 0.03 rad; slender faces of the cone's side by as much around it.
    np.testing.assert_allclose(normal[meets & clear], hull.face_normals[face[meets & clear]], atol=0.05)
    assert (~meets & (item == 0)).sum() <= 4  # the hull of corners lies a little inside the round one


def _convex(hull, origin, direction):
    """Distances at which rays enter and leave a convex polyhedron, and the face they enter by: planes, one by one."""
    towards = direction @ hull.face_normals.T
    distance = np.sum(hull.face_normals * hull.triangles[:, 0], axis=1) - origin @ hull.face_normals.T
    with np.errstate(divide="ignore"):
        at = distance / towards
    entering = np.where(towards < 0, at, -np.inf)
    return entering.max(axis=1), entering.argmax(axis=1), np.where(towards > 0, at, np.inf).min(axis=1)


def test_rays_along_the_axis_of_a_cone():
    """Enter at the ball that faces the ray, where the side's quadratic has no say, and leave nothing out."""
    solids, _keep = _solids([[0, 0, 0]], [[0, 0, 1]], [[0.3, 0.1]])
    along = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    item, distance, normal = _cast(solids, np.array([[0.0, 0, -3], [0.0, 0, 4], [0.29, 0, -3]]), along)
    np.testing.assert_array_equal(item, 0)
    np.testing.assert_allclose(distance, [2.7, 2.9, 3.0 - np.sqrt(0.3**2 - 0.29**2)], rtol=1e-5)
    np.testing.assert_allclose(normal[:2], -along[:2], atol=1e-6)


def test_thin_cones_far_away_are_met_exactly():
    """Meet a twig of 2 mm, 30 m away, at its side's closed form within 0.02 mm: a hundredth of its radius."""
    solids, _keep = _solids([[30, 0, -0.5]], [[30, 0, 0.5]], [[0.002, 0.002]])
    offset = np.linspace(-0.0019, 0.0019, 41)
    origin = np.stack([np.zeros(41), offset, np.zeros(41)], axis=1)
    item, _, normal = _cast(solids, origin, np.tile([1.0, 0.0, 0.0], (41, 1)))
    np.testing.assert_array_equal(item, 0)
    np.testing.assert_allclose(normal[:, 1], offset / 0.002, atol=0.01)


def test_leaf_ground_and_sky():
    """Meet a leaf in x = 2 inside |v| = 4 u (1 - u) only, the ground beside it, and nothing above."""
    solids, _keep = _solids([[2, 0, 0]], [[2, 0, 1]], [[0, 0]], side=[[0, 0.4, 0]], ground=-1.0)
    down = np.array([0.6, 0.0, -0.8])
    rays = [[1, 0, 0], [1, 0, 0], [1, 0, 0], down, [-1, 0, 0], [0.0, 0, 1]]
    origin = [[0, 0.29, 0.25], [0, 0.31, 0.25], [0, -0.39, 0.5], [0, 0, 4.0], [0, 0, 0.5], [0, 0, 0.5]]
    item, distance, normal = _cast(solids, np.array(origin), np.array(rays, float))
    np.testing.assert_array_equal(item, [0, raytrace.SKY, 0, raytrace.GROUND, raytrace.SKY, raytrace.SKY])
    np.testing.assert_allclose(distance[[0, 2, 3]], [2.0, 2.0, 5.0 / 0.8], rtol=1e-6)
    np.testing.assert_allclose(normal[[0, 2, 3]], [[-1, 0, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-6)  # towards the viewer


def test_hidden_sky_is_the_form_factor_of_a_thin_cylinder():
    """Hide what half a million cosine-weighted rays find hidden, times the fade 1 - (h / 20 r)^2.

    The share's standard error is below 0.0004; a thin strip's arc for its chord errs by (r / h)^2 / 6 = 0.4 % at 6 r.
    """
    rng = np.random.default_rng(0)
    start, end = rng.uniform([-1, -1, -0.4], [1, 1, 1.6], (2, 12, 3))
    axis = end - start
    foot = start - np.sum(start * axis, axis=1, keepdims=True) / np.sum(axis**2, axis=1, keepdims=True) * axis
    h = np.linalg.norm(foot, axis=1)
    radius = np.minimum(h / 6, 0.04)
    normal = np.tile([0.0, 0.0, 1.0], (12, 1))
    out = wp.full(12, float("nan"), dtype=float)
    ends = [_there(np.column_stack([p, radius]), wp.vec4) for p in (start, end)]
    wp.launch(hide, dim=12, inputs=[*ends, _there(normal, wp.vec3)], outputs=[out])
    u, turn = rng.uniform(size=500_000), rng.uniform(0, 2 * np.pi, 500_000)
    rays = np.stack([np.sqrt(u) * np.cos(turn), np.sqrt(u) * np.sin(turn), np.sqrt(1 - u)], axis=1)
    for k in range(12):
        solids, _keep = _solids(start[k : k + 1], end[k : k + 1], np.full((1, 2), radius[k]))
        hidden = (_cast(solids, np.zeros(3), rays)[0] == 0).mean()
        fade = max(1 - (h[k] / (20 * radius[k])) ** 2, 0)
        # round ends, which the cylinder lacks: at most a ball's pi r^2 / 2 at each end
        ends_hide = sum(radius[k] ** 2 / np.sum(p[k] ** 2) for p in (start, end)) / 2
        assert abs(out.numpy()[k] - fade * hidden) <= fade * (0.0015 + 0.01 * hidden + ends_hide)


def _bar(height=1.0, half=1.0, color=0.5, length=100.0):
    """Return a bar along y over the ground: shadows like a strip of width 2 ``half`` in a sun overhead."""
    ends = [np.array([[0.0, s * length, height]]) for s in (-1, 1)]
    return Solids.cones(*ends, np.full((1, 2), half), np.full(3, color))


@pytest.mark.parametrize("elevation", [15.0, 40.0, 90.0])
def test_plane_reflects_by_lamberts_law(elevation):
    """Give the lit ground the radiance albedo / pi * E * sin(elevation)."""
    light = Sunlight(azimuth=30.0, elevation=elevation, **SUN_ONLY)
    view = View((50.0, 0.0, 5.0), (50.0, 10.0, 0.0), fov=10.0)
    image = trace(_bar(), Ground(color=(0.2, 0.4, 0.6)), view, light, 8, 8)
    expected = np.array([0.2, 0.4, 0.6]) / np.pi * 2.0 * np.sin(np.radians(elevation))
    np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), rtol=1e-4)


def test_shadow_lies_where_the_sun_is_hidden():
    """Darken the ground exactly under a bar of 2 m seen in a sun overhead, and nowhere else."""
    light = Sunlight(elevation=90.0, **SUN_ONLY)
    for x, lit in ((-1.2, True), (-0.8, False), (0.0, False), (0.8, False), (1.2, True)):
        view = View((x, -4.0, 0.5), (x, 0.0, 0.0), fov=0.5)  # under the bar
        image = trace(_bar(height=2.0), GRAY, view, light, 4, 4)
        assert (image > 0.3).all() if lit else (image < 1e-6).all()


@pytest.mark.parametrize("offset", [-0.5, 0.0, 0.5])
def test_half_shadow_of_a_soft_sun(offset):
    """Light the ground near a bar's edge by the share of the sun's disc that the edge leaves free.

    At ``offset`` disc radii under the bar that is (acos d - d sqrt(1 - d^2)) / pi. The picture is 1.7 cm wide, the
    half-shadow 1.75 m.
    """
    bar = _bar(height=10.0, half=5.0)
    light = Sunlight(elevation=90.0, **{**SUN_ONLY, "softness": 5.0})
    x = 5.0 - offset * 10.0 * np.tan(np.radians(5.0))
    image = trace(bar, GRAY, View((x, -1.0, 1.0), (x, 0.0, 0.0), fov=0.7), light, 8, 8)
    free = (np.arccos(offset) - offset * np.sqrt(1 - offset**2)) / np.pi
    np.testing.assert_allclose(image / (0.5 / np.pi * 2.0), free, atol=0.01)


@pytest.mark.parametrize("radius", [0.005, 0.02, 0.1])
def test_a_chain_shades_like_one_bar(radius):
    """Cast the half-shadow of one bar with eight bars end to end.

    The sun's disc is 3.5 cm in radius there. Thinner bars differ by less than the eye sees, 2 %; of thicker ones the
    balls at a joint overlap: where each hides c, both hide c (1 - c) more, nothing in full shade and full light.
    """
    cuts = np.linspace(-4.0, 4.0, 9)
    at = np.stack([0 * cuts, cuts, 2.0 + 0 * cuts], axis=1)
    chain = Solids.cones(at[:-1], at[1:], np.full((8, 2), radius), np.full(3, 0.5))
    whole = Solids.cones(at[:1], at[-1:], np.full((1, 2), radius), np.full(3, 0.5))
    light = Sunlight(elevation=90.0, **{**SUN_ONLY, "softness": 1.0})
    view = View((0.0, -1.5, 1.0), (0.0, 0.0, 0.0), fov=30.0)
    one, many = (trace(s, GRAY, view, light, 60, 60)[..., 0] / (1.0 / np.pi) for s in (whole, chain))
    assert one.min() < 1 - min(0.9, radius / 0.035) < one.max()
    assert (np.abs(many - one) < 0.02 + (radius > 0.035) * one * (1 - one)).all()


def test_open_ground_under_an_even_sky():
    """Give ground under a sky of radiance L everywhere the radiance albedo * L, and L in the sky itself.

    Ground of albedo 1 below keeps the light even all around; then the first harmonic is all there is.
    """
    light = Sunlight(sun=DARK, zenith=(1.5, 1.5, 1.5), horizon=(1.5, 1.5, 1.5), inside=DARK, glow=DARK)
    view = View((50.0, 0.0, 1.0), (50.0, 10.0, 1.0), fov=60.0)
    image = trace(_bar(length=1.0), Ground(color=(1.0, 1.0, 1.0)), view, light, 16, 16)
    np.testing.assert_allclose(image, 1.5, rtol=1e-3)


def test_sky_lights_a_face_by_the_cosine_law():
    """Light the ground by the mean of the sky's radiance, weighted by the cosine, within the harmonics' 3 %."""
    light = Sunlight(sun=DARK, zenith=(0.2, 0.5, 1.0), horizon=(1.0, 0.8, 0.6), glow=DARK)
    view = View((50.0, 0.0, 5.0), (50.0, 10.0, 0.0), fov=10.0)
    image = trace(_bar(), Ground(color=(0.3, 0.3, 0.3)), view, light, 4, 4)
    z = (np.arange(2000) + 0.5) / 2000  # the radiance depends on z alone: L = integral of 2 z L(z) dz
    sky = np.array(light.horizon) + np.sqrt(z)[:, None] * np.subtract(light.zenith, light.horizon)
    expected = 0.3 * (2 * z[:, None] * sky).mean(axis=0)
    np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), rtol=0.03)


def test_leaf_passes_light():
    """See a leaf lit from behind by albedo / pi * E * through, and black if it passes none."""
    light = Sunlight(elevation=90.0, **SUN_ONLY)
    view = View((0.0, 0.0, 0.2), (0.0, 1e-3, 1.0), fov=20.0)
    ends = np.array([[-1.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 1.0]])
    for share in (0.0, 0.6):
        leaf = Solids(*ends, np.zeros((1, 2)), np.ones((1, 3)), np.array([[0.0, 1.0, 0.0]]), np.full(1, share))
        parts = Solids.joined([leaf, _bar(height=-5.0)])
        image = trace(parts, Ground(-9.0, DARK), view, light, 4, 4)
        np.testing.assert_allclose(image, 2.0 / np.pi * share, rtol=1e-4)


def test_haze_takes_contrast_exponentially():
    """Fade black ground to the horizon's radiance by 1 - exp(-haze * distance)."""
    light = Sunlight(sun=DARK, zenith=(1.0, 1.0, 1.0), horizon=(1.0, 1.0, 1.0), inside=DARK, glow=DARK, haze=0.05)
    view = View((50.0, 0.0, 6.0), (50.0, 8.0, 0.0), fov=0.1)
    image = trace(_bar(), Ground(color=DARK), view, light, 2, 2)
    np.testing.assert_allclose(image, 1.0 - np.exp(-0.05 * 10.0), rtol=1e-3)


def test_camera_sees_a_ball_under_its_solid_angle():
    """Cover the pixels of a ball, those on its rim in part: a disc of the tangent of asin(r/d)."""
    at = np.array([[0.0, 0.0, 3.0]])
    ball = Solids.cones(at, at, np.ones((1, 2)), np.ones(3))
    even = {"zenith": (1.0,) * 3, "horizon": (1.0,) * 3, "sun": DARK, "glow": DARK}
    image = trace(ball, Ground(-50.0, (1.0,) * 3), View((0, -5, 3), (0, 0, 3), fov=60.0),
                  Sunlight(**even, haze=0.0), 200, 100, samples=64)[:45, :, 0]  # fmt: skip
    np.testing.assert_allclose(image, 1.0, atol=2e-3)  # white in white: a ball's edge adds nothing of its own
    black = Solids.cones(at, at, np.ones((1, 2)), np.zeros(3))
    image = trace(black, Ground(-50.0, (1.0,) * 3), View((0, -5, 3), (0, 0, 3), fov=60.0), Sunlight(**even), 200, 100,
                  samples=64)[..., 0]  # fmt: skip
    radius = np.tan(np.arcsin(1 / 5)) / np.tan(np.radians(30.0)) * 100
    # 64 even places a pixel miss its covered share by 0.1 at most, of either sign, in the 6 radii of rim pixels.
    assert abs((1 - image).sum() - np.pi * radius**2) < 0.1 * np.sqrt(6 * radius) + 0.01 * radius**2
    rows, columns = np.nonzero(image < 0.5)
    np.testing.assert_allclose([rows.mean(), columns.mean()], [49.5, 99.5], atol=0.5)


def test_squares_have_the_edge_that_they_should():
    """Alternate over ``tile`` metres, and fade to the plain ground far away."""
    ground = Ground(color=(0.5, 0.5, 0.5), tile=0.5, contrast=0.2)
    light = Sunlight(elevation=90.0, **SUN_ONLY)
    view = View((20.0, 0.0, 3.0), (20.0, 0.01, 0.0), fov=40.0)
    row = trace(_bar(height=-9.0), ground, view, light, 400, 4)[1, :, 0] / (1.0 / np.pi)
    assert np.isclose(row.max(), 1.2, rtol=1e-3) and np.isclose(row.min(), 0.8, rtol=1e-3)
    changes = np.flatnonzero(np.diff(np.sign(row - 1.0)))
    metre = 400 / (2 * 3.0 * np.tan(np.radians(20.0)))
    np.testing.assert_allclose(np.diff(changes), 0.5 * metre, atol=1.0)
    far = trace(_bar(height=-9.0), ground, View((20.0, 0.0, 3.0), (20.0, 500.0, 1.0), fov=0.5), light, 8, 2)
    np.testing.assert_allclose(far[-1, :, 0] * np.pi, 1.0, atol=0.05)


def test_picture_does_not_depend_on_the_threads():
    """Give the same bits for one and three threads."""
    view, light = View((3.0, -4.0, 2.0), (0.0, 0.0, 0.5)), Sunlight(haze=0.01)
    one, three = (trace(_bar(), GRAY, view, light, 48, 31, threads=t) for t in (1, 3))
    np.testing.assert_array_equal(one, three)
    assert np.isfinite(one).all()
