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
from experiments.dataset.frame import LAYER_WORDS, FrameRenderer, RenderedFrame, header_cards
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

_RENDERERS: dict[tuple[str, str], PreparedRenderer] = {}
"""Renderer by configuration and backend: the last one only."""
_CHECKED_TOKENS: set[str] = set()
"""Destination tokens of the jobs for which this process was checked."""
_LOCK = threading.Lock()
"""One frame at a time in a process, which has a single renderer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Data for a worker; small, pickled once per batch."""

    config: str  # JSON
    folder: str  # Folder of the dataset, the same path for all workers
    backend: str  # "llvm" or "cuda"
    url: str = ""  # Destination of files in place of the folder
    token: str = ""  # File in folder or URL by which a worker on another machine recognises the destination
    software: str = ""  # Versions that a worker on another machine must have, as JSON


@dataclass(frozen=True, slots=True)
class PreparedRenderer:
    """Renderer of a process, and the provenance (JSON) in the truth files that it writes."""

    renderer: FrameRenderer
    provenance: str


def check_worker(job: Job) -> None:
    """Refuse a process that does not see the destination, or has other software."""
    from distributed import get_worker

    worker = f"worker {get_worker().address}"
    if job.url:
        if job.token not in Store(job.url).names():
            raise ConfigError(f"{worker} does not see {job.url}; the worker must reach this URL")
    elif not (Path(job.folder) / job.token).exists():
        raise ConfigError(
            f"{worker} does not see the folder of the dataset; it must be on a file system that all machines share, "
            "at the same path"
        )
    installed = software(job.backend)
    for package, version in json.loads(job.software).items():
        if installed.get(package) != version:
            raise ConfigError(
                f"{worker} has {package} {installed.get(package)}, here it is {version}; frames would differ: install "
                "the same version"
            )


def prepare(job: Job, threads: int | None = None) -> PreparedRenderer:
    """Renderer of this process, built on the first call."""
    if job.token and job.token not in _CHECKED_TOKENS:
        check_worker(job)
        _CHECKED_TOKENS.add(job.token)
    key = (job.config, job.backend)
    if key not in _RENDERERS:
        Engine.start(job.backend)
        from render.engine.jit import dr

        if threads is not None:
            dr.set_thread_count(threads)
            dr.set_log_level(dr.LogLevel.Error)  # it warns if two workers store the same new kernel
        _RENDERERS.clear()  # one dataset at a time limits the memory
        config = DatasetConfig.model_validate_json(job.config)
        provenance = json.dumps(origin(config, job.backend))
        _RENDERERS[key] = PreparedRenderer(FrameRenderer(build_scene(config)), provenance)
    return _RENDERERS[key]


def make_frame(job: Job, frame: int, threads: int | None = None) -> FrameRecord:
    """Render and write a frame, unless it is complete already; the truth is written last."""
    with _LOCK:
        prepared = prepare(job, threads)
        folder = Path(job.folder)
        truth = prepared.renderer.scene.config.files.truth
        if not job.url:
            return checked_frame(folder, frame, truth) or _write(prepared, folder, frame)
        store = Store(job.url)
        with tempfile.TemporaryDirectory(prefix="starbench-") as scratch:
            folder = Path(scratch)
            for name in (FRAMES, TRUTH):
                (folder / name).mkdir()
            record = _write(prepared, folder, frame)
            names = [frame_files(frame, truth)[2]] if record.layers_sha256 else []
            for name in (*names, record.file, record.truth):
                store.write(name, (folder / name).read_bytes())
        return record


def _write(prepared: PreparedRenderer, folder: Path, frame: int) -> FrameRecord:
    """Render a frame and write its files: layers, frame, and last the truth, which marks the frame as complete."""
    scene = prepared.renderer.scene
    rendered = prepared.renderer.render(frame)
    truth = scene.config.files.truth
    frame_name, truth_name, layers_name = frame_files(frame, truth)
    layers = b"" if rendered.layers is None else _layers(scene, rendered)
    if layers:
        (folder / LAYERS).mkdir(exist_ok=True)
        write_whole(folder / layers_name, layers)
    path = folder / frame_name
    _write_fits(scene, rendered, path)
    try:
        with path.open("rb") as stream:
            digest, size = hashlib.file_digest(stream, "sha256").hexdigest(), path.stat().st_size
    except OSError as error:
        raise storage_error(path, error) from None
    record = frame_record(rendered, scene, frame_name, truth_name, size, digest)
    record = replace(record, layers_sha256=hashlib.sha256(layers).hexdigest()) if layers else record
    write_whole(folder / truth_name, truth_bytes(rendered.truth, record, truth, prepared.provenance))
    return record


def _write_fits(scene: DatasetScene, rendered: RenderedFrame, path: Path) -> None:
    from render.fits.files import write_frame

    files = scene.config.files
    try:
        write_frame(
            rendered.frame,
            path,
            compression=None if files.compression == "none" else files.compression,
            mask=files.mask,
            cards=header_cards(scene, rendered),
            marks=mask_planes(scene, rendered),
        )
    except ConfigError as error:
        cause: Any = error.__context__
        if isinstance(cause, OSError):
            raise storage_error(path, cause) from None
        raise
    except OSError as error:
        raise storage_error(path, error) from None


def _layers(scene: DatasetScene, rendered: RenderedFrame) -> bytes:
    """FITS file of the layers of a frame: its header, and a float32 extension for each."""
    from astropy.io import fits

    assert rendered.layers is not None
    cards = [("IMAGETYP", "layers", "expected electrons, source by source"), *header_cards(scene, rendered)]
    units: list[Any] = [fits.PrimaryHDU(header=fits.Header(cards))]
    for name, image in rendered.layers.items():
        header = fits.Header([("EXTNAME", name.upper(), LAYER_WORDS[name]), ("BUNIT", "electron", "without noise")])
        if scene.config.files.compression == "none":
            units.append(fits.ImageHDU(image, header))
        else:
            units.append(fits.CompImageHDU(image, header, compression_type="GZIP_2", quantize_level=0.0))
    return fits_bytes(units)


def mask_planes(scene: DatasetScene, rendered: RenderedFrame) -> dict[str, NDArray[np.bool_]]:
    """Pixels (h, w) of cosmic rays, and of disks, if a dataset may have them, by card of the mask."""
    planes = {} if rendered.cosmic_rays is None else {"COSMIC": rendered.cosmic_rays}
    if scene.simulator.disks is not None:
        disk = np.zeros(rendered.frame.dn.shape, np.bool_)
        for label in body_labels(scene, rendered.plan):
            disk[tuple(label.pixels)] = True
        planes["DISK"] = disk
    return planes


def frame_record(
    rendered: RenderedFrame, scene: DatasetScene, frame_name: str, truth_name: str, size: int, digest: str
) -> FrameRecord:
    """Record of a frame with the names of its files, size and digest."""
    config, plan = scene.config, rendered.plan
    ra, dec, roll = angles_from_attitude(plan.attitude)
    x, y, z, w = quat_xyzw(plan.attitude).tolist()
    return FrameRecord(
        frame=plan.frame,
        split=plan.split,
        file=frame_name,
        truth=truth_name,
        ra_deg=ra,
        dec_deg=dec,
        roll_deg=roll,
        quat_xyzw=(x, y, z, w),
        rate_deg_per_s=tuple((plan.rate_rad_per_s * RAD_DEG).tolist()),
        epoch_year=config.catalogue.epoch_year,
        exposure_s=config.instrument.exposure_s,
        stars=rendered.stars,
        saturated=rendered.saturated,
        saturated_px=rendered.saturated_px,
        background_e=rendered.background_e,
        frame_bytes=size,
        sha256=digest,
        disks=disk_truth(scene, plan, rendered.disks),
        ghosts=rendered.ghosts,
    )
