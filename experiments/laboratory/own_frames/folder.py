"""Frames from a laboratory: a folder of FITS files and ``frames.toml``, which says which frame is which.

    gain_dn_per_e = 0.25
    offset_dn = 64
    read_noise_e = 13
    pixel_arcsec = 5.5
    dark = ["dark_*.fits"]           # lamp off; optional
    points = 25                      # the brightest; or points_px = [[x, y], ...]; or target = "target.csv"

    [[series]]
    files = ["still_*.fits"]

A series is a number of frames of a target at rest: a brightness level (temporal), a position (hsfe), a session
(distortion). Target points are detected in the mean frame of each series; windows are cut around them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from calib.flags import StarFlag, has_flag
from calib.measure.detection import detect
from calib.measure.image import sensor_image
from experiments.harness.config import StrictModel
from experiments.laboratory.readout.search import match_points
from experiments.laboratory.readout.windows import cut_windows, window_corners
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.units import ARCSEC_RAD
from optics.validate import parse_model, read_toml
from render.fits.files import read_frame
from render.records import Frame, WindowStack

__all__ = ["SETTINGS_FILE", "FolderSettings", "FrameFolder", "FrameSeries", "SeriesSettings", "read_folder"]

Scalar = TypeVar("Scalar", bound=np.generic)

SETTINGS_FILE = "frames.toml"
"""Name of the file that describes a folder."""
_COLUMNS = (("x_px", "y_px"), ("tan_x", "tan_y"))


class SeriesSettings(StrictModel):
    """Frames of a target at rest."""

    files: tuple[str, ...] = Field(min_length=1, description="file names or patterns (*, ?), within the folder")
    name: str = Field(default="", description="for messages and tables")
    count: int | None = Field(default=None, ge=2, description="number of frames that must be there")
    dark: tuple[str, ...] = Field(default=(), description="lamp off, in place of those of the folder")
    position: int | None = Field(default=None, description="hsfe: place in the order of the steps")
    shift_px: tuple[float, float] | None = Field(default=None, description="hsfe: commanded shift since the start")
    session: Literal["earlier", "test"] = Field(default="test", description="distortion: which session")


class FolderSettings(StrictModel):
    """Contents of ``frames.toml``."""

    gain_dn_per_e: float = Field(gt=0, le=1e5, description="system gain K")
    offset_dn: float = Field(ge=0, le=65535, description="nominal offset")
    read_noise_e: float = Field(ge=0, le=1e5, description="temporal dark noise of a pixel")
    pixel_arcsec: float = Field(gt=0, le=36000, description="angle of a pixel")
    saturation_dn: float | None = Field(default=None, gt=0, description="pixels from here on are saturated")
    dark: tuple[str, ...] = Field(default=(), description="frames with the lamp off; without them patterns stay")
    points: int | None = Field(default=None, ge=1, le=10000, description="number of target points: the brightest")
    points_px: tuple[tuple[float, float], ...] = Field(default=(), description="nominal places (column, row)")
    target: str | None = Field(
        default=None, description="CSV or ECSV file of nominal places: x_px, y_px or tan_x, tan_y"
    )
    match_px: float = Field(default=4.0, gt=0, le=50, description="farthest a point may lie from its nominal place")
    centre_px: tuple[float, float] | None = Field(default=None, description="where tan_x = tan_y = 0 is imaged")
    series: tuple[SeriesSettings, ...] = Field(min_length=1, description="the frames")

    @model_validator(mode="after")
    def _one_target(self) -> FolderSettings:
        given = [self.points is not None, bool(self.points_px), self.target is not None]
        if sum(given) != 1:
            raise ValueError("exactly one of points, points_px and target is needed: it says what is to be measured")
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSeries:
    """Windows of a series around j target points.

    Attributes
    ----------
    settings : SeriesSettings
        What the folder says of it.
    name : str
        For messages and tables.
    windows : WindowStack
        The frames.
    found_px : (j, 2)
        Where the points were detected.
    dark_e : (j, h, w) or None
        Mean frame with the lamp off, offset included.
    """

    settings: SeriesSettings
    name: str
    windows: WindowStack
    found_px: FloatArray
    dark_e: FloatArray | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFolder:
    """A folder as read.

    Attributes
    ----------
    settings : FolderSettings
        Its ``frames.toml``.
    width_px, height_px : int
        Size of the frames.
    nominal_px : (j, 2) or None
        Nominal places of the target points, if stated.
    series : tuple of FrameSeries
        Ordered by ``position`` where that is given.
    dark_frames : int
        Frames with the lamp off.
    """

    settings: FolderSettings
    width_px: int
    height_px: int
    nominal_px: FloatArray | None
    series: tuple[FrameSeries, ...]
    dark_frames: int

    @property
    def centre_px(self) -> FloatArray:
        """Middle of the frames, or what the folder says."""
        middle = ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
        return np.asarray(self.settings.centre_px or middle, float)


def read_folder(folder: str | Path, *, window_px: int) -> FrameFolder:
    """Read a folder, find the target points, cut windows.

    Parameters
    ----------
    folder : path
        Holds ``frames.toml`` and the FITS files: whole numbers from 0 to 65535. The mask behind frames of `write_frame`
        is used; other frames have none.
    window_px : int
        Side of the windows, odd.

    Raises
    ------
    ConfigError
        A folder, file or key is missing, unknown or broken.
    DomainError
        Fewer than two frames in a series, frames of different sizes, target points off the detector or not detected.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; one with frames and {SETTINGS_FILE} is needed")
    if not (folder / SETTINGS_FILE).is_file():
        raise ConfigError(f"{folder}: holds no {SETTINGS_FILE}, which says which frame is which")
    settings = parse_model(FolderSettings, read_toml(folder / SETTINGS_FILE), SETTINGS_FILE)
    names = [one.name or f"series {number}" for number, one in enumerate(settings.series, start=1)]
    files = [_series_files(folder, one, name) for one, name in zip(settings.series, names, strict=True)]
    dark_files = [_files(folder, one.dark or settings.dark, "dark") for one in settings.series]
    every_dark = list(dict.fromkeys(path for some in dark_files for path in some))
    _refuse_shared([every_dark, *files], ["dark", *names])
    reader = _Reader(settings, files[0][0])
    nominal = _nominal_px(folder, settings, reader)
    series: list[FrameSeries] = []
    for number in _order(settings.series):
        mean, defect = reader.mean(files[number])
        dark = reader.dark(dark_files[number])
        reference = series[0].found_px if series else nominal
        found = reader.find(mean, defect, dark, len(files[number]), reference, names[number])
        advice = "move the target, or take a smaller window_px"
        corner = window_corners(found, window_px, reader.size, where=names[number], advice=advice)
        windows = reader.cut(files[number], corner, window_px)
        series.append(
            FrameSeries(
                settings=settings.series[number],
                name=names[number],
                windows=windows,
                found_px=found,
                dark_e=None if dark is None else cut_windows(dark, corner, window_px) / settings.gain_dn_per_e,
            )
        )
    width, height = reader.size
    return FrameFolder(
        settings=settings,
        width_px=width,
        height_px=height,
        nominal_px=nominal,
        series=tuple(series),
        dark_frames=len(every_dark),
    )


def _files(folder: Path, patterns: Sequence[str], name: str) -> list[Path]:
    """Files of patterns in the order of the patterns, each once."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        steps = PurePosixPath(pattern)
        if steps.is_absolute() or PureWindowsPath(pattern).drive or ".." in steps.parts or not steps.parts:
            raise ConfigError(f"{SETTINGS_FILE}, {name}: {pattern!r} is not within the folder; name files in it")
        many = any(sign in pattern for sign in "*?[")
        here = sorted(p for p in folder.glob(pattern) if p.is_file()) if many else [folder / pattern]
        if not here or not all(p.is_file() for p in here):
            raise ConfigError(f"{SETTINGS_FILE}, {name}: no file {pattern!r} in the folder {folder}")
        found.update(dict.fromkeys(here))
    return list(found)


def _series_files(folder: Path, settings: SeriesSettings, name: str) -> list[Path]:
    files = _files(folder, settings.files, name)
    if len(files) < 2:
        raise DomainError(f"{SETTINGS_FILE}, {name}: {len(files)} frame; at least 2 are needed")
    if settings.count is not None and len(files) != settings.count:
        raise ConfigError(
            f"{SETTINGS_FILE}, {name}: {len(files)} frames in the folder, count says {settings.count}; add the missing "
            "ones or correct the count"
        )
    return files


def _refuse_shared(groups: Sequence[Sequence[Path]], names: Sequence[str]) -> None:
    owner: dict[Path, str] = {}
    for group, name in zip(groups, names, strict=True):
        for path in group:
            if path in owner:
                raise ConfigError(
                    f"{SETTINGS_FILE}: {path.name} belongs to {owner[path]} and to {name}; a frame has one"
                )
            owner[path] = name


def _order(series: Sequence[SeriesSettings]) -> list[int]:
    """Numbers of the series by position; as listed where none is given."""
    positions = [one.position for one in series]
    if all(p is None for p in positions):
        return list(range(len(series)))
    known = [p for p in positions if p is not None]
    if len(known) < len(series) or len(set(known)) < len(series):
        raise ConfigError(f"{SETTINGS_FILE}: position must be given for every series or none, each number once")
    return [int(i) for i in np.argsort(known)]


def _nominal_px(folder: Path, settings: FolderSettings, reader: _Reader) -> FloatArray | None:
    """Nominal places of the points; they must be on the detector."""
    width, height = reader.size
    if settings.target is not None:
        path = _files(folder, [settings.target], "target")[0]
        pair, values = _table(path)
        if pair == "tan_x":
            centre = settings.centre_px or ((width - 1) / 2, (height - 1) / 2)
            values = np.asarray(centre, float) + values / (settings.pixel_arcsec * ARCSEC_RAD)
    elif settings.points_px:
        values = np.asarray(settings.points_px, float)
    else:
        return None
    off = np.any((values < 0) | (values > np.array([width, height]) - 1), axis=1)
    if off.any():
        at = values[int(np.argmax(off))]
        raise DomainError(
            f"{int(off.sum())} of {len(values)} target points lie off the detector, e.g. at column {at[0]:.1f}, row "
            f"{at[1]:.1f} of {width} x {height} px; correct their coordinates, centre_px or pixel_arcsec"
        )
    return values


def _table(path: Path) -> tuple[str, FloatArray]:
    """Name of the first column and the coordinates (j, 2) of a CSV or ECSV file."""
    from astropy.table import Table

    try:
        table = Table.read(path, format="ascii.ecsv" if path.suffix == ".ecsv" else "ascii.csv")
        for pair in _COLUMNS:
            if set(pair) <= set(table.colnames):
                values = np.column_stack([np.asarray(table[name], float) for name in pair])
                if len(values) and np.isfinite(values).all():
                    return pair[0], values
                raise ConfigError(f"{path.name}: finite coordinates of at least one point are needed")
    except ConfigError:
        raise
    except Exception as error:  # astropy raises many kinds for broken tables
        raise ConfigError(f"{path.name}: not a readable table ({' '.join(str(error).split())[:160]})") from None
    raise ConfigError(f"{path.name}: columns x_px and y_px, or tan_x and tan_y, are needed; it has {table.colnames}")


class _Reader:
    """Reads frames one at a time: a series of large frames need not fit into memory."""

    def __init__(self, settings: FolderSettings, first: Path) -> None:
        self.settings = settings
        self.first = first
        self._last_dark: tuple[list[Path], FloatArray] | None = None
        height, width = self._frame(first).dn.shape
        self.size = (int(width), int(height))

    def _frame(self, path: Path) -> Frame:
        s = self.settings
        frame = read_frame(
            path,
            gain_dn_per_e=s.gain_dn_per_e,
            offset_dn=s.offset_dn,
            read_noise_e=s.read_noise_e,
            exposure_s=float("nan"),  # not known, not needed
        )
        return frame

    def frames(self, files: Sequence[Path]) -> Iterator[Frame]:
        for path in files:
            frame = self._frame(path)
            height, width = frame.dn.shape
            if (width, height) != self.size:
                raise DomainError(
                    f"{path.name} has {width} x {height} px, {self.first.name} {self.size[0]} x {self.size[1]} px; all "
                    "frames of a folder must have one size"
                )
            yield frame

    def mean(self, files: Sequence[Path]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Mean frame [DN] and pixels known to be defective in any."""
        width, height = self.size
        total, defect = np.zeros((height, width)), np.zeros((height, width), bool)
        for frame in self.frames(files):
            total += frame.dn
            defect |= frame.defect
        return total / len(files), defect

    def dark(self, files: list[Path]) -> FloatArray | None:
        """Mean frame with the lamp off; None without files. Read once for series that share it."""
        if not files:
            return None
        if self._last_dark is None or self._last_dark[0] != files:
            self._last_dark = (files, self.mean(files)[0])
        return self._last_dark[1]

    def find(
        self,
        mean: FloatArray,
        defect: NDArray[np.bool_],
        dark: FloatArray | None,
        frames: int,
        reference: FloatArray | None,
        name: str,
    ) -> FloatArray:
        """Places (j, 2) of the target points in the mean frame of a series."""
        s = self.settings
        image = sensor_image(
            mean if dark is None else mean - dark + s.offset_dn,
            gain_dn_per_e=s.gain_dn_per_e,
            offset_dn=s.offset_dn,
            read_noise_e=s.read_noise_e / np.sqrt(frames),
            defect=defect,
            quantised=False,
            source=name,
        )
        table = detect(image)
        table = table.select(~has_flag(table.flags, StarFlag.SPIKE)) if len(table) else table
        position = np.column_stack([table.x_px, table.y_px])
        wanted = s.points if reference is None else len(reference)
        assert wanted is not None
        if len(position) < wanted:
            raise DomainError(
                f"{name}: {len(position)} points detected of {wanted}; expose longer, focus, or correct the number"
            )
        if reference is None:
            brightest = position[:wanted]
            return brightest[np.lexsort((brightest[:, 0], brightest[:, 1]))]
        return match_points(
            position,
            reference,
            match_px=s.match_px,
            where=name,
            unseen=f"correct the coordinates or raise match_px ({s.match_px:g})",
            merged="lower match_px or part them",
        )

    def cut(self, files: Sequence[Path], corner: NDArray[np.int64], window_px: int) -> WindowStack:
        """Windows of all frames."""
        s, dn, saturated = self.settings, [], []
        defect = np.zeros((len(corner), window_px, window_px), bool)
        for frame in self.frames(files):
            cut = cut_windows(frame.dn, corner, window_px)
            full = cut_windows(frame.saturated, corner, window_px)
            dn.append(cut)
            saturated.append(full if s.saturation_dn is None else full | (cut.astype(float) >= s.saturation_dn))
            defect |= cut_windows(frame.defect, corner, window_px)
        return WindowStack(
            dn=np.stack(dn),
            saturated=np.stack(saturated),
            defect=defect,
            corner_px=corner,
            gain_dn_per_e=s.gain_dn_per_e,
            offset_dn=s.offset_dn,
            read_noise_e=s.read_noise_e,
            exposure_s=float("nan"),
            band="",
            first_index=0,
        )
