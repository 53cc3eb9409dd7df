"""The frames of a folder: files, times, and pointing of the mount."""

from __future__ import annotations

import os
import re
from collections import Counter
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from calib.measure.images.exposure_time import name_time
from calib.measure.images.sensor_image import read_image
from calib.records import ExposureTime, SensorImage
from optics.errors import ConfigError, StarbenchError

SUFFIXES = frozenset(
    (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".fits", ".fit", ".fts", ".npy", ".npz")
)
PACKED = frozenset((".gz", ".bz2", ".xz", ".fz"))
MOST_FRAMES = 500
_SAME_TIME = timedelta(minutes=5)
"""Difference of two times of a frame, an exposure included, that is no zone and no other night."""
_POINTING = re.compile(r"Alt([-+]?\d+(?:\.\d+)?).?Azi?([-+]?\d+(?:\.\d+)?)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class NightFrame:
    """A frame and the data of its file."""

    name: str  # Name of the file
    image: SensorImage  # Image in DN
    taken: datetime | None = None  # Middle of the exposure, UTC
    altitude_deg: float | None = None  # Altitude of the boresight, stated by the file name


def night_frames(folder: str | Path) -> tuple[tuple[NightFrame, ...], tuple[str, ...]]:
    """Frames of a folder in the order of their names, and notes on rejected files.

    Frames of the commonest size and converter step are taken; the notes name all other files.
    """
    folder = Path(folder)
    if not os.path.isdir(folder):
        raise ConfigError(
            f"--frames {folder}: no such folder; a folder of TIFF, PNG, JPEG, PGM, PPM, FITS or NumPy frames is needed"
        )
    paths, notes = _files(folder)
    frames: list[NightFrame] = []
    readings: dict[str, list[str]] = {}
    for path in paths:
        try:
            image = read_image(path)
        except StarbenchError as error:
            notes.append(f"left out: {str(error).replace(str(folder) + os.sep, '')}")
            continue
        pointing = pointing_of(path.name)
        taken, reading = _time(path.name, image)
        readings.setdefault(reading, []).append(path.name)
        frames.append(
            NightFrame(
                name=path.name,
                image=image,
                taken=None if taken is None else taken.utc,
                altitude_deg=None if pointing is None else pointing[0],
            )
        )
    for reading, names in readings.items():
        if reading:
            notes.append(f"time of {names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: {reading}")
    if not frames:
        reasons = f": {'; '.join(notes)}" if notes else ""
        raise ConfigError(
            f"--frames {folder}: no readable frame (TIFF, PNG, JPEG, PGM, PPM, FITS, NumPy) in it{reasons}"
        )
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


def _time(name: str, image: SensorImage) -> tuple[ExposureTime | None, str]:
    """Time of a frame, and a note where its reading is uncertain.

    The header overrules the name, unless only the name states a zone.
    """
    header = image.conversion.taken if image.conversion else None
    stated = name_time(name, image.exposure_s)
    times = sorted((time for time in (header, stated) if time), key=lambda time: not time.zone_stated)
    if not times:
        return None, ""
    taken, note = times[0], ""
    if not taken.zone_stated:
        note = f"{taken.source} states no time zone, read as UTC; in another zone the zenith is off by 15 deg/h"
    if len(times) == 2 and abs(times[0].utc - times[1].utc) > _SAME_TIME:
        difference = f"{(times[1].utc - taken.utc) / timedelta(hours=1):+.2f} h"
        note = f"{note or taken.source}; {times[1].source} differs by {difference} and is not used"
    return taken, note


def pointing_of(name: str) -> tuple[float, float] | None:
    """Altitude and azimuth [deg] in a name such as ``Alt40_Azi-135``."""
    match = _POINTING.search(name)
    return None if match is None else (float(match[1]), float(match[2]))
