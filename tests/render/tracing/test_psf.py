"""Effective PSFs against brute force, and against what they are for: predicting images of stars."""

from dataclasses import replace

import numpy as np
import pytest
from fields import star_field
from scipy.special import ndtr

from optics.frames import field_angles_deg, field_direction
from optics.lens_file import load_lens
from optics.rays.spots import trace_spots
from render.records import EffectivePsf
from render.sensor_file.load import load_star_sensor
from render.tracing import psf as psf_module
from render.tracing.psf import blurred, epsf_tracer, of_disk, ray_epsf, render_epsf, trailed, wave_images

OVERSAMPLING = 4


@pytest.mark.parametrize("name", ["star_camera_206mm", pytest.param("star_tracker_26mm", marks=pytest.mark.slow)])
def test_samples_are_pixel_integrals_around_the_bundle_mean(engine, bench, name):
    camera = bench.camera_of(name, film=False, defocus_mm=0.01)
    centre = 2 * camera.centre_px
    stars = bench.stars_at(camera, [0.9 * centre[0], 0.5 * centre[0]], 0.7 * centre[1], bands=((600.0, 50.0),), nodes=2)
    tracer = epsf_tracer(camera)
    psfs = render_epsf(tracer, stars, oversampling=OVERSAMPLING, half_size_px=6)
    assert [len(row) for row in psfs] == [1, 1]
    exact = name == "star_camera_206mm"
    for star in range(2):
        psf = psfs[star][0]
        values, half = psf.values, psf.values.shape[0] // 2
        assert psf.oversampling == OVERSAMPLING
        x, y, weight = bench.bundle(camera, stars, star, 0, rings=200, arms=240, stagger=not exact)
        weight = weight / weight.sum()
        mean = bench.mean_of(x, y, weight)
        for dx, dy in ((0, 0), (1, 0), (2, 3), (-1, 2), (-6, -5)):  # in quarters of a pixel
            offset = np.array([dx, dy]) / OVERSAMPLING
            expected = bench.pixel_integrals(
                x - mean[0] - offset[0], y - mean[1] - offset[1], weight, camera.charge_diffusion_px, 0, 0, 1
            )[0, 0]
            assert values[half + dy, half + dx] == pytest.approx(expected, abs=2e-4)


def test_light_is_conserved_and_centred(engine, bench):
    camera = bench.camera_of(film=False)
    stars = bench.stars_at(camera, [3000.3, 4000.1], [500.2, 40.0], bands=((500.0, 100.0), (800.0, 100.0)))
    for row in render_epsf(epsf_tracer(camera), stars):
        for psf in row:
            offset = (np.arange(psf.values.shape[0]) - psf.values.shape[0] // 2) / psf.oversampling
            # every phase sums to one pixel after another of the whole light
            assert psf.values.sum() / psf.oversampling**2 == pytest.approx(1.0, abs=1e-6)
            assert abs(offset @ psf.values.sum(0)) / psf.oversampling**2 < 1e-5
            assert abs(offset @ psf.values.sum(1)) / psf.oversampling**2 < 1e-5


def test_one_ray_is_the_diffusion_kernel_on_pixels():
    """A ray at the mean lies on a corner of four cells; counted in one of them, it is not half a cell off."""
    psf = ray_epsf(np.array([3.2]), np.array([-1.0]), np.array([2.0]), diffusion_px=0.5, oversampling=16)
    offset = (np.arange(len(psf.values)) - len(psf.values) // 2) / 16.0
    share = ndtr((offset + 0.5) / 0.5) - ndtr((offset - 0.5) / 0.5)
    np.testing.assert_allclose(psf.values, np.outer(share, share), atol=1e-3)
    assert psf.values[::16, ::16].sum() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_rays_on_numpy_make_the_same(engine):
    sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=1024, diffraction="rays")
    camera = sensor.camera
    direction = camera.nominal_direction(camera.centre_px[0] + 300.0, camera.centre_px[1], sensor.focal_length_mm)
    wave = np.array([[550.0, 700.0]])
    stars = star_field(direction, wave, [2.0, 1.0])
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
    assert psf.values.sum() / 64.0 == pytest.approx(1.0, abs=1e-12)  # the grid grew by the trail: all light is there
    np.testing.assert_allclose(psf.values[16:-16, 16:-16], np.outer(still, moved), atol=1e-9)


@pytest.mark.parametrize(
    ("widened", "variance_px2"),
    [(lambda psf: blurred(psf, 0.3), 0.3), (lambda psf: of_disk(psf, 1.6), 1.6**2 / 4.0)],
)
def test_a_convolution_adds_the_variance_of_its_kernel(widened, variance_px2):
    """A Gaussian's, and per axis a quarter of the squared radius of a disk."""
    offset = (np.arange(161) - 80) / 8.0
    pixel = ndtr((offset + 0.5) / 0.7) - ndtr((offset - 0.5) / 0.7)
    psf = EffectivePsf(values=np.outer(pixel, pixel), oversampling=8)
    moments = []
    for values in (psf.values, widened(psf).values):
        assert values.sum() / 64.0 == pytest.approx(1.0, abs=1e-9)
        moments += [values.sum(0) @ offset**2 / values.sum()]
    assert moments[1] - moments[0] == pytest.approx(variance_px2, rel=1e-6)


PIXEL = {"pitch_mm": 5.5e-3, "diffusion_px": 0.18}


@pytest.mark.parametrize("azimuth", [0.0, 30.0])
def test_wavefronts_on_numpy_make_the_same(engine, azimuth):
    """Two codes that share the trace alone: 1e-4 of the light in a pixel, of a peak of 0.6."""
    camera = load_star_sensor("star_camera_206mm", "acc18_mosaic", diffraction="exact_waves").camera
    camera = replace(camera, losses=None)  # the other code lets all rays through alike: 3e-4 of the light in a pixel
    wave, field = np.array([500.0, 760.0]), 3.0
    share = np.array([0.4, 0.6])
    turn = np.radians(azimuth)
    tangent = np.tan(np.radians(field)) * np.array([np.cos(turn), np.sin(turn)])
    stars = star_field(field_direction(*np.degrees(np.arctan(tangent))), wave, share / camera.response_at(wave))
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
    traced = psf_module.trace_pupil

    def with_hole(*given, order=None, **named):
        pupil = traced(*given, order=order, **named)
        lost = np.hypot(*pupil.unit_pupil((0, 0))) < radius
        lost[0, 0] |= order is not None  # the first look at the pupil misses a ray
        return replace(pupil, area_mm2=np.where(lost, 0.0, pupil.area_mm2))

    monkeypatch.setattr(psf_module, "trace_pupil", with_hole)
    radius = 0.0
    summed = wave_images(lens, field, wave, **PIXEL).psfs(np.ones(1))[0].values
    np.testing.assert_allclose(summed, clear, atol=1e-4)
    radius = 0.5
    assert wave_images(lens, field, wave, **PIXEL).psfs(np.ones(1))[0].values.max() < 0.97 * summed.max()
