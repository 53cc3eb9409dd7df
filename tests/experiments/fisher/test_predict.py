"""Predicted covariances against the scatter of many noisy realisations, of new data and of the calibration's own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.star_vectors import initial_frame_vectors
from calib.cameras import BrownConrady, SensorGeometry
from calib.directional.fisher import mean_and_chords
from experiments.fisher.acquire import Motion, visit_once
from experiments.fisher.predict import (
    calibration_of_rows,
    covariance_of_rows,
    jitter_covariance_px2,
    on_the_sphere,
    predict_independent,
    predict_same_data,
    ratio_scatter,
    table_covariance_px2,
    tangent_maps,
)
from experiments.fisher.reduce import baseline_px, evaluate
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.bench import Bench, aim
from experiments.laboratory.single_star.reduce import Data, calibrated_bench, reduce_data
from experiments.laboratory.single_star.star import star_direction
from optics.units import ARCSEC_RAD, RAD_ARCSEC
from render.engine.random import Streams

SIGMA_PX = 0.02


@pytest.fixture(scope="module")
def model() -> BrownConrady:
    geometry = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
    return BrownConrady.create(geometry, focal_length_mm=50.0, x0_px=6.0, y0_px=-4.0, q1_per_mm2=2e-5)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(
        table=build_turntable("xy", reading_noise_arcsec=(0.2, 0.5), non_orthogonality_arcsec=4.0),
        star=star_direction(0.3, -0.2),
        installation=Rotation.from_rotvec([0.01, -0.02, 0.3]),
    )


@pytest.fixture(scope="module")
def angle(model: BrownConrady, bench: Bench) -> np.ndarray:
    return aim(bench, model.unproject(model.geometry.grid_px(9)), np.zeros(81))


def _vectors(model, bench, pixel, angle):
    turn = bench.table.rotation(angle)
    return initial_frame_vectors(model, pixel, installation=bench.installation, table_rotation=turn)


def test_tangent_maps_against_differences(model, bench, angle) -> None:
    maps = tangent_maps(model, bench, angle)
    pixel = model.project(bench.seen(angle))
    for axis in range(2):
        step = 0.01 * np.eye(2)[axis]
        moved = _vectors(model, bench, pixel + step, angle) - _vectors(model, bench, pixel - step, angle)
        np.testing.assert_allclose(
            np.linalg.norm(moved, axis=1) / 0.02, np.linalg.norm(maps[:, :, axis], axis=1), rtol=1e-6
        )


def test_the_prediction_is_what_noisy_data_scatter(model, bench, angle) -> None:
    """N = 800 runs of 81 vectors: the mean sum of squares is known to 0.3 %, variances to 5 %."""
    maps, rows = tangent_maps(model, bench, angle), calibration_of_rows(model, bench, angle)
    noise = SIGMA_PX**2 * np.broadcast_to(np.eye(2), maps.shape) + table_covariance_px2(model, bench, angle, Motion())
    predicted = predict_independent(maps, noise, rows, np.zeros((rows.shape[2], rows.shape[2])))
    rng, exact, sums, ratios = np.random.default_rng(3), model.project(bench.seen(angle)), [], []
    sigma = np.array([0.2, 0.5]) * ARCSEC_RAD
    for _ in range(800):
        pixel = exact + SIGMA_PX * rng.standard_normal(exact.shape)
        read = angle + sigma * rng.standard_normal(angle.shape)
        sums.append(mean_and_chords(_vectors(model, bench, pixel, read)[None])[1].sum())
        ratios.append(baseline_px(pixel - model.project(bench.seen(read))) / np.sqrt(sums[-1]))
    error = np.std(sums) / np.sqrt(len(sums))
    assert np.mean(sums) == pytest.approx(predicted.sum_rad2, abs=4 * error)
    assert np.var(sums) == pytest.approx(predicted.variance_rad4, rel=4 * np.sqrt(2 / 800))
    chance = 1 / np.sqrt(2 * 800)
    assert np.std(ratios) / np.mean(ratios) == pytest.approx(ratio_scatter(maps, noise), rel=4 * chance)
    z = [predicted.z_score(s) for s in sums]
    assert np.std(z) == pytest.approx(1.0, abs=4 / np.sqrt(1600))
    assert predicted.sigma_arcsec == pytest.approx(predicted.noise_arcsec, rel=1e-3)


def test_causes_add_up(model, bench, angle) -> None:
    maps, motion = tangent_maps(model, bench, angle), Motion(rate_rad_per_s=1e-3, jitter_s=2e-3, samples=4)
    both = on_the_sphere(maps, table_covariance_px2(model, bench, angle, motion))
    readings = on_the_sphere(maps, table_covariance_px2(model, bench, angle, Motion()))
    clocks = on_the_sphere(maps, jitter_covariance_px2(model, bench, angle, motion))
    assert both == pytest.approx(np.hypot(readings, clocks), rel=1e-12)
    # the second axis, Y carried by a turn about X, stands nearly across the star: the whole error, in one of two axes
    carried = Rotation.from_rotvec(angle[:, :1] * [1.0, 0.0, 0.0]).apply(bench.table.true_axis[1])
    share = np.mean(1.0 - (carried @ bench.star) ** 2)
    assert clocks == pytest.approx(1e-3 * 2e-3 * RAD_ARCSEC * np.sqrt(share / 2), rel=1e-9)


def test_same_data_lose_as_many_degrees_as_there_are_unknowns(model, bench, angle) -> None:
    maps, rows = tangent_maps(model, bench, angle), calibration_of_rows(model, bench, angle)
    even = np.linalg.inv(np.swapaxes(maps, 1, 2) @ maps)  # isotropic on the sphere
    same = predict_same_data(maps, even, rows)
    assert same.effective_degrees == pytest.approx(2 * len(maps) - rows.shape[2], rel=1e-9)
    assert same.satterthwaite == pytest.approx(2 * len(maps) - rows.shape[2], rel=1e-9)


def test_same_data_and_others_by_real_calibrations(model, bench) -> None:
    """N = 30 calibrations at 36 places: variances known to some 4 %."""
    angle = aim(bench, model.unproject(model.geometry.grid_px(6)), np.zeros(36))
    centroid = np.tile(SIGMA_PX**2 * np.eye(2), (36, 1, 1))
    maps, rows = tangent_maps(model, bench, angle), calibration_of_rows(model, bench, angle)
    noise = centroid + table_covariance_px2(model, bench, angle, Motion())
    exact, rng, sums, covariance = model.project(bench.seen(angle)), np.random.default_rng(5), [], []
    for run in range(30):
        first, second = (
            Data(
                pixel_px=exact + SIGMA_PX * rng.standard_normal(exact.shape),
                covariance_px2=centroid,
                reading_rad=bench.table.read(angle, Streams(5), call=2 * run + call),
            )
            for call in range(2)
        )
        found = reduce_data(first, bench.table, model, leans=True, start_star=np.array(bench.star))
        assert found.converged
        own = calibrated_bench(found, bench.table)
        vectors = [_vectors(found.model, own, data.pixel_px, data.reading_rad) for data in (first, second)]
        sums.append([mean_and_chords(one[None])[1].sum() for one in vectors])
        covariance.append(covariance_of_rows(found))
    same = predict_same_data(maps, noise, rows)
    other = predict_independent(maps, noise, rows, np.mean(covariance, axis=0))
    error = np.std(sums, axis=0, ddof=1) / np.sqrt(30)
    for mean, expected, spread in zip(np.mean(sums, axis=0), (same, other), error, strict=True):
        assert mean == pytest.approx(expected.sum_rad2, abs=4 * spread)
    assert rows.shape[2] == 14
    assert same.effective_degrees < 0.9 * 70
    assert other.effective_degrees > 1.1 * 70


def test_evaluation_of_coordinates(model, bench, angle) -> None:
    """N = 81 vectors of one acquisition: sigma known to 5.6 %."""
    places = visit_once(bench, bench.seen(angle), np.zeros(len(angle)), Motion(), 9, Streams(2))
    rng = np.random.default_rng(4)
    pixel = model.project(bench.seen(places.true_rad.copy())) + SIGMA_PX * rng.standard_normal((81, 2))
    pixel[40] += [1.5, 0.0]  # a wrong centroid
    judged = evaluate(model, bench, pixel, places.reading_rad)
    np.testing.assert_array_equal(np.flatnonzero(judged.outlier), [40])
    assert judged.fit.count == 80
    across = np.cross(bench.table.angle_rates(angle), bench.star)  # of a reading's error, what moves the vector
    table = np.sqrt(((across**2).sum(2) * [0.2**2, 0.5**2]).sum(1).mean() / 2)
    expected = np.hypot(SIGMA_PX * 0.0055 / 50.0 * RAD_ARCSEC, table)
    assert judged.sigma_arcsec == pytest.approx(expected, rel=4 / np.sqrt(4 * 80))
    low, high = judged.interval_arcsec(0.9999)
    assert low < expected < high
    np.testing.assert_allclose(judged.fit.mean, bench.star, atol=2e-6)
    assert baseline_px(judged.residual_px[~judged.outlier]) * 0.0055 / 50 * RAD_ARCSEC == pytest.approx(
        judged.sigma_arcsec, rel=0.03
    )


def test_motion_moves_the_star_along_one_axis(bench, angle) -> None:
    motion = Motion(rate_rad_per_s=1e-2, jitter_s=1e-3, samples=4)
    places = visit_once(bench, bench.seen(angle), np.zeros(len(angle)), motion, 9, Streams(2))
    np.testing.assert_allclose(np.abs(places.rate_rad_per_s), np.tile([0.0, 1e-2], (81, 1)))
    assert places.rate_rad_per_s[0, 1] == -places.rate_rad_per_s[9, 1]
    seen = places.directions(bench, exposure_s=0.1)
    assert seen.shape == (81, 4, 3)
    np.testing.assert_allclose(motion.instants_s(0.1), [-0.0375, -0.0125, 0.0125, 0.0375])
    length = np.linalg.norm(seen[:, 3] - seen[:, 0], axis=1)
    np.testing.assert_allclose(length, 1e-2 * 0.075, rtol=0.05)
    late = (places.reading_rad - places.true_rad)[:, 1]
    assert late.std() == pytest.approx(np.hypot(1e-5, 0.5 * ARCSEC_RAD), rel=4 / np.sqrt(162))
