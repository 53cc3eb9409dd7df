"""Focus and tilt of a detector from widths of a cone of light, against those it was given."""

from __future__ import annotations

import numpy as np
import pytest

from calib.psf.focus_tilt import fit_detector_pose, gaussian_widths
from calib.psf.gaussian_mixture import MixturePsf

PITCH_MM, CENTRE = 5e-3, np.array([499.5, 399.5])
SHIFT = np.linspace(-0.06, 0.06, 25)
X, Y = np.meshgrid(np.linspace(0.0, 999.0, 7), np.linspace(0.0, 799.0, 7))
GRID = np.column_stack([X.ravel(), Y.ravel()])


def width(shift_mm, position_px):
    """F/2 cone about a curved focal surface [px]; sigma of a disk is half its radius."""
    sag = 6e-8 * ((position_px - CENTRE) ** 2).sum(axis=-1)
    return np.hypot(0.45, (shift_mm - sag) / (4.0 * 2.0) / PITCH_MM)


def fitted(defocus, slope, blur, seed, count=300, spread=0.04):
    rng = np.random.default_rng(seed)
    position = rng.uniform(10, [989, 789], (count, 2))
    shift = defocus + (position - CENTRE) @ slope * PITCH_MM
    measured = np.hypot(width(shift, position), blur) * (1.0 + spread * rng.standard_normal(count))
    return fit_detector_pose(
        position,
        measured,
        shift_mm=SHIFT,
        grid_px=GRID,
        grid_width_px=width(SHIFT[:, None], GRID),
        centre_px=CENTRE,
        pitch_mm=PITCH_MM,
    )


def test_focus_tilt_and_blur_come_back_with_unit_pulls():
    slope = np.array([0.004, -0.003])
    pose = fitted(0.02, slope, 0.2, 1)
    true = [0.02, -np.degrees(slope[1]), -np.degrees(slope[0]), 0.2]
    np.testing.assert_array_less(np.abs(pose.value - true), 4.0 * pose.sigma)
    assert pose.scatter == pytest.approx(0.04, rel=0.2)
    assert pose.scatter_before > 3.0 * pose.scatter
    assert pose.stars == 300
    # RMS of 16 pulls: 1 within 4 / sqrt(32)
    poses = [fitted(0.02, np.zeros(2), 0.2, seed, count=60) for seed in range(16)]
    pulls = np.array([(pose.value - [0.02, 0.0, 0.0, 0.2]) / pose.sigma for pose in poses])[:, :2]
    np.testing.assert_allclose(np.sqrt((pulls**2).mean(axis=0)), 1.0, atol=4.0 / np.sqrt(32.0))


def test_two_foci_are_stated_and_few_stars_refused():
    """Without curvature focus and tilt of either sign give the same widths."""
    position = np.random.default_rng(3).uniform(10, [989, 789], (60, 2))
    table = np.repeat(np.hypot(0.45, SHIFT / (8.0 * PITCH_MM))[:, None], len(GRID), axis=1)
    lens = {"shift_mm": SHIFT, "grid_px": GRID, "grid_width_px": table, "centre_px": CENTRE, "pitch_mm": PITCH_MM}
    shift = 0.025 + 0.01 * (position - CENTRE)[:, 0] * PITCH_MM
    measured = np.hypot(0.45, shift / (8.0 * PITCH_MM))
    pose = fit_detector_pose(position, measured, **lens)
    assert [abs(pose.value[0]), abs(pose.other_focus_mm[0])] == pytest.approx([0.025, 0.025], abs=1e-3)
    assert pose.value[0] * pose.other_focus_mm[0] < 0.0


def test_widths_of_gaussian_psfs_are_their_sigmas():
    value = np.zeros(18)
    value[:6] = [-20.0, -20.0, np.log(0.1), np.log(0.8), np.log(1.1), np.log(2.0)]
    psf = MixturePsf(size_px=(100, 100), value=value, covariance=np.zeros((18, 18)), chi2=1.0)
    psfs = [psf.effective(np.array([49.5, 49.5]), 1, half_px=9)]
    pixel = 1.0 / 12.0  # a fit of a Gaussian that is not integrated over the pixel
    assert gaussian_widths(psfs)[0] ** 2 == pytest.approx((0.8**2 + 1.1**2) / 2.0 + pixel, rel=0.15)
