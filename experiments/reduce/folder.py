"""Frames from a laboratory: a folder of FITS files with ``frames.toml``, which assigns them.

A series is a number of frames of a target, or a star, at rest: a brightness level (temporal), a position (hsfe), a
session (distortion), a filter at a place (chromatic), a pose of the table (turntable, fisher). Points are detected in
the mean frame of each series; windows are cut around them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from calib.measure.detection.matched_filter import detect
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

    settings: SeriesSettings  # What the folder says of it
    windows: WindowStack  # The frames
    found_px: FloatArray  # (j, 2) Where the points were detected
    dark_e: FloatArray | None  # (j, h, w) Mean frame with the lamp off, offset included
    dark_frames: int  # How many are behind it
    response: FloatArray | None  # (j, h, w) The flat, and its standard deviation
    response_error: FloatArray | None  # (j, h, w)
    origin: tuple[str, ...]  # File of every frame, and its number there where it holds several
    digest: tuple[str, ...]  # Of all pixels of every frame
    taken: tuple[str, ...]  # When the files say that they were taken: DATE-OBS or FRAMENUM; () where some do not

    @property
    def name(self) -> str:
        """Name of the series in messages and tables."""
        return self.settings.name


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFolder:
    """A folder as read."""

    settings: FolderSettings  # Its ``frames.toml``
    width_px: int  # Size of the frames
    height_px: int
    nominal_px: FloatArray | None  # (j, 2) Nominal places of the target points, if stated
    series: tuple[FrameSeries, ...]  # Ordered by ``position`` where that is given
    dark_frames: int  # Frames with the lamp off
    flat: Flat | None = None  # Response of the pixels
    bad_pixels: int = 0  # Pixels that the map calls bad

    @property
    def centre_px(self) -> FloatArray:
        """Middle of the frames, or as stated in the folder."""
        middle = ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
        return np.asarray(self.settings.centre_px or middle, float)


def read_folder(folder: str | Path, *, window_px: int, layout: FolderLayout | None = None) -> FrameFolder:
    """Read a folder, find the points, cut windows."""
    folder, layout = Path(folder), layout or FolderLayout()
    settings = read_settings(folder)
    layout.check(settings)
    files = [find_files(folder, one.files, one.name) for one in settings.series]
    dark_files = [find_files(folder, one.dark or settings.dark, "dark") for one in settings.series]
    every_dark = list(dict.fromkeys(path for some in dark_files for path in some))
    flat_files = find_files(folder, settings.flat, "flat")
    refuse_shared([every_dark, flat_files, *files], ["dark", "flat", *(one.name for one in settings.series)])
    reader = FrameReader(settings)
    size_px = reader.size_of(files[0][0])
    bad = bad_pixels(reader, folder, settings)
    flat = mean_flat(reader, folder, settings, bad)
    nominal, excluded = _nominal_px(folder, settings, size_px), _excluded(size_px, bad, flat)
    darks: dict[tuple[Path, ...], FrameGroup] = {}
    filters: dict[str, SeriesSettings] = {}
    seen: dict[str, FloatArray] = {}
    corners: dict[str, NDArray[np.int64]] = {}
    series: list[FrameSeries] = []
    for number in _order(settings.series):
        own = settings.series[number]
        group = read_group(reader, files[number], own.name)
        _check_count(own, group.mean.frames, layout.fewest)
        _check_filter(own, group.band, filters)
        dark = None
        if paths := tuple(dark_files[number]):
            dark = darks.setdefault(paths, darks.get(paths) or read_group(reader, paths, "dark"))
            if not same(dark.exposure_s, group.exposure_s):
                raise DomainError(
                    f"{own.name}: exposed {group.exposure_s:g} s, its dark frames {dark.exposure_s:g} s; dark frames "
                    "must have the exposure time of the frames"
                )
        scene = {"all": "", "place": own.place, "none": own.name}[layout.same_scene]
        found = _find(settings, group, excluded, dark, seen.get(scene, nominal), layout.points)
        seen.setdefault(scene, found)
        advice = "move the target, or take a smaller window_px"
        corner = window_corners(found, window_px, size_px, where=own.name, advice=advice)
        if layout.same_scene == "place":  # the same pixels behind every filter: their patterns cancel in differences
            corner = corners.setdefault(scene, corner)
        gain = settings.gain_dn_per_e
        windows, origin, digest = _cut(reader, files[number], own.name, corner, window_px, excluded)
        series.append(
            FrameSeries(
                settings=own,
                windows=windows,
                origin=origin,
                digest=digest,
                taken=_taken(files[number]),
                found_px=found,
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
        dark_frames=sum(one.mean.frames for one in darks.values()),
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


def _check_filter(own: SeriesSettings, band: str, known: dict[str, SeriesSettings]) -> None:
    """A filter that the files name stands for one wavelength."""
    if own.filter_nm is None or not band:
        return
    first = known.setdefault(band, own)
    if first.filter_nm != own.filter_nm:
        raise ConfigError(
            f"{SETTINGS_FILE}: FILTER = {band!r} in the files of {first.name} and of {own.name}, filter_nm says "
            f"{first.filter_nm:g} and {own.filter_nm:g}; one of them is in the wrong series"
        )


def _order(series: Sequence[SeriesSettings]) -> list[int]:
    """Numbers of the series by position; as listed where none is given."""
    positions = [one.position for one in series]
    if all(p is None for p in positions):
        return list(range(len(series)))
    known = [p for p in positions if p is not None]
    if len(known) < len(series) or len(set(known)) < len(series):
        raise ConfigError(f"{SETTINGS_FILE}: position must be given for every series or none, each number once")
    return [int(i) for i in np.argsort(known)]


def _nominal_px(folder: Path, settings: FolderSettings, size_px: tuple[int, int]) -> FloatArray | None:
    """Nominal places of the points; they must be on the detector."""
    width, height = size_px
    if settings.target is not None:
        path = find_files(folder, [settings.target], "target")[0]
        pair, values = _coordinates(path)
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


def _excluded(size_px: tuple[int, int], bad: NDArray[np.bool_] | None, flat: Flat | None) -> NDArray[np.bool_]:
    """Pixels (h, w) that no frame may use."""
    excluded = np.zeros(size_px[::-1], bool)
    for more in (bad, None if flat is None else flat.response.unusable):
        excluded |= False if more is None else more
    return excluded


def _find(
    settings: FolderSettings,
    group: FrameGroup,
    excluded: NDArray[np.bool_],
    dark: FrameGroup | None,
    reference: FloatArray | None,
    points: int | None,
) -> FloatArray:
    """Places (j, 2) of the points in the mean frame of a series."""
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
    """Windows of all frames of a series, where each frame stands, and what tells it from all others."""
    s, dn, saturated = reader.settings, [], []
    held: list[tuple[str, int]] = []
    digest: list[str] = []
    defect = cut_windows(excluded, corner, window_px)
    exposure_s, band = float("nan"), ""
    for path, frame in reader.frames(files, name):
        held.append((path.name, frame.index))
        digest.append(blake2b(frame.dn.tobytes(), digest_size=16).hexdigest())
        cut = cut_windows(frame.dn, corner, window_px)
        full = cut_windows(frame.saturated, corner, window_px)
        dn.append(cut)
        saturated.append(full if s.saturation_dn is None else full | (cut.astype(float) >= s.saturation_dn))
        defect = defect | cut_windows(frame.defect, corner, window_px)
        exposure_s, band = frame.exposure_s, frame.band
    several = Counter(file for file, _ in held)
    origin = [f"{file}[{number}]" if several[file] > 1 else file for file, number in held]
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
    """Text by which files are in the order of their exposure; () where a file does not say, or two say the same."""
    for card in ("DATE-OBS", "FRAMENUM"):
        said = [image_header(path).get(card) for path in files]
        if all(isinstance(one, str | int) for one in said) and len(set(said)) == len(said):
            return tuple(f"{one:012d}" if isinstance(one, int) else str(one) for one in said)
    return ()
