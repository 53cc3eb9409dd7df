"""A measured wavefront error on a lens: what real rays find is what was put in."""

import numpy as np
import pytest

from optics import load_lens, trace_pupil, with_wavefront
from optics.waves.wavefront import PathMap, wavefront, zernike_map

GIVEN_NM = np.zeros(15)
GIVEN_NM[[4, 6, 10, 12]] = 40.0, -30.0, 20.0, 15.0  # astigmatism, coma, spherical, secondary astigmatism


def change_nm(lens, other, field_deg):
    """Zernike coefficients by which two lenses differ."""
    nominal, found = (
        wavefront(trace_pupil(one, [field_deg], [0.0], [lens.design_wavelength_nm], order=(12, 48))).zernike_nm(15)
        for one in (lens, other)
    )
    return found - nominal


@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm", "hubble_57m"])
def test_rays_find_the_coefficients_that_were_put_in(name):
    """Stop in front, stop inside, a mirror; the first three depend on the reference point."""
    lens = load_lens(name)
    found = change_nm(lens, with_wavefront(lens, zernike_map(GIVEN_NM)), 0.0)
    np.testing.assert_allclose(found[3:], GIVEN_NM[3:], atol=0.2)


def test_other_fields_and_maps_see_nearly_the_same():
    """The stop is near: beams of 3 deg shift by a percent of their width. A map says what polynomials say."""
    lens = load_lens("star_camera_206mm")
    grid = np.linspace(-1.0, 1.0, 65)
    smooth = zernike_map(GIVEN_NM)
    measured = PathMap(x=grid, y=grid, error_nm=smooth(*np.meshgrid(grid, grid)))
    np.testing.assert_allclose(change_nm(lens, with_wavefront(lens, measured), 3.0)[3:], GIVEN_NM[3:], atol=0.6)


def test_the_mean_of_the_rays_moves_with_the_light():
    """Coma bends rays: their mean, which is the centroid of the light, moves by the mean slope of the wavefront."""
    lens = load_lens("star_camera_206mm")
    wave = [lens.design_wavelength_nm]
    coma = np.zeros(8)
    coma[7] = 100.0
    pupils = [
        trace_pupil(one, [0.0], [0.0], wave, order=(12, 48)) for one in (lens, with_wavefront(lens, zernike_map(coma)))
    ]
    radius = float(pupils[0].pupil_x.max() / pupils[0].ring[-1])
    # the mean slope of sqrt(8) (3 r^3 - 2 r) cos a over the unit disk is its integral around the rim: sqrt(8) / rim
    slope = np.sqrt(8.0) * 100e-6 / radius
    moved = float(pupils[1].mean_mm[0][0, 0] - pupils[0].mean_mm[0][0, 0])
    assert abs(moved) == pytest.approx(slope * 206.2, rel=0.02)


def test_every_surface_takes_one_error():
    lens = load_lens("hubble_57m")
    error = zernike_map([0.0, 0.0, 0.0, 1.0])
    both = with_wavefront(with_wavefront(lens, error), error)
    assert sum(surface.error is not None for surface in both.surfaces) == 2
