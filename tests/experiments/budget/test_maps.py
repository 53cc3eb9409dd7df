"""Smooth maps of the budget's terms on drawn points: what fits leave, what drawn maps weigh."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.budget.attitude import _smooth
from experiments.budget.experiment import pulls
from experiments.budget.thermal import PLACES, _left, _slopes, _smooth_rms, cubic_basis, field_directions


def test_stars_are_spread_over_the_detector_at_all_fractions_of_a_pixel(star_camera):
    camera = star_camera.camera
    direction = field_directions(SimpleNamespace(instrument=star_camera))
    tangent = star_camera.focal_length_mm * direction[:, :2] / direction[:, 2:] / camera.pixel_pitch_mm
    pixel = tangent + np.array(camera.centre_px)
    size = np.array([camera.width_px, camera.height_px]) / PLACES
    cell = np.floor((pixel + 0.5) / size).astype(int)
    assert len(set(map(tuple, cell))) == PLACES[0] * PLACES[1]
    assert (cell >= 0).all() and (cell < PLACES).all()  # noqa: PT018
    middle = (cell + 0.5) * size - 0.5
    assert ((pixel - middle) >= -1e-6).all()
    assert ((pixel - middle) < 1.0).all()
    # a row of middles stands on one fraction; spread evenly it leaves at most gaps of a few over the number of stars
    fractions = np.sort(np.mod(pixel, 1.0), axis=0)
    assert np.diff(fractions, axis=0).max() < 4.0 / len(pixel)


def test_what_a_fit_leaves_counts_its_parameters():
    """Noise of 0.03 px at 48 points about a cubic of ten terms: RMS 0.03 in the mean over 300 draws."""
    rng, place = np.random.default_rng(2), np.random.default_rng(1).uniform(0.0, 4000.0, (48, 2))
    basis = cubic_basis(place)
    smooth = basis @ rng.standard_normal((basis.shape[1], 2))
    smooth *= [0.05, 0.08] / smooth.std(0)
    noise = np.array([0.03, 0.05])
    drawn = smooth + noise * rng.standard_normal((300, 48, 2))
    squares = np.mean([_left(basis, one) ** 2 for one in drawn], axis=0)
    np.testing.assert_allclose(np.sqrt(squares), noise, rtol=4.0 / np.sqrt(2 * 38 * 300))
    # the smooth map itself, of this RMS about its mean, without what the noise of its terms adds
    found, stated = np.transpose([_smooth_rms(basis, one) for one in drawn], (1, 0, 2))
    np.testing.assert_allclose(found.mean(0), [0.05, 0.08], atol=4.0 * 0.05 / np.sqrt(48 * 300))
    np.testing.assert_allclose(found.std(0), stated.mean(0), rtol=4.0 / np.sqrt(600))


def test_growth_and_its_standard_deviation():
    """x grows by 3e-5 along x, y by 4e-5 along y; pulls of 500 draws are normal."""
    rng, place = np.random.default_rng(3), np.random.default_rng(1).uniform(0.0, 4000.0, (48, 2))
    true = np.array([3e-5, 4e-5])
    found = [_slopes(place, true * place + [5.0, -2.0] + 0.05 * rng.standard_normal((48, 2))) for _ in range(500)]
    pull = (np.array([slope for slope, _ in found]) - true) / np.array([sigma for _, sigma in found])
    assert np.abs(pull.mean(0)).max() < 4.0 / np.sqrt(500)
    # Student's t of 45 degrees of freedom: variance 45 / 43
    np.testing.assert_allclose(pull.std(0), np.sqrt(45 / 43), rtol=4.0 / np.sqrt(1000))


def test_drawn_cubic_maps_have_unit_variance_over_the_field():
    """Mean square one over a field of 40 x 40 points; a map is a cubic without a constant."""
    side = (np.arange(40) + 0.5) / 20 - 1.0
    place = np.stack(np.meshgrid(side, side), axis=-1).reshape(1, -1, 2)
    maps = _smooth(np.repeat(place, 400, axis=0), np.random.default_rng(4))
    assert maps.shape == (400, 1600, 2)
    # nine terms of equal weight: the mean square of a map is chi^2 of nine over nine
    assert (maps**2).mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 9 / 800) + 0.01)
    assert (maps**2).mean((1, 2)).std() == pytest.approx(np.sqrt(2.0 / 18), rel=0.15)
    assert np.abs(maps.mean(1)).max() < 0.05
    basis = cubic_basis(place[0] * 1000.0 + 2000.0)
    assert _left(basis, maps[0]).max() < 1e-9


@pytest.mark.parametrize(("name", "expected"), [("TE", [1.0, -2.0]), ("HSFE", [0.5 / 0.3, -2.5])])
def test_a_pull_is_the_difference_over_its_uncertainty(name, expected):
    """Of both sides; the predicted one of HSFE already holds what frames state of theirs."""

    def side(value, sigma):
        return SimpleNamespace(
            budget={name: SimpleNamespace(arcsec=np.array(value), uncertainty_arcsec=np.array(sigma))}
        )

    np.testing.assert_allclose(pulls(side([1.5, 0.9], [0.3, 0.04]), side([1.0, 1.0], [0.4, 0.03]), name), expected)
