"""Star lists with known truth: attitudes from the document's matrices written out (ACF17, eq. 1, 2 and 6)."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib import AttitudeCorrelated, BrownConrady, FreeAttitudes, NoAttitude, Observations, SensorGeometry, calibrate
from calib.calibration.gyro_linked import GyroLinked, GyroNoise

GEOMETRY = SensorGeometry(width_px=1024, height_px=1024, pixel_pitch_mm=0.01)
DISTORTION = {"q1_per_mm2": 2e-4, "q2_per_mm4": -4e-7, "q3_per_mm6": 1e-8, "p1_per_mm": 2e-4, "p2_per_mm": 2e-4}
CAMERA = BrownConrady.create(GEOMETRY, focal_length_mm=25.6, x0_px=10.0, y0_px=-10.0, **DISTORTION)
START = BrownConrady.create(GEOMETRY, focal_length_mm=20.0)  # start values of ACF17, table 2
NARROW = BrownConrady.create(GEOMETRY, focal_length_mm=83.0, x0_px=10.0, y0_px=-10.0)  # 7 deg
PHI_DEG = (56.9476, -1.0046, -25.3335)
THETA_DEG = (2.0, 2.0, 2.0)
GYRO_NOISE = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=0.005, bias_deg_per_h=0.03)


def document_matrix(angles_deg):
    """R_y(a2) R_x(a1) R_z(a3) with the matrices as printed."""
    (c1, c2, c3), (s1, s2, s3) = np.cos(np.deg2rad(angles_deg)), np.sin(np.deg2rad(angles_deg))
    x = np.array([[1, 0, 0], [0, c1, s1], [0, -s1, c1]])
    y = np.array([[c2, 0, -s2], [0, 1, 0], [s2, 0, c2]])
    z = np.array([[c3, s3, 0], [-s3, c3, 0], [0, 0, 1]])
    return y @ x @ z


@dataclass(frozen=True)
class Scene:
    """Observations, what the gyro said, and the truth."""

    observations: Observations
    gyro: Rotation
    attitude: Rotation
    exact_px: np.ndarray
    camera: BrownConrady
    theta_deg: tuple

    @property
    def truth(self):
        """Camera, phi, theta."""
        return np.concatenate([self.camera.parameters, np.deg2rad(PHI_DEG), np.deg2rad(self.theta_deg)])

    @property
    def installation(self):
        return Rotation.from_matrix(document_matrix(self.theta_deg))

    def calibrated(self, family, *, stars=None, start=START, **options):
        """Calibration of the observations, or of other stars, from the start values of ACF17."""
        return calibrate(self.observations if stars is None else stars, start, family, **options)

    def family(self, method, noise=GYRO_NOISE):
        """A family that knows nothing of attitudes and installation."""
        time = np.arange(float(len(self.gyro)))
        return {
            "free": FreeAttitudes(),
            "acc": AttitudeCorrelated(gyro_rotation=self.gyro),
            "linked": GyroLinked(gyro_rotation=self.gyro, time_s=time, noise=noise),
            "angles": NoAttitude(),
            "weighted angles": NoAttitude(weighting="full"),
        }[method]

    def noisy(self, rng, sigma_px=0.05):
        """The same stars measured once more."""
        shift = rng.normal(0.0, sigma_px, self.exact_px.shape)
        covariance = np.tile(sigma_px**2 * np.eye(2), (len(shift), 1, 1))
        return replace(self.observations, pixel_px=self.exact_px + shift, covariance_px2=covariance)

    def with_wrong_matches(self, part, rng):
        """Stars of a part of the list named wrongly: their directions belong to other places of the same field."""
        direction = self.observations.direction.copy()
        wrong = rng.random(len(direction)) < part
        place = self.camera.unproject(rng.uniform(0, 1023, (int(wrong.sum()), 2)))
        to_sky = self.attitude.inv()[self.observations.frame[wrong]]
        direction[wrong] = to_sky.apply(place)
        return replace(self.observations, direction=direction), wrong


def assert_same_covariance(found, expected, atol):
    """Elements agree in units of the expected standard deviations."""
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=atol)


def body_turns(frames, rate_deg, *, single_axis=False):
    """Turns of the gyro body from the first frame, about an axis that wanders (or not)."""
    turns = [np.eye(3)]
    for k in range(1, frames):
        angle = 2 * np.pi * k / frames
        axis = np.array([0.0, 1.0, 0.0]) if single_axis else np.array([np.cos(angle), np.sin(angle), 0.5])
        axis /= np.linalg.norm(axis)
        turns.append(Rotation.from_rotvec(-np.deg2rad(rate_deg) * axis).as_matrix() @ turns[-1])
    return np.array(turns)


def make_scene(
    seed=0,
    *,
    frames=12,
    stars=12,
    sigma_px=0.05,
    camera=CAMERA,
    rate_deg=1.0,
    single_axis=False,
    theta_deg=THETA_DEG,
    area_px=(0.0, 1023.0),
):
    """Stars at random places of the detector (or of a square of it) in frames of a turning camera."""
    rng = np.random.default_rng(seed)
    turn = body_turns(frames, rate_deg, single_axis=single_axis)
    a, first = document_matrix(theta_deg), document_matrix(PHI_DEG)
    attitude = np.array([a @ g @ a.T @ first for g in turn])
    frame = np.repeat(np.arange(frames), stars)
    exact = rng.uniform(*area_px, (frames * stars, 2))
    direction = np.einsum("nji,nj->ni", attitude[frame], camera.unproject(exact))
    measured = exact + rng.normal(0.0, sigma_px, exact.shape)
    observations = Observations.isotropic(
        pixel_px=measured, direction=direction, frame=frame, sigma_px=sigma_px or 0.05, frames=frames
    )
    turns = Rotation.from_matrix(turn)
    return Scene(observations, turns, Rotation.from_matrix(attitude), exact, camera, theta_deg)
