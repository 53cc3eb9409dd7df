"""Effective PSFs by diffraction on NumPy, by a matrix Fourier transform: the renderer's sum of plane waves, holes."""

from dataclasses import replace

import numpy as np
import pytest

from optics.errors import DomainError
from optics.frames import field_direction
from optics.lens_file import load_lens
from render.records import StarField
from render.sensor import load_star_sensor
from render.tracing import wave_psf
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.wave_psf import wave_images

PIXEL = {"pitch_mm": 5.5e-3, "diffusion_px": 0.18}


@pytest.mark.parametrize("azimuth", [0.0, 30.0])
def test_the_renderer_makes_the_same(engine, azimuth):
    """Two codes that share the trace alone: 1e-4 of the light in a pixel, of a peak of 0.6."""
    camera = load_star_sensor("star_camera_206mm", "acc18_mosaic", diffraction="exact_waves").camera
    wave, field = np.array([500.0, 760.0]), 3.0
    share = np.array([0.4, 0.6])
    turn = np.radians(azimuth)
    tangent = np.tan(np.radians(field)) * np.array([np.cos(turn), np.sin(turn)])
    stars = StarField(
        direction=field_direction(*np.degrees(np.arctan(tangent))[:, None]),
        wavelength_nm=wave[None],
        photon_rate=(share / camera.response_at(wave))[None, None],
        band=("two lines",),
    )
    rendered = render_epsf(epsf_tracer(camera), stars, oversampling=4, half_size_px=6)[0][0]
    images = wave_images(
        camera.focused_lens,
        np.array([field]),
        wave,
        pitch_mm=camera.pixel_pitch_mm,
        diffusion_px=camera.charge_diffusion_px,
        azimuth_deg=azimuth,
        oversampling=4,
        half_size_px=6,
    )
    np.testing.assert_allclose(images.psfs(share)[0].values, rendered.values, atol=1e-4)


def test_a_pupil_that_is_not_clear_is_summed_ray_by_ray(monkeypatch):
    """The same light both ways; a hole in the middle of the pupil takes light out of the peak of what is left."""
    lens, field, wave = load_lens("star_camera_206mm"), np.array([0.0]), np.array([600.0])
    clear = wave_images(lens, field, wave, **PIXEL).psfs(np.ones(1))[0].values
    traced = wave_psf.trace_pupil

    def with_hole(*given, order=None, **named):
        pupil = traced(*given, order=order, **named)
        lost = np.hypot(*pupil.unit_pupil((0, 0))) < radius
        lost[0, 0] |= order is not None  # the first look at the pupil misses a ray
        return replace(pupil, area_mm2=np.where(lost, 0.0, pupil.area_mm2))

    monkeypatch.setattr(wave_psf, "trace_pupil", with_hole)
    radius = 0.0
    summed = wave_images(lens, field, wave, **PIXEL).psfs(np.ones(1))[0].values
    np.testing.assert_allclose(summed, clear, atol=1e-4)
    radius = 0.5
    assert wave_images(lens, field, wave, **PIXEL).psfs(np.ones(1))[0].values.max() < 0.97 * summed.max()


def test_refused():
    with pytest.raises(DomainError, match="even"):
        wave_images(load_lens("star_camera_206mm"), np.zeros(1), np.array([600.0]), oversampling=3, **PIXEL)
