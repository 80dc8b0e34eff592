"""The report page is complete, escaped and self-contained; figures show what they are given."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from bough.learn.reports import figures
from bough.learn.reports.page import KeyNumber, ParameterRow, ReportContent, ReportFigure, number, write_report
from matplotlib.figure import Figure
from matplotlib.image import imread

NASTY = '<script>alert("x")</script> & co'


class Page(HTMLParser):
    """Collect tags, their attributes and the text; complain about tags closed out of order."""

    VOID = ("meta", "img", "br", "link")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def content(**changes) -> ReportContent:
    """Return a report with something in every section, some of it hostile."""
    drawing = Figure(figsize=(2, 1))
    drawing.subplots().plot([0, 1])
    fields = {
        "title": f"Identification of {NASTY}",
        "headline": f"The prediction is as good as the sensor allows {NASTY}",
        "status": "good",
        "numbers": [KeyNumber("Coverage", 94.83, "%", NASTY), KeyNumber("Kind", NASTY, "", "text")],
        "parameters": [ParameterRow(f"K {NASTY}", 71.123, 68.0, 75.5, "N m/rad")],
        "caveat": NASTY,
        "figures": [ReportFigure("loop.png", drawing, NASTY), ReportFigure("raw.png", figures.png(drawing), "Raw.")],
        "details": {"seed": 0, "note": NASTY, "particles": 48},
        "further": [("posterior.npz", NASTY)],
    }
    return ReportContent(**{**fields, **changes})


def test_page_is_complete_and_escaped(tmp_path: Path) -> None:
    """Every text and number appears, once decoded, nothing of it becomes markup, and tags are balanced."""
    page = Page(write_report(tmp_path, content()).read_text(encoding="utf-8"))
    text = " ".join(" ".join(page.text).split())
    assert not [tag for tag, _ in page.tags if tag == "script"]
    places = ["title", "header", "headline", "explanation", "value", "parameter", "caveat", "caption", "detail"]
    assert text.count(NASTY) == len([*places, "further"])
    assert [a["alt"] for tag, a in page.tags if tag == "img"] == [NASTY, "Raw."]
    for part in ("94.8 %", "71.1", "68.0 to 75.5", "N m/rad", "particles", "48", "posterior.npz"):
        assert part in text


def test_page_loads_nothing_and_holds_its_figures(tmp_path: Path) -> None:
    """No address leads elsewhere; each embedded image is byte for byte the PNG beside the page, with a text for it."""
    text = write_report(tmp_path, content()).read_text(encoding="utf-8")
    assert not re.search(r"https?:|//cdn|@import|url\(|<link", text)
    images = [attributes for tag, attributes in Page(text).tags if tag == "img"]
    assert len(images) == 2 and all(image["alt"] for image in images)
    for image, name in zip(images, ("loop.png", "raw.png"), strict=True):
        data = base64.b64decode(image["src"].removeprefix("data:image/png;base64,"))
        assert data == (tmp_path / name).read_bytes() and data.startswith(b"\x89PNG")


@pytest.mark.parametrize("status", ["good", "warning", "bad"])
def test_headline_comes_first_and_shows_the_status(tmp_path: Path, status: str) -> None:
    """The first heading is the verdict, coloured by its status; sections without content are left out."""
    bare = content(status=status, parameters=[], figures=[], details={}, further=[])
    page = Page(write_report(tmp_path, bare).read_text(encoding="utf-8"))
    headings = [(tag, attributes.get("class")) for tag, attributes in page.tags if tag in ("h1", "h2")]
    assert headings == [("h1", status), ("h2", None)]


def test_figure_name_with_a_path_is_refused(tmp_path: Path) -> None:
    """A figure cannot be written outside the folder."""
    with pytest.raises(ValueError, match="plain name"):
        write_report(tmp_path, content(figures=[ReportFigure("../x.png", b"", "x")]))


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0035, "0.00350"), (71.123, "71.1"), (12345.6, "12346"), (3, "3"), (0, "0"), (-0.25, "-0.250"), ("x", "x"),
     (1.5e-7, "1.50 × 10^-7"), (float("nan"), "not finite"), (True, "True"), (np.float32(2.5), "2.50"), (0.0, "0")],
)  # fmt: skip
def test_numbers_are_readable(value: object, text: str) -> None:
    """Three significant digits, no exponent where it can be avoided."""
    assert number(value) == text


def arrays(n: int, channels: int, samples: int = 60) -> tuple[list[np.ndarray], list[np.ndarray]]:
    rng = np.random.default_rng(n)
    return [np.arange(samples) / 25] * n, [rng.normal(size=(samples, channels)) for _ in range(n)]


def decoded(figure: Figure) -> np.ndarray:
    """Pixels of the rendered figure."""
    return imread(io.BytesIO(figures.png(figure, dpi=60)))


@pytest.mark.parametrize(("n", "channels"), [(1, 1), (3, 3), (8, 3)])
def test_prediction_figure_draws_every_channel(n: int, channels: int) -> None:
    """One panel a trajectory and channel, with the measured and predicted numbers and a band of the right height."""
    t, y = arrays(n, channels)
    drawn = figures.prediction_figure(
        t, y, [v + 1 for v in y], [v - 1 for v in y], [v + 2 for v in y],
        titles=[f"{i}: steps" for i in range(n)], labels=["x [cm]", "y [cm]", "z [cm]"][:channels],
    )  # fmt: skip
    assert len(drawn.axes) == n * channels and decoded(drawn).std() > 0.01
    last = drawn.axes[-1]
    lines = {line.get_label(): line.get_ydata() for line in last.lines}
    np.testing.assert_array_equal(lines["measured"], y[-1][:, -1])
    np.testing.assert_array_equal(lines["predicted"], y[-1][:, -1] + 1)
    band = last.collections[0].get_paths()[0].vertices
    assert band[:, 1].min() == y[-1][:, -1].min() - 1 and band[:, 1].max() == y[-1][:, -1].max() + 2
    assert last.get_xlabel() == "time [s]"


@pytest.mark.parametrize("n", [1, 2, 6, 11])
def test_posterior_figure_states_median_and_interval(n: int) -> None:
    """Each parameter's panel carries its median and 95 % interval."""
    samples = np.random.default_rng(0).uniform(10, 20, size=(200, n))
    drawn = figures.posterior_figure(samples, [f"K {i} [N m/rad]" for i in range(n)])
    low, middle, high = np.quantile(samples[:, -1], [0.025, 0.5, 0.975])
    titles = [ax.get_title() for ax in drawn.axes]
    assert f"{middle:.1f}\n({low:.1f} to {high:.1f})" in titles and sum(bool(title) for title in titles) == n
    assert decoded(drawn).std() > 0.01


def test_residual_figure_shows_misfit_above_noise() -> None:
    """White residuals of the noise's size are plain; three times larger ones state it in the alarm colour."""
    t, y = arrays(4, 2, 200)
    plain, loud = (figures.residual_figure(t, [k * v for v in y], np.ones(2), label="r [m]") for k in (1, 3))
    rms = np.sqrt(np.mean(np.square(y)))
    assert plain.get_suptitle() == f"rms residual = {rms:.2f} times the noise"
    assert loud.get_suptitle() == f"rms residual = {3 * rms:.2f} times the noise"
    assert plain._suptitle.get_color() == figures.MEASURED and loud._suptitle.get_color() == figures.ALARM
    decoded(loud)


def test_loop_figure_projects_on_the_force() -> None:
    """Force and displacement are drawn along the main direction of force, positive towards the larger pull."""
    direction = np.array([0.0, 0.6, -0.8])
    history = np.sin(np.linspace(0, 3, 50))[:, None]
    drawn = figures.loop_figure([9 * history * direction], [0.1 * history * direction], [0.1 * history * direction],
                                titles=["1: steps"])  # fmt: skip
    line = drawn.axes[0].lines[0]
    np.testing.assert_allclose(line.get_ydata(), 9 * history[:, 0], atol=1e-12)
    np.testing.assert_allclose(line.get_xdata(), 10 * history[:, 0], atol=1e-12)
    decoded(drawn)


def test_convergence_figure_and_global_style() -> None:
    """Particles settle below their best; means of coordinates are drawn; matplotlib's settings are left alone."""
    before = dict(matplotlib.rcParams)
    steps = np.arange(30)[:, None]
    below = 0.003 + 100 * np.exp(-steps / 5) * np.linspace(0.5, 2, 16)
    mean = np.exp(-steps / 4) * np.array([1.0, -2.0, 0.5])
    drawn = figures.convergence_figure(-below, mean)
    left, right = drawn.axes
    assert len(left.lines) == 17
    np.testing.assert_allclose(left.lines[16].get_ydata(), np.median(below, axis=1) - below.min())
    np.testing.assert_allclose([line.get_ydata() for line in right.lines], mean.T)
    assert decoded(drawn).std() > 0.01 and dict(matplotlib.rcParams) == before


def test_coverage_figure_shows_both_curves() -> None:
    """Nominal probabilities across, shares of points up, in percent."""
    drawn = figures.coverage_figure(np.array([0.5, 0.95]), np.array([0.4, 0.9]))
    ideal, found = drawn.axes[0].lines
    np.testing.assert_allclose(found.get_xydata(), [[50, 40], [95, 90]])
    np.testing.assert_allclose(ideal.get_xydata(), [[0, 0], [100, 100]])
