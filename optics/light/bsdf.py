r"""BSDF of surfaces and their total integrated scatter (TIS): roughness and dust.

Design programs use the same letters for different quantities; here (Stover, *Optical Scattering*, 3rd ed.; Pfisterer,
"Approximated scatter models for stray light analysis", Optics & Photonics News 22 (10), 16, 2011), with
:math:`\Delta\beta` the difference of the sines of scatter and specular angle:

.. math::

   \text{Harvey-Shack:} \; b_0 [1 + (\Delta\beta / l)^2]^{s/2}, \qquad
   \text{ABg:} \; A / (B + \Delta\beta^g) \qquad [1/\mathrm{sr}]

TIS is the integral of BSDF times cosine over the hemisphere at normal incidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf, hyp2f1, j1

from optics.arrays import FloatArray
from optics.errors import DomainError

SLOPE = 0.926
"""Of the logarithm of the number of particles over log^2 of their size (IEST-STD-CC1246)."""
REFERENCE_MM2 = 1e5
"""0.1 m^2, the area that the standard counts particles on."""


def _positive(**numbers: float) -> None:
    for name, value in numbers.items():
        if not 0.0 < value < math.inf:
            raise DomainError(f"{name} = {value:g}; it must be positive")


def roughness_tis(
    sigma_nm: ArrayLike,
    wavelength_nm: ArrayLike,
    n_before: ArrayLike,
    n_after: ArrayLike,
    cos_incidence: ArrayLike = 1.0,
) -> FloatArray:
    r"""TIS of a smooth surface, :math:`(2 \pi \sigma (n' \cos i' - n \cos i) / \lambda)^2`.

    ``sigma_nm`` is the RMS roughness in the band of spatial frequencies that scatter; ``n_after = -n_before`` is a
    mirror. All broadcast. `DomainError` above 0.3, where the law no longer holds.
    """
    sigma, wave, n1, n2, cosine = (
        np.asarray(v, dtype=np.float64) for v in (sigma_nm, wavelength_nm, n_before, n_after, cos_incidence)
    )
    if (sigma < 0.0).any() or (wave <= 0.0).any():
        raise DomainError("roughness must not be negative [nm], and wavelengths be positive [nm]")
    behind = np.sign(n2) * np.sqrt(np.maximum(n2**2 - n1**2 * (1.0 - cosine**2), 0.0))
    tis = np.asarray((2.0 * np.pi * sigma * (behind - n1 * cosine) / wave) ** 2)
    if (tis > 0.3).any():
        raise DomainError(f"a surface that scatters {tis.max():.3g} of the light is not smooth; at most 0.3")
    return tis


def lens_scatter(lens: Any, sigma_nm: float, wavelength_nm: float) -> float:
    """Fraction of the light along the axis that the surfaces of a `LensSystem` scatter, all equally rough."""
    lens.check_surfaces()
    index = lens.indices(wavelength_nm)
    sign = np.array([-1.0 if surface.mirror else 1.0 for surface in lens.surfaces])
    return float(roughness_tis(sigma_nm, wavelength_nm, index[:-1], sign * index[1:]).sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class HarveyShack:
    """Angular law of polished surfaces."""

    b0: float  # BSDF at the specular direction [1/sr]
    shoulder: float  # l, the difference of sines where it begins to fall
    slope: float  # s, negative: its power beyond

    def __post_init__(self) -> None:
        _positive(b0=self.b0, shoulder=self.shoulder, minus_slope=-self.slope)

    def bsdf(self, sine_difference: ArrayLike) -> FloatArray:
        """BSDF [1/sr] at differences of sines."""
        ratio = np.asarray(sine_difference, dtype=np.float64) / self.shoulder
        return np.asarray(self.b0 * (1.0 + ratio**2) ** (0.5 * self.slope))

    @property
    def tis(self) -> float:
        """2 pi b0 l^2 [(1 + 1 / l^2)^(s / 2 + 1) - 1] / (s + 2), for s = -2 its limit."""
        power, log = 0.5 * self.slope + 1.0, math.log1p(self.shoulder**-2)
        integral = log if power == 0.0 else math.expm1(power * log) / power
        return math.pi * self.b0 * self.shoulder**2 * integral


@dataclass(frozen=True, slots=True, kw_only=True)
class ABg:
    """Angular law A / (B + x^g); all three positive."""

    a: float
    b: float
    g: float

    def __post_init__(self) -> None:
        _positive(a=self.a, b=self.b, g=self.g)

    def bsdf(self, sine_difference: ArrayLike) -> FloatArray:
        """BSDF [1/sr] at differences of sines."""
        return np.asarray(self.a / (self.b + np.abs(np.asarray(sine_difference, dtype=np.float64)) ** self.g))

    @property
    def tis(self) -> float:
        """pi A / B 2F1(1, 2 / g; 1 + 2 / g; -1 / B); pi A ln(1 + 1 / B) for g = 2."""
        order = 2.0 / self.g
        return float(math.pi * self.a / self.b * hyp2f1(1.0, order, 1.0 + order, -1.0 / self.b))


def polished(tis: float, shoulder: float, slope: float) -> HarveyShack:
    """The Harvey-Shack law of a surface that scatters a fraction ``tis`` of its light."""
    unit = HarveyShack(b0=1.0, shoulder=shoulder, slope=slope)
    return HarveyShack(b0=tis / unit.tis, shoulder=shoulder, slope=slope)


def particles_per_mm2(level: float, size_um: ArrayLike) -> FloatArray:
    """Particles of at least a size on a surface of a cleanliness level, 10^(0.926 (log^2 L - log^2 x)) on 0.1 m^2.

    IEST-STD-CC1246 (Borson, CleanRooms, August 2005); ``size_um`` from 1 um to the level, which is the size of the
    largest particle on 0.1 m^2. Raises DomainError outside.
    """
    size = np.asarray(size_um, dtype=np.float64)
    if not 1.0 <= level <= 5000.0:
        raise DomainError(f"cleanliness level {level:g} is outside 1 ... 5000")
    if not ((size >= 1.0) & (size <= level)).all():
        raise DomainError(f"particle sizes must lie between 1 um and the level, {level:g} um")
    return np.asarray(10.0 ** (SLOPE * (math.log10(level) ** 2 - np.log10(size) ** 2)) / REFERENCE_MM2)


def area_coverage(level: float) -> float:
    r"""Fraction of a surface covered by particles of a cleanliness level; twice that is lost from the beam.

    The integral of the distribution over disks as wide as the particles from 1 um to the level L [um], 1 to 5000, with
    :math:`a = 0.926 / \ln 10`, :math:`u = \ln x`:

    .. math:: \int_0^U \frac{\pi}{4} e^{2 u} \, 2 a u \, e^{a (U^2 - u^2)} \, du

    Fibres cover less than disks of the same diameter. The largest particle is a separate term.
    """
    count = float(particles_per_mm2(level, 1.0))
    a, end = SLOPE / math.log(10.0), math.log(level)
    centre, root = 1.0 / a, math.sqrt(a)
    # e^(2u - a u^2) = e^(1/a) e^(-a (u - 1/a)^2); by parts 2 a u e^(2u - a u^2) = 2 e^(...) - d/du e^(...)
    area = math.exp(centre) * math.sqrt(math.pi) / root * (erf(root * (end - centre)) + erf(root * centre))
    area -= math.exp(2.0 * end - a * end**2) - 1.0
    largest = math.exp(2.0 * end) / REFERENCE_MM2
    return float(0.25 * math.pi * 1e-6 * (count * area + largest))


SIZES = 400
"""Of particles, evenly in the logarithm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Particles:
    r"""Angular law of dust: opaque disks that diffract and scatter a fraction of the intercepted light forwards.

    .. math:: \int n(D) \left( \frac{\pi D^2}{4 \lambda} \right)^2 \left( \frac{2 J_1(x)}{x} \right)^2 dD
              + \frac{g\, C}{\pi}, \qquad x = \pi D \Delta\beta / \lambda

    with the coverage C (`area_coverage`). The first term integrates to C; rings of disks of one size are not resolved.
    """

    level: float  # Cleanliness level (IEST-STD-CC1246) [um], 1 to 5000
    wavelength_nm: float
    # g, fraction of the intercepted light that is scattered forwards as by a Lambertian sheet: an assumption
    forward: float = 0.5

    def __post_init__(self) -> None:
        _positive(wavelength_nm=self.wavelength_nm)
        particles_per_mm2(self.level, 1.0)
        if not 0.0 <= self.forward <= 1.0:
            raise DomainError(f"forward = {self.forward:g}; the forward-scattered fraction must lie in 0 ... 1")

    def bsdf(self, sine_difference: ArrayLike) -> FloatArray:
        """BSDF [1/sr] at differences of sines."""
        delta = np.abs(np.asarray(sine_difference, dtype=np.float64))
        edges = np.geomspace(1.0, max(self.level, 1.0), SIZES + 1)
        counts = particles_per_mm2(self.level, edges)
        number = np.append(counts[:-1] - counts[1:], counts[-1])  # the last one is the largest size
        size_mm = 1e-3 * np.append(np.sqrt(edges[:-1] * edges[1:]), edges[-1])
        wave_mm = 1e-6 * self.wavelength_nm
        peak = number * (0.25 * math.pi * size_mm**2 / wave_mm) ** 2
        knots = np.concatenate([[0.0], np.geomspace(1e-7, 4.0, 1200)])
        x = np.maximum(math.pi * size_mm * knots[:, None] / wave_mm, 1e-9)
        # beyond the second ring the mean of the rings: J1^2 -> 1 / (pi x)
        airy = np.where(x < 7.0156, (2.0 * j1(x) / x) ** 2, 4.0 / (math.pi * x**3))
        log_bsdf = np.log(airy @ peak)
        diffracted = np.exp(
            np.interp(np.log(np.maximum(delta, 1e-7)), np.log(np.maximum(knots[1:], 1e-7)), log_bsdf[1:])
        )
        diffracted = np.where(delta < 1e-7, math.exp(log_bsdf[0]), diffracted)
        return np.asarray(diffracted + self.forward * area_coverage(self.level) / math.pi)

    @property
    def tis(self) -> float:
        """Scattered in all, (1 + g) C; the covered fraction C is lost from the beam in addition to diffracted light."""
        return (1.0 + self.forward) * area_coverage(self.level)


@dataclass(frozen=True, slots=True, kw_only=True)
class SummedScatter:
    """Laws of many surfaces in sequence; small scatter adds up."""

    laws: tuple[HarveyShack | ABg | Particles, ...]

    def bsdf(self, sine_difference: ArrayLike) -> FloatArray:
        """BSDF [1/sr] at differences of sines."""
        return np.asarray(sum(law.bsdf(sine_difference) for law in self.laws))

    @property
    def tis(self) -> float:
        """Scattered by all."""
        return sum(law.tis for law in self.laws)
