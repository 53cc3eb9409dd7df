r"""From a magnitude to photons: synthetic photometry through the published passband, scaled by its zero point.

* ``"V"`` (Johnson): passband of Bessell, PASP 102, 1181 (1990), a response to energy; zero point of Bessell, Castelli
  and Plez, A&A 333, 231 (1998), table A2 and its note, in erg s^-1 cm^-2 A^-1:

  .. math:: V = -2.5 \log_{10} \frac{\int f_\lambda R\, d\lambda}{\int R\, d\lambda} - 21.100

  The authors meant Vega to have V = 0.03 on it; the CALSPEC model of Vega has V = 0.018, which shows the uncertainty of
  absolute fluxes (1.2 %).
* ``"G"`` (Gaia DR3): passband and zero point of Riello et al., A&A 649, A3 (2021), files of
  ``GaiaEDR3_passbands_zeropoints_version2``; photo-electrons per second through a pupil of 0.7278 m^2:

  .. math:: G = -2.5 \log_{10} \left( P_A \int N_\lambda S\, d\lambda \right) + 25.6873668671 \pm 0.0028
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.light.band import Band, TabulatedBand, piecewise_nodes
from optics.light.spectrum import PHOTON_J_NM, Sed

_ERG_S_CM2_A = 1e8  # erg s^-1 cm^-2 A^-1 in one W mm^-2 nm^-1
_GAIA_PUPIL_MM2 = 0.7278e6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnitudeSystem:
    """A magnitude scale."""

    name: str
    source: str  # Of passband and zero point
    band: TabulatedBand  # Passband
    detects: Literal["energy", "photon"]  # What the passband responds to
    scale: float  # Factor from the integral (W or photons s^-1 mm^-2) to the argument of the logarithm
    zero_point: float  # Magnitude of a source for which the argument is 1


def _band(file: str, name: str, source: str) -> TabulatedBand:
    text = files("optics").joinpath("data", "bands", file).read_text(encoding="utf-8")
    table = np.loadtxt(io.StringIO(text), delimiter=",")
    return TabulatedBand(name=name, source=source, wavelength_nm=table[:, 0], value=table[:, 1])


@cache
def magnitude_system(name: str) -> MagnitudeSystem:
    """Magnitude scale by name."""
    if name == "V":
        source = "passband: Bessell, PASP 102, 1181 (1990); zero point: Bessell, Castelli, Plez, A&A 333, 231 (1998)"
        band = _band("johnson_v_bessell1990.csv", "V", source)
        scale = _ERG_S_CM2_A / band_integral(band, np.ones_like)
        return MagnitudeSystem(name=name, source=source, band=band, detects="energy", scale=scale, zero_point=-21.100)
    if name == "G":
        source = "Riello et al., A&A 649, A3 (2021), GaiaEDR3_passbands_zeropoints_version2 (ESA/Gaia/DPAC)"
        band, zero_point = _band("gaia_g_dr3.csv", "G", source), 25.6873668671
        return MagnitudeSystem(
            name=name, source=source, band=band, detects="photon", scale=_GAIA_PUPIL_MM2, zero_point=zero_point
        )
    raise unknown_name("magnitude system", name, ("V", "G"))


def band_integral(
    band: Band, function: Callable[[FloatArray], FloatArray], *, breakpoints_nm: ArrayLike = (), order: int = 4
) -> float:
    """Integral of a function times a band over wavelength."""
    wave, weight = _fine_nodes(band, np.asarray(breakpoints_nm, dtype=np.float64), order)
    return float(np.asarray(function(wave)) @ weight)


def _fine_nodes(band: Band, breakpoints_nm: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre between all breakpoints of band and function; the weights hold the transmission."""
    edges = band.breakpoints_nm
    inner = breakpoints_nm[(breakpoints_nm > edges[0]) & (breakpoints_nm < edges[-1])]
    wave, weight = piecewise_nodes(np.unique(np.concatenate([edges, inner])), order)
    return wave, weight * band.transmission(wave)


def _check_covered(sed: Sed, system: MagnitudeSystem) -> None:
    low, high = sed.range_nm
    first, last = system.band.breakpoints_nm[[0, -1]]
    if low > first or high < last:
        raise DomainError(
            f"spectrum known from {low:g} to {high:g} nm does not cover the {system.name} passband, {first:g} ... "
            f"{last:g} nm; extend it or use another magnitude"
        )


def synthetic_magnitude(sed: Sed, *, system: str = "V") -> float:
    """Magnitude of a source of absolute spectrum.

    Parameters
    ----------
    sed : Sed
        Photons s^-1 mm^-2 nm^-1 as they arrive.
    system : {"V", "G"}
        Magnitude scale.

    Returns
    -------
    float
        Magnitude.

    Raises
    ------
    ConfigError
        Unknown scale.
    DomainError
        The spectrum does not cover the passband, or has no light in it.
    """
    scale = magnitude_system(system)
    _check_covered(sed, scale)
    wave, weight = _fine_nodes(scale.band, sed.breakpoints_nm, 4)
    photons = sed.photon_density(wave)
    signal = float((photons * PHOTON_J_NM / wave if scale.detects == "energy" else photons) @ weight)
    if not signal > 0.0:
        raise DomainError(f"the spectrum has no light in the {system} passband, so it has no magnitude there")
    return scale.zero_point - 2.5 * float(np.log10(scale.scale * signal))


def _brightening(sed: Sed, magnitude: ArrayLike, system: str) -> FloatArray:
    """Factor on a spectrum that gives it the magnitude; shape of ``magnitude``."""
    values = np.asarray(magnitude, dtype=np.float64)
    if not np.isfinite(values).all():
        raise DomainError(f"magnitude {values[~np.isfinite(values)].flat[0]} is not finite")
    return np.asarray(10.0 ** (-0.4 * (values - synthetic_magnitude(sed, system=system))))


def photon_rate(sed: Sed, magnitude: ArrayLike, *, wavelength_nm: ArrayLike, system: str = "V") -> FloatArray:
    """Photons arriving from a star of given magnitude and spectral shape, above the atmosphere.

    Parameters
    ----------
    sed : Sed
        Spectrum; only its shape matters.
    magnitude : array_like, (...)
        Magnitudes.
    wavelength_nm : array_like, (...)
        Wavelengths [nm].
    system : {"V", "G"}
        Magnitude scale.

    Returns
    -------
    numpy.ndarray
        Photons s^-1 mm^-2 nm^-1, shape of ``magnitude`` followed by that of ``wavelength_nm``.

    Raises
    ------
    ConfigError
        Unknown scale.
    DomainError
        Magnitude not finite, spectrum that does not cover the passband or the wavelengths.
    """
    return np.multiply.outer(_brightening(sed, magnitude, system), sed.photon_density(wavelength_nm))


def band_photon_rate(sed: Sed, magnitude: ArrayLike, bands: Sequence[Band], *, system: str = "V") -> FloatArray:
    """Photons s^-1 mm^-2 (..., b) that pass each of b filters, integrated over all of its pieces."""
    rates = [band_integral(band, sed.photon_density, breakpoints_nm=sed.breakpoints_nm, order=8) for band in bands]
    return np.multiply.outer(_brightening(sed, magnitude, system), np.array(rates))
