"""Temperatures of stars from their colours: effective temperature, and colour temperature (black body of the same
colour).

*Effective temperature* is a property of the star: the black body of the same radius and luminosity. Its Planck curve
does not have the star's colour: within 0.05 mag in BP-RP for dwarfs of 5100 to 5900 K, but 0.25 mag too red for an A
star, whose hydrogen absorbs, and 0.1, 0.2 and 0.4 mag too blue at K5, M0 and M2, where molecules do. *Colour
temperature* is that of the black body with the star's own BP-RP or B-V, reddening by dust included. A black body of the
BP-RP of a star has its G - V, too, within 0.02 mag for BP-RP from 0 to 2. A camera sees colours, so `render.sky.field`
renders with the colour temperature unless told otherwise.

Sources
-------
* Effective temperature against BP-RP and B-V: mean sequence of dwarfs of M. J. Pecaut and E. E. Mamajek, ApJS 208, 9
  (2013), table 5, continued by the authors (EEM_dwarf_UBVIJHK_colors_Teff, version 2024.05.15); colours free of
  reddening, so reddened stars are hotter than it says. Giants agree within 5 % by BP-RP (A. Mucciarelli et al., A&A
  653, A90 (2021), 0.33 to 1.81); by B-V they do to 1.3, but redder ones are hotter (Aldebaran by 15 %). BP-RP is that
  of DR2, within 0.02 mag of DR3.
* Colour temperature from BP-RP: synthetic photometry of Planck curves through the passbands of M. Riello et al., A&A
  649, A3 (2021); ``docs/make_blackbody_colours.py`` makes the table.
* Colour temperature from B-V: F. J. Ballesteros, EPL 97, 34008 (2012), eq. 14, black bodies with the passbands of
  Johnson:

  .. math:: T = 4600 \\left( \\frac{1}{0.92 (B-V) + 1.7} + \\frac{1}{0.92 (B-V) + 0.62} \\right)

  The same stars have by BP-RP 1.28 times this temperature for B-V below 0, 1.14 at 0.15, 1.02 to 1.04 from 0.3 to 1.4
  and 0.94 beyond (medians of 5000 stars to V = 6): spectra of stars are no Planck curves.
"""

from __future__ import annotations

import io
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError

if TYPE_CHECKING:
    from render.catalogue.record import StarCatalog


# Teff [K], B-V, BP-RP of dwarfs from O3 to M7; BP-RP is not tabulated before B9
_SEQUENCE = np.array(
    [
        (45900, -0.330, np.nan), (41400, -0.323, np.nan), (37900, -0.318, np.nan), (33300, -0.312, np.nan),
        (31400, -0.301, np.nan), (26000, -0.278, np.nan), (20600, -0.215, np.nan), (17000, -0.178, np.nan),
        (15700, -0.156, np.nan), (14000, -0.128, np.nan), (12300, -0.109, np.nan), (10700, -0.070, -0.120),
        (9700, 0.000, -0.037), (9300, 0.035, 0.005), (8840, 0.070, 0.068), (8600, 0.100, 0.110),
        (8250, 0.140, 0.166), (8100, 0.160, 0.194), (7910, 0.185, 0.222), (7760, 0.210, 0.263),
        (7590, 0.250, 0.320), (7220, 0.295, 0.377), (7020, 0.330, 0.434), (6820, 0.370, 0.490),
        (6670, 0.410, 0.546), (6550, 0.440, 0.587), (6350, 0.486, 0.640), (6180, 0.530, 0.694),
        (6050, 0.560, 0.719), (5930, 0.595, 0.784), (5860, 0.622, 0.803), (5770, 0.650, 0.823),
        (5660, 0.680, 0.850), (5550, 0.710, 0.880), (5480, 0.730, 0.900), (5380, 0.775, 0.950),
        (5290, 0.816, 0.983), (5170, 0.857, 1.010), (5100, 0.884, 1.100), (4870, 0.990, 1.190),
        (4600, 1.090, 1.340), (4440, 1.150, 1.430), (4300, 1.240, 1.530), (4090, 1.340, 1.700),
        (3930, 1.400, 1.790), (3850, 1.420, 1.840), (3660, 1.485, 2.090), (3560, 1.505, 2.230),
        (3430, 1.530, 2.500), (3210, 1.650, 2.940), (3060, 1.830, 3.350), (2810, 2.010, 4.160),
        (2680, 2.120, 4.650),
    ]
)  # fmt: skip
COLOUR_TEMPERATURE_RANGE_K = (1000.0, 60000.0)
"""What `colour_temperature` can say; bluer and redder stars get the ends."""
B_V_RANGE_MAG = (-0.4, 4.0)
"""B-V to which the formula of Ballesteros is applied; at -0.4 a black body would be at 21 000 K."""
TYPICAL_TEMPERATURE_K = 4900.0
"""Median colour temperature of the stars brighter than G = 10, for the few without a colour."""


def _colours(bp_rp_mag: ArrayLike | None, b_v_mag: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    red = np.asarray(np.nan if bp_rp_mag is None else bp_rp_mag, np.float64)
    blue = np.asarray(np.nan if b_v_mag is None else b_v_mag, np.float64)
    both = np.broadcast_arrays(red, blue)
    return both[0], both[1]


def effective_temperature(bp_rp_mag: ArrayLike | None = None, b_v_mag: ArrayLike | None = None) -> FloatArray:
    """Effective temperature [K] of a star by its colour, from the mean sequence of dwarfs."""
    # bp_rp_mag, b_v_mag (n,) -> (n,)
    red, blue = _colours(bp_rp_mag, b_v_mag)
    log_t = np.log(_SEQUENCE[:, 0])
    tabulated = ~np.isnan(_SEQUENCE[:, 2])
    ends = {"left": np.nan, "right": np.nan}
    by_red = np.interp(red, _SEQUENCE[tabulated, 2], log_t[tabulated], **ends)
    by_blue = np.interp(blue, _SEQUENCE[:, 1], log_t, **ends)
    return np.asarray(np.exp(np.where(np.isnan(by_red), by_blue, by_red)))


@cache
def _blackbody_colours() -> tuple[FloatArray, FloatArray]:
    """BP-RP, increasing, and 1/T [1/K]."""
    text = files("render").joinpath("data", "blackbody_colours.csv").read_text(encoding="utf-8")
    table = np.loadtxt(io.StringIO(text), delimiter=",", skiprows=4)
    return table[:, 1], 1.0 / table[:, 0]


def colour_temperature(bp_rp_mag: ArrayLike | None = None, b_v_mag: ArrayLike | None = None) -> FloatArray:
    """Temperature [K] of the black body that has the colour of the star."""
    # bp_rp_mag, b_v_mag (n,) -> (n,)
    red, blue = _colours(bp_rp_mag, b_v_mag)
    colour, inverse = _blackbody_colours()
    by_red = 1.0 / np.interp(red, colour, inverse)  # NaN stays NaN
    scaled = 0.92 * np.clip(blue, *B_V_RANGE_MAG)
    by_blue = 4600.0 * (1.0 / (scaled + 1.7) + 1.0 / (scaled + 0.62))
    return np.asarray(np.where(np.isnan(by_red), by_blue, by_red))


def star_temperature(
    stars: StarCatalog, kind: Literal["colour", "effective"] = "colour", *, typical_k: float = TYPICAL_TEMPERATURE_K
) -> FloatArray:
    """Temperature (n,) [K] of the black body that stands for each star of a catalogue when it is rendered.

    ``kind``: the black body of the star's colour, or of its effective temperature; a star without the one gets the
    other. Stars that have neither get ``typical_k``.
    """
    if kind not in ("colour", "effective"):
        raise ConfigError(f"temperature = {kind!r}; 'colour' or 'effective' is needed")
    temperatures = (colour_temperature(stars.bp_rp_mag, stars.b_v_mag), stars.effective_temperature_k)
    first, second = temperatures if kind == "colour" else temperatures[::-1]
    kelvin = np.where(np.isnan(first), second, first)
    return np.where(np.isnan(kelvin), typical_k, kelvin)
