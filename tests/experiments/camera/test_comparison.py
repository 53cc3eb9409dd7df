"""Sensors side by side."""

import json

import pytest

from experiments.camera.settings import main


@pytest.mark.slow
def test_two_sensor_files_make_a_page(sensor_file, tmp_path, capsys):
    sensors = [sensor_file("update_rate_hz = 4.0", f"The {n} one", s) for n, s in (("fast", 0.1), ("slow", 0.5))]
    files = ["--sensor", str(sensors[0]), "--sensor", str(sensors[1])]
    assert main([*files, "--sweep", "exposure_s=0.1:0.2:2"], own_process=False) == 2
    assert "a sweep is of one sensor" in capsys.readouterr().err
    assert main([*files, "--set", "sky.attitudes=20", "--out", str(tmp_path / "out")], own_process=False) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    sensors = summary["results"]["sensors"]
    assert list(sensors["requirements_missed"]["value"].values()) == [0, 1]
    electrons = sensors["electrons_e"]["value"]
    assert electrons["The slow one"] > 4.9 * electrons["The fast one"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "MISSED" in page
    assert "instrument.exposure_s" in page
