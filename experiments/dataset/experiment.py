"""Datasets of star frames with exact truth: missing frames are rendered, exported and evaluated."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.cameras.fit import fit_camera
from calib.measure.reduced_frame import FrameReduction, measure_frame
from experiments.dataset import detection, solve
from experiments.dataset.calibration import write_calibration
from experiments.dataset.card import about, sheet_records, write_closing_files
from experiments.dataset.detection import Example, compare_frame, dataset_bound, joined, wcs_misses_px
from experiments.dataset.exports import COCO, WEBDATASET, check_webdataset, export_coco, export_shards
from experiments.dataset.folder import DatasetFolder, StorageError, for_workers, frame_files, in_words, software
from experiments.dataset.job import Job
from experiments.dataset.labels import FrameLabeller
from experiments.dataset.scene import DatasetScene, build_scene
from experiments.dataset.settings import DatasetConfig
from experiments.dataset.solve import BlindSolver, attitudes, star_patterns
from experiments.dataset.truth import FrameRecord
from experiments.dataset.truth_files import read_table
from experiments.dataset.workers import make_frames
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome
from experiments.harness.sections import Section, col
from experiments.harness.system import prompt_pool
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.checks import focus_remark
from experiments.laboratory.bench.readout.frames import empty_frame, mean_dark_frame, true_noise
from optics.errors import ConfigError
from render.engine import Engine
from render.fits.files import read_frame
from render.psf_lattice import render_psf_grid
from render.sensor_file.filters import open_band

EXPORTS = (COCO, WEBDATASET)
EMPTY = "empty"
"""Random streams of frames without stars."""
SMALLEST_FRACTION = {"none": 1.0, "rice": 0.1, "gzip": 0.1}
"""Lower bound of the compressed size of a frame with noise."""
FAINTEST_FRACTION = 0.5
"""Lower bound of the size of a packed frame over that of the first, which may hold the Moon or a mask."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Export:
    """An export of the dataset."""

    format: str = col("Format")
    files: str = col("Files")


@dataclass(frozen=True, slots=True, kw_only=True)
class CompleteDataset:
    """A dataset that is complete."""

    frames: int = col("Frames")
    frames_made: int = col("Frames made by this run")
    # Rate between the first finished frame and the last, all workers together; NaN for fewer than two frames
    frames_per_s: float = col("Frames per second", format=".1f")
    workers: int = col("Processes")
    stars: int = col("Star images")
    frames_without_stars: int = col("Frames without stars")
    damaged: tuple[int, ...]  # Existing frames that were damaged and rendered again
    folder: Path
    scene: DatasetScene
    records: tuple[FrameRecord, ...]  # Records in the order of the frame numbers
    exports: Mapping[str, str]  # Name of an export -> its content, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class Solver:
    """Camera model and mode of the attitude solution."""

    camera_model_max_px: float = col("Camera model, largest misfit", "px", ".1e")
    temperature_k: float  # Median star temperature, for which the camera is calibrated
    blind: bool  # Whether stars were identified without a rough attitude


def run(config: DatasetConfig, *, progress: Progress, output: DatasetFolder) -> dict[str, Any]:
    """Render missing frames, write the exports, evaluate the first frames."""
    with progress.stage("prepare"):
        if "webdataset" in config.exports:
            check_webdataset()
        scene = build_scene(config)
        camera = scene.instrument.camera
        if config.verify.frames and min(camera.width_px, camera.height_px) < config.window_px:
            raise ConfigError(
                f"window_px = {config.window_px} px; the window does not fit the detector of "
                f"{camera.width_px} x {camera.height_px} px: take a larger instrument.height_px or width_px, or set "
                "verify.frames = 0"
            )
    if remark := focus_remark(scene.instrument, scene.light.wavelength_nm.ravel()):
        progress.note(remark)
    backend = Engine.active().backend
    job = Job(config=for_workers(config).model_dump_json(), folder=str(output.path), backend=backend, url=output.url)
    output.open(software(backend))
    try:
        completed = _complete(scene, output, job, progress)
        records = completed["records"]
        evaluated = records[: config.verify.frames]
        exported = bool(config.exports) or any((output.path / name).is_dir() for name in EXPORTS)
        needed = records if exported else (*evaluated, *sheet_records(records))
        output.fetch(dict.fromkeys([*(record.truth for record in records), *(record.file for record in needed)]))
        exports = _export(scene, output.path, records, progress)
        frames = CompleteDataset(**completed, folder=output.path, scene=scene, exports=exports)
        written = [Export(format=name, files=files) for name, files in exports.items()] or None
        evaluation = evaluate(output.path, scene, evaluated, progress)
        return dict.fromkeys(SECTIONS) | {"frames": frames, "exports": written} | evaluation
    except BaseException:
        output.close()
        raise


def _complete(scene: DatasetScene, output: DatasetFolder, job: Job, progress: Progress) -> dict[str, Any]:
    """A dataset completed to the requested frames: intact frames are kept, missing ones rendered."""
    config, camera = scene.config, scene.instrument.camera
    if output.repaired:
        progress.note(f"{output.shown}: {output.repaired}")
    existing = output.numbers()
    with prompt_pool() as pool:
        checked = progress.track(pool.map(output.checked, existing), "check existing frames", total=len(existing))
        records = {record.frame: record for record in checked if record is not None}
    damaged = tuple(frame for frame in existing if frame not in records)
    missing = [frame for frame in range(config.frames) if frame not in records]
    if missing:
        bytes_each = 2 * camera.width_px * camera.height_px * SMALLEST_FRACTION[config.files.compression]
        if config.files.layers and config.files.compression == "none":  # stars and dark at least
            bytes_each += 8 * camera.width_px * camera.height_px
        output.check_room(len(missing) * bytes_each)
    times: list[tuple[float, int]] = []
    with progress.stage("render frames", total=len(missing)) as stage:

        def done(batch: Sequence[FrameRecord]) -> None:
            records.update({record.frame: record for record in batch})
            if not times and config.files.compression != "none":  # the first batch shows the compression
                output.check_room((len(missing) - len(batch)) * batch[0].frame_bytes * FAINTEST_FRACTION)
            times.append((time.perf_counter(), len(batch)))
            stage.advance(len(batch))

        try:
            processes = 1 if output.only_here else config.workers
            workers = make_frames(job, missing, workers=processes, scheduler=config.scheduler, done=done)
        except StorageError as error:
            raise StorageError(
                f"{output.shown}: {error}; {output.count()} of {config.frames} frames are complete and kept: free "
                "disk space and run the same command again"
            ) from None
    rate = math.nan
    if len(times) > 1:
        rate = sum(count for _, count in times[1:]) / (times[-1][0] - times[0][0])
    ordered = tuple(records[frame] for frame in range(config.frames))
    for record in ordered:
        output.digests[record.file] = record.sha256
        if record.layers_sha256:
            output.digests[frame_files(record.frame, config.files.truth)[2]] = record.layers_sha256
    if damaged:
        progress.note(f"{output.shown}: damaged frames are rendered again: {in_words(damaged)}")
    stars = [record.stars for record in ordered]
    return {
        "records": ordered,
        "frames": len(ordered),
        "frames_made": len(missing),
        "damaged": damaged,
        "frames_per_s": rate,
        "workers": workers,
        "stars": sum(stars),
        "frames_without_stars": stars.count(0),
    }


def _export(scene: DatasetScene, folder: Path, records: Sequence[FrameRecord], progress: Progress) -> dict[str, str]:
    """Requested exports, and existing ones updated; name -> content, in words."""
    config = scene.config
    written: dict[str, str] = {}
    for name in sorted({*config.exports, *(name for name in EXPORTS if (folder / name).is_dir())}):
        with progress.stage(f"export {name}", total=len(records)) as stage:
            if name == WEBDATASET:
                written[name] = export_shards(folder, records, done=stage.advance)
                continue
            written[name] = export_coco(
                folder,
                records,
                diffusion_px=scene.instrument.camera.blur_px,
                bits=config.png_bits,
                labels=FrameLabeller(scene).labels,
                about=about(config, scene.catalogue),
                done=stage.advance,
            )
    if config.calibration_frames > 1:
        with progress.stage("calibration", total=3) as stage:
            written["calibration"] = write_calibration(scene, folder, config.calibration_frames, stage.advance)
    return written


def evaluate(folder: Path, scene: DatasetScene, records: Sequence[FrameRecord], progress: Progress) -> dict[str, Any]:
    """Sections of detection and attitude solution, from the files of frames."""
    if not records:
        return {}
    config, camera, instrument = scene.config, scene.instrument.camera, scene.instrument
    streams, dark_frames = scene.plan.streams.child("verify"), config.verify.dark_frames
    with progress.stage("prepare the evaluation (star patterns are computed once, then kept on disk)"):
        dark = mean_dark_frame(instrument, dark_frames, streams=streams, label=EMPTY)
        temperature_k = float(np.median(scene.sky.temperature_k))
        psfs = render_psf_grid(instrument, scene.light, temperature_k=temperature_k, window_px=config.window_px)
        reduction = FrameReduction(
            dark_dn=dark,
            noise=true_noise(instrument, dark_frames=dark_frames),
            centroid=config.centroid,
            window_px=config.window_px,
            threshold_sigma=config.threshold_sigma,
            psfs=psfs if needs_epsf(config.centroid) else None,
        )
        band = open_band(config.passband, instrument)
        calibration = fit_camera(instrument.pixel_map(band, temperature_k=temperature_k))
        solver = BlindSolver(scene, calibration, star_patterns(scene))
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    stars, solved, misses = [], [], [np.zeros(0)]
    example: Example | None = None
    for record in progress.track(records, "evaluate frames", total=len(records)):
        frame, table = read_frame(folder / record.file), read_table(folder / record.truth)
        truth = {name: np.asarray(table[name]) for name in table.colnames}
        smear = np.hypot(truth["smear_x_px"], truth["smear_y_px"])
        measured = measure_frame(frame, reduction, smear_px=float(np.nanmax(smear, initial=0.0)))
        stars.append(compare_frame(record.frame, measured, truth, **size))
        if not (config.instrument.line_time_us and any(record.rate_deg_per_s)):  # else the attitude differs by row
            misses.append(wcs_misses_px(folder / record.file, truth, **size))
        if not solver.missing:
            solved.append(solver.solve(record, measured.at_positions(solver.turned(record, measured))))
        if example is None and record.stars:
            light = (frame.dn - dark) / np.float32(frame.gain_dn_per_e)
            example = Example(frame=record.frame, electrons=light, measured=measured, truth=truth)
    sky_e = float(np.mean([record.background_e for record in records]))
    empty = streams.child("empty")
    empty_frames = (empty_frame(instrument, k, sky_e=sky_e, streams=empty, label=EMPTY) for k in range(dark_frames))
    unflagged = [np.count_nonzero(~measure_frame(frame, reduction).stars.sharp) for frame in empty_frames]
    return detection.detection(
        joined(stars),
        dataset_bound(scene, psfs, sky_e),
        empty_frames=dark_frames,
        empty_detections=int(sum(unflagged)),
        wcs_misses=np.concatenate(misses),
        cosmic_rays=config.radiation.environment != "none",
        example=example,
    ) | {
        "solver": Solver(camera_model_max_px=calibration.max_px, temperature_k=temperature_k, blind=solver.blind),
        "attitudes": attitudes(solved) if solved else None,
        "solved_frames": solved or None,
        "unsolved": None if solved else solve.Unsolved(without_solver=solver.missing),
    }


def files(result: Mapping[str, Any], folder: Path) -> None:
    """Index, data card and contact sheet, in addition to the files of every run."""
    frames, detected = result["frames"], result.get("detection")
    write_closing_files(
        frames.scene,
        frames.folder,
        frames.records,
        folder,
        exports=frames.exports,
        baseline=_baseline(frames.scene.config, result),
        example=None if detected is None else detected.example,
    )


def _baseline(config: DatasetConfig, result: Mapping[str, Any]) -> dict[str, str]:
    """Baseline results of simple methods on the frames."""
    detected, solved, bins = (result.get(name) for name in ("detection", "attitudes", "centroids"))
    if detected is None or not detected.bright_stars:
        return {}
    half = detected.magnitude_of_half
    faint = f", half of the stars of {half:.2f} mag" if math.isfinite(half) else ""
    texts = {
        f"detection at {config.threshold_sigma:g} sigma, first {detected.frames_looked_at} frames": (
            f"{100 * detected.bright_undisturbed:.2f} % of undisturbed stars of SNR 10 and more{faint}; "
            f"{detected.false_not_flagged:.2f} false detections per frame"
        )
    }
    if bins and math.isfinite(ratio := detection.mean_ratio(bins)[0]):
        texts[f"centroid ({config.centroid})"] = f"error {ratio:.2f} times the Cramer-Rao bound"
    if solved is not None:
        texts["attitude (tetra3rs, lost in space)"] = (
            f"{solved.solved} of {solved.attempted} frames solved, boresight error "
            f"{solved.median_arcsec.value:.2f} arcsec in the median, {solved.p95_arcsec:.2f} for 95 %"
        )
    return texts


def sky_coverage(outcome: Outcome) -> Figure:
    """Boresights of the frames; icrs, east to the left."""
    from experiments.harness.plotting import PALETTE, new_figure

    figure, axis = new_figure(aspect_ratio=0.52, subplot_kw={"projection": "mollweide"})
    records, solved = outcome.result["frames"].records, outcome.result.get("solved_frames") or ()
    ra, dec = (np.radians([getattr(record, f"{name}_deg") for record in records]) for name in ("ra", "dec"))
    longitude = -((ra + np.pi) % (2 * np.pi) - np.pi)  # right ascension grows to the left, 0h in the middle
    stars = np.array([record.stars for record in records], float)
    shown = axis.scatter(
        longitude, dec, c=stars, s=np.clip(2000 / max(len(ra), 1), 4, 30), cmap="viridis", linewidths=0
    )
    figure.colorbar(shown, ax=axis, shrink=0.7, label="stars", pad=0.03)
    unsolved = [frame.frame for frame in solved if not frame.solved]  # evaluated frames are the first ones
    if unsolved:
        axis.scatter(longitude[unsolved], dec[unsolved], s=60, marker="x", color=PALETTE[1], label="not solved")
        axis.legend(loc="lower right")
    axis.set_xticks(np.radians(np.arange(-120, 121, 60)), ["8h", "4h", "0h", "20h", "16h"])
    axis.tick_params(labelsize=7)
    return figure


SECTIONS = {
    "frames": Section(record=CompleteDataset, figures={"sky_coverage": sky_coverage}),
    **detection.SECTIONS,
    "exports": Section(record=Export, dim="export", along="format"),
    "solver": Section(record=Solver),
    **solve.SECTIONS,
}
