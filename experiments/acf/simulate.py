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
from experiments.acf.settings import Config
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import freeze_all
from optics.units import DEG_RAD
from render.engine.random import Streams
from render.motion.gyro import Gyro, simulate_gyro_runs
from render.motion.trajectory import TurningAxis, swept_rotation

HOUR_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """True values common to all runs."""

    camera: BrownConrady  # The star sensor
    attitude: Rotation  # Cam from icrs
    body: Rotation  # Gyro body at a frame from gyro body at the first
    installation: Rotation  # Cam from gyro body
    time_s: FloatArray  # (f,) Times of the frames
    swept: FloatArray  # (f, 3, 3) Integral over time of the first body from the body at t [s]
    motion: TurningAxis  # Motion of the gyro's body

    def __post_init__(self) -> None:
        freeze_all(self, time_s=("f",), swept=("f", 3, 3))


def build_camera(config: Config, pixel_um: float | None = None) -> BrownConrady:
    """The true camera, with another pixel if one is given."""
    c = config.camera
    pitch_mm = 1e-3 * (c.pixel_pitch_um if pixel_um is None else pixel_um)
    camera = BrownConrady.create(
        SensorGeometry(width_px=c.width_px, height_px=c.height_px, pixel_pitch_mm=pitch_mm),
        focal_length_mm=c.focal_length_mm,
        x0_px=c.x0_px,
        y0_px=c.y0_px,
        q1_per_mm2=c.q1_per_mm2,
        q2_per_mm4=c.q2_per_mm4,
        q3_per_mm6=c.q3_per_mm6,
        p1_per_mm=c.p1_per_mm,
        p2_per_mm=c.p2_per_mm,
    )
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


def start_camera(config: Config, geometry: SensorGeometry) -> BrownConrady:
    """The camera that the adjustments start from: no distortion."""
    s = config.start
    return BrownConrady.create(geometry, focal_length_mm=s.focal_length_mm, x0_px=s.x0_px, y0_px=s.y0_px)


@lru_cache(maxsize=8)
def build_scene(config: Config, pixel_um: float | None = None) -> Scene:
    """Camera, motion and gyro of a configuration; ``pixel_um`` replaces the configured pixel."""
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
    return Scene(
        camera=build_camera(config, pixel_um),
        attitude=installation * body,
        body=body * body[0].inv(),
        installation=installation,
        time_s=time,
        swept=swept_rotation(trajectory, time),
        motion=trajectory,
    )


def gyro_rotations(
    scene: Scene, config: Config, streams: Streams, runs: range, noise: tuple[float, float]
) -> list[Rotation]:
    """The gyro's rotations of the body, frame by frame from the first, for each run."""
    bias, walk = noise
    if bias == 0.0 and walk == 0.0:
        return [scene.body] * len(runs)
    triad = Gyro(
        rate_hz=config.gyro.rate_hz, bias_deg_per_h=np.zeros(3), angle_random_walk_deg_per_sqrt_h=np.full(3, walk)
    )
    time, rates = simulate_gyro_runs(scene.motion, triad, streams, runs=runs)
    for row, run in enumerate(runs):
        sign = streams.generator("bias sign", run).choice([-1.0, 1.0], 3)
        rates[row] += sign * bias * DEG_RAD / HOUR_S
    return list(integrate_rates_many(time, rates, scene.time_s))


def choose_frames(stars: DrawnStars, scene: Scene, which: str) -> tuple[NDArray[np.bool_], IntArray]:
    """Stars of the frames that calibrate, and the frames: "odd" (first, third, ...), "even", or "all"."""
    frames = np.arange(len(scene.time_s))
    kept = {"odd": frames % 2 == 0, "even": frames % 2 == 1, "all": frames >= 0}[which]
    return kept[stars.frame], frames[kept]


def observe(
    stars: DrawnStars, mask: NDArray[np.bool_], frames: IntArray, noise_px: float, rng: np.random.Generator
) -> Observations:
    """Noisy positions of some of the stars; frames are numbered anew."""
    number = np.full(int(frames.max()) + 1, -1)
    number[frames] = np.arange(len(frames))
    # drawn for all stars: leaving a frame out changes no other star's noise
    noise = noise_px * rng.standard_normal(stars.pixel_px.shape)
    return Observations.isotropic(
        pixel_px=(stars.pixel_px + noise)[mask],
        direction=stars.direction[mask],
        frame=number[stars.frame[mask]],
        star=stars.star[mask],
        sigma_px=noise_px,
        frames=len(frames),
    )
