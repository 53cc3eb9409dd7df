"""The turntable calibration: reduction on coordinates, a tiny rendered run from end to end, refusals."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, aiming_angles, star_direction
from calib.calibration.table_reduction import calibrate_on_table
from calib.cameras import BrownConrady, SensorGeometry
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.measure import Measurement, TracedMap
from experiments.laboratory.single_star.setup import build_bench, grid_px
from experiments.laboratory.single_star.visits import visit
from experiments.turntable import experiment as study
from experiments.turntable.monte_carlo import (
    Coordinates,
    map_error,
)
from experiments.turntable.settings import Config, rendered
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


PLACES = {"columns": 7, "rows": 5}
STUDY = {"runs": 20, "sweep_runs": 5, "reading_noise_arcsec": (0.1, 0.3), "field_deg": (3.0, 12.0)}
SIGMA_PX = 0.003


def measured(config, instrument, table, streams, *, advance):
    """What the rendered bench gives, from a Brown-Conrady camera with drawn centroids."""
    camera = camera_of(instrument)
    bench, wanted = build_bench(config, table), grid_px(config, instrument)
    rolls = np.radians(table.rolls_deg)[np.arange(len(wanted)) % len(table.rolls_deg)]
    visits = visit(bench, wanted, camera.unproject(wanted), rolls, streams, readings=config.frames)
    bundle = camera.project(visits.direction)
    noise = SIGMA_PX * streams.generator("centroids").standard_normal(bundle.shape)
    readings = SimpleNamespace(
        position_px=bundle + noise,
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (len(bundle), 1, 1)),
        sigma_px=np.full(bundle.shape, SIGMA_PX),
    )
    return Measurement(bench=bench, visits=visits, bundle_px=bundle, readings=readings)


def camera_of(instrument):
    """A camera of that size with the principal point of the settings."""
    camera = instrument.camera
    size = SensorGeometry(width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm)
    return BrownConrady.create(size, focal_length_mm=206.0, x0_px=12.0, y0_px=-8.0, q1_per_mm2=1e-6)


@pytest.fixture(scope="module")
def outcome():
    """A whole run on coordinates; nothing is rendered."""
    config = Config.model_validate({"grid": PLACES, "study": STUDY})

    def traced(config, instrument):
        camera = camera_of(instrument)
        pixel = camera.geometry.grid_px(9)
        return TracedMap(direction=camera.unproject(pixel), pixel_px=pixel)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "measure", measured)
        patch.setattr(study, "traced_map", traced)
        return rendered.outcome(config, study.run(config, progress=Progress()))


@pytest.mark.parametrize("table", ["two_axis", "three_axis"])
def test_a_run_finds_what_was_set(table: str, outcome) -> None:
    """Star, lean and principal point within five sigma of the estimator; errors as predicted, for 35 places."""
    assert outcome.value("lost_runs", table=table) == 0
    set_values = {
        "star_azimuth_rad": np.radians(0.35),
        "star_elevation_rad": np.radians(-0.25),
        "lean1_rad": 5.0 * ARCSEC_RAD,
        "x0_px": 12.0,
        "y0_px": -8.0,
    }
    for name, value in set_values.items():
        at = {"unknown": name, "table": table}
        assert abs(outcome.values("estimate", **at) - value) < 5.0 * outcome.errors("estimate", **at), name
        assert outcome.value("truth", unknown=name, table=table) == pytest.approx(value, rel=1e-4), name
    assert np.isnan(outcome.value("truth", unknown="lean2_rad", table=table)) == (table == "two_axis")
    assert outcome.value("camera_model_arcsec", table=table) < 1e-4
    rms, predicted = (outcome.values(f"centroid_{one}_px", table=table) for one in ("error", "predicted"))
    assert rms == pytest.approx(predicted, rel=4.0 / np.sqrt(2 * 35))
    error, limit = outcome.values("map_error_arcsec", table=table)[0], outcome.value("map_limit_arcsec", table=table)
    assert error < limit
    point = outcome.values("line_of_sight.principal_point_sigma_arcsec", table=table).max()
    line = outcome.value("map_predicted_arcsec", table=table) / np.sqrt(2.0)
    assert outcome.value("line_of_sight.point_over_line", table=table) == pytest.approx(point / line)
    drawn = outcome.values("map_monte_carlo_arcsec", table=table)
    assert outcome.value("map_bound_arcsec", table=table) == pytest.approx(drawn, rel=0.5)


def test_noise_and_knowledge_of_a_run(outcome) -> None:
    shares = outcome.values("share_arcsec", table="two_axis")
    bound = outcome.value("map_bound_arcsec", table="two_axis")
    assert np.sqrt(np.nansum(shares**2)) == pytest.approx(bound, rel=1e-6)
    known = outcome.values("known_arcsec", table="two_axis")
    assert known[0] == pytest.approx(bound)
    assert known.max() <= bound * (1 + 1e-9)
    assert np.isnan(outcome.values("true_deg", table="two_axis", turn="middle")).all()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["two_axis.axes=x"], "2 axes are needed"),
        (["grid.columns=2", "grid.rows=2", "grid.edge_px=400"], "4 places give 8 measurements"),
    ],
)
def test_mistakes_end_in_one_line(settings: list[str], words: str, refused_by) -> None:
    assert words in refused_by("turntable", "--quick", settings=settings)
