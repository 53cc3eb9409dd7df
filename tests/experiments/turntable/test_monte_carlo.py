"""Many calibrations on coordinates: honest covariance, the bound, and a closed form of the reading noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, aiming_angles, star_direction
from calib.cameras import BrownConrady, SensorGeometry
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.measure import TracedMap
from experiments.turntable.monte_carlo import Coordinates, equal_reading_noise_arcsec, monte_carlo, reading_sweep
from render.engine.random import Streams

SENSOR = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
MODEL = BrownConrady.create(SENSOR, focal_length_mm=40.0, x0_px=5.0, y0_px=-3.0, q1_per_mm2=1e-4)
RUNS = 12


@pytest.fixture(scope="module")
def setup():
    bench = StarBench(
        table=build_turntable("xy", non_orthogonality_arcsec=20.0, reading_noise_arcsec=(0.2, 0.4)),
        star=star_direction(0.5, -0.4),
        installation=Rotation.from_rotvec([0.01, 0.02, -0.05]),
    )
    direction = MODEL.unproject(SENSOR.grid_px(7))
    covariance = np.tile([[1.0, 0.5], [0.5, 2.0]], (49, 1, 1)) * 0.02**2
    coordinates = Coordinates(
        model=MODEL,
        bench=bench,
        true_rad=aiming_angles(bench, direction, np.zeros(49)),
        covariance_px2=covariance,
        start=MODEL,
        start_star=np.array(bench.star),
    )
    return coordinates, TracedMap(direction=direction, pixel_px=MODEL.project(direction))


def test_pulls_are_normal_and_the_map_reaches_its_bound(setup):
    """N runs: mean square of q pulls and of the map's error to sqrt(2 / N q) and better."""
    coordinates, traced = setup
    found = monte_carlo(coordinates, traced, Streams(4), RUNS)
    assert (found.lost, found.runs) == (0, RUNS)
    assert np.sqrt((found.pull_std**2).mean()) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * RUNS * 5))  # correlated
    np.testing.assert_allclose(
        found.error / found.pull, np.median(found.error / found.pull, axis=0) + 0 * found.pull, rtol=0.05
    )
    assert found.reduced_chi2.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (RUNS * (2 * 49 - 14))))
    one = found.map_arcsec
    assert one.value == pytest.approx(coordinates.map_bound_arcsec(traced), abs=4.0 * one.uncertainty)
    assert found.predicted_map_arcsec.mean() == pytest.approx(coordinates.map_bound_arcsec(traced), rel=0.05)
    assert one.uncertainty < 0.15 * one.value
    known = dict(zip(found.names, found.truth, strict=True))
    assert known["x0_px"] == 5.0
    np.testing.assert_allclose(known["lean1_rad"], 20.0 / 206264.806, rtol=1e-6)


def test_drawn_centroids_have_the_covariance_that_is_told(setup):
    coordinates, _ = setup
    exact = MODEL.project(coordinates.bench.star_in_cam(coordinates.true_rad))
    apart = np.concatenate([coordinates.draw(Streams(1), run).pixel_px - exact for run in range(60)])
    covariance = np.cov(apart.T) / 0.02**2
    np.testing.assert_allclose(covariance, [[1.0, 0.5], [0.5, 2.0]], atol=4.0 * 2.0 * np.sqrt(2.0 / len(apart)))


def test_readings_count_as_centroids_where_they_double_the_variance(setup):
    coordinates, traced = setup
    sweep = reading_sweep(coordinates, traced, Streams(2), [0.0, 3.0], 4, advance=lambda: None)
    still = sweep[0].bound_arcsec
    equal = equal_reading_noise_arcsec(sweep, still)
    doubled = coordinates.with_reading_noise(equal).map_bound_arcsec(traced)
    assert doubled == pytest.approx(still * 2**0.5, rel=0.02)
    assert [one.reading_arcsec for one in sweep] == [0.0, 3.0]
    for one in sweep:
        assert one.runs == 4
        assert one.measured_arcsec.value == pytest.approx(one.bound_arcsec, rel=0.5)
        assert one.pull_rms == pytest.approx(1.0, abs=0.5)
    assert np.isnan(equal_reading_noise_arcsec(sweep[:1], still))
