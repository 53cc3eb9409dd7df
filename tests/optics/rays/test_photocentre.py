"""Photocentres against Planck's law on single rays, and on moments made by hand."""

import numpy as np
from scipy.constants import c, h, k

from optics import load_lens
from optics.rays.photocentre import photocentres_of
from optics.rays.spots import SpotMoments, trace_spots
from optics.rays.stellar_chromatic_shift import stellar_chromatic_shift_mm


def moments(x, area):
    """Round spots of variance 0.02 mm^2 at (x, -x), two fields or one."""
    shape = np.shape(x)
    return SpotMoments(
        x_mm=np.array(x),
        y_mm=-np.array(x),
        xx_mm2=np.full(shape, 0.01),
        xy_mm2=np.zeros(shape),
        yy_mm2=np.full(shape, 0.01),
        transmitted_mm2=np.array(area),
    )


def test_colours_count_by_photons_times_area():
    """Two colours at 0 and 1 mm, areas 3 : 1: photons 1 : 1 have their mean at 1/4, photons 1 : 3 at 1/2."""
    light = photocentres_of(moments([[0.0, 1.0]], [[3.0, 1.0]]), [[1.0, 1.0], [1.0, 3.0], [0.0, 5.0]])
    np.testing.assert_allclose(light.x_mm, [[0.25, 0.5, 1.0]])
    np.testing.assert_allclose(light.y_mm, [[-0.25, -0.5, -1.0]])
    np.testing.assert_allclose(light.area_mm2, [[2.0, 1.5, 1.0]])
    spread = np.array([3.0 / 16.0, 1.0 / 4.0, 0.0])  # variance of two points, along x and along y
    np.testing.assert_allclose(light.rms_radius_mm[0] ** 2, 0.02 + 2.0 * spread)


def test_colours_that_do_not_arrive_do_not_count():
    light = photocentres_of(moments([[0.0, np.nan], [np.nan, np.nan]], [[3.0, 0.0], [0.0, 0.0]]), [1.0, 1.0])
    np.testing.assert_array_equal(light.x_mm, [[0.0], [np.nan]])
    np.testing.assert_allclose(light.area_mm2, [[1.5], [0.0]])


def test_a_star_moves_with_its_colour_as_planck_and_the_rays_say():
    """Rays of 48 colours at the edge of the field, other rays than the photocentre's, photons by Planck's law."""
    lens, wave = load_lens("star_camera_206mm"), np.linspace(450.0, 900.0, 48)
    field = np.array([2.0]), np.array([-0.5])
    spots = trace_spots(lens, *field, wave, order=(12, 24))
    area = spots.area_mm2[0]
    by_colour = (area * spots.rays.x[0]).sum(1) / area.sum(1)
    temperature = (3000.0, 5800.0, 30000.0)
    photons = np.array([wave**-4.0 / np.expm1(h * c / (wave * 1e-9 * k * kelvin)) for kelvin in temperature])
    expected = (photons * area.sum(1)) @ by_colour / (photons @ area.sum(1))
    shift = stellar_chromatic_shift_mm(
        lens,
        *field,
        wavelength_nm=wave,
        response=np.ones(48),
        temperature_k=temperature,
        reference_k=5800.0,
        order=(5, 12),
    )
    np.testing.assert_allclose(shift[:, 0, 0], expected - expected[1], rtol=1e-3, atol=1e-8)
    assert np.abs(shift[[0, 2], 0, 0]).min() > 1e-5
