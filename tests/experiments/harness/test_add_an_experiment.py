"""The page "Add an experiment", followed to the letter: its files are written, found, listed and run."""

import importlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments.__main__ import main as starbench
from experiments.harness import registry
from render.detector.spec import load_detector

PAGE = Path(__file__).parents[3] / "docs" / "extending" / "add_an_experiment.md"


@pytest.fixture
def added(tmp_path, monkeypatch):
    """A distribution of its own that offers the experiment of the page through its entry point."""
    text = PAGE.read_text(encoding="utf-8")
    files = {"photon_transfer/report.md": re.search(r"```markdown\n(.*?)```", text, re.S)[1]}
    for name, code in re.findall(r"```python\n# (\S+)\n(.*?)```", text, re.S):
        files[name] = files.get(name, "") + code
    files["photon_transfer-1.dist-info/METADATA"] = "Metadata-Version: 2.1\nName: photon-transfer\nVersion: 1\n"
    entry = re.search(r"```toml\n(.*?)```", text, re.S)[1]
    group, line = entry.replace('[project.entry-points."', "[").replace('"]', "]").strip().split("\n")
    files["photon_transfer-1.dist-info/entry_points.txt"] = f"{group}\n{line.replace(chr(34), '')}\n"
    for name, code in files.items():
        (tmp_path / "site" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "site" / name).write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    importlib.invalidate_caches()
    registry._packages.cache_clear()
    yield tmp_path
    registry._packages.cache_clear()
    for name in [name for name in sys.modules if name.startswith("photon_transfer")]:
        del sys.modules[name]


def test_it_is_listed_and_runs(added, capsys):
    assert starbench([]) == 0
    assert re.search(r"photon_transfer\s+Photon transfer: does the slope", capsys.readouterr().out)
    out = added / "out"
    assert starbench(["photon_transfer", "--seed", "5", "--out", str(out)]) == 0
    results = json.loads((out / "summary.json").read_text(encoding="utf-8"))["results"]
    gain, stated = results["gain"]["gain"], load_detector("cmv4000").gain_dn_per_e
    # variance of a variance of n normal numbers 2 s^4 / n: 0.17 % a level of 40 frames of 128 x 128 pixels; the slope
    # at no light of a quadratic through four of them is three times as uncertain
    assert gain["value"] == pytest.approx(stated, rel=5 * 3 * np.sqrt(2 / (40 * 128**2)))
    assert gain["uncertainty"] < 0.006 * stated
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "<svg" in report
    assert f"{results['levels']['mean_dn']['value'][0]:.1f}" in report
    assert (out / "levels.ecsv").exists()
    assert starbench(["photon_transfer", "--set", "framse=3"]) == 2
    assert "frames" in capsys.readouterr().err
