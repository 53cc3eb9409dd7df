"""The predicted numbers of a grid target against the reduction of drawn errors; no code is shared."""

from __future__ import annotations

import numpy as np
import pytest

from calib.accuracy import distortion
from calib.accuracy.distortion_prediction import GridErrors, camera_projector, expected_map_error, expected_numbers

ORDER, CHIPS, SURVEYS = 3, 40, 25


@pytest.fixture(scope="module")
def errors():
    """A 4 x 8 grid with distortion, unequal and correlated errors of the points, and marking errors of that size."""
    rng = np.random.default_rng(3)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.9, 0.9, 8), np.linspace(-0.45, 0.45, 4)))
    position = np.column_stack([x, y]) + 1e-3 * rng.standard_normal((32, 2))
    root = 0.02 * rng.standard_normal((2, 32, 2, 2))
    chip, session = root @ root.swapaxes(-1, -2)
    return GridErrors(
        position=position,
        offset_px=0.02 * position * (position**2).sum(1)[:, None] ** 3 + 0.01 * rng.standard_normal((32, 2)),
        chip_px2=chip,
        session_px2=session,
        mean_px2=np.zeros((32, 2, 2)),
        marking_px=0.03,
    )


def _drawn(errors, reference):
    """sigma_d, sigma_Dd, sigma_C1 (chips, surveys, 3, 2) by the reduction of drawn errors."""
    rng = np.random.default_rng(11)
    of_chip, of_session = (np.linalg.cholesky(v + 1e-18 * np.eye(2)) for v in (errors.chip_px2, errors.session_px2))
    numbers = []
    for _ in range(CHIPS):
        normal = rng.standard_normal((3, 32, 2, 1))
        true = 1000.0 * errors.position + errors.offset_px + (of_chip @ normal[0])[..., 0]
        earlier, test = (true + (of_session @ one)[..., 0] for one in normal[1:])
        for _ in range(SURVEYS):
            nominal = 1000.0 * errors.position + errors.marking_px * rng.standard_normal((32, 2))
            d, _ = distortion.grid_residual_px(nominal, nominal / 1000.0, earlier, test, reference)
            numbers.append(distortion.distortion_statistics(nominal / 1000.0, d, ORDER).sigma_px)
    return np.reshape(numbers, (CHIPS, SURVEYS, 3, 2))


@pytest.mark.parametrize("reference", distortion.REFERENCES)
def test_numbers_are_those_of_drawn_errors(errors, reference):
    """Rationale: quadratic forms with projectors made otherwise. Expected: RMS and both scatters within sampling."""
    predicted, drawn = expected_numbers(errors, ORDER, reference), _drawn(errors, reference)
    rms = np.sqrt((drawn**2).mean((0, 1)))
    of_mean = np.hypot(predicted.frozen_px / np.sqrt(CHIPS), predicted.scatter_px / np.sqrt(CHIPS * SURVEYS))
    np.testing.assert_array_less(np.abs(rms - predicted.rms_px), 4.0 * of_mean)
    np.testing.assert_allclose(drawn.std((0, 1)), predicted.scatter_px, rtol=0.15)
    several = predicted.frozen_px**2 + (predicted.scatter_px**2 - predicted.frozen_px**2) / SURVEYS
    over_surveys = np.sqrt((drawn**2).mean(1)).std(0, ddof=1)
    np.testing.assert_allclose(over_surveys, np.sqrt(several), rtol=4.0 / np.sqrt(2.0 * CHIPS))


def test_noise_of_the_expected_places_is_not_taken_for_distortion(errors):
    """Places known with an error e make |Q u|^2 larger by tr(Q e): it is taken away, and enters the uncertainty."""
    rng, known = np.random.default_rng(5), 0.02
    squares = []
    for _ in range(400):
        noisy = GridErrors(
            **{name: getattr(errors, name) for name in ("position", "chip_px2", "session_px2", "marking_px")},
            offset_px=errors.offset_px + known * rng.standard_normal((32, 2)),
            mean_px2=np.tile(known**2 * np.eye(2), (32, 1, 1)),
        )
        squares.append(expected_numbers(noisy, ORDER, "calibrated").rms_px ** 2)
    exact = expected_numbers(errors, ORDER, "calibrated").rms_px ** 2
    np.testing.assert_array_less(np.abs(np.mean(squares, 0) - exact), 4.0 * np.std(squares, 0) / np.sqrt(400))


@pytest.mark.parametrize(("reference", "count"), [("nominal", 0), ("aligned", 4), ("calibrated", 8)])
def test_a_camera_is_projected_onto_itself_and_nothing_else(reference, count):
    """Terms of Brown and Conrady in real coordinates; a projector has the trace of its dimension."""
    position = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 2))
    projector = camera_projector(position, reference)
    terms = distortion.camera_terms(position, reference).reshape(80, count)
    np.testing.assert_allclose(projector @ terms, terms, atol=1e-12)
    assert np.trace(projector) == pytest.approx(count)
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)


def grid(rows, columns, reach=1.0):
    """Positions (n, 2) of a regular grid on a detector twice as wide as high."""
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, columns), np.linspace(-0.45, 0.45, rows))
    return reach * np.column_stack([x.ravel(), y.ravel()])


def wide_lens(position):
    """Barrel distortion up to the seventh order, 60 px at the corners."""
    r2 = (position**2).sum(1, keepdims=True)
    return position * (40.0 * r2 + 15.0 * r2**2 + 5.0 * r2**3)


@pytest.mark.parametrize("reference", distortion.REFERENCES)
def test_the_map_error_of_a_wide_lens_is_predicted_for_every_camera(reference):
    """8 x 4 points, order 3, a distortion of order 7: bias as reduced, noise of 300 surveys. Points left out stand
    where the fit is held: they show less than the map error, by five for the calibrated camera."""
    position, field = grid(4, 8, reach=0.8), grid(17, 33)
    offset, field_offset = wide_lens(position), wide_lens(field)

    def true_error(noise):
        measured = offset + noise
        d, camera = distortion.grid_residual_px(np.zeros_like(position), position, measured, measured, reference)
        fit = distortion.distortion_statistics(position, d, ORDER).coefficient_px
        given = {"camera_px": camera, "polynomial_px": fit, "reference": reference, "order": ORDER}
        return distortion.map_error_px(field, field_offset, **given)

    sigma, rng = 0.1, np.random.default_rng(4)
    expected = expected_map_error(
        position, offset, field, field_offset, order=ORDER, reference=reference, point_error_px=sigma
    )
    exact = true_error(0.0)
    np.testing.assert_allclose(expected.bias_px, np.sqrt((exact**2).mean(0)), rtol=1e-6)
    change = np.array([true_error(sigma * rng.standard_normal(position.shape)) - exact for _ in range(300)])
    np.testing.assert_allclose(expected.noise_px, np.sqrt((change**2).mean((0, 1))), rtol=4.0 / np.sqrt(2 * 300 * 7))
    left_out = distortion.deleted_rms_px(position, offset, ORDER, reference)
    assert expected.bias_px.min() > 1.2 * left_out[0].max()
    assert np.isnan(left_out[1]).all()  # four rows do not test a cubic: without one of them it is arbitrary
