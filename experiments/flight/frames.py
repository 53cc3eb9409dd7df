"""Rendered segments of the orbit, the attitudes of the tracker, and the separation of their errors.

Every frame is rendered with the lens at its temperatures and read out twice, with independent noise. With the errors a
and b of the two attitudes, (a - b)^2 / 2 and a b estimate without bias the variance of the temporal noise and the
square of all other terms. For some frames of every segment two causes are switched off: rendered through the lens as
calibrated with the same noise, the difference is the thermo-elastic error; solved with the true velocity, it is the
residual aberration. The remaining mean of a segment is FOV spatial error and the constant bias.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.tracker import StarTracker, TrackedAttitude
from experiments.flight.prediction import Budget
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import mean_dark_frame
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.lens.heated_lens import COMPONENTS, ThermalState
from optics.records import freeze
from optics.units import ARCSEC_RAD
from render.bodies.solar_system import BODIES, solar_system
from render.engine.random import Streams
from render.observation import SkyLight
from render.psf_lattice import inset_axes, psf_tracer, refined, render_psf_grid
from render.records import Frame, PsfGrid
from render.sensor_file.detector import overridden
from render.sensor_file.instrument import build_instrument, configured_detector, housing_of
from render.simulator import SkySimulator

MARGIN_PX = 32.0
"""Margin about the detector within which stars are rendered: their light may reach it."""
PLANETS = tuple(name for name in BODIES if name != "moon")
PSF_REFINEMENT = 4
"""Interpolated steps between rendered PSFs of the tracker."""
HANDOVER_SIGMA_PX = 3.0
"""Standard deviation per axis of an attitude that another sensor head hands over."""
AT_REST_PX = 0.02
"""Smaller rotations within an exposure are rendered at rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """Frames of a part of the orbit; errors about x, y and roll [arcsec], NaN without an attitude."""

    start_s: float
    blinded: bool  # A body within its exclusion angle: nothing is rendered
    error_arcsec: FloatArray  # (2, n, 3) Attitude errors of both readouts
    stars: FloatArray  # (n,) Stars used by the attitude
    rejected: FloatArray  # (n,) Stars rejected by the attitude
    false_stars: FloatArray  # (n,) True number of planets and cosmic rays in the frame
    thermal_arcsec: FloatArray  # (s, 3) Attitude minus that through the lens as calibrated
    aberration_arcsec: FloatArray  # (s, 3) Attitude minus that with the true velocity
    acquired: str  # Status of the first frame, solved lost in space
    acquisition_s: float  # Computing time of the first frame on this machine
    wrong: int  # Attitudes whose error exceeds `tracker.wrong_sigma` predicted standard deviations

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("stars", "rejected", "false_stars"):
            freeze(self, name, shape=("n",), sizes=sizes)
        freeze(self, "error_arcsec", shape=(2, "n", 3), finite=False, sizes=sizes)
        for name in ("thermal_arcsec", "aberration_arcsec"):
            freeze(self, name, shape=("s", 3), finite=False, sizes=sizes)

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Frames (n,) of which both readouts have an attitude."""
        return np.asarray(np.isfinite(self.error_arcsec).all(axis=(0, 2)))


class FlightCamera:
    """Frames of the sensor along the flight."""

    def __init__(self, budget: Budget) -> None:
        config = self.config = budget.config
        self.budget, self.flight = budget, budget.flight
        setting, state = config.instrument, budget.nominal.state
        detector = overridden(configured_detector(setting), budget.sensor.detector)
        self.nominal = build_instrument(setting, detector=detector)
        self.streams = Streams(config.seed).child("flight", "old" if budget.old else "new")
        planets = solar_system(self.flight.orbit.epoch_year, bodies=PLANETS) if config.frames.planets else ()
        self.simulator = SkySimulator(
            self.nominal,
            budget.sky,
            exposure_s=setting.exposure_s,
            passband=state.band,
            nodes=state.light.wavelength_nm.shape[1],
            throughput_fraction=budget.sensor.throughput_fraction,
            temperature_c=setting.chip_temperature_c,
            seed=self.streams,
            bodies=planets,
            disks_above_px=np.inf,
            cosmic_rays=None if config.frames.cosmic_rays == "none" else config.frames.cosmic_rays,
            housing=housing_of(setting.housing),
            margin_px=MARGIN_PX,
            tolerance=1e-4,
            by_grid=True,
        )

    def expected(self, time_s: float, state_k: FloatArray) -> SkyLight:
        """Expected image of an exposure about a time, through the lens in a thermal state."""
        trajectory, exposure_s = self.flight.trajectory, self.config.instrument.exposure_s
        start_s = time_s - 0.5 * exposure_s
        during = trajectory.attitude(start_s + exposure_s * np.array([0.0, 0.5, 1.0]))
        rotation_rad = 2.0 * (during[1:] * during[:-1].inv()).magnitude().max()
        pointing: dict[str, Any] = {"attitude": trajectory.attitude(time_s)}
        if rotation_rad > AT_REST_PX * self.budget.pixel_rad or self.config.jitter.rms_arcsec:
            pointing = {"attitude": trajectory, "start_s": start_s}
        return self.simulator.expected(
            **pointing,
            velocity_km_per_s=self.flight.velocity_km_per_s(time_s),
            lens_state=ThermalState.of(np.asarray(state_k, float)),
        )

    def read(self, light: SkyLight, time_s: float, number: int, label: str) -> Frame:
        """A readout; number and label determine its noise."""
        background = float(self.flight.background_e_per_s(time_s))
        return self.simulator.read(light, frame=number, label=label, background_e_per_s=background)

    def false_stars(self, light: SkyLight, number: int, label: str) -> int:
        """Number of planets in the field and of tracks of cosmic rays of a readout."""
        hits = self.simulator.hits(number, label)
        planets = 0
        if light.planets is not None:
            rows = slice(len(light.sources) - len(light.planets), None)
            position_px = np.column_stack([light.truth.photon_x_px[rows, 0], light.truth.photon_y_px[rows, 0]])
            planets = int(self.simulator.view.on_detector(position_px, 0.0).sum())
        return planets + (0 if hits is None else len(hits))


def psf_grid(budget: Budget) -> PsfGrid | None:
    """Calibrated PSFs of the tracker; None for a centroider that needs none."""
    config = budget.config
    if not needs_epsf(config.centroid):
        return None
    rate = np.asarray(budget.flight.trajectory.rate(float(budget.flight.segments_s[0])))
    camera = budget.camera(0.0, rate)
    coarse = render_psf_grid(
        budget.instrument,
        budget.nominal.state.light,
        temperature_k=config.star_temperature_k,
        window_px=config.window_px,
        trail_px=camera.state.trail_px,
        axes=inset_axes(budget.instrument.camera, config.frames.psf_grid),
        tracer=psf_tracer(budget.instrument, by_grid=True),
    )
    return refined(coarse, PSF_REFINEMENT)


def build_tracker(camera: FlightCamera) -> StarTracker:
    """The tracker with its ground calibration: camera model, PSFs, mean dark frame, guide stars."""
    budget = camera.budget
    config, processing, grid = budget.config, budget.nominal.processing, psf_grid(budget)
    return StarTracker(
        budget.model,
        budget.guides,
        dark_dn=mean_dark_frame(camera.nominal, config.dark_frames, streams=camera.streams, label="dark"),
        noise=processing.noise,
        centroid=config.centroid,
        psfs=() if grid is None else grid.psfs,
        psf_place_px=None if grid is None else grid.place_px,
        window_px=config.window_px,
        threshold_sigma=processing.threshold_sigma,
        fwhm_px=processing.fwhm_px,
        fewest=config.tracker.fewest,
        most=config.tracker.most,
        gate_px=config.tracker.gate_px,
        star_error_px=budget.star_error_px,
        scale_error=budget.scale_error,
    )


def render_flight(budget: Budget, *, advance: Callable[[], None] = lambda: None) -> list[Segment]:
    """Render all segments and track their stars."""
    camera = FlightCamera(budget)
    tracker = build_tracker(camera)
    starts = budget.flight.segments_s
    return [_segment(camera, tracker, number, float(start_s), advance) for number, start_s in enumerate(starts)]


def _segment(
    camera: FlightCamera, tracker: StarTracker, number: int, start_s: float, advance: Callable[[], None]
) -> Segment:
    """Render, read out twice and track the frames of a segment, the first frame lost in space."""
    flight, setting = camera.flight, camera.config.frames
    bias_arcsec = camera.budget.bias_arcsec()
    alignment = Rotation.from_rotvec(ARCSEC_RAD * bias_arcsec)
    count = setting.frames
    errors = np.full((2, count, 3), np.nan)
    stars, rejected, false_stars = np.zeros((3, count))
    thermal, aberration = np.full((2, setting.switched, 3), np.nan)
    blinded = bool(flight.blinded(start_s))
    status, acquisition_s = "blinded", math.nan
    wrong = 0
    tracker.reset()
    for k, at_s in enumerate(() if blinded else flight.frame_times_s(start_s)):
        truth = flight.trajectory.attitude(at_s)
        onboard_velocity = flight.known_velocity_km_per_s(at_s)
        light = camera.expected(at_s, flight.states_k[number])
        frame_number = number * count + k
        frame = camera.read(light, at_s, frame_number, "first")
        false_stars[k] = camera.false_stars(light, frame_number, "first")
        start = time.perf_counter()
        rate = flight.trajectory.rate(at_s)
        first = tracker(frame, at_s, velocity_km_per_s=onboard_velocity, rate_rad_per_s=rate)
        if k == 0:
            acquisition_s = time.perf_counter() - start
            status = first.status
            if not first.ok:
                first = _hand_over(camera, tracker, frame, at_s, number)
        second_frame = camera.read(light, at_s, frame_number, "second")
        second = tracker(second_frame, at_s, velocity_km_per_s=onboard_velocity, near=first.attitude or truth)
        for readout, tracked in enumerate((first, second)):
            if tracked.attitude is not None:
                errors[readout, k] = attitude_error_arcsec(alignment * tracked.attitude, truth)
        if first.ok:
            stars[k] = len(first.star_id)
            rejected[k] = first.rejected
            limit_arcsec = camera.config.tracker.wrong_sigma * first.sigma_arcsec
            wrong += bool((np.abs(errors[0, k] - bias_arcsec) > limit_arcsec).any())
            if k < setting.switched:
                thermal[k], aberration[k] = _switched(camera, tracker, first, frame, at_s, frame_number)
        advance()
    return Segment(
        start_s=start_s,
        blinded=blinded,
        error_arcsec=errors,
        stars=stars,
        rejected=rejected,
        false_stars=false_stars,
        thermal_arcsec=thermal,
        aberration_arcsec=aberration,
        acquired=status,
        acquisition_s=acquisition_s,
        wrong=wrong,
    )


def _hand_over(camera: FlightCamera, tracker: StarTracker, frame: Frame, at_s: float, number: int) -> TrackedAttitude:
    """Attitude of a frame near the attitude of another sensor head, `HANDOVER_SIGMA_PX` off."""
    sigma_rad = HANDOVER_SIGMA_PX * camera.budget.pixel_rad
    error_rad = sigma_rad * camera.streams.generator("rough", number).standard_normal(3)
    prior = Rotation.from_rotvec(error_rad) * camera.flight.trajectory.attitude(at_s)
    tracker.begin(at_s, prior)
    return tracker(frame, at_s, velocity_km_per_s=camera.flight.known_velocity_km_per_s(at_s), near=prior)


def _switched(
    camera: FlightCamera, tracker: StarTracker, first: TrackedAttitude, frame: Frame, at_s: float, number: int
) -> tuple[FloatArray, FloatArray]:
    """Thermo-elastic error and residual aberration: attitude minus that without the cause, the noise equal."""
    truth = camera.flight.trajectory.attitude(at_s)
    calibrated_state_k = np.zeros(len(COMPONENTS))
    calibrated_frame = camera.read(camera.expected(at_s, calibrated_state_k), at_s, number, "first")
    onboard_velocity = camera.flight.known_velocity_km_per_s(at_s)
    true_velocity = camera.flight.velocity_km_per_s(at_s)

    def error_arcsec(image: Frame, velocity_km_per_s: FloatArray | None) -> FloatArray:
        tracked = tracker(image, at_s, velocity_km_per_s=velocity_km_per_s, near=first.attitude)
        if tracked.attitude is None:
            return np.full(3, np.nan)
        return np.asarray(attitude_error_arcsec(tracked.attitude, truth))

    error = error_arcsec(frame, onboard_velocity)
    thermal = error - error_arcsec(calibrated_frame, onboard_velocity)
    return thermal, error - error_arcsec(frame, true_velocity)
