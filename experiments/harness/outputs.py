"""The output folder appears complete or not at all: files are written to a temporary folder, synced, and moved by one
rename."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import signal
import tempfile
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from experiments.harness.interrupts import NOTHING_WRITTEN
from experiments.harness.system import signals_held
from optics.errors import ConfigError

PROGRAM = "starbench"
RECORD = "provenance.json"

_RENAME_EXCHANGE = 2  # linux/fs.h
_AT_FDCWD = -100  # fcntl.h
_ENDING = (signal.SIGINT, signal.SIGTERM)


class OutputFolder:
    """A folder that an experiment is going to write.

    The constructor checks, before any long work, that the folder can be written and that no file of the user would be
    lost; it leaves nothing on disk.

    Examples
    --------
    >>> folder = OutputFolder("out/chromatic")      # doctest: +SKIP
    >>> with folder.writing() as staging:           # doctest: +SKIP
    ...     (staging / "summary.json").write_text("{}")
    """

    interrupted = NOTHING_WRITTEN

    def __init__(self, path: str | Path) -> None:
        self.shown = str(path)
        self.path = Path(os.path.realpath(path))
        self._refuse_unsuitable()
        self._probe()

    @contextlib.contextmanager
    def writing(self) -> Iterator[Path]:
        """Folder to write into; without an exception it then becomes the output folder, otherwise it is removed."""
        staging = self._ancestor() / f".{self.path.name}.partial-{uuid.uuid4().hex[:8]}"
        try:
            staging.mkdir()
            yield staging
            for path in (*sorted(staging.rglob("*")), staging):
                _sync(path)
            self._refuse_unsuitable()
            with signals_held(*_ENDING):
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._publish(staging)
        except OSError as error:
            raise ConfigError(f"{self.shown}: cannot be written ({error.strerror or error})") from error
        finally:
            with signals_held(*_ENDING):  # it holds the earlier output, or an unfinished one
                shutil.rmtree(staging, ignore_errors=True)

    def refuse_other_run(self, experiment: str, config: Mapping[str, Any]) -> None:
        """Refuse a folder that holds the output of another experiment, or of this one with other settings."""
        from optics.settings import flat

        record = self._record()
        if not {"experiment", "config"} <= record.keys():
            return
        earlier, present = flat(record["config"]), flat(json.loads(json.dumps(config)))
        advice = "name another folder with --out, or replace it with --force"
        if record["experiment"] != experiment:
            raise ConfigError(f"{self.shown}: holds a run of {record['experiment']}; {advice}")
        if keys := [key for key in {**present, **earlier} if earlier.get(key) != present.get(key)]:
            more = f" and {len(keys) - 1} more differences" if len(keys) > 1 else ""
            raise ConfigError(
                f"{self.shown}: holds a run with {keys[0]} = {shown_value(earlier, keys[0])}, this one has "
                f"{shown_value(present, keys[0])}{more}; {advice}"
            )

    def _refuse_unsuitable(self) -> None:
        try:
            if not self.path.exists():
                return
            if not self.path.is_dir():
                raise ConfigError(f"{self.shown}: is a file; name a folder")
            if self.path == Path(os.path.realpath(os.curdir)):
                raise ConfigError(f"{self.shown}: is the current folder; name a folder inside it")
            if os.path.ismount(self.path):
                raise ConfigError(f"{self.shown}: is a mount point; name a folder inside it")
            present = {str(file.relative_to(self.path)) for file in self.path.rglob("*") if not file.is_dir()}
        except OSError as error:
            raise ConfigError(f"{self.shown}: cannot be read ({error.strerror})") from None
        if not present:
            return
        record = self._record()
        foreign = sorted(present - {RECORD, *record["files"]} if record else present)
        if foreign:
            raise ConfigError(
                f"{self.shown}: holds {foreign[0]}{' and more' if len(foreign) > 1 else ''}, "
                "which is no earlier output; name another folder or empty it"
            )

    def _record(self) -> dict[str, Any]:
        """Provenance of an earlier output of this program; empty without one."""
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            record: dict[str, Any] = json.loads((self.path / RECORD).read_text(encoding="utf-8"))
            return record if record["program"] == PROGRAM and isinstance(record["files"], dict) else {}
        return {}

    def _ancestor(self) -> Path:
        return next(folder for folder in self.path.parents if folder.exists())

    def _probe(self) -> None:
        try:
            with signals_held(*_ENDING):
                os.rmdir(tempfile.mkdtemp(prefix=f".{self.path.name}.probe-", dir=self._ancestor()))
        except OSError as error:
            raise ConfigError(f"{self.shown}: cannot be written ({error.strerror or error})") from None

    def _publish(self, staging: Path) -> None:
        if not self.path.exists() or not any(self.path.iterdir()):
            os.rename(staging, self.path)  # replaces an empty folder in one step
        elif not _exchange(staging, self.path):
            earlier = Path(tempfile.mkdtemp(prefix=f".{self.path.name}.earlier-", dir=self.path.parent))
            kept = earlier / "output"
            os.rename(self.path, kept)
            try:
                os.rename(staging, self.path)
            except OSError as error:
                try:
                    os.rename(kept, self.path)
                except OSError:
                    reason = f"cannot be written ({error.strerror or error})"
                    raise ConfigError(f"{self.shown}: {reason}; the earlier output is in {kept}") from error
                earlier.rmdir()
                raise
            shutil.rmtree(earlier, ignore_errors=True)
        _sync(self.path.parent)


def shown_value(values: Mapping[str, Any], key: str) -> str:
    """A setting for a message."""
    return json.dumps(values[key], ensure_ascii=False) if key in values else "nothing there"


def _exchange(first: Path, second: Path) -> bool:
    """Swap two folders in one step (Linux renameat2); False if the system or the file system cannot."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return bool(renameat2(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE) == 0)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
