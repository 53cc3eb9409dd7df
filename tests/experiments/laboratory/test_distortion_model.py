"""The predicted numbers of a grid target against the document's reduction of drawn errors; no code is shared."""

import numpy as np
import pytest

from experiments.laboratory import distortion_model
from experiments.laboratory.devices.targets import GridTarget, grid_directions
from experiments.laboratory.distortion_error import DenseMap, camera_place, dense_grid, grid_residual_px
from experiments.laboratory.distortion_model import GridErrors, forecast_map, predicted_numbers
from experiments.laboratory.distortion_statistics import REFERENCES, distortion_statistics
from render.engine.random import Streams

ORDER, CHIPS, SURVEYS = 3, 40, 25


@pytest.fixture(scope="module")
def errors():
    """A 4 x 8 grid with distortion, unequal and correlated errors of the points, and marking errors of that size."""
    rng = np.random.default_rng(3)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.9, 0.9, 8), np.linspace(-0.45, 0.45, 4)))
    place = np.column_stack([x, y]) + 1e-3 * rng.standard_normal((32, 2))
    root = 0.02 * rng.standard_normal((2, 32, 2, 2))
    chip, session = root @ root.swapaxes(-1, -2)
    return GridErrors(
        place=place,
        offset_px=0.02 * place * (place**2).sum(1)[:, None] ** 3 + 0.01 * rng.standard_normal((32, 2)),
        chip_px2=chip,
        session_px2=session,
        mean_px2=np.zeros((32, 2, 2)),
        marking_px=0.03,
    )


def _drawn(errors, reference):
    """sigma_d, sigma_Dd, sigma_C1 (chips, surveys, 3, 2) by the document's reduction of drawn errors."""
    rng = np.random.default_rng(11)
    of_chip, of_session = (np.linalg.cholesky(v + 1e-18 * np.eye(2)) for v in (errors.chip_px2, errors.session_px2))
    found = []
    for _ in range(CHIPS):
        normal = rng.standard_normal((3, 32, 2, 1))
        true = 1000.0 * errors.place + errors.offset_px + (of_chip @ normal[0])[..., 0]
        earlier, test = (true + (of_session @ one)[..., 0] for one in normal[1:])
        for _ in range(SURVEYS):
            nominal = 1000.0 * errors.place + errors.marking_px * rng.standard_normal((32, 2))
            d, _ = grid_residual_px(nominal, nominal / 1000.0, earlier, test, reference)
            s = distortion_statistics(nominal / 1000.0, d, ORDER)
            found.append([s.sigma_d_px, s.sigma_left_px, s.sigma_c1_px])
    return np.reshape(found, (CHIPS, SURVEYS, 3, 2))


@pytest.mark.parametrize("reference", REFERENCES)
def test_numbers_are_those_of_drawn_errors(errors, reference):
    """Rationale: quadratic forms with projectors made otherwise. Expected: RMS and both scatters within sampling."""
    predicted, drawn = predicted_numbers(errors, ORDER, reference), _drawn(errors, reference)
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
            **{name: getattr(errors, name) for name in ("place", "chip_px2", "session_px2", "marking_px")},
            offset_px=errors.offset_px + known * rng.standard_normal((32, 2)),
            mean_px2=np.tile(known**2 * np.eye(2), (32, 1, 1)),
        )
        squares.append(predicted_numbers(noisy, ORDER, "calibrated").rms_px ** 2)
    exact = predicted_numbers(errors, ORDER, "calibrated").rms_px ** 2
    np.testing.assert_array_less(np.abs(np.mean(squares, 0) - exact), 4.0 * np.std(squares, 0) / np.sqrt(400))


def test_dense_map_spans_the_detector_and_states_rms_per_axis(small_camera):
    width, height = small_camera.camera.width_px, small_camera.camera.height_px
    nominal = camera_place(small_camera, dense_grid(small_camera, 3, 5))[0].reshape(3, 5, 2)
    np.testing.assert_allclose(nominal[[0, 0, -1], [0, -1, 0]], [[0, 0], [width - 1, 0], [0, height - 1]], atol=1e-8)
    left = np.array([[3.0, 0.0], [4.0, 0.2]])
    one = DenseMap(nominal_px=left, shape=(1, 2), uncorrected_px=left, corrected_px=0.1 * left)
    np.testing.assert_allclose(one.uncorrected_rms_px, [np.sqrt(12.5), np.sqrt(0.02)])
    np.testing.assert_allclose(one.rms_px, 0.1 * one.uncorrected_rms_px)


def test_forecast_of_a_map_is_what_drawn_point_errors_make(small_camera, bench_of, monkeypatch):
    """A cubic distortion that a cubic map follows; errors of the points through plain least squares, 500 draws."""
    target, grid = GridTarget(rows=5, columns=6, marking_error_arcsec=0.4), (8, 12)

    def distorted(direction):
        nominal, place = camera_place(small_camera, direction)
        return nominal + 3.0 * place * (place**2).sum(1, keepdims=True) - 0.7 * place[:, ::-1] ** 2

    monkeypatch.setattr(distortion_model, "traced_bundles", lambda bench, instrument, direction: distorted(direction))
    dense = dense_grid(small_camera, *grid)
    given = {"order": 3, "point_error_px": 0.05, "traced_px": distorted(dense), "grid": grid}
    found = forecast_map(bench_of(), small_camera, target, **given)
    assert found.bias_px.max() < 1e-9
    points = grid_directions(target, small_camera, Streams(0).generator("forecast"))
    at, over = (camera_place(small_camera, direction)[1].T for direction in (points, dense))
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    fit, shown = (np.stack([x**i * y**j for i, j in powers], axis=1) for x, y in (at, over))
    sigma = np.hypot(0.05, 0.4 / small_camera.pixel_arcsec)
    error = sigma * np.random.default_rng(2).standard_normal((500, 2, len(points)))
    maps = np.einsum("gp,nap->nga", shown @ np.linalg.pinv(fit), error)
    maps -= maps.mean(1, keepdims=True)
    roll = np.column_stack([-over[1], over[0]])
    roll -= roll.mean(0)
    maps -= ((maps * roll).sum((1, 2)) / (roll**2).sum())[:, None, None] * roll
    drawn = np.sqrt((maps**2).mean((0, 1)))
    np.testing.assert_allclose(found.noise_px, drawn, rtol=4.0 / np.sqrt(2 * 500 * 7))
