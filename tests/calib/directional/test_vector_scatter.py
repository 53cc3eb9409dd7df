"""Predicted covariances against the scatter of many noisy realisations, of new data and of the calibration's own."""

import numpy as np
import pytest
from star_bench_scene import MODEL, SENSOR, star_bench

from calib.calibration.star_bench import (
    aiming_angles,
    design_star_last,
    reading_covariance_px2,
    residual_px,
    star_last,
    star_vector_by_pixel,
    star_vectors,
)
from calib.calibration.table_reduction import PoseData, calibrate_on_table, calibrated_bench, predicted_scatter
from calib.directional import fisher, pixel_method, vector_accuracy
from calib.directional.vector_scatter import (
    pixel_method_scatter,
    scatter_of_other_data,
    scatter_of_own_data,
    vector_sigma_arcsec,
)
from optics.units import ARCSEC_RAD, RAD_ARCSEC

SIGMA_PX = 0.02
READING_RAD = np.array([0.2, 0.5]) * ARCSEC_RAD


@pytest.fixture(scope="module")
def bench():
    return star_bench(lean=4.0, reading=(0.2, 0.5))


@pytest.fixture(scope="module")
def angle(bench):
    return aiming_angles(bench, MODEL.unproject(SENSOR.grid_px(9)), np.zeros(81))


def test_the_prediction_is_what_noisy_data_scatter(bench, angle):
    """N = 800 runs of 81 vectors: the mean sum of squares is known to 0.3 %, variances to 5 %."""
    by_pixel, design = star_vector_by_pixel(MODEL, bench, angle), design_star_last(MODEL, bench, angle)
    noise = SIGMA_PX**2 * np.broadcast_to(np.eye(2), by_pixel.shape) + reading_covariance_px2(MODEL, bench, angle)
    predicted = scatter_of_other_data(by_pixel, noise, design, np.zeros((design.shape[2], design.shape[2])))
    rng, exact, sums, ratios = np.random.default_rng(3), MODEL.project(bench.star_in_cam(angle)), [], []
    for _ in range(800):
        pixel = exact + SIGMA_PX * rng.standard_normal(exact.shape)
        read = angle + READING_RAD * rng.standard_normal(angle.shape)
        sums.append(fisher.mean_and_chords(star_vectors(MODEL, bench, pixel, read)[None])[1].sum())
        ratios.append(pixel_method.residual_sigma_px(residual_px(MODEL, bench, pixel, read)) / np.sqrt(sums[-1]))
    error = np.std(sums) / np.sqrt(len(sums))
    assert np.mean(sums) == pytest.approx(predicted.sum_rad2, abs=4 * error)
    assert np.var(sums) == pytest.approx(predicted.variance_rad4, rel=4 * np.sqrt(2 / 800))
    chance = 1 / np.sqrt(2 * 800)
    assert np.std(ratios) / np.mean(ratios) == pytest.approx(pixel_method_scatter(by_pixel, noise), rel=4 * chance)
    z = [predicted.z_score(s) for s in sums]
    assert np.std(z) == pytest.approx(1.0, abs=4 / np.sqrt(1600))
    assert predicted.sigma_arcsec == pytest.approx(vector_sigma_arcsec(by_pixel, noise), rel=1e-3)


def test_same_data_lose_as_many_degrees_as_there_are_unknowns(bench, angle):
    by_pixel, design = star_vector_by_pixel(MODEL, bench, angle), design_star_last(MODEL, bench, angle)
    even = np.linalg.inv(np.swapaxes(by_pixel, 1, 2) @ by_pixel)  # isotropic on the sphere
    same = scatter_of_own_data(by_pixel, even, design)
    assert same.sum_rad2 / same.noise_rad2 == pytest.approx(2 * len(by_pixel) - design.shape[2], rel=1e-9)
    assert same.satterthwaite == pytest.approx(2 * len(by_pixel) - design.shape[2], rel=1e-9)


@pytest.mark.slow
def test_same_data_and_others_by_real_calibrations(bench):
    """N = 30 calibrations at 36 places: variances known to some 4 %."""
    angle = aiming_angles(bench, MODEL.unproject(SENSOR.grid_px(6)), np.zeros(36))
    centroid = np.tile(SIGMA_PX**2 * np.eye(2), (36, 1, 1))
    by_pixel, design = star_vector_by_pixel(MODEL, bench, angle), design_star_last(MODEL, bench, angle)
    noise = centroid + reading_covariance_px2(MODEL, bench, angle)
    exact, rng, sums, covariance = MODEL.project(bench.star_in_cam(angle)), np.random.default_rng(5), [], []
    for _ in range(30):
        first, second = (
            PoseData(
                pixel_px=exact + SIGMA_PX * rng.standard_normal(exact.shape),
                covariance_px2=centroid,
                reading_rad=angle + READING_RAD * rng.standard_normal(angle.shape),
            )
            for _ in range(2)
        )
        found = calibrate_on_table(first, bench.table, MODEL, leans=True, start_star=np.array(bench.star))
        assert found.converged
        own = calibrated_bench(found, bench.table)
        vectors = [star_vectors(found.model, own, data.pixel_px, data.reading_rad) for data in (first, second)]
        sums.append([fisher.mean_and_chords(one[None])[1].sum() for one in vectors])
        solution = found.solution
        order = star_last(solution.names)
        scatter = predicted_scatter(found, own, angle, noise)
        assert scatter.sum_rad2 > scatter.noise_rad2 * 70
        covariance.append(solution.covariance[np.ix_(order, order)])
    same = scatter_of_own_data(by_pixel, noise, design)
    other = scatter_of_other_data(by_pixel, noise, design, np.mean(covariance, axis=0))
    error = np.std(sums, axis=0, ddof=1) / np.sqrt(30)
    for mean, expected, spread in zip(np.mean(sums, axis=0), (same, other), error, strict=True):
        assert mean == pytest.approx(expected.sum_rad2, abs=4 * spread)
    assert design.shape[2] == 14
    assert same.sum_rad2 < 0.9 * 70 * same.noise_rad2
    assert other.sum_rad2 > 1.1 * 70 * same.noise_rad2


def test_evaluation_of_coordinates(bench, angle):
    """N = 81 vectors of one acquisition: sigma known to 5.6 %."""
    rng = np.random.default_rng(4)
    reading = angle + READING_RAD * rng.standard_normal(angle.shape)
    pixel = MODEL.project(bench.star_in_cam(angle)) + SIGMA_PX * rng.standard_normal((81, 2))
    pixel[40] += [1.5, 0.0]  # a wrong centroid
    vectors = star_vectors(MODEL, bench, pixel, reading)
    judged = vector_accuracy.vector_accuracy(vectors, residual_px(MODEL, bench, pixel, reading))
    np.testing.assert_array_equal(np.flatnonzero(judged.outlier), [40])
    assert judged.fit.count == 80
    across = np.cross(bench.table.angle_rates(angle), bench.star)  # of a reading's error, what moves the vector
    table = np.sqrt(((across**2).sum(2) * [0.2**2, 0.5**2]).sum(1).mean() / 2)
    expected = np.hypot(SIGMA_PX * 0.0055 / 40.0 * RAD_ARCSEC, table)
    assert judged.sigma_arcsec == pytest.approx(expected, rel=4 / np.sqrt(4 * 80))
    low, high = judged.interval_arcsec(0.9999)
    assert low < expected < high
    np.testing.assert_allclose(judged.fit.mean, bench.star, atol=2e-6)
    pixel_arcsec = 0.0055 / 40 * RAD_ARCSEC
    assert judged.pixel_method_arcsec(pixel_arcsec) == pytest.approx(judged.sigma_arcsec, rel=0.03)
    wide = judged.effective_interval_arcsec()
    assert wide[0] < judged.sigma_arcsec < wide[1]
