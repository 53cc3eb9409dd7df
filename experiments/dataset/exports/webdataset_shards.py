"""WebDataset export: tar files of samples (image, truth, record, FITS), one series per split, for streaming.

The image is a NumPy array, key ``npy``: webdataset, datasets and torch read it alike, 16 bits, first row first. By PIL
they would turn FITS upside down and ignore BZERO, and make 8 bits of 16-bit PNG; so the FITS file has the key ``fts``,
the standard's third suffix, which they hand on as bytes.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from experiments.dataset.production.folder import storage_error
from experiments.dataset.truth.frame_record import FrameRecord
from optics.errors import ConfigError

__all__ = ["check_webdataset", "export_shards"]

FOLDER = "webdataset"
FRAMES_PER_SHARD = 1000
"""Numbers of frames, over all splits, that go into the shards of one number: more frames leave whole shards as they
are."""


def check_webdataset() -> Any:
    """The library."""
    try:
        import webdataset
    except ImportError:
        raise ConfigError(
            "exports = webdataset needs the package webdataset; pip install 'starbench[export]', or leave it out"
        ) from None
    return webdataset


def export_shards(folder: Path, records: Sequence[FrameRecord], *, done: Callable[[], None]) -> str:
    """Write ``webdataset/SPLIT-000000.tar``: per sample ``npy`` (uint16), ``json`` (record), the truth, and ``fts``."""
    webdataset = check_webdataset()
    root = folder / FOLDER
    shards: dict[str, list[FrameRecord]] = {}
    for one in records:
        shards.setdefault(f"{one.split}-{one.frame // FRAMES_PER_SHARD:06d}.tar", []).append(one)
    try:
        root.mkdir(exist_ok=True)
        for left in root.glob(".*.tar.*.partial"):  # by a run that was killed
            left.unlink()
        for name, members in shards.items():
            _shard(webdataset, folder, root / name, members, done)
    except OSError as error:
        raise storage_error(root, error) from None
    return f"{len(shards)} shards in {FOLDER}/"


def _shard(webdataset: Any, folder: Path, path: Path, members: Sequence[FrameRecord], done: Callable[[], None]) -> None:
    beside = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with beside.open("wb") as stream:
            writer = webdataset.TarWriter(stream, user="", group="", mtime=0.0, encoder=False)
            for one in members:
                sample = {
                    "__key__": f"frame_{one.frame:06d}",
                    "npy": _array(folder / one.file),
                    "json": one.to_text().encode(),
                    Path(one.truth).suffix[1:]: (folder / one.truth).read_bytes(),
                    "fts": (folder / one.file).read_bytes(),
                }
                writer.write(sample)
                done()
            writer.close()
        os.replace(beside, path)
    finally:
        with suppress(OSError):
            beside.unlink()


def _array(path: Path) -> bytes:
    from render.fits.files import read_frame

    held = io.BytesIO()
    np.save(held, read_frame(path).dn, allow_pickle=False)
    return held.getvalue()
