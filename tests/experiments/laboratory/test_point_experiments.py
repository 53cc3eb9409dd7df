"""The commands temporal, hsfe and distortion: bad input in one line, quick runs whose criteria hold."""

from __future__ import annotations

import importlib
import json

import pytest

NAMES = ("temporal", "hsfe", "distortion")


def run(name, *arguments, capsys):
    status = importlib.import_module(f"experiments.{name}.experiment").main([*arguments])
    return status, capsys.readouterr().err.strip()


@pytest.mark.parametrize(
    ("name", "setting", "said"),
    [
        ("temporal", "frames=1", "frames"),
        ("temporal", "brightness.lowest_e=30000", "the first must be the lower one"),
        ("temporal", "instrument.lense=x", "lense"),
        ("temporal", "place_px=[20, 20]", "off the detector"),
        ("temporal", "passband.range_nm=[300, 900]", "passband.range_nm"),
        ("temporal", "instrument.defocus_mm=0.5", "window_px"),
        ("hsfe", "steps.step_px=7", "not smaller than half the window"),
        ("hsfe", "steps.positions=1", "positions"),
        ("hsfe", "window_px=12", "an odd number"),
        ("hsfe", "place_px=[90000, 20]", "off the detector"),
        ("distortion", "order=5", "more rows and columns than the order"),
        ("distortion", "target.edge_px=2000", "does not fit"),
        ("distortion", "reference=ideal", "reference"),
        ("distortion", "target.jitter_px=-1", "jitter_px"),
    ],
)
def test_bad_input_is_one_line(name, setting, said, capsys, tmp_path):
    status, text = run(name, "--set", setting, "--out", str(tmp_path / "out"), capsys=capsys)
    assert status == 2
    assert said in text
    assert len(text.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_quick_run_holds_its_criteria_and_writes_its_files(name, capsys, tmp_path):
    out = tmp_path / name
    status, text = run(name, "--quick", "--out", str(out), capsys=capsys)
    assert status == 0, text
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert content["experiment"] == name
    assert all(criterion["passed"] for criterion in content["criteria"])
    assert (out / "report.html").stat().st_size > 50_000
    assert list(out.glob("*.ecsv"))
