"""Pixel values against brute force: the same lens traced by NumPy on a dense grid, error functions over every pixel."""

import numpy as np
import pytest

from render.tracing.rays import images as passes
from render.tracing.rays import kernel as star_kernel
from render.tracing.rays.kernel import reach_px, strips_per_pixel
from render.tracing.tracer import Tracer

# on the axis, at the edge of the long side, in the corner
PLACES = ([2047.6, 4071.3, 4080.2], [1023.9, 1000.1, 17.4])


def stamp(image, centre, half):
    """Window of an image around a position, and its first column and row."""
    column, row = (round(v) - half for v in centre)
    return image[row : row + 2 * half + 1, column : column + 2 * half + 1], column, row


def worst_pixel(bench, camera, stars, traced, rays=None, **dense):
    """Largest difference of a pixel from brute force, in units of the light that the star sends in."""
    worst = 0.0
    for star in range(len(stars)):
        for band in range(len(stars.band)):
            x, y, weight = bench.bundle(camera, stars, star, band, **dense) if rays is None else rays
            half = int(np.ceil(max(np.ptp(x), np.ptp(y)) / 2)) + 3
            got, column, row = stamp(traced.electrons[..., band].astype(float), bench.mean_of(x, y, weight), half)
            expected = bench.pixel_integrals(x, y, weight, camera.charge_diffusion_px, column, row, 2 * half + 1)
            worst = max(worst, np.abs(got / bench.launched(camera, stars)[star, band] - expected).max())
    return worst


@pytest.mark.parametrize(
    ("defocus_mm", "diffusion_px", "tolerance"),
    [(0.0, 0.18, 3e-5), (0.02, 0.18, 1e-5), pytest.param(-0.05, 0.3, 3e-5, marks=pytest.mark.slow)],
)
def test_pixels_against_brute_force(engine, bench, defocus_mm, diffusion_px, tolerance):
    camera = bench.camera_of(defocus_mm=defocus_mm, charge_diffusion_px=diffusion_px)
    stars = bench.stars_at(camera, *PLACES, nodes=2)
    traced = Tracer(camera, tolerance=tolerance).render(stars, exposure_s=1.0)
    assert set(traced.sampling) == {"quadrature"}
    assert worst_pixel(bench, camera, stars, traced, rings=200, arms=260) < tolerance


@pytest.mark.slow
def test_pixels_of_a_cut_bundle_against_brute_force(engine, bench):
    """Stop inside the lens and vignetting: smooth outlines, outlines with kinks, and 2^16 Sobol rays."""
    camera = bench.camera_of("star_tracker_26mm")
    stars = bench.stars_at(camera, [511.6, 1000.3], [511.4, 1003.9], bands=((650.0, 0.0),))
    traced = Tracer(camera).render(stars, exposure_s=1.0)
    assert set(traced.sampling) == {"quadrature", "arcs"}
    assert worst_pixel(bench, camera, stars, traced, rings=300, arms=400, stagger=True) < 1e-4
    traced = Tracer(camera, tolerance=1e-300).render(stars, exposure_s=1.0)  # which nothing meets
    assert set(traced.sampling) == {"sobol"}
    assert worst_pixel(bench, camera, stars, traced, rings=300, arms=400, stagger=True) < 2e-4


@pytest.mark.slow
def test_pixels_without_diffusion_converge(engine, bench):
    """Edges of pixels cut the bundle: more Sobol points, less error; against brute force with half a million rays."""
    camera = bench.camera_of(charge_diffusion_px=0.0, defocus_mm=0.02)
    stars = bench.stars_at(camera, 3000.3, 500.2, bands=((600.0, 0.0),))
    error = []
    x_y_weight = bench.bundle(camera, stars, 0, 0, rings=700, arms=700, stagger=True)
    for log2_rays in (10, 14, 18):
        traced = Tracer(camera, sobol_log2_rays=log2_rays).render(stars, exposure_s=1.0)
        error.append(worst_pixel(bench, camera, stars, traced, x_y_weight))
    assert error[0] < 1e-2
    assert error[1] < 2e-3
    assert error[2] < 2e-4
    assert error[2] < error[0] / 20


@pytest.mark.slow
def test_second_moments_hold_no_hidden_blur(engine, bench):
    """Sheppard: variance over pixels = variance of the bundle + diffusion^2 + 1/12 of a pixel's square.

    That holds where pixels are fine against the light: its spectrum at one cycle per pixel has to vanish. With 0.18 px
    of diffusion it does on pixels of a quarter.
    """
    fine = 4
    camera = bench.camera_of(fine=fine, defocus_mm=0.02)
    camera = bench.window(camera, 64 * fine, fine * 3000, fine * 500)
    stars = bench.stars_at(camera, 32.13 * fine, 31.61 * fine)
    traced = Tracer(camera).render(stars, exposure_s=1.0)
    image, truth = traced.electrons[..., 0].astype(float), traced.truth
    assert truth.electrons_image[0, 0] == pytest.approx(truth.electrons_in[0, 0], rel=1e-6)
    index = np.arange(64 * fine)
    for axis, name in ((0, "x"), (1, "y")):
        profile = image.sum(axis) / image.sum()
        mean = profile @ index
        variance = (profile @ (index - mean) ** 2) / fine**2
        bundle = getattr(truth, f"variance_{name}_px2")[0, 0] / fine**2
        expected = bundle + (camera.charge_diffusion_px / fine) ** 2 + 1 / 12 / fine**2
        assert abs(variance - expected) < 3e-5  # demanded: 1e-3 px^2
        x, y, weight = bench.bundle(camera, stars, 0, 0)
        values = x if name == "x" else y
        spread = weight @ (values - (weight @ values) / weight.sum()) ** 2 / weight.sum() / fine**2
        assert abs(bundle - spread) < 1e-4 * spread


def test_first_moment_over_native_pixels_aliases_as_predicted(engine, bench):
    r"""A moment over whole pixels is off by sum_k (-1)^k / (pi k) exp(-2 (pi k sigma)^2) <sin(2 pi k x)>.

    Poisson's sum over pixel centres: the pixel's transfer vanishes at whole cycles k, its slope there does not. Truth
    therefore counts light in finer strips.
    """
    diffusion_px = 0.18
    camera = bench.camera_of(charge_diffusion_px=diffusion_px, defocus_mm=0.0)
    stars = bench.stars_at(camera, *PLACES)
    traced = Tracer(camera).render(stars, exposure_s=1.0)
    seen = []
    for star in range(len(stars)):
        x, y, weight = bench.bundle(camera, stars, star, 0)
        got, column, row = stamp(traced.electrons[..., 0].astype(float), bench.mean_of(x, y, weight), 8)
        k = np.arange(1, 6)[:, None]
        for values, moment in (
            (x, got.sum(0) @ (column + np.arange(17)) / got.sum()),
            (y, got.sum(1) @ (row + np.arange(17)) / got.sum()),
        ):
            damp = np.exp(-2 * (np.pi * k[:, 0] * diffusion_px) ** 2)
            sine = np.sin(2 * np.pi * k * values) @ weight / weight.sum()
            predicted = ((-1.0) ** k[:, 0] / (np.pi * k[:, 0]) * damp * sine).sum()
            assert moment - weight @ values / weight.sum() == pytest.approx(predicted, abs=2e-5)
            seen.append(abs(predicted))
    assert max(seen) > 2e-3  # so the formula was put to the test


def test_closed_form_of_the_strips(engine, bench, monkeypatch):
    camera = bench.camera_of("star_tracker_26mm", film=False)
    stars = bench.stars_at(camera, [511.6, 700.3, 300.1], [511.4, 303.9, 600.8])
    closed = Tracer(camera).render(stars, exposure_s=1.0).truth
    monkeypatch.setattr(star_kernel, "OutlinePoints", type(None))  # as if nothing followed an outline
    summed = Tracer(camera).render(stars, exposure_s=1.0).truth
    for name in ("photon_x_px", "photon_y_px"):
        assert 0 < np.abs(getattr(closed, name) - getattr(summed, name)).max() < 1e-6
    assert np.array_equal(closed.bundle_x_px, summed.bundle_x_px)


def test_stamp_that_is_too_small_is_done_again(engine, bench, monkeypatch):
    camera = bench.camera_of(defocus_mm=0.02)
    stars = bench.stars_at(camera, *PLACES)
    expected = Tracer(camera).render(stars, exposure_s=1.0)
    monkeypatch.setattr(passes, "MARGIN_PX", -1.0)
    got = Tracer(camera).render(stars, exposure_s=1.0)
    assert got.sampling == expected.sampling  # light beside the stamp is not lost in the lens
    assert got.truth.electrons_vignetted.max() == 0.0
    assert np.abs(got.electrons - expected.electrons).max() < 1e-6 * expected.truth.electrons_in.max()


def test_reach_and_strips():
    for sigma in (0.0, 0.05, 0.18, 0.3, 0.5, 1.7):
        assert reach_px(sigma) >= 5 * sigma
        m = strips_per_pixel(sigma)
        assert m * sigma >= 0.55 or m == 1024  # a strip is at most 1.8 sigma wide
    assert strips_per_pixel(0.0) == 1024
