"""``frames.toml``: assignment of the frames of a folder, and stated properties of the camera (docs/frames.md)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from experiments.harness.config import AngleDeg
from experiments.laboratory.bench.centroid_methods import CentroiderName
from optics.errors import ConfigError
from optics.settings import StrictModel
from optics.validate import parse_model, read_toml

Patterns = Annotated[tuple[str, ...], BeforeValidator(lambda value: (value,) if isinstance(value, str) else value)]
"""File names or patterns; a single one needs no list."""

SETTINGS_FILE = "frames.toml"


class SeriesSettings(StrictModel):
    """Frames of a target, or of a star, at rest."""

    files: Patterns = Field(min_length=1, description="file names or patterns (*, ?), within the folder")
    name: str = Field(default="", description="name in messages and tables")
    count: int | None = Field(default=None, ge=1, le=10**6, description="required number of frames")
    dark: Patterns = Field(default=(), description="dark frames of the series, in place of the folder's")
    position: int | None = Field(
        default=None, ge=-(10**6), le=10**6, description="hsfe: index in the order of the steps"
    )
    shift_px: tuple[float, float] | None = Field(
        default=None, description="hsfe: commanded shift from the first position"
    )
    session: Literal["earlier", "test"] = Field(default="test", description="distortion: session")
    filter_nm: float | None = Field(
        default=None, gt=0, le=1e5, description="chromatic: central wavelength of the filter"
    )
    place: str = Field(default="middle", min_length=1, description="chromatic: name of the target's field position")
    filter_angle_deg: float = Field(
        default=0.0, ge=-360, le=360, description="chromatic: rotation of the filter, from +x to +y"
    )
    camera_angle_deg: float = Field(
        default=0.0, ge=-360, le=360, description="chromatic: rotation of the camera, filters and target at rest"
    )
    outer_deg: float | None = Field(
        default=None, ge=-1e5, le=1e5, description="turntable, fisher: reading of the outermost axis"
    )
    middle_deg: float | None = Field(
        default=None, ge=-1e5, le=1e5, description="turntable, fisher: reading of the middle axis of three"
    )
    inner_deg: float | None = Field(
        default=None, ge=-1e5, le=1e5, description="turntable, fisher: reading of the innermost axis"
    )
    use: Literal["calibration", "evaluation"] = Field(
        default="calibration", description="fisher: calibration or evaluation of star vectors"
    )

    @property
    def angle_deg(self) -> float:
        """Angle of the filter to the camera, from +x to +y."""
        return self.filter_angle_deg - self.camera_angle_deg


class TableSettings(StrictModel):
    """Turntable of a single-star bench (turntable, fisher)."""

    axes: str = Field(description="axes, outermost first, as letters of the laboratory frame, minus for left turns")
    reading_noise_arcsec: tuple[Annotated[float, Field(ge=0, le=1e5)], ...] = Field(
        min_length=1, description="standard deviation of the reading of a series; one for all axes, or one per axis"
    )
    star_deg: tuple[AngleDeg, AngleDeg] = Field(
        default=(0.0, 0.0), description="nominal star direction at zero angles, azimuth and elevation"
    )


class FolderSettings(StrictModel):
    """Contents of ``frames.toml``."""

    gain_dn_per_e: float = Field(gt=0, le=1e5, description="system gain K")
    offset_dn: float = Field(ge=0, le=65535, description="nominal offset")
    read_noise_e: float = Field(ge=0, le=1e5, description="temporal dark noise of a pixel")
    pixel_arcsec: float = Field(gt=0, le=36000, description="angle of a pixel on the axis")
    pixel_pitch_um: float | None = Field(default=None, gt=0, le=1000, description="turntable, fisher: side of a pixel")
    saturation_dn: float | None = Field(default=None, gt=0, le=1e9, description="lowest value of a saturated pixel")
    prnu_fraction: float = Field(
        default=0.0, ge=0, le=0.2, description="standard deviation of the pixel response after flat-fielding"
    )
    dark: Patterns = Field(default=(), description="dark frames; without them fixed patterns remain")
    flat: Patterns = Field(default=(), description="flat fields; without them the response pattern remains")
    flat_dark: Patterns = Field(default=(), description="dark frames with the exposure of the flats; default: `dark`")
    bad_pixels: str | None = Field(default=None, description="FITS image, non-zero at pixels to exclude")
    points: int | None = Field(default=None, ge=1, le=10000, description="number of target points, the brightest")
    points_px: tuple[tuple[float, float], ...] = Field(default=(), description="nominal positions (column, row)")
    target: str | None = Field(
        default=None, description="CSV or ECSV file of nominal positions: x_px, y_px or tan_x, tan_y"
    )
    match_px: float = Field(
        default=4.0, gt=0, le=50, description="largest distance of a point from its nominal position"
    )
    centroid: CentroiderName | None = Field(
        default=None, description="main centroider, in place of the configuration's; not epsf"
    )
    reference_nm: float | None = Field(
        default=None, gt=0, le=1e5, description="chromatic: reference filter; default: filters.reference_nm"
    )
    centre_px: tuple[float, float] | None = Field(default=None, description="image of tan_x = tan_y = 0")
    table: TableSettings | None = Field(default=None, description="turntable, fisher: turntable")
    series_table: str | None = Field(
        default=None, description="CSV or ECSV file with a row per series; columns are keys of [[series]]"
    )
    series: tuple[SeriesSettings, ...] = Field(default=(), description="series of frames")

    @model_validator(mode="after")
    def _what_is_there(self) -> FolderSettings:
        if bool(self.series) == (self.series_table is not None):
            raise ValueError("[[series]] or series_table is needed, one of them: it assigns the frames")
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderLayout:
    """Requirements of an experiment on a folder."""

    needs: tuple[str, ...] = ()  # Keys that every series must have
    # Series with the same points, whose positions are those of the first: all, of the same ``place``, or none
    same_scene: Literal["all", "place", "none"] = "all"
    points: int | None = None  # Number of points, if not stated in the folder
    fewest: int = 2  # Fewest frames of a series

    def check(self, settings: FolderSettings) -> None:
        """Refuse a folder with missing information."""
        given = [settings.points is not None, bool(settings.points_px), settings.target is not None]
        if self.points is None and sum(given) != 1:
            raise ConfigError(
                f"{SETTINGS_FILE}: exactly one of points, points_px and target is needed, to define what is measured"
            )
        if self.same_scene != "all" and any(given[1:]):
            raise ConfigError(
                f"{SETTINGS_FILE}: points_px and target give the positions of a target at rest; this experiment "
                "moves it" + ("" if self.points else ", give points, its number")
            )
        for series in settings.series:
            missing = [key for key in self.needs if getattr(series, key) is None]
            if missing:
                raise ConfigError(f"{SETTINGS_FILE}, {series.name}: {missing[0]} is missing")


def read_settings(folder: Path) -> FolderSettings:
    """Contents of a folder's ``frames.toml``, series of a table included, every series with a name."""
    if not os.path.isdir(folder):
        raise ConfigError(f"{folder}: no such folder; one with frames and {SETTINGS_FILE} is needed")
    if not os.path.isfile(folder / SETTINGS_FILE):
        raise ConfigError(f"{folder}: holds no {SETTINGS_FILE}, which describes the frames")
    settings = parse_model(FolderSettings, read_toml(folder / SETTINGS_FILE), SETTINGS_FILE)
    series: Sequence[SeriesSettings] = settings.series
    if settings.series_table is not None:
        if not os.path.isfile(folder / settings.series_table):
            raise ConfigError(f"{SETTINGS_FILE}, series_table: no file {settings.series_table!r} in the folder")
        table = read_table(folder / settings.series_table)
        rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
        if not rows:
            raise ConfigError(f"{settings.series_table}: no rows; at least one series is needed")
        series = []
        for number, row in enumerate(rows, start=1):  # names may look like numbers
            cells = {key: str(value) if key in ("name", "place") else value for key, value in row.items()}
            cells = {key: value for key, value in cells.items() if row[key] is not None}
            series.append(parse_model(SeriesSettings, cells, f"{settings.series_table}, row {number}"))
    names = [part.name or f"series {number}" for number, part in enumerate(series, start=1)]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{SETTINGS_FILE}: two series have the name {name!r}; each needs its own")
    named = (part.model_copy(update={"name": name}) for part, name in zip(series, names, strict=True))
    return settings.model_copy(update={"series": tuple(named)})


def read_table(path: Path) -> dict[str, list[Any]]:
    """Columns of a CSV or ECSV file by name; None for empty cells."""
    from astropy.table import Table

    try:
        table = Table.read(path, format="ascii.ecsv" if path.suffix == ".ecsv" else "ascii.csv")
    except Exception as error:  # astropy raises errors of many classes
        raise ConfigError(f"{path.name}: not a readable table ({' '.join(str(error).split())[:160]})") from None
    return {name: table[name].tolist() for name in table.colnames}
