"""Displacement damage of a detector in space: hot pixels.

A particle that displaces atoms in the depleted volume leaves a centre that generates dark current. The number of
centres per pixel is a Poisson variate, the dark current of each is exponentially distributed (Virmontois et al. 2012,
IEEE Trans. Nucl. Sci. 59, 927; Belloir et al. 2016, Opt. Express 24, 4299):

    centres per pixel = gamma V D,   mean dark current of a centre = K(T, t) / gamma

with the depleted volume V and the displacement damage dose D (fluence times non-ionising energy loss). K is the
universal damage factor of silicon (Srour & Lo 2000, IEEE Trans. Nucl. Sci. 47, 2451): 1.9e5 e-/s per cm^3 and MeV/g at
300 K one week after the irradiation; the mean increase K V D does not depend on gamma. Dark current by ionising dose at
interfaces and random telegraph signals are neglected.
"""

from __future__ import annotations

import math
from dataclasses import replace

from scipy import constants

from optics.errors import DomainError
from render.detector.spec import Detector

GAMMA_PER_UM3 = 0.097179425484859 / 4100.0
"""Centres per um^3 and TeV/g (Belloir et al. 2016, as their authors hold it in Pyxel's ``dark_current_induced``)."""

_DAMAGE_FACTOR = 0.19  # e-/s per um^3 and TeV/g
_FACTOR_K = 300.0
_ACTIVATION_EV = 0.63  # Srour & Lo 2000: the centres lie in the middle of the gap
_WEEK_S = 7 * 86400.0
_ANNEALED_S = (1e4, 5e6)
_MOST_CENTRES = 1000.0


def damage_factor(temperature_c: float, *, annealed_s: float = _WEEK_S) -> float:
    """Universal damage factor K of silicon: dark current [e-/s] per depleted volume [um^3] and dose [TeV/g].

    Time since the irradiation at room temperature: Srour & Lo's curve, between 1e4 and 5e6 s linear in its logarithm
    (fit of Pyxel's ``dark_current_induced``). For a dose that is spread over years take the end of the range.
    """
    if not -100.0 <= temperature_c <= 100.0:
        raise DomainError(f"temperature_c = {temperature_c:g} C; it must be -100 to 100 C")
    if not _ANNEALED_S[0] <= annealed_s <= _ANNEALED_S[1]:
        raise DomainError(f"annealed_s = {annealed_s:g} s; it must be {_ANNEALED_S[0]:g} to {_ANNEALED_S[1]:g} s")
    annealing = (3.5948 - 0.3965 * math.log10(annealed_s)) / 1.3024
    kelvin = temperature_c + constants.zero_Celsius
    barrier = _ACTIVATION_EV * constants.e / constants.k
    return _DAMAGE_FACTOR * annealing * math.exp(barrier * (1.0 / _FACTOR_K - 1.0 / kelvin))


def aged(
    detector: Detector,
    *,
    displacement_dose_tev_per_g: float,
    depleted_volume_um3: float,
    temperature_c: float | None = None,
    annealed_s: float = _WEEK_S,
) -> Detector:
    """The new detector after a displacement damage dose D in a depleted volume V per pixel.

    Which pixels are hit follows from its ``sensor_seed``; with more dose they stay hit, and others join them. The dark
    current is right at ``temperature_c`` (the detector's reference by default); at others it follows the detector's
    doubling, which is not that of these centres (0.63 eV: 8.5 K at 300 K). Pixels whose centres give more than the
    detector's ``damage_known_e_per_s`` are in the map of defects.
    """
    for name, value, unit in (
        ("displacement_dose_tev_per_g", displacement_dose_tev_per_g, "TeV/g"),
        ("depleted_volume_um3", depleted_volume_um3, "um3"),
    ):
        if not 0.0 <= value < math.inf:
            raise DomainError(f"{name} = {value:g} {unit}; it must be finite and not negative")
    if detector.damage_centres_per_px > 0:
        raise DomainError(f"detector {detector.name!r} is already aged; apply the total dose to the new detector")
    centres = GAMMA_PER_UM3 * depleted_volume_um3 * displacement_dose_tev_per_g
    if centres > _MOST_CENTRES:
        raise DomainError(f"{centres:.4g} damage centres per pixel; the model is valid up to {_MOST_CENTRES:g}")
    temperature_c = detector.dark_reference_c if temperature_c is None else temperature_c
    each = damage_factor(temperature_c, annealed_s=annealed_s) / GAMMA_PER_UM3
    return replace(
        detector,
        name=f"{detector.name}, {displacement_dose_tev_per_g:g} TeV/g",
        damage_centres_per_px=centres,
        damage_dark_e_per_s=each / detector.dark_factor(temperature_c),
    )
