"""Mean and variance of a pixel, from the detector's description and the conditions.

A pixel that expects ``light`` photo-electrons reads, in electrons above the nominal offset,

    light (1 + PRNU) + dark charge + offset pattern + temporal noise,

and its temporal variance is the sum of photons and dark charge (Poisson), read noise and rounding to whole DN (EMVA
1288 Release 4.0: K^2 (sigma_d^2 + light) + 1/12 in DN^2). Read noise and dark current are means over the pixels, with
their pixel-to-pixel scatter. Fixed patterns are separate from temporal noise: response (PRNU), offset (DSNU, dark
current), columns.

Pixels listed as defects are excluded (the maker's hot pixels, known displacement damage). Full well, crosstalk and the
limits of the converter are neglected; so is the non-linearity, which affects mean and noise alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import gammainc, gammaincinv, gammaln, xlogy

from optics.arrays import FloatArray
from render.detector.spec import Detector


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelNoise:
    """Noise and patterns of a pixel in one exposure [e-]."""

    read_e2: float  # Mean variance of the read noise over the pixels
    read_e4: float  # Variance over the pixels of that variance
    dark_e: float  # Mean dark charge, displacement damage included; also its temporal variance [e-^2]
    dark_pattern_e: float  # Standard deviation of the dark charge over the pixels
    rounding_e2: float  # Variance of rounding to whole DN
    prnu: float  # Standard deviation of the response over the pixels, relative
    dsnu_e: float  # Standard deviation of the offset over the pixels
    column_e: float  # and over the columns

    @classmethod
    def of(cls, detector: Detector, *, temperature_c: float, exposure_s: float) -> Self:
        """Noise of a detector under its conditions.

        Read noise is log-normal over the pixels with the median ``read_noise_e`` and the standard deviation s of its
        logarithm: its square has the mean read_noise_e^2 exp(2 s^2) and the variance mean^2 (exp(4 s^2) - 1).
        """
        dark_s = detector.dark_factor(temperature_c) * exposure_s
        spread2 = detector.read_noise_spread**2
        read_e2 = float(detector.read_noise_e**2 * np.exp(2.0 * spread2))
        damage, damage_variance = damage_moments(detector)
        spread = detector.dark_spread_e_per_s if detector.dark_current_e_per_s > 0.0 else 0.0
        return cls(
            read_e2=read_e2,
            read_e4=float(read_e2**2 * np.expm1(4.0 * spread2)),
            dark_e=(detector.dark_current_e_per_s + damage) * dark_s,
            dark_pattern_e=float(np.sqrt(spread**2 + damage_variance)) * dark_s,
            rounding_e2=1.0 / (12.0 * detector.gain_dn_per_e**2),
            prnu=detector.prnu,
            dsnu_e=detector.dsnu_e,
            column_e=detector.column_pattern_e,
        )

    @property
    def floor_e2(self) -> float:
        """Temporal variance of a pixel without light, mean over the pixels."""
        return self.read_e2 + self.dark_e + self.rounding_e2

    @property
    def floor_e4(self) -> float:
        """Variance over the pixels of `floor_e2`: one chip differs from the next."""
        return self.read_e4 + self.dark_pattern_e**2

    @property
    def offset_e(self) -> float:
        """Standard deviation over the pixels of a frame without light: offset and dark charge."""
        return float(np.hypot(self.dsnu_e, self.dark_pattern_e))

    def temporal_e2(
        self, light_e: FloatArray | float, *, frames: int = 1, dark_frames: int | None = None
    ) -> FloatArray:
        """Temporal variance, in the mean of ``frames``, of pixels that expect ``light_e``, any shape.

        ``dark_frames``: frames without light whose mean is subtracted.
        """
        variance = (np.asarray(light_e, np.float64) + self.floor_e2) / frames
        return variance if dark_frames is None else variance + self.floor_e2 / dark_frames

    def response_e2(self, light_e: FloatArray | float) -> FloatArray:
        """Variance over the pixels by the response pattern; no averaging and no dark frame removes it."""
        return np.asarray((self.prnu * np.asarray(light_e, np.float64)) ** 2)


def damage_moments(detector: Detector) -> tuple[float, float]:
    """Mean [e-/s] and variance [e-^2/s^2] over the pixels of the dark current by displacement damage, at the reference.

    A Poisson number of centres (mean n), each with an exponential dark current of mean d: n d and 2 n d^2 if no pixel
    is in the map of defects. Of those below the limit K of the map, k centres make a gamma variate, and
    E[X^m; X < K] = d^m (k + m - 1)! / (k - 1)! P(k + m, K / d) with the regularised incomplete gamma function P.
    """
    n, d = detector.damage_centres_per_px, detector.damage_dark_e_per_s
    if n <= 0.0 or d <= 0.0:
        return 0.0, 0.0
    k = np.arange(1.0, n + 12.0 * np.sqrt(n) + 30.0)
    chance, limit = np.exp(xlogy(k, n) - n - gammaln(k + 1.0)), detector.damage_known_e_per_s / d
    unknown = np.exp(-n) + (chance * gammainc(k, limit)).sum()
    first = (chance * k * gammainc(k + 1.0, limit)).sum() / unknown
    second = (chance * k * (k + 1.0) * gammainc(k + 2.0, limit)).sum() / unknown
    return float(first * d), float((second - first**2) * d**2)


def damage_steps(detector: Detector, steps: int = 24) -> tuple[FloatArray, FloatArray]:
    """Dark current by displacement damage [e-/s], at the reference, and the share of the pixels that have it.

    Shapes (q,): no damage, then ``steps`` equal parts of the pixels of k = 1, 2 ... centres below the map's limit.
    """
    n, d = detector.damage_centres_per_px, detector.damage_dark_e_per_s
    if n <= 0.0 or d <= 0.0:
        return np.zeros(1), np.ones(1)
    k = np.arange(1.0, n + 6.0 * np.sqrt(n) + 4.0)
    listed_below = gammainc(k, detector.damage_known_e_per_s / d)
    part = gammaincinv(k[:, None], listed_below[:, None] * (np.arange(steps) + 0.5) / steps)
    chance = np.exp(xlogy(k, n) - n - gammaln(k + 1.0)) * listed_below
    fractions = np.concatenate([[np.exp(-n)], np.repeat(chance / steps, steps)])
    return np.concatenate([[0.0], d * part.ravel()]), fractions / fractions.sum()
