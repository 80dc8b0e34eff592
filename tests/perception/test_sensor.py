"""The sensor's clouds and scores against geometry, statistics and brute force."""

import re
from types import SimpleNamespace

import bough.sim.engine.arrays as arrays
import numpy as np
import pytest
import torch
import warp as wp
from bough.kernels.points.cloud import blur_kernel, sample_kernel
from bough.kernels.points.embedding import embed_clouds_kernel
from bough.kernels.points.nearest import finish_kernel, margin_kernel, nearest_kernel, occlusion_kernel
from bough.perception import sensor as sensor_module
from bough.perception.sensor import COLUMNS, Sensor, SensorSettings
from bough.sim.base.errors import InputError
from oracles.point_scene import embedding, point_scene, squared_distances, top_pairs_score
from scipy import stats

ROBOT, TARGET, BRANCHES = range(3)
WIDTHS = [1, 8, 16]


def make(scene, *, seed=0, noise=0.0, width=None, threads=1, columns=COLUMNS, **settings):
    """Return a sensor bound to an observation full of NaN, and the observation."""
    target = settings.pop("target", scene.line)
    sensor = Sensor(
        scene.capsules, target, scene.ee, SensorSettings(**settings), seed=seed, width=width, threads=threads
    )
    sensor.max_noise.fill_(noise)
    observation = torch.full((len(scene.start), 88), float("nan"))
    sensor.bind(observation, columns)
    return sensor, observation


def cloud(sensor, which):
    """Return a copy of one cloud, [worlds, N, 3]."""
    return sensor.clouds()[0][:, which].mT.numpy().copy()


def distance_to_axes(points, start, end):
    """Return distances [worlds, N, S] of points from the segments of their world, float64."""
    p, a, b = points[:, :, None].astype(np.float64), start[:, None].astype(np.float64), end[:, None].astype(np.float64)
    along = ((p - a) * (b - a)).sum(-1) / np.maximum(((b - a) ** 2).sum(-1), 1e-30)
    return np.linalg.norm(p - a - np.clip(along, 0, 1)[..., None] * (b - a), axis=-1)


# ---- where points lie --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", WIDTHS)
def test_points_lie_on_surfaces(width):
    """Find each point at a radius from the axis of a capsule of its own cloud, and target points on the side.

    Coordinates of 1 m are rounded to 6e-8 some ten times on the way.
    """
    scene = point_scene(5, absent=0.3)
    sensor, _ = make(scene, width=width)
    sensor.update()
    arm = scene.capsules.num_arm
    for which, part in ((ROBOT, slice(0, arm)), (BRANCHES, slice(arm, None))):
        radius = np.where(scene.radius > 0, scene.radius, np.inf)[:, None, part]
        gap = distance_to_axes(cloud(sensor, which), scene.start[:, part], scene.end[:, part]) - radius
        assert np.abs(gap).min(-1).max() < 2e-6
    start, end = scene.line.start.numpy().astype(np.float64), scene.line.end.numpy().astype(np.float64)
    d = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    relative = cloud(sensor, TARGET) - start[:, None]
    along = (relative * d[:, None]).sum(-1)
    assert np.abs(np.linalg.norm(relative - along[..., None] * d[:, None], axis=-1) - 0.05).max() < 2e-6
    assert along.min() > -2e-6 and (along.max(-1) - np.linalg.norm(end - start, axis=-1)).max() < 2e-6


def apart(worlds=1):
    """Return a scene of six branches so far apart that a point tells which it is on; the fifth is absent."""
    start = np.zeros((worlds, 8, 3), np.float32)
    start[:, :, 0] = np.arange(8) * 3.0
    axis = np.array(
        [[0, 0, 1], [0, 0, 1], [0, 0, 0.2], [0, 0.5, 0], [0.3, 0.4, -0.5], [0, 0, 0], [0, 0, 1], [0, 0, -2]]
    )
    radius = np.tile(np.array([0.1, 0.1, 0.3, 0.02, 0.1, 0.2, 0.0, 0.005], np.float32), (worlds, 1))
    end = (start + axis).astype(np.float32)
    vec = [wp.array(a, dtype=wp.vec3) for a in (start, end, start[:, 0].copy(), end[:, 0].copy())]
    capsules = SimpleNamespace(start=vec[0], end=vec[1], radius=wp.array(radius), num_arm=2)
    return SimpleNamespace(
        capsules=capsules,
        line=SimpleNamespace(start=vec[2], end=vec[3]),
        ee=vec[2],
        start=start,
        end=end,
        radius=radius,
    )


def test_points_are_shared_out_by_area():
    """Count points of 300 draws on each branch: areas 2 pi r (L + 2 r), by chi-square; none on the absent one.

    Counts of one branch over the draws vary as independent points do: binomial variance, chi-square again. Each of the
    tests fails one seed in 10,000.
    """
    scene = apart()
    sensor, _ = make(scene)
    part = slice(2, None)
    counts = []
    for _ in range(300):
        sensor.update()
        owner = np.rint(cloud(sensor, BRANCHES)[0, :, 0] / 3.0 - 0.06).astype(int) - 2
        counts.append(np.bincount(owner, minlength=6))
    counts = np.array(counts)
    length = np.linalg.norm(scene.end[0, part] - scene.start[0, part], axis=-1)
    radius = scene.radius[0, part].astype(np.float64)
    area = radius * (length + 2 * radius)
    share = area / area.sum()
    assert counts[:, 4].sum() == 0
    real = share > 0
    assert stats.chisquare(counts.sum(0)[real], share[real] * counts.sum()).pvalue > 1e-4
    scatter = ((counts[:, real] - 512 * share[real]) ** 2 / (512 * share[real] * (1 - share[real]))).sum(0)
    tails = stats.chi2(300).cdf(scatter)
    assert tails.min() > 1e-4 and tails.max() < 1 - 1e-4


def test_points_are_uniform_on_a_capsule():
    """Draw on a capsule with caps: its whole extent and the angle about it are uniform (Archimedes), and unrelated."""
    scene = apart()
    scene.capsules.radius.numpy()[:, 3:] = 0.0  # leaves one branch, the fat one: r = 0.3, L = 0.2
    sensor, _ = make(scene)
    points = []
    for _ in range(40):
        sensor.update()
        points.append(cloud(sensor, BRANCHES)[0] - scene.start[0, 2])
    x, y, z = np.concatenate(points).T.astype(np.float64)
    angle = np.arctan2(y, x)
    assert stats.kstest(z, stats.uniform(-0.3, 0.8).cdf).pvalue > 1e-4
    assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-4
    assert abs(stats.spearmanr(z, angle).statistic) < 4 / np.sqrt(len(z))
    for shift in (1, 2):  # neighbours in memory are neighbours along the axis, not about it
        assert abs(np.corrcoef(np.cos(angle[shift:]), np.cos(angle[:-shift]))[0, 1]) < 4 / np.sqrt(len(z))


def test_sphere_as_target():
    """Take start = end and round ends: points on a sphere, uniform in each coordinate."""
    scene = apart()
    sphere = SimpleNamespace(start=scene.line.start, end=scene.line.start)
    sensor, _ = make(scene, target=sphere, rounded=True, clearance=0.07, points=4096)
    sensor.update()
    points = cloud(sensor, TARGET)[0] - scene.start[0, 0]
    np.testing.assert_allclose(np.linalg.norm(points, axis=-1), 0.07, atol=2e-7)
    for axis in range(3):
        assert stats.kstest(points[:, axis], stats.uniform(-0.07, 0.14).cdf).pvalue > 1e-4


def test_target_of_several_cylinders():
    """Take ends [worlds, 2]: both are sampled, by area."""
    scene = point_scene(3)
    start, end = scene.line.start.numpy(), scene.line.end.numpy()
    both = [
        wp.array(np.stack([a, b], 1), dtype=wp.vec3)
        for a, b in ((start, start + 5), (end, start + (end - start) / 3 + 5))
    ]
    sensor, _ = make(scene, target=SimpleNamespace(start=both[0], end=both[1]), points=2048)
    sensor.update()
    far = (cloud(sensor, TARGET)[..., 0] > 3).mean()
    assert far == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / (3 * 2048)))


def test_noise_is_gaussian():
    """Compare each point with itself without noise: deviation d_max / 3 of each world, coordinates unrelated."""
    scene = point_scene(3)
    plain, _ = make(scene, points=2048)
    noisy, _ = make(scene, points=2048)
    noisy.max_noise.copy_(torch.tensor([0.0, 0.005, 0.04]))
    errors = []
    for _ in range(6):
        plain.update()
        noisy.update()
        errors.append((noisy.clouds()[0] - plain.clouds()[0]).numpy().astype(np.float64))
    errors = np.concatenate(errors, axis=-1)
    assert (errors[0] == 0).all()
    for world, most in ((1, 0.005), (2, 0.04)):
        e = errors[world] / (most / 3)
        assert e.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * e.size))
        assert stats.kstest(e.ravel(), stats.norm.cdf).pvalue > 1e-4
        correlation = np.corrcoef(e.reshape(9, -1)) - np.eye(9)
        assert np.abs(correlation).max() < 4.5 / np.sqrt(e.shape[-1])
        # a point and its partner in the other half share draws
        halves = e.reshape(3, 3, 6, 2, -1).transpose(0, 1, 3, 2, 4).reshape(18, -1)
        assert np.abs(np.corrcoef(halves) - np.eye(18)).max() < 4.5 / np.sqrt(halves.shape[-1])


# ---- draws -------------------------------------------------------------------------------------------------------


def test_draws_are_keyed_by_seed_world_and_tick():
    """Repeat a tick bit for bit; change tick, seed or world and get other points of the same scene."""
    scene = point_scene(1)

    def twice(array):
        return wp.array(np.repeat(array.numpy(), 2, 0), dtype=array.dtype)

    capsules, line = scene.capsules, SimpleNamespace(start=twice(scene.line.start), end=twice(scene.line.end))
    twins = SimpleNamespace(
        start=twice(capsules.start), end=twice(capsules.end), radius=twice(capsules.radius), num_arm=7
    )
    both = SimpleNamespace(capsules=twins, line=line, ee=twice(scene.ee), start=np.zeros(2))
    sensor, observation = make(both, noise=0.02)
    sensor.update(tick=7)
    first, seen = sensor.clouds()[0], observation.clone()
    assert sensor.tick.tolist() == [8, 8]
    assert not torch.isclose(first[0], first[1], atol=1e-5).any(-1).all()
    sensor.update()
    assert (sensor.clouds()[0] != first).float().mean() > 0.99
    sensor.update(observation, tick=torch.tensor([7, 7], dtype=torch.int32))
    assert torch.equal(sensor.clouds()[0], first) and torch.equal(observation.nan_to_num(), seen.nan_to_num())
    other, _ = make(both, noise=0.02, seed=1)
    other.update(tick=7)
    assert (other.clouds()[0] != first).float().mean() > 0.99


def test_numbers_of_worlds_and_ticks_are_unrelated():
    """Correlate the noise of neighbouring worlds, ticks and points: nothing beyond chance."""
    scene = point_scene(64)
    plain, _ = make(scene)
    noisy, _ = make(scene, noise=0.03)
    errors = []
    for _ in range(3):
        plain.update()
        noisy.update()
        errors.append((noisy.clouds()[0] - plain.clouds()[0]).flatten(1).double().numpy() / 0.01)
    e = np.stack(errors)  # ticks, worlds, numbers
    for a, b in ((e[1:], e[:-1]), (e[:, 1:], e[:, :-1]), (e[..., 1:], e[..., :-1])):
        assert abs((a * b).mean()) < 4.5 / np.sqrt(a.size)


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_bits(threads):
    """Split 17 worlds over threads: every output keeps its bits."""
    results = []
    for count in (1, threads):
        sensor, observation = make(point_scene(17), noise=0.02, threads=count)
        for _ in range(3):
            sensor.update()
        results.append((observation.nan_to_num(), sensor.clouds()[0], sensor.occlusion, sensor.distances))
    assert all(map(torch.equal, *results))


@pytest.mark.parametrize("threads", [1, 2])
def test_blocks_do_not_change_bits(monkeypatch, threads):
    """Take 17 worlds through the same rows of memory, 4 at a time: every output keeps its bits."""
    results = []
    for block in (32, 4):
        monkeypatch.setattr(sensor_module, "_BLOCK", block)
        sensor, observation = make(point_scene(17), noise=0.02, threads=threads)
        for _ in range(3):
            sensor.update()
        results.append((observation.nan_to_num(), sensor.clouds()[0], sensor.occlusion, sensor.distances))
    assert all(map(torch.equal, *results))
    assert sensor.nbytes <= threads * 4 * 32 * 1024  # of rows, not of worlds


@pytest.mark.parametrize("points", [16, 48, 512])
def test_widths_agree(points):
    """Draw with 1, 8 and 16 lanes: points differ by rounding of running sums only, scores by what these move."""
    results = []
    for width in WIDTHS:
        sensor, observation = make(point_scene(9), noise=0.02, width=width, points=points)
        sensor.update()
        results.append((sensor.clouds()[0], observation[:, 16:80].clone(), sensor.distances))
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            torch.testing.assert_close(a, b, rtol=0, atol=2e-5)


# ---- what is computed from them ----------------------------------------------------------------------------------


def near_scene(worlds):
    """Return a scene whose line passes 0 to 0.25 m from the hand, so that half of the worlds are in breach."""
    scene = point_scene(worlds)
    start = scene.end[:, 6] + np.linspace([0.0, -0.4, 0.05], [0.0, -0.4, 0.3], worlds)
    scene.line.start.assign(start.astype(np.float32))
    scene.line.end.assign((start + np.array([0.0, 1.0, 0.0])).astype(np.float32))
    return scene


@pytest.mark.parametrize("points", [512, 1040])  # 1040 fill neither groups of chunks nor groups of groups
@pytest.mark.parametrize("width", WIDTHS)
def test_outputs_equal_brute_force(width, points):
    """Recompute everything from the clouds: embeddings in float64, pairs and distances by looking at them all."""
    scene = near_scene(8)
    threshold = 0.035 if points == 512 else 0.02
    sensor, observation = make(scene, noise=0.01, width=width, threshold=threshold, points=points)
    sensor.update()
    robot, target, branches = (cloud(sensor, k) for k in range(3))
    waves = sensor.frequencies.numpy()
    axis = distance_to_axes(branches, scene.line.start.numpy()[:, None], scene.line.end.numpy()[:, None])[..., 0]
    np.testing.assert_array_equal(sensor.clouds()[1].numpy() > 0, axis < 0.3)
    expected = {"rob": embedding(robot, waves), "clr": embedding(target, waves), "wbr": embedding(branches, waves),
                "zbr": embedding(branches, waves, sensor.clouds()[1].numpy() > 0)}  # fmt: skip
    for name, value in expected.items():
        columns = observation[:, COLUMNS[name] : COLUMNS[name] + 16]
        np.testing.assert_allclose(columns, value, rtol=0, atol=2e-6, err_msg=name)
    hand = squared_distances(scene.ee.numpy()[:, None], branches)[:, 0]
    np.testing.assert_array_equal(sensor.distances, np.sqrt(np.sort(hand, -1)[:, :5]))
    assert torch.equal(observation[:, 81:86], sensor.distances)
    seen, true = (scores(sensor.clouds(noise=noise)[0], threshold) for noise in (True, False))
    for found, (occlusion, breach) in (((observation[:, 87], observation[:, 86]), seen),
                                       ((sensor.occlusion, sensor.breach), true)):  # fmt: skip
        np.testing.assert_array_equal(found[0], occlusion)
        assert ((occlusion > 0) & (occlusion < 1)).sum() > 2
        np.testing.assert_array_equal(found[1].numpy() > 0, breach)
        assert 0 < breach.mean() < 1
    assert (seen[0] != true[0]).sum() > 2


def scores(points, threshold):
    """Return occlusion and breach of clouds [worlds, 3, 3, N] by looking at all pairs."""
    robot, target, branches = (points[:, k].mT.numpy() for k in range(3))
    score = [top_pairs_score(squared_distances(b, t), 200, threshold) for b, t in zip(branches, target, strict=True)]
    pairs = [np.sqrt(np.sort(squared_distances(r, t).ravel())[:5]).mean() for r, t in zip(robot, target, strict=True)]
    return np.array(score, np.float32), np.array(pairs) < 0.04


def test_noise_is_seen_and_not_scored():
    """Hold a branch 11 cm off the line's surface and the arm 5 cm: noise shows pairs below 10 and 4 cm; none is scored.

    Without noise what is seen is what is scored.
    """
    start, end = np.zeros((2, 3, 3), np.float32), np.zeros((2, 3, 3), np.float32)
    start[..., 0] = [0.0, 0.2, -0.17]  # the line's, the arm's and the branch's
    end[..., 0], end[..., 2] = start[..., 0], 1.0
    ends = [wp.array(x[:, 1:].copy(), dtype=wp.vec3) for x in (start, end)]
    radius = wp.array(np.tile(np.float32([0.1, 0.01]), (2, 1)))
    line = SimpleNamespace(**{n: wp.array(x[:, 0].copy(), dtype=wp.vec3) for n, x in (("start", start), ("end", end))})
    capsules = SimpleNamespace(start=ends[0], end=ends[1], radius=radius, num_arm=1)
    sensor, observation = make(SimpleNamespace(capsules=capsules, line=line, ee=line.start, start=start))
    sensor.max_noise.copy_(torch.tensor([0.0, 0.04]))
    for _ in range(5):
        sensor.update()
        assert sensor.occlusion.tolist() == sensor.breach.tolist() == [0.0, 0.0]
        assert observation[0, 86:].tolist() == [0.0, 0.0]
        assert observation[1, 87] > 0.1 and observation[1, 86] == 1.0


def test_permuted_clouds_give_the_same_embedding():
    """Embed the sensor's points in random order through the loose function: equal to 1e-6."""
    from bough.perception import embed

    sensor, observation = make(point_scene(6), noise=0.02)
    sensor.update()
    order = torch.randperm(512, generator=torch.Generator().manual_seed(0))
    shuffled = sensor.clouds()[0][:, BRANCHES].mT[:, order]
    assert (embed(shuffled) - observation[:, 16:32]).abs().max() < 1e-6
    assert (embed(shuffled, mask=sensor.clouds()[1][:, order] > 0) - observation[:, 32:48]).abs().max() < 1e-6


def test_worlds_without_branches():
    """Leave some worlds no branch: embeddings and occlusion 0, distances the farthest; the others keep their bits."""
    scene = point_scene(4)
    full, seen = make(scene, noise=0.02)
    full.update()
    scene.capsules.radius.numpy()[1, 7:] = 0.0
    sensor, observation = make(scene, noise=0.02)
    sensor.update()
    assert (observation[1, 16:48] == 0).all() and sensor.occlusion[1] == 0
    assert (sensor.distances[1] == 10.0).all()
    rest = [0, 2, 3]
    assert torch.equal(observation[rest, 16:80], seen[rest, 16:80])
    assert not observation[:, 16:80].isnan().any()


# ---- memory ------------------------------------------------------------------------------------------------------


def test_only_named_columns_are_written():
    """Name two groups: their columns are written, all others keep NaN; true scores come all the same."""
    sensor, observation = make(point_scene(5), columns={"clr": 3, "breach": 87})
    sensor.update()
    written = ~observation.isnan().all(0)
    assert written.nonzero().flatten().tolist() == [*range(3, 19), 87]
    assert sensor.occlusion.max() > 0 and (sensor.distances > 0).all()


def test_wide_observation_of_warp():
    """Write into a Warp array that torch sees."""
    memory = wp.full((5, 100), float("nan"), dtype=wp.float32)
    sensor, observation = make(point_scene(5))
    sensor.update(memory, tick=0)
    sensor.update(observation, tick=0)
    assert torch.equal(wp.to_torch(memory)[:, 16:80], observation[:, 16:80])


def test_outputs_are_the_kernels_memory(monkeypatch):
    """Run updates with every way of making a Warp array or a tensor closed: nothing is allocated, nothing copied."""
    sensor, observation = make(point_scene(6), noise=0.01, threads=2)
    memory = sensor._clouds
    views = (sensor.occlusion, sensor.breach, sensor.distances, memory.points, memory.near, sensor.tick, observation)
    pointers = [v.data_ptr() for v in views]
    assert memory.points.data_ptr() == memory.kernel.flat.ptr == memory.kernel.point.ptr

    def closed(*_args, **_kwargs):
        raise AssertionError("allocated or copied")

    for owner, name in ((wp.array, "__init__"), (wp, "copy"), (wp, "to_torch"), (wp, "from_torch"), (torch, "empty")):
        monkeypatch.setattr(owner, name, closed)
    before = observation[:, 16:].clone()
    for _ in range(3):
        sensor.update()
    assert [v.data_ptr() for v in views] == pointers
    assert not torch.equal(before, observation[:, 16:]) and sensor.tick.tolist() == [3] * 6


def test_graph_replays_the_same_bits():
    """Capture one update and replay it: the same numbers as updates outside, tick after tick."""
    results = []
    for captured in (False, True):
        sensor, observation = make(point_scene(6), noise=0.02, threads=2)
        sensor.update()
        sensor.tick.zero_()
        run = sensor.update
        if captured:
            with wp.ScopedCapture() as scope:
                sensor.update()
            sensor.tick.zero_()

            def run(graph=scope.graph):
                wp.capture_launch(graph)

        history = []
        for _ in range(3):
            run()
            history.append(observation[:, 16:].nan_to_num().clone())
        results.append(torch.stack(history))
    assert torch.equal(*results) and not torch.equal(results[0][0], results[0][1])


# ---- a GPU, without one ------------------------------------------------------------------------------------------


def test_memory_order_of_a_gpu_gives_the_same_bits(monkeypatch):
    """Lay clouds out with worlds innermost and share each world's pairs among 32 threads, as on a GPU."""
    results = []
    for flipped in (False, True):
        monkeypatch.setattr(arrays, "link_major", lambda device, value=flipped: value)
        sensor, observation = make(near_scene(5), noise=0.02, width=1)
        sensor.update()
        assert sensor._count.shape[1] == (32 if flipped else 1)
        results.append((observation.nan_to_num(), sensor.clouds()[0], sensor.clouds()[1], sensor.breach))
    assert all(map(torch.equal, *results))


@pytest.mark.parametrize("name", ["sample", "blur", "embed", "occlusion", "nearest", "margin", "finish"])
def test_compiles_for_a_gpu(name, tmp_path):
    """Compile for sm_90, in float32 throughout."""
    kernel = {"sample": sample_kernel(1), "blur": blur_kernel(1), "embed": embed_clouds_kernel(1),
              "occlusion": occlusion_kernel(1), "nearest": nearest_kernel(1), "margin": margin_kernel(1),
              "finish": finish_kernel}[name]  # fmt: skip
    paths = wp.compile_aot_module(kernel.module, arch=90, module_dir=tmp_path, use_ptx=True)
    text = next(p for p in paths if p.suffix == ".ptx").read_text()
    assert ".entry" in text and not re.search(r"(?:add|mul|fma|div|sqrt)\S*\.f64", text)


# ---- bad input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"points": 100}, "points: found 100; allowed: a multiple of 16"),
        ({"margin": 0.0}, "margin: found 0.0; allowed: a number above zero"),
        ({"bandwidth": float("nan")}, "bandwidth: found nan"),
    ],
)
def test_bad_settings(settings, message):
    """Name the setting and what is allowed."""
    with pytest.raises(InputError, match="sensor") as error:
        SensorSettings(**settings)
    assert message in str(error.value)


def test_memory_of_another_device_is_refused():
    """Bind what lies on a GPU to a sensor on the CPU: its kernels would write to wild addresses."""
    sensor, _ = make(point_scene(2))
    elsewhere = SimpleNamespace(shape=(2, 88), device="cuda:0", ptr=1)
    with pytest.raises(InputError, match=r"sensor: observation: found memory of cuda:0; allowed: memory of cpu"):
        sensor.bind(elsewhere)


def test_bad_columns():
    """Refuse groups that do not exist and columns beyond the tensor."""
    sensor, _ = make(point_scene(2))
    with pytest.raises(InputError, match="found touch; allowed: rob, clr"):
        sensor.bind(torch.zeros(2, 88), {"touch": 80})
    with pytest.raises(InputError, match="found columns 80 to 95 of"):
        sensor.bind(torch.zeros(2, 88), {"rob": 80})
    with pytest.raises(InputError, match=r"of \[3, 88\]"):
        sensor.bind(torch.zeros(3, 88))
