from dataclasses import replace

import numpy as np
import pytest
from star_images import gaussian_epsf, gaussian_stars, noisy, stamps_of

from calib.flags import StarFlag, has_flag
from calib.measure.centroiders.epsf import EpsfCentroider
from calib.measure.centroiding.registry import get_centroider
from calib.measure.epsf.bspline import draw_epsf, smeared_epsfs
from calib.measure.epsf.build import build_epsf
from calib.records import NoiseModel
from render.records import EffectivePsf


@pytest.mark.parametrize(("sigma", "oversampling", "order"), [(0.5, 4, 4), (0.5, 8, 4), (0.7, 4, 4)])
def test_interpolation_error_falls_with_the_fourth_power(sigma, oversampling, order):
    """Cubic splines: error ~ h^4; halving the step must gain a factor near 16."""
    rng = np.random.default_rng(1)
    x, y = 5.0 + rng.uniform(-0.5, 0.5, (2, 300))
    truth = gaussian_stars(x, y, sigma)
    errors = [
        np.abs(draw_epsf(gaussian_epsf(sigma, k), x, y, (11, 11)) - truth).max()
        for k in (oversampling, 2 * oversampling)
    ]
    assert errors[0] < 3e-4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.6)


def test_star_far_outside_the_window_leaves_it_dark():
    image = draw_epsf(gaussian_epsf(0.7), np.array([-40.0, 60.0, 5.0]), np.array([5.0, 5.0, 1e7]), (11, 11))
    assert np.abs(image).max() < 1e-12


@pytest.mark.parametrize("sigma", [0.5, 0.7, 1.0])
def test_s_curve_is_below_a_thousandth_of_a_pixel(sigma):
    noise = NoiseModel(read_noise_e=5.0)
    phase = (np.arange(20) + 0.5) / 20 - 0.5
    x, y = (a.ravel() + 5.0 for a in np.meshgrid(phase, phase))
    stamps = stamps_of(1e5 * gaussian_stars(x, y, sigma), np.full(400, 5.0), np.full(400, 5.0))
    table = EpsfCentroider(epsf=gaussian_epsf(sigma)).measure(stamps, noise)
    assert np.abs(table.x_px - x).max() < 1e-3
    assert np.abs(table.y_px - y).max() < 1e-3


def test_a_psf_far_wider_than_the_stars_converges():
    """Its information is a fraction of the curvature of the likelihood: full steps oscillate until none are left. By
    symmetry the centre of a Gaussian stays the best place."""
    x, y = 5.0 + np.random.default_rng(4).uniform(-0.5, 0.5, (2, 40))
    stamps = stamps_of(2e4 * gaussian_stars(x, y, 0.5), np.full(40, 5.0), np.full(40, 5.0))
    table = EpsfCentroider(epsf=gaussian_epsf(1.8)).measure(stamps, NoiseModel(read_noise_e=150.0))
    assert not has_flag(table.flags, StarFlag.NOT_CONVERGED).any()
    assert np.abs(table.x_px - x).max() < 0.01


def test_every_star_its_own_psf():
    """Several PSFs of different size in one call give what each gives alone."""
    rng = np.random.default_rng(3)
    noise = NoiseModel(read_noise_e=5.0)
    sigmas, n = (0.5, 0.8, 1.1), 300
    which = rng.integers(0, 3, n)
    x, y = 5.0 + rng.uniform(-0.5, 0.5, (2, n))
    unit = np.concatenate([gaussian_stars(x[i : i + 1], y[i : i + 1], sigmas[which[i]]) for i in range(n)])
    stamps = replace(stamps_of(noisy(2e4 * unit + 3, 5.0, rng), x, y, background_e=3.0), psf_index=which)
    psfs = [gaussian_epsf(sigma, half_px=6 + i) for i, sigma in enumerate(sigmas)]
    table = EpsfCentroider(epsf=psfs).measure(stamps, noise)
    for i, psf in enumerate(psfs):
        rows = np.flatnonzero(which == i)
        alone = EpsfCentroider(epsf=psf).measure(replace(stamps.select(rows), psf_index=np.zeros(len(rows))), noise)
        assert table.x_px[rows] == pytest.approx(alone.x_px, abs=1e-9)
        assert table.flux_e[rows] == pytest.approx(alone.flux_e, rel=1e-9)
    pull = (table.x_px - x) / table.sigma_x_px
    assert pull.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * n))


def dithered(stars=30, frames=30, snr_flux=1e5, seed=2):
    """Stamps of an asymmetric star (two Gaussians) in shifted frames; the truth is the centre of its light."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.5, 0.5, (2, 1, stars)) + rng.uniform(-0.5, 0.5, (2, frames, 1))
    x, y = place.reshape(2, -1)
    whole = np.rint([x, y])
    inner_x, inner_y = x - whole[0] + 5.0, y - whole[1] + 5.0

    def draw(at_x, at_y):
        return 0.7 * gaussian_stars(at_x - 0.15, at_y + 0.09, 0.6) + 0.3 * gaussian_stars(at_x + 0.35, at_y - 0.21, 0.9)

    electrons = noisy(snr_flux * draw(inner_x, inner_y) + 2.0, 5.0, rng)
    stamps = stamps_of(electrons, inner_x, inner_y, background_e=2.0)
    corner = whole.T.astype(np.int64)
    stamps = replace(stamps, corner_px=corner, start_px=stamps.start_px + corner)
    index = {"star_index": np.tile(np.arange(stars), frames), "frame_index": np.repeat(np.arange(frames), stars)}
    return stamps, index, x + 5.0, y + 5.0, draw


def test_psf_built_from_dithered_frames(noise):
    """900 stars of SNR about 310: S-curve below 1e-3 px, origin at the centre of light, pulls near 1."""
    stamps, index, x, y, draw = dithered()
    solution = build_epsf(stamps, noise, **index)
    assert solution.converged
    assert solution.iterations < 20
    assert solution.used.all()
    assert solution.chi2 == pytest.approx(1.0, abs=0.03)
    assert solution.epsf.values.sum() / solution.epsf.oversampling**2 == pytest.approx(1.0, rel=1e-12)
    phase = (np.arange(12) + 0.5) / 12 - 0.5
    grid_x, grid_y = (a.ravel() + 5.0 for a in np.meshgrid(phase, phase))
    clean = stamps_of(1e5 * draw(grid_x, grid_y), np.full(144, 5.0), np.full(144, 5.0))
    table = get_centroider("epsf", epsf=solution.epsf).measure(clean, noise)
    offset = np.array([(table.x_px - grid_x).mean(), (table.y_px - grid_y).mean()])
    assert np.abs(offset).max() < 5e-3
    assert np.abs(table.x_px - grid_x - offset[0]).max() < 1e-3
    assert np.abs(table.y_px - grid_y - offset[1]).max() < 1e-3
    error = solution.stars.x_px - x
    assert error.std() / solution.stars.sigma_x_px.mean() == pytest.approx(1.0, abs=0.1)
    assert (solution.stars.y_px - y).std() / solution.stars.sigma_y_px.mean() == pytest.approx(1.0, abs=0.1)


def test_bad_stars_take_no_part_in_the_psf(noise):
    stamps, index, *_ = dithered(stars=20, frames=10)
    flags, electrons = np.array(stamps.flags), np.array(stamps.electrons)
    flags[::50] |= int(StarFlag.BLEND)
    electrons[::50] += 3e4 * gaussian_stars([8.0], [2.0], 0.7)
    solution = build_epsf(replace(stamps, flags=flags, electrons=electrons), noise, **index)
    assert not solution.used[::50].any()
    assert solution.chi2 < 1.1
    assert has_flag(solution.stars.flags, StarFlag.BLEND)[::50].all()


def test_smeared_psf_has_the_variance_of_its_path() -> None:
    grid = np.arange(-80, 81) / 8.0
    gauss = np.exp(-0.5 * (grid[:, None] ** 2 + grid[None, :] ** 2) / 0.8**2)
    psf = gauss / gauss.sum() * 64
    path = np.column_stack([np.linspace(-1.5, 1.5, 31), np.zeros(31)])
    (smeared,) = smeared_epsfs(psf[None], path[None])
    assert isinstance(smeared, EffectivePsf)
    share = smeared.values / smeared.values.sum()
    assert smeared.values.sum() == pytest.approx(64, rel=1e-9)
    assert (share.sum(0) * grid).sum() == pytest.approx(0.0, abs=1e-9)
    assert (share.sum(0) * grid**2).sum() == pytest.approx(0.64 + path[:, 0].var(), rel=1e-6)  # columns: along the path
    assert (share.sum(1) * grid**2).sum() == pytest.approx(0.64, rel=1e-6)
    (still,) = smeared_epsfs(psf[None], np.zeros((1, 1, 2)))
    np.testing.assert_array_equal(still.values, psf)
