"""Stars in the field of many attitudes, and the attitude errors that they give, without frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.star_errors import DetectionLimit, StarErrors, colour_distance
from calib.attitude.attitude_covariance import attitude_covariance
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC


@dataclass(frozen=True, slots=True, kw_only=True)
class Sightings:
    """m sightings of stars on the detector in f attitudes."""

    frames: int  # f
    frame: NDArray[np.int64]  # (m,) Which attitude
    direction: FloatArray  # (m, 3) Unit vectors in cam
    pixel_px: FloatArray  # (m, 2) Column and row
    radius_px: FloatArray  # (m,) Distance from the middle of the detector
    temperature_k: FloatArray  # (m,) Colour
    electrons: FloatArray  # (m,) In one exposure
    neighbour_e: FloatArray  # (m,) Electrons of the brightest other star within the window
    brighter_px: FloatArray  # (m,) Distance of the nearest brighter star within the window; infinite: none
    colour_shift_px: FloatArray  # (m,) Radial shift by the colour, against the reference star


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeForecast:
    """Predicted attitude errors over f attitudes of the sky."""

    detected: FloatArray  # (f,) Expected number of stars that are detected
    detected_variance: FloatArray  # (f,) Variance of that number by noise
    # (f,) Expected number of those that are fit: not saturated, whole and alone in their window, on good pixels
    stars: FloatArray
    # (f, 3) Standard deviation about x, y (across) and z (roll) by temporal noise; infinite where too few stars are fit
    noise_arcsec: FloatArray
    total_arcsec: FloatArray  # (f, 3) The same with patterns, pixel phase and star colours
    sigma_px: FloatArray  # (m,) Error of each sighting, per axis, all terms
    chance: FloatArray  # (m,) That it is detected

    @property
    def across_arcsec(self) -> FloatArray:
        """(f,) Error across the boresight, root mean square of x and y."""
        return np.sqrt((self.total_arcsec[:, :2] ** 2).mean(axis=1))


def whole_windows(pixel_px: FloatArray, size_px: tuple[int, int], window_px: int) -> NDArray[np.bool_]:
    """Which windows around positions (m, 2) lie on a detector of (columns, rows)."""
    edge = window_px // 2 - 0.5
    return np.asarray(((pixel_px > edge) & (pixel_px < np.array(size_px) - 1 - edge)).all(axis=1))


def attitude_forecast(
    sightings: Sightings,
    stars: StarErrors,
    limit: DetectionLimit,
    *,
    pixel_arcsec: float,
    size_px: tuple[int, int],
    window_px: int,
    bad_fraction: float = 0.0,
) -> AttitudeForecast:
    """Attitudes from stars that are detected, alone and whole in their window, and not saturated.

    Parameters
    ----------
    sightings : Sightings
        Stars in the field of each attitude.
    stars : StarErrors
        Errors against electrons.
    limit : DetectionLimit
        Detection and noise.
    pixel_arcsec : float
        Angle of a pixel.
    size_px : (int, int)
        Columns and rows of the detector.
    window_px : int
        Side of the centroid window.
    bad_fraction : float
        Fraction of the pixels that are defective; a window with one of them is not used.
    """
    r, electrons = sightings.radius_px, sightings.electrons
    effective_e = stars.effective(electrons, sightings.temperature_k, r)
    chance = stars.detected_at(effective_e, r)
    saturated = np.interp(r, stars.radius_px, stars.centroid.peak) * electrons > limit.frame.saturation_e
    fit = np.where(saturated | ~whole_windows(sightings.pixel_px, size_px, window_px), 0.0, chance)
    fit = fit * (1.0 - bad_fraction) ** (window_px**2)
    fit = fit * (1.0 - stars.detected_at(sightings.neighbour_e, r))  # a neighbour within the window spoils both
    # two equal Gaussians, filtered with their own width, have one maximum up to two standard deviations of the sum
    chance = np.where(sightings.brighter_px < 2.0 * np.sqrt(2.0) * limit.sigma_px, 0.0, chance)
    noise = stars.sigma_at(stars.centroid.noise_px, effective_e, r)
    static = stars.sigma_at(np.hypot(stars.centroid.pattern_px, stars.centroid.phase_px), electrons, r)
    spot = stars.sigma_at(stars.colour_px, electrons, r) * colour_distance(sightings.temperature_k, stars.reference_k)
    variance = noise**2 + static**2 + 0.5 * sightings.colour_shift_px**2 + spot**2
    spread = []
    for square in (noise**2, variance):
        covariance = attitude_covariance(
            sightings.direction,
            square * (pixel_arcsec / RAD_ARCSEC) ** 2,
            sightings.frame,
            sightings.frames,
            probability=fit,
        )
        spread.append(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) * RAD_ARCSEC)
    sums = [
        np.bincount(sightings.frame, values, sightings.frames).astype(np.float64)
        for values in (chance, chance * (1.0 - chance), fit)
    ]
    return AttitudeForecast(
        detected=sums[0],
        detected_variance=sums[1],
        stars=sums[2],
        noise_arcsec=spread[0],
        total_arcsec=spread[1],
        sigma_px=np.sqrt(variance),
        chance=chance,
    )


def with_noise_scaled(total: float, noise: float, ratio: FloatArray) -> FloatArray:
    """A total error whose part by noise is larger by ratios (n,), the rest unchanged."""
    return np.asarray(np.sqrt(np.maximum(total**2 - noise**2, 0.0) + (noise * ratio) ** 2))


def draw_star_list(
    place_px: FloatArray,
    electrons: FloatArray,
    sigma_px: FloatArray,
    chance: FloatArray,
    *,
    false_alarms: float,
    size_px: tuple[int, int],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Positions (k, 2) and electrons (k,) as detected in one frame: stars with their errors, and false alarms.

    Stars (n,) at true positions (n, 2) are detected by chance; false alarms, a Poisson number, lie anywhere on the
    detector of (columns, rows) and are half as bright as the faintest star.
    """
    detected = rng.random(len(place_px)) < chance
    star_px, light = place_px[detected], electrons[detected]
    star_px = star_px + sigma_px[detected, None] * rng.standard_normal(star_px.shape)
    false = int(rng.poisson(min(false_alarms, 1e4)))
    faint = np.full(false, 0.5 * light.min(initial=1.0))
    anywhere = rng.uniform(-0.5, np.array(size_px) - 0.5, (false, 2))
    return np.concatenate([star_px, anywhere]), np.concatenate([light, faint])
