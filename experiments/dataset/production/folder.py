"""The folder of a dataset: what is in it is whole, and what was made stays.

A file is written beside its place and moved there by one rename. A frame counts as made when its truth file is there,
which is written last and holds size and digest of the frame's file, and both are as it says; so neither ``kill -9`` nor
a full disk nor a lost machine can leave anything that would be taken for a frame and is none.
``dataset.json`` comes first and says which configuration the frames are of; every truth file says it too, so that it
can be written anew. ``SHA256SUMS`` comes last and covers every file. Nothing is deleted but temporary files whose names
only this program gives; frames that nobody vouches for are only ever replaced by the same frames.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from experiments.dataset.production.identity import FORMAT_VERSION
from experiments.dataset.truth.files import read_origin, read_record
from experiments.dataset.truth.frame_record import FrameRecord
from experiments.harness.outputs import flat, shown_value
from experiments.harness.summary import dumps
from experiments.harness.system import lock_folder
from optics.errors import ConfigError

__all__ = [
    "FRAMES",
    "IDENTITY",
    "SUMS",
    "TRUTH",
    "DatasetFolder",
    "StorageError",
    "checked_frame",
    "file_digest",
    "frame_files",
    "held_identity",
    "numbered",
    "numbers",
    "sum_lines",
    "write_whole",
]

IDENTITY, FRAMES, TRUTH, SUMS = "dataset.json", "frames", "truth", "SHA256SUMS"
OWN_FOLDERS = (FRAMES, TRUTH, "calibration", "coco", "webdataset")
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NUMBERED = re.compile(r"frame_(\d{6,10})\.(?:parquet|ecsv)")
_FRAME = re.compile(r"frame_(\d{6,10})\.fits")
_TEMPORARY = re.compile(
    r"\.(frame_\d{6,10}\.fits\.[a-z0-9_]{8}|[\w.-]+\.\d+-\d+\.partial|[\w-]+\.tar\.\d+\.partial"
    r"|token-[0-9a-f]{16}\.partial)"
)
_STAGING = re.compile(r"\.starbench-report-[a-z0-9_]{8}")
_COUNT = itertools.count()


class StorageError(ConfigError):
    """Something cannot be written: no room, no right, no disk. What was written before is kept."""


def frame_files(frame: int, truth: str) -> tuple[str, str]:
    """Names of frame and truth, relative to the folder; ``truth`` is the truth's format."""
    return f"{FRAMES}/frame_{frame:06d}.fits", f"{TRUTH}/frame_{frame:06d}.{truth}"


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place and move it there."""
    beside = path.with_name(f".{path.name}.{os.getpid()}-{next(_COUNT)}.partial")
    try:
        try:
            with beside.open("xb", buffering=0) as stream:
                view = memoryview(content)
                while view:
                    view = view[stream.write(view) :]
            os.replace(beside, path)
        finally:
            with contextlib.suppress(OSError):
                beside.unlink()
    except OSError as error:
        raise storage_error(path, error) from None


def storage_error(path: Path, error: OSError) -> StorageError:
    """The error for a file that could not be written, in words."""
    if error.errno in _FULL:
        return StorageError(f"{path.name} cannot be written: the disk is full")
    return StorageError(f"{path.name} cannot be written ({error.strerror or error})")


def numbers(folder: Path) -> list[int]:
    """Frames that a dataset has, as its truth files say, in their order; the files are not looked into."""
    try:
        names = os.listdir(folder / TRUTH)
    except OSError:
        return []
    return sorted(int(found.group(1)) for found in map(_NUMBERED.fullmatch, names) if found)


def numbered(name: str) -> bool:
    """Whether a name, relative to the dataset, is that of a truth file."""
    folder, _, file = name.rpartition("/")
    return folder == TRUTH and bool(_NUMBERED.fullmatch(file))


def held_identity(folder: Path) -> dict[str, Any] | None:
    """Format, software and configuration of a dataset: from its first whole truth, which vouches for itself.

    Of a dataset without frames from ``dataset.json``; None where neither says it.
    """
    for path in sorted((folder / TRUTH).glob("frame_*")):
        with contextlib.suppress(ConfigError):
            return read_origin(path)
    try:
        held = json.loads((folder / IDENTITY).read_text(encoding="utf-8"))
        return held if isinstance(held, dict) and {"format", "software", "config"} <= set(held) else None
    except (OSError, ValueError, RecursionError):
        return None


def file_digest(path: Path) -> str:
    """SHA-256 of a file; errors as OSError."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sum_lines(folder: Path, known: Mapping[str, str]) -> str:
    """Text of ``SHA256SUMS`` for all files of a dataset, as ``sha256sum --check`` reads it; hidden files are left out."""
    names = sorted(
        file.relative_to(folder).as_posix()
        for part in (folder, *(folder / name for name in OWN_FOLDERS))
        for file in (part.rglob("*") if part != folder else part.iterdir())
        if file.is_file() and not file.name.startswith(".")
    )
    names = sorted({*names, *known} - {SUMS})
    with ThreadPoolExecutor() as pool:
        digests = pool.map(lambda name: known.get(name) or file_digest(folder / name), names)
        return "".join(f"{digest}  {name}\n" for digest, name in zip(digests, names, strict=True))


def checked_frame(folder: Path, frame: int, truth: str) -> FrameRecord | None:
    """Record of a frame if it is there and whole, otherwise None."""
    frame_name, truth_name = frame_files(frame, truth)
    try:
        record = read_record(folder / truth_name)
        if (record.frame, record.file, record.truth) != (frame, frame_name, truth_name):
            return None
        content = (folder / frame_name).read_bytes()
    except (ConfigError, OSError):
        return None
    if len(content) != record.frame_bytes or hashlib.sha256(content).hexdigest() != record.sha256:
        return None
    return record


class DatasetFolder:
    """A dataset on disk, new or begun.

    Making the object only looks: it refuses a folder that holds something else, and changes nothing.

    Attributes
    ----------
    repaired : str
        What `open` mended, in words; empty if nothing.
    digests : dict
        SHA-256 of files by name, as far as they are known; `writing` reads the others.
    """

    url = ""
    """Where it is, if that is no folder (`experiments.dataset.production.remote`)."""
    only_here = False
    """Whether other processes cannot write it."""

    def __init__(
        self, path: str | Path, *, config: Mapping[str, Any], frames: int, truth: str, shown: str = ""
    ) -> None:
        self.shown = shown or str(path)
        self.path = Path(os.path.realpath(path))
        self.frames, self.truth = frames, truth
        self.repaired = ""
        self.digests: dict[str, str] = {}
        self._config = dict(config)
        self._lock: int | None = None
        try:
            self._look()
        except OSError as error:
            raise ConfigError(f"{self.shown}: cannot be read ({error.strerror})") from None

    @property
    def interrupted(self) -> str:
        """What to say after an interrupt."""
        return f"interrupted; {self.count()} of {self.frames} frames are kept, the same command continues"

    def count(self) -> int:
        """Frames there are, as their truth files say; they are not looked into."""
        return len(numbers(self.path))

    def checked(self, frame: int) -> FrameRecord | None:
        """Record of a frame if it is there and whole, otherwise None."""
        return checked_frame(self.path, frame, self.truth)

    def fetch(self, names: Iterable[str]) -> None:
        """See to it that files of the dataset are in its folder: here they are."""

    def open(self, software: Mapping[str, str]) -> None:
        """Make the folder, or take it up again; from here on it is this process's."""
        identity: dict[str, Any] = {"format": FORMAT_VERSION, "software": dict(software), "config": self._config}
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._take_lock()
            self._clear()
            if self._holds_frames():
                self._compare(identity)
            if not self._says(identity):
                if self.count():
                    was = "damaged" if (self.path / IDENTITY).exists() else "gone"
                    self.repaired = f"{IDENTITY} was {was} and is written anew from the truth of the frames"
                write_whole(self.path / IDENTITY, dumps(identity).encode())
            for name in (FRAMES, TRUTH):
                (self.path / name).mkdir(exist_ok=True)
        except OSError as error:
            raise StorageError(f"{self.shown}: cannot be written ({error.strerror})") from None

    def check_room(self, needed_bytes: float) -> None:
        """Refuse what surely does not fit."""
        free = shutil.disk_usage(self.path).free
        if needed_bytes > free:
            raise StorageError(
                f"{self.shown}: needs {needed_bytes / 1e9:.3g} GB more, its disk has {free / 1e9:.3g} GB left; make "
                "room, ask for fewer frames, or set files.compression = rice in a new dataset"
            )

    def close(self) -> None:
        """Let others write here. A folder in which no frame was made is left as if it had not been opened."""
        if self._lock is None:
            return
        with contextlib.suppress(OSError):
            self._clear()
        if not self.count():
            with contextlib.suppress(OSError):
                for folder in (self.path / FRAMES, self.path / TRUTH):
                    folder.rmdir()
                (self.path / IDENTITY).unlink()
                self.path.rmdir()
        os.close(self._lock)
        self._lock = None

    @contextlib.contextmanager
    def writing(self) -> Iterator[Path]:
        """Folder for the files that are written at the end; they then take their places, one by one."""
        try:
            staging = Path(tempfile.mkdtemp(prefix=".starbench-report-", dir=self.path))
        except OSError as error:
            raise storage_error(self.path, error) from None
        try:
            yield staging
            for file in sorted(staging.iterdir(), key=lambda f: f.name == "provenance.json"):
                os.replace(file, self.path / file.name)
            write_whole(self.path / SUMS, sum_lines(self.path, self.digests).encode())
        except OSError as error:
            raise storage_error(self.path / str(error.filename or ""), error) from None
        finally:
            shutil.rmtree(staging, ignore_errors=True)
            self.close()

    def _look(self) -> None:
        if not self.path.exists():
            return
        if not self.path.is_dir():
            raise ConfigError(f"{self.shown}: is a file; name a folder")
        links = [name for name in OWN_FOLDERS if (self.path / name).is_symlink()]
        if links:
            raise ConfigError(
                f"{self.shown}: {links[0]} is a link to elsewhere; a dataset keeps its files in its own folder: name "
                "the folder that holds them, or put them there"
            )
        if not (self.path / IDENTITY).exists() and not self.count():
            foreign = [f.name for f in self.path.iterdir() if not _TEMPORARY.fullmatch(f.name)]
            foreign = [name for name in foreign if name not in (FRAMES, TRUTH) or any((self.path / name).iterdir())]
            if foreign:
                raise ConfigError(
                    f"{self.shown}: holds {min(foreign)}{' and more' if len(foreign) > 1 else ''} but no {IDENTITY}, "
                    "so it is no dataset; name another folder or empty it"
                )
            return
        if self._holds_frames():
            self._compare({"format": FORMAT_VERSION, "config": self._config})
        most = max(numbers(self.path), default=-1) + 1
        if most > self.frames:
            raise ConfigError(
                f"{self.shown}: holds frames up to number {most - 1}, frames = {self.frames} are asked for; a dataset "
                f"only grows: ask for at least {most}, or name another folder"
            )

    def _compare(self, wanted: Mapping[str, Any]) -> None:
        """Refuse a dataset of another configuration, naming the first key that differs."""
        held = held_identity(self.path)
        if held is None:
            raise ConfigError(
                f"{self.shown}: neither {IDENTITY} nor a truth file says of which dataset its frames are; name another "
                "folder"
            )
        before = flat({name: held[name] for name in wanted})
        now = flat(json.loads(dumps(wanted)))
        for key in (*now, *(key for key in before if key not in now)):
            if before.get(key) != now.get(key):
                name = key.removeprefix("config.")
                raise ConfigError(
                    f"{self.shown}: holds a dataset with {name} = {shown_value(before, key)}, this run has "
                    f"{shown_value(now, key)}; name another folder or take the same configuration"
                )

    def _holds_frames(self) -> bool:
        """Whether there is anything that must be of this dataset: truth, or frames that lost theirs."""
        if self.count():
            return True
        with contextlib.suppress(OSError):
            return any(map(_FRAME.fullmatch, os.listdir(self.path / FRAMES)))
        return False

    def _says(self, identity: Mapping[str, Any]) -> bool:
        try:
            return bool(json.loads((self.path / IDENTITY).read_text(encoding="utf-8")) == json.loads(dumps(identity)))
        except (OSError, ValueError, RecursionError):
            return False

    def _take_lock(self) -> None:
        try:
            self._lock = lock_folder(self.path)
        except BlockingIOError:
            raise ConfigError(f"{self.shown}: another run is writing here; wait for it, or end it") from None

    def _clear(self) -> None:
        """Remove temporary files of processes that were killed."""
        for folder in (self.path, self.path / FRAMES, self.path / TRUTH):
            for file in folder.iterdir() if folder.exists() else ():
                if _TEMPORARY.fullmatch(file.name):
                    file.unlink(missing_ok=True)
                elif _STAGING.fullmatch(file.name):
                    shutil.rmtree(file, ignore_errors=True)
