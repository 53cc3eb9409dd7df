r"""Transmission of a lens along its axis: reflection at every surface, absorption in every glass.

.. math:: T(\lambda) = \prod_{surfaces} T_i \prod_{glasses} \tau_j^{d_j / d_{j,0}}

Light reflected twice is not included; it forms ghosts outside the star's image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.glass.catalogue import Glass
from optics.glass.coating import BARE, Coating
from optics.records import freeze
from optics.response import Response


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxialLayout:
    """Surfaces and media along the axis."""

    media: tuple[Glass | None, ...]  # Medium behind each surface, None for air; in front of the first surface is air
    thickness_mm: FloatArray  # (n,) Axial length of each of these media; behind the last surface it is not used
    coatings: tuple[Coating | None, ...] = ()  # Of each surface; None, or an empty tuple: not stated
    mirrors: tuple[bool, ...] = ()  # Whether each surface reflects; an empty tuple: lenses only

    def __post_init__(self) -> None:
        thickness = freeze(self, "thickness_mm", shape=("n",), sizes={"n": len(self.media)})
        if (thickness < 0).any():
            raise DomainError(f"layout: thickness {thickness.min():g} mm is negative")

    @property
    def slabs(self) -> Iterator[tuple[Glass, float]]:
        """Each glass with its axial thickness [mm]."""
        pairs = zip(self.media, self.thickness_mm, strict=True)
        return ((glass, float(thickness)) for glass, thickness in pairs if glass is not None)


def axial_layout(lens: Any) -> AxialLayout:
    """Axial layout of a `optics.lens.system.LensSystem`: distances between vertices, media by name."""
    try:
        vertices = np.array([surface.position_mm for surface in lens.surfaces] + [lens.image_position_mm])
        media = tuple(lens.glasses.get(surface.medium) for surface in lens.surfaces)
    except AttributeError:
        raise ConfigError(f"a lens or a layout is needed, got {type(lens).__name__}") from None
    return AxialLayout(
        media=media,
        thickness_mm=np.linalg.norm(np.diff(vertices, axis=0), axis=1),
        coatings=tuple(surface.coating for surface in lens.surfaces),
        mirrors=tuple(surface.mirror for surface in lens.surfaces),
    )


def lens_transmission(
    lens: Any, wavelength_nm: ArrayLike, *, coating: Coating | None = None, absorption: bool = True
) -> FloatArray:
    """Axial transmission of a lens: its stated throughput, else surfaces and glasses.

    Parameters
    ----------
    lens : LensSystem or AxialLayout
        The lens.
    wavelength_nm : array_like
        Wavelengths [nm], any shape.
    coating : Coating, optional
        On every air-glass surface for which the lens states none; bare glass if left out. Cemented surfaces have none
        but what the lens states; mirrors without a coating reflect everything.
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
    layout = lens if isinstance(lens, AxialLayout) else axial_layout(lens)
    wave = np.asarray(wavelength_nm, dtype=np.float64)
    transmission = np.ones_like(wave)
    before: Glass | None = None
    for number, after in enumerate(layout.media):
        stated = layout.coatings[number] if layout.coatings else None
        index = [1.0 if glass is None else glass.index(wave) for glass in (before, after)]
        if layout.mirrors and layout.mirrors[number]:
            transmission = transmission if stated is None else transmission * stated.split(wave, *index).reflectance
        elif before is not after:
            default = coating if before is None or after is None else None
            transmission = transmission * (stated or default or BARE).split(wave, *index).transmittance
        before = after
    if absorption:
        for glass, thickness in layout.slabs:
            transmission = transmission * glass.internal_transmittance(wave, thickness)
    return transmission
