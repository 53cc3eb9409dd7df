"""Frames from a laboratory: a folder of FITS files with ``frames.toml``, which assigns them.

A series holds frames of a target, or a star, at rest: a brightness level (temporal), a position (hsfe), a session
(distortion), a filter at a field position (chromatic), a pose of the table (turntable, fisher). Points are detected in
the mean frame of each series; windows are cut around them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from calib.measure.detection.matched_filter import detect
from calib.measure.images.exposure_time import header_time
from calib.measure.images.sensor_image import sensor_image
from calib.measure.targets.target_points import match_points
from experiments.laboratory.bench.readout.windows import cut_windows, window_corners
from experiments.reduce.frames import (
    Flat,
    FrameGroup,
    FrameReader,
    bad_pixels,
    find_files,
    mean_flat,
    read_group,
    refuse_shared,
    same,
)
from experiments.reduce.frames_toml import (
    SETTINGS_FILE,
    FolderLayout,
    FolderSettings,
    SeriesSettings,
    read_settings,
    read_table,
)
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.fits import image_header
from optics.units import ARCSEC_RAD
from render.records import WindowStack

_COLUMNS = (("x_px", "y_px"), ("tan_x", "tan_y"))


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSeries:
    """Windows of a series around j points."""

    settings: SeriesSettings
    windows: WindowStack
    detected_px: FloatArray  # (j, 2) Positions of the points in the mean frame
    dark_e: FloatArray | None  # (j, h, w) Mean dark frame, offset included
    dark_frames: int
    response: FloatArray | None  # (j, h, w) The flat, and its standard deviation
    response_error: FloatArray | None  # (j, h, w)
    origin: tuple[str, ...]  # File of every frame, with its number in a file of several
    digest: tuple[str, ...]  # Of all pixels of every frame
    taken: tuple[str, ...]  # Times or FRAMENUM of the headers; () if a file has none

    @property
    def name(self) -> str:
        """Name of the series in messages and tables."""
        return self.settings.name


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFolder:
    """Content of a folder."""

    settings: FolderSettings
    width_px: int
    height_px: int
    nominal_px: FloatArray | None  # (j, 2) Stated positions of the target points
    series: tuple[FrameSeries, ...]  # Ordered by ``position`` if given
    dark_frames: int
    flat: Flat | None = None
    bad_pixels: int = 0  # Number of bad pixels in the map

    @property
    def centre_px(self) -> FloatArray:
        """Image of tan_x = tan_y = 0: as stated, or the middle of the frames."""
        return _centre_px(self.settings, (self.width_px, self.height_px))


def read_folder(folder: str | Path, *, window_px: int, layout: FolderLayout | None = None) -> FrameFolder:
    """Read a folder, find the points, cut windows."""
    folder, layout = Path(folder), layout or FolderLayout()
    settings = read_settings(folder)
    layout.check(settings)
    files = [find_files(folder, part.files, part.name) for part in settings.series]
    dark_files = [find_files(folder, part.dark or settings.dark, "dark") for part in settings.series]
    groups = {"dark": list(dict.fromkeys(chain.from_iterable(dark_files)))}
    groups["flat"] = find_files(folder, settings.flat, "flat")
    refuse_shared([*groups.values(), *files], [*groups, *(part.name for part in settings.series)])
    reader = FrameReader(settings)
    size_px = reader.size_of(files[0][0])
    bad = bad_pixels(reader, folder, settings)
    flat = mean_flat(reader, folder, settings, bad)
    nominal, excluded = _nominal_px(folder, settings, size_px), np.zeros(size_px[::-1], bool)
    for pixels in (bad, None if flat is None else flat.response.unusable):
        excluded |= False if pixels is None else pixels
    darks: dict[tuple[Path, ...], FrameGroup] = {}
    filters: dict[str, SeriesSettings] = {}
    references: dict[str, FloatArray] = {}
    corners: dict[str, NDArray[np.int64]] = {}
    series: list[FrameSeries] = []
    for number in _order(settings.series):
        current = settings.series[number]
        group = read_group(reader, files[number], current.name)
        _check_count(current, group.mean.frames, layout.fewest)
        _check_filter(current, group.band, filters)
        dark = None
        if paths := tuple(dark_files[number]):
            dark = darks.setdefault(paths, darks.get(paths) or read_group(reader, paths, "dark"))
            if not same(dark.exposure_s, group.exposure_s):
                raise DomainError(
                    f"{current.name}: exposed {group.exposure_s:g} s, its dark frames {dark.exposure_s:g} s; dark "
                    "frames must have the exposure time of the frames"
                )
        scene = {"all": "", "place": current.place, "none": current.name}[layout.same_scene]
        detected = _detected_px(settings, group, excluded, dark, references.get(scene, nominal), layout.points)
        references.setdefault(scene, detected)
        advice = "move the target, or take a smaller window_px"
        corner = window_corners(detected, window_px, size_px, where=current.name, advice=advice)
        if layout.same_scene == "place":  # fixed patterns of the same pixels cancel in differences of filters
            corner = corners.setdefault(scene, corner)
        gain = settings.gain_dn_per_e
        windows, origin, digest = _cut(reader, files[number], current.name, corner, window_px, excluded)
        series.append(
            FrameSeries(
                settings=current,
                windows=windows,
                origin=origin,
                digest=digest,
                taken=_taken(files[number]),
                detected_px=detected,
                dark_e=None if dark is None else cut_windows(dark.mean.mean_dn, corner, window_px) / gain,
                dark_frames=0 if dark is None else dark.mean.frames,
                response=None if flat is None else cut_windows(flat.response.response, corner, window_px),
                response_error=None if flat is None else cut_windows(flat.response.error, corner, window_px),
            )
        )
    return FrameFolder(
        settings=settings,
        width_px=size_px[0],
        height_px=size_px[1],
        nominal_px=nominal,
        series=tuple(series),
        dark_frames=sum(dark.mean.frames for dark in darks.values()),
        flat=flat,
        bad_pixels=0 if bad is None else int(bad.sum()),
    )


def _check_count(settings: SeriesSettings, frames: int, fewest: int) -> None:
    if frames < fewest:
        raise DomainError(
            f"{SETTINGS_FILE}, {settings.name}: {frames} frame{'s' if frames != 1 else ''}; at least {fewest} are "
            "needed"
        )
    if settings.count is not None and frames != settings.count:
        raise ConfigError(
            f"{SETTINGS_FILE}, {settings.name}: {frames} frames in the folder, count = {settings.count}; add the "
            f"missing frames or correct count"
        )


def _check_filter(settings: SeriesSettings, band: str, filters: dict[str, SeriesSettings]) -> None:
    """Refuse a FILTER of the files with two wavelengths."""
    if settings.filter_nm is None or not band:
        return
    first = filters.setdefault(band, settings)
    if first.filter_nm != settings.filter_nm:
        raise ConfigError(
            f"{SETTINGS_FILE}: FILTER = {band!r} in the files of {first.name} and of {settings.name}, filter_nm says "
            f"{first.filter_nm:g} and {settings.filter_nm:g}; one of them is in the wrong series"
        )


def _order(series: Sequence[SeriesSettings]) -> list[int]:
    """Numbers of the series by position; as listed without positions."""
    positions = [settings.position for settings in series if settings.position is not None]
    if not positions:
        return list(range(len(series)))
    if len(set(positions)) < len(series):
        raise ConfigError(f"{SETTINGS_FILE}: position must be given for every series or none, each number once")
    return [int(i) for i in np.argsort(positions)]


def _centre_px(settings: FolderSettings, size_px: tuple[int, int]) -> FloatArray:
    return np.asarray(settings.centre_px or [(size - 1) / 2 for size in size_px], float)


def _nominal_px(folder: Path, settings: FolderSettings, size_px: tuple[int, int]) -> FloatArray | None:
    """Nominal positions of the points, which must be on the detector."""
    width, height = size_px
    if settings.target is not None:
        path = find_files(folder, [settings.target], "target")[0]
        pair, values = _coordinates(path)
        if pair == "tan_x":
            values = _centre_px(settings, size_px) + values / (settings.pixel_arcsec * ARCSEC_RAD)
    elif settings.points_px:
        values = np.asarray(settings.points_px, float)
    else:
        return None
    off = np.any((values < 0) | (values > np.array([width, height]) - 1), axis=1)
    if off.any():
        x, y = values[int(np.argmax(off))]
        raise DomainError(
            f"{int(off.sum())} of {len(values)} target points lie off the detector, e.g. at column {x:.1f}, row "
            f"{y:.1f} of {width} x {height} px; correct their coordinates, centre_px or pixel_arcsec"
        )
    return values


def _coordinates(path: Path) -> tuple[str, FloatArray]:
    """Name of the first column and the coordinates (j, 2) of a CSV or ECSV file."""
    table = read_table(path)
    for pair in _COLUMNS:
        if set(pair) <= set(table):
            try:
                values = np.array([table[name] for name in pair], float).T
            except (TypeError, ValueError):
                values = np.zeros((0, 2))
            if len(values) and np.isfinite(values).all():
                return pair[0], values
            raise ConfigError(f"{path.name}: finite coordinates of at least one point are needed")
    raise ConfigError(f"{path.name}: columns x_px and y_px, or tan_x and tan_y, are needed; it has {list(table)}")


def _detected_px(
    settings: FolderSettings,
    group: FrameGroup,
    excluded: NDArray[np.bool_],
    dark: FrameGroup | None,
    reference: FloatArray | None,
    points: int | None,
) -> FloatArray:
    """Positions (j, 2) of the points in the mean frame of a series."""
    name = group.name
    image = sensor_image(
        group.mean.mean_dn if dark is None else group.mean.mean_dn - dark.mean.mean_dn + settings.offset_dn,
        gain_dn_per_e=settings.gain_dn_per_e,
        offset_dn=settings.offset_dn,
        read_noise_e=settings.read_noise_e / np.sqrt(group.mean.frames),
        defect=group.defect | excluded,
        quantised=False,
        source=name,
    )
    table = detect(image)
    table = table.select(~has_flag(table.flags, StarFlag.SPIKE)) if len(table) else table
    position = np.column_stack([table.x_px, table.y_px])
    wanted = (settings.points or points) if reference is None else len(reference)
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
        match_px=settings.match_px,
        where=name,
        unseen=f"correct the coordinates or raise match_px ({settings.match_px:g})",
        merged="lower match_px or move the points apart",
    )


def _cut(
    reader: FrameReader,
    files: Sequence[Path],
    name: str,
    corner: NDArray[np.int64],
    window_px: int,
    excluded: NDArray[np.bool_],
) -> tuple[WindowStack, tuple[str, ...], tuple[str, ...]]:
    """Windows of all frames of a series, with origin and digest of each frame."""
    s, dn, saturated = reader.settings, [], []
    sources: list[tuple[str, int]] = []
    digest: list[str] = []
    defect = cut_windows(excluded, corner, window_px)
    exposure_s, band = float("nan"), ""
    for path, frame in reader.frames(files, name):
        sources.append((path.name, frame.index))
        digest.append(blake2b(frame.dn.tobytes(), digest_size=16).hexdigest())
        cut = cut_windows(frame.dn, corner, window_px)
        full = cut_windows(frame.saturated, corner, window_px)
        dn.append(cut)
        saturated.append(full if s.saturation_dn is None else full | (cut.astype(float) >= s.saturation_dn))
        defect = defect | cut_windows(frame.defect, corner, window_px)
        exposure_s, band = frame.exposure_s, frame.band
    frames_of = Counter(file for file, _ in sources)
    origin = [f"{file}[{number}]" if frames_of[file] > 1 else file for file, number in sources]
    windows = WindowStack(
        dn=np.stack(dn),
        saturated=np.stack(saturated),
        defect=defect,
        corner_px=corner,
        gain_dn_per_e=s.gain_dn_per_e,
        offset_dn=s.offset_dn,
        read_noise_e=s.read_noise_e,
        exposure_s=exposure_s,
        band=band,
        first_index=0,
    )
    return windows, tuple(origin), tuple(digest)


def _taken(files: Sequence[Path]) -> tuple[str, ...]:
    """Text that sorts files by their exposure; () unless every file has its own."""
    headers = [image_header(path) for path in files]
    times = [header_time(header) for header in headers]
    instants = [None if time is None else time.utc.isoformat() for time in times]
    for values in (instants, [header.get("FRAMENUM") for header in headers]):
        if all(isinstance(value, str | int) for value in values) and len(set(values)) == len(values):
            return tuple(f"{value:012d}" if isinstance(value, int) else str(value) for value in values)
    return ()
