"""Chapter 3 again: scores against scipy and by hand, samplers' calls counted, the command as a user types it."""

import html
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
import tyro
from bough.cli.reproduce import Reproduce
from bough.learn.reports.page import KeyNumber, ReportContent, ReportTable, write_report
from bough.learn.thesis.chapter3 import baselines, figures, literal, prior, robust
from bough.learn.thesis.chapter3 import bench as bench_module
from bough.learn.thesis.chapter3 import report as chapter3_report
from bough.learn.thesis.chapter3.bench import KT, Bench, Scores
from bough.learn.thesis.chapter3.cost import Cost, exponent, linear_fit
from bough.learn.thesis.chapter3.report import beaten, letter_says, ranking
from bough.learn.thesis.chapter3.reproduce import Findings, Options
from bough.sim.base.console import start_warp
from bough.sim.base.errors import InputError
from oracles import json_page
from scipy import stats

#: Samples of a record where the whole chapter is run.
SAMPLES = 16


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """One branch of two segments with three unseen trajectories."""
    start_warp()
    return Bench(tmp_path_factory.mktemp("bench"), 4, segments=2, unseen=3)


def test_true_springs_explain_their_own_records(bench):
    """Find no loss at the truth beyond what nine printed digits lose, and springs that fall from base to tip."""
    target = bench.target()
    loss = -target.log_likelihood(target.predict(bench.truth[None]), torch.zeros(1, 0)) * KT
    # 5 records, 120 samples of 2 + 2 channels below 1 in float32: at most 5 sqrt(480) 1e-6
    assert 0.0 <= float(loss) < 1e-4
    assert (bench.truth[:2].diff() < 0).all() and (bench.truth[2:].diff() < 0).all()


def test_scores_are_those_of_a_kernel_density(bench):
    """Agree with scipy's Gaussian kernel density (Scott) on the interval, and with numpy's norms on the loss."""
    theta = bench.uniform(16, 0)
    low, high = bench.predictive(theta)
    clean = bench.target(chosen=bench.unseen).predict(theta)[..., [0, 2]].numpy()
    for place in ((0, 40, 1), (2, 90, 0)):
        density = stats.gaussian_kde(clean[(slice(None), *place)], "scott")
        # the quantiles are bisected to 1e-12 of the spread; the bandwidth is widened by 1e-9 m
        assert density.integrate_box_1d(-np.inf, float(low[place])) == pytest.approx(0.025, abs=1e-6)
        assert density.integrate_box_1d(-np.inf, float(high[place])) == pytest.approx(0.975, abs=1e-6)
    scores = bench.score(theta, kt=0.5)
    truth = np.stack([r.output[:, [0, 2]] for r in bench.unseen])
    assert scores.outside == np.mean((truth < low.numpy()) | (truth > high.numpy()))
    assert scores.width == pytest.approx(float((high - low).mean()))
    error = np.stack([r.output for r in bench.train]) - bench.target().predict(theta).numpy()
    norms = np.sqrt((error[..., :3] ** 2).sum((2, 3))) + np.sqrt((error[..., 3:] ** 2).sum((2, 3)))
    assert scores.nll == pytest.approx(norms.sum(1).mean() / 0.5, rel=1e-6)
    np.testing.assert_allclose(scores.spread, theta.numpy().std(0, ddof=1))


def test_energy_distance_is_scipys():
    """Agree in one dimension with scipy, which gives the root."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=30), rng.normal(1.0, 2.0, size=200)
    mine = baselines.energy_distance(torch.tensor(x)[:, None], torch.tensor(y)[:, None])
    assert mine == pytest.approx(stats.energy_distance(x, y) ** 2, rel=1e-10)


def test_calls_are_rollouts(bench):
    """Count one call for each particle, offset and trajectory where no world is padding."""
    target = bench.target()
    before = baselines.calls_of(target)
    target.evaluate(bench.uniform(16, 0))  # 16 x (1 + 2 x 4) sets fill whole vectors
    assert baselines.calls_of(target) - before == 16 * 9 * 5


def test_random_walk_never_adapts():
    """Propose with the given step from first to last; at a step far below the scale nearly everything is accepted."""
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(200, 2, generator=generator, dtype=torch.float64)
    walk = baselines.RandomWalk(start, iterations=40, seed=1, step=0.01)
    normal = stats.multivariate_normal(np.zeros(2))

    class Normal:
        def log_density(self, x):
            return torch.tensor(normal.logpdf(x.numpy()))

    trace = torch.stack([walk.step(Normal()).clone() for _ in range(40)])
    moves = torch.cat([trace[:1] - start, trace.diff(dim=0)]).flatten()
    moved = moves[moves != 0.0]
    assert len(moved) > 0.95 * len(moves)
    # 15,000 moves: the deviation's standard error is 0.6 %; acceptance bends it by far less
    assert float(moved.std()) == pytest.approx(0.01, rel=0.04)
    assert torch.equal(walk.factor, 0.01 * torch.eye(2, dtype=torch.float64))


def test_reference_is_resampled_by_weight():
    """Turn draws of N(0, 1) into draws of N(1, 1) by the ratio of the densities, exp(x)."""
    flat = torch.randn(200_000, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    made = baselines._reference(flat, torch.softmax(flat[:, 0], 0), 1.0, particles=32, seed=0)
    # 1024 draws: the mean's standard error is 0.03, the deviation's 0.02
    assert float(made.draws.mean()) == pytest.approx(1.0, abs=0.12)
    assert float(made.draws.std()) == pytest.approx(1.0, abs=0.09)
    assert made.distance(made.draws) < 1e-9 < made.exact
    assert made.worst_mean(made.draws + 2.0 * made.draws.std()) == pytest.approx(2.0)
    # a shift by s deviations costs about s^2 / sqrt(pi) for small s, and exact draws some 2 / sqrt(pi) / 32
    assert made.exact == pytest.approx(2.0 / math.sqrt(math.pi) / 32, rel=0.5)


def test_line_and_power_of_exact_data():
    """Recover slope and power of exact lines and powers; a square is no line."""
    line = [Cost(n, 0.1 + 0.02 * n, n) for n in (1, 2, 5)]
    square = [Cost(n, 0.3 * n**2, n) for n in (1, 2, 4, 8)]
    assert linear_fit(line) == pytest.approx((0.02, 1.0))
    assert exponent(square) == pytest.approx(2.0) and linear_fit(square)[1] < 0.97


def entry(method, distance, nll, width, origin="prior", branch=0):
    scores = Scores(width, 0.0, nll, (1.0,))
    return baselines.Entry(branch, origin, method, 1.0, 100, scores, distance, 0.0, torch.zeros(1, 1))


def reference(r_hat):
    return baselines.Reference(torch.zeros(4, 1), torch.eye(1), r_hat, 1.0)


def test_beating_takes_all_three_measures():
    """Count as beaten only a rival from the same kind of start that is worse in distance, NLL and width alike."""
    entries = [entry(name, 1.0, 5.0, 0.001) for name in ("SVGD", "NNSVGD")]
    entries += [entry("SGLD", 1.0, 60.0, 0.001), entry("SGHMC", 1.0, 5.0, 0.02)]
    entries += [entry("MH, adaptive", 30.0, 50.0, 0.01), entry("MH, step 5 %", 90.0, 70.0, 0.005)]
    entries += [entry(name, 2.0, 5.0, 0.001, "modes") for name in baselines.GRADIENT]
    entries += [entry("MH, adaptive", 1.5, 5.0, 0.001, "modes")]
    found = Findings(Options(), [], entries=entries, references=[reference(1.01)])
    assert beaten(found, "prior") == (["SVGD", "NNSVGD"], ["SGLD", "SGHMC"])
    assert beaten(found, "modes") == ([], list(baselines.GRADIENT))
    assert "2 of 4 from the prior, 0 of 4 from the modes" in ranking(found)


def test_nobody_is_ranked_by_chains_that_disagree():
    """Leave a branch out whose reference has an R-hat of 1.05 or more; rank nobody where all have."""
    entries = [entry(name, 9.0, 9.0, 0.9) for name in baselines.GRADIENT] + [entry("MH, adaptive", 1.0, 1.0, 0.1)]
    entries += [entry(name, 1.0, 1.0, 0.1, branch=1) for name in baselines.GRADIENT]
    entries += [entry("MH, adaptive", 9.0, 9.0, 0.9, branch=1)]
    found = Findings(Options(branches=2), [], entries=entries, references=[reference(1.3), reference(1.04)])
    assert beaten(found, "prior") == (list(baselines.GRADIENT), [])
    found.references = [reference(1.3), reference(1.05)]
    assert beaten(found, "prior") == ([], [])
    assert ranking(found) == "no ranking of samplers: R-hat 1.3"
    table = chapter3_report._samplers(found)
    assert all(row[-2:] == ("no ranking", "no ranking") for row in table.rows)
    assert "No ranking of samplers: r-hat 1.3".lower() in table.note.lower() and "Better" not in table.note


def test_all_samplers_start_from_the_same_places(bench, monkeypatch):
    """Hand every method, with gradients or without, the same start positions, from the prior and from the modes."""
    seen = []

    def spy(theirs):
        def make(*arguments, **options):
            seen.append(next(a for a in arguments if torch.is_tensor(a)).clone())
            return theirs(*arguments, **options)

        return make

    monkeypatch.setattr(baselines, "make_sampler", spy(baselines.make_sampler))
    monkeypatch.setattr(baselines, "RandomWalk", spy(baselines.RandomWalk))
    monkeypatch.setattr(baselines, "MODE_STARTS", 2)
    entries, found = baselines.compare(
        bench, 0, (1.0,), particles=16, iterations=2, reference=20, seed=0, advance=lambda: None
    )
    methods = len(baselines.GRADIENT) + len(baselines.WALKS) + 1
    assert [e.origin for e in entries] == ["prior"] * methods + ["modes"] * methods
    assert all(torch.equal(first, bench.uniform(16, 0)) for first in seen[:methods])
    start = baselines._start(bench, "modes", 16, 0)
    whitened = start.density(bench.target())
    for e, first in zip(entries[methods:], seen[methods:], strict=True):
        plain = first if "step" in e.method else whitened.theta(first)
        torch.testing.assert_close(plain, start.theta)
        assert e.calls > start.calls > 0
    assert found.worst_r_hat > 1.05 and not found.settled  # twenty iterations


class Bell:
    """A normal density of known mean and deviations, as the reference asks a target for one."""

    mean, deviation = torch.tensor([1.0, -2.0, 0.5]).double(), torch.tensor([0.1, 3.0, 1.0]).double()

    def log_density(self, x):
        return -0.5 * (((x - self.mean) / self.deviation) ** 2).sum(-1)


def test_reference_walks_until_its_chains_agree():
    """Draw a normal density from starts far too wide; stop at an R-hat below 1.05, with its mean and deviations."""
    generator = torch.Generator().manual_seed(0)
    start = Bell.mean + 5.0 * Bell.deviation * torch.randn(12, 3, generator=generator, dtype=torch.float64)
    trace, worst = baselines._walk(Bell(), start, 6000, 0)
    assert worst < 1.05 and len(trace) < 3000
    flat = trace.flatten(0, 1)
    # some 500 independent draws: standard errors of 5 % of a deviation, and 3 % of it
    assert float(((flat.mean(0) - Bell.mean) / Bell.deviation).abs().max()) < 0.2
    np.testing.assert_allclose(flat.std(0) / Bell.deviation, 1.0, atol=0.12)
    short, far = baselines._walk(Bell(), start, 20, 0)
    assert far > 1.05 and len(short) == 10


def test_reference_starts_about_the_truth_and_wider_than_the_posterior(bench):
    """Begin at the true springs, twice as wide as numpy's linearisation there says."""
    target = bench.target()
    x = baselines._overdispersed(target, bench.truth, 4000, 0)
    _, slopes = target.linearise(bench.truth[None])
    scale = np.array([1e-3, 1e-3, 1e-2, 1e-2])[:, None, None]
    rows = (slopes[0].numpy()[..., [0, 2, 3, 5]].transpose(3, 1, 2, 0) / scale[..., None]).reshape(-1, 4)
    wanted = np.linalg.inv(rows.T @ rows + np.eye(4))
    np.testing.assert_allclose(x.mean(0), bench.truth, atol=4 * float(x.std(0).max()) / 4000**0.5)
    np.testing.assert_allclose(np.cov(x.numpy().T) / 4.0, wanted, rtol=0.1, atol=0.1 * np.abs(wanted).max())


# ---- by the letter ------------------------------------------------------------------------------------------------


def test_letter_direction_is_the_formula():
    """Agree with eq. 2.22 summed by hand, sigma the median of the distances."""
    rng = np.random.default_rng(0)
    x, g = rng.normal(100.0, 30.0, (7, 3)), rng.normal(size=(7, 3))
    sigma = np.median([np.linalg.norm(x[i] - x[j]) for i in range(7) for j in range(i)])
    wanted = np.zeros_like(x)
    for i in range(7):
        for j in range(7):
            k = np.exp(-np.sum((x[j] - x[i]) ** 2) / (2 * sigma**2))
            wanted[i] += (k * g[j] - k * (x[j] - x[i]) / sigma**2) / 7
    np.testing.assert_allclose(literal.direction(torch.tensor(x), torch.tensor(g)), wanted, rtol=1e-12)


def test_letter_gradient_is_of_springs_not_logarithms(bench):
    """Agree with the published loss taken 0.5 N m/rad either way, one spring at a time, and with the box outside it."""
    target = bench.target()
    x = torch.tensor([[120.0, 60.0, 90.0, 40.0], [210.0, 50.0, 30.0, 20.0]]).double()
    found = literal.gradient(target, x, (0.5, None))
    for i in range(4):
        step = torch.zeros(4).double()
        step[i] = 0.5
        ends = [target.log_likelihood(target.predict((x + s * step).log()), torch.zeros(2, 0)) for s in (1, -1)]
        wanted = ends[0] - ends[1]
        wanted[1] -= (10.0 / 0.5**2) if i == 0 else 0.0
        # one part in 1e3: worlds are packed into other lanes, and losses are single precision
        torch.testing.assert_close(found[:, i], wanted, rtol=1e-3, atol=1e-2)


def test_letter_prior_is_eq_3_17_per_newton_metre():
    """Cost eta times the difference where a child is above its parent, nothing where it is below."""
    x = torch.tensor([[150.0, 30.0], [100.0, 130.0], [20.0, 190.0], [60.0, 50.0]]).double()
    found = literal.log_prior(x, [(0, 1)], (1.0, 3.0))
    level = float(literal.log_prior(torch.tensor([199.0, 6.0]).double(), [(0, 1)], (1.0, 3.0)))
    # the network rounds the kink off over some N m/rad
    np.testing.assert_allclose(found - level, [0.0, -90.0, -510.0, 0.0], atol=3.0 * 3.0)
    assert not literal.log_prior(x, [(0, 1)], (1.0, None)).any()


def test_letter_steps_are_adam_s(bench):
    """Start in the box and move every spring and damper by 3.0 in the first step."""
    first, second = (literal.follow(bench.target(), (1.0, 10.0), particles=8, marks=(n,), seed=3)[0] for n in (1, 2))
    low, high = literal.BOX
    rng = torch.Generator().manual_seed(3)
    start = low + (high - low) * torch.rand(8, 4, generator=rng, dtype=torch.float64)
    np.testing.assert_allclose((first - start).abs(), 3.0, rtol=1e-5)
    # twice as far after two, but for what the momentum adds where gradients change
    assert float((second - start).abs().max()) < 6.1


def test_gains_and_their_intervals():
    """Divide seed by seed, and agree with scipy's t-test on logarithms; one seed has no interval."""

    def scores(widths):
        return [[Scores(w, 0.0, 10.0 * w, (1.0,))] for w in widths]

    (gain,) = literal.gains({(1.0, None): scores([2.0, 3.0, 4.0]), (1.0, 10.0): scores([1.0, 2.0, 2.0])}, (70,))
    np.testing.assert_allclose(gain.width, [2.0, 1.5, 2.0])
    middle, low, high = literal.interval(gain.width)
    wanted = stats.ttest_1samp(np.log(gain.width), 0.0).confidence_interval(0.95)
    np.testing.assert_allclose([middle, low, high], [6.0 ** (1 / 3), *np.exp(wanted)], rtol=1e-10)
    assert literal.interval(np.array([1.5])) == (pytest.approx(1.5), 0.0, math.inf)


def test_what_the_letter_may_conclude():
    """Call a gain beyond doubt, or the thesis's factor reached, by intervals alone."""
    sure, vague = np.array([1.70, 1.75, 1.73]), np.array([0.8, 1.5, 1.2])
    said = letter_says([literal.Gain(1.0, 10.0, 70, vague, vague), literal.Gain(1.0, 100.0, 200, sure, sure)])
    assert "width: the prior gains beyond doubt in 1 of 2 rows; the thesis's 1.73 is inside" in said
    assert "eta 100 at 200" in said
    narrow = np.array([1.10, 1.11, 1.12])
    assert letter_says([literal.Gain(1.0, 10.0, 70, narrow, narrow)]).count("outside every interval") == 2


def test_table_and_figures_of_made_up_runs():
    """Write ratios with their intervals beside the plain run's 1, and draw both kinds of start and every variant."""

    def scores(width):
        return [[Scores(f * width, 0.0, 1e4 * f * width, (1.0,)) for _ in literal.MARKS] for f in (1.0, 1.1, 0.9)]

    found = Findings(Options(), [])
    found.letter = {(s, eta): scores(0.1 if eta is None else 0.05) for s in literal.BOX_SIGMAS
                    for eta in (None, *literal.ETAS)}  # fmt: skip
    table = chapter3_report._letter(found)
    assert len(table.rows) == len(literal.MARKS) * len(found.letter)
    assert {row[-1] for row in table.rows} == {"1", "2.00 (2.00 to 2.00)"}
    gains = {"eta 10": [(1.2, 1.1, 1.3), (1.5, 0.0, math.inf)]}
    wide = np.array([[1.0, 1.1], [1.2, 1.3]])
    assert len(figures.sweep_figure((0.01, 1.0), wide, wide, wide, (70, 200), gains).axes) == 3
    curve = ([1e3, 2e3], [3.0, 2.0], [0.01, 0.002])
    drawn = figures.calls_figure({"from the prior": {"SVGD": curve}, "from the modes": {"SVGD": curve}}, reference=1.3)
    names = [f"{name}, {origin}" for origin in baselines.ORIGINS for name in "abcde"]
    band = (np.zeros(3), np.ones(3))
    groups = {o: {n: band for n in names if o in n} for o in baselines.ORIGINS}
    bands = figures.baseline_figure(np.arange(3.0), np.ones(3), groups, width=dict.fromkeys(names, 0.1))
    assert [ax.get_title().split("\n")[0] for ax in bands.axes[::2]] == names
    rows = [ax.get_subplotspec().rowspan.start // 2 for ax in bands.axes[::2]]
    assert rows == [0, 0, 0, 0, 1, 2, 2, 2, 2, 3]  # the second kind of start begins on a row of its own
    assert len(drawn.axes) == 4 and "R-hat 1.3" in drawn.axes[0].get_title()


def test_tables_are_drawn_and_escaped(tmp_path):
    """Show every cell of a plain table as text; refuse a row that does not fit its header."""
    table = ReportTable("Widths <1>", ("run", "cm"), [("a & b", 1.2345), ("c", 7)], "Why <so>.")
    page = ReportContent("t", "h", "good", [KeyNumber("n", 1.0, "", "e")], tables=[table])
    text = write_report(tmp_path, page).read_text()
    for part in ("Widths &lt;1&gt;", "a &amp; b", '"cm">1.23</td>', '"cm">7</td>', "Why &lt;so&gt;."):
        assert part in text
    with pytest.raises(ValueError, match="row 1: 1 cells under 2 headings"):
        ReportTable("t", ("a", "b"), [(1, 2), (1,)])


@pytest.mark.parametrize(("option", "value"), [("particles", 4), ("iterations", 71), ("branches", 0), ("seed", -1)])
def test_bad_options_are_refused_in_one_line(tmp_path, option, value):
    """Name the option, what was found and what is allowed, and write nothing."""
    command = command_of(tmp_path / "out", f"--{option}", str(value))
    with pytest.raises(InputError, match=rf"^reproduce: --{option}: found {value}; allowed: \d+ ") as caught:
        command.run()
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()


def command_of(out, *options):
    arguments = ["chapter3", "--out", str(out), *options]
    return tyro.cli(Reproduce, args=arguments, config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone))


@pytest.fixture
def sparse(monkeypatch):
    """Keep of every sweep's values the ends, and what the report singles out; few samples."""
    for module in (prior, chapter3_report):
        monkeypatch.setattr(module, "TEMPERATURES", (prior.KT, prior.ETA_KT, prior.TEMPERATURES[-1]))
    monkeypatch.setattr(robust, "NOISES", (robust.NOISES[0], robust.NOISES[-1]))
    monkeypatch.setattr(literal, "SEEDS", 2)
    monkeypatch.setattr(literal, "ETAS", (100.0,))
    monkeypatch.setattr(bench_module, "PUSH", replace(bench_module.PUSH, samples=SAMPLES))
    monkeypatch.setitem(robust.make_case.__kwdefaults__, "samples", SAMPLES)
    for module in (robust, literal):
        monkeypatch.setattr(module, "STAND_INS", tuple((*s[:2], SAMPLES, s[3]) for s in module.STAND_INS))


def test_command_writes_everything(tmp_path, capsys, sparse):
    """Write the page with every table and figure inside, numbers in tables.json, and say where; tiny, so no verdicts.

    Ten iterations are too few to converge, which the exit code says.
    """
    out = tmp_path / "made" / "here"
    sizes = ("--particles", "12", "--iterations", "10", "--branches", "1", "--unseen", "3")
    code = command_of(out, *sizes).run()
    said = capsys.readouterr().out
    assert said.count("\n") == 1 and "report.html" in said
    kept = json.loads((out / "tables.json").read_text())
    names = {"table_3_1", "table_3_1_sweep", "table_3_1_letter", "figure_3_5", "figure_3_6", "figure_3_7",
             "figure_3_8", "figure_3_9", "table_a_1", "cost"}  # fmt: skip
    json_page.check("reproduce", kept)
    assert set(kept["tables"]) == names and kept["options"]["particles"] == 12
    text = (out / "report.html").read_text()
    for table in kept["tables"].values():
        assert table["rows"] and all(len(row) == len(table["header"]) for row in table["rows"])
        assert table["title"] in html.unescape(text)
    pictures = sorted(p.name for p in out.glob("*.png"))
    assert len(pictures) == 8 == text.count("data:image/png;base64,")
    assert not re.search(r"https?:", text)
    own = {row[0]: row for row in kept["tables"]["table_a_1"]["rows"]}["bough, NNSVGD, R = 3"]
    # every iteration moves 12 particles with 13 offsets on 5 records of 40 samples; the search for modes comes on top
    assert own[5] > 11 * 12 * 13 * 5 * SAMPLES
    converged = [row[-1] == "yes" for row in kept["tables"]["table_a_1"]["rows"][:2]]
    assert code == (0 if all(converged) else 3)
