"""The ray tracer against closed forms: distances, Lambert's law, shadows, a camera's view of a ball."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from bough.kernels.points import raytrace
from bough.sim.pictures.render import Mesh, Sunlight, View, trace, vertex_normals

DARK = (0.0, 0.0, 0.0)
SUN_ONLY = {"zenith": DARK, "horizon": DARK, "inside": DARK, "glow": DARK, "sun": (2.0, 2.0, 2.0), "softness": 0.0}


@wp.kernel
def cast(
    surfaces: raytrace.Surfaces, origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3),
    kind_out: wp.array(dtype=int), distance_out: wp.array(dtype=float), normal_out: wp.array(dtype=wp.vec3),
    color_out: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Return what each ray meets first."""
    i = wp.tid()
    hit = raytrace.first_hit(surfaces, origin[i], direction[i])
    kind_out[i] = hit.kind
    distance_out[i] = hit.distance
    normal_out[i] = hit.normal
    color_out[i] = hit.color


@wp.kernel
def draw(normal: wp.vec3, numbers: wp.array(dtype=wp.vec2), direction_out: wp.array(dtype=wp.vec3)):
    """Turn pairs of uniform numbers into directions about ``normal``."""
    i = wp.tid()
    direction_out[i] = raytrace.cosine_direction(normal, numbers[i][0], numbers[i][1])


def _surfaces(vertices, faces, color, ground=-10.0):
    points = wp.array(np.asarray(vertices, np.float32), dtype=wp.vec3)
    mesh = wp.Mesh(points, wp.array(np.asarray(faces, np.int32).ravel(), dtype=int))
    out = raytrace.Surfaces()
    out.mesh = mesh.id
    out.normal = wp.array(vertex_normals(np.asarray(vertices), np.asarray(faces)).astype(np.float32), dtype=wp.vec3)
    out.color = wp.array(np.asarray(color, np.float32), dtype=wp.vec4)
    out.ground, out.size, out.detail, out.ground_color = ground, 1.0, 0.0, wp.vec3(0.1, 0.2, 0.3)
    return out, mesh


def _cast(surfaces, origin, direction):
    n = len(origin)
    out = [wp.full(n, -1, dtype=int), wp.full(n, float("nan"), dtype=float)]
    out += [wp.full(n, wp.vec3(float("nan")), dtype=wp.vec3) for _ in range(2)]
    rays = [wp.array(np.asarray(a, np.float32), dtype=wp.vec3) for a in (origin, direction)]
    wp.launch(cast, dim=n, inputs=[surfaces, *rays], outputs=out)
    return [a.numpy() for a in out]


def test_ray_meets_a_triangle_where_it_should():
    """Meet a triangle in x = 2 at distance 2, with the colour interpolated there; pass beside it to the ground."""
    corners = [[2.0, -1.0, 0.0], [2.0, 1.0, 0.0], [2.0, 0.0, 1.0]]
    surfaces, _keep = _surfaces(corners, [[0, 1, 2]], [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], ground=-1.0)
    down = np.array([0.6, 0.0, -0.8])
    origin = [[0, 0.2, 0.5], [0, 0, 4.0], [0, 0, 0.5], [0, 0, 0.5]]
    kind, distance, normal, color = _cast(surfaces, origin, [[1, 0, 0], down, [-1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(kind, [raytrace.MESH, raytrace.GROUND, raytrace.SKY, raytrace.SKY])
    np.testing.assert_allclose(distance[:2], [2.0, 5.0 / 0.8], rtol=1e-6)
    np.testing.assert_allclose(normal[:2], [[-1, 0, 0], [0, 0, 1]], atol=1e-6)  # towards the viewer
    np.testing.assert_allclose(color[:2], [[0.15, 0.35, 0.5], [0.1, 0.2, 0.3]], atol=1e-6)


def test_rays_meet_a_ball_at_the_closed_form_distance():
    """Meet a finely triangulated unit ball at c.d - sqrt((c.d)^2 - c.c + 1).

    A face of the icosphere of 5 subdivisions has edges up to e = 0.04, so it lies up to e^2 / 6 = 3e-4 inside the ball;
    a ray that falls in at 60 degrees or less travels twice that further.
    """
    ball = trimesh.creation.icosphere(subdivisions=5)
    centre = np.array([4.0, 1.0, 2.0])
    surfaces, _keep = _surfaces(ball.vertices + centre, ball.faces, np.ones((len(ball.vertices), 4)))
    rng = np.random.default_rng(0)
    aim = centre + rng.uniform(-0.45, 0.45, (200, 3))
    direction = aim / np.linalg.norm(aim, axis=1, keepdims=True)
    kind, distance, normal, _ = _cast(surfaces, np.zeros((200, 3)), direction)
    along = direction @ centre
    expected = along - np.sqrt(along**2 - centre @ centre + 1.0)
    assert (kind == raytrace.MESH).all()
    np.testing.assert_allclose(distance, expected, atol=8e-4)
    np.testing.assert_allclose(normal, expected[:, None] * direction - centre, atol=5e-3)


def test_sky_rays_follow_the_cosine_law():
    """Draw directions with density cos / pi: mean cosine 2/3, mean square 1/2, none below the surface.

    Means of n = 40000 draws scatter by 0.236 / sqrt(n) = 0.0012 (cosine) and 0.29 / sqrt(n) = 0.0014 (its square).
    """
    numbers = np.random.default_rng(0).uniform(size=(40000, 2)).astype(np.float32)
    normal, out = np.array([0.6, 0.0, 0.8]), wp.empty(40000, dtype=wp.vec3)
    wp.launch(draw, dim=40000, inputs=[wp.vec3(0.6, 0.0, 0.8), wp.array(numbers, dtype=wp.vec2)], outputs=[out])
    direction = out.numpy()
    cosine = direction @ normal
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-6)
    assert cosine.min() >= -1e-6
    np.testing.assert_allclose([cosine.mean(), (cosine**2).mean()], [2 / 3, 1 / 2], atol=0.006)
    sideways = direction - cosine[:, None] * normal
    np.testing.assert_allclose(sideways.mean(axis=0), 0.0, atol=0.012)


def _plate(height=1.0, half=1.0, color=0.5):
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [0, 0, height]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(corners, faces, np.full((4, 3), color), np.zeros(4), ground=0.0, size=1.0)


@pytest.mark.parametrize("elevation", [15.0, 40.0, 90.0])
def test_plane_reflects_by_lamberts_law(elevation):
    """Give the lit ground the radiance albedo / pi * E * sin(elevation)."""
    light = Sunlight(azimuth=30.0, elevation=elevation, **SUN_ONLY)
    view = View((50.0, 0.0, 5.0), (50.0, 10.0, 0.0), fov=10.0)
    image = trace(_plate(), view, light, 8, 8, samples=2, detail=0.0, ground_color=(0.2, 0.4, 0.6))
    expected = np.array([0.2, 0.4, 0.6]) / np.pi * 2.0 * np.sin(np.radians(elevation))
    np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), rtol=1e-4)


def test_shadow_lies_where_the_sun_is_hidden():
    """Darken the ground exactly under a plate of 2 m seen in a sun overhead, and nowhere else."""
    light = Sunlight(elevation=90.0, **SUN_ONLY)
    for x, lit in ((-1.2, True), (-0.8, False), (0.0, False), (0.8, False), (1.2, True)):
        view = View((x, -4.0, 0.5), (x, 0.0, 0.0), fov=0.5)  # under the plate
        image = trace(_plate(), view, light, 4, 4, samples=1, detail=0.0, ground_color=(0.5, 0.5, 0.5))
        assert (image > 0.3).all() if lit else (image == 0.0).all()


@pytest.mark.parametrize("offset", [-0.5, 0.0, 0.5])
def test_half_shadow_of_a_soft_sun(offset):
    """Light the ground near a plate's edge by the share of the sun's disc that the edge leaves free.

    At ``offset`` disc radii under the plate that is (acos d - d sqrt(1 - d^2)) / pi. The mean over 1600 pixels of 16
    fair coins scatters by 0.3 %; the picture is 1.7 cm wide, the half-shadow 1.75 m.
    """
    plate = _plate(height=10.0, half=100.0)
    plate.vertices[:, 0] += 100.0  # its edge lies over x = 0
    light = Sunlight(elevation=90.0, **{**SUN_ONLY, "softness": 5.0})
    x = offset * 10.0 * np.tan(np.radians(5.0))
    view = View((x, -1.0, 1.0), (x, 0.0, 0.0), fov=0.7)
    image = trace(plate, view, light, 40, 40, samples=16, detail=0.0, ground_color=(0.5, 0.5, 0.5))
    free = (np.arccos(offset) - offset * np.sqrt(1 - offset**2)) / np.pi
    np.testing.assert_allclose(image.mean() / (0.5 / np.pi * 2.0), free, atol=0.015)


def test_open_ground_under_an_even_sky():
    """Give ground under a sky of radiance L everywhere the radiance albedo * L, and L in the sky itself."""
    light = Sunlight(sun=DARK, zenith=(1.5, 1.5, 1.5), horizon=(1.5, 1.5, 1.5), inside=DARK, glow=DARK)
    view = View((50.0, 0.0, 1.0), (50.0, 10.0, 1.0), fov=60.0)
    image = trace(_plate(), view, light, 16, 16, samples=1, detail=0.0, ground_color=(0.2, 0.4, 0.6))
    np.testing.assert_allclose(image[:6], 1.5, rtol=1e-5)
    np.testing.assert_allclose(image[-6:], np.broadcast_to([0.3, 0.6, 0.9], (6, 16, 3)), rtol=1e-5)


def test_leaf_passes_light():
    """See a leaf lit from behind by albedo / pi * E * through, and black if it passes none."""
    light = Sunlight(elevation=90.0, **SUN_ONLY)
    view = View((0.0, 0.0, 0.2), (0.0, 1e-3, 1.0), fov=20.0)
    for share in (0.0, 0.6):
        plate = _plate(color=1.0)
        plate.through[:] = share
        image = trace(plate, view, light, 4, 4, samples=1, detail=0.0, ground_color=DARK)
        np.testing.assert_allclose(image, 2.0 / np.pi * share, rtol=1e-4)


def test_haze_takes_contrast_exponentially():
    """Fade black ground to the horizon's radiance by 1 - exp(-haze * distance)."""
    light = Sunlight(sun=DARK, zenith=(1.0, 1.0, 1.0), horizon=(1.0, 1.0, 1.0), inside=DARK, glow=DARK, haze=0.05)
    view = View((50.0, 0.0, 6.0), (50.0, 8.0, 0.0), fov=0.1)
    image = trace(_plate(), view, light, 2, 2, samples=1, detail=0.0, ground_color=DARK)
    np.testing.assert_allclose(image, 1.0 - np.exp(-0.05 * 10.0), rtol=1e-3)


def test_camera_sees_a_ball_under_its_solid_angle():
    """Count the pixels of a ball: a disc of the tangent of asin(r/d), within the pixels its rim crosses."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    scene = Mesh(
        ball.vertices + np.array([0, 0, 3]),
        ball.faces,
        np.ones(ball.vertices.shape),
        np.zeros(len(ball.vertices)),
        -50.0,
        1.0,
    )
    light = Sunlight(elevation=0.0, azimuth=-90.0, **SUN_ONLY)  # from behind the camera
    image = trace(scene, View((0, -5, 3), (0, 0, 3), fov=60.0), light, 200, 100, samples=1, detail=0.0)
    radius = np.tan(np.arcsin(1 / 5)) / np.tan(np.radians(30.0)) * 100
    seen = (image[..., 0] > 0).sum()
    assert abs(seen - np.pi * radius**2) < 2 * np.pi * radius * 0.2
    rows, columns = np.nonzero(image[..., 0] > 0)
    np.testing.assert_allclose([rows.mean(), columns.mean()], [49.5, 99.5], atol=1.0)


def test_picture_does_not_depend_on_the_threads():
    """Give the same bits for one and three threads and the same seed, and others for another seed."""
    view, light = View((3.0, -4.0, 2.0), (0.0, 0.0, 0.5)), Sunlight(haze=0.01)
    one, three, other = (
        trace(_plate(), view, light, 48, 31, samples=3, seed=s, threads=t) for s, t in ((1, 1), (1, 3), (2, 1))
    )
    np.testing.assert_array_equal(one, three)
    assert (one != other).any()
    assert np.isfinite(one).all()
