"""Training at the command line: what is refused in one line, before any world is built."""


def test_bad_commands_are_refused(bough, tmp_path):
    """Zero worlds, a run that is there already, no run: one line, exit code 2, nothing written or changed."""
    out = tmp_path / "run"
    bough("train", "powerline", "--out", out, "--num-envs", 0).refused("--num-envs", "1 or more")
    bough("evaluate", out).refused("no such folder")
    assert not out.exists()
    out.mkdir()
    (out / "config.json").write_text("{}")
    bough("train", "powerline", "--out", out).refused("a run", "--resume")
    assert [p.name for p in out.iterdir()] == ["config.json"] and (out / "config.json").read_text() == "{}"
