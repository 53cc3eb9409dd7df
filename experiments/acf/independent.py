"""ACF17 by a path of its own: eq. 1 to 6 and 11 written out in NumPy, and known moves of stars and sky.

The night. The body's rate is integrated by Runge and Kutta's fourth order, dM/dt = -[w x] M, which gives C_b1_to_bk;
eq. 6 makes attitudes of it, eq. 3 and 4 images. The stars that all calibrations see must lie there.

The adjustment. Eq. 11 for all 14 unknowns by SciPy's Levenberg-Marquardt with differences for derivatives, on the noisy
stars and the gyro of one run: the solution must be that of the estimator.

Known moves. Images moved by d move the principal point by d; a sky turned by D turns the first attitude, C -> C D^T.
Nothing else may move.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from calib.calibration.attitude_correlated import AttitudeCorrelated
from calib.calibration.attitude_family import AttitudeFamily
from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.no_attitude import NoAttitude
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras.brown_conrady import BrownConrady
from experiments.acf.settings import Config
from experiments.acf.simulate import Scene, Stars, choose_frames, gyro_rotations, observe, start_camera
from experiments.laboratory.plain_formulae import acf_camera_px, acf_matrix, small_turn_rad, turn_matrix
from optics.arrays import FloatArray, IntArray
from render.engine.random import Streams

__all__ = ["Check", "check_night"]


STEP_S = 0.05
MOVED_PX = (0.3, -0.2)
SKY_TURN = turn_matrix(np.array([2.0, -1.0, 2.0]) / 3.0, 0.02)
"""Of the whole sky [rad]."""
TABLE1_GYRO = (0.03, 0.005)
"""Bias [deg/h] and angle random walk [deg/sqrt(h)] of ACF17's Table 1."""
NOISE_PX = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """What came of it."""

    images_off_px: float  # Largest distance of a star from where eq. 1 to 6 put it
    # Largest difference of the estimator's 14 unknowns from those of eq. 11 written out, in its sigmas
    adjusted_off_sigma: float
    moved_part: float  # Largest difference of what came back from what was moved, as part of it, over three methods


def _rate(config: Config, time_s: float) -> FloatArray:
    """Angular velocity of the body [rad/s]: of the size of Table 1, its direction goes once round z in the night."""
    speed, tilt = np.radians(config.gyro.angular_speed_deg_per_s), np.arctan(np.sqrt(0.5))
    whole = (config.frames - 1) / config.frame_rate_hz
    turn = 2 * np.pi * time_s / whole if config.gyro.motion == "turning_axis" else 0.0
    return np.asarray(speed * np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)]))


def _body(config: Config) -> FloatArray:
    """C_b1_to_bk (f, 3, 3) of all frames, by integration of the rate."""

    def slope(time_s: float, matrix: FloatArray) -> FloatArray:
        x, y, z = _rate(config, time_s)
        return -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ matrix

    between = 1.0 / config.frame_rate_hz
    steps = int(np.ceil(between / STEP_S))
    h, matrix, found = between / steps, np.eye(3), [np.eye(3)]
    for k in range((config.frames - 1) * steps):
        t = k * h
        k1 = slope(t, matrix)
        k2 = slope(t + h / 2, matrix + h / 2 * k1)
        k3 = slope(t + h / 2, matrix + h / 2 * k2)
        k4 = slope(t + h, matrix + h * k3)
        matrix = matrix + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if (k + 1) % steps == 0:
            found.append(matrix)
    return np.array(found)


def _images(values: FloatArray, body: FloatArray, direction: FloatArray, frame: IntArray, config: Config) -> FloatArray:
    """Images (n, 2) of stars: 8 numbers of the camera, phi and theta [rad]; eq. 1 to 6."""
    camera, first, mount = values[:8], acf_matrix(*values[8:11]), acf_matrix(*values[11:14])
    attitudes = mount @ body @ mount.T @ first  # eq. 6
    seen = np.einsum("nij,nj->ni", attitudes[frame], direction)
    c = config.camera
    return acf_camera_px(list(camera), seen, (c.width_px, c.height_px), 1e-3 * c.pixel_um)


def _truth(config: Config) -> FloatArray:
    c = config.camera
    camera = [c.x0_px, c.y0_px, c.focal_length_mm, c.q1_per_mm2, c.q2_per_mm4, c.q3_per_mm6, c.p1_per_mm, c.p2_per_mm]
    return np.array([*camera, *np.radians(config.sky.phi_deg), *np.radians(config.gyro.installation_deg)])


def check_night(config: Config, scene: Scene, stars: Stars) -> Check:
    """All three for the sky of Fig. 3 to 5."""
    images = _images(_truth(config), _body(config), stars.direction, stars.frame, config)
    streams = Streams(config.seed).child("acf", "written out")
    used, kept = choose_frames(stars, scene, "odd")
    observed = observe(stars, used, kept, NOISE_PX, streams.generator("noise"))
    turned = gyro_rotations(scene, config, streams, range(1), TABLE1_GYRO)[0][kept]
    start = start_camera(config, scene.camera.geometry)
    families: dict[str, AttitudeFamily] = {
        "acc": AttitudeCorrelated(gyro_rotation=turned),
        "free": FreeAttitudes(),
        "iac": NoAttitude(weighting="full"),
    }
    moved = replace(
        observed,
        pixel_px=observed.pixel_px + np.array(MOVED_PX),
        direction=observed.direction @ SKY_TURN.T,
    )
    before = {name: calibrate(observed, start, family) for name, family in families.items()}
    after = {name: calibrate(moved, start, family) for name, family in families.items()}
    return Check(
        images_off_px=float(np.abs(images - stars.pixel_px).max()),
        adjusted_off_sigma=_adjusted_off_sigma(config, observed, turned.as_matrix(), before["acc"]),
        moved_part=max(_moved_part(before[name], after[name]) for name in families),
    )


def _adjusted_off_sigma(config: Config, observed: Observations, body: FloatArray, made: Calibration) -> float:
    """Eq. 11 by differences from a start beside the truth, against the estimator's solution."""
    scale = np.array([1.0, 1.0, 1e-2, 1e-5, 1e-7, 1e-9, 1e-5, 1e-5, *[1e-4] * 6])
    truth = _truth(config)

    def left(step: FloatArray) -> FloatArray:
        where = _images(truth + step * scale, body, observed.direction, observed.frame, config)
        return np.asarray((where - observed.pixel_px).ravel())

    found = truth + scale * least_squares(left, np.full(14, 0.5), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert made.attitude is not None
    assert made.installation is not None
    sigma = np.asarray(made.solution.sigma)
    apart = list(np.abs(found[:8] - made.model.parameters) / sigma[:8])
    for at, other in ((8, made.attitude[0].as_matrix()), (11, made.installation.as_matrix())):
        turn = small_turn_rad(acf_matrix(*found[at : at + 3]) @ other.T)
        apart.append(float(np.abs(turn).max() / sigma[at : at + 3].min()))
    return float(max(apart))


def _moved_part(before: Calibration, after: Calibration) -> float:
    """Difference of two calibrations less what was moved, as part of that."""
    models = before.model, after.model
    assert isinstance(models[0], BrownConrady)
    change = np.asarray(models[1].parameters) - np.asarray(models[0].parameters)
    apart = list(np.abs(change[:2] / np.array(MOVED_PX) - 1.0))
    apart.append(abs(change[2] / models[0].parameters[2]) / 0.02)
    if before.attitude is not None and after.attitude is not None:
        first, second = before.attitude[0].as_matrix(), after.attitude[0].as_matrix()
        apart.append(float(np.abs(small_turn_rad(second @ (first @ SKY_TURN.T).T)).max()) / 0.02)
    return float(max(apart))
