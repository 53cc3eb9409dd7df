"""Frames solved by their stars alone: tetra3rs identifies them blind, attitudes follow, the truth judges them.

tetra3rs gets centroids and a calibrated camera, no attitude, and the whole sky. Two attitudes are made of what it
matched: one in which all stars weigh the same, and one from all detections near a star of the catalogue, weighted by
their own covariance and a common error that nobody modelled (undersampling, colour): the one with which the residuals
are as large as they should be, after R. C. Paule and J. Mandel, J. Res. NBS 87, 377 (1982), here by their median.
Neither uses the truth. Fields below `NARROWEST_BLIND_DEG` hold too few stars of the sky that tetra3rs knows (to G = 10)
for patterns of four, and the patterns for them take minutes: there stars are identified from a rough attitude, which is
the written one turned by `PRIOR_OFF_PX` pixels, and reports say so.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.association import associate
from calib.attitude.identify import Identification, identify
from calib.attitude.patterns import kept_database
from calib.attitude.star_attitude import FEWEST, MATCH_PX, balanced_attitude, identify_stars
from calib.cameras.base import CameraModel
from experiments.laboratory.readout.reduction import MeasuredFrame
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.records import freeze
from optics.units import RAD_ARCSEC
from render.catalogue.motion import directions_at

if TYPE_CHECKING:
    from calib.cameras.fit import MapFit
    from experiments.dataset.frames.scene import Scene
    from experiments.dataset.truth.frame_record import FrameRecord

__all__ = ["BlindSolver", "SkyMap", "SolvedFrame", "field_deg", "solve_frame", "star_patterns"]

NARROWEST_BLIND_DEG = 2.0
"""Of 40 random attitudes with stars to 9.5 mag, 40 were solved blind at 2 deg and 36 at 1.5 deg."""
PRIOR_OFF_PX = 20.0
GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))

FIELD_MARGIN = 0.06
"""The database of patterns is made for fields this much narrower and wider than the camera's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyMap:
    """Catalogue that attitudes are computed with, as the camera sees it."""

    direction: FloatArray  # (n, 3) Unit vectors in icrs, aberration included if the frames have it
    # Identifier -> direction; None where identifiers are not those of tetra3rs, whose own directions then serve
    by_id: Mapping[int, FloatArray] | None
    id: NDArray[np.int64]  # (n,) Identifiers

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        freeze(self, "id", shape=("n",), dtype=np.int64, sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class SolvedFrame:
    """What became of one frame; errors are rotation vectors in cam: across the boresight x, y, and roll z."""

    frame: int  # Its number
    status: str  # Of `calib.attitude.identify.identify`; ``"wrong"`` for an attitude that is off by more than a pixel
    message: str  # Of `calib.attitude.identify.identify`; ``"wrong"`` for an attitude that is off by more than a pixel
    detected: int  # Detections, those without a flag, those that tetra3rs matched, those in the weighted attitude
    fit: int  # Detections, those without a flag, those that tetra3rs matched, those in the weighted attitude
    identified: int  # Detections, those without a flag, those that tetra3rs matched, those in the weighted attitude
    used: int  # Detections, those without a flag, those that tetra3rs matched, those in the weighted attitude
    error_arcsec: FloatArray  # (3,) Weighted attitude minus truth; NaN where there is none
    sigma_arcsec: FloatArray  # (3,) What its covariance says
    equal_error_arcsec: FloatArray  # (3,) With equal weights, of the stars that tetra3rs matched
    common_px: float  # Common centroid error that the residuals ask for

    def __post_init__(self) -> None:
        for name in ("error_arcsec", "sigma_arcsec", "equal_error_arcsec"):
            freeze(self, name, shape=(3,), finite=False)

    @property
    def solved(self) -> bool:
        """Whether the stars were identified and the attitude is right."""
        return self.status == "identified"

    @property
    def mirrored(self) -> bool:
        """Whether the stars matched a mirrored sky only."""
        return self.status == "mirrored"

    @property
    def boresight_arcsec(self) -> float:
        """Angle between the boresights."""
        return float(np.hypot(self.error_arcsec[0], self.error_arcsec[1]))


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
    """Solve one frame blind, or near a rough attitude, and compare with the truth."""
    # patterns are made of the brightest stars: those that are saturated or blended must not be missing from them
    stars = measured.stars
    seen = np.isfinite(stars.pixel_px).all(axis=1) & np.isfinite(stars.flux_e) & ~stars.sharp
    if near is not None:
        found = identify_stars(stars, model, sky, near=near)
    else:
        found = identify(stars.pixel_px[seen], model, database, flux=stars.flux_e[seen], catalogue=sky.by_id)
    pixel = stars.pixel_px[measured.fit]
    common: dict[str, Any] = {
        "frame": frame,
        "detected": len(measured.stars),
        "fit": len(pixel),
        "identified": len(found.detected),
    }
    nothing = np.full(3, np.nan)
    if not found.ok or found.attitude is None:
        return SolvedFrame(
            **common,
            status=found.status,
            message=found.message,
            used=0,
            error_arcsec=nothing,
            sigma_arcsec=nothing,
            equal_error_arcsec=nothing,
            common_px=float("nan"),
        )
    equal = attitude_error_arcsec(model_turn.inv() * found.attitude.rotation, truth)
    weighted, used, common_px = _weighted(measured, pixel, model, found, sky, pixel_arcsec)
    error = attitude_error_arcsec(model_turn.inv() * weighted.rotation, truth)
    wrong = not np.hypot(error[0], error[1]) < pixel_arcsec
    return SolvedFrame(
        **common,
        status="wrong" if wrong else "identified",
        message=f"off by {np.hypot(error[0], error[1]):.3g} arcsec" if wrong else found.message,
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
    found: Identification,
    sky: SkyMap,
    pixel_arcsec: float,
) -> tuple[Any, int, float]:
    """Attitude from all detections near a star, how many they are, and their common error [px]."""
    assert found.attitude is not None
    pairs = associate(pixel, sky.direction, found.attitude.rotation, model, radius_px=MATCH_PX)
    if len(pairs.detected) < FEWEST:
        return found.attitude, len(found.detected), float("nan")
    covariance = measured.stars.covariance[measured.fit][pairs.detected]
    variance = (covariance[:, 0, 0] + covariance[:, 1, 1]) / 2.0
    v_cam, v_ref = model.unproject(pixel[pairs.detected]), sky.direction[pairs.catalogue]
    solution, kept, common_px = balanced_attitude(v_cam, v_ref, variance, pixel_arcsec / RAD_ARCSEC)
    return solution, int(kept.sum()), common_px


def field_deg(scene: Scene) -> float:
    """Full width of the field of view."""
    camera = scene.instrument.camera
    half = camera.width_px * camera.pixel_pitch_mm / 2 / scene.instrument.focal_length_mm
    return 2.0 * float(np.degrees(np.arctan(half)))


def star_patterns(scene: Scene) -> Any:
    """Patterns of tetra3rs for the camera of a dataset; None without tetra3rs, or in a field too narrow for them."""
    field = field_deg(scene)
    if importlib.util.find_spec("tetra3rs") is None or field < NARROWEST_BLIND_DEG:
        return None
    return kept_database(min_fov_deg=field * (1.0 - FIELD_MARGIN), max_fov_deg=field * (1.0 + FIELD_MARGIN))


class BlindSolver:
    """tetra3rs with the camera and the sky of a dataset; in narrow fields, identification near a rough attitude.

    Attributes
    ----------
    blind : bool
        Whether nothing but the camera is known before.
    missing : str
        Why no frame can be solved; "" if they can.
    """

    def __init__(self, scene: Scene, calibration: MapFit, patterns: Any) -> None:
        self.scene, self.calibration, self.database = scene, calibration, patterns
        self.blind = field_deg(scene) >= NARROWEST_BLIND_DEG
        self.missing = "" if patterns or not self.blind else "tetra3rs is not installed: pip install '.[solve]'"
        catalogue = scene.catalogue.catalog
        direction = directions_at(catalogue, scene.config.catalogue.epoch_year, scene.observer)
        known = scene.config.catalogue.source == "gaia"  # the identifiers of tetra3rs are Gaia's
        self.sky = SkyMap(
            direction=direction,
            by_id=dict(zip(catalogue.id.tolist(), direction, strict=True)) if known else None,
            id=catalogue.id,
        )

    def turned(self, record: FrameRecord, measured: MeasuredFrame) -> FloatArray:
        """Centroids (n, 2) carried to the middle of the exposure of the middle row, by the rate that a gyro tells."""
        camera, model, pixel = self.scene.config.instrument, self.calibration.model, measured.stars.pixel_px
        if not (camera.line_time_us and any(record.rate_deg_per_s)):
            return pixel
        middle = (self.scene.instrument.camera.height_px - 1) / 2.0
        later_s = (np.nan_to_num(pixel[:, 1], nan=middle) - middle) * camera.line_time_us * 1e-6
        rate = self.calibration.rotation.apply(np.radians(record.rate_deg_per_s))
        # R(t + dt) = exp(-rate dt) R(t): what is seen later is turned back
        turn = Rotation.from_rotvec(later_s[:, None] * rate)
        known = np.isfinite(pixel).all(axis=1)
        carried = np.full_like(pixel, np.nan)
        carried[known] = model.project(turn[known].apply(model.unproject(pixel[known])))
        return carried

    def solve(self, record: FrameRecord, measured: MeasuredFrame) -> SolvedFrame:
        """One frame."""
        truth = Rotation.from_quat(record.quat_xyzw)
        angle = PRIOR_OFF_PX * self.scene.instrument.pixel_arcsec / RAD_ARCSEC
        way = record.frame * GOLDEN_RAD
        off = self.calibration.rotation * Rotation.from_rotvec([angle * np.cos(way), angle * np.sin(way), 0.0])
        return solve_frame(
            record.frame,
            measured,
            model=self.calibration.model,
            model_turn=self.calibration.rotation,
            database=self.database,
            sky=self.sky,
            truth=truth,
            pixel_arcsec=self.scene.instrument.pixel_arcsec,
            near=None if self.blind else off * truth,
        )
