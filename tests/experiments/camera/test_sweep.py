"""Sweeps of the camera: closed forms, crossings, and the command."""

import json

import numpy as np
import pytest
from astropy.table import Table
from small_sensors import sensor

from experiments.camera.settings import CameraReportConfig, experiment, main
from experiments.harness.progress import Progress
from experiments.harness.range import quantity_of
from experiments.harness.what_if import _finer, crossing, run_sweep
from optics.validate import parse_model

TRACKER = {**sensor(defocus_mm=0.0), "sky": {"attitudes": 40}}
STILL = {"dark_current_e_per_s": 0.0, "dark_spread_e_per_s": 0.0, "hot_fraction": 0.0}


def study(*sweep, **tables):
    config = parse_model(CameraReportConfig, {**TRACKER, "sweep": sweep, **tables}, "test")
    return run_sweep(experiment, config, progress=Progress())


def series(found, name):
    return np.array([getattr(point, name) for point in found["points"]])


@pytest.mark.slow
def test_magnitude_of_the_star_that_is_quoted():
    light = series(study("magnitude_mag=3:8:3"), "electrons_e")
    np.testing.assert_allclose(light[:-1] / light[1:], 10.0, rtol=1e-9)


@pytest.mark.slow
def test_stars_that_trail():
    """NEA in white noise rises with the root of the lit area; a trail beyond the window is refused at its point."""
    quiet = {"detector": STILL | {"read_noise_e": 40.0}, "star": {"magnitude_mag": 6.0}, "centroid": "epsf"}
    found = study("slew.rate_deg_per_s=0:1.2:4", window_px=19, **quiet)
    nea, electrons = (series(found, name) for name in ("nea_arcsec", "electrons_e"))
    assert electrons[2] == pytest.approx(electrons[0], rel=1e-12)
    trail_px = 0.4 * 0.2 * 3600.0 / found["points"][0].pixel_arcsec
    assert 3.0 < trail_px < 15.0
    assert 1.5 < nea[1] / nea[0] < nea[2] / nea[0]
    assert "too much for window_px = 19 px" in found["points"][3].refusal


@pytest.mark.parametrize(
    ("key", "name", "unit"),
    [
        ("instrument.exposure_s", "exposure", "s"),
        ("detector.dark_current_e_per_s", "dark current", "e-/s"),
        ("instrument.f_number", "F-number", ""),
        ("instrument.gain_dn_per_e", "gain", "DN/e-"),
    ],
)
def test_the_name_of_a_key_ends_in_its_unit(key, name, unit):
    assert quantity_of(key) == (name, unit)


@pytest.mark.slow
def test_files_and_output_of_a_sweep(sensor_file, tmp_path, capsys):
    sensor, out = sensor_file("update_rate_hz = 4.0\nfocus_shift_um = 50.0"), tmp_path / "out"
    line = ["--sensor", str(sensor), "--set", "sky.attitudes=20", "--sweep", "exposure_s=0.2:0.3:2", "--out", str(out)]
    assert main(line, own_process=False) == 0
    results = json.loads((out / "summary.json").read_text())["results"]
    assert results["swept"]["first"]["value"] == "instrument.exposure_s"
    assert results["points"]["instrument_exposure_s"] == {"unit": "s", "dims": ["point"], "value": [0.2, 0.3]}
    assert results["points"]["meets"]["value"] == [True, False]
    every = Table.read(out / "sweep.ecsv", format="ascii.ecsv")
    assert every["instrument_exposure_s"].unit == "s"
    assert every["nea_arcsec"][1] == results["points"]["nea_arcsec"]["value"][1]
    page = (out / "report.html").read_text()
    assert "1 of 2 points meet the requirement" in page
    assert "focus_shift_um" in page  # required, stated as not judged
    shown = capsys.readouterr().out
    assert "Misses" in shown
    assert "update_rate" in shown
    assert max(map(len, shown.splitlines())) <= max(80, len(str(out)) + 24)


def test_a_crossing_is_known_to_two_percent_of_its_step():
    for true in (0.013, 0.5, 0.97):
        assert crossing(lambda value, true=true: value < true, 0.0, 1.0) == pytest.approx(true, abs=0.01)
        assert crossing(lambda value, true=true: value > 10.0 + true, 12.0, 10.0) == pytest.approx(
            10.0 + true, abs=0.02
        )


def test_lines_of_a_map_stand_where_the_law_crosses():
    """A noise of sqrt(a / t + b N^2 / t^2) on a coarse map: contour to 2 % of the exposure of the closed form."""
    exposure, stop = np.geomspace(0.05, 0.8, 5), np.linspace(2.0, 6.0, 5)
    values = np.sqrt(0.1 / exposure + 0.02 * stop[:, None] ** 2 / exposure**2)
    x, y, fine = _finer(exposure, stop, values)
    for row in range(0, len(y), 17):
        found = np.interp(-1.5, -fine[row], x)
        true = (0.1 + np.sqrt(0.01 + 4.0 * 2.25 * 0.02 * y[row] ** 2)) / (2.0 * 2.25)
        if exposure[0] < true < exposure[-1]:
            assert found == pytest.approx(true, rel=0.02)
