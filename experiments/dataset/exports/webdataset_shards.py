"""WebDataset export: tar files of samples (frame, truth, record), one series per split, for streaming."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from experiments.dataset.production.folder import storage_error
from experiments.dataset.truth.frame_record import FrameRecord
from optics.errors import ConfigError

__all__ = ["check_webdataset", "export_shards"]

FOLDER = "webdataset"
FRAMES_PER_SHARD = 1000
"""Numbers of frames, over all splits, that go into the shards of one number: more frames leave whole shards as they
are."""


def check_webdataset() -> Any:
    """The library.

    Raises
    ------
    ConfigError
        It is not installed.
    """
    try:
        import webdataset
    except ImportError:
        raise ConfigError(
            "exports = webdataset needs the package webdataset; pip install 'starbench[export]', or leave it out"
        ) from None
    return webdataset


def export_shards(folder: Path, records: Sequence[FrameRecord], *, done: Callable[[], None]) -> str:
    """Write ``webdataset/SPLIT-000000.tar``: per sample ``fits``, ``json`` (record) and the truth.

    Parameters
    ----------
    folder : pathlib.Path
        The dataset.
    records : sequence of FrameRecord
        Its frames, in their order.
    done : callable
        Called after every frame.

    Returns
    -------
    str
        What was written, in words.

    Raises
    ------
    ConfigError
        The library is missing.
    StorageError
        Something could not be written.
    """
    webdataset = check_webdataset()
    root = folder / FOLDER
    shards: dict[str, list[FrameRecord]] = {}
    for one in records:
        shards.setdefault(f"{one.split}-{one.frame // FRAMES_PER_SHARD:06d}.tar", []).append(one)
    try:
        root.mkdir(exist_ok=True)
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
                    "fits": (folder / one.file).read_bytes(),
                    "json": one.to_text().encode(),
                    Path(one.truth).suffix[1:]: (folder / one.truth).read_bytes(),
                }
                writer.write(sample)
                done()
            writer.close()
        os.replace(beside, path)
    finally:
        with suppress(OSError):
            beside.unlink()
