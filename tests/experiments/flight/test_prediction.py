"""Predicted errors of an attitude in flight against attitudes that are solved from stars with these errors."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_sensors import RAYS, sensor

from calib.attitude.attitude_covariance import attitude_of_shifts
from calib.attitude.attitude_solution import solve_wahba
from experiments.flight.loop import by_budget
from experiments.flight.prediction import Budget, build_budget
from experiments.flight.scenario import build_flight
from experiments.flight.settings import FlightConfig
from optics.attitude import attitude_error_arcsec
from optics.field_map import fit_field_map
from optics.stellar_aberration import aberrated
from optics.units import RAD_ARCSEC

TIME_S, REST, WINDOW = 900.0, np.zeros(3), 11
GROWTH = 2e-4
"""Of the image, per kelvin."""


@pytest.fixture(scope="module")
def budget():
    """A small aged tracker with many hot pixels and a uniform growth of the image as its thermal sensitivity."""
    config = FlightConfig(
        **sensor(700, **RAYS),
        detector={"hot_fraction": 2e-3},
        window_px=WINDOW,
        temperature={"offset_k": 0, "mean_k": 0, "eclipse_k": 0},
        attitude={"law": "inertial"},
        aberration={"corrected": "earth"},
        life={"darkened_glass": 0.0, "contamination": 0.2},
    )
    budget = build_budget(config, build_flight(config), old=True)
    offset_px = budget._map.pixel_px - budget.model.geometry.centre_px
    budget.__dict__["sensitivity"] = {"mean_k": fit_field_map(budget._map.direction, GROWTH * offset_px)}
    return budget


@pytest.fixture(scope="module")
def predicted(budget):
    """An attitude with enough stars, and its predicted errors."""
    for attitude in Rotation.random(100, rng=np.random.default_rng(3)):
        errors = budget.errors_of(attitude, REST, TIME_S, state_k=np.array([3.0, 0.0, 0.0, 0.0, 0.0]))
        if errors.available and errors.stars > 9.0:
            return attitude, errors
    raise AssertionError


def stars_of(budget, attitude):
    rows, v = budget.expected(attitude, budget.flight.velocity_km_per_s(TIME_S))
    light = float(budget.flight.background_e_per_s(TIME_S, attitude))
    star = budget.star_errors(light, REST, rows, v)
    return rows, v, (star.noise_px, star.pattern_px, np.hypot(star.phase_px, star.colour_phase_px), star.shift_px)


@pytest.mark.slow
def test_random_errors_are_the_scatter_of_attitudes(budget, predicted):
    """3000 draws; a star with a bad pixel in its window is left out."""
    attitude, errors = predicted
    rows, v, (noise, pixel, spot, _) = stars_of(budget, attitude)
    fit = (1.0 - 2e-3 - budget.nominal.detector.dead_fraction) ** (WINDOW * WINDOW)
    assert errors.stars == pytest.approx(fit * len(v))
    weight = 1.0 / (noise**2 + budget.unmodelled_px2(rows, v))
    rng, position_px = np.random.default_rng(5), budget.model.project(v)
    for sigma, square in ((noise, errors.noise_arcsec2), (pixel, errors.pixel_arcsec2), (spot, errors.spot_arcsec2)):
        pixel_px = position_px + sigma[:, None] * rng.standard_normal((3000, len(v), 2))
        shift = budget.model.unproject(pixel_px.reshape(-1, 2)).reshape(3000, -1, 3) - v
        weights = (rng.random((3000, len(v))) < fit) * weight
        error = [RAD_ARCSEC * attitude_of_shifts(v, *draw) for draw in zip(weights, shift, strict=True)]
        np.testing.assert_allclose(np.sqrt(np.mean(np.square(error), axis=0)), np.sqrt(square), rtol=0.08)


def test_systematic_shifts_rotate_the_attitude(budget, predicted):
    """Colour and residual distortion; an image grown by 6e-4; an error of the velocity."""
    attitude, errors = predicted
    rows, v, (noise, _, _, shift) = stars_of(budget, attitude)
    sigma = np.sqrt(noise**2 + budget.unmodelled_px2(rows, v))
    position_px = budget.model.project(v)
    growth_px = 3.0 * GROWTH * (position_px - budget.model.geometry.centre_px)
    for shift_px, expected in ((shift, errors.fov_arcsec), (growth_px, errors.thermal_arcsec)):
        solved = solve_wahba(budget.model.unproject(position_px + shift_px), v, sigma_rad=budget.pixel_rad * sigma)
        error = attitude_error_arcsec(solved.rotation, Rotation.identity())
        np.testing.assert_allclose(expected, error, atol=0.02 * np.abs(error).max())
    stars, flight = np.array(budget.guides.direction[rows]), budget.flight
    true = attitude.apply(aberrated(stars, flight.velocity_km_per_s(TIME_S)))
    solved = solve_wahba(true, aberrated(stars, flight.known_velocity_km_per_s(TIME_S)))
    error = attitude_error_arcsec(solved.rotation, attitude)
    np.testing.assert_allclose(errors.aberration_arcsec[:2], error[:2], atol=0.02 * np.abs(error).max())


def test_the_sensor_of_a_loop_errs_as_the_budget(budget, predicted):
    """30 groups, 11 s apart, of 20 frames: noise is drawn for every frame, spatial errors for every group."""
    attitude, errors = predicted
    sensor, groups, frames = by_budget(budget.config, budget=budget), 30, 20
    readings = [[sensor(attitude, REST, TIME_S + 11.0 * k + 0.01 * n) for n in range(frames)] for k in range(groups)]
    error = np.array([[attitude_error_arcsec(r.attitude, attitude) for r in group] for group in readings])
    noise2, static2 = errors.noise_arcsec2, errors.static_arcsec2
    np.testing.assert_allclose(
        error.var(axis=1, ddof=1).mean(0), noise2, rtol=4.0 * np.sqrt(2.0 / groups / (frames - 1))
    )
    static = error.mean(1) - [
        budget.aberration_arcsec(TIME_S + 11.0 * k, attitude) + errors.fov_arcsec + budget.bias_arcsec()
        for k in range(groups)
    ]
    group2 = static2 + noise2 / frames
    assert np.all(np.abs(static.mean(0)) < 4.0 * np.sqrt(group2 / groups))
    np.testing.assert_allclose((static**2).mean(0), group2, rtol=4.0 * np.sqrt(2.0 / groups))
    np.testing.assert_allclose(np.diag(readings[0][0].covariance_rad2) * RAD_ARCSEC**2, noise2 + static2, rtol=1e-6)


@pytest.mark.slow
def test_a_lens_warmer_by_three_kelvin_moves_stars_by_three_times_its_sensitivity(budget):
    """The sensitivity is a central difference of one kelvin; the response to the mean temperature is nearly linear."""
    warm = SimpleNamespace(thermal=SimpleNamespace(values_k=np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])))
    stub = SimpleNamespace(flight=warm, _map=budget._map, _traced=budget._traced)
    (sensitivity,) = Budget.sensitivity.func(stub).values()
    moved = budget._traced(np.array([3.0, 0.0, 0.0, 0.0, 0.0])) - budget._map.pixel_px
    assert np.abs(moved).max() > 0.01
    np.testing.assert_allclose(3.0 * sensitivity.at(budget._map.direction), moved, atol=0.03 * np.abs(moved).max())


def test_star_errors_without_noise(budget, predicted, monkeypatch):
    """The camera model's residual, read from its map; colours of a star over the field, the mean of both axes."""
    direction, pixel = budget._map.direction, budget._map.pixel_px
    residual_px = pixel - budget.model.project(direction)
    assert np.std(residual_px - budget._residual.at(direction)) < 0.5 * np.std(residual_px)
    rows, v, _ = stars_of(budget, predicted[0])
    away = budget.model.project(v) - budget.model.geometry.centre_px
    # an error of the scale, root mean square 1e-3: half of the square of the distance along an axis
    monkeypatch.setitem(budget.__dict__, "_common_error", (budget._common_error[0], 1e-3))
    assert budget.unmodelled_px2(rows, v) == pytest.approx(
        budget.star_error_px[rows] ** 2 + ((1e-3 * away) ** 2).mean(1)
    )
    rng, star = np.random.default_rng(2), int(np.argmax(budget.sky.temperature_k[budget.guides.row]))
    away = rng.uniform(-350.0, 350.0, (4000, 2))
    radius, kelvin = np.hypot(*away.T), float(budget.sky.temperature_k[budget.guides.row[star]])
    shift, spot = budget.colour_px(np.full(4000, kelvin), radius)
    moved = shift[:, None] * away / radius[:, None]
    expected = (moved**2).mean() + (spot**2).mean() + budget._common_error[0]
    assert (moved**2).mean() > 0.02 * expected
    assert budget.star_error_px[star] ** 2 == pytest.approx(expected, rel=0.02)
