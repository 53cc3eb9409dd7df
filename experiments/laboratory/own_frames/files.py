"""Frames of a folder, one at a time: patterns become files, files become frames, frames that do not fit are refused."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath

from experiments.laboratory.own_frames.settings import SETTINGS_FILE, FolderSettings
from optics.errors import ConfigError, DomainError
from render.fits.files import read_frames
from render.records import Frame

__all__ = ["FrameReader", "find_files", "refuse_shared", "same"]

SAME_EXPOSURE = 0.01
"""Exposure times that differ by less than this part of each other are the same."""


def find_files(folder: Path, patterns: Sequence[str], name: str) -> list[Path]:
    """Files of patterns in the order of the patterns, each once."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        steps = PurePosixPath(pattern)
        if steps.is_absolute() or PureWindowsPath(pattern).drive or ".." in steps.parts or not steps.parts:
            raise ConfigError(f"{SETTINGS_FILE}, {name}: {pattern!r} is not within the folder; name files in it")
        many = any(sign in pattern for sign in "*?[")
        here = sorted(p for p in folder.glob(pattern) if os.path.isfile(p)) if many else [folder / pattern]
        if not here or not all(map(os.path.isfile, here)):
            raise ConfigError(f"{SETTINGS_FILE}, {name}: no file {pattern!r} in the folder {folder}")
        found.update(dict.fromkeys(here))
    return list(found)


def refuse_shared(groups: Sequence[Sequence[Path]], names: Sequence[str]) -> None:
    """Refuse files that belong to two groups."""
    owner: dict[Path, str] = {}
    for group, name in zip(groups, names, strict=True):
        for path in group:
            if path in owner:
                raise ConfigError(
                    f"{SETTINGS_FILE}: {path.name} belongs to {owner[path]} and to {name}; a frame has one"
                )
            owner[path] = name


@dataclass(slots=True)
class FrameReader:
    """Reads frames one at a time: a series of large frames need not fit into memory."""

    settings: FolderSettings  # Of the folder
    size_px: tuple[int, int] | None = None  # (int, int) Columns and rows of all its frames; known from the first one on
    first: str = ""  # Which file that was

    def size_of(self, path: Path) -> tuple[int, int]:
        """Columns and rows of the first frame of a file."""
        frame = next(self.frames([path], path.name))
        return int(frame.dn.shape[1]), int(frame.dn.shape[0])

    def frames(self, files: Sequence[Path], name: str) -> Iterator[Frame]:
        """Frames of files, planes of cubes and extensions included."""
        s = self.settings
        before: tuple[Path, Frame] | None = None
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
                if before is not None:
                    _refuse_mixed(before, (path, frame), name)
                before = before or (path, frame)
                yield frame


def _refuse_mixed(first: tuple[Path, Frame], other: tuple[Path, Frame], name: str) -> None:
    for label, unit, one, two in (
        ("exposure time", " s", first[1].exposure_s, other[1].exposure_s),
        ("filter", "", first[1].band, other[1].band),
    ):
        if not same(one, two):
            raise DomainError(
                f"{name}: {other[0].name} has the {label} {two}{unit}, {first[0].name} {one}{unit}; one series has one"
            )


def same(one: float | str, two: float | str) -> bool:
    """Whether exposure times or filters agree, as far as both are known."""
    if isinstance(one, str) or isinstance(two, str):
        return one == two or not one or not two
    return math.isnan(one) or math.isnan(two) or abs(one - two) <= SAME_EXPOSURE * max(abs(one), abs(two))
