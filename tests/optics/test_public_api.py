"""The package's own names; what all packages keep to is in tests/test_public_names.py."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import optics

ROOT = Path(__file__).resolve().parents[2]


def test_help_names_everything_public_beside_its_module():
    table = re.split(r"={20,}.*\n", optics.__doc__)[1]
    rows = re.findall(r"^(optics\.[\w.]+)((?:.*\n)(?: {20,}.*\n)*)", table, re.M)
    said = {name: module for module, names in rows for name in re.findall(r"`(\w+)`", names)}
    assert set(said) == set(optics.__all__)
    for name, module in said.items():
        home = getattr(getattr(optics, name), "__module__", None)
        assert home is None or f"{home}.".startswith(f"{module}."), name


@pytest.mark.parametrize("statement", ["import optics", "from optics import load_lens"])
def test_names_that_are_not_used_cost_nothing(statement):
    code = f"import sys\n{statement}\nprint(*{{'matplotlib', 'astropy', 'optics.waves'}} & set(sys.modules))"
    assert subprocess.check_output([sys.executable, "-c", code], cwd=ROOT, text=True, timeout=60).split() == []


def test_the_lines_that_help_shows_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec("\n".join(re.findall(r"^    (.*)", optics.__doc__.split("====")[0], re.M)), {})
    assert (tmp_path / "lens.png").exists()
