"""Predicted errors of an attitude in flight against attitudes that are solved from stars with these errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from calib.attitude.solve import solve_wahba, solve_wahba_many
from calib.cameras.field_map import fit_field_map
from experiments.flight.loop import by_budget
from experiments.flight.prediction import Budget, build_budget
from experiments.flight.scenario import build_flight
from experiments.flight.settings import Config
from optics.attitude import aberrated, attitude_error_arcsec
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


def test_random_errors_are_the_scatter_of_attitudes(budget, seen):
    """3000 draws; a star with a bad pixel in its window is left out."""
    attitude, told = seen
    rows, v, (noise, pixel, spot, _) = stars_of(budget, attitude)
    bad = 2e-3 + budget.nominal.detector.dead_fraction
    fit, rng, draws = (1.0 - bad) ** (WINDOW * WINDOW), np.random.default_rng(5), 3000
    assert fit < 0.8
    assert told.stars == pytest.approx(fit * len(v))
    stated = budget.pixel_rad * np.sqrt(noise**2 + budget.unmodelled_px2(rows, v))
    frame = np.repeat(np.arange(draws), len(v))
    for sigma, square in ((noise, told.noise_arcsec2), (pixel, told.pixel_arcsec2), (spot, told.spot_arcsec2)):
        place = budget.model.project(v) + sigma[:, None] * rng.standard_normal((draws, len(v), 2))
        there = rng.random(len(frame)) < fit
        solved = solve_wahba_many(
            budget.model.unproject(place.reshape(-1, 2))[there],
            np.tile(v, (draws, 1))[there],
            frame[there],
            frames=draws,
            sigma_rad=np.tile(stated, draws)[there],
        )
        error = attitude_error_arcsec(solved.rotation, Rotation.identity(draws))
        np.testing.assert_allclose(np.sqrt(np.nanmean(error**2, axis=0)), np.sqrt(square), rtol=0.08)


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


def test_spots_that_lie_elsewhere_bias_the_fit_by_as_much(budget, monkeypatch):
    """PSFs of the tracker moved by 0.02 px outwards and by 0.03 px across; they lie 22.5 deg from the rows."""
    outwards = np.radians(22.5)
    moved = []
    for dx, dy in ((0.02, 0.0), (0.0, 0.03)):
        x, y = np.array([[np.cos(outwards), -np.sin(outwards)], [np.sin(outwards), np.cos(outwards)]]) @ [dx, dy]
        moved.append(
            tuple(
                replace(one, values=ndimage.shift(one.values, np.array([y, x]) * one.oversampling))
                for one in budget.usual.state.psfs
            )
        )
    mean, spread = budget._fit_bias(*moved)
    np.testing.assert_allclose(mean[0], 0.02, atol=1e-3)
    np.testing.assert_allclose(mean[1], 0.0, atol=1e-3)
    assert spread.max() < 2e-3
    # outwards by it, a star of 10 000 K
    fields, hot, there = len(budget.nominal.state.radius_px), np.array([1e4]), np.array([100.0])
    monkeypatch.setitem(budget.__dict__, "_colour_bias", (np.full((2, fields), 0.02), np.zeros((2, fields))))
    beside = budget.colour_px(hot, there)[0] - budget.nominal.state.colour_shift_px(hot, there)
    assert beside == pytest.approx([0.02])


def test_what_stars_err_by_besides_noise(budget, seen, monkeypatch):
    """The camera model's residual, read from its map; colours of a star over the field, the mean of both axes."""
    direction, pixel = budget._map.direction, budget._map.pixel_px
    left = pixel - budget.model.project(direction)
    assert np.std(left - budget._residual.at(direction)) < 0.5 * np.std(left)
    rows, v, (_, _, _, shift) = stars_of(budget, seen[0])
    away = budget.model.project(v) - budget.model.geometry.centre_px
    colour = budget.colour_px(budget.sky.temperature_k[budget.guides.row[rows]], np.hypot(*away.T))[0]
    radius, sky = np.hypot(*away.T), budget.guides.row[rows]
    stars, state = budget.nominal.stars, budget.nominal.state
    electrons = 0.8 * 0.2 * state.electrons_per_s(budget.sky.magnitude[sky], budget.sky.temperature_k[sky], radius)
    pattern = stars.sigma_at(stars.centroid.pattern_px, electrons, radius)
    assert budget._star_errors(0.0, REST, rows, v)[1] == pytest.approx(pattern, rel=1e-9)
    rest = shift - colour[:, None] * away / np.hypot(*away.T)[:, None]
    nearest = np.argmin(((direction[:, None] - v) ** 2).sum(-1), axis=0)
    assert (rest * left[nearest]).sum() > 0.5 * (left[nearest] ** 2).sum()
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
