"""The simulated night of ACF17: a turning body with gyro and star sensor, known stars, noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import rotation_of_angles
from calib.attitude.gyro_attitude import integrate_rates_many
from calib.calibration.drawn_stars import DrawnStars
from calib.calibration.observations import Observations
from calib.cameras.base import SensorGeometry
from calib.cameras.brown_conrady import BrownConrady
from experiments.acf.settings import AcfConfig
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import freeze_all
from optics.units import DEG_RAD
from render.engine.random import Streams
from render.motion.gyro import Gyro, simulate_gyro_runs
from render.motion.trajectory import TurningAxis, swept_rotation

HOUR_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AcfScene:
    """True values common to all runs."""

    camera: BrownConrady  # The star sensor
    attitude: Rotation  # Cam from icrs
    body: Rotation  # Gyro body at a frame from gyro body at the first
    installation: Rotation  # Cam from gyro body: mounting of the star sensor, ACF17's installation matrix
    time_s: FloatArray  # (f,) Times of the frames
    integrated_rotation: FloatArray  # (f, 3, 3) P_k: integral over time of the rotation to the first body frame [s]
    motion: TurningAxis  # Motion of the gyro's body

    def __post_init__(self) -> None:
        freeze_all(self, time_s=("f",), integrated_rotation=("f", 3, 3))


def build_camera(config: AcfConfig, pixel_um: float | None = None) -> BrownConrady:
    """The true camera; ``pixel_um`` replaces the configured pixel pitch."""
    values = config.camera.model_dump()
    configured_um = values.pop("pixel_pitch_um")
    pitch_mm = 1e-3 * (configured_um if pixel_um is None else pixel_um)
    geometry = SensorGeometry(
        width_px=values.pop("width_px"), height_px=values.pop("height_px"), pixel_pitch_mm=pitch_mm
    )
    camera = BrownConrady.create(geometry, **values)
    pixel = camera.geometry.grid_px(33)
    folded = ~np.isfinite(camera.unproject(pixel)).all(axis=1)
    if folded.any():
        centre = camera.geometry.centre_px + camera.parameters[:2]
        radius_mm = pitch_mm * float(np.hypot(*(pixel[folded] - centre).T).min())
        raise DomainError(
            f"camera: this distortion folds the image over {radius_mm:.1f} mm from the principal point, inside the "
            f"detector (half its diagonal is {camera.geometry.half_diagonal_mm:.1f} mm); use smaller q1_per_mm2 ... "
            "p2_per_mm"
        )
    return camera


def start_camera(config: AcfConfig, geometry: SensorGeometry) -> BrownConrady:
    """The camera that the adjustments start from: no distortion."""
    start = config.start
    return BrownConrady.create(geometry, focal_length_mm=start.focal_length_mm, x0_px=start.x0_px, y0_px=start.y0_px)


@lru_cache(maxsize=8)
def build_scene(config: AcfConfig, pixel_um: float | None = None) -> AcfScene:
    """Camera, motion and gyro of a configuration; ``pixel_um`` replaces the configured pixel pitch."""
    gyro = config.gyro
    installation = rotation_of_angles(DEG_RAD * np.array(gyro.installation_deg))
    first = rotation_of_angles(DEG_RAD * np.array(config.sky.phi_deg))
    time = np.arange(config.frames) / config.frame_rate_hz
    end = float(time[-1]) + 1.0 / gyro.rate_hz
    trajectory = TurningAxis(
        initial=installation.inv() * first,
        speed_rad_per_s=gyro.angular_speed_deg_per_s * DEG_RAD,
        turns_rad_per_s=2.0 * np.pi / float(time[-1]) if gyro.motion == "turning_axis" else 0.0,
        end_s=end,
    )
    body = trajectory.attitude(time)
    return AcfScene(
        camera=build_camera(config, pixel_um),
        attitude=installation * body,
        body=body * body[0].inv(),
        installation=installation,
        time_s=time,
        integrated_rotation=swept_rotation(trajectory, time),
        motion=trajectory,
    )


def gyro_rotations(
    scene: AcfScene, config: AcfConfig, streams: Streams, runs: range, noise: tuple[float, float]
) -> list[Rotation]:
    """Measured rotations of the body since the first frame, for each run.

    ``noise``: bias [deg/h] and angle random walk [deg/sqrt(h)].
    """
    bias, walk = noise
    if bias == 0.0 and walk == 0.0:
        return [scene.body] * len(runs)
    gyro = Gyro(
        rate_hz=config.gyro.rate_hz, bias_deg_per_h=np.zeros(3), angle_random_walk_deg_per_sqrt_h=np.full(3, walk)
    )
    time, rates = simulate_gyro_runs(scene.motion, gyro, streams, runs=runs)
    for row, run in enumerate(runs):
        sign = streams.generator("bias sign", run).choice([-1.0, 1.0], 3)
        rates[row] += sign * bias * DEG_RAD / HOUR_S
    return list(integrate_rates_many(time, rates, scene.time_s))


def choose_frames(stars: DrawnStars, scene: AcfScene, frame_selection: str) -> tuple[NDArray[np.bool_], IntArray]:
    """Stars of the frames that calibrate, and the frames: "odd" (first, third, ...) or "all"."""
    frames = np.arange(len(scene.time_s))
    chosen = frames % 2 == 0 if frame_selection == "odd" else frames >= 0
    return chosen[stars.frame], frames[chosen]


def observe(
    stars: DrawnStars, mask: NDArray[np.bool_], frames: IntArray, noise_px: float, rng: np.random.Generator
) -> Observations:
    """Noisy positions of some of the stars, whose frames are numbered from 0."""
    # Noise is drawn for all stars, so that leaving a frame out changes no other star's noise
    noise = noise_px * rng.standard_normal(stars.pixel_px.shape)
    return Observations.isotropic(
        pixel_px=(stars.pixel_px + noise)[mask],
        direction=stars.direction[mask],
        frame=np.searchsorted(frames, stars.frame[mask]),
        star=stars.star[mask],
        sigma_px=noise_px,
        frames=len(frames),
    )
