"""Star identification from a data-sheet camera and an attitude with an error of arcminutes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.association import associate, match_stars
from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.observations import Observations
from calib.cameras import BrownConrady
from calib.cameras.base import CameraModel
from calib.flags import StarFlag, has_flag
from experiments.skycal.measure import FrameStars, Recording
from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import concatenated, freeze, freeze_all

BRIGHTEST = 40
"""Number of detections and catalogue stars in the first matching."""
FIRST_TOLERANCE_PX = 12.0
"""How far the camera of the data sheet may be off: its focal length, and a distortion that it does not state."""
FINAL_RADIUS_PX = 2.0
LEAST_RADIUS_SIGMA = 4.5
"""Search radius of the first matching over the standard deviation of the attitude."""
FEWEST_MATCHED = 4
"""Stars in a frame, below which it does not count as matched."""
CORRECT_PX = 1.0
"""A match counts as correct if the light of that star really fell this close."""
FAILED = StarFlag.NOT_CONVERGED | StarFlag.NO_DATA


@dataclass(frozen=True, slots=True, kw_only=True)
class Matched:
    """Measured and identified stars, frame after frame."""

    frame: IntArray  # (n,) Frame, and row in the sky
    star: IntArray  # (n,)
    row: IntArray  # (n,) Row of the detection in the stamps of the recording
    direction: FloatArray  # (n, 3) Unit vectors in icrs
    pixel_px: FloatArray  # (n, 2) Measured centroids
    covariance_px2: FloatArray  # (n, 2, 2) Of the centroids: temporal noise
    snr: FloatArray  # (n,) Flux over its standard deviation
    photon_px: FloatArray  # (n, 2) Truth: mean of all light of the star
    in_cam: FloatArray  # (n, 3) Truth: direction in cam
    correct: NDArray[np.bool_]  # (n,) Truth: whether the match is
    count: dict[str, int]  # What became of the detections of all frames
    first_matched: int  # Frames matched from the camera of the data sheet

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("frame", "star", "row"):
            freeze(self, name, shape=("n",), dtype=np.int64, sizes=sizes)
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        for name in ("pixel_px", "photon_px"):
            freeze(self, name, shape=("n", 2), finite=False, sizes=sizes)
        freeze_all(self, covariance_px2=("n", 2, 2), snr=("n",), sizes=sizes)
        freeze(self, "in_cam", shape=("n", 3), finite=False, sizes=sizes)
        freeze(self, "correct", shape=("n",), dtype=np.bool_, sizes=sizes)

    def __len__(self) -> int:
        return len(self.frame)


def sheet_camera(scene: Scene, config: Config) -> CameraModel:
    """Pinhole with the focal length of a data sheet, not quite right."""
    focal_length_mm = scene.instrument.focal_length_mm * (1.0 + config.start.sheet_error_fraction)
    return BrownConrady.create(scene.geometry, focal_length_mm=focal_length_mm)


def match_frames(scene: Scene, recording: Recording, config: Config) -> Matched:
    """Match all frames.

    The brightest detections give every frame an attitude under the camera of the data sheet; what they match gives a
    first camera; with that one all detections are matched closely.
    """
    _check_detections(scene, recording, config)
    camera = sheet_camera(scene, config)
    first = [_first_match(scene, stars, config, camera, k) for k, stars in enumerate(recording.frames)]
    good = [one for one in first if one is not None]
    if len(good) < max(2, scene.frames // 2):
        raise DomainError(
            f"{scene.name}: the stars of {len(good)} of {scene.frames} frames were matched; at least half are needed: "
            "reduce the a priori attitude error (motion.attitude_error_arcmin = "
            f"{config.motion.attitude_error_arcmin:g}), include more stars ({scene.name}.faintest_mag, "
            f"{scene.name}.instrument.exposure_s) or reduce the focal-length error (start.sheet_error_fraction = "
            f"{config.start.sheet_error_fraction:g})"
        )
    rough = calibrate(concatenated(good, frames=scene.frames), camera, FreeAttitudes(), loss="tukey")
    if not rough.converged:
        raise DomainError(f"{scene.name}: no camera fits the first matches ({rough.solution.message})")
    assert rough.attitude is not None
    parts = [
        _FinalMatch(scene, stars, config, number).match(rough.model, rough.attitude[number])
        for number, stars in enumerate(recording.frames)
        if first[number] is not None
    ]
    total = {name: sum(part.count[name] for part in parts) for name in OUTCOMES}
    return concatenated(parts, count=total, first_matched=len(good))


def _check_detections(scene: Scene, recording: Recording, config: Config) -> None:
    found = sum(len(one.found) for one in recording.frames)
    set_up = scene.instrument.config
    if not found:
        raise DomainError(
            f"{scene.name}: no star was detected in {scene.frames} frames at {config.threshold_sigma:g} sigma; raise "
            f"{scene.name}.instrument.exposure_s ({set_up.exposure_s:g} s) or check the focus "
            f"({scene.name}.instrument.defocus_mm = {set_up.defocus_mm:g} mm)"
        )
    saturated = sum(int(has_flag(one.found.flags, StarFlag.SATURATED).sum()) for one in recording.frames)
    if 2 * saturated > found:
        raise DomainError(
            f"{scene.name}: {saturated} of {found} detections are saturated; lower {scene.name}.instrument.exposure_s "
            f"({set_up.exposure_s:g} s)"
        )


def _first_match(
    scene: Scene, stars: FrameStars, config: Config, camera: CameraModel, number: int
) -> Observations | None:
    """Brightest stars of one frame, or None where they cannot be identified."""
    bright = stars.found.select(slice(BRIGHTEST))
    prior = scene.prior_attitude[number]
    sigma_px = config.motion.attitude_error_arcmin * 60.0 / scene.pixel_arcsec
    radius_px = LEAST_RADIUS_SIGMA * sigma_px + FIRST_TOLERANCE_PX
    rows = _brightest_near(scene, prior)
    pixel = np.column_stack([bright.x_px, bright.y_px])
    found = match_stars(
        pixel, scene.sky.direction[rows], prior, camera, radius_px=radius_px, tolerance_px=FIRST_TOLERANCE_PX
    )
    if not found.ok or len(found.association) < FEWEST_MATCHED:
        return None
    match = found.association
    return Observations.isotropic(
        pixel_px=pixel[match.detected],
        direction=scene.sky.direction[rows[match.catalogue]],
        frame=np.full(len(match), number),
        sigma_px=0.1,
        frames=scene.frames,
        star=rows[match.catalogue],
    )


def _brightest_near(scene: Scene, attitude: Rotation) -> IntArray:
    """Rows of the brightest catalogue stars around a boresight: about as many as detections."""
    width, height = scene.instrument.field_deg
    reach = np.radians(0.5 * np.hypot(width, height) + 0.2)
    near = np.flatnonzero(scene.sky.direction @ attitude.as_matrix()[2] > np.cos(reach))
    share = np.pi * np.degrees(reach) ** 2 / (width * height)  # the circle holds more than the detector
    order = np.argsort(scene.sky.magnitude[near], kind="stable")[: round(1.2 * share * BRIGHTEST)]
    return near[order]


@dataclass(frozen=True, slots=True)
class _FinalMatch:
    """Second matching of one frame, with the fate of its detections."""

    scene: Scene
    stars: FrameStars
    config: Config
    number: int

    def match(self, model: CameraModel, attitude: Rotation) -> Matched:
        """Matches of good detections."""
        found, sky = self.stars.found, self.scene.sky
        pixel = np.column_stack([found.x_px, found.y_px])
        reach = np.radians(np.hypot(*self.scene.instrument.field_deg))
        near = np.flatnonzero(sky.direction @ attitude.as_matrix()[2] > np.cos(reach))
        pair = associate(pixel, sky.direction[near], attitude, model, radius_px=FINAL_RADIUS_PX)
        snr = found.flux_e / np.sqrt(found.covariance[:, 2, 2])
        fault = self._faults(snr, pair.detected)
        fine = fault[pair.detected] == 0
        rows, star = pair.detected[fine], near[pair.catalogue[fine]]
        photon, in_cam = self._truth(star)
        return Matched(
            frame=np.full(len(rows), self.number),
            star=star,
            row=self.stars.first_row + rows,
            direction=sky.direction[star],
            pixel_px=pixel[rows],
            covariance_px2=found.covariance[rows][:, :2, :2],
            snr=snr[rows],
            photon_px=photon,
            in_cam=in_cam,
            correct=np.hypot(*(pixel[rows] - photon).T) < CORRECT_PX,
            count={name: int((fault == code).sum()) for code, name in enumerate(OUTCOMES)},
            first_matched=0,
        )

    def _faults(self, snr: FloatArray, matched: IntArray) -> IntArray:
        """Per detection: 0 if it takes part, otherwise the number of the first of `_REASONS` that holds."""
        flags = self.stars.found.flags
        unmatched = np.ones(len(flags), bool)
        unmatched[matched] = False
        reasons = (
            has_flag(flags, FAILED) | ~np.isfinite(snr),
            has_flag(flags, StarFlag.SATURATED),
            has_flag(flags, StarFlag.BLEND),
            has_flag(flags, StarFlag.EDGE),
            has_flag(flags, StarFlag.DEFECT | StarFlag.SPIKE),
            ~(snr >= self.config.least_snr),
            unmatched,
        )
        fault = np.zeros(len(flags), np.int64)
        for code in range(len(reasons), 0, -1):
            fault[reasons[code - 1]] = code
        return fault

    def _truth(self, star: IntArray) -> tuple[FloatArray, FloatArray]:
        """Centroid of the light (n, 2) and direction in cam (n, 3) of stars; NaN for one that was not rendered."""
        order = np.argsort(self.stars.star)
        at = np.clip(np.searchsorted(self.stars.star, star, sorter=order), 0, max(len(order) - 1, 0))
        row = order[at]
        there = (self.stars.star[row] == star)[:, None]
        return np.where(there, self.stars.photon_px[row], np.nan), np.where(there, self.stars.direction[row], np.nan)


_REASONS = ("not converged", "saturated", "blended", "at the edge", "defective pixel", "too faint", "not matched")
"""Reasons to reject a detection, in the order of tests."""
OUTCOMES = ("used", *_REASONS)
