"""Frames of a folder, read one at a time, and their means: dark frames, flats, bad-pixel maps.

As in `ccdproc`: a frame minus the mean dark frame, over the mean flat (dark-subtracted, over its mean). The noise of
the mean dark frame and of the flat falls with their number of frames; both shift a centroid equally in every frame of
a series.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from calib.detector.fixed_pattern import FlatResponse, flat_response
from calib.detector.mean_frame import MeanFrame, mean_frame
from calib.detector.photon_transfer import PhotonTransfer, flat_photon_transfer
from calib.records import NoiseModel
from experiments.reduce.frames_toml import SETTINGS_FILE, FolderSettings
from optics.errors import ConfigError, DomainError
from render.fits.files import read_frames
from render.records import Frame

SAME_EXPOSURE = 0.01
"""Largest relative difference of equal exposure times."""


def find_files(folder: Path, patterns: Sequence[str], name: str) -> list[Path]:
    """Files of patterns in the order of the patterns, each once."""
    files: dict[Path, None] = {}
    for pattern in patterns:
        steps = PurePosixPath(pattern)
        if steps.is_absolute() or PureWindowsPath(pattern).drive or ".." in steps.parts or not steps.parts:
            raise ConfigError(f"{SETTINGS_FILE}, {name}: {pattern!r} is not within the folder; name files in it")
        wildcard = any(sign in pattern for sign in "*?[")
        matches = sorted(folder.glob(pattern), key=_natural) if wildcard else [folder / pattern]
        if not matches or not all(map(os.path.lexists, matches)):
            raise ConfigError(f"{SETTINGS_FILE}, {name}: no file {pattern!r} in the folder {folder}")
        for path in matches:
            if not os.path.isfile(path):
                raise ConfigError(
                    f"{SETTINGS_FILE}, {name}: {path.name}, which {pattern!r} names, is {_kind(path)}; only files "
                    "can be read: remove it or narrow the pattern"
                )
        files.update(dict.fromkeys(matches))
    return list(files)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Order of names with numbers: a_2 before a_10."""
    parts = re.findall(r"\d+|\D+", str(path))
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in parts]


def _kind(path: Path) -> str:
    if os.path.isdir(path):
        return "a folder"
    if os.path.islink(path) and not os.path.exists(path):
        return f"a link to {os.readlink(path)}, which is not there"
    return "a device, pipe or socket"


def refuse_shared(groups: Sequence[Sequence[Path]], names: Sequence[str]) -> None:
    """Refuse files that belong to two groups."""
    owner: dict[Path, str] = {}
    for group, name in zip(groups, names, strict=True):
        for path in group:
            if path in owner:
                raise ConfigError(
                    f"{SETTINGS_FILE}: {path.name} belongs to {owner[path]} and to {name}; a frame belongs to one "
                    "series"
                )
            owner[path] = name


@dataclass(slots=True)
class FrameReader:
    """Reads frames one at a time: a series of large frames need not fit into memory."""

    settings: FolderSettings
    size_px: tuple[int, int] | None = None  # Columns and rows of all frames, from the first one
    first: str = ""  # Name of its file

    def size_of(self, path: Path) -> tuple[int, int]:
        """Columns and rows of the first frame of a file."""
        _, frame = next(self.frames([path], path.name))
        return int(frame.dn.shape[1]), int(frame.dn.shape[0])

    def frames(self, files: Sequence[Path], name: str) -> Iterator[tuple[Path, Frame]]:
        """Frames of files with their paths, planes of cubes and extensions included."""
        s = self.settings
        reference: tuple[Path, Frame] | None = None
        for path in files:
            for frame in read_frames(
                path, gain_dn_per_e=s.gain_dn_per_e, offset_dn=s.offset_dn, read_noise_e=s.read_noise_e
            ):
                height, width = frame.dn.shape
                if self.size_px is None:
                    self.size_px, self.first = (width, height), path.name
                if (width, height) != self.size_px:
                    raise DomainError(
                        f"{path.name} has {width} x {height} px, {self.first} {self.size_px[0]} x {self.size_px[1]} "
                        "px; all frames of a folder must have one size"
                    )
                reference = reference or (path, frame)
                _refuse_mixed(reference, (path, frame), name)
                yield path, frame


def _refuse_mixed(first: tuple[Path, Frame], other: tuple[Path, Frame], name: str) -> None:
    for label, unit, a, b in (
        ("exposure time", " s", first[1].exposure_s, other[1].exposure_s),
        ("filter", "", first[1].band, other[1].band),
    ):
        if not same(a, b):
            raise DomainError(
                f"{name}: {other[0].name} has the {label} {b}{unit}, {first[0].name} {a}{unit}; a series must "
                "have a single one"
            )


def same(a: float | str, b: float | str) -> bool:
    """Whether exposure times or filters agree, or one of them is unknown."""
    if isinstance(a, str) or isinstance(b, str):
        return a == b or not a or not b
    return math.isnan(a) or math.isnan(b) or math.isclose(a, b, rel_tol=SAME_EXPOSURE)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameGroup:
    """Mean of the frames of a group of files, and their metadata."""

    name: str  # For messages
    mean: MeanFrame
    exposure_s: float  # NaN if unknown
    band: str  # FILTER of the files
    defect: NDArray[np.bool_]  # (h, w) In any of the frames
    saturated: NDArray[np.bool_]  # (h, w) In any of the frames


@dataclass(frozen=True, slots=True, kw_only=True)
class Flat:
    """The flats of a folder."""

    response: FlatResponse
    frames: int
    transfer: PhotonTransfer | None  # None of a single flat


def read_group(reader: FrameReader, files: Sequence[Path], name: str) -> FrameGroup:
    """Mean of the frames of files, and their metadata."""
    last: list[Frame] = []
    masks: list[NDArray[np.bool_]] = []

    def pixels() -> Iterator[NDArray[np.uint16]]:
        for _, frame in reader.frames(files, name):
            masks[:] = [frame.defect | (masks[0] if masks else False), frame.saturated | (masks[1] if masks else False)]
            last[:] = [frame]
            yield frame.dn

    mean = mean_frame(pixels())
    return FrameGroup(
        name=name,
        mean=mean,
        exposure_s=last[0].exposure_s,
        band=last[0].band,
        defect=masks[0],
        saturated=masks[1],
    )


def mean_flat(
    reader: FrameReader, folder: Path, settings: FolderSettings, bad: NDArray[np.bool_] | None
) -> Flat | None:
    """The flat of a folder, if any."""
    if not settings.flat:
        return None
    light = read_group(reader, find_files(folder, settings.flat, "flat"), "flat")
    fraction = float((light.saturated | (light.mean.mean_dn >= (settings.saturation_dn or 65535.0))).mean())
    if fraction > 0.01:
        raise DomainError(f"{SETTINGS_FILE}, flat: {fraction:.0%} of the pixels are saturated; expose the flats less")
    patterns = settings.flat_dark or settings.dark
    noise = NoiseModel(read_noise_e=settings.read_noise_e, gain_dn_per_e=settings.gain_dn_per_e, quantised=True)
    if patterns:
        group = read_group(reader, find_files(folder, patterns, "flat_dark"), "flat_dark")
        if not same(group.exposure_s, light.exposure_s):
            raise DomainError(
                f"{SETTINGS_FILE}, flat: exposed {light.exposure_s:g} s, its dark frames {group.exposure_s:g} s; give "
                "flat_dark, frames with the lamp off exposed as the flats"
            )
        dark = group.mean
    else:
        dark = mean_frame([np.full(light.mean.mean_dn.shape, settings.offset_dn)])
    response = flat_response(
        noise.to_electrons(light.mean.mean_dn - dark.mean_dn),
        ~(light.defect | light.saturated | (False if bad is None else bad)),
        floor_e2=noise.floor_e2,
        flats=light.mean.frames,
        darks=dark.frames if patterns else 0,
    )
    if response.level_e <= 10.0 * np.sqrt(noise.floor_e2):
        raise DomainError(
            f"{SETTINGS_FILE}, flat: {response.level_e:.0f} e- above the dark frames, with a read noise of "
            f"{settings.read_noise_e:g} e-; brighter flats are needed"
        )
    transfer = None
    if light.mean.frames > 1:
        stated_dn2 = None if dark.frames > 1 else noise.floor_e2 * settings.gain_dn_per_e**2
        transfer = flat_photon_transfer([light.mean], dark, usable=~response.unusable, dark_variance_dn2=stated_dn2)
    return Flat(response=response, frames=light.mean.frames, transfer=transfer)


def bad_pixels(reader: FrameReader, folder: Path, settings: FolderSettings) -> NDArray[np.bool_] | None:
    """The bad-pixel map of a folder, if any: a FITS image, non-zero at bad pixels."""
    if settings.bad_pixels is None:
        return None
    path = find_files(folder, [settings.bad_pixels], "bad_pixels")[0]
    try:
        values = np.squeeze(np.asarray(fits.getdata(path)))
    except (OSError, ValueError, TypeError, IndexError) as error:
        raise ConfigError(f"{path.name}: not a readable FITS image ({str(error).splitlines()[0][:160]})") from None
    assert reader.size_px is not None
    width, height = reader.size_px
    if values.shape != (height, width):
        raise DomainError(
            f"{path.name} has the shape {values.shape}, the frames {width} x {height} px; a bad-pixel map has one "
            "value for every pixel"
        )
    return np.asarray(~(values == 0))
