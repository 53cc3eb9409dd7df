"""Spectral response of a camera from the colours of its stars.

Colours alone do not determine a curve: the result is a stated quantum efficiency times the smoothest correction of few
knots with the measured colour terms.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from calib.photometry.zero_point import COLOUR_KNOTS, POGSON, REFERENCE_KNOT
from optics.arrays import FloatArray
from optics.light.magnitudes import photon_rate
from optics.light.spectrum import Blackbody

REFERENCE_K = 5040.0
"""Numerator of colours, 5040 K / T."""
WAVELENGTHS_NM = np.arange(400.0, 1001.0, 25.0)
CURVE_NM = np.array([400.0, 500.0, 600.0, 700.0, 800.0, 1000.0])
"""Knots of the correction."""
STIFFNESS_MAG, LEAST_ERROR_MAG, MEAN_MAG = 0.5, 0.01, 0.1
"""Prior of the bend of the correction at a knot, least error of a colour term, prior of the mean correction."""
HIGHEST_TRANSMISSION = 0.9


class SpectralResponse(NamedTuple):
    """Response with the measured colour terms."""

    relative: FloatArray  # (w,) At `WAVELENGTHS_NM`, in units of the stated efficiency
    colour_mag: FloatArray  # (k,) Colour term of this response at `COLOUR_KNOTS`
    electrons_per_mm2_s: float  # Of a star of G = 0 and the reference colour, per aperture area


@lru_cache(maxsize=64)
def blackbody_photons(temperature_k: float) -> FloatArray:
    """Photons (w,) [s^-1 mm^-2 nm^-1] of a black body of G = 0 at `WAVELENGTHS_NM`."""
    star = Blackbody(temperature_k=temperature_k)
    return np.asarray(photon_rate(star, 0.0, wavelength_nm=WAVELENGTHS_NM, system="G"))


def electrons_per_mm2(response: FloatArray, colour: FloatArray) -> FloatArray:
    """Electrons (n,) [s^-1 mm^-2] of stars of G = 0 and colours 5040 K / T (n,), by a response (w,)."""
    rates = np.stack([blackbody_photons(float(REFERENCE_K / value)) for value in np.ravel(colour)])
    return np.asarray(np.trapezoid(rates * np.asarray(response, float), WAVELENGTHS_NM, axis=1))


def fit_response(colour_mag: FloatArray, error_mag: FloatArray, efficiency: FloatArray) -> SpectralResponse:
    """Response of the measured colour terms (k,): excess brightness over G at `COLOUR_KNOTS`, NaN where it is unknown.

    ``efficiency`` (w,): stated quantum efficiency at `WAVELENGTHS_NM`.
    """
    finite = np.isfinite(colour_mag)
    measured, error = colour_mag[finite], np.maximum(error_mag[finite], LEAST_ERROR_MAG)
    colours = COLOUR_KNOTS[finite]
    reference = int(np.flatnonzero(colours == COLOUR_KNOTS[REFERENCE_KNOT])[0])

    def curve(p: FloatArray) -> FloatArray:
        return np.asarray(efficiency * np.exp(np.interp(WAVELENGTHS_NM, CURVE_NM, p) / POGSON))

    def misfit(p: FloatArray) -> FloatArray:
        light = electrons_per_mm2(curve(p), colours)
        terms = POGSON * np.log(light / light[reference])
        return np.concatenate([(terms - measured) / error, np.diff(p, 2) / STIFFNESS_MAG, [p.mean() / MEAN_MAG]])

    response = curve(least_squares(misfit, np.zeros(len(CURVE_NM))).x)
    light = electrons_per_mm2(response, COLOUR_KNOTS)
    return SpectralResponse(response, POGSON * np.log(light / light[REFERENCE_KNOT]), float(light[REFERENCE_KNOT]))


def aperture_and_transmission(
    zero_point_mag: float,
    response: SpectralResponse,
    efficiency: FloatArray,
    *,
    exposure_s: float,
    aperture_mm: float | None = None,
) -> tuple[float, FloatArray]:
    """Diameter of the aperture [mm] and transmission (w,) at `WAVELENGTHS_NM` that give the measured zero point.

    Frames determine their product: the aperture is the stated one, or the smallest of the highest transmission.
    """
    # electrons of a star of G = 0 per exposure, over electrons per mm2 and s: aperture area times response factor
    area_mm2 = 10.0 ** (0.4 * zero_point_mag) / (response.electrons_per_mm2_s * exposure_s)
    correction = response.relative / efficiency
    if aperture_mm is None or area_mm2 * correction.max() > 0.25 * np.pi * aperture_mm**2:
        aperture_mm = float(np.sqrt(4.0 * area_mm2 * correction.max() / (np.pi * HIGHEST_TRANSMISSION)))
    return aperture_mm, np.asarray(correction * area_mm2 / (0.25 * np.pi * aperture_mm**2))
