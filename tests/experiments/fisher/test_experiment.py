"""The whole bench, rendered, small: scatter against prediction, same bytes; the streak of a moving table; mistakes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calib.cameras import BrownConrady, SensorGeometry
from experiments.fisher.accuracy import _angles_per_pixel, check_config
from experiments.fisher.settings import Config, main
from optics.errors import StarbenchError

READING_ARCSEC, RATE_DEG_PER_S, JITTER_MS = 0.4, 0.05, 4.0
DETECTOR = Config().instrument.detector
"""Of full size: a narrow field does not tell the unknowns of a joint calibration apart."""


@pytest.fixture(scope="module")
def run(tiny_run):
    """Of a bright star, so that the table makes nearly all of the scatter, and its size is known."""
    places = {"grid__columns": 7, "grid__rows": 5, "grid__edge_px": 20, "frames": 16, "dark_frames": 10}
    table = {"table__reading_noise_arcsec": [READING_ARCSEC], "dynamic__rate_deg_per_s": RATE_DEG_PER_S}
    star = {"evaluation__columns": 10, "evaluation__rows": 8, "evaluation__edge_px": 20, "evaluation__signal_e": 10000}
    study = {"field__directions": 500, "field__runs": 6}
    clocks = {"field__field_deg": [3.0, 20.0], "dynamic__jitter_ms": JITTER_MS, "dynamic__samples": 5}
    sensor = {"instrument__detector": DETECTOR, "instrument__diffraction": "rays"}
    return tiny_run("fisher", **sensor, **places, **table, **star, **study, **clocks)


@pytest.mark.slow
def test_the_scatter_is_that_of_the_table(run) -> None:
    """Both axes stand across the star: each reading errs in full along one of two directions, the clocks along one."""
    assert run.status == 0
    clocks = RATE_DEG_PER_S * 3600 * JITTER_MS / 1000 / np.sqrt(2)
    static, dynamic = run.results["static"], run.results["dynamic"]
    for found, table in ((static, READING_ARCSEC), (dynamic, np.hypot(READING_ARCSEC, clocks))):
        assert found["n"] == 80
        assert found["expected_arcsec"]["readings"] == pytest.approx(READING_ARCSEC, rel=1e-3)
        error = 1 / np.sqrt(4 * (found["n"] - 1))  # of a standard deviation with 2 (n - 1) degrees of freedom
        assert found["sigma_arcsec"]["value"] == pytest.approx(table, rel=4 * error)
        assert found["sigma_arcsec"]["uncertainty"] == pytest.approx(error * found["sigma_arcsec"]["value"], rel=1e-9)
    assert static["expected_arcsec"]["clocks"] == 0.0
    assert dynamic["expected_arcsec"]["clocks"] == pytest.approx(clocks, rel=1e-3)
    assert dynamic["streak_px"] == pytest.approx(RATE_DEG_PER_S * 3600 * 0.1 / 5.5005, rel=1e-3)


def test_angle_of_a_pixel_by_focal_length_and_by_the_field(star_camera) -> None:
    """The last one is the angle between the directions of the outer edges over the number of pixels."""
    camera = star_camera.camera
    geometry = SensorGeometry(
        width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm
    )
    model = BrownConrady.create(geometry, focal_length_mm=200.0)
    found = _angles_per_pixel(SimpleNamespace(instrument=star_camera, model=model))
    middle = (camera.height_px - 1) / 2
    left, right = model.unproject([[-0.5, middle], [camera.width_px - 0.5, middle]])
    expected = [camera.pixel_pitch_mm / 200.0, np.arccos(left @ right) / camera.width_px]
    assert [list(found.values())[i] for i in (0, 2)] == pytest.approx(np.array(expected) * 648000 / np.pi, rel=1e-6)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("table.axes=x", "2 or 3"),
        ("table.axes=xx", "orthogonal"),
        ("table.axes=q", "letters"),
        ("table.axes=xyz", "table.rolls_deg = [0.0]"),
        ("table.reading_noise_arcsec=[0.1,0.1,0.1]", "table.reading_noise_arcsec"),
        ("table.reading_noise_arcsec=[-0.1]", "at least 0"),
        ("evaluation.columns=100", "lower evaluation.columns"),
        ("evaluation.edge_px=5", "evaluation.edge_px = 5 px"),
        ("evaluation.edge_px=900", "evaluation.edge_px"),
        ("grid.edge_px=900", "grid.edge_px"),
        ("dynamic.rate_deg_per_s=5", "smears the image"),
        ("dynamic.samples=2", "dynamic.samples = 2"),
        ("field.field_deg=[3.0,150.0]", "field_deg"),
        ("passband.range_nm=[100,200]", "nm"),
    ],
)
def test_bad_settings_get_one_line(setting: str, words: str, refused_by) -> None:
    assert words in refused_by("fisher", "--set", setting)


@pytest.mark.slow
def test_light_that_cannot_be_measured(tmp_path, capsys) -> None:
    few = ("grid.columns=7", "grid.rows=5", "frames=4", "dark_frames=10", "instrument.diffraction=rays")
    settings = [word for one in (*few, "evaluation.signal_e=20") for word in ("--set", one)]
    assert main(["--quick", *settings, "--out", str(tmp_path / "x")]) == 2
    assert "gives a position at" in capsys.readouterr().err.strip().splitlines()[-1]


def test_defaults_are_accepted_without_rendering() -> None:
    assert check_config(Config()).pixel_arcsec == pytest.approx(5.5005, abs=1e-3)
    with pytest.raises(StarbenchError, match=r"evaluation\.columns or evaluation\.rows"):
        check_config(Config.model_validate({"evaluation": {"columns": 2, "rows": 2}}))
