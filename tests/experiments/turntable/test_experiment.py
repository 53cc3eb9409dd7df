"""The turntable calibration: reduction on coordinates, and a run with a Brown-Conrady camera from end to end."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.calibration.table_reduction import calibrate_on_table
from calib.cameras import BrownConrady, SensorGeometry
from experiments.harness.progress import Progress
from experiments.laboratory.single_star.measure import Measurement, TracedMap
from experiments.laboratory.single_star.setup import build_bench, grid_px
from experiments.laboratory.single_star.visits import visit
from experiments.turntable import experiment as study
from experiments.turntable.monte_carlo import (
    map_error,
)
from experiments.turntable.settings import TurntableCalibrationConfig, rendered
from optics.units import ARCSEC_RAD
from render.engine.random import Streams


def test_ignored_non_orthogonality_does_not_fit(coordinates_of) -> None:
    setup = coordinates_of(reading_noise_arcsec=0.01, non_orthogonality_arcsec=60.0, side=9)
    data = setup.draw(Streams(1), 0)
    nominal = setup.bench.table.nominal
    estimated, ignored = (calibrate_on_table(data, nominal, setup.start, leans=leans) for leans in (True, False))
    assert estimated.solution.reduced_chi2 < 1.5
    assert ignored.solution.reduced_chi2 > 2.0
    pixel_px = setup.model.geometry.grid_px(11)
    traced = TracedMap(direction=setup.model.unproject(pixel_px), pixel_px=pixel_px)
    assert map_error(ignored, traced).rms_arcsec > 5 * map_error(estimated, traced).rms_arcsec


GRID = {"columns": 7, "rows": 5}
STUDY = {"runs": 20, "sweep_runs": 5, "reading_noise_arcsec": (0.1, 0.3), "field_deg": (3.0, 12.0)}
SIGMA_PX = 0.003


def measured(config, instrument, table, streams, *, advance):
    """The measurement on the rendered bench, from a Brown-Conrady camera with drawn centroids."""
    camera = camera_of(instrument)
    bench, pixel_px = build_bench(config, table), grid_px(config, instrument)
    rolls = np.radians(table.rolls_deg)[np.arange(len(pixel_px)) % len(table.rolls_deg)]
    visits = visit(bench, pixel_px, camera.unproject(pixel_px), rolls, streams, readings=config.frames)
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
    config = TurntableCalibrationConfig.model_validate({"grid": GRID, "study": STUDY})

    def traced(config, instrument):
        camera = camera_of(instrument)
        pixel = camera.geometry.grid_px(9)
        return TracedMap(direction=camera.unproject(pixel), pixel_px=pixel)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "measure", measured)
        patch.setattr(study, "traced_map", traced)
        return rendered.outcome(config, study.run(config, progress=Progress()))


@pytest.mark.parametrize("table", ["two_axis", "three_axis"])
def test_a_run_recovers_the_truth(table: str, outcome) -> None:
    """Star, lean and principal point within five sigma of the estimator; errors as predicted, for 35 places."""
    assert outcome.value("runs_not_converged", table=table) == 0
    truth = {
        "star_azimuth_rad": np.radians(0.35),
        "star_elevation_rad": np.radians(-0.25),
        "lean1_rad": 5.0 * ARCSEC_RAD,
        "x0_px": 12.0,
        "y0_px": -8.0,
    }
    for name, value in truth.items():
        at = {"unknown": name, "table": table}
        assert abs(outcome.values("estimate", **at) - value) < 5.0 * outcome.errors("estimate", **at), name
        assert outcome.value("truth", unknown=name, table=table) == pytest.approx(value, rel=1e-4), name
    assert np.isnan(outcome.value("truth", unknown="lean2_rad", table=table)) == (table == "two_axis")
    assert outcome.value("camera_model_arcsec", table=table) < 1e-4
    rms, predicted = (outcome.values(f"centroid_{kind}_px", table=table) for kind in ("error", "predicted"))
    assert rms == pytest.approx(predicted, rel=4.0 / np.sqrt(2 * 35))
    error, limit = outcome.values("map_error_arcsec", table=table)[0], outcome.value("map_limit_arcsec", table=table)
    assert error < limit
    principal_point = outcome.values("line_of_sight.principal_point_sigma_arcsec", table=table).max()
    per_axis = outcome.value("map_predicted_arcsec", table=table) / np.sqrt(2.0)
    ratio = outcome.value("line_of_sight.principal_point_ratio", table=table)
    assert ratio == pytest.approx(principal_point / per_axis)
    drawn = outcome.values("map_monte_carlo_arcsec", table=table)
    assert outcome.value("map_bound_arcsec", table=table) == pytest.approx(drawn, rel=0.5)


def test_noise_and_knowledge_of_a_run(outcome) -> None:
    contributions = outcome.values("contribution_arcsec", table="two_axis")
    bound = outcome.value("map_bound_arcsec", table="two_axis")
    assert np.sqrt(np.nansum(contributions**2)) == pytest.approx(bound, rel=1e-6)
    known = outcome.values("map_bound_if_known_arcsec", table="two_axis")
    assert known[0] == pytest.approx(bound)
    assert known.max() <= bound * (1 + 1e-9)
    assert np.isnan(outcome.values("true_deg", table="two_axis", turn="middle")).all()
