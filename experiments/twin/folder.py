"""The frames of a folder: files, times, and pointing of the mount."""

from __future__ import annotations

import os
import re
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from calib.measure.images.sensor_image import read_image
from calib.records import SensorImage
from optics.errors import ConfigError, StarbenchError

SUFFIXES = frozenset((".tif", ".tiff", ".png", ".jpg", ".jpeg", ".fits", ".fit", ".fts", ".npy", ".npz"))
PACKED = frozenset((".gz", ".bz2", ".xz"))
MOST_FRAMES = 500
_TIME = re.compile(r"(\d{4})-?(\d{2})-?(\d{2})[T_ -]?(\d{2})[-:_h]?(\d{2})[-:_m]?(\d{2})(\.\d+)?")
_POINTING = re.compile(r"Alt([-+]?\d+(?:\.\d+)?).?Azi?([-+]?\d+(?:\.\d+)?)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class NightFrame:
    """A frame and the data of its file."""

    name: str  # Of the file
    image: SensorImage  # In steps of the converter
    taken: datetime | None = None  # UTC
    altitude_deg: float | None = None  # Of the boresight, stated by the name of the file


def night_frames(folder: str | Path) -> tuple[tuple[NightFrame, ...], tuple[str, ...]]:
    """Frames of a folder in the order of their names, and notes on rejected files.

    Frames of the commonest size and converter step are taken; the notes name all other files.
    """
    folder = Path(folder)
    if not os.path.isdir(folder):
        raise ConfigError(
            f"--frames {folder}: no such folder; a folder of TIFF, PNG, JPEG, FITS or NumPy frames is needed"
        )
    paths, notes = _files(folder)
    frames = []
    for path in paths:
        try:
            image = read_image(path)
        except StarbenchError as error:
            notes.append(f"left out: {str(error).replace(str(folder) + os.sep, '')}")
            continue
        pointing = pointing_of(path.name)
        frames.append(
            NightFrame(
                name=path.name,
                image=image,
                taken=time_of(path.name) or time_of(image.conversion.taken if image.conversion else ""),
                altitude_deg=None if pointing is None else pointing[0],
            )
        )
    if not frames:
        reasons = f": {'; '.join(notes)}" if notes else ""
        raise ConfigError(f"--frames {folder}: no readable frame (TIFF, PNG, JPEG, FITS, NumPy) in it{reasons}")
    formats = Counter(_kind(frame) for frame in frames)
    common, count = formats.most_common(1)[0]
    for kind in formats:
        if kind != common:
            others = ", ".join(frame.name for frame in frames if _kind(frame) == kind)
            notes.append(
                f"frames of two cameras: {others} ({kind[1]} x {kind[0]} px, steps of {kind[2]:g}) left out; "
                f"{count} frames have {common[1]} x {common[0]} px, steps of {common[2]:g}"
            )
    return tuple(frame for frame in frames if _kind(frame) == common), tuple(notes)


def _kind(frame: NightFrame) -> tuple[int, int, float]:
    """Rows, columns and stored numbers per DN, the same for all frames of a camera."""
    conversion = frame.image.conversion
    return (*frame.image.dn.shape, conversion.step if conversion else 1.0)


def _files(folder: Path) -> tuple[list[Path], list[str]]:
    """Candidates by their suffix, and a note on each that is no regular file."""
    paths, notes = [], []
    for path in sorted(folder.iterdir()):
        suffix = Path(path.stem).suffix if path.suffix.lower() in PACKED else path.suffix
        if suffix.lower() not in SUFFIXES:
            continue
        if os.path.isfile(path):
            paths.append(path)
        else:
            reason = "a link to nothing that can be read" if path.is_symlink() else "no file"
            notes.append(f"left out: {path.name} is {reason}")
    if len(paths) > MOST_FRAMES:
        raise ConfigError(f"--frames {folder}: {len(paths)} frames; at most {MOST_FRAMES} are taken at once")
    return paths, notes


def time_of(text: str) -> datetime | None:
    """A time (UTC) in a name or a header: year, month, day, hour, minute, second."""
    match = _TIME.search(text or "")
    if match is None:
        return None
    fields = [int(part) for part in match.groups()[:6]]
    try:
        return datetime(*fields, int(float(match[7] or 0.0) * 1e6), tzinfo=UTC)  # type: ignore[misc, arg-type]
    except ValueError:
        return None


def pointing_of(name: str) -> tuple[float, float] | None:
    """Altitude and azimuth [deg] in a name such as ``Alt40_Azi-135``."""
    match = _POINTING.search(name)
    return None if match is None else (float(match[1]), float(match[2]))
