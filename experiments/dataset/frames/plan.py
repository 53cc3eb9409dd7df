"""What each frame is: attitude, motion, split. A pure function of configuration and frame number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.dataset.frames.attitude_files import read_attitudes, read_motion
from experiments.dataset.frames.splits import Splits, build_splits
from experiments.dataset.settings import (
    BodyPointing,
    ConePointing,
    Config,
    FixedRate,
    JitterConfig,
    ListPointing,
    RandomRate,
    ScanPointing,
    SkyPointing,
)
from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import ConfigError, DomainError
from optics.units import DEG_RAD
from render.catalogue.motion import Observer, earth_observer
from render.engine.random import Streams
from render.motion.jitter import JitterSpectrum, jittered
from render.motion.trajectory import ConstantRate, SampledAttitude, Trajectory

__all__ = [
    "FramePlan",
    "Plan",
    "build_plan",
    "fastest_rad_per_s",
    "plan_frame",
    "sun_direction",
]


RATE_SAMPLES = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """All frames of a dataset; made by `build_plan`."""

    config: Config  # The configuration
    streams: Streams  # Root of the randomness of this dataset
    duration_s: float  # From the start of the exposure of the first row to the end of that of the last
    attitudes: Rotation | None  # Of a list
    aim: SkyPointing | ConePointing | None  # Where attitudes are drawn; a cone about the body that is asked for
    path: Trajectory | None  # Of a scan
    to_sun: FloatArray | None  # (3,) Towards the Sun along icrs, where attitudes have to keep away from it
    jitter: JitterSpectrum | None  # Random motion on top; the path of a scan has it already
    splits: Splits  # How the frames are shared out


@dataclass(frozen=True, slots=True, kw_only=True)
class FramePlan:
    """One frame."""

    frame: int  # Its number
    split: str  # train, validation, test, or gap (`experiments.dataset.frames.splits`)
    attitude: Rotation  # cam from icrs in the middle of the exposure
    rate_rad_per_s: FloatArray  # (3,) Angular velocity in camera axes at that time
    start_s: float  # Start of the exposure on the trajectory
    trajectory: Trajectory | None  # Motion during the exposure; None where the camera stands still


def build_plan(config: Config, height_px: int | None = None, diagonal_deg: float = 0.0) -> Plan:
    """Read what has to be read, and refuse what cannot be."""
    pointing = config.pointing
    rows = config.instrument.height_px if height_px is None else height_px
    duration_s = config.instrument.exposure_s + max(0, rows - 1) * config.instrument.line_time_us * 1e-6
    streams, jitter = Streams(config.seed).child("dataset"), _spectrum(config.jitter)
    attitudes: Rotation | None = None
    path: Trajectory | None = None
    if isinstance(pointing, ListPointing):
        attitudes = read_attitudes(pointing.file, "pointing.file")
        if len(attitudes) < config.frames:
            raise ConfigError(
                f"pointing.file: {pointing.file} holds {len(attitudes)} attitudes, {config.frames} frames are asked "
                f"for; set frames to at most {len(attitudes)}"
            )
    elif isinstance(pointing, ScanPointing):
        if not (isinstance(config.rate, FixedRate) and not any(config.rate.rate_deg_per_s)):
            raise ConfigError("rate: the motion of a scan is that of pointing; leave rate out")
        path = _scan(pointing, config, duration_s)
        if jitter is not None:
            path = jittered(path, jitter, streams=streams)  # one motion for all frames
    aim: SkyPointing | ConePointing | None = None
    if isinstance(pointing, BodyPointing):
        aim = _cone_about(pointing, config)
    to_sun = None
    if isinstance(pointing, SkyPointing | ConePointing):
        aim = pointing
        if pointing.sun_exclusion_deg > 0:
            to_sun = sun_direction(config.catalogue.epoch_year)
            if isinstance(pointing, ConePointing):
                _check_cone(pointing, to_sun)
    return Plan(
        config=config,
        streams=streams,
        duration_s=duration_s,
        attitudes=attitudes,
        aim=aim,
        path=path,
        to_sun=to_sun,
        jitter=jitter,
        splits=build_splits(config, streams, diagonal_deg, None if attitudes is None else attitudes.as_matrix()[:, 2]),
    )


def _spectrum(config: JitterConfig) -> JitterSpectrum | None:
    """The configured power spectra."""
    count = len(config.frequency_hz)
    densities = (config.psd_x_arcsec2_per_hz, config.psd_y_arcsec2_per_hz, config.psd_z_arcsec2_per_hz)
    if not count or not any(densities):
        return None
    return JitterSpectrum(
        frequency_hz=np.array(config.frequency_hz),
        psd_arcsec2_per_hz=np.array([values or (0.0,) * count for values in densities]),
    )


def observer_of(config: Config) -> Observer | None:
    """The centre of the Earth, or a place from which the Earth is seen where the settings say; None for no place."""
    if config.catalogue.observer != "earth":
        return None
    observer, background = earth_observer(config.catalogue.epoch_year), config.background
    if background.earth_distance_km is None:
        return observer
    away = attitude_from_angles(*background.earth_direction_deg).as_matrix()[2] * -background.earth_distance_km
    return observer.moved(position_km=away, velocity_km_per_s=np.zeros(3))


def sun_direction(epoch_year: float) -> FloatArray:
    """Unit vector from the Earth towards the Sun, along icrs."""
    away = earth_observer(epoch_year).from_sun_au
    assert away is not None
    return np.asarray(-away / np.linalg.norm(away))


def _cone_about(pointing: BodyPointing, config: Config) -> ConePointing:
    """The cone of boresights that have a body in their field, as the observer sees it."""
    from render.bodies.solar_system import solar_system

    x, y, z = solar_system(
        config.catalogue.epoch_year, observer=observer_of(config), bodies=(pointing.body,)
    ).direction[0]
    return ConePointing(
        ra_deg=float(np.degrees(np.arctan2(y, x)) % 360.0),
        dec_deg=float(np.degrees(np.arcsin(z))),
        radius_deg=pointing.offset_deg,
        roll_deg=pointing.roll_deg,
    )


def _check_cone(pointing: ConePointing, to_sun: FloatArray) -> None:
    """Refuse a cone of which nothing is left."""
    centre = attitude_from_angles(pointing.ra_deg, pointing.dec_deg, 0.0).as_matrix()[2]
    farthest = float(np.degrees(np.arccos(np.clip(centre @ to_sun, -1.0, 1.0)))) + pointing.radius_deg
    if farthest <= pointing.sun_exclusion_deg:
        raise DomainError(
            f"pointing: all of the cone lies within {farthest:.1f} deg of the Sun, pointing.sun_exclusion_deg = "
            f"{pointing.sun_exclusion_deg:g} deg; point elsewhere or change catalogue.epoch_year"
        )


def _scan(pointing: ScanPointing, config: Config, duration_s: float) -> Trajectory:
    last_s = (config.frames - 1) / pointing.frame_rate_hz + duration_s
    if pointing.file:
        times, attitudes = read_motion(pointing.file, "pointing.file")
        path = SampledAttitude(samples_s=times, attitudes=attitudes)
        if path.end_s - path.start_s < last_s:
            most = int((path.end_s - path.start_s - duration_s) * pointing.frame_rate_hz) + 1
            raise DomainError(
                f"pointing.file: {pointing.file} lasts {path.end_s - path.start_s:g} s, {config.frames} frames at "
                f"{pointing.frame_rate_hz:g} Hz need {last_s:g} s; set frames to at most {max(most, 0)}"
            )
        return path
    return ConstantRate(
        initial=attitude_from_angles(pointing.ra_deg, pointing.dec_deg, pointing.roll_deg),
        rate_rad_per_s=np.array(pointing.rate_deg_per_s) * DEG_RAD,
        end_s=1e7 / pointing.frame_rate_hz + duration_s,  # more than the most frames there can be
    )


def plan_frame(plan: Plan, frame: int) -> FramePlan:
    """What frame number ``frame`` is."""
    config, half_s = plan.config, plan.duration_s / 2.0
    if plan.path is not None:
        assert isinstance(config.pointing, ScanPointing)
        start = plan.path.start_s + frame / config.pointing.frame_rate_hz
        at_rest = isinstance(plan.path, ConstantRate) and not plan.path.rate_rad_per_s.any()
        attitude = plan.path.attitude(start + half_s)
        return FramePlan(
            frame=frame,
            split=_split(plan, frame, attitude),
            attitude=attitude,
            rate_rad_per_s=plan.path.rate(start + half_s),
            start_s=start,
            trajectory=None if at_rest else plan.path,
        )
    attitude, rate = _attitude(plan, frame), _rate(plan, frame)
    path: Trajectory | None = None
    if rate.any() or plan.jitter is not None:
        initial = Rotation.from_rotvec(rate * half_s) * attitude  # half an exposure earlier
        path = ConstantRate(initial=initial, rate_rad_per_s=rate, end_s=2.0 * half_s)
    if path is not None and plan.jitter is not None:
        path = jittered(path, plan.jitter, streams=plan.streams, frame=frame)
        attitude, rate = path.attitude(half_s), path.rate(half_s)
    split = _split(plan, frame, attitude)
    return FramePlan(frame=frame, split=split, attitude=attitude, rate_rad_per_s=rate, start_s=0.0, trajectory=path)


def _split(plan: Plan, frame: int, attitude: Rotation) -> str:
    return plan.splits.of(frame, attitude.as_matrix()[2])


def _attitude(plan: Plan, frame: int) -> Rotation:
    if plan.attitudes is not None:
        return plan.attitudes[frame]
    pointing = plan.aim
    assert pointing is not None
    rng = plan.streams.generator("attitude", frame)
    nearest = np.cos(pointing.sun_exclusion_deg * DEG_RAD)
    while True:
        attitude = _drawn(pointing, rng)
        if plan.to_sun is None or attitude.as_matrix()[2] @ plan.to_sun < nearest:
            return attitude


def _drawn(pointing: SkyPointing | ConePointing, rng: np.random.Generator) -> Rotation:
    if isinstance(pointing, SkyPointing):
        return Rotation.from_quat(rng.standard_normal(4))  # a direction uniform on the 3-sphere is a uniform rotation
    height = rng.uniform(np.cos(pointing.radius_deg * DEG_RAD), 1.0)  # equal heights of a cap are equal areas
    azimuth, roll = rng.uniform(0.0, 360.0, 2)
    centre = attitude_from_angles(pointing.ra_deg, pointing.dec_deg, 0.0)
    across = np.sqrt(max(0.0, 1.0 - height * height))
    inside = np.array([across * np.cos(azimuth * DEG_RAD), across * np.sin(azimuth * DEG_RAD), height])
    boresight = centre.inv().apply(inside)
    ra, dec = np.arctan2(boresight[1], boresight[0]), np.arcsin(np.clip(boresight[2], -1.0, 1.0))
    return attitude_from_angles(ra / DEG_RAD, dec / DEG_RAD, roll if pointing.roll_deg is None else pointing.roll_deg)


def _rate(plan: Plan, frame: int) -> FloatArray:
    """Angular velocity in camera axes [rad/s]."""
    rate = plan.config.rate
    if isinstance(rate, FixedRate):
        return np.array(rate.rate_deg_per_s) * DEG_RAD
    rng = plan.streams.generator("rate", frame)
    axis = rng.standard_normal(3)
    share = rng.uniform()
    low, high = rate.lowest_deg_per_s, rate.highest_deg_per_s
    size = low * (high / low) ** share if rate.distribution == "log_uniform" else low + (high - low) * share
    return np.asarray(axis / np.linalg.norm(axis) * size * DEG_RAD)


def fastest_rad_per_s(plan: Plan) -> tuple[float, float]:
    """Largest angular velocities that a frame may have, across the boresight and about it [rad/s]."""
    config = plan.config
    if plan.path is not None:
        assert isinstance(config.pointing, ScanPointing)
        end_s = plan.path.start_s + (config.frames - 1) / config.pointing.frame_rate_hz + plan.duration_s
        rate = plan.path.rate(np.linspace(plan.path.start_s, end_s, RATE_SAMPLES))
        return float(np.hypot(rate[:, 0], rate[:, 1]).max()), float(np.abs(rate[:, 2]).max())
    if isinstance(config.rate, RandomRate):
        return config.rate.highest_deg_per_s * DEG_RAD, config.rate.highest_deg_per_s * DEG_RAD
    x, y, z = config.rate.rate_deg_per_s
    return float(np.hypot(x, y)) * DEG_RAD, abs(z) * DEG_RAD
