"""Light of stars of any temperature at the wavelength nodes of filter bands, from one table per set of bands."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.band import Band, band_nodes
from optics.light.magnitudes import photon_rate
from optics.light.spectrum import Blackbody, Sed
from optics.records import freeze_all
from render.records import StarField

TEMPERATURE_KNOTS = 96
COLDEST_K, HOTTEST_K = 900.0, 70000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarLight:
    """Light of stars of any temperature in given bands; made by `star_light`, once per set of bands."""

    band: tuple[str, ...]  # Names of the b bands
    wavelength_nm: FloatArray  # (b, k) Nodes (`optics.light.band.band_nodes`)
    magnitude_system: Literal["V", "G"]  # Scale of the magnitudes that it takes
    log_temperature: FloatArray  # (s,) Knots, equally spaced in log T
    spline: Any  # Logarithm of the photon rate of a star of magnitude 0 at each node over log T, (b, k)

    def __post_init__(self) -> None:
        freeze_all(self, wavelength_nm=("b", "k"), log_temperature=("s",), sizes={"b": len(self.band)})

    def photon_rate(self, magnitude: FloatArray, temperature_k: FloatArray) -> FloatArray:
        """Photons s^-1 mm^-2 that each node stands for, (n, b, k), of n stars."""
        m, t = np.asarray(magnitude, np.float64), np.asarray(temperature_k, np.float64)
        low, high = np.exp(self.log_temperature[[0, -1]])
        for what, values, good, unit, advice in (
            ("magnitude", m, np.isfinite(m), "", "leave such stars out with a magnitude limit"),
            ("temperature", t, (t >= low) & (t <= high), " K", f"{low:.0f} ... {high:.0f} K is allowed"),
        ):
            if not good.all():
                at = int(np.argmin(good))
                raise DomainError(f"{what} of star {at} is {values[at]:g}{unit}; {advice}")
        return np.asarray(np.exp(self.spline(np.log(t)) - (0.4 * math.log(10.0)) * m[:, None, None]))

    def stars(self, direction: FloatArray, magnitude: ArrayLike, temperature_k: ArrayLike) -> StarField:
        """Stars of given magnitudes and temperatures, each (n,) or one for all, seen at directions (n, 3)."""
        m, t = (np.broadcast_to(np.asarray(value, float), len(direction)) for value in (magnitude, temperature_k))
        return StarField(
            direction=direction, wavelength_nm=self.wavelength_nm, photon_rate=self.photon_rate(m, t), band=self.band
        )


def star_light(
    bands: Sequence[Band],
    *,
    nodes: int = 5,
    magnitude_system: Literal["V", "G"] = "G",
    spectrum: Callable[[float], Sed] | None = None,
) -> StarLight:
    """Prepare bands: light of a star of magnitude 0 as a function of temperature, for interpolation.

    Parameters
    ----------
    bands : sequence of Band
        b filters.
    nodes : int
        Wavelength nodes per band, k.
    magnitude_system : {"V", "G"}
        Scale of the magnitudes of the catalogue.
    spectrum : callable, optional
        Spectrum of a temperature [K]; black bodies if left out.

    Returns
    -------
    StarLight
        Exact at 96 temperatures from 900 to 70 000 K, a cubic spline in log T of the logarithm between them: below 1e-5
        of the rate between 1200 and 50 000 K for black bodies.

    Raises
    ------
    ConfigError, DomainError
        As `optics.light.band.band_nodes` and `optics.light.magnitudes.photon_rate`.
    """
    from scipy.interpolate import CubicSpline

    rule = band_nodes(bands, nodes)
    log_t = np.linspace(math.log(COLDEST_K), math.log(HOTTEST_K), TEMPERATURE_KNOTS)
    of = (lambda t: Blackbody(temperature_k=t)) if spectrum is None else spectrum
    rates = [
        photon_rate(of(float(t)), 0.0, wavelength_nm=rule.wavelength_nm, system=magnitude_system) for t in np.exp(log_t)
    ]
    light = np.array(rates) * rule.weight_nm * rule.transmission
    if not (light > 0.0).all():
        raise DomainError("a band has a wavelength node without light; leave out its dark parts")
    return StarLight(
        band=rule.name,
        wavelength_nm=rule.wavelength_nm,
        magnitude_system=magnitude_system,
        log_temperature=log_t,
        spline=CubicSpline(log_t, np.log(light)),
    )
