"""Progress: bars on a terminal, now and then a line elsewhere, times in all cases."""

import io
import time

import pytest

from experiments.harness.progress import LineProgress, Progress, terminal_progress
from experiments.harness.provenance import without_paths


def work(progress):
    with progress.stage("outer", total=2) as stage:
        stage.advance()
        for _ in progress.track(range(3), "inner"):
            time.sleep(0.002)
        stage.advance()
    return list(progress.track(iter("ab"), "inner"))


def test_a_run_of_a_moment_says_nothing_in_a_pipe(capsys):
    assert work(terminal_progress()) == ["a", "b"]
    printed = capsys.readouterr()
    assert printed.out == printed.err == ""


def test_long_work_in_a_pipe_says_a_line_now_and_then():
    """Seven steps of 9 s: a line after 2 s, then one in thirty seconds; no control characters in a log file."""
    now, log = [100.0], io.StringIO()
    progress = LineProgress(log, clock=lambda: now[0])
    with progress.stage("render", total=7) as stage:
        for _ in range(7):
            now[0] += 9.0
            stage.advance()
    with progress.stage("write"):
        now[0] += 30.0
    with progress.stage("judge"):
        pass
    assert log.getvalue() == "[9 s] render: 1 of 7, 54 s left\n[45 s] render: 5 of 7, 18 s left\n[93 s] judge\n"


def test_a_terminal_shows_bars_and_notes_above_them(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    progress = terminal_progress()
    with progress.stage("render", total=2) as stage:
        stage.advance()
        progress.note("a [remark]")
    assert "render" in terminal.getvalue()
    assert "a [remark]" in terminal.getvalue()
    assert list(progress.times_s) == ["render"]


def test_times_of_stages_add_up_and_survive_a_fault():
    progress = Progress()
    work(progress)
    assert list(progress.times_s) == ["inner", "outer"]
    assert progress.times_s["outer"] >= 0.006
    assert progress.times_s["inner"] >= 0.006

    def fails():
        with progress.stage("fails"):
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fails()
    assert "fails" in progress.times_s


def test_paths_of_one_machine_are_cut():
    config = {"lens": "/opt/data/lens.toml", "list": ["~/x/y.fits", 3], "ratio": "a/b", "none": None}
    assert without_paths(config) == {"lens": "lens.toml", "list": ["y.fits", 3], "ratio": "a/b", "none": None}
