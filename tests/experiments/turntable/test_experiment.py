"""The turntable calibration: reduction on coordinates, a tiny rendered run from end to end, refusals."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, aiming_angles, star_direction
from calib.calibration.table_reduction import calibrate_on_table
from calib.cameras import BrownConrady, SensorGeometry
from experiments.harness.config import load_config
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.measure import TracedMap
from experiments.turntable.experiment import point_over_line
from experiments.turntable.monte_carlo import (
    Coordinates,
    map_error,
)
from experiments.turntable.settings import Config, main
from optics.errors import ConfigError
from optics.units import ARCSEC_RAD
from render.engine.random import Streams

SENSOR = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
MODEL = BrownConrady.create(SENSOR, focal_length_mm=40.0, x0_px=5.0, y0_px=-3.0, q1_per_mm2=1e-5, p2_per_mm=1e-6)
START = BrownConrady.create(SENSOR, focal_length_mm=38.0)
AHEAD = np.array([0.0, 0.0, 1.0])
MAP = TracedMap(direction=MODEL.unproject(SENSOR.grid_px(11)), pixel_px=SENSOR.grid_px(11))


def _setup(axes: str, *, reading_arcsec: float = 0.3, lean_arcsec: float = 8.0, side: int = 9) -> Coordinates:
    bench = StarBench(
        table=build_turntable(axes, non_orthogonality_arcsec=lean_arcsec, reading_noise_arcsec=reading_arcsec),
        star=star_direction(0.5, -0.4),
        installation=Rotation.from_rotvec([0.01, 0.02, -0.05]),
    )
    direction = MODEL.unproject(SENSOR.grid_px(side))
    angle = aiming_angles(bench, direction, np.asarray(np.arange(len(direction)) % 4 * (np.pi / 2)))
    covariance = np.tile(np.array([[4e-4, 1e-4], [1e-4, 2e-4]]), (len(direction), 1, 1))
    return Coordinates(
        model=MODEL, bench=bench, true_rad=angle, covariance_px2=covariance, start=START, start_star=AHEAD
    )


def test_what_a_square_table_is_taken_for_does_not_fit() -> None:
    setup = _setup("xy", reading_arcsec=0.01, lean_arcsec=60.0)
    data = setup.draw(Streams(1), 0)
    believed = setup.bench.table.nominal
    estimated = calibrate_on_table(data, believed, START, leans=True)
    ignored = calibrate_on_table(data, believed, START, leans=False)
    assert estimated.solution.reduced_chi2 < 1.5
    assert ignored.solution.reduced_chi2 > 2.0
    errors = [map_error(c, MAP).rms_arcsec for c in (estimated, ignored)]
    assert errors[1] > 5 * errors[0]


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("two_axis.reading_noise_arcsec=[-0.3]", "at least 0"),
        ("grid.edge_px=5", "windows leave the detector"),
        ("installation_deg=[40,0,0]", "at most 30 deg"),
        ("reduction.star_deg=[90,0]", "at most 60"),
        ("study.field_deg=[0,3]", "0.5"),
        ("study.reading_noise_arcsec=[-1,3]", "at least 0"),
    ],
)
def test_settings_that_do_not_do(setting: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        load_config(Config, settings=[setting])


def test_principal_point_and_line_of_sight_are_compared_per_axis() -> None:
    assert point_over_line(3.0, np.hypot(1.0, 1.0)) == pytest.approx(3.0)


TINY = [
    "instrument.diffraction=rays",
    "grid.columns=7",
    "grid.rows=5",
    "study.runs=20",
    "study.sweep_runs=5",
    "study.reading_noise_arcsec=[0.1,0.3]",
    "study.field_deg=[3,12]",
]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Results of a whole run of few places and runs."""
    out = tmp_path_factory.mktemp("turntable") / "run"
    argv = ["--quick", "--out", str(out), *(part for setting in TINY for part in ("--set", setting))]
    assert main(argv) in (0, 1)
    return json.loads((out / "summary.json").read_text())["results"]


@pytest.mark.slow
@pytest.mark.parametrize("table", ["two_axis", "three_axis"])
def test_a_rendered_run_finds_what_was_set(table: str, tiny) -> None:
    """Star, lean and principal point that were set, within five sigma of the estimator."""
    found = tiny[table]
    assert found["lost_runs"] == 0
    injected = {
        "star_azimuth_rad": np.radians(0.35),
        "star_elevation_rad": np.radians(-0.25),
        "lean1_rad": 5.0 * ARCSEC_RAD,
        "x0_px": 12.0,
        "y0_px": -8.0,
    }
    for name, value in injected.items():
        estimate = found["unknowns"][name]["estimate"]
        assert abs(estimate["value"] - value) < 5.0 * estimate["uncertainty"], name
        assert found["unknowns"][name]["truth"] == pytest.approx(value, rel=1e-4), name
    assert (found["unknowns"]["lean2_rad"]["truth"] is None) == (table == "two_axis")
    units = {name: found["unknowns"][name]["estimate"]["unit"] for name in ("x0_px", "q1_per_mm2")}
    assert units == {"x0_px": "px", "q1_per_mm2": "1/mm2"}


@pytest.mark.slow
@pytest.mark.parametrize("table", ["two_axis", "three_axis"])
def test_a_rendered_run_is_as_good_as_predicted(table: str, tiny) -> None:
    """N = 35 places: a standard deviation is known to 12 %, three of those."""
    found = tiny[table]
    assert found["map_split_arcsec"]["model"] < 1e-4 < found["map_error_arcsec"]["estimated"]
    for axis in "xy":
        rms, predicted = found["centroid_error_px"]["rms"][axis], found["centroid_predicted_px"][axis]
        assert rms == pytest.approx(predicted, rel=3.0 / np.sqrt(2 * 35))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["two_axis.axes=x"], "2 axes are needed"),
        (["grid.columns=2", "grid.rows=2", "grid.edge_px=400"], "4 places give 8 measurements"),
    ],
)
def test_mistakes_end_in_one_line(settings: list[str], words: str, refused_by) -> None:
    assert words in refused_by("turntable", "--quick", settings=settings)
