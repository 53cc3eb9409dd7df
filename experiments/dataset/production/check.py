"""``dataset check``: whether every file of a dataset is as it was written, and what a run would make again."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from operator import ne
from pathlib import Path

from experiments.dataset.production.complete import in_words
from experiments.dataset.production.folder import (
    IDENTITY,
    OWN_FOLDERS,
    SUMS,
    checked_frame,
    file_digest,
    frame_files,
    held_identity,
    numbers,
)
from experiments.harness.progress import Progress
from experiments.harness.system import prompt_pool
from optics.errors import ConfigError

__all__ = ["Checked", "check"]

_LINE = re.compile(r"([0-9a-f]{64})  ((?!.*[0-9a-f]{64})[^\s\x00-\x1f][^\x00-\x1f]*)")  # one line each, not two
_FRAME = re.compile(r"(?:frames|truth)/frame_(\d{6,10})\.\w+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked:
    """What was found."""

    files: int  # Files that are as they were written
    damaged: tuple[str, ...]  # Names of those that are not, and of those that are gone
    missing: tuple[str, ...]  # Names of those that are not, and of those that are gone
    unlisted: tuple[str, ...]  # Frames that no list covers, as after an interrupted run; they vouch for themselves
    foreign: tuple[str, ...]  # Files that no run wrote; not told where the list is damaged
    frames: tuple[int, ...]  # Frames that a run would make again

    def lines(self) -> list[str]:
        """In words."""
        said = [f"damaged: {name}" for name in self.damaged] + [f"missing: {name}" for name in self.missing]
        if self.unlisted:
            said.append(f"{len(self.unlisted)} files of frames are whole and in no list yet: the run was interrupted")
        said += [f"not of the dataset: {name}" for name in self.foreign[:20]]
        others = [name for name in (*self.damaged, *self.missing) if not _FRAME.fullmatch(name)]
        again = [f"frames {in_words(self.frames)}"] if self.frames else []
        again += ["what is written at the end of a run, exports included"] if others else []
        if again:
            said.append(f"the same command makes again: {'; '.join(again)}")
        return [*said, f"{self.files} files are whole"]


def check(folder: Path, progress: Progress) -> Checked:
    """Read every file of a dataset."""
    if not os.path.isdir(folder):
        raise ConfigError(f"{folder}: no such folder")
    origin, listed = held_identity(folder), _listed(folder)
    if origin is None and not listed:
        raise ConfigError(f"{folder}: is no dataset: neither {IDENTITY} nor {SUMS} nor a truth file tells of one")
    truth = _truth_format(folder)
    there = {
        file.relative_to(folder).as_posix()
        for part in (folder, *(folder / name for name in OWN_FOLDERS))
        for file in (part.rglob("*") if part != folder else part.iterdir())
        if file.is_file() and not file.name.startswith(".")
    }
    frames = numbers(folder)
    with prompt_pool() as pool:
        records = pool.map(lambda frame: checked_frame(folder, frame, truth), frames)
        records = progress.track(records, "frames", total=len(frames))
        whole = {one.frame for one in records if one is not None}
        names = sorted(there & set(listed))
        digests = progress.track(pool.map(lambda name: file_digest(folder / name), names), "files", total=len(names))
        off = {name: digest for name, digest in zip(names, digests, strict=True) if digest != listed[name]}
    # digests of different content are far apart: a single other digit is a fault of the list
    bad = {SUMS if _near(digest, listed[name]) else name for name, digest in off.items()}
    sound = {name for frame in whole for name in frame_files(frame, truth)}
    for frame in set(frames) - whole:
        pair = set(frame_files(frame, truth))
        bad |= (pair - there) or (set() if bad & pair else {frame_files(frame, truth)[1]})
    if bad & sound:  # the files vouch for themselves, so it is the list that is wrong
        bad = (bad - sound) | {SUMS}
    if IDENTITY in there and not _agrees(folder, origin):
        bad.add(IDENTITY)
    misspelt = {name for name in set(listed) - there if _misspelt(folder, name, listed[name], there - set(listed))}
    missing = ({name for name in listed if name not in there} | (bad - there)) - misspelt
    if SUMS in there and (misspelt or not _all_lines(folder)):
        bad.add(SUMS)
    again = {int(found[1]) for found in map(_FRAME.fullmatch, bad | missing) if found}
    return Checked(
        files=len(there - bad),
        damaged=tuple(sorted(bad - missing)),
        missing=tuple(sorted(missing)),
        unlisted=tuple(sorted(sound - set(listed))),
        foreign=tuple(sorted(there - set(listed) - sound - bad - {SUMS, IDENTITY}))
        if listed and SUMS not in bad
        else (),
        frames=tuple(sorted(again)),
    )


def _listed(folder: Path) -> dict[str, str]:
    """Digests by name of ``SHA256SUMS``, without lines that are none."""
    try:
        text = (folder / SUMS).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return {}
    found = map(_LINE.fullmatch, text.split("\n")[:-1])
    return {one[2]: one[1] for one in found if one and not one[2].startswith("/") and ".." not in one[2].split("/")}


def _all_lines(folder: Path) -> bool:
    *lines, rest = (folder / SUMS).read_bytes().decode(errors="replace").split("\n")
    return bool(lines) and not rest and all(map(_LINE.fullmatch, lines))


def _misspelt(folder: Path, name: str, digest: str, others: set[str]) -> bool:
    """Whether a file that is gone is there under a name of one other character: then it is the list that is wrong."""
    return any(_near(name, other) and file_digest(folder / other) == digest for other in others)


def _near(one: str, other: str) -> bool:
    return len(one) == len(other) and sum(map(ne, one, other)) == 1


def _truth_format(folder: Path) -> str:
    return "ecsv" if any((folder / "truth").glob("*.ecsv")) else "parquet"


def _agrees(folder: Path, origin: Mapping[str, object] | None) -> bool:
    try:
        return bool(json.loads((folder / IDENTITY).read_text(encoding="utf-8")) == origin)
    except (OSError, ValueError, RecursionError):
        return False
