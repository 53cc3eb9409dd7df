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
from experiments.skycal.scene import CameraScene
from experiments.skycal.settings import SkycalConfig
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import concatenated, freeze, freeze_all

BRIGHTEST = 40
"""Number of detections and catalogue stars in the first matching."""
FIRST_TOLERANCE_PX = 12.0
"""Largest error of a position by the camera of the data sheet: its focal length, and the distortion it lacks."""
FINAL_RADIUS_PX = 2.0
"""Largest distance of a detection from its star in the second matching."""
RADIUS_SIGMA = 4.5
"""Search radius of the first matching over the standard deviation of the attitude."""
MIN_MATCHED = 4
"""Smallest number of matched stars in a matched frame."""
CORRECT_PX = 1.0
"""Largest distance of a detection from the light of the star in a correct match."""
FIRST_SIGMA_PX = 0.1
"""Equal weights of the first fit; its result is a camera accurate to `FINAL_RADIUS_PX`."""
CIRCLE_MARGIN_DEG, CATALOGUE_EXCESS = 0.2, 1.2
"""Margin of the circle around the field, and number of catalogue stars per detection of equal area."""
FAILED = StarFlag.NOT_CONVERGED | StarFlag.NO_DATA
"""Flags of a detection without a centroid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Matched:
    """Measured and identified stars, frame after frame."""

    frame: IntArray  # (n,) Frame
    star: IntArray  # (n,) Row in the sky
    row: IntArray  # (n,) Row of the detection in the stamps of the recording
    direction: FloatArray  # (n, 3) Unit vectors in icrs
    pixel_px: FloatArray  # (n, 2) Measured centroids
    covariance_px2: FloatArray  # (n, 2, 2) Covariance of the centroids by temporal noise
    snr: FloatArray  # (n,) Flux over its standard deviation
    photon_px: FloatArray  # (n, 2) Truth: mean of all light of the star
    in_cam: FloatArray  # (n, 3) Truth: direction in cam
    correct: NDArray[np.bool_]  # (n,) Truth: whether the match is correct
    count: dict[str, int]  # Number of detections of all frames by `OUTCOMES`
    first_matched: int  # Number of frames matched with the camera of the data sheet

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


def sheet_camera(scene: CameraScene, config: SkycalConfig) -> CameraModel:
    """Pinhole with the focal length of a data sheet, wrong by ``start.sheet_error_fraction``."""
    focal_length_mm = scene.instrument.focal_length_mm * (1.0 + config.start.sheet_error_fraction)
    return BrownConrady.create(scene.geometry, focal_length_mm=focal_length_mm)


def match_frames(scene: CameraScene, recording: Recording, config: SkycalConfig) -> Matched:
    """Match all frames.

    The brightest detections of a frame are matched with the camera of the data sheet; a first camera model is fitted to
    these matches; with it all detections are matched within `FINAL_RADIUS_PX`.
    """
    _check_detections(scene, recording, config)
    camera = sheet_camera(scene, config)
    first = [_first_match(scene, stars, config, camera, k) for k, stars in enumerate(recording.frames)]
    matched = [match for match in first if match is not None]
    if len(matched) < max(2, scene.frames // 2):
        raise DomainError(
            f"{scene.name}: the stars of {len(matched)} of {scene.frames} frames were matched; at least half are needed"
            ": reduce the a priori attitude error (motion.attitude_error_arcmin = "
            f"{config.motion.attitude_error_arcmin:g}), include more stars ({scene.name}.faintest_mag, "
            f"{scene.name}.instrument.exposure_s) or reduce the focal-length error (start.sheet_error_fraction = "
            f"{config.start.sheet_error_fraction:g})"
        )
    first_camera = calibrate(concatenated(matched, frames=scene.frames), camera, FreeAttitudes(), loss="tukey")
    if not first_camera.converged:
        raise DomainError(f"{scene.name}: no camera fits the first matches ({first_camera.solution.message})")
    assert first_camera.attitude is not None
    final = [
        _FinalMatch(scene, stars, config, number).match(first_camera.model, first_camera.attitude[number])
        for number, stars in enumerate(recording.frames)
        if first[number] is not None
    ]
    total = {name: sum(match.count[name] for match in final) for name in OUTCOMES}
    return concatenated(final, count=total, first_matched=len(matched))


def _check_detections(scene: CameraScene, recording: Recording, config: SkycalConfig) -> None:
    """Refuse frames without a star, and frames with more than half of the detections saturated."""
    detections = sum(len(frame.detections) for frame in recording.frames)
    instrument = scene.instrument.config
    if not detections:
        raise DomainError(
            f"{scene.name}: no star was detected in {scene.frames} frames at {config.threshold_sigma:g} sigma; raise "
            f"{scene.name}.instrument.exposure_s ({instrument.exposure_s:g} s) or check the focus "
            f"({scene.name}.instrument.defocus_mm = {instrument.defocus_mm:g} mm)"
        )
    saturated = sum(int(has_flag(frame.detections.flags, StarFlag.SATURATED).sum()) for frame in recording.frames)
    if 2 * saturated > detections:
        raise DomainError(
            f"{scene.name}: {saturated} of {detections} detections are saturated; lower "
            f"{scene.name}.instrument.exposure_s ({instrument.exposure_s:g} s)"
        )


def _first_match(
    scene: CameraScene, stars: FrameStars, config: SkycalConfig, camera: CameraModel, number: int
) -> Observations | None:
    """Brightest stars of a frame, or None where they cannot be identified."""
    bright = stars.detections.select(slice(BRIGHTEST))
    prior = scene.prior_attitude[number]
    sigma_px = config.motion.attitude_error_arcmin * 60.0 / scene.pixel_arcsec
    radius_px = RADIUS_SIGMA * sigma_px + FIRST_TOLERANCE_PX
    rows = _brightest_near(scene, prior)
    pixel = np.column_stack([bright.x_px, bright.y_px])
    match = match_stars(
        pixel, scene.sky.direction[rows], prior, camera, radius_px=radius_px, tolerance_px=FIRST_TOLERANCE_PX
    )
    pairs = match.association
    if not match.ok or len(pairs) < MIN_MATCHED:
        return None
    return Observations.isotropic(
        pixel_px=pixel[pairs.detected],
        direction=scene.sky.direction[rows[pairs.catalogue]],
        frame=np.full(len(pairs), number),
        sigma_px=FIRST_SIGMA_PX,
        frames=scene.frames,
        star=rows[pairs.catalogue],
    )


def _brightest_near(scene: CameraScene, attitude: Rotation) -> IntArray:
    """Rows of the brightest catalogue stars in a circle around the field: as many per area as detections, and 20 %."""
    width_deg, height_deg = scene.instrument.field_deg
    radius_rad = np.radians(0.5 * np.hypot(width_deg, height_deg) + CIRCLE_MARGIN_DEG)
    in_circle = np.flatnonzero(scene.sky.direction @ attitude.as_matrix()[2] > np.cos(radius_rad))
    area_ratio = np.pi * np.degrees(radius_rad) ** 2 / (width_deg * height_deg)
    order = np.argsort(scene.sky.magnitude[in_circle], kind="stable")
    return in_circle[order[: round(CATALOGUE_EXCESS * area_ratio * BRIGHTEST)]]


@dataclass(frozen=True, slots=True)
class _FinalMatch:
    """Second matching of a frame, with the fitted camera and attitude."""

    scene: CameraScene
    stars: FrameStars
    config: SkycalConfig
    number: int

    def match(self, model: CameraModel, attitude: Rotation) -> Matched:
        """Stars within `FINAL_RADIUS_PX` of detections without a reason to reject them."""
        detections = self.stars.detections
        sky = self.scene.sky
        pixel = np.column_stack([detections.x_px, detections.y_px])
        radius_rad = np.radians(np.hypot(*self.scene.instrument.field_deg))
        in_circle = np.flatnonzero(sky.direction @ attitude.as_matrix()[2] > np.cos(radius_rad))
        pairs = associate(pixel, sky.direction[in_circle], attitude, model, radius_px=FINAL_RADIUS_PX)
        snr = detections.flux_e / np.sqrt(detections.covariance[:, 2, 2])
        outcome = self._outcomes(snr, pairs.detected)
        used = outcome[pairs.detected] == 0
        rows, star = pairs.detected[used], in_circle[pairs.catalogue[used]]
        photon, in_cam = self._truth(star)
        return Matched(
            frame=np.full(len(rows), self.number),
            star=star,
            row=self.stars.first_row + rows,
            direction=sky.direction[star],
            pixel_px=pixel[rows],
            covariance_px2=detections.covariance[rows][:, :2, :2],
            snr=snr[rows],
            photon_px=photon,
            in_cam=in_cam,
            correct=np.hypot(*(pixel[rows] - photon).T) < CORRECT_PX,
            count={name: int((outcome == code).sum()) for code, name in enumerate(OUTCOMES)},
            first_matched=0,
        )

    def _outcomes(self, snr: FloatArray, matched: IntArray) -> IntArray:
        """Index in `OUTCOMES` per detection: 0 if it is used, otherwise that of the first reason to reject it."""
        flags = self.stars.detections.flags
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
        return np.select(reasons, np.arange(1, len(OUTCOMES)))

    def _truth(self, star: IntArray) -> tuple[FloatArray, FloatArray]:
        """Centroid of the light (n, 2) and direction in cam (n, 3) of stars; NaN for a star that was not rendered."""
        order = np.argsort(self.stars.star)
        at = np.clip(np.searchsorted(self.stars.star, star, sorter=order), 0, max(len(order) - 1, 0))
        row = order[at]
        rendered = (self.stars.star[row] == star)[:, None]
        return (
            np.where(rendered, self.stars.photon_px[row], np.nan),
            np.where(rendered, self.stars.direction[row], np.nan),
        )


OUTCOMES = (
    "used",
    "not converged",
    "saturated",
    "blended",
    "at the edge",
    "defective pixel",
    "too faint",
    "not matched",
)
"""Used detections, and reasons to reject a detection in the order of tests."""
