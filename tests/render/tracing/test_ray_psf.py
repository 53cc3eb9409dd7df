"""Effective PSFs from rays by NumPy: closed form, and the renderer's own."""

import numpy as np
import pytest
from scipy.special import ndtr

from optics.errors import DomainError
from optics.frames import field_angles_deg
from optics.rays.spots import trace_spots
from render.records import EffectivePsf, StarField
from render.sensor import load_star_sensor
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.ray_psf import ray_epsf, trailed


def test_one_ray_is_the_diffusion_kernel_on_pixels():
    """A ray at the mean lies on a corner of four cells; it is counted half a cell off: 1 % of the peak at 16 cells."""
    psf = ray_epsf(np.array([3.2]), np.array([-1.0]), np.array([2.0]), diffusion_px=0.5, oversampling=16)
    offset = (np.arange(len(psf.values)) - len(psf.values) // 2) / 16.0
    share = ndtr((offset + 0.5) / 0.5) - ndtr((offset - 0.5) / 0.5)
    np.testing.assert_allclose(psf.values, np.outer(share, share), atol=0.03)
    assert psf.values[::16, ::16].sum() == pytest.approx(1.0, abs=1e-3)


def test_the_renderer_makes_the_same(engine):
    sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=1024, diffraction="rays")
    camera = sensor.camera
    direction = camera.nominal_direction(camera.centre_px[0] + 300.0, camera.centre_px[1], sensor.focal_length_mm)
    wave = np.array([[550.0, 700.0]])
    stars = StarField(
        direction=direction[None], wavelength_nm=wave, photon_rate=np.array([[[2.0, 1.0]]]), band=("two lines",)
    )
    rendered = render_epsf(epsf_tracer(camera), stars, oversampling=8)[0][0]
    x, y = field_angles_deg(direction[None])
    spots = trace_spots(camera.focused_lens, x, y, wave[0], order=(32, 64))
    weight = spots.area_mm2[0] * (np.array([2.0, 1.0]) * camera.response_at(wave[0]))[:, None]
    at = camera.to_pixel(spots.rays.x[0], spots.rays.y[0])
    psf = ray_epsf(at[0].ravel(), at[1].ravel(), weight.ravel(), diffusion_px=camera.charge_diffusion_px)
    np.testing.assert_allclose(psf.values, rendered.values, atol=2.5e-3)  # of a peak of 0.6


def test_a_trail_across_the_columns_is_an_integral_of_the_star():
    """Integral of the error function, to what samples 1/8 px apart hold."""
    sigma, length = 0.6, 3.5
    offset = (np.arange(121) - 60) / 8.0

    def within(x):  # of the light of a pixel that begins at x, up to a constant; its derivative is ndtr(x / sigma)
        u = x / sigma
        return sigma * (u * ndtr(u) + np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi))

    still = ndtr((offset + 0.5) / sigma) - ndtr((offset - 0.5) / sigma)
    ends = [offset + side + 0.5 * turn * length for side in (0.5, -0.5) for turn in (1, -1)]
    moved = (within(ends[0]) - within(ends[1]) - within(ends[2]) + within(ends[3])) / length
    psf = trailed(EffectivePsf(values=np.outer(still, still), oversampling=8), np.array([length, 0.0]))
    np.testing.assert_allclose(psf.values, np.outer(still, moved), atol=1e-9)


def test_refused():
    one = np.ones(1)
    with pytest.raises(DomainError, match="even"):
        ray_epsf(one, one, one, diffusion_px=0.1, oversampling=3)
    with pytest.raises(DomainError, match="no light"):
        ray_epsf(one, one, 0.0 * one, diffusion_px=0.1)
