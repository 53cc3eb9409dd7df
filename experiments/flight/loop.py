"""The sensor as a function for control loops: attitude, rate and time in; measured attitude and covariance out.

`by_frames` renders and reads out every exposure, and the tracker solves it. `by_budget` draws an error with the
predicted covariance of the budget, thousands of times per second. Both return the same record.
"""

from __future__ import annotations

import itertools
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
from experiments.flight.settings import FlightConfig
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.motion.trajectory import rate_of_trail, trail_of_rate

Sensor = Callable[[Rotation, ArrayLike, float], TrackedAttitude]
"""``sensor(attitude, rate_rad_per_s, time_s)``: camera from ICRS and its rate in camera axes, at mid-exposure."""

REUSE_FIELD_FRACTION = 0.02
"""Predicted errors are reused for rotations up to this fraction of the field."""
REUSE_S = 10.0
"""Predicted errors are reused for this time."""


def by_frames(config: FlightConfig) -> Sensor:
    """A sensor that renders every exposure, with the lens as calibrated; times have to increase from call to call.

    The attitude law of the configuration is not used. Raises the errors of
    `experiments.flight.prediction.build_budget`.
    """
    camera = FlightCamera(build_budget(config, build_flight(config)))
    tracker = build_tracker(camera)
    flight = camera.flight
    alignment = Rotation.from_rotvec(ARCSEC_RAD * camera.budget.bias_arcsec())
    frame_numbers = itertools.count()

    def sensor(attitude: Rotation, rate_rad_per_s: ArrayLike, time_s: float) -> TrackedAttitude:
        rate = np.asarray(rate_rad_per_s, float)
        exposure: dict[str, Any] = {"rate_deg_per_s": np.degrees(rate)} if rate.any() else {}
        velocity = flight.velocity_km_per_s(time_s)
        light = camera.simulator.expected(attitude, velocity_km_per_s=velocity, **exposure)
        frame = camera.read(light, time_s, next(frame_numbers), "loop")
        tracker_velocity = flight.known_velocity_km_per_s(time_s)
        reading = tracker(frame, time_s, velocity_km_per_s=tracker_velocity, rate_rad_per_s=rate)
        return reading if reading.attitude is None else replace(reading, attitude=alignment * reading.attitude)

    return sensor


def by_budget(config: FlightConfig, *, budget: Budget | None = None) -> Sensor:
    """A sensor with the predicted errors: temporal noise drawn in every call, the errors of the stars constant.

    ``budget``: prediction for this configuration, if it exists already. The status of a reading states too few stars
    or a blinding body. Raises the errors of `by_frames`.
    """
    predicted = budget or build_budget(config, build_flight(config))
    rng = Streams(config.seed).generator("loop")
    bias = ARCSEC_RAD * predicted.bias_arcsec()
    reuse_rad = REUSE_FIELD_FRACTION * 2.0 * float(np.arccos(predicted.model.unproject(np.array([[-0.5, -0.5]]))[0, 2]))
    last: list[tuple[Rotation, float, TrackedAttitude, FloatArray, FloatArray]] = []  # last predicted errors

    def rounded(rate: FloatArray) -> FloatArray:
        """Rate rounded to whole pixels of trail and 45 deg: a new prediction takes a second."""
        step_deg = np.degrees(predicted.pixel_rad) / config.instrument.exposure_s
        size_deg, direction_deg = trail_of_rate(rate)
        return rate_of_trail(step_deg * round(size_deg / step_deg), 45.0 * round(direction_deg / 45.0))

    def predict(attitude: Rotation, rate: FloatArray, time_s: float) -> None:
        errors = predicted.errors_of(attitude, rounded(rate), time_s)
        covariance = np.full((3, 3), np.inf)
        sigma = np.zeros(3)
        shift = np.zeros(3)
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
        last[:] = [(attitude, time_s, answer, sigma, shift)]

    def sensor(attitude: Rotation, rate_rad_per_s: ArrayLike, time_s: float) -> TrackedAttitude:
        if not last or abs(time_s - last[0][1]) > REUSE_S or (attitude * last[0][0].inv()).magnitude() > reuse_rad:
            predict(attitude, np.asarray(rate_rad_per_s, float), time_s)
        _, _, answer, sigma, shift = last[0]
        if answer.status != "ok":
            return replace(answer, time_s=time_s)
        reading = Rotation.from_rotvec(shift + sigma * rng.standard_normal(3)) * attitude
        return replace(answer, time_s=time_s, attitude=reading)

    return sensor
