"""Plan of each frame: attitude, motion, split, as a pure function of configuration and frame number."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.dataset.settings import (
    BodyPointing,
    ConePointing,
    DatasetConfig,
    FixedRate,
    JitterSpectrumConfig,
    ListPointing,
    RandomRate,
    ScanPointing,
    SkyPointing,
)
from experiments.dataset.splits import Splits, build_splits
from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import ConfigError, DomainError
from optics.units import DEG_RAD
from render.catalogue.motion import Observer, earth_observer
from render.engine.random import Streams
from render.motion.jitter import JitterSpectrum, jittered
from render.motion.pointing import random_attitude, random_attitude_in_cone, random_rate
from render.motion.trajectory import ConstantRate, SampledAttitude, Trajectory

RATE_SAMPLES = 1000
"""Times at which the rate of a scan is evaluated for its maximum."""
MAX_FRAMES = 1e7
"""Largest number of frames of a dataset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """All frames of a dataset; from `build_plan`."""

    config: DatasetConfig
    streams: Streams  # Root of the random streams of the dataset
    duration_s: float  # Time from the start of exposure of the first row to the end of exposure of the last row
    attitudes: Rotation | None  # Attitudes of a list, one per frame
    sampling_region: SkyPointing | ConePointing | None  # Boresights of random attitudes; about a body, a cone
    trajectory: Trajectory | None  # Motion of a scan through all frames, jitter included
    to_sun: FloatArray | None  # (3,) Direction of the Sun, ICRS, if attitudes avoid it
    jitter: JitterSpectrum | None
    splits: Splits


@dataclass(frozen=True, slots=True, kw_only=True)
class FramePlan:
    """One frame."""

    frame: int
    split: str  # train, validation, test, or gap (`experiments.dataset.splits`)
    attitude: Rotation  # Camera from ICRS at mid-exposure
    rate_rad_per_s: FloatArray  # (3,) Angular velocity in camera axes at mid-exposure
    start_s: float  # Start of the exposure on the trajectory
    trajectory: Trajectory | None  # Motion during the exposure; None where the camera stands still


def build_plan(config: DatasetConfig, height_px: int | None = None, diagonal_deg: float = 0.0) -> Plan:
    """Read input files, and refuse impossible settings."""
    pointing = config.pointing
    rows = config.instrument.height_px if height_px is None else height_px
    duration_s = config.instrument.exposure_s + max(0, rows - 1) * config.instrument.line_time_us * 1e-6
    streams = Streams(config.seed).child("dataset")
    jitter = _spectrum(config.jitter)
    attitudes: Rotation | None = None
    path: Trajectory | None = None
    if isinstance(pointing, ListPointing):
        attitudes = read_attitudes(pointing.file)
        if len(attitudes) < config.frames:
            raise ConfigError(
                f"pointing.file: {pointing.file} holds {len(attitudes)} attitudes, {config.frames} frames were "
                f"requested; set frames to at most {len(attitudes)}"
            )
    elif isinstance(pointing, ScanPointing):
        if not (isinstance(config.rate, FixedRate) and not any(config.rate.rate_deg_per_s)):
            raise ConfigError("rate: a scan's motion is set by pointing; leave rate out")
        path = _scan(pointing, config, duration_s)
        if jitter is not None:
            path = jittered(path, jitter, streams=streams)  # one motion for all frames
    region: SkyPointing | ConePointing | None = None
    if isinstance(pointing, BodyPointing):
        region = _cone_about(pointing, config)
    to_sun = None
    if isinstance(pointing, SkyPointing | ConePointing):
        region = pointing
        if pointing.sun_exclusion_deg > 0:
            to_sun = earth_observer(config.catalogue.epoch_year).to_sun
            if isinstance(pointing, ConePointing):
                _check_cone(pointing, to_sun)
    return Plan(
        config=config,
        streams=streams,
        duration_s=duration_s,
        attitudes=attitudes,
        sampling_region=region,
        trajectory=path,
        to_sun=to_sun,
        jitter=jitter,
        splits=build_splits(config, streams, diagonal_deg, None if attitudes is None else attitudes.as_matrix()[:, 2]),
    )


def _spectrum(config: JitterSpectrumConfig) -> JitterSpectrum | None:
    """The configured power spectra."""
    count = len(config.frequency_hz)
    densities = (config.psd_x_arcsec2_per_hz, config.psd_y_arcsec2_per_hz, config.psd_z_arcsec2_per_hz)
    if not count or not any(densities):
        return None
    return JitterSpectrum(
        frequency_hz=np.array(config.frequency_hz),
        psd_arcsec2_per_hz=np.array([values or (0.0,) * count for values in densities]),
    )


def observer_of(config: DatasetConfig) -> Observer | None:
    """Observer at the centre of the Earth, or where the Earth has the set direction and distance; None for none."""
    if config.catalogue.observer != "earth":
        return None
    observer, background = earth_observer(config.catalogue.epoch_year), config.background
    if background.earth_distance_km is None:
        return observer
    position_km = attitude_from_angles(*background.earth_direction_deg).as_matrix()[2] * -background.earth_distance_km
    return observer.moved(position_km=position_km, velocity_km_per_s=np.zeros(3))


def _cone_about(pointing: BodyPointing, config: DatasetConfig) -> ConePointing:
    """The cone of boresights about the apparent direction of a body."""
    from render.bodies.solar_system import solar_system

    bodies = solar_system(config.catalogue.epoch_year, observer=observer_of(config), bodies=(pointing.body,))
    x, y, z = bodies.direction[0]
    return ConePointing(
        ra_deg=float(np.degrees(np.arctan2(y, x)) % 360.0),
        dec_deg=float(np.degrees(np.arcsin(z))),
        radius_deg=pointing.offset_deg,
        roll_deg=pointing.roll_deg,
    )


def _check_cone(pointing: ConePointing, to_sun: FloatArray) -> None:
    """Refuse a cone within the exclusion angle of the Sun."""
    centre = attitude_from_angles(pointing.ra_deg, pointing.dec_deg, 0.0).as_matrix()[2]
    max_angle_deg = float(np.degrees(np.arccos(np.clip(centre @ to_sun, -1.0, 1.0)))) + pointing.radius_deg
    if max_angle_deg <= pointing.sun_exclusion_deg:
        raise DomainError(
            f"pointing: the whole cone lies within {max_angle_deg:.1f} deg of the Sun, pointing.sun_exclusion_deg = "
            f"{pointing.sun_exclusion_deg:g} deg; point elsewhere or change catalogue.epoch_year"
        )


def _scan(pointing: ScanPointing, config: DatasetConfig, duration_s: float) -> Trajectory:
    last_s = (config.frames - 1) / pointing.frame_rate_hz + duration_s
    if pointing.file:
        times, attitudes = read_motion(pointing.file)
        path = SampledAttitude(samples_s=times, attitudes=attitudes)
        if path.end_s - path.start_s < last_s:
            max_frames = int(np.floor((path.end_s - path.start_s - duration_s) * pointing.frame_rate_hz)) + 1
            raise DomainError(
                f"pointing.file: {pointing.file} lasts {path.end_s - path.start_s:g} s, {config.frames} frames at "
                f"{pointing.frame_rate_hz:g} Hz need {last_s:g} s; set frames to at most {max(max_frames, 0)}"
            )
        return path
    return ConstantRate(
        initial=attitude_from_angles(pointing.ra_deg, pointing.dec_deg, pointing.roll_deg),
        rate_rad_per_s=np.array(pointing.rate_deg_per_s) * DEG_RAD,
        end_s=MAX_FRAMES / pointing.frame_rate_hz + duration_s,
    )


def plan_frame(plan: Plan, frame: int) -> FramePlan:
    """Plan of frame number ``frame``."""
    config, half_s = plan.config, plan.duration_s / 2.0
    if plan.trajectory is not None:
        assert isinstance(config.pointing, ScanPointing)
        start = plan.trajectory.start_s + frame / config.pointing.frame_rate_hz
        at_rest = isinstance(plan.trajectory, ConstantRate) and not plan.trajectory.rate_rad_per_s.any()
        attitude = plan.trajectory.attitude(start + half_s)
        return FramePlan(
            frame=frame,
            split=_split(plan, frame, attitude),
            attitude=attitude,
            rate_rad_per_s=plan.trajectory.rate(start + half_s),
            start_s=start,
            trajectory=None if at_rest else plan.trajectory,
        )
    attitude = _attitude(plan, frame)
    rate = _rate(plan, frame)
    path: Trajectory | None = None
    if rate.any() or plan.jitter is not None:
        initial = Rotation.from_rotvec(rate * half_s) * attitude  # attitude at the start of the exposure
        path = ConstantRate(initial=initial, rate_rad_per_s=rate, end_s=2.0 * half_s)
    if path is not None and plan.jitter is not None:
        path = jittered(path, plan.jitter, streams=plan.streams, frame=frame)
        attitude, rate = path.attitude(half_s), path.rate(half_s)
    split = _split(plan, frame, attitude)
    return FramePlan(frame=frame, split=split, attitude=attitude, rate_rad_per_s=rate, start_s=0.0, trajectory=path)


def _split(plan: Plan, frame: int, attitude: Rotation) -> str:
    return plan.splits.of(frame, attitude.as_matrix()[2])


def _attitude(plan: Plan, frame: int) -> Rotation:
    """Attitude of a frame: of the list, or drawn until the boresight is outside the exclusion angle of the Sun."""
    if plan.attitudes is not None:
        return plan.attitudes[frame]
    pointing = plan.sampling_region
    assert pointing is not None
    rng = plan.streams.generator("attitude", frame)
    max_cosine = np.cos(pointing.sun_exclusion_deg * DEG_RAD)
    while True:
        if isinstance(pointing, SkyPointing):
            attitude = random_attitude(rng)
        else:
            cone = pointing.model_dump(include={"ra_deg", "dec_deg", "radius_deg", "roll_deg"})
            attitude = random_attitude_in_cone(rng, **cone)
        if plan.to_sun is None or attitude.as_matrix()[2] @ plan.to_sun < max_cosine:
            return attitude


def _rate(plan: Plan, frame: int) -> FloatArray:
    """Angular velocity in camera axes [rad/s]."""
    rate = plan.config.rate
    if isinstance(rate, FixedRate):
        return np.array(rate.rate_deg_per_s) * DEG_RAD
    rng = plan.streams.generator("rate", frame)
    return random_rate(rng, rate.lowest_deg_per_s, rate.highest_deg_per_s, rate.distribution) * DEG_RAD


def fastest_rad_per_s(plan: Plan) -> tuple[float, float]:
    """Largest angular velocities that a frame may have, across the boresight and about it [rad/s]."""
    config = plan.config
    if plan.trajectory is not None:
        assert isinstance(config.pointing, ScanPointing)
        end_s = plan.trajectory.start_s + (config.frames - 1) / config.pointing.frame_rate_hz + plan.duration_s
        rate = plan.trajectory.rate(np.linspace(plan.trajectory.start_s, end_s, RATE_SAMPLES))
        return float(np.hypot(rate[:, 0], rate[:, 1]).max()), float(np.abs(rate[:, 2]).max())
    if isinstance(config.rate, RandomRate):
        return config.rate.highest_deg_per_s * DEG_RAD, config.rate.highest_deg_per_s * DEG_RAD
    x, y, z = config.rate.rate_deg_per_s
    return float(np.hypot(x, y)) * DEG_RAD, abs(z) * DEG_RAD


# --- Attitudes from files: lists and motions

NORM_TOLERANCE = 1e-6
"""Error of the length of a quaternion written with seven digits."""
_MIN_ROWS_FOR_UNIT = 20
"""Rows from which angles without a unit are refused as possible radians: a range of right ascension up to 2 pi,
and declinations up to pi."""
_QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")


def read_attitudes(name: str) -> Rotation:
    """Attitudes of a file, camera from ICRS."""
    return _attitudes(_table(name), name)


def read_motion(name: str) -> tuple[FloatArray, Rotation]:
    """Times [s] and attitudes of a file with a column ``time_s``; errors as `read_attitudes`."""
    table = _table(name)
    time_s = _column(table, "time_s", "s", name)
    late = np.flatnonzero(np.diff(time_s) <= 0)
    if len(late):
        row = int(late[0]) + 1
        raise DomainError(f"{name}: time_s of row {row} is {time_s[row]:g} s, not later than the row before")
    return time_s, _attitudes(table, name)


def _table(name: str) -> Any:
    from astropy.table import Table

    key = "pointing.file"
    if not name:
        raise ConfigError(f"{key} is empty; name a CSV or ECSV file with attitudes")
    path = Path(name)
    if not os.path.isfile(path):
        raise ConfigError(f"{key}: {name}: no such file")
    if path.suffix.lower() not in (".csv", ".ecsv"):
        raise ConfigError(f"{key}: {name}: a file .csv or .ecsv is needed")
    try:
        table = Table.read(path, format="ascii.ecsv" if path.suffix.lower() == ".ecsv" else "ascii.csv")
    except Exception as error:  # astropy raises what its readers happen to raise
        raise ConfigError(f"{key}: {name} cannot be read: {' '.join(str(error).split())[:200]}") from None
    if not len(table):
        raise ConfigError(f"{key}: {name} holds no rows")
    return table


def _attitudes(table: Any, name: str) -> Rotation:
    if all(column in table.colnames for column in _QUATERNION):
        return _from_quaternions(table, name)
    columns = [next((c for c in (f"{a}_deg", a) if c in table.colnames), None) for a in ("ra", "dec", "roll")]
    if None in columns:
        raise ConfigError(
            f"{name}: columns {', '.join(table.colnames)}; ra_deg, dec_deg, roll_deg or {', '.join(_QUATERNION)} needed"
        )
    ra, dec, roll = (_column(table, str(column), "deg", name) for column in columns)
    unit_stated = any(table[column].unit is not None or str(column).endswith("_deg") for column in columns)
    if not unit_stated and len(ra) >= _MIN_ROWS_FOR_UNIT and max(np.ptp(ra), 2 * np.abs(dec).max()) <= 2 * np.pi:
        raise DomainError(f"{name}: no angle is above 2 pi; are they radians? State the unit or name the columns _deg")
    for label, angle, limit in (("declination", dec, 90), ("right ascension", ra, 360), ("roll", roll, 360)):
        row = int(np.argmax(np.abs(angle) > limit))
        if abs(angle[row]) > limit:
            raise DomainError(f"{name}: {label} of row {row} is {angle[row]:g} deg; -{limit} to {limit} deg is allowed")
    return attitude_from_angles(ra, dec, roll)


def _from_quaternions(table: Any, name: str) -> Rotation:
    quaternion = np.stack([_column(table, column, "", name) for column in _QUATERNION], axis=1)
    length = np.hypot.reduce(quaternion, axis=1)
    worst = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[worst] - 1.0) > NORM_TOLERANCE:
        raise DomainError(
            f"{name}: the quaternion of row {worst} has length {length[worst]:.9g}; an attitude must be normalised "
            f"(1 within {NORM_TOLERANCE:g})"
        )
    return Rotation.from_quat(quaternion)


def _column(table: Any, column: str, unit: str, name: str) -> FloatArray:
    """Values of a column in a unit; those without a unit are taken to be in it."""
    from astropy import units

    if column not in table.colnames:
        raise ConfigError(f"{name}: column {column} is missing; it has {', '.join(table.colnames)}")
    try:
        factor = 1.0 if table[column].unit is None else units.Unit(table[column].unit).to(units.Unit(unit))
        values = np.ma.filled(np.ma.asarray(table[column], float), np.nan) * factor
    except units.UnitConversionError:
        raise ConfigError(
            f"{name}: column {column} is in {table[column].unit}; its unit must be {unit or 'none'}"
        ) from None
    except (TypeError, ValueError):
        raise ConfigError(f"{name}: column {column} holds a value that is not a number") from None
    if not np.isfinite(values).all():
        raise DomainError(f"{name}: {column} of row {int(np.argmin(np.isfinite(values)))} is missing or not finite")
    return np.asarray(values, np.float64)
