"""Wedges separated from the lens where filters or camera were turned; files of two filters exchanged."""

from __future__ import annotations

import numpy as np
import pytest

from calib.accuracy.filter_wedge import exchanged_filters, separate_wedge, spot_radius_px

PLACE = np.stack(
    [np.stack(np.meshgrid([-20.0, 0, 20], [-20.0, 0, 20]), -1).reshape(-1, 2) + at for at in (0, 90, -60, 10)]
)
LENS, WEDGE, SIGMA = np.array([0.03, -0.02]), np.array([0.05, 0.08]), 0.004


def shifts(rng, angles, common=0.0):
    """Lens, lateral colour, and a wedge turned by hand (complex numbers: x + iy)."""
    turned = (WEDGE[0] + 1j * WEDGE[1]) * np.exp(1j * np.radians(angles))
    wedge = np.stack([turned.real, turned.imag], -1)[:, None]
    moved = common * rng.standard_normal((len(angles), 1, 2))
    place = PLACE[: len(angles)]
    return LENS + 2e-4 * place + wedge + moved + SIGMA * rng.standard_normal(place.shape)


@pytest.mark.parametrize("angles", [(0.0, 180.0), (0.0, 120.0, 240.0, 90.0)])
def test_a_wedge_is_recovered_within_its_stated_error(angles):
    rng, angles, pulls = np.random.default_rng(3), np.array(angles), []
    sigma = np.full((len(angles), 9, 2), SIGMA)
    for _ in range(100):
        found = separate_wedge(shifts(rng, angles), sigma, PLACE[: len(angles)], angles, angles)
        pulls.append((found.wedge_px - WEDGE) / found.wedge_sigma_px)
        pulls.append((found.lens_px - LENS) / found.lens_sigma_px)
    assert found.wedge_sigma_px.max() < 0.003
    assert np.mean(np.square(pulls)) < 1.0 + 4 * np.sqrt(2.0 / np.size(pulls))
    assert np.mean(np.square(pulls)) > 0.4  # they are never made smaller than the stated noise, often larger


def test_a_target_that_moved_between_series_widens_the_error():
    rng, angles = np.random.default_rng(4), np.array([0.0, 120.0, 240.0, 90.0])
    sigma = np.full((4, 9, 2), SIGMA)
    pulls = []
    for _ in range(200):
        found = separate_wedge(shifts(rng, angles, 0.02), sigma, PLACE, angles, angles)
        pulls.append((found.wedge_px - WEDGE) / found.wedge_sigma_px)
    assert np.median(np.abs(pulls)) < 1.2 * 0.74  # Student's t with four degrees of freedom


def test_what_was_not_turned_is_not_told_apart():
    rng, still = np.random.default_rng(5), np.zeros(3)
    sigma = np.full((3, 9, 2), SIGMA)
    found = separate_wedge(shifts(rng, still), sigma, PLACE[:3], still, still)
    assert np.isnan([found.wedge_px, found.lens_px]).all()
    np.testing.assert_allclose(found.constant_px, LENS + WEDGE, atol=4 * found.constant_sigma_px.max())
    alone = np.array([0.0, 90.0, 180.0])  # the reference filter's own wedge stands still: it goes with the lens
    found = separate_wedge(shifts(rng, alone), sigma, PLACE[:3], alone, still)
    assert np.isnan([found.wedge_px, found.lens_px]).all()


def test_width_of_a_spot_is_its_rms_radius():
    """Gaussians of 1.0 and 1.4 px beside the middle, on an even background: the mean of their radii, root two each."""
    axis = np.arange(21) - 10.0
    spots = [np.exp(-np.add.outer((axis - 0.7) ** 2, (axis + 0.4) ** 2) / (2 * s**2)) for s in (1.0, 1.4)]
    found = spot_radius_px(20.0 + 1e4 * np.stack(spots))
    assert found == pytest.approx(1.2 * np.sqrt(2.0), rel=2e-3)


def light_and_radius(rng, places, swap=None):
    """Three filters at some places; light and width differ by 2 and 0.5 % from the product of filter and place."""
    order = np.tile(np.arange(3), (places, 1))
    if swap is not None:
        order[swap] = [1, 0, 2]
    light = np.array([5000.0, 9000.0, 7000.0])[order] * (1 + 0.1 * np.arange(places))[:, None]
    radius = np.array([1.0, 1.1, 1.3])[order]
    return light * (1 + 0.02 * rng.standard_normal(light.shape)), radius * (
        1 + 0.005 * rng.standard_normal(light.shape)
    )


def test_exchanged_filters_are_found():
    rng = np.random.default_rng(6)
    for _ in range(30):
        assert exchanged_filters(*light_and_radius(rng, 4, swap=2)) == [(2, 0, 1)]
    assert exchanged_filters(*light_and_radius(rng, 2, swap=1)) == [(0, 0, 1), (1, 0, 1)]
    rng = np.random.default_rng(7)  # and filters at their places
    assert not any(exchanged_filters(*light_and_radius(rng, places)) for places in (1, 2, 4) for _ in range(60))
