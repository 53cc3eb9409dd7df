"""Focus and tilt of a detector behind a known lens, from the widths of stars over the field.

Widths of Gaussian fits are compared with fits to the lens's own PSFs at several shifts of the detector. The shift is
linear over the detector, z = z0 + a x + b y; diffraction and air add a width in quadrature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares

from calib.measure.centroiding.registry import get_centroider
from calib.measure.stamps import noiseless_stamps
from calib.measure.statistics.robust import robust_rms
from calib.records import NoiseModel
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import EffectivePsf

WINDOW_PX = 11
FEWEST_STARS = 30
STEEPEST_RAD, WIDEST_BLUR_PX = 0.05, 3.0
STARTS = np.linspace(-0.6, 0.6, 5)
"""Start of the focus over the search range."""
SAME_MISFIT, SAME_FOCUS = 4.5, 0.1
"""Chi-square per degree of freedom, and fraction of the range, within which a second focus fits equally well."""


class DetectorPose(NamedTuple):
    """Position of a detector along the axis of a lens."""

    stars: int
    value: FloatArray  # (4,) Defocus [mm], tilt about x and y of the lens [deg], width added in quadrature [px]
    sigma: FloatArray  # (4,) Standard deviations
    scatter: float  # Relative scatter of the widths about the fitted lens
    scatter_before: float  # The same about the lens without shift, tilt and blur
    other_focus_mm: list[float]  # Further foci that fit equally well


def fit_detector_pose(
    position_px: FloatArray,
    width_px: FloatArray,
    *,
    shift_mm: FloatArray,
    grid_px: FloatArray,
    grid_width_px: FloatArray,
    centre_px: FloatArray,
    pitch_mm: float,
) -> DetectorPose:
    """Focus and tilt from the widths of Gaussian fits of stars, ``position_px`` (n, 2), ``width_px`` (n,).

    The lens was rendered at shifts of the detector away from it, ``shift_mm`` (s,), symmetric about 0:
    ``grid_width_px`` (s, g) are widths of its PSFs (`gaussian_widths`) on a regular grid (g, 2), row by row;
    ``centre_px`` (2,) is the middle of the detector.

    Raises
    ------
    DomainError
        On fewer than 30 stars.
    """
    if len(width_px) < FEWEST_STARS:
        raise DomainError(f"{len(width_px)} bright stars; focus and tilt of a lens need {FEWEST_STARS}")
    reach = float(shift_mm[-1])
    x, y = (np.unique(np.round(grid_px[:, k], 6)) for k in (0, 1))
    log_variance = np.log(np.reshape(np.square(grid_width_px), (len(shift_mm), len(y), len(x))))
    table = RegularGridInterpolator((shift_mm, y, x), log_variance, method="cubic", bounds_error=False)
    offset_mm = (position_px - centre_px) * pitch_mm
    at = np.clip(position_px, [x[0], y[0]], [x[-1], y[-1]])

    def model(p: FloatArray) -> FloatArray:
        z = np.clip(p[0] + offset_mm @ p[1:3], -reach, reach)
        return 0.5 * np.log(np.exp(table(np.column_stack([z, at[:, 1], at[:, 0]]))) + p[3] ** 2)

    measured = np.log(width_px)
    slope = 0.1 * reach / np.abs(offset_mm).max()
    fits = [
        least_squares(
            lambda p: model(p) - measured,
            [start, 0.0, 0.0, 0.2],
            bounds=([-reach, *[-STEEPEST_RAD] * 2, 0.0], [reach, *[STEEPEST_RAD] * 2, WIDEST_BLUR_PX]),
            x_scale=[0.1 * reach, slope, slope, 0.1],
            loss="soft_l1",
            f_scale=0.05,
        )
        for start in STARTS * reach
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    scatter = robust_rms(measured - model(best.x))
    free = best.x[3] > 1e-3  # a blur at its bound is held
    jacobian = best.jac if free else best.jac[:, :3]
    sigma = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian))) * scatter
    sigma = sigma if free else np.append(sigma, 0.0)
    noise = best.cost * 2.0 / (len(measured) - 4)
    equal = [fit.x[0] for fit in fits if fit.cost - best.cost < SAME_MISFIT * noise]
    others = [float(z) for z in equal if abs(z - best.x[0]) > SAME_FOCUS * reach]
    scale = np.array([1.0, -np.degrees(1.0), -np.degrees(1.0), 1.0])  # slopes along y and x are tilts about x and y
    rows = [0, 2, 1, 3]
    scatter_before = robust_rms(measured - model(np.zeros(4)))
    value, sigma = scale * best.x[rows], np.abs(scale) * sigma[rows]
    return DetectorPose(len(measured), value, sigma, scatter, scatter_before, others)


def gaussian_widths(psfs: Sequence[EffectivePsf]) -> FloatArray:
    """Widths (n,) [px] of Gaussian fits to PSFs, each the mean over all phases of the pixel."""
    widths = []
    centroider = get_centroider("gaussian", fit_background=True)
    for psf in psfs:
        fine = psf.oversampling
        start = len(psf.values) // 2 - (WINDOW_PX // 2) * fine - fine // 2
        i, j = np.divmod(np.arange(fine * fine), fine)
        pixel = np.arange(WINDOW_PX) * fine + start
        windows = psf.values[(i[:, None] + pixel)[:, :, None], (j[:, None] + pixel)[:, None, :]]
        start_px = (fine // 2 - np.column_stack([j, i])) / fine + WINDOW_PX // 2
        stamps = noiseless_stamps(3e4 * windows + 100.0, start_px=start_px)
        stamps = replace(stamps, background_e=np.full(len(i), 100.0))
        widths.append(float(np.nanmean(centroider.measure(stamps, NoiseModel(read_noise_e=5.0)).width_px)))
    return np.array(widths)
