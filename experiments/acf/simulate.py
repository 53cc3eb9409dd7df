"""The simulated night of ACF17: a turning body with gyro and star sensor, known stars, noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.gyro_attitude import integrate_rates_many
from calib.attitude.link import rotation_of_angles
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

HOUR_S = 3600.0
TILT = float(np.arctan(np.sqrt(0.5)))
"""Of the turning axis against its plane: each body axis then has the same mean square rate."""
SPARE = 3.0
"""Where n stars per frame are wanted, the sky holds this many times n, plus 20; the brightest are seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningAxis:
    """A body whose rate keeps its size while its direction goes round the body's z axis: a `render` trajectory.

    The rate is speed (cos b cos wt, cos b sin wt, sin b). In axes that go round with it the rate is constant, so that
    with w0 = speed (cos b, 0, sin b) the attitude is exactly R(t) = exp([z]w t) exp(-[w0 + w z]t) R(0).
    """

    initial: Rotation  # Body from reference at time 0
    speed_rad_per_s: float  # Size of the rate
    turns_rad_per_s: float  # w: how fast the axis goes round; 0 for a fixed axis
    end_s: float  # Last time

    @property
    def start_s(self) -> float:
        """First time [s]."""
        return 0.0

    @property
    def _fixed(self) -> FloatArray:
        return self.speed_rad_per_s * np.array([np.cos(TILT), 0.0, np.sin(TILT)])

    def attitude(self, time_s: ArrayLike) -> Rotation:
        """Body from reference at a time, or at n of them [s]."""
        time = np.asarray(time_s, float)[..., None]
        z = np.array([0.0, 0.0, self.turns_rad_per_s])
        return Rotation.from_rotvec(z * time) * Rotation.from_rotvec(-(self._fixed + z) * time) * self.initial

    def rate(self, time_s: ArrayLike) -> FloatArray:
        """Angular velocity in body axes [rad/s]."""
        time = np.asarray(time_s, float)[..., None]
        z = np.array([0.0, 0.0, self.turns_rad_per_s])
        return np.asarray(Rotation.from_rotvec(z * time).apply(self._fixed))


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
    pitch_mm = 1e-3 * (c.pixel_um if pixel_um is None else pixel_um)
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
        radius_mm = pitch_mm * float(np.linalg.norm(pixel[folded] - centre, axis=1).min())
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
        swept=_swept(trajectory, time),
        motion=trajectory,
    )


def _swept(trajectory: TurningAxis, time_s: FloatArray, substeps: int = 20) -> FloatArray:
    """Integral of the first body from the body at t (Simpson's rule between frames)."""
    fine = np.linspace(time_s[0], time_s[-1], 2 * substeps * (len(time_s) - 1) + 1)
    turned = (trajectory.attitude(time_s[0]) * trajectory.attitude(fine).inv()).as_matrix()
    step = fine[1] - fine[0]
    pieces = step / 3.0 * (turned[:-1:2] + 4.0 * turned[1::2] + turned[2::2])
    sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(pieces, axis=0)])
    return np.asarray(sums[::substeps])


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Stars:
    """Noise-free stars in frames."""

    pixel_px: FloatArray  # (n, 2) Where they fall
    direction: FloatArray  # (n, 3) Unit vectors, icrs
    frame: IntArray  # (n,) Frame of each
    star: IntArray  # (n,) Number in the sky

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, pixel_px=("n", 2), direction=("n", 3), sizes=sizes)
        freeze_all(self, frame=("n",), star=("n",), sizes=sizes, dtype=np.int64)

    def __len__(self) -> int:
        return len(self.frame)


def draw_stars(scene: Scene, streams: Streams, sky: int, *, mean: float | None = None, exactly: int = 0) -> Stars:
    """A uniform random sky, seen by the camera along its path."""
    camera, geometry = scene.camera, scene.camera.geometry
    dense = SPARE * (exactly if mean is None else mean) + 20.0
    pitch, focal = geometry.pixel_pitch_mm, camera.value("focal_length_mm")
    half = 0.5 * pitch * np.array([geometry.width_px, geometry.height_px]) / focal
    cap = np.cos(1.05 * np.arctan(np.hypot(*half)) + 0.01)
    rng = streams.generator("sky", sky)
    count = rng.poisson(dense * 4.0 * np.pi / _solid_angle(*half))
    z, angle = rng.uniform(-1.0, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    ring = np.sqrt(1.0 - z * z)
    sky_direction = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
    parts: list[tuple[FloatArray, IntArray]] = []  # stars are numbered in the order of their brightness
    for matrix in scene.attitude.as_matrix():
        near = np.flatnonzero(sky_direction @ matrix[2] > cap)
        pixel = camera.project(sky_direction[near] @ matrix.T)
        inside = geometry.contains(pixel)
        chosen = slice(exactly) if mean is None else slice(None)
        parts.append((pixel[inside][chosen], near[inside][chosen]))
    pixel, star = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    frame = np.repeat(np.arange(len(parts)), [len(part[1]) for part in parts])
    if mean is not None:
        faintest = np.sort(star)[min(round(mean * len(parts)), len(star) - 1)]
        bright = star < faintest
        pixel, star, frame = pixel[bright], star[bright], frame[bright]
    return Stars(pixel_px=pixel, direction=sky_direction[star], frame=frame, star=star)


def _solid_angle(half_x: float, half_y: float) -> float:
    """Of a rectilinear field with these half widths in units of the focal length [sr]."""
    return float(4.0 * np.arctan(half_x * half_y / np.sqrt(1.0 + half_x**2 + half_y**2)))


def choose_frames(stars: Stars, scene: Scene, which: str) -> tuple[NDArray[np.bool_], IntArray]:
    """Stars of the frames that calibrate, and the frames: "odd" (first, third, ...), "even", or "all"."""
    frames = np.arange(len(scene.time_s))
    kept = {"odd": frames % 2 == 0, "even": frames % 2 == 1, "all": frames >= 0}[which]
    return kept[stars.frame], frames[kept]


def observe(
    stars: Stars, mask: NDArray[np.bool_], frames: IntArray, noise_px: float, rng: np.random.Generator
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
