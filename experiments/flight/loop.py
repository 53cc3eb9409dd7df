"""The sensor as a function for control loops: attitude, rate and time in; quaternion and covariance out.

By frames (`by_frames`): each call renders the exposure, reads it out, and the tracker solves it. By budget
(`by_budget`): each call draws an error with the budget's predicted covariance, thousands of times per second. Both
return the same record, with the given truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.tracker import TrackedAttitude
from experiments.flight.frames import FlightCamera, build_tracker
from experiments.flight.prediction import Budget, build_budget
from experiments.flight.scenario import build_flight
from experiments.flight.settings import Config
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.motion.trajectory import rate_of_trail, trail_of_rate

Sensor = Callable[[Rotation, ArrayLike, float], TrackedAttitude]
"""``sensor(attitude, rate_rad_per_s, time_s)``: cam from icrs and its rate in cam, in the middle of the exposure."""

FIELD_PART = 0.02
"""Errors of the stars are looked up again after a turn by this part of the field, or `AGED_S`."""
AGED_S = 10.0


def by_frames(config: Config) -> Sensor:
    """A sensor that renders every exposure, with the lens as calibrated; times have to increase from call to call.

    The attitude law of the configuration is not used. `StarbenchError` as of
    `experiments.flight.prediction.build_budget`.
    """
    camera = FlightCamera(build_budget(config, build_flight(config)))
    tracker, flight = build_tracker(camera), camera.flight
    aligned, calls = Rotation.from_rotvec(ARCSEC_RAD * camera.budget.bias_arcsec()), iter(range(2**31))

    def sensor(attitude: Rotation, rate_rad_per_s: ArrayLike, time_s: float) -> TrackedAttitude:
        rate = np.asarray(rate_rad_per_s, float)
        exposure: dict[str, Any] = {"rate_deg_per_s": np.degrees(rate)} if rate.any() else {}
        velocity = flight.velocity_km_per_s(time_s)
        light = camera.simulator.expected(attitude, velocity_km_per_s=velocity, **exposure)
        frame = camera.read(light, time_s, next(calls), "loop")
        known = flight.known_velocity_km_per_s(time_s)
        found = tracker(frame, time_s, velocity_km_per_s=known, rate_rad_per_s=rate)
        return found if found.attitude is None else replace(found, attitude=aligned * found.attitude)

    return sensor


def by_budget(config: Config, *, budget: Budget | None = None) -> Sensor:
    """A sensor that errs as the budget predicts: independent temporal noise in every call, errors of the stars
    unchanged.

    ``budget``: of this configuration, where there is one already. Without stars enough, or blinded, the status of the
    answer says so; errors as of `by_frames`.
    """
    known = budget or build_budget(config, build_flight(config))
    rng = Streams(config.seed).generator("loop")
    bias = ARCSEC_RAD * known.bias_arcsec()
    reach = FIELD_PART * 2.0 * float(np.arccos(known.model.unproject(np.array([[-0.5, -0.5]]))[0, 2]))
    kept: list[tuple[Rotation, float, TrackedAttitude, FloatArray, FloatArray]] = []  # the last look

    def coarse(rate: FloatArray) -> FloatArray:
        """Rate whose trail is a whole number of pixels, in steps of 45 deg: each other one costs a second."""
        step_deg = np.degrees(known.pixel_rad) / config.instrument.exposure_s
        size_deg, towards = trail_of_rate(rate)
        return rate_of_trail(step_deg * round(size_deg / step_deg), 45.0 * round(towards / 45.0))

    def look_up(attitude: Rotation, rate: FloatArray, time_s: float) -> None:
        errors = known.errors_of(attitude, coarse(rate), time_s)
        covariance, sigma, shift = np.full((3, 3), np.inf), np.zeros(3), np.zeros(3)
        if errors.available:
            covariance = ARCSEC_RAD**2 * np.diag(errors.noise_arcsec2 + errors.static_arcsec2)
            sigma, static = ARCSEC_RAD * np.sqrt([errors.noise_arcsec2, errors.static_arcsec2])
            shift = bias + ARCSEC_RAD * errors.signed_arcsec + static * rng.standard_normal(3)
        answer = TrackedAttitude(
            time_s=time_s,
            mode="tracking",
            status="ok" if errors.available else "few_stars",
            covariance_rad2=covariance,
            expected=round(errors.stars),
        )
        kept[:] = [(attitude, time_s, answer, sigma, shift)]

    def sensor(attitude: Rotation, rate_rad_per_s: ArrayLike, time_s: float) -> TrackedAttitude:
        if not kept or abs(time_s - kept[0][1]) > AGED_S or (attitude * kept[0][0].inv()).magnitude() > reach:
            look_up(attitude, np.asarray(rate_rad_per_s, float), time_s)
        _, _, answer, sigma, shift = kept[0]
        if answer.status != "ok":
            return replace(answer, time_s=time_s)
        reading = Rotation.from_rotvec(shift + sigma * rng.standard_normal(3)) * attitude
        return replace(answer, time_s=time_s, attitude=reading)

    return sensor
