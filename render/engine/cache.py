"""Folder of Dr.Jit's compiled kernels; Dr.Jit ends the process if the folder cannot be created."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from optics.errors import BackendError


@contextmanager
def home_with_cache() -> Iterator[None]:
    """Context with a home folder that can hold a cache: the user's, or one below the temporary folder.

    Dr.Jit makes ``$HOME/.drjit`` when it is imported and calls ``abort`` where that fails: a home that does not exist
    or is read-only, as in containers and services.
    """
    before = os.environ.get("HOME")
    if os.name != "posix" or (before and _holds_cache(Path(before))):
        yield
        return
    os.environ["HOME"] = str(_temporary())
    try:
        yield
    finally:
        if before is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = before


def _holds_cache(home: Path) -> bool:
    folder = home / ".drjit"
    try:
        folder.mkdir(exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _temporary() -> Path:
    """A folder of this user below the temporary one, the same each time if no other user can have created it."""
    try:
        folder = Path(tempfile.gettempdir()) / f"starbench-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022:
            return folder
        return Path(tempfile.mkdtemp(prefix="starbench-"))
    except OSError as error:
        raise BackendError(
            f"no folder for compiled kernels can be made ({error.strerror or error}); set HOME or TMPDIR to one that "
            "can be written"
        ) from None
