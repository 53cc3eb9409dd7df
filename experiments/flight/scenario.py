"""Conditions of the flight against time: attitude, temperatures, true and known velocity, stray light."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from experiments.flight.settings import FlightConfig, OrbitConfig
from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import DomainError, StarbenchError
from optics.lens.heated_lens import COMPONENTS
from optics.lens.thermal_history import ThermalHistory, first_order_response
from optics.textfile import read_text
from render.bodies.orbit_view import OrbitView, orbit_view
from render.engine.random import Streams
from render.motion.jitter import JitterSpectrum, jittered
from render.motion.orbit import Orbit, in_shadow, kepler_orbit, sgp4_orbit
from render.motion.trajectory import ConstantRate, SampledAttitude, Trajectory, rate_of_trail

SAMPLES = 721
"""Times of the attitude of an elliptic orbit, per revolution."""
BEFORE_S, AFTER_S = 60.0, 600.0
"""Extension of the trajectory before and after the orbit, for segments at its ends."""
LARGEST_GAP_FRACTION = 0.05
"""Largest gap of a temperature table, as a fraction of the orbit."""
GAP_DEG = 90.0
"""Largest turn of an attitude table between rows."""


def read_columns(
    file: str, key: str, required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> dict[str, FloatArray]:
    """Columns of a CSV file; the first of ``required`` increases.

    Raises
    ------
    DomainError
        A column that is missing or unknown, a value that is no number, values of the first column that do not increase,
        fewer than two rows.
    """
    lines = read_text(Path(file), "a table").lines
    rows = list(csv.reader(line for line in lines if line.strip() and not line.startswith("#")))
    header = [name.strip() for name in rows[0]] if rows else []
    source = f"{key} = {Path(file).name}"
    if missing := [name for name in required if name not in header]:
        raise DomainError(f"{source}: no column {missing[0]}; required: {', '.join(required)}")
    if unknown := [name for name in header if name not in (*required, *optional)]:
        raise DomainError(
            f"{source}: column {unknown[0]} is not known; columns are {', '.join((*required, *optional))}"
        )
    try:
        values = np.array([[float(cell) for cell in row] for row in rows[1:]]).reshape(-1, len(header))
    except ValueError:
        raise DomainError(f"{source}: every row needs {len(header)} numbers, as its head has columns") from None
    table = dict(zip(header, values.T, strict=True))
    first = table[required[0]]
    if len(first) < 2 or not np.isfinite(values).all():
        raise DomainError(f"{source}: at least two rows of finite numbers are needed")
    if not (np.diff(first) > 0).all():
        row = int(np.argmax(np.diff(first) <= 0)) + 1
        raise DomainError(
            f"{source}: {required[0]} = {first[row]:g} in row {row + 1} is not above {first[row - 1]:g} before it; it "
            "has to increase"
        )
    return table


def _covers(time_s: FloatArray, end_s: float, source: str) -> None:
    if time_s[0] > 0.0 or time_s[-1] < end_s:
        raise DomainError(
            f"{source} runs from {time_s[0]:g} to {time_s[-1]:g} s; the orbit lasts from 0 to {end_s:.0f} s"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """Conditions as functions of time; see `build_flight`."""

    config: FlightConfig
    orbit: Orbit
    view: OrbitView  # Sun, Earth and Moon
    trajectory: Trajectory  # cam from icrs
    thermal: ThermalHistory
    straylight: Mapping[str, tuple[FloatArray, FloatArray]]  # body -> angles [deg], light [e-/px/s]

    @property
    def period_s(self) -> float:
        """Period of the orbit [s]."""
        return self.orbit.period_s

    @cached_property
    def segments_s(self) -> FloatArray:
        """Starts of the segments, in the middles of equal parts of the orbit."""
        count = self.config.frames.segments
        return np.asarray((np.arange(count) + 0.5) * self.period_s / count)

    @cached_property
    def states_k(self) -> FloatArray:
        """Thermal states (segments, 5) of the rendered segments: means over groups of similar uniform temperature."""
        states = self.thermal.at(self.segments_s)
        count = min(self.config.frames.thermal_states, len(states))
        for group in np.array_split(np.argsort(states[:, 0], kind="stable"), count):
            states[group] = states[group].mean(axis=0)
        return states

    def frame_times_s(self, start_s: float) -> FloatArray:
        """Middles of the exposures of a segment."""
        frames = self.config.frames
        return np.asarray(start_s + np.arange(frames.frames) / frames.rate_hz)

    def velocity_km_per_s(self, time_s: float) -> FloatArray:
        """True velocity (3,) against the barycentre."""
        return np.asarray(self.view.earth.velocity_km_per_s + self.orbit.state(time_s)[1])

    def known_velocity_km_per_s(self, time_s: float) -> FloatArray | None:
        """Velocity (3,) known to the tracker; None: no correction."""
        setting = self.config.aberration
        if setting.corrected == "none":
            return None
        if setting.corrected == "earth":
            return self.view.earth.velocity_km_per_s
        _, orbital = self.orbit.state(time_s)
        error = 1e-3 * setting.velocity_error_m_per_s * orbital / math.hypot(*orbital)
        return np.asarray(self.velocity_km_per_s(time_s) + error)

    def angles_deg(self, time_s: ArrayLike, attitude: Rotation | None = None) -> dict[str, FloatArray]:
        """Angles (...,) from the boresight, of the law or of another attitude, to Sun, limb of the Earth and Moon."""
        t = np.asarray(time_s, float)
        boresight = (self.trajectory.attitude(t) if attitude is None else attitude).as_matrix()[..., 2, :]
        return self.view.angles_deg(boresight, self.orbit.state(t)[0])

    def shadowed(self, time_s: ArrayLike) -> NDArray[np.bool_]:
        """Whether (...,) the Earth hides the Sun."""
        return in_shadow(self.orbit.state(time_s)[0], self.view.sun)

    def background_e_per_s(self, time_s: ArrayLike, attitude: Rotation | None = None) -> FloatArray:
        """Stray light (...,) per pixel; none of the Sun in the shadow of the Earth."""
        angles, dark = self.angles_deg(time_s, attitude), self.shadowed(time_s)
        light = np.zeros(np.shape(time_s))
        for body, (angle, rate) in self.straylight.items():
            body_light = np.interp(angles[body], angle, rate)
            light = light + (np.where(dark, 0.0, body_light) if body == "sun" else body_light)
        return np.asarray(light)

    def blinded(self, time_s: ArrayLike, attitude: Rotation | None = None) -> NDArray[np.bool_]:
        """Whether (...,) a body is within its exclusion angle."""
        angles, setting = self.angles_deg(time_s, attitude), self.config.straylight
        dark = self.shadowed(time_s)
        return np.asarray(
            ((angles["sun"] < setting.sun_exclusion_deg) & ~dark)
            | (angles["earth"] < setting.earth_exclusion_deg)
            | (angles["moon"] < setting.moon_exclusion_deg)
        )


def build_orbit(config: OrbitConfig, epoch_year: float) -> Orbit:
    """The orbit: of the Kepler elements at an epoch, or of two-line elements at theirs."""
    try:
        return sgp4_orbit(*config.tle) if config.tle else kepler_orbit(**config.kepler, epoch_year=epoch_year)
    except StarbenchError as error:
        raise type(error)(f"orbit.tle: {error}") from None


def build_flight(config: FlightConfig) -> Flight:
    """The flight of a configuration.

    Raises
    ------
    StarbenchError
        Tables that cannot be read, run backwards, or do not cover the orbit.
    """
    orbit = build_orbit(config.orbit, config.catalogue.epoch_year)
    view = orbit_view(orbit.epoch_year)
    light = {
        body: _straylight(getattr(config.straylight, f"{body}_file"), f"straylight.{body}_file")
        for body in ("sun", "earth", "moon")
        if getattr(config.straylight, f"{body}_file")
    }
    return Flight(
        config=config,
        orbit=orbit,
        view=view,
        trajectory=_trajectory(config, orbit),
        thermal=_thermal(config, orbit, view),
        straylight=light,
    )


def _straylight(file: str, key: str) -> tuple[FloatArray, FloatArray]:
    table = read_columns(file, key, ("angle_deg", "e_per_px_s"))
    if table["e_per_px_s"].min() < 0.0:
        raise DomainError(f"{key} = {Path(file).name}: e_per_px_s = {table['e_per_px_s'].min():g}; it is negative")
    return table["angle_deg"], table["e_per_px_s"]


# --- Attitude


def _trajectory(config: FlightConfig, orbit: Orbit) -> Trajectory:
    law, start, end = config.attitude, -BEFORE_S, orbit.period_s + AFTER_S
    base: Trajectory
    if law.law == "table":
        base = _tabulated(law.file, orbit.period_s)
    elif law.law == "nadir":
        time = np.linspace(start, end, int(SAMPLES * (end - start) / orbit.period_s))
        base = SampledAttitude(samples_s=time, attitudes=orbit.local_vertical(time, law.off_zenith_deg))
    else:
        rate = np.zeros(3)
        if law.law == "turn":
            rate = rate_of_trail(law.rate_deg_per_s, law.direction_deg)
        at_zero = attitude_from_angles(law.ra_deg, law.dec_deg, law.roll_deg)
        base = ConstantRate(
            initial=Rotation.from_rotvec(-rate * start) * at_zero, rate_rad_per_s=rate, start_s=start, end_s=end
        )
    jitter = config.jitter
    if not jitter.rms_arcsec:
        return base
    level = jitter.rms_arcsec**2 / (jitter.highest_hz - jitter.lowest_hz)
    spectrum = JitterSpectrum(
        frequency_hz=np.array([jitter.lowest_hz, jitter.highest_hz]), psd_arcsec2_per_hz=np.full((3, 2), level)
    )
    return jittered(base, spectrum, streams=Streams(config.seed).child("flight"))


def _tabulated(file: str, end_s: float) -> SampledAttitude:
    names = ("qx", "qy", "qz", "qw")
    table = read_columns(file, "attitude.file", ("time_s", *names))
    _covers(table["time_s"], end_s, f"attitude.file = {Path(file).name}")
    quat = np.column_stack([table[name] for name in names])
    length = np.hypot.reduce(quat, axis=1)
    if np.abs(length - 1.0).max() > 1e-3:
        worst = length[np.abs(length - 1.0).argmax()]
        raise DomainError(f"attitude.file = {Path(file).name}: a quaternion has the length {worst:g}; it must be 1")
    attitudes = Rotation.from_quat(quat)
    step = np.degrees((attitudes[1:] * attitudes[:-1].inv()).magnitude())
    if step.max() > GAP_DEG:
        row = int(step.argmax())
        raise DomainError(
            f"attitude.file = {Path(file).name}: {step[row]:.0f} deg between {table['time_s'][row]:g} and "
            f"{table['time_s'][row + 1]:g} s; a gap, at most {GAP_DEG:g} deg"
        )
    time = table["time_s"]
    if time[-1] < end_s + AFTER_S:  # at rest beyond its end
        time, attitudes = np.append(time, end_s + AFTER_S + 1.0), Rotation.concatenate([attitudes, attitudes[-1]])
    return SampledAttitude(samples_s=time, attitudes=attitudes)


# --- Temperature


def _thermal(config: FlightConfig, orbit: Orbit, view: OrbitView) -> ThermalHistory:
    """First harmonics of the orbit and a step in the shadow; or a table."""
    setting, period = config.temperature, orbit.period_s
    if setting.file:
        return _tabulated_temperatures(setting.file, period)
    time = np.linspace(0.0, period, SAMPLES)
    phase = 2.0 * np.pi * time / period + np.radians(setting.phase_deg)
    # two revolutions before the flight: the response to the shadow is periodic
    before = np.linspace(-2.0 * period, period, 3 * (SAMPLES - 1) + 1)
    forcing = np.where(in_shadow(orbit.state(before)[0], view.sun), setting.eclipse_k, 0.0)
    eclipse = first_order_response(forcing, step_s=before[1] - before[0], constant_s=setting.eclipse_time_s)
    mean = setting.offset_k + setting.mean_k * np.cos(phase) + eclipse[-SAMPLES:]
    gradients = np.outer(np.sin(phase), [setting.axial_k, setting.transverse_k, 0.0, setting.radial_k])
    return ThermalHistory(time_s=time, values_k=np.column_stack([mean, gradients]))


def _tabulated_temperatures(file: str, period_s: float) -> ThermalHistory:
    table = read_columns(file, "temperature.file", ("time_s", "mean_k"), COMPONENTS[1:])
    source, time_s = f"temperature.file = {Path(file).name}", table["time_s"]
    _covers(time_s, period_s, source)
    gap, longest = float(np.diff(time_s).max()), LARGEST_GAP_FRACTION * period_s
    if gap > longest:
        raise DomainError(f"{source}: a gap of {gap:g} s; at most {longest:.0f} s, a twentieth of the orbit")
    columns = [table.get(name, np.zeros(len(time_s))) for name in COMPONENTS]
    return ThermalHistory(time_s=time_s, values_k=np.column_stack(columns))
