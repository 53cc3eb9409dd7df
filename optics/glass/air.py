r"""Refractive index of air.

Two published formulas:

* ``"kohlrausch"``: Edlen's dispersion of 1953 with the density of an ideal gas, as in F. Kohlrausch, *Praktische
  Physik* (1968), and in SCHOTT TIE-19. The glass catalogues and the lens trace use it, so it is the default:

  .. math:: n - 1 = \frac{p / p_0}{1 + 3.4785\cdot 10^{-3} (t - 15)} \left(6432.8
            + \frac{2949810 \lambda^2}{146 \lambda^2 - 1} + \frac{25540 \lambda^2}{41 \lambda^2 - 1}\right) 10^{-8}

* ``"ciddor"``: P. E. Ciddor, Appl. Opt. 35, 1566 (1996), with humidity and carbon dioxide and the density of moist air
  of BIPM 1981/91; the author states 2e-8 to 5e-8.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError, unknown_name
from optics.response import checked_wavelength

AirFormula = Literal["kohlrausch", "ciddor"]

STANDARD_PRESSURE_HPA = 1013.25
KELVIN = 273.15
RANGE_NM = {"kohlrausch": (185.0, 10000.0), "ciddor": (230.0, 1700.0)}
TEMPERATURE_RANGE_C = (-100.0, 140.0)


def air_index(
    wavelength_nm: ArrayLike,
    temperature_c: float = 20.0,
    pressure_hpa: float = STANDARD_PRESSURE_HPA,
    *,
    humidity: float = 0.0,
    co2_ppm: float = 450.0,
    formula: AirFormula = "kohlrausch",
) -> FloatArray:
    """Refractive index of air against vacuum."""
    if formula not in get_args(AirFormula):
        raise unknown_name("air formula", formula, get_args(AirFormula))
    low, high = TEMPERATURE_RANGE_C
    if not low <= temperature_c <= high:
        raise DomainError(f"air temperature {temperature_c:g} C is outside {low:g} ... {high:g} C")
    if not 0.0 <= pressure_hpa <= 2000.0:
        raise DomainError(f"air pressure {pressure_hpa:g} hPa is outside 0 ... 2000 hPa")
    wave = checked_wavelength(wavelength_nm, RANGE_NM[formula], f"air index ({formula})")
    if formula == "ciddor":
        return 1.0 + _ciddor(wave * 1e-3, temperature_c, pressure_hpa * 100.0, humidity, co2_ppm)
    if humidity != 0.0:
        raise ConfigError("humidity is not part of the 'kohlrausch' air formula; use formula='ciddor'")
    return 1.0 + kohlrausch_density(temperature_c, pressure_hpa) * kohlrausch_refractivity(wave)


def kohlrausch_refractivity(wavelength_nm: Any) -> Any:
    """n - 1 of air at 15 C and 1013.25 hPa (`air_index`, "kohlrausch"), on any array type with arithmetic."""
    l2 = (wavelength_nm * 1e-3) * (wavelength_nm * 1e-3)
    return 1e-8 * (6432.8 + 2949810.0 * l2 / (146.0 * l2 - 1.0) + 25540.0 * l2 / (41.0 * l2 - 1.0))


def kohlrausch_density(temperature_c: float, pressure_hpa: float) -> float:
    """Density of air relative to 15 C and 1013.25 hPa, by which `kohlrausch_refractivity` is multiplied."""
    return pressure_hpa / STANDARD_PRESSURE_HPA / (1.0 + 3.4785e-3 * (temperature_c - 15.0))


def _compressibility(t: float, p: float, xw: float) -> float:
    """Z of moist air; ``t`` [C], ``p`` [Pa], ``xw`` molar fraction of water vapour (Ciddor 1996, appendix A)."""
    ratio = p / (t + KELVIN)
    virial = 1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2
    virial += (5.707e-6 - 2.051e-8 * t) * xw + (1.9898e-4 - 2.376e-6 * t) * xw**2
    return 1.0 - ratio * virial + ratio**2 * (1.83e-11 - 0.765e-8 * xw**2)


def _water_fraction(t: float, p: float, humidity: float) -> float:
    """Molar fraction of water vapour from relative humidity (Ciddor 1996, appendices A and C)."""
    kelvin = t + KELVIN
    if t >= 0.0:
        saturation = np.exp(1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin)
    else:  # over ice
        saturation = 10.0 ** (12.537 - 2663.5 / kelvin)
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    return float(humidity * enhancement * saturation / p)


def _ciddor(wave_um: FloatArray, t: float, p: float, humidity: float, co2_ppm: float) -> FloatArray:
    """n - 1 after Ciddor 1996, equations 1-5; ``p`` [Pa]."""
    if not 0.0 <= humidity <= 1.0:
        raise DomainError(f"relative humidity {humidity:g} is outside 0 ... 1")
    if not 0.0 <= co2_ppm <= 2000.0:
        raise DomainError(f"carbon dioxide {co2_ppm:g} ppm is outside 0 ... 2000 ppm")
    if p == 0.0:
        return np.zeros_like(wave_um)
    s2 = wave_um**-2.0
    dry = 1e-8 * (5792105.0 / (238.0185 - s2) + 167917.0 / (57.362 - s2)) * (1.0 + 0.534e-6 * (co2_ppm - 450.0))
    vapour = 1.022e-8 * (295.235 + 2.6422 * s2 - 0.032380 * s2**2 + 0.004028 * s2**3)
    gas, water = 8.314510, 0.018015
    mass = 1e-3 * (28.9635 + 12.011e-6 * (co2_ppm - 400.0))
    xw = _water_fraction(t, p, humidity)
    density = p / (_compressibility(t, p, xw) * gas * (t + KELVIN))
    dry_density = density * mass * (1.0 - xw)
    water_density = density * water * xw
    dry_standard = 101325.0 * mass / (_compressibility(15.0, 101325.0, 0.0) * gas * 288.15)
    water_standard = 1333.0 * water / (_compressibility(20.0, 1333.0, 1.0) * gas * 293.15)
    return dry * (dry_density / dry_standard) + vapour * (water_density / water_standard)
