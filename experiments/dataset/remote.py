"""A dataset at a URL (``s3://``, ``gs://``, ``memory://`` and others of fsspec): a protocol without renames.

Object stores have neither renames nor locks. Every frame is written as one object before its truth, which holds the
frame's size and digest and its own; truncated frames are therefore noticed and rendered again. ``SHA256SUMS`` is
written last. Two runs at once are safe: they write the same bytes.

The work is done in a local folder with truth and index of all frames and with the frames that are evaluated or
exported; workers of a cluster need no common file system.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from experiments.dataset.folder import (
    FRAMES,
    IDENTITY,
    LAYERS,
    OWN_FOLDERS,
    SUMS,
    TRUTH,
    Checked,
    DatasetFolder,
    StorageError,
    check,
    checked_frame,
    frame_files,
    identity,
    numbers,
)
from experiments.dataset.settings import DatasetConfig
from experiments.dataset.truth import FrameRecord
from experiments.harness.progress import terminal_progress
from optics.errors import ConfigError

AT_ONCE = 8
BUCKETS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss"})
"""Stores without folders: to make one would make a bucket, of whatever name was misspelt."""


def dataset_at(path: str, config: DatasetConfig) -> DatasetFolder:
    """A dataset, new or begun, in a folder or at a URL."""
    settings: dict[str, Any] = {"config": identity(config), "frames": config.frames, "truth": config.files.truth}
    if "://" not in path:
        return DatasetFolder(path, **settings)
    remote = RemoteDataset(path, **settings)
    if remote.only_here and (config.workers > 1 or config.scheduler):
        raise ConfigError(f"{path}: is visible to this process only; set workers = 1 and no scheduler")
    return remote


def check_at(path: str) -> Checked:
    """State of a dataset in a folder or at a URL, from every file."""
    with working_copy(path) if "://" in path else contextlib.nullcontext(Path(path)) as folder:
        return check(folder, terminal_progress())


class Store:
    """Objects below a URL."""

    def __init__(self, url: str) -> None:
        import fsspec

        self.url = url.rstrip("/")
        try:
            self._system, root = fsspec.core.url_to_fs(self.url)
        except (ImportError, ValueError) as error:
            raise ConfigError(f"{url}: {_text(error)}") from None
        self._root = str(root).rstrip("/")

    def names(self) -> set[str]:
        """Names of all objects, relative."""
        self._system.invalidate_cache()
        with self._one_line_errors(self.url):
            try:
                paths = self._system.find(self._root)
            except FileNotFoundError:
                return set()
            names = {str(path)[len(self._root) :].lstrip("/") for path in paths} - {""}
            return {name for name in names if ".." not in name.split("/")}  # a local copy must not leave its folder

    def read(self, name: str) -> bytes:
        """Content of an object, also of one written since the last listing."""
        self._system.invalidate_cache()
        with self._one_line_errors(f"{self.url}/{name}"):
            return bytes(self._system.cat_file(f"{self._root}/{name}"))

    def write(self, name: str, content: bytes) -> None:
        """Write an object in one piece."""
        with self._one_line_errors(f"{self.url}/{name}"):
            path = f"{self._root}/{name}"
            if self.url.partition(":")[0] not in BUCKETS:
                self._system.makedirs(path.rpartition("/")[0], exist_ok=True)
            self._system.pipe_file(path, content)

    def remove(self, name: str) -> None:
        """Remove an object."""
        with self._one_line_errors(f"{self.url}/{name}"):
            self._system.rm_file(f"{self._root}/{name}")

    @contextlib.contextmanager
    def _one_line_errors(self, name: str) -> Iterator[None]:
        """Any error of a store, in one line."""
        try:
            yield
        except Exception as error:  # every store has classes of its own
            raise StorageError(f"{name}: {_text(error)}") from None


def _text(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _fetch(store: Store, names: Iterable[str], folder: Path) -> None:
    """Copies of objects in a folder."""

    def copy(name: str) -> None:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(store.read(name))

    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(copy, names))


@contextlib.contextmanager
def working_copy(url: str) -> Iterator[Path]:
    """All of a dataset in a temporary local folder."""
    store = Store(url)
    names = store.names()
    if not names:
        raise ConfigError(f"{url}: does not exist")
    with tempfile.TemporaryDirectory(prefix="starbench-") as folder:
        _fetch(store, names, Path(folder))
        yield Path(folder)


class RemoteDataset(DatasetFolder):
    """A dataset at a URL, new or begun; as `DatasetFolder`, whose ``path`` is a folder of this run."""

    def __init__(self, url: str, *, config: Mapping[str, Any], frames: int, truth: str) -> None:
        self.store = Store(url)
        self._initial = self.store.names()
        foreign = {name for name in self._initial if name.partition("/")[0] not in (*OWN_FOLDERS, IDENTITY)}
        if foreign and IDENTITY not in self._initial and not numbers(self._initial):
            raise ConfigError(
                f"{url}: holds {min(foreign)} but no {IDENTITY}, so it is no dataset; name another place or empty it"
            )
        folder = Path(tempfile.mkdtemp(prefix="starbench-"))
        self._clean_up = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        parts = (f"{FRAMES}/", f"{LAYERS}/", SUMS)  # images are large, and copied only if needed
        _fetch(self.store, (name for name in self._initial if not name.startswith(parts)), folder)
        super().__init__(folder, config=config, frames=frames, truth=truth, shown=url)
        self._stale: set[str] = set()
        self.url = self.store.url
        self.only_here = self.url.startswith("memory:")

    def count(self) -> int:
        """Number of frames with a truth file, which is not read."""
        try:
            return len(numbers(self.store.names()))
        except StorageError:
            return super().count()

    def open(self, software: Mapping[str, str]) -> None:
        """As `DatasetFolder.open`."""
        super().open(software)
        self._push(IDENTITY)

    def close(self) -> None:
        """Remove the folder if no frame was made."""
        if not self._initial and not self.count():
            with contextlib.suppress(StorageError):
                self.store.remove(IDENTITY)
        super().close()

    def check_room(self, needed_bytes: float) -> None:
        """No check: the capacity of a store is unknown."""

    def checked(self, frame: int) -> FrameRecord | None:
        """Record of a frame if it is complete and intact, otherwise None; its images are read, and not stored."""
        record = checked_frame(self.path, frame, self.truth, self.store.read)
        if record is None:
            self._stale |= set(frame_files(frame, self.truth))  # it will be rendered again
        return record

    def fetch(self, names: Iterable[str]) -> None:
        """Copy files of the dataset that are missing or outdated in the folder."""
        needed = [name for name in names if name in self._stale or not (self.path / name).is_file()]
        _fetch(self.store, needed, self.path)
        self._stale -= set(needed)

    @contextlib.contextmanager
    def writing(self) -> Iterator[Path]:
        """As `DatasetFolder.writing`; files other than frames and truth are then written to the URL, digests last."""
        with super().writing() as staging:
            yield staging
        files = [file.relative_to(self.path).as_posix() for file in self.path.rglob("*") if file.is_file()]
        excluded = (*(f"{folder}/" for folder in (FRAMES, LAYERS, TRUTH)), ".", SUMS)
        with ThreadPoolExecutor(AT_ONCE) as pool:
            list(pool.map(self._push, [name for name in files if not name.startswith(excluded)]))
        self._push(SUMS)
        self._clean_up()

    def _push(self, name: str) -> None:
        self.store.write(name, (self.path / name).read_bytes())
