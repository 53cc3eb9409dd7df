"""``provenance.json``: configuration, versions, backend and times of a run; no path of the machine."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil

from experiments.harness.outputs import PROGRAM
from experiments.harness.registry import version_of
from render.engine.llvm import llvm_version

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


def collect(
    experiment: str,
    config: Mapping[str, Any],
    *,
    variant: str | None,
    quick: bool,
    times_s: Mapping[str, float],
) -> dict[str, Any]:
    """Everything needed to repeat a run, except the files it wrote."""
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
        "packages": {name: version_of(name) for name in _PACKAGES},
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
    """Largest resident memory of this process and its workers so far [MB = 10^6 bytes]."""
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return largest / 1e6 + sum(_WORKERS_MB)


def count_memory_of_workers(peaks_mb: Iterable[float]) -> None:
    """Add the peaks of parallel worker processes; earlier smaller sums are dropped."""
    peaks = list(peaks_mb)
    if sum(peaks) > sum(_WORKERS_MB):
        _WORKERS_MB[:] = peaks


def process_seconds() -> float:
    """Seconds since this process started, interpreter and imports included."""
    return time.time() - psutil.Process().create_time()


def without_paths(value: Any) -> Any:
    """Copy in which every absolute path is cut to its last part, without folders of the machine."""
    if isinstance(value, Mapping):
        return {key: without_paths(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_paths(item) for item in value]
    return Path(value).name if isinstance(value, str) and value.startswith(("/", "~/")) else value


def _cpu_name() -> str:
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return platform.processor() or platform.machine()


def _git() -> dict[str, Any] | None:
    """Commit of the source tree this runs from; None for an installed package or without git."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None

    def ask(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        commit = ask("rev-parse", "HEAD")
        return {"commit": commit, "changed": bool(ask("status", "--porcelain", "--untracked-files=no"))}
    except (OSError, subprocess.SubprocessError):
        return None
