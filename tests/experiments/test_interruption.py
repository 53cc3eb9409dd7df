"""An interrupt from the terminal ends experiments that render and that have workers: one line, nothing written."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def catches_sigterm(process):
    """Whether the program has taken over SIGTERM, which it does first of all (Python itself does not)."""
    status = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    caught = int(re.search(r"^SigCgt:\s*(\w+)", status, re.MULTILINE)[1], 16)
    return bool(caught >> (signal.SIGTERM - 1) & 1)


def has_workers(process):
    """Whether it has started others."""
    return bool(Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii").split())


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc to see when the program is up")
@pytest.mark.parametrize(
    ("name", "settings", "ready", "after_s"),
    [("chromatic", ["--set", "frames=200"], catches_sigterm, 6.0), ("acf", [], has_workers, 1.0)],
)
def test_interruption_leaves_nothing_behind(tmp_path, name, settings, ready, after_s):
    """Before it is ready an interrupt ends Python, not the program; it goes to all processes, as from a terminal."""
    process = subprocess.Popen(
        [sys.executable, "-m", f"experiments.{name}", *settings, "--out", str(tmp_path / "deep" / "out")],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while not ready(process.pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said[1].strip() == "interrupted; nothing was written"
    assert list(tmp_path.iterdir()) == []
