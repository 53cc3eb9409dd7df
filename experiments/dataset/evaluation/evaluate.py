"""What others find in the frames of a dataset: stars, attitudes, world coordinates; read back from the files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.cameras.fit import MapFit, fit_camera
from experiments.dataset.evaluation.centroid_bound import CentroidBound, dataset_bound
from experiments.dataset.evaluation.detection import FoundStars, compare_frame, joined
from experiments.dataset.evaluation.independent import (
    TURN_DEG,
    PlainAttitude,
    plain_attitude,
    pointing_off_arcsec,
    read_pixels,
    turn_missed_sigma,
    turned_px,
)
from experiments.dataset.evaluation.solve import BlindSolver, SolvedFrame
from experiments.dataset.evaluation.wcs_check import wcs_misses_px
from experiments.dataset.truth.files import read_table
from experiments.dataset.truth.frame_record import FrameRecord
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.filter_wheel import open_band
from experiments.laboratory.readout.frames import empty_frame, mean_dark_frame
from experiments.laboratory.readout.noise_model import true_noise
from experiments.laboratory.readout.psf_grid import PsfGrid, render_psf_grid
from experiments.laboratory.readout.reduction import MeasuredFrame, Reduction, measure_frame
from optics.arrays import FloatArray
from render.fits.files import read_frame

if TYPE_CHECKING:
    from experiments.dataset.frames.scene import Scene
    from render.engine.random import Streams

__all__ = ["Evaluation", "Example", "evaluate"]


EMPTY = "empty"
"""Random streams of frames without stars."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A frame to be shown."""

    frame: int  # Its number
    electrons: NDArray[np.float32]  # (h, w) Above the dark
    measured: MeasuredFrame  # What was detected
    truth: dict[str, Any]  # Columns of its truth


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """What was found."""

    frames: int  # How many were looked at
    temperature_k: float  # Colour of the stars that the camera is calibrated for: the median
    calibration: MapFit  # Camera model
    solved: tuple[SolvedFrame, ...]  # One per frame; empty where the solver is missing
    without_solver: str  # Why, if so
    blind: bool  # Whether stars were identified without a rough attitude (`experiments.dataset.evaluation.solve`)
    stars: FoundStars  # Of all frames
    bound: CentroidBound  # What centroids could reach
    # Expected electrons of a pixel without star, sky and dark current, that the bound was computed with
    background_e: float
    empty_frames: int  # Frames without stars that were read out for comparison, with the same background
    empty_detections: int  # What was detected in them without a flag of the measurement
    wcs_miss_px: FloatArray  # (n,) Of all stars of all frames
    # Written attitudes against the pixels, of frames at rest (`experiments.dataset.evaluation.independent`)
    plain: tuple[PlainAttitude, ...]
    pointing_off_arcsec: FloatArray  # (n,) Written boresight and roll against the written quaternion
    # How far the blind solution is off that of the same stars turned by a known angle, in its sigmas, for the first
    # frame that is solved; NaN without one
    turned_off_sigma: float
    example: Example | None  # The first frame with stars


def evaluate(
    folder: Path, scene: Scene, records: Sequence[FrameRecord], *, patterns: Any, advance: Callable[[], None]
) -> Evaluation:
    """Measure, solve and compare frames of a dataset."""
    verify, camera = scene.config.verify, scene.instrument.camera
    streams = scene.plan.streams.child("verify")
    dark = mean_dark_frame(scene.instrument, verify.dark_frames, streams=streams, label=EMPTY)
    temperature_k = float(np.median(scene.temperature_k))
    psfs = render_psf_grid(scene.instrument, scene.light, temperature_k=temperature_k, window_px=scene.config.window_px)
    reduction = _reduction(scene, dark, psfs)
    known = scene.instrument.pixel_map(open_band(scene.config.passband, scene.instrument), temperature_k=temperature_k)
    calibration = fit_camera(known)
    solver = BlindSolver(scene, calibration, patterns)
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    stars, solved, misses, plain = [], [], [np.zeros(0)], []
    focal_px, turned_off = scene.instrument.focal_length_mm / camera.pixel_pitch_mm, float("nan")
    example: Example | None = None
    for one in records:
        frame = read_frame(folder / one.file)
        table = read_table(folder / one.truth)
        truth = {name: np.asarray(table[name]) for name in table.colnames}
        smear = np.hypot(truth["smear_x_px"], truth["smear_y_px"])
        measured = measure_frame(frame, reduction, smear_px=float(np.nanmax(smear, initial=0.0)))
        stars.append(compare_frame(one.frame, measured, truth, **size))
        rows_differ = scene.config.instrument.line_time_us and any(one.rate_deg_per_s)  # each has its own attitude
        if not rows_differ:
            misses.append(wcs_misses_px(folder / one.file, truth, **size))
        if not any(one.rate_deg_per_s):
            pixels = read_pixels(folder / one.file)
            plain.append(plain_attitude(pixels, one, truth, focal_px=focal_px, centre_px=camera.centre_px))
        if not solver.missing:
            solved.append(solver.solve(one, measured.at_once(solver.turned(one, measured))))
            if solver.blind and np.isnan(turned_off) and solved[-1].solved and not any(one.rate_deg_per_s):
                turned = measured.at_once(turned_px(measured.stars.pixel_px, camera.centre_px, TURN_DEG))
                turned_off = turn_missed_sigma(solved[-1], solver.solve(one, turned))
        if example is None and one.stars:
            light = (frame.dn - dark) / np.float32(frame.gain_dn_per_e)
            example = Example(frame=one.frame, electrons=light, measured=measured, truth=truth)
        advance()
    sky_e = float(np.mean([one.background_e for one in records]))
    return Evaluation(
        frames=len(records),
        temperature_k=temperature_k,
        calibration=calibration,
        solved=tuple(solved),
        without_solver=solver.missing,
        blind=solver.blind,
        stars=joined(stars),
        bound=dataset_bound(scene, psfs, sky_e),
        background_e=sky_e + scene.instrument.pixel_noise().dark_e,
        empty_frames=verify.dark_frames,
        empty_detections=_in_empty_frames(scene, reduction, sky_e, streams.child("empty")),
        wcs_miss_px=np.concatenate(misses),
        plain=tuple(one for one in plain if one is not None),
        pointing_off_arcsec=np.array([pointing_off_arcsec(one) for one in records]),
        turned_off_sigma=turned_off,
        example=example,
    )


def _in_empty_frames(scene: Scene, reduction: Reduction, sky_e: float, streams: Streams) -> int:
    """Detections without a flag in frames of an even background: what noise alone makes."""
    count = 0
    for frame in range(scene.config.verify.dark_frames):
        empty = empty_frame(scene.instrument, frame, sky_e=sky_e, streams=streams, label=EMPTY)
        found = measure_frame(empty, reduction)
        count += int(np.count_nonzero(~found.stars.sharp))
    return count


def _reduction(scene: Scene, dark_dn: NDArray[Any], psfs: PsfGrid | None) -> Reduction:
    """The configured reduction."""
    config = scene.config
    return Reduction(
        dark_dn=dark_dn,
        noise=true_noise(scene.instrument, dark_frames=config.verify.dark_frames),
        centroid=config.centroid,
        window_px=config.window_px,
        threshold_sigma=config.threshold_sigma,
        psfs=psfs if needs_epsf(config.centroid) else None,
    )
