"""A few wavelengths whose diffraction images represent a band."""

from __future__ import annotations

import math

import numpy as np

from optics.arrays import FloatArray, IntArray

RINGS = 44.0
"""Wavelengths per relative half width of a band, by the change of the rings' scale."""


def lagrange(points: FloatArray, at: FloatArray) -> FloatArray:
    """Values (n, p) at n places of the Lagrange polynomials of p points."""
    difference = points[:, None] - points
    np.fill_diagonal(difference, 1.0)
    distance = at[:, None] - points
    before, after = np.ones((2, len(at), len(points)))
    np.cumprod(distance[:, :-1], axis=1, out=before[:, 1:])
    np.cumprod(distance[:, :0:-1], axis=1, out=after[:, 1:])
    return np.asarray(before * after[:, ::-1] / difference.prod(1))


def picked_wavelengths(
    wavelength_nm: FloatArray, finer: float = 1.0, phase_rad: float = 0.0
) -> tuple[IntArray, IntArray, FloatArray]:
    """Numbers of wavelengths that have images (q,) and of those that test errors (j,), and weights (k, q) for all.

    Polynomials on wavelengths (k,) near Chebyshev's extrema.
    """
    middle, half = 0.5 * (wavelength_nm.max() + wavelength_nm.min()), 0.5 * np.ptp(wavelength_nm)
    wanted = math.ceil((3.0 + (RINGS + phase_rad) * half / middle) * finer)
    order = np.argsort(wavelength_nm)
    if wanted >= len(wavelength_nm) or half == 0.0:
        which = np.asarray(order)
    else:
        extrema = middle - half * np.cos(np.pi * np.arange(wanted) / (wanted - 1))
        which = np.unique([np.abs(wavelength_nm - extremum).argmin() for extremum in extrema])
    scaled = (wavelength_nm - middle) / (half or 1.0)
    distance = np.abs(scaled[:, None] - scaled[which]).prod(1)
    weight = lagrange(scaled[which], scaled) if half > 0.0 else np.full((len(scaled), len(which)), 1.0 / len(which))
    return which, np.unique([order[0], order[-1], distance.argmax()]), weight


def condensed_light(wavelength_nm: FloatArray, weight: FloatArray, phase_rad: float) -> tuple[FloatArray, FloatArray]:
    """Fewer wavelengths (b, q) and weights (n, b, t q) that represent the images of k wavelengths (n, b, t k).

    Parameters as `picked_wavelengths`, for all bands; weights may be negative.
    """
    bands, colours = wavelength_nm.shape
    most = max(len(picked_wavelengths(band, 1.0, phase_rad)[0]) for band in wavelength_nm)
    if most == colours:
        return wavelength_nm, weight
    waves = np.empty((bands, most))
    by_time = weight.reshape(*weight.shape[:2], -1, colours)
    condensed = np.zeros((*by_time.shape[:3], most))
    for b, band in enumerate(wavelength_nm):
        which = picked_wavelengths(band, 1.0, phase_rad)[0]
        while len(which) < most:  # the same number in every band, without repetition
            distance = np.abs(band[:, None] - band[which]).prod(1)
            which = np.sort(np.append(which, distance.argmax()))
        waves[b] = band[which]
        half = 0.5 * np.ptp(band)
        condensed[:, b] = by_time[:, b] @ lagrange((waves[b] - band[0]) / half, (band - band[0]) / half)
    return waves, condensed.reshape(*weight.shape[:2], -1)
