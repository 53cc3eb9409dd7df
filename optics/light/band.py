"""Filter bands and the wavelengths at which to sample them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze_alike
from optics.response import Curve


@runtime_checkable
class Band(Protocol):
    """A filter: transmission over wavelength, zero outside its breakpoints."""

    @property
    def name(self) -> str:
        """Name in tables and messages."""
        ...

    @property
    def breakpoints_nm(self) -> FloatArray:
        """Wavelengths between which the transmission is smooth [nm], increasing; the first and last end the band."""
        ...

    def transmission(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Fraction let through at each wavelength [nm]."""
        ...


def _finite_wavelength(wavelength_nm: ArrayLike, name: str) -> FloatArray:
    wave = np.asarray(wavelength_nm, dtype=np.float64)
    if np.isnan(wave).any():
        raise DomainError(f"band {name!r}: a wavelength is NaN; wavelengths in nm are needed")
    return wave


@dataclass(frozen=True, slots=True, kw_only=True)
class TopHat:
    """Flat top with straight edges (a trapezoid).

    Attributes
    ----------
    centre_nm : float
        Middle of the band [nm].
    width_nm : float
        Full width at half maximum [nm].
    edge_nm : float
        Length of each edge, from no transmission to the top [nm]; 0.8 of it lies between 10 % and 90 %, the usual
        specification of an edge. 0 is a step.
    peak : float
        Transmission of the top, above 0, at most 1.
    name : str
        Centre and width if left out.

    Raises
    ------
    DomainError
        Width not positive, edge negative or longer than the width, peak outside 0 ... 1, band reaching 0 nm, NaN.
    """

    centre_nm: float
    width_nm: float
    edge_nm: float = 0.0
    peak: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", f"{self.centre_nm:g}/{self.width_nm:g}")
        title = f"band {self.name!r}"
        if not (math.isfinite(self.centre_nm) and math.isfinite(self.width_nm) and self.width_nm > 0.0):
            raise DomainError(
                f"{title}: centre {self.centre_nm:g} nm, width {self.width_nm:g} nm; a positive width is needed"
            )
        if not 0.0 <= self.edge_nm <= self.width_nm:
            raise DomainError(f"{title}: edge {self.edge_nm:g} nm is outside 0 ... {self.width_nm:g} nm, its width")
        if not 0.0 < self.peak <= 1.0:
            raise DomainError(f"{title}: peak transmission {self.peak:g} is outside 0 ... 1 (0 excluded)")
        if not self.centre_nm - 0.5 * (self.width_nm + self.edge_nm) > 0.0:
            raise DomainError(f"{title}: it reaches below 0 nm; raise the centre or narrow the band")

    @property
    def breakpoints_nm(self) -> FloatArray:
        """Feet and shoulders of the trapezoid [nm]."""
        half, edge = 0.5 * self.width_nm, 0.5 * self.edge_nm
        corners = self.centre_nm + np.array([-half - edge, -half + edge, half - edge, half + edge])
        return np.unique(corners)

    def transmission(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Fraction let through at wavelengths [nm] of any shape; a step counts as inside; DomainError on NaN."""
        inside = 0.5 * self.width_nm - np.abs(_finite_wavelength(wavelength_nm, self.name) - self.centre_nm)
        if self.edge_nm == 0.0:
            return np.where(inside >= 0.0, self.peak, 0.0)
        return self.peak * np.clip(inside / self.edge_nm + 0.5, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TabulatedBand(Curve):
    """A measured filter curve, linear between its points and zero outside them.

    Attributes
    ----------
    name, source : str
        What it is and where it comes from.
    wavelength_nm : (n,)
        Increasing wavelengths [nm].
    value : (n,)
        Transmission, 0 ... 1.

    Raises
    ------
    DomainError
        Unequal lengths, NaN, wavelengths not increasing, values outside 0 ... 1, opaque everywhere.
    ConfigError
        No source.
    """

    noun: ClassVar[str] = "band"

    def __post_init__(self) -> None:
        Curve.__post_init__(self)
        if not self.value.any():
            raise DomainError(f"{self.title} is opaque everywhere")

    @property
    def breakpoints_nm(self) -> FloatArray:
        """The tabulated wavelengths, without points on either side that only repeat zero."""
        lit = np.flatnonzero(self.value)
        return self.wavelength_nm[max(lit[0] - 1, 0) : lit[-1] + 2]

    def transmission(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Fraction let through at wavelengths [nm] of any shape, 0 outside the table; DomainError on NaN."""
        wave = _finite_wavelength(wavelength_nm, self.name)
        return np.asarray(np.interp(wave, self.wavelength_nm, self.value, left=0.0, right=0.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BandNodes:
    """Quadrature over bands: ``f`` times a filter integrates to ``sum(f(wavelength) * weight * transmission)``."""

    name: tuple[str, ...]  # (b,) Bands
    wavelength_nm: FloatArray  # (b, k) Nodes [nm]
    weight_nm: FloatArray  # (b, k) Weights [nm], without the transmission of the filter
    transmission: FloatArray  # (b, k) Transmission of the filter at the nodes

    def __post_init__(self) -> None:
        shape = (len(self.name), "k")
        freeze_alike(self, "wavelength_nm", "weight_nm", "transmission", shape=shape)

    def integrate(self, values: ArrayLike) -> FloatArray:
        """Integral over each band of values (..., b, k) at the nodes."""
        return np.asarray((np.asarray(values) * self.weight_nm * self.transmission).sum(axis=-1))


def band_nodes(bands: Sequence[Band], count: int) -> BandNodes:
    """Wavelengths and weights that integrate smooth functions over bands.

    Each band gets the Gaussian rule that has its own transmission as weight function, so that polynomials of degree
    ``2 count - 1`` times the band are integrated exactly, edges included. For a step band that is Gauss-Legendre;
    otherwise the rule comes from the discrete Stieltjes procedure (Gautschi, *Orthogonal Polynomials*, 2004, sec. 2.2)
    on Gauss-Legendre pieces between the breakpoints.

    Parameters
    ----------
    bands : sequence of Band
        At least one.
    count : int
        Nodes per band, k.

    Returns
    -------
    BandNodes
        b bands, k nodes each, increasing in wavelength.

    Raises
    ------
    ConfigError
        No band.
    DomainError
        Less than one node, or a band with a gap into which a node falls.
    """
    if not bands:
        raise ConfigError("no band is given; at least one filter is needed")
    if count < 1:
        raise DomainError(f"{count} nodes per band; at least 1 is needed")
    rules = [_gauss_of_curve(band, count) for band in bands]
    return BandNodes(
        name=tuple(band.name for band in bands),
        wavelength_nm=np.stack([wave for wave, _ in rules]),
        weight_nm=np.stack([weight for _, weight in rules]),
        transmission=np.stack([band.transmission(wave) for band, (wave, _) in zip(bands, rules, strict=True)]),
    )


def piecewise_nodes(edges_nm: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights [nm], ``order`` of them on every piece between increasing ``edges_nm``."""
    x, w = np.polynomial.legendre.leggauss(order)
    middle, half = 0.5 * (edges_nm[1:] + edges_nm[:-1]), 0.5 * np.diff(edges_nm)
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * w).ravel()


def _gauss_of_curve(band: Band, count: int) -> tuple[FloatArray, FloatArray]:
    """Gaussian rule whose weight function is the transmission; the weights are divided by it."""
    edges = band.breakpoints_nm
    # the curve is linear on a piece, so `count + 1` points make the discrete measure exact for degree 2 count
    wave, weight = piecewise_nodes(edges, count + 1)
    mass = weight * band.transmission(wave)
    centre, half = 0.5 * (edges[0] + edges[-1]), 0.5 * (edges[-1] - edges[0])
    x = (wave - centre) / half
    alpha, beta = np.zeros(count), np.zeros(count)
    previous, polynomial, previous_norm = np.zeros_like(x), np.ones_like(x), 1.0
    for j in range(count):
        norm = float(mass @ (polynomial * polynomial))
        alpha[j] = float(mass @ (x * polynomial * polynomial)) / norm
        beta[j] = norm / previous_norm if j else norm
        previous, polynomial = polynomial, (x - alpha[j]) * polynomial - (beta[j] if j else 0.0) * previous
        previous_norm = norm
    jacobi = np.diag(alpha) + np.diag(np.sqrt(beta[1:]), 1) + np.diag(np.sqrt(beta[1:]), -1)
    nodes, vectors = np.linalg.eigh(jacobi)
    node_nm = centre + half * nodes
    transmission = band.transmission(node_nm)
    if not (transmission > 0.0).all():
        gap = node_nm[np.argmin(transmission)]
        raise DomainError(
            f"band {band.name!r} is opaque at {gap:g} nm, where one of {count} nodes falls; split it in two bands"
        )
    return node_nm, mass.sum() * vectors[0] ** 2 / transmission
