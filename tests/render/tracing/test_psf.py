"""Effective PSFs against brute force, and against what they are for: predicting images of stars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optics.errors import DomainError
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.tracer import Tracer

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


@pytest.mark.slow
def test_predicts_the_image_of_a_star(engine, bench):
    """At a quarter-pixel phase the ePSF's samples are the pixels of the rendered image."""
    whole = bench.camera_of(defocus_mm=0.01)
    camera = bench.window(whole, 31, 3000, 500)
    start = bench.stars_at(whole, 3000.0, 500.0)
    # shift the detector so that the bundle mean lies 1/4, -1/2 px from a pixel's centre
    mean = Tracer(camera).bundle_means(start, rings=12, arms=26)[0, 0]
    shift = np.array([15.25, 14.5]) - mean
    camera = replace(camera, centre_px=camera.centre_px + shift)
    traced = Tracer(camera).render(start, exposure_s=1.0)
    share = traced.electrons[..., 0].astype(float) / traced.truth.electrons_image[0, 0]
    ((psf,),) = render_epsf(epsf_tracer(camera), start, oversampling=8, half_size_px=7)
    half, values = psf.values.shape[0] // 2, psf.values
    for row in range(10, 21):
        for column in range(10, 21):
            dx, dy = round(8 * (column - 15.25)), round(8 * (row - 14.5))
            assert values[half + dy, half + dx] == pytest.approx(share[row, column], abs=1e-4)


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


def test_bad_requests(engine, bench):
    camera = bench.camera_of("star_tracker_26mm", film=False)
    tracer = epsf_tracer(camera)
    stars = bench.stars_at(camera, 500.0, 500.0)
    for oversampling in (0, 1, 3):
        with pytest.raises(DomainError, match=r"oversampling = \d; an even number of at least 2"):
            render_epsf(tracer, stars, oversampling=oversampling)
    beside = bench.stars_at(camera, 0, 0, direction=np.array([[np.sin(0.9), 0.0, np.cos(0.9)]]))
    with pytest.raises(DomainError, match="star 0: none of its light reaches the detector"):
        render_epsf(tracer, beside)
