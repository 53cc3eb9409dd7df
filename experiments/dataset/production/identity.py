"""What makes two configurations the same dataset, and how a configuration travels to workers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from experiments.dataset.frames.attitude_files import file_digest
from experiments.dataset.settings import Config

__all__ = ["FILE_KEYS", "for_workers", "identity"]

FREE = (
    *("frames", "exports", "png_bits", "card", "verify"),
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
        if name and Path(name).is_file():
            content[table][key] = f"{Path(name).name} sha256:{file_digest(name)[:16]}"
    return content


def for_workers(config: Config) -> Config:
    """The same configuration with absolute paths, for processes that run elsewhere."""
    content = config.model_dump()
    for table, key in FILE_KEYS:
        name = content[table].get(key)
        if name and Path(name).is_file():
            content[table][key] = str(Path(name).resolve())
    return Config.model_validate(content)
