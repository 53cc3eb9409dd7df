"""Blind solution of the frames: tetra3rs identifies the stars, attitudes are solved and compared with the truth.

tetra3rs gets centroids, a calibrated camera and the full sky, no attitude. Two attitudes follow from its matches: with
equal weights, and from all detections near a catalogue star, weighted by their covariance and an unmodelled common
error (undersampling, colour) for which the residuals match their expectation, after R. C. Paule and J. Mandel, J. Res.
NBS 87, 377 (1982), here by their median. Neither uses the truth. Fields below `NARROWEST_BLIND_DEG` contain too few
stars of tetra3rs (to G = 10) for patterns of four, which would take minutes: there stars are identified from an
approximate attitude, `PRIOR_OFF_PX` pixels from the truth, and reports state this.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.association import associate
from calib.attitude.identify import Identification, identify
from calib.attitude.pattern_cache import camera_database
from calib.attitude.star_attitude import FEWEST, MATCH_PX, NARROWEST_BLIND_DEG, balanced_attitude, identify_stars
from calib.cameras.base import CameraModel
from calib.measure.reduced_frame import MeasuredFrame
from calib.measure.statistics.robust import rms_pull, robust_median
from experiments.harness.drawings import cloud
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, below, col, ratio_near
from experiments.harness.summary import Measured
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.records import freeze
from optics.units import RAD_ARCSEC

if TYPE_CHECKING:
    from calib.cameras.fit import MapFit
    from experiments.dataset.scene import DatasetScene
    from experiments.dataset.truth import FrameRecord


PRIOR_OFF_PX = 20.0
GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))  # golden angle: directions of the a-priori errors, frame by frame


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyMap:
    """Apparent directions of the catalogue, for attitudes."""

    direction: FloatArray  # (n, 3) Unit vectors, ICRS, aberration included if the frames have it
    by_id: Mapping[int, FloatArray] | None  # Directions by identifier of tetra3rs; None: the directions of its database
    id: NDArray[np.int64]  # (n,) Identifiers

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        freeze(self, "id", shape=("n",), dtype=np.int64, sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class SolvedFrame:
    """Result of a frame; errors are rotation vectors in the camera frame: cross-boresight x, y, and roll z."""

    frame: int = col("Frame")
    # Status of `calib.attitude.identify.identify`; "wrong" for an error of more than a pixel
    status: str = col("Status")
    detected: int = col("Detected")
    fit: int = col("Without a flag")
    identified: int = col("Identified")
    used: int = col("In the attitude")
    error_arcsec: FloatArray = col("Error", "arcsec", dims="axis")  # NaN for none
    sigma_arcsec: FloatArray = col("σ", "arcsec", dims="axis")
    message: str = col("Message")
    equal_error_arcsec: FloatArray  # (3,) Attitude error with equal weights of the stars that tetra3rs matched
    common_px: float  # Common centroid error estimated from the residuals

    def __post_init__(self) -> None:
        for name in ("error_arcsec", "sigma_arcsec", "equal_error_arcsec"):
            freeze(self, name, shape=(3,), finite=False)

    @property
    def solved(self) -> bool:
        """Whether the stars were identified and the attitude is right."""
        return self.status == "identified"


def solve_frame(
    frame: int,
    measured: MeasuredFrame,
    *,
    model: CameraModel,
    model_turn: Rotation,
    database: Any,
    sky: SkyMap,
    truth: Rotation,
    pixel_arcsec: float,
    near: Rotation | None = None,
) -> SolvedFrame:
    """Solve one frame blind, or near an a-priori attitude, and compare with the truth."""
    # patterns consist of the brightest stars, saturated and blended ones included
    stars = measured.stars
    usable = np.isfinite(stars.pixel_px).all(axis=1) & np.isfinite(stars.flux_e) & ~stars.sharp
    if near is not None:
        match = identify_stars(stars, model, sky, near=near)
    else:
        match = identify(stars.pixel_px[usable], model, database, flux=stars.flux_e[usable], catalogue=sky.by_id)
    pixel = stars.pixel_px[measured.fit]
    common: dict[str, Any] = {
        "frame": frame,
        "detected": len(measured.stars),
        "fit": len(pixel),
        "identified": len(match.detected),
    }
    if not match.ok or match.attitude is None:
        errors: dict[str, Any] = dict.fromkeys(
            ("error_arcsec", "sigma_arcsec", "equal_error_arcsec"), np.full(3, np.nan)
        )
        return SolvedFrame(
            **common, **errors, status=match.status, message=match.message, used=0, common_px=float("nan")
        )
    equal = attitude_error_arcsec(model_turn.inv() * match.attitude.rotation, truth)
    weighted, used, common_px = _weighted(measured, pixel, model, match, sky, pixel_arcsec)
    error = attitude_error_arcsec(model_turn.inv() * weighted.rotation, truth)
    cross_arcsec = np.hypot(error[0], error[1])
    wrong = not cross_arcsec < pixel_arcsec
    return SolvedFrame(
        **common,
        status="wrong" if wrong else "identified",
        message=f"off by {cross_arcsec:.3g} arcsec" if wrong else match.message,
        used=used,
        error_arcsec=error,
        sigma_arcsec=np.sqrt(np.diagonal(weighted.covariance_rad2)) * RAD_ARCSEC,
        equal_error_arcsec=equal,
        common_px=common_px,
    )


def _weighted(
    measured: MeasuredFrame,
    pixel: FloatArray,
    model: CameraModel,
    match: Identification,
    sky: SkyMap,
    pixel_arcsec: float,
) -> tuple[Any, int, float]:
    """Attitude from all detections near a star, their number, and their common error [px]."""
    assert match.attitude is not None
    pairs = associate(pixel, sky.direction, match.attitude.rotation, model, radius_px=MATCH_PX)
    if len(pairs.detected) < FEWEST:
        return match.attitude, len(match.detected), float("nan")
    covariance = measured.stars.covariance[measured.fit][pairs.detected]
    variance = (covariance[:, 0, 0] + covariance[:, 1, 1]) / 2.0
    v_cam, v_ref = model.unproject(pixel[pairs.detected]), sky.direction[pairs.catalogue]
    solution, used, common_px = balanced_attitude(v_cam, v_ref, variance, pixel_arcsec / RAD_ARCSEC)
    return solution, int(used.sum()), common_px


def _field_deg(scene: DatasetScene) -> tuple[float, float]:
    """Full width and height of the field of view."""
    camera = scene.instrument.camera
    half = camera.pixel_pitch_mm / 2 / scene.instrument.focal_length_mm * np.array([camera.width_px, camera.height_px])
    width, height = 2.0 * np.degrees(np.arctan(half))
    return float(width), float(height)


def star_patterns(scene: DatasetScene) -> Any:
    """Patterns of tetra3rs for the camera of a dataset; None without tetra3rs, or in a field too narrow for them."""
    field = _field_deg(scene)
    if importlib.util.find_spec("tetra3rs") is None or field[0] < NARROWEST_BLIND_DEG:
        return None
    return camera_database(*field)


class BlindSolver:
    """tetra3rs with the camera and the sky of a dataset; in narrow fields, identification near an a-priori attitude."""

    def __init__(self, scene: DatasetScene, calibration: MapFit, patterns: Any) -> None:
        self.scene, self.calibration, self.database = scene, calibration, patterns
        self.blind = _field_deg(scene)[0] >= NARROWEST_BLIND_DEG
        # Reason for no solution; "" for none
        self.missing = "" if patterns or not self.blind else "tetra3rs is not installed: pip install '.[solve]'"
        catalogue, direction = scene.catalogue, scene.sky.direction
        by_id = None
        if scene.config.catalogue.source == "gaia":  # the identifiers of tetra3rs
            by_id = dict(zip(catalogue.id.tolist(), direction, strict=True))
        self.sky = SkyMap(direction=direction, by_id=by_id, id=catalogue.id)

    def turned(self, record: FrameRecord, measured: MeasuredFrame) -> FloatArray:
        """Centroids (n, 2) propagated to the middle of the exposure of the middle row, by the rate of a gyro."""
        camera, model, pixel = self.scene.config.instrument, self.calibration.model, measured.stars.pixel_px
        if not (camera.line_time_us and any(record.rate_deg_per_s)):
            return pixel
        middle = (self.scene.instrument.camera.height_px - 1) / 2.0
        delay_s = (np.nan_to_num(pixel[:, 1], nan=middle) - middle) * camera.line_time_us * 1e-6
        rate = self.calibration.rotation.apply(np.radians(record.rate_deg_per_s))
        # R(t + dt) = exp(-rate dt) R(t), inverted
        rotation = Rotation.from_rotvec(delay_s[:, None] * rate)
        finite = np.isfinite(pixel).all(axis=1)
        propagated = np.full_like(pixel, np.nan)
        propagated[finite] = model.project(rotation[finite].apply(model.unproject(pixel[finite])))
        return propagated

    def solve(self, record: FrameRecord, measured: MeasuredFrame) -> SolvedFrame:
        """Solve the attitude of one frame."""
        truth = Rotation.from_quat(record.quat_xyzw)
        angle = PRIOR_OFF_PX * self.scene.instrument.pixel_arcsec / RAD_ARCSEC
        azimuth = record.frame * GOLDEN_RAD
        axis = [np.cos(azimuth), np.sin(azimuth), 0.0]
        offset = self.calibration.rotation * Rotation.from_rotvec(angle * np.array(axis))
        return solve_frame(
            record.frame,
            measured,
            model=self.calibration.model,
            model_turn=self.calibration.rotation,
            database=self.database,
            sky=self.sky,
            truth=truth,
            pixel_arcsec=self.scene.instrument.pixel_arcsec,
            near=None if self.blind else offset * truth,
        )


# --- Sections

UNSOLVED_FRACTION = 0.005
"""Allowed fraction of failed frames; a single failure is always allowed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeStatistics:
    """Attitudes of all frames against the truth; mirrored and wrong solutions are failures."""

    attempted: int = col("Frames tried", shown=False)
    solved: int = col("Frames solved")
    mirrored: int = col("Mirrored", shown=False)
    wrong: int = col("Wrong", shown=False)
    unsolved: int = col("Frames that are not solved", shown=False)
    unsolved_limit: int = col("Largest allowed number of failures", shown=False)
    median_arcsec: Measured = col("Boresight, median", "arcsec", ".2f")
    p95_arcsec: float = col("95 % below", "arcsec")
    largest_arcsec: float = col("Largest", "arcsec")
    equal_weights_median_arcsec: float = col("Median, equal weights", "arcsec")
    roll_median_arcsec: float = col("Roll, median", "arcsec")
    circles_arcsec: FloatArray = col("Half of the frames", "arcsec", dims="across", shown=False)
    pull_rms: FloatArray = col("Error over predicted sigma, RMS", dims="rotation", shown=False)
    pull: Measured | None = col("Error / predicted σ", format=".2f")
    common_px: float = col("Common centroid error, median", "px", ".3f", shown=False)
    boresight_arcsec: FloatArray = col("Boresight error", "arcsec", dims="solved_frame across", shown=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unsolved:
    """Reason for no attempt."""

    without_solver: str = col("Reason for no attempt")


def attitudes(frames: Sequence[SolvedFrame]) -> AttitudeStatistics:
    """Statistics of solved frames; NaN where none was solved."""
    solved = [frame for frame in frames if frame.solved]
    error, sigma, equal = (
        np.array([getattr(frame, f"{name}_arcsec") for frame in solved]).reshape(-1, 3)
        for name in ("error", "sigma", "equal_error")
    )
    cross = np.hypot(error[:, 0], error[:, 1]) if solved else np.full(1, np.nan)
    equal_cross = np.hypot(equal[:, 0], equal[:, 1]) if solved else cross
    common = [frame.common_px for frame in frames if np.isfinite(frame.common_px)]
    (median, spread), pulls = robust_median(cross), error / sigma
    pull = None
    if len(solved) > 1:  # frames scatter more than axes, which share the common error estimated from few stars
        rms, uncertainty = rms_pull(pulls)
        pull = Measured(value=rms, uncertainty=uncertainty, n=len(pulls))
    return AttitudeStatistics(
        attempted=len(frames),
        solved=len(solved),
        mirrored=sum(frame.status == "mirrored" for frame in frames),
        wrong=sum(frame.status == "wrong" for frame in frames),
        unsolved=len(frames) - len(solved),
        unsolved_limit=max(1, math.floor(UNSOLVED_FRACTION * len(frames))),
        median_arcsec=Measured(value=median, uncertainty=spread, n=len(solved)),
        p95_arcsec=float(np.quantile(cross, 0.95)),
        largest_arcsec=float(cross.max()),
        equal_weights_median_arcsec=float(np.median(equal_cross)),
        roll_median_arcsec=float(np.median(np.abs(error[:, 2]))) if solved else math.nan,
        circles_arcsec=np.full(2, median),
        pull_rms=np.sqrt(np.mean(pulls**2, axis=0)) if solved else np.full(3, np.nan),
        pull=pull,
        common_px=float(np.median(common)) if common else math.nan,
        boresight_arcsec=error[:, :2],
    )


def _axes(q: Quantities, frames: Sequence[SolvedFrame]) -> None:
    q.axis("axis", ["x", "y", "roll"], "Axis")


SECTIONS = {
    "unsolved": Section(record=Unsolved),
    "attitudes": Section(
        record=AttitudeStatistics,
        table="solver",
        caption="Errors of the solved attitudes against the truth.",
        figures={"attitude_errors": cloud("boresight_arcsec", ellipses="circles_arcsec")},
        verdicts=[
            below(
                "unsolved",
                "unsolved_limit",
                title="frames that are not solved",
                advice="too few stars: use a longer exposure, a lower threshold, or a wider field",
            ),
            ratio_near(
                "pull",
                within=0.1,  # the common error is known to some 10 % from the stars of a frame
                title="attitude error over its predicted sigma, RMS of x, y and roll",
                advice="centroid errors exceed their covariance: see the centroid bound",
            ),
        ],
    ),
    "solved_frames": Section(
        record=SolvedFrame,
        dim="tried",
        along="frame",
        across="axis",
        axes=_axes,
        caption="All frames to be solved.",
    ),
}
