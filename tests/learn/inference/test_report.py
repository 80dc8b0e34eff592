"""The report page is complete, escaped and self-contained; figures show what they are given."""

from __future__ import annotations

import base64
import io
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from bough.learn.reports import figures
from bough.learn.reports.motion import FRAMES, MotionLine, ReportMotion
from bough.learn.reports.page import (
    KeyNumber,
    ParameterRow,
    ReportContent,
    ReportFigure,
    ReportTable,
    number,
    write_report,
)
from matplotlib.figure import Figure
from matplotlib.image import imread
from oracles.chromium import Chromium

NASTY = '<script>alert("x")</script> & co'


class Page(HTMLParser):
    """Collect tags, their attributes and the text; complain about tags closed out of order."""

    VOID = ("meta", "img", "br", "link", "input")

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


def swinging(name: str = "line", frames: int = 5, seconds: float = 1.0) -> ReportMotion:
    """Return a line of two points whose end moves on a circle."""
    turn = np.linspace(0.0, 1.0, frames)
    points = np.stack([np.zeros((frames, 2)), np.stack([np.sin(turn), -np.cos(turn)], axis=-1)], axis=1)
    return ReportMotion(
        f"Motion {name}", f"Caption {name}", 2.0 + seconds * turn, [MotionLine(f"L {name}", "#123456", points)]
    )


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
        "precisely": NASTY,
        "exact": [KeyNumber("p", NASTY, "", "text")],
        "commands": [(f"bough {NASTY}", NASTY)],
        "motion": swinging(NASTY),
    }
    return ReportContent(**{**fields, **changes})


def test_page_is_complete_and_escaped(tmp_path: Path) -> None:
    """Every text and number appears, once decoded, nothing of it becomes markup, and tags are balanced."""
    page = Page(write_report(tmp_path, content()).read_text(encoding="utf-8"))
    text = " ".join(" ".join(page.text).split())
    assert [a.get("type") for tag, a in page.tags if tag == "script"] == ["application/json", None]
    places = ["title", "header", "headline", "explanation", "value", "parameter", "caveat", "caption", "detail"]
    new = ["precisely", "exact", "command", "what it does", "motion", "its line", "its caption"]
    assert text.count(NASTY) == len([*places, "further", *new])
    assert [a["alt"] for tag, a in page.tags if tag == "img"] == [NASTY, "Raw."]
    assert [a["aria-label"] for tag, a in page.tags if tag == "canvas"] == [f"Caption {NASTY}"]
    for part in ("94.8 %", "71.1", "68.0 to 75.5", "N m/rad", "particles", "48", "posterior.npz"):
        assert part in text


def test_a_motion_keeps_its_shape() -> None:
    """Moments start at zero; points are whole steps of one scale, as far apart as the line's; frames are thinned."""
    told = json.loads(swinging().data)
    assert told["t"] == pytest.approx(np.linspace(0.0, 1.0, 5)) and told["lines"][0]["name"] == "L line"
    points = np.array(told["lines"][0]["points"]).reshape(5, 2, 2)
    length = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
    np.testing.assert_allclose(length / length[0], 1.0, atol=2.0 / length[0])
    assert told["start"] == 0 and points.min() == 0 and np.all(points.max(axis=(0, 1)) <= told["size"])
    assert len(json.loads(swinging(frames=5000).data)["t"]) == FRAMES
    with pytest.raises(ValueError, match="moments"):
        ReportMotion("m", "", np.zeros(3), [MotionLine("l", "#000000", np.zeros((2, 2, 2)))])


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
    bare = content(status=status, parameters=[], figures=[], details={}, further=[], exact=[], commands=[], motion=None)
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


# ---- in a browser ---------------------------------------------------------------------------------------------------


CUT = """[...document.querySelectorAll('table')]
    .filter((t) => t.parentElement.scrollWidth > t.parentElement.clientWidth)
    .map((t) => t.outerHTML.slice(0, 80))"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory):
    """Return a tab with a report of something in every section, whose motion lasts a minute."""
    folder = tmp_path_factory.mktemp("browser")
    opened = Chromium(folder / "profile", (1400, 900))
    columns = tuple(f"force {k} [N]" for k in range(9))
    wide = ReportTable("Nine columns", columns, [("after the repair", *["12.3 (4.5 to 67.8)"] * 8)] * 2)
    page = write_report(folder, content(motion=swinging("one", frames=200, seconds=60.0), tables=[wide]))
    opened.open(page.as_uri())
    opened.wait("document.querySelector('canvas')?.dataset.frame !== undefined")
    yield opened
    opened.close()


def test_the_page_works(browser: Chromium) -> None:
    """Play moves the picture and pauses, the slider sets the frame, the button copies or selects the command."""
    frame, play = "Number(document.querySelector('canvas').dataset.frame)", "document.querySelector('.motion button')"
    browser.value(f"{play}.click()")
    browser.wait(f"{frame} > 1", 20.0)
    browser.value(f"{play}.click()")
    assert browser.value(f"{play}.textContent") == "Play"
    browser.value("s = document.querySelector('.motion input'); s.value = 40; s.dispatchEvent(new Event('input'))")
    assert browser.value(frame) == 40
    pixels = "Array.from(document.querySelector('canvas').getContext('2d').getImageData(0, 0, 900, 400).data)"
    assert browser.value(f"{pixels}.some((x) => x > 0)")
    browser.value("document.querySelector('button.copy').click()")
    browser.wait("['Copied', 'Selected'].includes(document.querySelector('button.copy').textContent)", 20.0)
    assert browser.errors == []


@pytest.mark.parametrize("width", [400, 1400])
def test_nothing_sticks_out_and_no_text_is_small(browser: Chromium, width: int) -> None:
    """The page is no wider than the window, folds opened, and every text has 14 pixels at least."""
    browser.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
    browser.value("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert browser.value("document.documentElement.scrollWidth") <= width
    small = (
        "[...document.querySelectorAll('body *')].filter((e) => e.innerText && e.tagName !== 'SCRIPT'"
        " && parseFloat(getComputedStyle(e).fontSize) < 14).map((e) => e.outerHTML.slice(0, 80))"
    )
    assert browser.value(small) == []
    assert browser.value(CUT) == []


def test_a_wide_table_is_whole_on_paper(browser: Chromium) -> None:
    """Let cells wrap where the page is printed: a sheet cannot be scrolled (A4 at 96 dots an inch)."""
    browser.call("Emulation.setEmulatedMedia", media="print")
    browser.call("Emulation.setDeviceMetricsOverride", width=794, height=1123, deviceScaleFactor=1, mobile=False)
    assert browser.value("document.documentElement.scrollWidth") <= 794 and browser.value(CUT) == []
    browser.call("Emulation.setEmulatedMedia", media="screen")


def test_a_number_that_there_is_not_is_a_dash() -> None:
    """Show a number with its unit, and neither for one that there is not."""
    shown = [KeyNumber("x", value, "%", "").shown for value in (12.34, "about 3", math.nan)]
    assert shown == ["12.3 %", "about 3 %", "-"]
