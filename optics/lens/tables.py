"""Tables of a lens file with all allowed keys, validated without geometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, fields
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_type_hints

import numpy as np
from pydantic import (
    BaseModel,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    create_model,
    model_validator,
)

from optics.errors import ConfigError, DomainError
from optics.glass.air import STANDARD_PRESSURE_HPA
from optics.glass.catalogue import Glass
from optics.glass.coating import BARE, Coating, Film, QuarterWave, Stack, TabulatedCoating
from optics.lens.apertures import APERTURES, Aperture
from optics.lens.shapes.base import Shape
from optics.lens.shapes.registry import SHAPES, UNNAMED
from optics.validate import Positive, StrictTable

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Expansion = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Length = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
"""[mm]; more than a kilometre is a typing error."""
Two = tuple[FiniteFloat, FiniteFloat]
Three = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

MIRROR = "mirror"
UNCOATED = "bare"
"""Name of no coating."""
BREAK: Final = "coordinate_break"
"""Kind of a table that only moves the frame."""


class MovedTable(StrictTable):
    """A shift and a turn of a frame.

    ``tilt_deg`` are right-handed rotations about x, y (and z): with ``axes = "fixed"`` in this order about the axes of
    the frame before, with ``"moving"`` about x, then the turned y, then the turned z. ``first = "decentre"`` shifts
    along the axes before the turn, ``"tilt"`` along those after it.
    """

    decentre_mm: tuple[Length, Length] | tuple[Length, Length, Length] = (0.0, 0.0)
    tilt_deg: Two | Three = (0.0, 0.0)
    axes: Literal["fixed", "moving"] = "fixed"
    first: Literal["decentre", "tilt"] = "decentre"


class BreakTable(MovedTable):
    """A coordinate break: the frame of everything that follows."""

    kind: Literal["coordinate_break"] = BREAK
    thickness_mm: Length = 0.0


class ImageTable(MovedTable):
    """The image plane against the frame in which the last thickness ends."""


class StopTable(StrictTable):
    """A stop that is no surface of the list: a plane at ``z_mm`` in the lens frame."""

    z_mm: Length
    semi_diameter_mm: Positive = math.inf
    inner_semi_diameter_mm: NotNegative = 0.0


class PupilTable(StrictTable):
    """Opening of the stop, by the axial beam at the design wavelength."""

    f_number: Positive | None = None
    entrance_pupil_diameter_mm: Positive | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> PupilTable:
        if (self.f_number is None) == (self.entrance_pupil_diameter_mm is None):
            raise ValueError("[pupil] needs either f_number or entrance_pupil_diameter_mm")
        return self


class ErrorTable(StrictTable):
    """A measured deviation of a surface, in a file; see `optics.lens.sag_map.SagMap`."""

    file: Annotated[str, Field(min_length=1)]
    width_mm: tuple[Positive, Positive]
    unit: Literal["nm", "um", "mm"]
    scale: FiniteFloat = 1.0


def _keys(record: Any) -> dict[str, Any]:
    """Keys of a table that describes a record: its fields, their annotations the checks."""
    hints = get_type_hints(record, include_extras=True)
    keys: dict[str, Any] = {"kind": (Literal[record.kind], record.kind)}
    for field in fields(record):
        keys[field.name] = (hints[field.name], ... if field.default is MISSING else field.default)
    return keys


def _values(table: BaseModel, record: Any) -> dict[str, Any]:
    """Fields of a record by the keys of its table."""
    return {field.name: getattr(table, field.name) for field in fields(record)}


class ApertureTable(StrictTable):
    """An outline; its keys are the fields of its kind."""

    kind: str

    @model_validator(mode="after")
    def _it_exists(self) -> ApertureTable:
        self.aperture()
        return self

    def aperture(self) -> Aperture:
        """The outline that the table describes."""
        outline = next(kind for kind in APERTURES if kind.kind == self.kind)
        try:
            return outline(**_values(self, outline))
        except DomainError as error:
            raise ValueError(str(error)) from None


if TYPE_CHECKING:
    AnyAperture = ApertureTable
else:
    AnyAperture = Annotated[
        reduce(
            or_,
            (
                Annotated[create_model(f"{kind.__name__}Table", __base__=ApertureTable, **_keys(kind)), Tag(kind.kind)]
                for kind in APERTURES
            ),
        ),
        Discriminator("kind"),
    ]


class SurfaceTable(MovedTable):
    """Common keys of surfaces of any shape.

    Its shift and turn hold for this surface alone (``carry = "none"``), for all that follows too (``"forward"``), or
    are those of a mirror behind which the frame follows the reflected axis (``"bend"``). ``cte_per_k`` is the expansion
    of a mirror's substrate; ``coating`` names a table ``[coating.NAME]``, or is ``"bare"``.
    """

    kind: str
    thickness_mm: Length
    medium: str
    semi_diameter_mm: Positive = math.inf
    inner_semi_diameter_mm: NotNegative = 0.0
    element: str = ""
    stop: bool = False
    carry: Literal["none", "forward", "bend"] = "none"
    aperture: tuple[AnyAperture, ...] = ()
    error: ErrorTable | None = None
    cte_per_k: Expansion | None = None
    coating: str = ""

    @model_validator(mode="after")
    def _it_is_a_surface(self) -> SurfaceTable:
        self.shape()
        if self.carry == "bend" and self.medium != MIRROR:
            raise ValueError("carry = 'bend' needs medium = 'mirror'; use 'forward' for a surface that refracts")
        if self.cte_per_k is not None and self.medium != MIRROR:
            raise ValueError("cte_per_k needs medium = 'mirror'; a lens expands with its glass")
        return self

    def shape(self) -> Shape:
        """The shape that the table describes."""
        kind = next(shape for shape in SHAPES if shape.kind == self.kind)
        shape = kind(**_values(self, kind))
        return shape if "kind" in self.model_fields_set else shape.simplest()


def _kind_of(table: Any) -> Any:
    """Kind of a surface table, the default one if it names none."""
    return table.get("kind", UNNAMED.kind) if isinstance(table, dict) else getattr(table, "kind", UNNAMED.kind)


if TYPE_CHECKING:
    AnySurface = SurfaceTable | BreakTable
else:
    AnySurface = Annotated[
        reduce(
            or_,
            (
                Annotated[create_model(f"{kind.__name__}Table", __base__=SurfaceTable, **_keys(kind)), Tag(kind.kind)]
                for kind in SHAPES
            ),
        )
        | Annotated[BreakTable, Tag(BREAK)],
        Discriminator(_kind_of),
    ]


class GlassTable(StrictTable):
    """A glass that the built-in catalogue does not hold; keys as in `optics.glass.catalogue.glass_from_table`."""

    source: Annotated[str, Field(min_length=1)]
    maker: str = "generic"
    B: tuple[FiniteFloat, ...] | None = None
    C: tuple[FiniteFloat, ...] | None = None
    formula: str | None = None
    coefficients: tuple[FiniteFloat, ...] | None = None
    range_nm: tuple[Positive, Positive]
    reference_temperature_c: FiniteFloat = 20.0
    reference_pressure_hpa: NotNegative = STANDARD_PRESSURE_HPA
    dndt: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    dndt_range_c: Two | None = None
    cte_per_k: Expansion | None = None
    density_g_cm3: Positive | None = None
    nd: Positive | None = None
    vd: Positive | None = None
    transmittance_mm: Positive | None = None
    transmittance_nm: tuple[Positive, ...] | None = None
    transmittance: tuple[NotNegative, ...] | None = None


class FilmTable(StrictTable):
    """A thin film: a material of the glass catalogue, or an index."""

    thickness_nm: Positive
    material: str = ""
    index: NotNegative = 0.0
    extinction: NotNegative = 0.0


class StackTable(StrictTable):
    """Thin films, from the side of the lower index."""

    kind: Literal["stack"]
    source: Annotated[str, Field(min_length=1)]
    film: Annotated[tuple[FilmTable, ...], Field(min_length=1)]

    def coating(self, glass_of: Callable[[str], Glass]) -> Coating:
        """The coating that the table describes."""
        return Stack(
            films=tuple(
                Film(
                    thickness_nm=film.thickness_nm,
                    material=glass_of(film.material) if film.material else None,
                    index=film.index,
                    extinction=film.extinction,
                )
                for film in self.film
            )
        )


class QuarterWaveTable(StrictTable):
    """One film, a quarter of a wavelength thick."""

    kind: Literal["quarter_wave"]
    design_wavelength_nm: Positive
    material: str = "MgF2"

    def coating(self, glass_of: Callable[[str], Glass]) -> Coating:
        """The coating that the table describes."""
        return QuarterWave(design_wavelength_nm=self.design_wavelength_nm, film=glass_of(self.material))


Fractions = tuple[tuple[FiniteFloat, ...], ...]
"""A row for every angle, a value for every wavelength."""


class ReflectanceTable(StrictTable):
    """Measured or specified reflectance; ``reflectance`` and ``transmittance`` hold for s and p light alike."""

    kind: Literal["table"]
    source: Annotated[str, Field(min_length=1)]
    wavelength_nm: tuple[Positive, ...]
    angle_deg: tuple[NotNegative, ...] = (0.0,)
    reflectance: Fractions | None = None
    reflectance_s: Fractions | None = None
    reflectance_p: Fractions | None = None
    transmittance: Fractions | None = None
    transmittance_s: Fractions | None = None
    transmittance_p: Fractions | None = None

    @model_validator(mode="after")
    def _both_or_each(self) -> ReflectanceTable:
        for name in ("reflectance", "transmittance"):
            both, *each = (getattr(self, name + of) for of in ("", "_s", "_p"))
            if (both is not None and any(e is not None for e in each)) or (each[0] is None) != (each[1] is None):
                raise ValueError(f"give {name}, or {name}_s and {name}_p")
            if name == "reflectance" and both is None and each[0] is None:
                raise ValueError("reflectance is missing")
            for rows in (both, *each):
                shape = (len(self.angle_deg), len(self.wavelength_nm))
                if rows is not None and (len(rows) != shape[0] or any(len(row) != shape[1] for row in rows)):
                    raise ValueError(f"{name} needs {shape[0]} rows (angles) of {shape[1]} values (wavelengths)")
        return self

    def coating(self, glass_of: Callable[[str], Glass]) -> Coating:
        """The coating that the table describes."""
        of = {
            f"{name}_{light}": getattr(self, f"{name}_{light}") or getattr(self, name)
            for name in ("reflectance", "transmittance")
            for light in "sp"
        }
        return TabulatedCoating(
            source=self.source, wavelength_nm=np.array(self.wavelength_nm), angle_deg=np.array(self.angle_deg), **of
        )


CoatingTable = Annotated[StackTable | QuarterWaveTable | ReflectanceTable, Discriminator("kind")]


class Prescription(StrictTable):
    """Whole prescription file."""

    name: Annotated[str, Field(min_length=1)]
    source: Annotated[str, Field(min_length=1)]
    design_wavelength_nm: Positive
    max_field_deg: Annotated[float, Field(gt=0, lt=90)]
    stop: StopTable | None = None
    pupil: PupilTable | None = None
    surface: Annotated[tuple[AnySurface, ...], Field(min_length=1)]
    image: ImageTable = ImageTable()
    glass: dict[str, GlassTable] = Field(default_factory=dict)
    coating: dict[str, CoatingTable] = Field(default_factory=dict)
    default_coating: str = ""

    @model_validator(mode="after")
    def _one_stop(self) -> Prescription:
        stops = sum(isinstance(s, SurfaceTable) and s.stop for s in self.surface) + (self.stop is not None)
        if stops != 1:
            raise ValueError(f"{stops} stops are given; exactly one is needed ([stop] or stop = true on one surface)")
        stop = self.stop or next(s for s in self.surface if isinstance(s, SurfaceTable) and s.stop)
        if math.isinf(stop.semi_diameter_mm) == (self.pupil is None):
            raise ValueError(
                "the stop needs semi_diameter_mm, or in its place a table [pupil] with f_number or "
                "entrance_pupil_diameter_mm; not both"
            )
        return self

    def coatings(self, glass_of: Callable[[str], Glass]) -> dict[str, Coating]:
        """Coatings by name; ConfigError for an invalid one."""
        coatings: dict[str, Coating] = {UNCOATED: BARE}
        for name, table in self.coating.items():
            if name == UNCOATED:
                raise ConfigError(f"coating {name!r} is reserved; use another name")
            try:
                coatings[name] = table.coating(glass_of)
            except DomainError as error:
                raise ConfigError(f"coating {name!r}: {error}") from None
        return coatings
