"""Detections beside the truth: which stars are found, what is found that is no star, and how far off centroids are."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calib.crlb import cramer_rao
from calib.epsf import draw_epsf
from calib.flags import StarFlag, has_flag
from calib.records import NoiseModel
from experiments.dataset.measure import UNFIT, MeasuredFrame
from experiments.dataset.truth import FLAGS
from optics.records import freeze
from render.records import EffectivePsf

__all__ = ["CentroidBound", "FoundStars", "centroid_bound", "compare_frame", "false_alarms", "joined"]

FloatArray = NDArray[np.float64]

MATCH_PX = 2.0
"""A detection this near to the light of a star is that star; both must be each other's nearest."""
NEAR_PX = 4.0
"""A detection farther than this from every rendered star is false."""
PHASES = 5
FLUX_KNOTS = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundStars:
    """Stars of one or more frames, and what the detection made of them.

    Attributes
    ----------
    magnitude, snr, electrons : (n,)
        Of every star of which light reaches the detector.
    flags : (n,) int32
        Of the truth (`experiments.dataset.truth.FLAGS`).
    found : (n,) bool
        Whether a detection belongs to it.
    fit : (n,) bool
        Whether that detection has no flag of the measurement.
    blend_seen : (n,) bool
        Whether that detection is flagged ``BLEND``.
    error_px : (n, 2)
        Centroid minus centroid of the noiseless light; NaN where there is no centroid.
    radius_px : (n,)
        Distance from the middle of the detector.
    false : (f,)
        Frames of detections without a star.
    false_spike : (f,) bool
        Whether these are flagged as sharper than a star or as defective.
    frames : int
        Number of frames.
    """

    magnitude: FloatArray
    snr: FloatArray
    electrons: FloatArray
    flags: NDArray[np.int32]
    found: NDArray[np.bool_]
    fit: NDArray[np.bool_]
    blend_seen: NDArray[np.bool_]
    error_px: FloatArray
    radius_px: FloatArray
    false: NDArray[np.int64]
    false_spike: NDArray[np.bool_]
    frames: int

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("magnitude", "snr", "electrons", "radius_px"):
            freeze(self, name, shape=("n",), sizes=sizes)
        for name, kind in (("flags", np.int32), ("found", np.bool_), ("fit", np.bool_), ("blend_seen", np.bool_)):
            freeze(self, name, shape=("n",), dtype=kind, sizes=sizes)
        freeze(self, "error_px", shape=("n", 2), finite=False, sizes=sizes)
        freeze(self, "false", shape=("f",), dtype=np.int64, sizes=sizes)
        freeze(self, "false_spike", shape=("f",), dtype=np.bool_, sizes=sizes)

    def has(self, flag: str) -> NDArray[np.bool_]:
        """Stars with a flag of the truth."""
        return np.asarray((self.flags & FLAGS[flag][0]) != 0)

    @property
    def clean(self) -> NDArray[np.bool_]:
        """Stars that nothing disturbs: no flag of the truth but a vignetted pupil."""
        return np.asarray((self.flags & ~np.int32(FLAGS["vignetted"][0])) == 0)


def compare_frame(
    frame: int, measured: MeasuredFrame, truth: dict[str, Any], *, width_px: int, height_px: int
) -> FoundStars:
    """Lay the detections of a frame beside its truth.

    Parameters
    ----------
    frame : int
        Its number.
    measured : MeasuredFrame
        Detections.
    truth : dict
        Columns of its truth.
    width_px, height_px : int
        Size of the detector.
    """
    lit = (np.asarray(truth["flags"]) & FLAGS["no_light"][0]) == 0
    star = np.column_stack([truth["photon_x_px"], truth["photon_y_px"]])[lit]
    detected = measured.detected_px
    n = len(star)
    partner = np.full(n, -1)
    lonely = np.ones(len(detected), bool)
    if n and len(detected):
        distance, nearest = cKDTree(detected).query(star)
        back_distance, back = cKDTree(star).query(detected)
        mutual = (back[nearest] == np.arange(n)) & (distance <= MATCH_PX)
        partner[mutual] = nearest[mutual]
        lonely = back_distance > NEAR_PX
    found = partner >= 0
    error = np.full((n, 2), np.nan)
    error[found] = measured.pixel_px[partner[found]] - star[found]
    flags = np.zeros(n, np.uint32)
    flags[found] = measured.stars.flags[partner[found]]
    middle = np.array([(width_px - 1) / 2, (height_px - 1) / 2])
    sharp = has_flag(measured.stars.flags, StarFlag.SPIKE) | has_flag(measured.stars.flags, StarFlag.DEFECT)
    return FoundStars(
        magnitude=np.asarray(truth["magnitude"])[lit],
        snr=np.asarray(truth["snr"])[lit],
        electrons=np.asarray(truth["electrons"])[lit],
        flags=np.asarray(truth["flags"], np.int32)[lit],
        found=found,
        fit=found & ((flags & np.uint32(int(UNFIT))) == 0),
        blend_seen=has_flag(flags, StarFlag.BLEND),
        error_px=error,
        radius_px=np.hypot(*(star - middle).T) if n else np.zeros(0),
        false=np.full(np.count_nonzero(lonely), frame),
        false_spike=sharp[lonely],
        frames=1,
    )


def joined(parts: list[FoundStars]) -> FoundStars:
    """Stars of several frames as one record."""
    names = [one.name for one in fields(FoundStars) if one.name != "frames"]
    return FoundStars(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
        frames=sum(part.frames for part in parts),
    )


def false_alarms(pixels: int, threshold_sigma: float, fwhm_px: float) -> float:
    """Maxima of filtered white noise above a threshold that an image of so many pixels has, expected.

    A Gaussian field of unit variance with the correlation exp(-r^2 / (4 s^2)), s the width of the filter, has
    ``u exp(-u^2 / 2) / ((2 pi)^(3/2) 2 s^2)`` maxima above a high level u per unit of area (R. J. Adler, *The Geometry
    of Random Fields*, 1981, sec. 6.8).
    """
    width = fwhm_px / 2.354820045
    density = threshold_sigma * np.exp(-(threshold_sigma**2) / 2) / ((2 * np.pi) ** 1.5 * 2 * width**2)
    return float(pixels * density)


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidBound:
    """Cramer-Rao bound of a centroid against electrons, at some distances from the middle of the detector.

    Attributes
    ----------
    radius_px : (r,)
        Increasing distances of the PSFs.
    electrons : (k,)
        Increasing.
    sigma_px : (r, k)
        Root of the mean variance of x and y, mean over sub-pixel phases.
    """

    radius_px: FloatArray
    electrons: FloatArray
    sigma_px: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "radius_px", shape=("r",), sizes=sizes)
        freeze(self, "electrons", shape=("k",), sizes=sizes)
        freeze(self, "sigma_px", shape=("r", "k"), sizes=sizes)

    def at(self, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Bound (n,) of stars, by the PSF nearest in distance."""
        nearest = np.abs(np.asarray(radius_px)[:, None] - self.radius_px).argmin(axis=1)
        log_e = np.log(np.asarray(electrons))
        rows = np.stack([np.interp(log_e, np.log(self.electrons), np.log(row)) for row in self.sigma_px])
        return np.asarray(np.exp(rows[nearest, np.arange(len(log_e))]))


def centroid_bound(
    psfs: list[EffectivePsf],
    radius_px: FloatArray,
    *,
    noise: NoiseModel,
    background_e: float,
    window_px: int,
    electrons: tuple[float, float],
) -> CentroidBound:
    """Bound for stars of unknown position and flux on a known background, in the window that is used.

    Parameters
    ----------
    psfs : list of EffectivePsf
        At increasing distances from the middle.
    radius_px : (r,)
        These distances.
    noise : NoiseModel
        Of a pixel.
    background_e : float
        Expected electrons per pixel without the star.
    window_px : int
        Size of the window.
    electrons : (float, float)
        Range.
    """
    flux = np.geomspace(*electrons, FLUX_KNOTS)
    middle = (window_px - 1) / 2.0
    phase = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    sigma = np.empty((len(psfs), FLUX_KNOTS))
    for row, psf in enumerate(psfs):

        def image(theta: FloatArray, psf: EffectivePsf = psf) -> FloatArray:
            one = draw_epsf(psf, theta[:1], theta[1:2], (window_px, window_px))[0]
            return np.asarray(theta[2] * one + background_e)

        for column, value in enumerate(flux):
            variance = []
            for dx in phase:
                for dy in phase:
                    bound = cramer_rao(image, np.array([middle + dx, middle + dy, value]), noise)
                    variance.append((bound[0, 0] + bound[1, 1]) / 2.0)
            sigma[row, column] = np.sqrt(np.mean(variance))
    return CentroidBound(radius_px=np.asarray(radius_px, float), electrons=flux, sigma_px=sigma)
