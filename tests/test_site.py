"""The site as a reader's browser shows it: every page at the width of a phone and of a desk."""

import functools
import http.server
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from oracles.chromium import Chromium, chromium_or_skip

ROOT = Path(__file__).resolve().parents[1]
#: What is wider than the page and cannot be scrolled to by itself: in no ancestor that scrolls or clips on purpose.
OVERFLOWS = """(() => {
  const wide = document.documentElement.clientWidth;
  const found = [];
  if (document.documentElement.scrollWidth > wide) found.push('the page: ' + document.documentElement.scrollWidth);
  const inside = e => { for (let p = e.parentElement; p && p.tagName !== 'ARTICLE'; p = p.parentElement)
    if (/auto|scroll/.test(getComputedStyle(p).overflowX)) return true; return false; };
  for (const e of document.querySelectorAll('article *')) {
    const box = e.getBoundingClientRect();
    if (box.width > 1 && box.right > wide + 1 && !inside(e) && !/auto|scroll/.test(getComputedStyle(e).overflowX))
      found.push(e.tagName + ' to ' + Math.round(box.right) + ': ' + e.textContent.trim().slice(0, 60));
  }
  return found.slice(0, 5).join('; ');
})()"""
#: Tables that have to be scrolled: site.js sets them tighter, or their rows as lists.
CUT = """[...document.querySelectorAll('.md-typeset__scrollwrap')].filter(e => e.scrollWidth > e.clientWidth + 1)
  .map(e => e.textContent.trim().slice(0, 60)).join('; ')"""
#: Pictures that did not load.
BROKEN = "[...document.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src).join(' ')"


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Build the site as ``make docs`` does; a warning is an error."""
    pytest.importorskip("mkdocs", reason="no mkdocs here: pip install -e '.[docs]'")
    pytest.importorskip("mkdocstrings", reason="no mkdocstrings here: pip install -e '.[docs]'")
    chromium_or_skip()
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(out)]
    subprocess.run(command, cwd=ROOT, check=True, stdin=subprocess.DEVNULL)
    return out


@pytest.mark.parametrize("width", [400, 1400])
def test_nothing_is_cut_off(site, tmp_path, width):
    """Open every page: nothing reaches beyond the page's right edge, every picture is there, nothing is logged."""
    browser = Chromium(tmp_path / "profile", (width, 900))
    try:
        wrong = {}
        for page in sorted(site.rglob("*.html")):
            if page.name == "404.html":  # for a server, with absolute links
                continue
            browser.open(page.as_uri())
            browser.wait("document.readyState === 'complete'")
            found = [browser.value(OVERFLOWS), browser.value(CUT), browser.value(BROKEN)]
            if any(found):
                wrong[str(page.relative_to(site))] = found
        assert wrong == {}
        assert [e for e in browser.errors if "file:" not in e] == []
    finally:
        browser.close()


def test_search_finds_a_word(site, tmp_path):
    """Type a word into the search of a page, served by this machine alone, and be shown pages with that word."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(site))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser = Chromium(tmp_path / "profile", (1400, 900))
    try:
        browser.open(f"http://127.0.0.1:{server.server_port}/index.html")
        browser.wait("document.readyState === 'complete'")
        browser.value("document.querySelector('[data-md-component=search-query]').focus()")
        browser.call("Input.insertText", text="hysteresis")
        browser.wait("document.querySelector('.md-search-result__link')", 120.0)
        assert "hysteresis" in browser.value("document.querySelector('.md-search-result__list').textContent").lower()
    finally:
        browser.close()
        server.shutdown()
