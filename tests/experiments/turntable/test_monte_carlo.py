"""Calibrations on coordinates: consistent covariance, the bound, and a closed form of the reading noise."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.laboratory.single_star.measure import TracedMap
from experiments.turntable.monte_carlo import equal_reading_noise_arcsec, monte_carlo, reading_sweep
from render.engine.random import Streams

RUNS = 12


@pytest.fixture(scope="module")
def setup(coordinates_of):
    coordinates = coordinates_of(reading_noise_arcsec=(0.2, 0.4), non_orthogonality_arcsec=20.0, side=7)
    pixel_px = coordinates.model.geometry.grid_px(7)
    return coordinates, TracedMap(direction=coordinates.model.unproject(pixel_px), pixel_px=pixel_px)


def test_pulls_are_normal_and_the_map_reaches_its_bound(setup):
    """N runs: mean square of q pulls and of the map's error to sqrt(2 / N q) and better."""
    coordinates, traced = setup
    result = monte_carlo(coordinates, traced, Streams(4), RUNS)
    assert (result.not_converged, result.runs) == (0, RUNS)
    assert np.sqrt((result.rms_pull**2).mean()) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * RUNS * 5))  # correlated
    np.testing.assert_allclose(
        result.error / result.pull, np.median(result.error / result.pull, axis=0) + 0 * result.pull, rtol=0.05
    )
    assert result.reduced_chi2.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (RUNS * (2 * 49 - 14))))
    map_arcsec = result.map_arcsec
    assert map_arcsec.value == pytest.approx(coordinates.map_bound_arcsec(traced), abs=4.0 * map_arcsec.uncertainty)
    assert result.predicted_map_arcsec.mean() == pytest.approx(coordinates.map_bound_arcsec(traced), rel=0.05)
    assert map_arcsec.uncertainty < 0.15 * map_arcsec.value
    truth = dict(zip(result.names, result.truth, strict=True))
    assert truth["x0_px"] == 5.0
    np.testing.assert_allclose(truth["lean1_rad"], 20.0 / 206264.806, rtol=1e-6)


def test_drawn_centroids_have_the_stated_covariance(setup):
    coordinates, _ = setup
    exact = coordinates.model.project(coordinates.bench.star_in_cam(coordinates.true_rad))
    error_px = np.concatenate([coordinates.draw(Streams(1), run).pixel_px - exact for run in range(60)])
    covariance = np.cov(error_px.T) / 0.02**2
    np.testing.assert_allclose(covariance, [[1.0, 0.5], [0.5, 2.0]], atol=4.0 * 2.0 * np.sqrt(2.0 / len(error_px)))


def test_reading_noise_equivalent_to_the_centroids_doubles_the_variance(setup):
    coordinates, traced = setup
    sweep = reading_sweep(coordinates, traced, Streams(2), [0.0, 3.0], 4, advance=lambda: None)
    centroids_alone = sweep[0].bound_arcsec
    equal = equal_reading_noise_arcsec(sweep, centroids_alone)
    doubled = coordinates.with_reading_noise(equal).map_bound_arcsec(traced)
    assert doubled == pytest.approx(centroids_alone * 2**0.5, rel=0.02)
    assert [point.reading_noise_arcsec for point in sweep] == [0.0, 3.0]
    for point in sweep:
        assert point.runs == 4
        assert point.measured_arcsec.value == pytest.approx(point.bound_arcsec, rel=0.5)
        assert point.rms_pull == pytest.approx(1.0, abs=0.5)
    assert np.isnan(equal_reading_noise_arcsec(sweep[:1], centroids_alone))
