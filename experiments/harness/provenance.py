"""``provenance.json``: what made these files, with which versions, where and how long; no path of the machine."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import subprocess
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from experiments.harness.outputs import PROGRAM
from experiments.harness.system import own_peak_memory_mb
from render.engine.llvm import llvm_version

__all__ = [
    "collect",
    "count_memory_of_workers",
    "file_digests",
    "peak_memory_mb",
    "process_seconds",
    "program_version",
    "without_paths",
]

_PACKAGES = (
    "starbench",
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "astropy",
    "colour-science",
    "scikit-image",
    "pydantic",
    "matplotlib",
)
_WORKERS_MB: list[float] = []
_IMPORTED = time.perf_counter()


def collect(
    experiment: str,
    config: Mapping[str, Any],
    *,
    variant: str | None,
    quick: bool,
    times_s: Mapping[str, float],
) -> dict[str, Any]:
    """Everything needed to make a run again, except the files it wrote."""
    return {
        "program": PROGRAM,
        "experiment": experiment,
        "seed": config.get("seed"),
        "quick": quick,
        "config": without_paths(config),
        "finished_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "runtime_s": round(process_seconds(), 2),
        "stages_s": {label: round(seconds, 3) for label, seconds in times_s.items()},
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "backend": {"variant": variant, "llvm": llvm_version(), "threads": os.cpu_count()},
        "machine": {"cpu": _cpu_name(), "system": platform.system(), "architecture": platform.machine()},
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in _PACKAGES},
        "git": _git(),
    }


def file_digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below a folder, by its path relative to the folder."""
    return {
        file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, and of those that worked for it [MB = 10^6 bytes]."""
    return own_peak_memory_mb() + sum(_WORKERS_MB)


def count_memory_of_workers(peaks_mb: Iterable[float]) -> None:
    """Add the peaks of processes that work beside this one; earlier ones of less memory no longer count."""
    peaks = list(peaks_mb)
    if sum(peaks) > sum(_WORKERS_MB):
        _WORKERS_MB[:] = peaks


def process_seconds() -> float:
    """Seconds since this process started, interpreter and imports included (Linux; elsewhere since this import)."""
    try:
        after_name = Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        started = int(after_name[19]) / os.sysconf("SC_CLK_TCK")  # field 22 of proc(5), counted from field 3
        return time.clock_gettime(time.CLOCK_BOOTTIME) - started
    except (OSError, ValueError, AttributeError, IndexError):
        return time.perf_counter() - _IMPORTED


def without_paths(value: Any) -> Any:
    """Copy in which every absolute path is cut to its last part: it tells of one machine only."""
    if isinstance(value, Mapping):
        return {key: without_paths(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_paths(item) for item in value]
    if isinstance(value, str):
        if re.match(r"[A-Za-z]:[\\/]", value):
            return PureWindowsPath(value).name
        if value.startswith(("/", "~/")):
            return PurePosixPath(value).name
    return value


def program_version() -> str:
    """Name and version of the program, for ``--version``."""
    found = _version(PROGRAM)
    return f"{PROGRAM} {found}" if found else f"{PROGRAM}, from a source tree that is not installed"


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _cpu_name() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _git() -> dict[str, Any] | None:
    """Commit of the source tree this runs from; None for an installed package or without git."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None

    def ask(*arguments: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=10
        )
        return done.stdout.strip()

    try:
        commit = ask("rev-parse", "HEAD")
        return {"commit": commit, "changed": bool(ask("status", "--porcelain", "--untracked-files=no"))}
    except (OSError, subprocess.SubprocessError):
        return None
