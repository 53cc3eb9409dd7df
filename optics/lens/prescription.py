"""Lens prescriptions as TOML: the file says what every number is and where it comes from."""

from __future__ import annotations

from dataclasses import MISSING, fields
from functools import reduce
from importlib import resources
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, FiniteFloat, Tag, create_model, model_validator
from scipy.spatial.transform import Rotation

from optics.errors import ConfigError, StarbenchError, unknown_name
from optics.glass.catalogue import Glass, get_glass, glass_from_table
from optics.glass.media import CATALOGUE_AIR, Environment
from optics.lens.shapes.base import Shape
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.registry import SHAPES, UNNAMED
from optics.lens.system import AMBIENT, LensSystem, Surface
from optics.validate import parse_toml

__all__ = ["LensFile", "list_lenses", "load_lens"]

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class StopTable(_Table):
    """A stop that stands alone: a plane at ``z_mm`` in the lens frame."""

    z_mm: FiniteFloat
    semi_diameter_mm: Positive
    inner_semi_diameter_mm: NotNegative = 0.0


class SurfaceTable(_Table):
    """What every surface has, whatever its shape. Tilts are about x, then y, of the surface's own vertex."""

    kind: str
    thickness_mm: NotNegative
    medium: str
    semi_diameter_mm: Positive
    inner_semi_diameter_mm: NotNegative = 0.0
    element: str = ""
    stop: bool = False
    decentre_mm: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    tilt_deg: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)

    @model_validator(mode="after")
    def _the_shape_exists(self) -> SurfaceTable:
        self.shape()
        return self

    def shape(self) -> Shape:
        """The shape that the table describes."""
        shape = next(shape for shape in SHAPES if shape.kind == self.kind)
        made = shape(**{field.name: getattr(self, field.name) for field in fields(shape)})
        return made if "kind" in self.model_fields_set else made.simplest()


def _table_of(shape: type[Shape]) -> type[SurfaceTable]:
    """Surface table of one kind: its keys are the fields of the shape, their types the checks."""
    hints = get_type_hints(shape, include_extras=True)
    keys: dict[str, Any] = {"kind": (Literal[shape.kind], shape.kind)}
    for field in fields(shape):
        keys[field.name] = (hints[field.name], ... if field.default is MISSING else field.default)
    return create_model(f"{shape.__name__}Table", __base__=SurfaceTable, **keys)


def _kind_of(table: Any) -> Any:
    """Kind that a surface table names, or stands for if it names none."""
    return table.get("kind", UNNAMED.kind) if isinstance(table, dict) else getattr(table, "kind", UNNAMED.kind)


if TYPE_CHECKING:
    AnySurface = SurfaceTable
else:
    AnySurface = Annotated[
        reduce(or_, (Annotated[_table_of(shape), Tag(shape.kind)] for shape in SHAPES)), Discriminator(_kind_of)
    ]


class GlassTable(_Table):
    """A glass that the built-in catalogue does not hold; keys as in `optics.glass.catalogue.glass_from_table`."""

    source: Annotated[str, Field(min_length=1)]
    maker: str = "generic"
    B: tuple[FiniteFloat, ...]
    C: tuple[FiniteFloat, ...]
    range_nm: tuple[Positive, Positive]
    reference_temperature_c: FiniteFloat = 20.0
    dndt: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    dndt_range_c: tuple[FiniteFloat, FiniteFloat] | None = None
    cte_per_k: FiniteFloat | None = None


class LensFile(_Table):
    """Whole prescription file."""

    name: Annotated[str, Field(min_length=1)]
    source: Annotated[str, Field(min_length=1)]
    design_wavelength_nm: Positive
    max_field_deg: Annotated[float, Field(gt=0, lt=90)]
    stop: StopTable | None = None
    surface: Annotated[tuple[AnySurface, ...], Field(min_length=1)]
    glass: dict[str, GlassTable] = {}

    @model_validator(mode="after")
    def _one_stop(self) -> LensFile:
        stops = sum(s.stop for s in self.surface) + (self.stop is not None)
        if stops != 1:
            raise ValueError(f"{stops} stops are given; exactly one is needed ([stop] or stop = true on one surface)")
        return self


def _surfaces(file: LensFile) -> tuple[list[Surface], float]:
    """Surfaces at their vertices, and z of the image plane."""
    z, surfaces = 0.0, []
    for table in file.surface:
        surfaces.append(
            Surface(
                shape=table.shape(),
                position_mm=np.array([*table.decentre_mm, z]),
                rotation=Rotation.from_euler("xy", table.tilt_deg, degrees=True).as_matrix()
                if any(table.tilt_deg)
                else np.eye(3),
                medium=table.medium,
                semi_diameter_mm=table.semi_diameter_mm,
                inner_semi_diameter_mm=table.inner_semi_diameter_mm,
                element=table.element,
                is_stop=table.stop,
            )
        )
        z += table.thickness_mm
    if file.stop is not None:
        place = next((i for i, s in enumerate(surfaces) if s.position_mm[2] >= file.stop.z_mm), len(surfaces))
        surfaces.insert(
            place,
            Surface(
                shape=Plane(),
                position_mm=np.array([0.0, 0.0, file.stop.z_mm]),
                medium=surfaces[place - 1].medium if place else AMBIENT,
                semi_diameter_mm=file.stop.semi_diameter_mm,
                inner_semi_diameter_mm=file.stop.inner_semi_diameter_mm,
                element="",
                is_stop=True,
            ),
        )
    return surfaces, z


def _glasses(file: LensFile, media: list[str], where: str) -> dict[str, Glass]:
    """Records of the glasses that the surfaces name; the file's own come before the catalogue's."""
    glasses = {}
    for name in dict.fromkeys(medium for medium in media if medium != AMBIENT):
        table = file.glass.get(name)
        try:
            glasses[name] = (
                get_glass(name) if table is None else glass_from_table(name, table.model_dump(exclude_none=True))
            )
        except StarbenchError as error:
            raise ConfigError(f"{where}: {error}") from None
    return glasses


def _check_apertures(file: LensFile, where: str) -> None:
    """Refuse a clear aperture that reaches beyond the rim where a sphere or conic ends."""
    for number, table in enumerate(file.surface):
        shape = table.shape()
        if table.semi_diameter_mm >= shape.rim_mm:
            raise ConfigError(
                f"{where}: surface {number}: semi_diameter_mm = {table.semi_diameter_mm:g} mm reaches the rim of the "
                f"surface ({shape}); it must be below {shape.rim_mm:.6g} mm"
            )


def _builtin() -> dict[str, Path]:
    folder = Path(str(resources.files("optics"))) / "data" / "lenses"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def list_lenses() -> tuple[str, ...]:
    """Names of the built-in prescriptions."""
    return tuple(_builtin())


def load_lens(name_or_path: str | Path, *, environment: Environment = CATALOGUE_AIR) -> LensSystem:
    """Read a prescription.

    Parameters
    ----------
    name_or_path : str or path
        A built-in name (`list_lenses`) or a TOML file.
    environment : Environment
        Temperature and pressure; `optics.glass.media.VACUUM` for space.

    Returns
    -------
    LensSystem
        The lens.

    Raises
    ------
    ConfigError
        Unknown name (with the nearest), missing or broken file, unknown key (with the nearest), unknown glass.
    """
    builtin = _builtin()
    text = str(name_or_path)
    if text in builtin:
        path = builtin[text]
    elif text.endswith(".toml") or "/" in text:
        path = Path(name_or_path)
    else:
        raise unknown_name("lens", text, builtin)
    file, shown = parse_toml(LensFile, path), str(name_or_path)
    surfaces, image_z = _surfaces(file)
    glasses = _glasses(file, [s.medium for s in surfaces], shown)
    if surfaces[-1].medium != AMBIENT:
        raise ConfigError(f"{shown}: the last surface is followed by {surfaces[-1].medium!r}; it must be 'air'")
    _check_apertures(file, shown)
    return LensSystem(
        name=file.name,
        source=file.source,
        surfaces=tuple(surfaces),
        glasses=glasses,
        image_position_mm=np.array([0.0, 0.0, image_z]),
        design_wavelength_nm=file.design_wavelength_nm,
        max_field_deg=file.max_field_deg,
        environment=environment,
    )
