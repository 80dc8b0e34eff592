"""``bough view`` as a user types it: what it refuses, what it prints, what it writes."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest

pytest.importorskip("viser", reason="the page in the browser needs viser (extra view)")


def test_what_cannot_be_shown_is_refused(inside, forest, case, tmp_path):
    """Say in one line that a path holds nothing known, a case is missing, a port is taken, a page has another name."""
    inside("view", tmp_path / "nothing").refused("no such file or folder")
    (tmp_path / "odd").mkdir()
    inside("view", tmp_path / "odd").refused("an empty folder", "a forest")
    (tmp_path / "odd" / "notes.txt").write_text("x")
    inside("view", tmp_path / "odd").refused("notes.txt")
    inside("view", tmp_path / "odd" / "notes.txt").refused(".txt", "MJCF")
    (tmp_path / "odd" / "verdict.json").write_text("{}")
    inside("view", tmp_path / "odd").refused("--case", "the case folder")
    inside("view", tmp_path / "odd", "--case", case).refused("model.yaml")
    (tmp_path / "odd" / "trajectory.npz").write_bytes(b"PK")
    inside("view", tmp_path / "odd", "--export", tmp_path / "x.html").refused("trajectory.npz", "no whole .npz archive")
    np.savez(tmp_path / "odd" / "trajectory.npz", time=np.zeros(1))
    inside("view", tmp_path / "odd", "--export", tmp_path / "x.html").refused("body_name", "simulate again")
    inside("view", forest, "--export", tmp_path / "page.txt").refused("--export", ".html")
    inside("view", forest, "--law", "force_bias", "--port", 0).refused("--law", "force_bias")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        inside("view", forest, "--port", port).refused("--port", f"{port}, which is taken")
    assert not (tmp_path / "x.html").exists()


def test_a_simulation_becomes_one_file(bough, forest, tmp_path):
    """Simulate a tree, write its page: one file with its motion and viser's client inside and no address to fetch."""
    tree = forest / "tree_0000.xml"
    assert bough("simulate", tree, "--worlds", 2, "--bend", 0.1, "--seconds", 0.5, "--out", tmp_path / "sim").code == 0
    done = bough("view", tmp_path / "sim", "--export", tmp_path / "made" / "page.html")
    assert done.code == 0, done.err
    assert done.out.startswith("0.5 s of motion, ") and len(done.out.splitlines()) == 1
    text = (tmp_path / "made" / "page.html").read_text()
    assert "2 worlds of" in text and "__VISER_EMBED_DATA__" in text
    assert "<script src" not in text and '<link rel="stylesheet" href' not in text


def test_a_page_is_served_until_ctrl_c(forest):
    """Print address and SSH line, serve the page to this machine, send a client the trees, end by Ctrl-C with 0."""
    import viser
    import zstandard
    from websockets.sync.client import connect

    command = [sys.executable, "-m", "bough", "view", str(forest), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                               env={**os.environ, "SSH_CONNECTION": ""})  # fmt: skip
    try:
        where, over = process.stdout.readline(), process.stdout.readline()
        address = where.split()[1]
        port = int(address.rsplit(":", 1)[1])
        assert over.startswith(f"Over SSH, first: ssh -L {port}:localhost:{port} ")
        assert b"<title>Viser</title>" in urllib.request.urlopen(address).read()
        with connect(f"ws://localhost:{port}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as client:
            seen, end = b"", time.monotonic() + 120.0
            while not (b"/wood/balls" in seen and b"wind [m/s]" in seen) and time.monotonic() < end:
                frame = client.recv(timeout=60.0)
                size = int.from_bytes(frame[8:16], "little")
                seen += zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size])
        assert b"/wood/balls" in seen and b"wind [m/s]" in seen
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120.0) == 0
