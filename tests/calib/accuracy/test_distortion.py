"""ACC18 eq. 17-30 on residuals whose statistics are known."""

from __future__ import annotations

import numpy as np
import pytest

from calib import BrownConrady, SensorGeometry
from calib.accuracy import distortion

X, Y = np.meshgrid(np.linspace(-0.89, 0.89, 8), np.linspace(-0.44, 0.44, 4))
PLACE = np.column_stack([X.ravel(), Y.ravel()])


def test_a_cubic_leaves_all_of_an_orthogonal_quartic():
    """x^4 without its part in polynomials of degree 3 is left whole, in x; y keeps nothing. Divisor of the variance:
    W - 1."""
    lower = distortion.polynomial_terms(PLACE, 3)
    quartic = PLACE[:, 0] ** 4
    quartic = quartic - lower @ np.linalg.lstsq(lower, quartic, rcond=None)[0]
    d = np.column_stack([quartic, np.zeros(32)])
    found = distortion.distortion_statistics(PLACE, d, 3)
    np.testing.assert_allclose(found.residual_px, d, atol=1e-14)
    np.testing.assert_allclose(found.sigma_px[1], [np.sqrt((quartic**2).sum() / 31.0), 0.0], rtol=1e-9, atol=1e-15)
    assert found.sigma_px[2].max() < 1e-8


def test_of_pure_noise_a_cubic_removes_nine_of_31_parts():
    rng, runs = np.random.default_rng(1), 2000
    removed = np.mean(
        [distortion.distortion_statistics(PLACE, rng.normal(size=(32, 2)), 3).sigma_px[2] ** 2 for _ in range(runs)]
    )
    assert removed == pytest.approx(9.0 / 31.0, rel=4.0 * np.sqrt(2.0 / 9.0 / (2 * runs)))


def test_shift_roll_and_scale_change_what_is_found_but_not_what_is_left():
    d = 0.02 * np.random.default_rng(2).normal(size=(32, 2))
    more = d + distortion.camera_terms(PLACE, "aligned") @ np.array([1.0, -2.0, 0.5, 0.3])
    one, other = distortion.distortion_statistics(PLACE, d, 3), distortion.distortion_statistics(PLACE, more, 3)
    np.testing.assert_allclose(one.residual_px, other.residual_px, atol=1e-12)
    assert np.all(other.sigma_px[2] > 5 * one.sigma_px[2])


def test_the_camera_follows_a_brown_conrady_lens():
    geometry = SensorGeometry(width_px=4096, height_px=2048, pixel_pitch_mm=0.0055)
    model = BrownConrady.create(
        geometry, focal_length_mm=206.0, q1_per_mm2=2e-6, q2_per_mm4=1e-9, p1_per_mm=1e-6, p2_per_mm=-2e-6
    )
    half = 0.5 * np.hypot(4096, 2048)
    ideal = np.column_stack([PLACE * half * 0.0055 / 206.0, np.ones(32)])
    nominal = geometry.centre_px + PLACE * half
    offset = model.project(ideal / np.linalg.norm(ideal, axis=1, keepdims=True)) - nominal
    left = offset - distortion.camera_terms(PLACE, "calibrated") @ distortion.fit_camera_terms(
        PLACE, offset, "calibrated"
    )
    assert np.abs(offset).max() > 0.5
    assert np.abs(left).max() < 1e-9


def test_pointing_is_shift_and_roll_but_not_scale():
    shift_roll, scale = (
        distortion.camera_terms(PLACE, "aligned") @ np.array(c) for c in ([0.3, 0.1, 0.0, 0.2], [0, 0, 1.0, 0])
    )
    assert np.abs(distortion.without_pointing(PLACE, shift_roll)).max() < 1e-12
    np.testing.assert_allclose(distortion.without_pointing(PLACE, scale), scale, atol=1e-12)


@pytest.mark.parametrize("reference", ["aligned", "calibrated"])
def test_points_left_out_are_those_of_fits_without_them(reference):
    """Against fits repeated without a point, a row, a column; rows at the edge lose one point at a time."""
    place = np.stack(np.meshgrid(np.linspace(-0.7, 0.7, 7), np.linspace(-0.6, 0.6, 6)), -1).reshape(-1, 2)
    offset = np.random.default_rng(4).standard_normal(place.shape)
    found = distortion.deleted_residuals_px(place, offset, 3, reference)

    def without(points):
        terms = np.kron(distortion.polynomial_terms(place, 3), np.eye(2))
        terms = np.hstack([terms, distortion.camera_terms(place, reference).reshape(len(terms), -1)])
        kept = np.setdiff1d(np.arange(2 * len(place)), np.add.outer(2 * np.asarray(points), [0, 1]))
        fit = np.linalg.lstsq(terms[kept], offset.ravel()[kept], rcond=None)[0]
        return (offset.ravel() - terms @ fit).reshape(-1, 2)[points]

    row, column = np.arange(14, 21), np.arange(3, 42, 7)
    np.testing.assert_allclose(found[0, 17], without([17])[0], atol=1e-9)
    np.testing.assert_allclose(found[1, row], without(row), atol=1e-9)
    np.testing.assert_allclose(found[2, column], without(column), atol=1e-9)
    np.testing.assert_allclose(found[1, 3], without([3])[0], atol=1e-9)


def test_a_map_that_rows_do_not_test_is_not_stated():
    """0.17 px between four rows, nothing on them: neither residuals nor single points left out show it; six rows do."""
    for rows, tested in ((4, False), (6, True)):
        x, y = np.meshgrid(np.linspace(-0.7, 0.7, 8), np.linspace(-0.6, 0.6, rows))
        place = np.column_stack([x.ravel(), y.ravel()])
        wave = np.column_stack(
            [0.0 * place[:, 1], 0.25 * np.prod([place[:, 1] / 0.6 - a for a in (-1, -1 / 3, 1 / 3, 1)], 0)]
        )
        offset = wave + np.random.default_rng(1).normal(0.0, 0.001, place.shape)
        found = np.sqrt((distortion.deleted_residuals_px(place, offset, 3, "aligned") ** 2).mean((1, 2)))
        assert np.isfinite(found[1]) == tested
        if tested:
            assert found[1] > 0.02
        else:
            assert found[0] < 0.003


def test_a_correction_that_is_the_lens_leaves_only_what_it_lacks():
    """Camera and polynomial written out; a y^2 along y that neither has stays, less its mean (a pointing)."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.9, 0.9, 7), np.linspace(-0.45, 0.45, 5)))
    a, b, scale, roll = camera = 0.1 * np.random.default_rng(3).standard_normal(4)
    linear = 0.1 * np.array([[1.0, -2.0], [0.5, 3.0], [-4.0, 1.0]])
    lens = np.stack([a + scale * x - roll * y, b + scale * y + roll * x], axis=1)
    lens = lens + np.stack([np.ones_like(x), x, y], axis=1) @ linear
    extra = np.stack([0 * y, y**2], axis=1)
    given = {"camera_px": camera, "polynomial_px": linear, "reference": "aligned", "order": 1}
    error = distortion.map_error_px(np.column_stack([x, y]), lens + extra, **given)
    np.testing.assert_allclose(error, extra - extra.mean(0), atol=1e-10)


def test_the_order_of_the_lens_is_the_best_of_those_tested():
    """A quintic and 0.01 px of noise on 9 x 12 points; a grid of 4 rows tests no cubic."""
    rng, x, y = np.random.default_rng(5), np.linspace(-0.9, 0.9, 12), np.linspace(-0.45, 0.45, 9)
    position = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    offset = 5.0 * position * (position**2).sum(1, keepdims=True) ** 2 + 0.01 * rng.standard_normal(position.shape)
    tried = distortion.compare_orders(position, offset, "aligned", highest=7)
    assert (tried.best_order, tried.tested_order) == (5, 7)
    assert tried.over_best(3) > 10.0
    assert tried.residual_px[4] == pytest.approx(0.01, rel=0.2)
    few = distortion.compare_orders(PLACE, np.zeros_like(PLACE), "aligned")
    assert few.tested_order == 2
    assert few.order.tolist() == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("scaled", [True, False])
def test_a_change_of_shift_roll_and_scale_is_none(scaled):
    """Noise on top of it remains, by its degrees of freedom; a scale only where that is fitted."""
    rng = np.random.default_rng(3)
    rigid = np.array([2.0, -1.0]) + PLACE @ np.array([[0.0, 0.3], [-0.3, 0.0]])
    noise = [
        distortion.map_change_px(PLACE, rigid + rng.normal(0.0, 0.1, PLACE.shape), scaled=scaled) for _ in range(200)
    ]
    assert np.sqrt(np.mean(np.square(noise))) == pytest.approx(0.1, rel=0.03)
    grown = distortion.map_change_px(PLACE, rigid + 0.5 * PLACE, scaled=scaled)
    assert (grown < 1e-12) == scaled


def test_a_polynomial_of_each_axis_leaves_the_noise():
    rng = np.random.default_rng(4)
    cubic = distortion.polynomial_terms(PLACE, 3) @ rng.normal(size=(10, 2))
    rms = [distortion.polynomial_rms_px(PLACE, cubic + rng.normal(0.0, 0.1, PLACE.shape)) for _ in range(200)]
    assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(0.1, rel=0.03)
