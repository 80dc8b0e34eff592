"""How fast ``bough view`` is: frames of the server, and frames and motion in a headless Chromium.

64 trees of 40 links (ternary, order 3) move in gusts. Server: `Living.tick` (8 steps, observation, capsules' ends, what
viser queues) as often as it goes. Page: what Chromium receives, applies and draws with software WebGL, at several sizes
of the window; a frame counts if something was drawn in it, since the page draws only what has changed. CPU time a frame
hardly depends on what else the machine does. Needs Chromium for the second part.

Run: ``python benchmarks/view.py [--quick] [--seed n]``
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import measuring
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from bough.sim.trees.tree import Tree
from bough.sim.view.living import Living, Planted
from bough.sim.view.page import open_page
from bough.sim.view.show import Loop
from measuring import Figure
from ternary import ternary_tree

#: Run before the page: counts the frames in which WebGL draws.
COUNT = """window.drawnFrames = 0; let drawn = false;
for (const name of ["drawElements", "drawElementsInstanced", "drawArrays", "drawArraysInstanced"]) {
  const call = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) { drawn = true; return call.apply(this, given); };
}
(function frame() { if (drawn) window.drawnFrames += 1; drawn = false; requestAnimationFrame(frame); })();"""


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure and print."""
    page, rng = open_page(0), np.random.default_rng(options.seed)
    trees = [shaped(ternary_tree(3, rng)) for _ in range(64)]
    scene = Living(page, Planted(trees, np.array([0.0, 0.0, -9.81])), laws=())
    scene.start()
    control(page, "gusts [m/s]").value = 8.0
    seconds = 2.0 if options.quick else 8.0
    print(f"{len(trees)} trees of {trees[0].num_links} links; load of the machine {os.getloadavg()[0]:.1f}")
    found = [Figure("64 trees of 40 links", "CPU of the server a frame", ticks(scene, seconds), "ms")]
    if shutil.which("chromium"):
        for size in ("320x240",) if options.quick else ("320x240", "1000x700"):
            spent = browse(page, scene, size, seconds)
            found.append(Figure(f"page of {size}", "CPU of Chromium a frame, drawing in software", spent, "ms"))
    page.stop()
    return found


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    return measuring.quick_and_seed(__doc__, "2 seconds instead of 8, of a small page alone")


def shaped(tree: Tree) -> Tree:
    """Return a benchmark's tree with the capsules that its masses are those of."""
    radius = 0.03 * 0.6**tree.level
    return tree.with_(shape_link=np.arange(tree.num_links), shape_start=np.zeros((tree.num_links, 3)),
                      shape_end=2.0 * tree.com, shape_radius=np.stack([radius, radius], axis=1))  # fmt: skip


def control(page, label):
    """Return a control by its label."""
    return next(h for h in page.server.gui._gui_input_handle_from_uuid.values() if h.label == label)


def ticks(scene: Living, seconds: float) -> float:
    """Return the CPU time [ms] that the server needs for a frame of a thirtieth of a second of motion."""
    begun, used, count = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - begun < seconds:
        with scene.page.server.atomic():
            scene.tick(1.0 / 30.0)
        count += 1
    spent = 1e3 * (time.process_time() - used) / count
    print(f"server: {spent:.1f} ms of CPU a frame, {count / (time.perf_counter() - begun):.0f} frames a second")
    return spent


def cpu_of(process: int) -> float:
    """Return the CPU seconds that a process and those that it started have used, from Linux's /proc."""
    rows = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = file.read_text().rsplit(")", 1)[1].split()
        except OSError:  # it has ended meanwhile
            continue
        rows[int(file.parent.name)] = int(fields[1]), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    family, more = {process}, {process}
    while more:
        more = {p for p, (parent, _) in rows.items() if parent in more} - family
        family |= more
    return sum(rows[p][1] for p in family if p in rows)


def browse(page, scene: Living, size: str, seconds: float) -> float:
    """Print frames of the page while it is open; return the CPU time of each [ms]."""
    from oracles.chromium import Chromium

    width, height = map(int, size.split("x"))
    loop = Loop(page, scene)
    ended = threading.Event()
    thread = threading.Thread(target=loop.run, args=(ended.is_set,))
    thread.start()
    browser = Chromium(Path(tempfile.mkdtemp()), (width, height))
    try:
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=COUNT)
        browser.open(f"http://localhost:{page.port}")
        browser.wait("document.querySelector('canvas')")
        time.sleep(3.0 * seconds)  # shaders are compiled
        before, begun, used = scene.time, time.perf_counter(), cpu_of(browser.process)
        first = browser.value("window.drawnFrames")
        time.sleep(seconds)
        frames, took = browser.value("window.drawnFrames") - first, time.perf_counter() - begun
        moved = (scene.time - before) / took
        each = 1e3 * (cpu_of(browser.process) - used) / max(1, frames)
        print(f"page {size}: {frames / took:.1f} frames a second, {each:.0f} ms of CPU each; errors {browser.errors}")
        print(f"  server meanwhile {loop.rate:.0f}, {moved:.2f} x real time; load {os.getloadavg()[0]:.1f}")
        return each
    finally:
        browser.close()
        ended.set()
        thread.join()


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "view"))
