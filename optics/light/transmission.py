r"""How much light a lens lets through along its axis: reflections at every surface, absorption in every glass.

.. math:: T(\lambda) = \prod_{surfaces} (1 - R_i) \prod_{glasses} \tau_j^{d_j / d_{j,0}}

Light reflected twice is not followed here (it lands as a ghost, not in the image of the star).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.glass.catalogue import Glass, get_glass
from optics.records import freeze
from optics.response import Response

__all__ = [
    "Coating",
    "Layout",
    "QuarterWave",
    "TabulatedCoating",
    "Uncoated",
    "fresnel",
    "layout_of",
    "lens_transmission",
]


def fresnel(n_before: ArrayLike, n_after: ArrayLike) -> FloatArray:
    """Reflectance of a bare interface at normal incidence, ``((n1 - n2) / (n1 + n2))^2``."""
    first, second = np.asarray(n_before, dtype=np.float64), np.asarray(n_after, dtype=np.float64)
    return np.asarray(((first - second) / (first + second)) ** 2)


class Coating(Protocol):
    """What is on an air-glass surface."""

    def reflectance(self, wavelength_nm: FloatArray, index: FloatArray) -> FloatArray:
        """Residual reflectance at normal incidence on glass of that index, in air."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncoated:
    """Bare glass."""

    def reflectance(self, wavelength_nm: FloatArray, index: FloatArray) -> FloatArray:
        """Fresnel reflectance; shapes as the arguments."""
        return fresnel(1.0, index)


@dataclass(frozen=True, slots=True, kw_only=True)
class QuarterWave:
    r"""One film, a quarter of the design wavelength thick; magnesium fluoride unless another material is given.

    With :math:`\delta = \frac{\pi}{2} \frac{n(\lambda) \lambda_0}{n(\lambda_0) \lambda}` (Macleod, *Thin-Film Optical
    Filters*, 4th ed., sec. 2.6, characteristic matrix at normal incidence). The index of the bulk crystal stands for
    that of the evaporated film.

    Attributes
    ----------
    design_wavelength_nm : float
        Wavelength of least reflectance [nm].
    film : Glass
        Material of the film.

    Raises
    ------
    DomainError
        Design wavelength outside the range of the material.
    """

    design_wavelength_nm: float = 550.0
    film: Glass = field(default_factory=lambda: get_glass("MgF2"))

    def __post_init__(self) -> None:
        self.film.index(self.design_wavelength_nm)

    def reflectance(self, wavelength_nm: FloatArray, index: FloatArray) -> FloatArray:
        """Residual reflectance; shapes as the arguments."""
        n = self.film.index(wavelength_nm)
        design = self.film.index(self.design_wavelength_nm)
        phase = 0.5 * math.pi * (n / design) * (self.design_wavelength_nm / wavelength_nm)
        front, inside = np.cos(phase) + 1j * index * np.sin(phase) / n, index * np.cos(phase) + 1j * n * np.sin(phase)
        return np.asarray(np.abs((front - inside) / (front + inside)) ** 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class TabulatedCoating:
    """Residual reflectance as measured or specified, whatever the glass underneath.

    Attributes
    ----------
    curve : Response
        Reflectance over wavelength, with its source.
    """

    curve: Response

    def reflectance(self, wavelength_nm: FloatArray, index: FloatArray) -> FloatArray:
        """Interpolated reflectance; shapes as the arguments."""
        return self.curve.interpolate(wavelength_nm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """What light meets along the axis."""

    media: tuple[Glass | None, ...]  # Medium behind each surface, None for air; in front of the first surface is air
    thickness_mm: FloatArray  # (n,) Axial length of each of these media; that behind the last surface is not used

    def __post_init__(self) -> None:
        thickness = freeze(self, "thickness_mm", shape=("n",), sizes={"n": len(self.media)})
        if (thickness < 0).any():
            raise DomainError(f"layout: thickness {thickness.min():g} mm is negative")

    @property
    def slabs(self) -> Iterator[tuple[Glass, float]]:
        """Each glass with its axial thickness [mm]."""
        pairs = zip(self.media, self.thickness_mm, strict=True)
        return ((glass, float(thickness)) for glass, thickness in pairs if glass is not None)


def layout_of(lens: Any) -> Layout:
    """Axial layout of a `optics.lens.system.LensSystem`: distances between vertices, media by name."""
    try:
        vertices = np.array([surface.position_mm for surface in lens.surfaces] + [lens.image_position_mm])
        media = tuple(lens.glasses.get(surface.medium) for surface in lens.surfaces)
    except AttributeError:
        raise ConfigError(f"a lens or a layout is needed, got {type(lens).__name__}") from None
    return Layout(media=media, thickness_mm=np.linalg.norm(np.diff(vertices, axis=0), axis=1))


def lens_transmission(
    lens: Any, wavelength_nm: ArrayLike, *, coating: Coating | None = None, absorption: bool = True
) -> FloatArray:
    """Transmission of a lens along its axis: its own throughput where it has one, else of surfaces and glasses.

    Parameters
    ----------
    lens : LensSystem or Layout
        What light passes.
    wavelength_nm : array_like
        Wavelengths [nm], any shape.
    coating : Coating, optional
        On every air-glass surface; bare glass if left out. Cemented surfaces have none.
    absorption : bool
        Whether to count absorption in the glass; needs the internal transmittance of every glass.

    Returns
    -------
    numpy.ndarray
        Fraction, 0 ... 1, the same shape.

    Raises
    ------
    ConfigError
        Neither a lens nor a layout.
    DomainError
        Wavelength outside the range of a glass, its transmittance table or the coating; a glass without such a table.
    """
    throughput: Response | None = getattr(lens, "throughput", None)
    if throughput is not None:
        return throughput.interpolate(wavelength_nm)
    layout = lens if isinstance(lens, Layout) else layout_of(lens)
    film: Coating = Uncoated() if coating is None else coating
    wave = np.asarray(wavelength_nm, dtype=np.float64)
    through = np.ones_like(wave)
    before: Glass | None = None
    for after in layout.media:
        through = through * (1.0 - _reflectance(before, after, wave, film))
        before = after
    if absorption:
        for glass, thickness in layout.slabs:
            through = through * glass.internal_transmittance(wave, thickness)
    return through


def _reflectance(before: Glass | None, after: Glass | None, wave: FloatArray, film: Coating) -> FloatArray:
    if before is None and after is None:
        return np.zeros_like(wave)
    if before is not None and after is not None:
        return fresnel(before.index(wave), after.index(wave))
    glass = before if after is None else after
    assert glass is not None
    return film.reflectance(wave, glass.index(wave))
