"""What others find in the frames of a dataset: stars, attitudes, world coordinates; read back from the files."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.identify import build_database
from calib.cameras.fit import MapFit, fit_camera
from experiments.dataset.detection import CentroidBound, FoundStars, centroid_bound, compare_frame, joined
from experiments.dataset.facts import FrameFacts
from experiments.dataset.measure import MeasuredFrame, Reduction, measure_frame, reduction_of
from experiments.dataset.psf_grid import PsfGrid, render_psf_grid
from experiments.dataset.solve import SkyMap, SolvedFrame, solve_frame
from experiments.dataset.truth_file import read_table
from experiments.dataset.wcs_check import wcs_misses_px
from experiments.laboratory.readout.frames import empty_frame, mean_dark_frame
from experiments.laboratory.readout.noise_model import true_noise
from optics.arrays import FloatArray
from render.catalogue.motion import directions_at
from render.fits.files import read_frame
from render.mapping import pixel_map

if TYPE_CHECKING:
    from experiments.dataset.scene import Scene
    from render.engine.random import Streams

__all__ = ["Evaluation", "Example", "evaluate"]


EMPTY = "empty"
"""Random streams of frames without stars."""
FIELD_MARGIN = 0.06
"""The database of patterns is made for fields this much narrower and wider than the camera's."""
BOUND_RADII = (0.0, 0.5, 0.9)
"""Where PSFs for the bound are taken: parts of the largest distance of a PSF from the middle."""
WITHOUT_SOLVER = "tetra3rs is not installed: pip install '.[solve]'"


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A frame to be shown.

    Attributes
    ----------
    frame : int
        Its number.
    electrons : (h, w) float32
        Above the dark.
    measured : MeasuredFrame
        What was detected.
    truth : dict
        Columns of its truth.
    """

    frame: int
    electrons: NDArray[np.float32]
    measured: MeasuredFrame
    truth: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """What was found.

    Attributes
    ----------
    frames : int
        How many were looked at.
    temperature_k : float
        Colour of the stars that the camera is calibrated for: the median.
    calibration : MapFit
        Camera model.
    solved : tuple of SolvedFrame
        One per frame; empty where the solver is missing.
    without_solver : str
        Why, if so.
    stars : FoundStars
        Of all frames.
    bound : CentroidBound
        What centroids could reach.
    background_e : float
        Expected electrons of a pixel without star, sky and dark current, that the bound was computed with.
    empty_frames : int
        Frames without stars that were read out for comparison, with the same background.
    empty_detections : int
        What was detected in them without a flag of the measurement.
    wcs_miss_px : (n,)
        Of all stars of all frames.
    example : Example or None
        The first frame with stars.
    """

    frames: int
    temperature_k: float
    calibration: MapFit
    solved: tuple[SolvedFrame, ...]
    without_solver: str
    stars: FoundStars
    bound: CentroidBound
    background_e: float
    empty_frames: int
    empty_detections: int
    wcs_miss_px: FloatArray
    example: Example | None


def evaluate(folder: Path, scene: Scene, facts: Sequence[FrameFacts], *, advance: Callable[[], None]) -> Evaluation:
    """Measure, solve and compare frames of a dataset.

    Parameters
    ----------
    folder : pathlib.Path
        The dataset.
    scene : Scene
        What its frames have in common.
    facts : sequence of FrameFacts
        The frames to look at.
    advance : callable
        Called once per frame.

    Raises
    ------
    StarbenchError
        Unknown centroider; no light on most of the detector.
    """
    verify, camera = scene.config.verify, scene.instrument.camera
    streams = scene.plan.streams.child("verify")
    dark = mean_dark_frame(scene.instrument, verify.dark_frames, streams=streams, label=EMPTY)
    temperature_k = float(np.median(scene.temperature_k))
    psfs = render_psf_grid(scene, temperature_k=temperature_k, window_px=verify.window_px)
    reduction = reduction_of(scene, dark, psfs)
    known = pixel_map(scene.instrument, scene.light, temperature_k=temperature_k)
    calibration = fit_camera(known)
    solver = _Solver(scene, calibration)
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    stars, solved, misses = [], [], [np.zeros(0)]
    example: Example | None = None
    for one in facts:
        frame = read_frame(folder / one.file)
        table = read_table(folder / one.truth)
        truth = {name: np.asarray(table[name]) for name in table.colnames}
        smear = np.hypot(truth["smear_x_px"], truth["smear_y_px"])
        measured = measure_frame(frame, reduction, smear_px=float(np.nanmax(smear, initial=0.0)))
        stars.append(compare_frame(one.frame, measured, truth, **size))
        if not (scene.config.camera.line_time_us and any(one.rate_deg_per_s)):  # else every row has its own attitude
            misses.append(wcs_misses_px(folder / one.file, truth, **size))
        if solver.database is not None:
            solved.append(solver.solve(one, measured.at_once(solver.turned(one, measured))))
        if example is None and one.stars:
            light = (frame.dn - dark) / np.float32(frame.gain_dn_per_e)
            example = Example(frame=one.frame, electrons=light, measured=measured, truth=truth)
        advance()
    sky_e = float(np.mean([one.background_e for one in facts]))
    return Evaluation(
        frames=len(facts),
        temperature_k=temperature_k,
        calibration=calibration,
        solved=tuple(solved),
        without_solver="" if solver.database is not None else WITHOUT_SOLVER,
        stars=joined(stars),
        bound=dataset_bound(scene, psfs, sky_e),
        background_e=sky_e + scene.instrument.pixel_noise().dark_e,
        empty_frames=verify.dark_frames,
        empty_detections=_in_empty_frames(scene, reduction, sky_e, streams.child("empty")),
        wcs_miss_px=np.concatenate(misses),
        example=example,
    )


class _Solver:
    """tetra3rs with the camera and the sky of a dataset."""

    def __init__(self, scene: Scene, calibration: MapFit) -> None:
        self.scene, self.calibration = scene, calibration
        self.database: Any = None
        if importlib.util.find_spec("tetra3rs") is None:
            return
        camera = scene.instrument.camera
        half = camera.width_px * camera.pixel_pitch_mm / 2 / scene.instrument.focal_length_mm
        field_deg = 2.0 * float(np.degrees(np.arctan(half)))
        self.database = build_database(
            min_fov_deg=field_deg * (1.0 - FIELD_MARGIN), max_fov_deg=field_deg * (1.0 + FIELD_MARGIN)
        )
        catalogue = scene.catalogue.catalog
        direction = directions_at(catalogue, scene.config.sky.epoch_year, scene.observer)
        known = scene.config.sky.catalogue == "gaia"  # the identifiers of tetra3rs are Gaia's
        self.sky = SkyMap(
            direction=direction,
            by_id=dict(zip(catalogue.id.tolist(), direction, strict=True)) if known else None,
        )

    def turned(self, facts: FrameFacts, measured: MeasuredFrame) -> FloatArray:
        """Centroids (n, 2) carried to the middle of the exposure of the middle row, by the rate that a gyro tells."""
        camera, model, pixel = self.scene.config.camera, self.calibration.model, measured.stars.pixel_px
        if not (camera.line_time_us and any(facts.rate_deg_per_s)):
            return pixel
        middle = (self.scene.instrument.camera.height_px - 1) / 2.0
        later_s = (np.nan_to_num(pixel[:, 1], nan=middle) - middle) * camera.line_time_us * 1e-6
        rate = self.calibration.rotation.apply(np.radians(facts.rate_deg_per_s))
        # R(t + dt) = exp(-rate dt) R(t): what is seen later is turned back
        turn = Rotation.from_rotvec(later_s[:, None] * rate)
        known = np.isfinite(pixel).all(axis=1)
        carried = np.full_like(pixel, np.nan)
        carried[known] = model.project(turn[known].apply(model.unproject(pixel[known])))
        return carried

    def solve(self, facts: FrameFacts, measured: MeasuredFrame) -> SolvedFrame:
        """One frame."""
        return solve_frame(
            facts.frame,
            measured,
            model=self.calibration.model,
            model_turn=self.calibration.rotation,
            database=self.database,
            sky=self.sky,
            truth=Rotation.from_quat(facts.quat_xyzw),
            pixel_arcsec=self.scene.instrument.pixel_arcsec,
        )


def _in_empty_frames(scene: Scene, reduction: Reduction, sky_e: float, streams: Streams) -> int:
    """Detections without a flag in frames of an even background: what noise alone makes."""
    count = 0
    for frame in range(scene.config.verify.dark_frames):
        empty = empty_frame(scene.instrument, frame, sky_e=sky_e, streams=streams, label=EMPTY)
        found = measure_frame(empty, reduction)
        count += int(np.count_nonzero(~found.stars.sharp))
    return count


def dataset_bound(scene: Scene, psfs: PsfGrid, sky_e: float) -> CentroidBound:
    """Bound with the PSFs of the lens on an even sky; dark charge and the noise of the mean dark count."""
    verify = scene.config.verify
    distance = np.hypot(*(psfs.place_px - scene.instrument.camera.centre_px).T)
    chosen = [int(np.abs(distance - part * distance.max()).argmin()) for part in BOUND_RADII]
    return centroid_bound(
        [psfs.psfs[k] for k in chosen],
        distance[chosen],
        noise=true_noise(scene.instrument, dark_frames=verify.dark_frames),
        background_e=sky_e,
        window_px=verify.window_px,
        electrons=(30.0, 10.0 * scene.instrument.detector.full_well_e),
    )
