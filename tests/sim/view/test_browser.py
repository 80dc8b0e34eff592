"""A page in a real browser: it opens, a slider and the mouse move a branch, an exported file plays without a server."""

import io
import threading
import time

import numpy as np
import PIL.Image
import pytest

pytest.importorskip("viser", reason="the page in the browser needs viser (extra view)")

from bough.sim.view.living import Living, Planted
from bough.sim.view.page import open_page
from bough.sim.view.show import Loop, export
from oracles.chromium import Chromium, chromium_or_skip
from oracles.rods import rod, slider


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Open an empty tab of 700 by 350 pixels."""
    chromium_or_skip()
    opened = Chromium(tmp_path_factory.mktemp("chromium"), (700, 350))
    yield opened
    opened.close()


@pytest.fixture
def scene():
    """Put a rod of 4 N m/rad without weight on a page."""
    page = open_page(0)
    made = Living(page, Planted([rod(4.0)], np.zeros(3)), laws=())
    made.start()
    slider(page, "shadows").value = False
    yield made
    page.stop()


#: What Chromium says of a listener of viser 1.1.1's own when a drag begins; nothing is lost by it.
VISERS = "Unable to preventDefault inside passive event listener invocation."


def until(found, seconds: float = 90.0) -> None:
    """Wait until something is so; the machine may be busy."""
    end = time.monotonic() + seconds
    while not found():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.1)


def pixels(browser, path) -> np.ndarray:
    """Return the left half of the tab, where the scene is, [height, width, 3]."""
    return np.asarray(PIL.Image.open(io.BytesIO(browser.picture(path))).convert("RGB"))[:, :350].astype(int)


def wooden(picture: np.ndarray) -> np.ndarray:
    """Return where a picture is brown: neither sky nor ground, below the page's note that it draws in software."""
    red, green, blue = np.moveaxis(picture, 2, 0)
    return (red > green + 6) & (red > blue + 12) & (np.arange(len(red)) > 160)[:, None]


def test_a_slider_and_the_mouse_move_a_branch(scene, browser, tmp_path):
    """Press keys on the wind's slider, then drag the rod: it bends on the server and in the picture; no errors."""
    loop = Loop(scene.page, scene)
    ended = threading.Event()
    thread = threading.Thread(target=loop.run, args=(ended.is_set,))
    thread.start()

    def tip() -> np.ndarray:
        return np.array(scene.wood.balls.batched_positions[0])

    try:
        browser.open(f"http://localhost:{scene.page.port}")
        browser.wait("[...document.querySelectorAll('label, div')].some(e => e.textContent === 'wind [m/s]')", 90.0)
        until(lambda: wooden(pixels(browser, tmp_path / "still.png")).sum() > 50)
        still = pixels(browser, tmp_path / "still.png")
        place = np.argwhere(wooden(still))
        browser.value(
            "(() => { const sliders = [...document.querySelectorAll('[role=slider]')];"
            "sliders.find(s => s.getAttribute('aria-valuemax') === '25').focus(); })()"
        )
        browser.key("End", 35)
        until(lambda: slider(scene.page, "wind [m/s]").value == 25.0)
        until(lambda: tip()[0] > 0.5)
        until(lambda: (wooden(pixels(browser, tmp_path / "bent.png")) != wooden(still)).sum() > 50)
        browser.key("Home", 36)
        until(lambda: slider(scene.page, "wind [m/s]").value == 0.0 and abs(tip()[0]) < 0.01)
        drag(browser, place, lambda: np.linalg.norm(scene.pull.force) > 0.0)
        until(lambda: np.linalg.norm(tip()[:2]) > 0.01)
        browser.mouse("mouseReleased", 250, 100)
        until(lambda: not scene.pull.force.any())
    finally:
        ended.set()
        thread.join()
    assert [e for e in browser.errors if VISERS not in e] == []


def drag(browser, place: np.ndarray, pulled) -> None:
    """Press the mouse on the middle of the wood and move it right until that is a force."""
    row = int(np.median(place[:, 0]))
    x, y = float(np.median(place[place[:, 0] == row, 1])), float(row)
    browser.mouse("mouseMoved", x, y)
    time.sleep(1.0)
    browser.mouse("mousePressed", x, y, pressed=True)
    for k in range(200):
        browser.mouse("mouseMoved", x + min(4.0 * k, 80.0), y, pressed=True)
        time.sleep(0.1)
        if k > 20 and pulled():
            return
    raise AssertionError("the mouse pulled at nothing")


def test_an_exported_page_plays_from_a_file(scene, browser, tmp_path):
    """Open the file with no server: the rod bends in the wind it was recorded in; nothing is fetched, no errors."""
    slider(scene.page, "gusts [m/s]").value = 20.0
    slider(scene.page, "gusts [Hz]").value = 0.5
    scene.seconds = 2.0
    path = tmp_path / "page.html"
    assert export(scene.page, scene, path) == path.stat().st_size
    browser.open("about:blank")  # the page of the test before looks for its server
    time.sleep(0.5)
    browser.errors.clear()
    browser.open(path.as_uri())
    browser.wait("document.querySelector('canvas')", 90.0)
    until(lambda: wooden(pixels(browser, tmp_path / "first.png")).sum() > 50)
    first = wooden(pixels(browser, tmp_path / "first.png"))
    until(lambda: (wooden(pixels(browser, tmp_path / "later.png")) != first).sum() > 50)
    fetched = browser.value("performance.getEntriesByType('resource').map(e => e.name).filter(n => /^http/.test(n))")
    assert fetched == [] and browser.errors == []
    assert "rod, 1 link" in browser.value("document.body.innerText")
