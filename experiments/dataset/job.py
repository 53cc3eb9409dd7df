"""Rendering of frames in any process: existing frames are checked, missing ones rendered and written with digests."""

from __future__ import annotations

import hashlib
import json
import tempfile
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.calibration import fits_bytes
from experiments.dataset.folder import (
    FRAMES,
    LAYERS,
    TRUTH,
    checked_frame,
    frame_files,
    origin,
    software,
    storage_error,
    write_whole,
)
from experiments.dataset.frame import LAYER_WORDS, FrameMaker, MadeFrame, header_cards
from experiments.dataset.labels import body_labels, disk_truth
from experiments.dataset.remote import Store
from experiments.dataset.scene import DatasetScene, build_scene
from experiments.dataset.settings import DatasetConfig
from experiments.dataset.truth import FrameRecord
from experiments.dataset.truth_files import truth_bytes
from optics.attitude import angles_from_attitude, quat_xyzw
from optics.errors import ConfigError
from optics.units import RAD_DEG
from render.engine import Engine

_MAKERS: dict[tuple[str, str], tuple[FrameMaker, str]] = {}
_CHECKED: set[str] = set()
"""Tokens of the jobs for which this process was checked."""
_LOCK = threading.Lock()
"""One frame at a time in a process: the renderer's state is the process's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Data for a worker; small, pickled once per batch."""

    config: str  # The configuration as JSON
    folder: str  # The dataset's folder, the same for all workers
    backend: str  # "llvm" or "cuda"
    url: str = ""  # Where files go, if that is no folder; every process then works in one of its own
    token: str = ""  # File in folder or URL by which a worker elsewhere knows that it sees the same place
    software: str = ""  # Versions that a worker elsewhere must have, as JSON


def check_worker(job: Job) -> None:
    """Refuse a process that does not see the dataset's place, or has other software."""
    where = f"worker {_address()}"
    if not (job.token in Store(job.url).names() if job.url else (Path(job.folder) / job.token).exists()):
        place, advice = (
            (job.url, "the worker must reach this URL")
            if job.url
            else ("the folder of the dataset", "it must be on a file system that all machines share, at the same path")
        )
        raise ConfigError(f"{where} does not see {place}; {advice}")
    mine = software(job.backend)
    for package, version in json.loads(job.software).items():
        if mine.get(package) != version:
            raise ConfigError(
                f"{where} has {package} {mine.get(package)}, here it is {version}; frames would differ: install the "
                "same version"
            )


def _address() -> str:
    from distributed import get_worker

    return str(get_worker().address)


def prepare(job: Job, threads: int | None = None) -> tuple[FrameMaker, str]:
    """The maker of frames of this process, and what they say of the dataset; made on the first call."""
    if job.token and job.token not in _CHECKED:
        check_worker(job)
        _CHECKED.add(job.token)
    key = (job.config, job.backend)
    if key not in _MAKERS:
        Engine.start(job.backend)
        from render.engine.jit import dr

        if threads is not None:
            dr.set_thread_count(threads)
            dr.set_log_level(dr.LogLevel.Error)  # it warns where two workers keep the same new kernel
        _MAKERS.clear()  # one dataset at a time; memory is better spent on its images
        config = DatasetConfig.model_validate_json(job.config)
        _MAKERS[key] = FrameMaker(build_scene(config)), json.dumps(origin(config, job.backend))
    return _MAKERS[key]


def make_frame(job: Job, frame: int, threads: int | None = None) -> FrameRecord:
    """Make and write a frame, unless it is there and whole already."""
    with _LOCK:
        maker, of_dataset = prepare(job, threads)
        if job.url:
            return _write_to_url(maker, of_dataset, job.url, frame)
        folder, truth = Path(job.folder), maker.scene.config.files.truth
        return checked_frame(folder, frame, truth) or _write(maker, of_dataset, folder, frame)


def _write_to_url(maker: FrameMaker, of_dataset: str, url: str, frame: int) -> FrameRecord:
    """Make a frame in a folder of this process, and write it where it belongs: the truth last."""
    store = Store(url)
    with tempfile.TemporaryDirectory(prefix="starbench-") as scratch:
        folder = Path(scratch)
        for name in (FRAMES, TRUTH):
            (folder / name).mkdir()
        record = _write(maker, of_dataset, folder, frame)
        *_, layers = frame_files(frame, maker.scene.config.files.truth)
        for name in (*((layers,) if (folder / layers).exists() else ()), record.file, record.truth):
            store.write(name, (folder / name).read_bytes())
    return record


def _write(maker: FrameMaker, of_dataset: str, folder: Path, frame: int) -> FrameRecord:
    made = maker.make(frame)
    config = maker.scene.config
    frame_name, truth_name, layers_name = frame_files(frame, config.files.truth)
    layers = b"" if made.layers is None else _layers(maker.scene, made)
    if layers:
        (folder / LAYERS).mkdir(exist_ok=True)
        write_whole(folder / layers_name, layers)
    path = folder / frame_name
    _write_fits(maker, made, path)
    try:
        with path.open("rb") as stream:
            digest, size = hashlib.file_digest(stream, "sha256").hexdigest(), path.stat().st_size
    except OSError as error:
        raise storage_error(path, error) from None
    record = _record(made, maker.scene, frame_name, truth_name, size, digest)
    record = replace(record, layers_sha256=hashlib.sha256(layers).hexdigest()) if layers else record
    write_whole(folder / truth_name, truth_bytes(made.truth, record, config.files.truth, of_dataset))
    return record


def _write_fits(maker: FrameMaker, made: MadeFrame, path: Path) -> None:
    from render.fits.files import write_frame

    files = maker.scene.config.files
    try:
        write_frame(
            made.frame,
            path,
            compression=None if files.compression == "none" else files.compression,
            mask=files.mask,
            cards=header_cards(maker.scene, made),
            marks=pixel_marks(maker.scene, made),
        )
    except ConfigError as error:
        cause: Any = error.__context__
        if isinstance(cause, OSError):
            raise storage_error(path, cause) from None
        raise
    except OSError as error:
        raise storage_error(path, error) from None


def _layers(scene: DatasetScene, made: MadeFrame) -> bytes:
    """File of the layers of a frame: an extension of float32 for each, behind the header of the frame."""
    from astropy.io import fits

    assert made.layers is not None
    plain = scene.config.files.compression == "none"
    head = [("IMAGETYP", "layers", "expected electrons, source by source"), *header_cards(scene, made)]
    units: list[Any] = [fits.PrimaryHDU(header=fits.Header(head))]
    for name, image in made.layers.items():
        cards = fits.Header([("EXTNAME", name.upper(), LAYER_WORDS[name]), ("BUNIT", "electron", "without noise")])
        gzip = {"compression_type": "GZIP_2", "quantize_level": 0.0}
        units.append(fits.ImageHDU(image, cards) if plain else fits.CompImageHDU(image, cards, **gzip))
    return fits_bytes(units)


def pixel_marks(scene: DatasetScene, made: MadeFrame) -> dict[str, NDArray[np.bool_]]:
    """Pixels (h, w) struck by cosmic rays, and pixels of disks, where a dataset may have them, by card of the mask."""
    marks = {} if made.struck is None else {"COSMIC": made.struck}
    if scene.simulator.disks is not None:
        disk = np.zeros(made.frame.dn.shape, np.bool_)
        for label in body_labels(scene, made.plan):
            disk[tuple(label.pixels)] = True
        marks["DISK"] = disk
    return marks


def _record(
    made: MadeFrame, scene: DatasetScene, frame_name: str, truth_name: str, size: int, digest: str
) -> FrameRecord:
    config = scene.config
    ra, dec, roll = angles_from_attitude(made.plan.attitude)
    x, y, z, w = quat_xyzw(made.plan.attitude).tolist()
    return FrameRecord(
        frame=made.plan.frame,
        split=made.plan.split,
        file=frame_name,
        truth=truth_name,
        ra_deg=ra,
        dec_deg=dec,
        roll_deg=roll,
        quat_xyzw=(x, y, z, w),
        rate_deg_per_s=tuple((made.plan.rate_rad_per_s * RAD_DEG).tolist()),
        epoch_year=config.catalogue.epoch_year,
        exposure_s=config.instrument.exposure_s,
        stars=made.stars,
        saturated=made.saturated,
        saturated_px=made.saturated_px,
        background_e=made.background_e,
        frame_bytes=size,
        sha256=digest,
        disks=disk_truth(scene, made.plan, made.disks),
        ghosts=made.ghosts,
    )
