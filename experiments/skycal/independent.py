"""A calibration under the sky by a path of its own: the motion put together anew, residuals written out, known moves.

* The camera's way over the sky follows from its start (right ascension, declination, north up), its rate and the way
  its axis turns, as a product of small turns by Rodrigues' formula. The calibrated attitudes must follow it frame by
  frame, but for one small turn of all frames alike, which belongs to the principal point.
* Residuals follow from the numbers of the calibration by ACF17 eq. 3 and 4 and from quaternions, written out.
* Images moved by d under a sky turned by D move the principal point by d and turn every attitude, A -> A D^T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras import BrownConrady
from experiments.laboratory.plain_formulae import acf_camera_px, matrix_of_quaternion, small_turn_rad, turn_matrix
from experiments.skycal.calibrate import LOSS, Calibrator, start_camera
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from experiments.skycal.scene import Scene
    from experiments.skycal.settings import Config

__all__ = ["Check", "check_calibration", "commanded_matrices", "moved_part"]


STEPS = 20
"""Small turns per frame, about an axis that stands still in each."""
AXIS_TURN = np.pi
"""How far the axis turns about the boresight in the sequence."""
MOVED_PX = (0.4, -0.3)
SKY_TURN = turn_matrix(np.array([2.0, -1.0, 2.0]) / 3.0, 0.02)
"""Of the whole sky [rad]."""
SAME_SKY_RAD = 0.02
"""A common turn larger than this is no principal point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """What came of it."""

    # Largest distance of a calibrated attitude from the commanded one, the common turn removed, in its sigma; NaN for
    # another sky
    attitude_off_sigma: float
    attitudes: int  # Components in it
    # Largest difference of the residuals from those written out; NaN for a model that ACF17 does not have
    residual_off_px: float
    moved_part: float  # Largest difference of what came back from what was moved, as part of it
    focal_ratio: float  # Calibrated focal length over the paraxial one of the prescription; NaN without one


def commanded_matrices(
    frames: int, frame_rate_hz: float, start_deg: tuple[float, float], rate_deg_per_s: float, axis_deg: float
) -> FloatArray:
    """Attitudes cam from icrs (f, 3, 3) at the frames."""
    ra, dec = np.radians(start_deg)
    ahead = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    west = np.array([np.sin(ra), -np.cos(ra), 0.0])
    matrix = np.array([west, -north, ahead])  # columns grow to the west of a sky seen from inside, rows to the south
    tilt, count = np.radians(axis_deg), frames * STEPS
    angle = np.radians(rate_deg_per_s) * frames / frame_rate_hz / count
    found = [matrix]
    for k in range((frames - 1) * STEPS):
        turn = AXIS_TURN * (k + 0.5) / count
        axis = np.array([-np.sin(tilt) * np.sin(turn), np.sin(tilt) * np.cos(turn), np.cos(tilt)])
        matrix = turn_matrix(axis, -angle) @ matrix  # the camera turns by +angle, what it sees by -angle
        if (k + 1) % STEPS == 0:
            found.append(matrix)
    return np.array(found)


def check_calibration(scene: Scene, calibrator: Calibrator, made: Calibration, config: Config) -> Check:
    """All of it for the free calibration of measured centroids."""
    stars = calibrator.observations("measured")
    assert made.attitude is not None
    attitudes = np.array([matrix_of_quaternion(one) for one in made.attitude.as_quat()])
    motion, sky = config.motion, config.sky
    commanded = commanded_matrices(
        scene.frames, motion.frame_rate_hz, (sky.ra_deg, sky.dec_deg), motion.rate_deg_per_s, motion.axis_deg
    )
    size = (scene.geometry.width_px, scene.geometry.height_px)
    focal_px = scene.instrument.focal_length_mm / scene.geometry.pixel_pitch_mm
    off = attitude_off_sigma(attitudes, commanded, stars, focal_px, size)
    start, free = start_camera(scene, config, scene.config.model)
    again = calibrate(_moved(stars), start, FreeAttitudes(), loss=LOSS, free=free)
    brown = isinstance(made.model, BrownConrady)
    written = residuals_px(made, attitudes, stars, size) if brown else np.nan
    apart = written - (stars.pixel_px - _projected(made, stars))
    focal = float(made.model.value("focal_length_mm")) if brown else float("nan")
    return Check(
        attitude_off_sigma=off,
        attitudes=3 * scene.frames,
        residual_off_px=float(np.abs(apart).max()),
        moved_part=moved_part(made, again),
        focal_ratio=focal / scene.instrument.focal_length_mm,
    )


def _projected(made: Calibration, stars: Observations) -> FloatArray:
    """Images (n, 2) as the calibration itself gives them."""
    assert made.attitude is not None
    turn = made.attitude.as_matrix()[stars.frame]
    return np.asarray(made.model.project(np.einsum("nij,nj->ni", turn, stars.direction)))


def attitude_off_sigma(
    attitudes: FloatArray, commanded: FloatArray, stars: Observations, focal_px: float, size_px: tuple[int, int]
) -> float:
    """Largest distance of attitudes (f, 3, 3) from commanded ones in sigma, their common turn removed.

    A frame's sigma is that of the mean of its centroids across the boresight, and of their turn about it.
    """
    off = small_turn_rad(attitudes @ np.swapaxes(commanded, 1, 2))
    if not np.abs(off).max() < SAME_SKY_RAD:
        return float("nan")
    across = stars.pixel_px - np.array(size_px) / 2
    weight = 2.0 / np.trace(stars.covariance_px2, axis1=1, axis2=2)
    total = np.bincount(stars.frame, weight, len(attitudes))
    middle = np.column_stack([np.bincount(stars.frame, weight * across[:, i], len(attitudes)) / total for i in (0, 1)])
    arm = np.bincount(stars.frame, weight * ((across - middle[stars.frame]) ** 2).sum(1), len(attitudes))
    # the boresight is away from the middle of the stars, and takes part of the turn's error
    roll2 = 1.0 / arm
    sigma2 = np.column_stack([(1.0 / total + middle[:, i] ** 2 * roll2) / focal_px**2 for i in (0, 1)] + [roll2])
    weights = 1.0 / sigma2
    common = (weights * off).sum(0) / weights.sum(0)
    return float(np.abs((off - common) / np.sqrt(sigma2)).max())


def residuals_px(made: Calibration, attitudes: FloatArray, stars: Observations, size_px: tuple[int, int]) -> FloatArray:
    """Image minus what the calibration's numbers give (n, 2)."""
    seen = np.einsum("nij,nj->ni", attitudes[stars.frame], stars.direction)
    pitch = made.model.geometry.pixel_pitch_mm
    return np.asarray(stars.pixel_px - acf_camera_px(list(made.model.parameters), seen, size_px, pitch))


def _moved(stars: Observations) -> Observations:
    return replace(
        stars, pixel_px=stars.pixel_px + np.array(MOVED_PX), direction=np.array(stars.direction) @ SKY_TURN.T
    )


def moved_part(before: Calibration, after: Calibration) -> float:
    """Difference of two calibrations less what was moved, as part of that; of any camera model: its images."""
    assert before.attitude is not None
    assert after.attitude is not None
    rays = before.model.unproject(before.model.geometry.grid_px(5))
    shift = after.model.project(rays) - before.model.project(rays) - np.array(MOVED_PX)
    first, second = before.attitude.as_matrix(), after.attitude.as_matrix()
    turn = small_turn_rad(second @ np.swapaxes(first @ SKY_TURN.T, 1, 2))
    return float(max(np.abs(shift).max() / max(np.abs(MOVED_PX)), np.abs(turn).max() / 0.02))
