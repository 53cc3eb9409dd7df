"""The page "add a surface", followed: its two touches, made in a copy of the program, which then has the new kind."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "extending" / "add_a_surface.md").read_text(encoding="utf-8")
REGISTRY = Path("optics", "lens", "shapes", "registry.py")


def run(folder, *command):
    done = subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """A copy of the program, changed as the page says."""
    folder = tmp_path_factory.mktemp("program")
    no_cache = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "optics", folder / "optics", ignore=no_cache)
    (folder / "render").mkdir()
    (folder / "render" / "__init__.py").write_text("")
    shutil.copytree(ROOT / "render" / "engine", folder / "render" / "engine", ignore=no_cache)
    shape, registry, script, _ = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    file = re.search(r"^`(optics/lens/shapes/\w+\.py)`:$", PAGE, re.M)[1]
    (folder / file).write_text(shape, encoding="utf-8")
    listed, count = re.subn(
        r"^SHAPES: .*\n", lambda _: registry, (ROOT / REGISTRY).read_text(encoding="utf-8"), flags=re.M
    )
    assert count == 1
    (folder / REGISTRY).write_text(listed, encoding="utf-8")
    (folder / "lens.toml").write_text(re.search(r"```toml\n(.*?)```", PAGE, re.S)[1], encoding="utf-8")
    (folder / "script.py").write_text(script, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_the_script_of_the_page_runs_and_draws(program):
    radii_um = [float(number) for number in re.findall(r"\d+\.\d*", run(program, "script.py"))]
    assert len(radii_um) == 2
    assert (program / "lens.png").stat().st_size > 10_000
