"""Predicted errors of an attitude in flight against attitudes that are solved from stars with these errors."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.attitude_covariance import attitude_of_shifts
from calib.attitude.attitude_solution import solve_wahba
from experiments.flight.loop import by_budget
from experiments.flight.prediction import Budget, build_budget
from experiments.flight.scenario import build_flight
from experiments.flight.settings import Config
from optics.attitude import attitude_error_arcsec
from optics.field_map import fit_field_map
from optics.stellar_aberration import aberrated
from optics.units import RAD_ARCSEC

TIME_S, REST, WINDOW = 900.0, np.zeros(3), 11
GROWTH = 2e-4
"""Of the image, per kelvin."""


@pytest.fixture(scope="module")
def budget():
    """A small old tracker with many hot pixels, without a thermal state; an even growth of the image is put in."""
    chip = {"lens": "star_tracker_26mm", "detector": "cmv4000", "width_px": 700, "height_px": 700, "exposure_s": 0.2}
    config = Config(
        instrument={**chip, "defocus_mm": 0.0, "diffraction": "rays"},
        passband={"range_nm": [500.0, 800.0]},
        detector={"hot_fraction": 2e-3},
        window_px=WINDOW,
        temperature={"offset_k": 0, "mean_k": 0, "eclipse_k": 0},
        attitude={"law": "inertial"},
        aberration={"corrected": "earth"},
        life={"darkened_glass": 0.0, "contamination": 0.2},
    )
    made = build_budget(config, build_flight(config), old=True)
    direction = made._map.direction
    away = made._map.pixel_px - made.model.geometry.centre_px
    made.__dict__["sensitivity"] = {"mean_k": fit_field_map(direction, GROWTH * away)}
    return made


@pytest.fixture(scope="module")
def seen(budget):
    """An attitude with stars enough, and what is predicted of it."""
    for attitude in Rotation.random(100, rng=np.random.default_rng(3)):
        found = budget.errors_of(attitude, REST, TIME_S, state_k=np.array([3.0, 0.0, 0.0, 0.0, 0.0]))
        if found.available and found.stars > 9.0:
            return attitude, found
    raise AssertionError


def stars_of(budget, attitude):
    rows, v = budget.expected(attitude, budget.flight.velocity_km_per_s(TIME_S))
    light = float(budget.flight.background_e_per_s(TIME_S, attitude))
    noise, pixel, phase, spot, shift = budget._star_errors(light, REST, rows, v)
    return rows, v, (noise, pixel, np.hypot(phase, spot), shift)


@pytest.mark.slow
def test_random_errors_are_the_scatter_of_attitudes(budget, seen):
    """3000 draws; a star with a bad pixel in its window is left out."""
    attitude, told = seen
    rows, v, (noise, pixel, spot, _) = stars_of(budget, attitude)
    fit = (1.0 - 2e-3 - budget.nominal.detector.dead_fraction) ** (WINDOW * WINDOW)
    assert told.stars == pytest.approx(fit * len(v))
    weight = 1.0 / (noise**2 + budget.unmodelled_px2(rows, v))
    rng, place = np.random.default_rng(5), budget.model.project(v)
    for sigma, square in ((noise, told.noise_arcsec2), (pixel, told.pixel_arcsec2), (spot, told.spot_arcsec2)):
        pixel_px = place + sigma[:, None] * rng.standard_normal((3000, len(v), 2))
        shift = budget.model.unproject(pixel_px.reshape(-1, 2)).reshape(3000, -1, 3) - v
        lit = (rng.random((3000, len(v))) < fit) * weight
        error = [RAD_ARCSEC * attitude_of_shifts(v, w, moved) for w, moved in zip(lit, shift, strict=True)]
        np.testing.assert_allclose(np.sqrt(np.mean(np.square(error), axis=0)), np.sqrt(square), rtol=0.08)


def test_known_shifts_turn_the_attitude_their_way(budget, seen):
    """Colour and what the camera model leaves; an image that grew by 6e-4; a velocity that is not all known."""
    attitude, told = seen
    rows, v, (noise, _, _, shift) = stars_of(budget, attitude)
    sigma = np.sqrt(noise**2 + budget.unmodelled_px2(rows, v))
    place = budget.model.project(v)
    away = place - budget.model.geometry.centre_px
    for moved, expected in ((shift, told.fov_arcsec), (3.0 * GROWTH * away, told.thermal_arcsec)):
        solved = solve_wahba(budget.model.unproject(place + moved), v, sigma_rad=budget.pixel_rad * sigma)
        error = attitude_error_arcsec(solved.rotation, Rotation.identity())
        np.testing.assert_allclose(expected, error, atol=0.02 * np.abs(error).max())
    stars, flight = np.array(budget.guides.direction[rows]), budget.flight
    true = attitude.apply(aberrated(stars, flight.velocity_km_per_s(TIME_S)))
    solved = solve_wahba(true, aberrated(stars, flight.known_velocity_km_per_s(TIME_S)))
    error = attitude_error_arcsec(solved.rotation, attitude)
    np.testing.assert_allclose(told.aberration_arcsec[:2], error[:2], atol=0.02 * np.abs(error).max())


def test_the_sensor_of_a_loop_errs_as_the_budget(budget, seen):
    """Thirty looks, 11 s apart, of 20 frames each: noise is new in every frame, what pixels do in every look."""
    attitude, told = seen
    sensor, looks, frames = by_budget(budget.config, budget=budget), 30, 20
    found = [[sensor(attitude, REST, TIME_S + 11.0 * k + 0.01 * n) for n in range(frames)] for k in range(looks)]
    error = np.array([[attitude_error_arcsec(one.attitude, attitude) for one in look] for look in found])
    noise2, static2 = told.noise_arcsec2, told.static_arcsec2
    np.testing.assert_allclose(
        error.var(axis=1, ddof=1).mean(0), noise2, rtol=4.0 * np.sqrt(2.0 / looks / (frames - 1))
    )
    each = error.mean(1) - [
        budget.aberration_arcsec(TIME_S + 11.0 * k, attitude) + told.fov_arcsec + budget.bias_arcsec()
        for k in range(looks)
    ]
    of_look2 = static2 + noise2 / frames
    assert np.all(np.abs(each.mean(0)) < 4.0 * np.sqrt(of_look2 / looks))
    np.testing.assert_allclose((each**2).mean(0), of_look2, rtol=4.0 * np.sqrt(2.0 / looks))
    np.testing.assert_allclose(np.diag(found[0][0].covariance_rad2) * RAD_ARCSEC**2, noise2 + static2, rtol=1e-6)


@pytest.mark.slow
def test_a_lens_warmer_by_three_kelvin_moves_stars_by_three_times_its_sensitivity(budget):
    """The differences are of one kelvin to either side; a shift of the mean temperature is nearly linear."""
    warm = SimpleNamespace(thermal=SimpleNamespace(values_k=np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])))
    stub = SimpleNamespace(flight=warm, _map=budget._map, _traced=budget._traced)
    (told,) = Budget.sensitivity.func(stub).values()
    moved = budget._traced(np.array([3.0, 0.0, 0.0, 0.0, 0.0])) - budget._map.pixel_px
    assert np.abs(moved).max() > 0.01
    np.testing.assert_allclose(3.0 * told.at(budget._map.direction), moved, atol=0.03 * np.abs(moved).max())


def test_what_stars_err_by_besides_noise(budget, seen, monkeypatch):
    """The camera model's residual, read from its map; colours of a star over the field, the mean of both axes."""
    direction, pixel = budget._map.direction, budget._map.pixel_px
    left = pixel - budget.model.project(direction)
    assert np.std(left - budget._residual.at(direction)) < 0.5 * np.std(left)
    rows, v, _ = stars_of(budget, seen[0])
    away = budget.model.project(v) - budget.model.geometry.centre_px
    # an error of the scale, root mean square 1e-3: half of the square of the distance along an axis
    monkeypatch.setitem(budget.__dict__, "_alike", (budget._alike[0], 1e-3))
    assert budget.unmodelled_px2(rows, v) == pytest.approx(
        budget.star_error_px[rows] ** 2 + ((1e-3 * away) ** 2).mean(1)
    )
    rng, star = np.random.default_rng(2), int(np.argmax(budget.sky.temperature_k[budget.guides.row]))
    away = rng.uniform(-350.0, 350.0, (4000, 2))
    radius, kelvin = np.hypot(*away.T), float(budget.sky.temperature_k[budget.guides.row[star]])
    shift, spot = budget.colour_px(np.full(4000, kelvin), radius)
    moved = shift[:, None] * away / radius[:, None]
    expected = (moved**2).mean() + (spot**2).mean() + budget._alike[0]
    assert (moved**2).mean() > 0.02 * expected
    assert budget.star_error_px[star] ** 2 == pytest.approx(expected, rel=0.02)
