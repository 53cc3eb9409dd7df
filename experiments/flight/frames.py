"""Rendered segments of the orbit, the tracker's attitudes, and the split of each error by switching causes.

Every frame is rendered with the lens at its temperatures and read out twice, with independent noise. With errors a and
b of both attitudes, (a - b)^2 / 2 is temporal noise and a b everything else, both without bias. A few frames of every
segment are rendered again through the lens as calibrated, with the same noise: the difference is the thermo-elastic
error. They are solved again with the true velocity: the difference is the residual aberration. The rest of the mean of
a segment is spatial error of the field and the constant bias.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.patterns import kept_database
from calib.attitude.tracker import StarTracker, TrackedAttitude
from experiments.flight.prediction import Budget, heated
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import mean_dark_frame
from experiments.laboratory.bench.readout.psf_grid import PsfGrid, refined, render_psf_grid
from optics.arrays import FloatArray
from optics.attitude import aberrated, attitude_error_arcsec
from optics.records import freeze
from optics.units import ARCSEC_RAD
from render.bodies.solar_system import BODIES, joined, planet_field, solar_system
from render.detector.cosmic_rays import CosmicRayHits, cosmic_ray_hits
from render.detector.readout import expose
from render.engine.random import Streams
from render.forward import StarRenderer
from render.motion.trajectory import Trajectory
from render.records import Frame
from render.sensor_file.detector import overridden
from render.sensor_file.instrument import Instrument, build_instrument, configured_detector
from render.sky.field import field_of_view
from render.tracing.motion.exposure import exposure_motion

MARGIN_PX = 32.0
"""Strip around the detector whose stars are rendered: their light may reach it."""
ABERRATED_RAD = 1.3e-4
"""Largest aberration, in a low orbit about the Earth."""
PLANETS = tuple(name for name in BODIES if name != "moon")
BLENDED = 4
"""Steps between rendered PSFs of the tracker; those between are blended."""
ROUGH_PX = 3.0
"""Error of an attitude that is handed over, about each axis."""
OBLONG = 1.5
"""A longer field needs star patterns down to its shorter side."""
STILL_PX = 0.02
"""Turns by less in an exposure are rendered at rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """Frames of one part of the orbit; errors about x, y and roll [arcsec], NaN where there is no attitude."""

    start_s: float
    blinded: bool  # A body within its exclusion angle: nothing is rendered
    error_arcsec: FloatArray  # (2, n, 3) Of both readouts
    stars: FloatArray  # (n,) Used
    rejected: FloatArray  # (n,)
    false_stars: FloatArray  # (n,) Planets and cosmic rays in the frame: truth
    thermal_arcsec: FloatArray  # (s, 3) By switching the temperatures
    aberration_arcsec: FloatArray  # (s, 3) By switching the knowledge of the velocity
    acquired: str  # Status of the first frame, searched lost in space
    acquisition_s: float  # Time that it took on this machine
    wrong: int  # Attitudes beyond the stated limit

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


class Camera:
    """Renders and reads frames of the sensor at its temperatures; a lens is prepared once per state."""

    def __init__(self, budget: Budget) -> None:
        config = self.config = budget.config
        self.budget, self.flight = budget, budget.flight
        self._whole = overridden(configured_detector(config.instrument), budget.sensor.detector)
        self.nominal: Instrument = build_instrument(config.instrument, detector=self._whole)
        self.detector = self.nominal.detector
        self.streams = Streams(config.seed).child("flight", "old" if budget.old else "new")
        self._view = field_of_view(self.nominal.camera, margin_px=MARGIN_PX)
        self._renderers: dict[bytes, StarRenderer] = {}
        light = budget.nominal.state.light
        planets = solar_system(budget.flight.orbit.epoch_year, bodies=PLANETS if config.frames.planets else ())
        planets = planets.select(np.isfinite(planets.magnitude_v))  # near the Sun some have no published magnitude
        self.planets = planet_field(planets, [budget.nominal.state.band], nodes=light.wavelength_nm.shape[1])

    def renderer(self, state_k: FloatArray) -> StarRenderer:
        """Renderer of the lens in a state."""
        key = np.asarray(state_k, float).tobytes()
        if key not in self._renderers:
            lens = heated(self.config, state_k)
            camera = build_instrument(self.config.instrument, lens=lens, detector=self._whole).camera
            exposure_s = self.config.instrument.exposure_s
            self._renderers[key] = StarRenderer(camera, exposure_s=exposure_s, tolerance=1e-4, by_grid=True)
        return self._renderers[key]

    def expected(self, time_s: float, state_k: FloatArray, trajectory: Trajectory | None = None) -> FloatArray:
        """Noiseless electrons (h, w) of an exposure about a time."""
        path = self.flight.trajectory if trajectory is None else trajectory
        exposure, attitude = self.config.instrument.exposure_s, path.attitude(time_s)
        rate = path.rate(time_s + exposure * np.array([-0.5, 0.0, 0.5]))
        turn_rad = float(np.linalg.norm(rate, axis=1).max()) * exposure
        row, near = (self._near(attitude, each, turn_rad) for each in (self.budget.direction, self.planets.direction))
        seen = aberrated(self.budget.direction[row], self.flight.velocity_km_per_s(time_s))
        stars = joined(
            self.budget.nominal.state.light.stars(
                seen, self.budget.stars.magnitude[row], self.budget.temperature_k[row]
            ),
            replace(self.planets, direction=self.planets.direction[near], photon_rate=self.planets.photon_rate[near]),
        )
        stars = replace(stars, photon_rate=stars.photon_rate * self.budget.sensor.throughput_fraction)
        renderer = self.renderer(state_k)
        if turn_rad > STILL_PX * self.budget.pixel_rad or self.config.jitter.rms_arcsec:
            motion = exposure_motion(path, start_s=time_s - 0.5 * exposure, exposure_s=exposure, camera=renderer.camera)
            traced = renderer.trace(stars, motion=motion)
        else:
            traced = renderer.trace(stars, rotation_cam_from_world=attitude.as_matrix())
        return np.array(traced.electrons[:, :, 0])

    def _near(self, attitude: Rotation, direction: FloatArray, turn_rad: float) -> NDArray[np.int64]:
        """Rows of directions along icrs whose light may reach the detector; all about it where light scatters."""
        slack_rad = ABERRATED_RAD + turn_rad
        row = np.flatnonzero(direction @ attitude.as_matrix()[2] > np.cos(1.1 * self._view.radius_rad + slack_rad))
        if self.nominal.camera.scatter is not None:
            return row
        return row[self._view.inside(attitude.apply(direction[row]), slack_rad)]

    def read(self, electrons: FloatArray, time_s: float, number: int, label: str) -> Frame:
        """One readout; the same number and label: the same noise."""
        setting = self.config.instrument
        return expose(
            electrons,
            self.detector,
            streams=self.streams,
            frame=number,
            exposure_s=setting.exposure_s,
            temperature_c=setting.chip_temperature_c,
            background_e_per_s=float(self.flight.background_e_per_s(time_s)),
            band=label,
            hits=self.hits(number, label),
        )

    def hits(self, number: int, label: str) -> CosmicRayHits | None:
        """Cosmic rays of a readout; None without them."""
        if self.config.frames.cosmic_rays == "none":
            return None
        streams, exposure_s = self.streams.child(label), self.config.instrument.exposure_s
        return cosmic_ray_hits(
            self.detector, self.config.frames.cosmic_rays, streams=streams, frame=number, exposure_s=exposure_s
        )

    def false_stars(self, time_s: float, number: int, label: str) -> int:
        """Planets in the field and tracks of cosmic rays of a readout."""
        camera, hits = self.nominal.camera, self.hits(number, label)
        v = self.planets.direction @ self.flight.trajectory.attitude(time_s).as_matrix().T
        place = self.budget.model.project(v)
        with np.errstate(invalid="ignore"):
            inside = ((place > -0.5) & (place < np.array([camera.width_px, camera.height_px]) - 0.5)).all(axis=1)
        return int(inside.sum()) + (0 if hits is None else len(hits))


def psf_grid(budget: Budget) -> PsfGrid | None:
    """PSFs that the tracker was calibrated with, for a centroider that needs them."""
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
        long_side=config.frames.psf_grid,
        by_grid=True,
    )
    return refined(coarse, BLENDED)


def build_tracker(camera: Camera) -> StarTracker:
    """The tracker as it was calibrated on ground: camera model, PSFs, mean dark frame, guide stars."""
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
        database=_patterns(budget),
    )


def _patterns(budget: Budget) -> Any:
    """Star patterns for an oblong field; None where patterns of a square field serve (`identify_stars`)."""
    wide, high = (budget.nominal.value(f"field_{side}_deg") for side in ("width", "height"))
    if max(wide, high) < OBLONG * min(wide, high):
        return None
    return kept_database(min_fov_deg=round(0.94 * min(wide, high), 1), max_fov_deg=round(1.06 * max(wide, high), 1))


def render_flight(budget: Budget, *, advance: Callable[[], None] = lambda: None) -> list[Segment]:
    """Render all segments and track their stars."""
    camera = Camera(budget)
    tracker = build_tracker(camera)
    starts = budget.flight.segments_s
    return [_segment(camera, tracker, number, float(start_s), advance) for number, start_s in enumerate(starts)]


def _segment(camera: Camera, tracker: StarTracker, number: int, start_s: float, advance: Callable[[], None]) -> Segment:
    flight, setting = camera.flight, camera.config.frames
    times, count = flight.frame_times_s(start_s), setting.frames
    state = flight.states_k[number]
    aligned = Rotation.from_rotvec(ARCSEC_RAD * camera.budget.bias_arcsec())
    errors = np.full((2, count, 3), np.nan)
    stars, rejected, false_stars = np.zeros((3, count))
    warm, moving = np.full((setting.switched, 3), np.nan), np.full((setting.switched, 3), np.nan)
    blinded, status, spent, wrong = bool(flight.blinded(start_s)), "blinded", float("nan"), 0
    tracker.reset()
    for k, at_s in enumerate(times if not blinded else ()):
        truth, known = flight.trajectory.attitude(at_s), flight.known_velocity_km_per_s(at_s)
        image, key = camera.expected(at_s, state), number * count + k
        frame, false_stars[k] = camera.read(image, at_s, key, "first"), camera.false_stars(at_s, key, "first")
        began = time.perf_counter()
        found = tracker(frame, at_s, velocity_km_per_s=known, rate_rad_per_s=flight.trajectory.rate(at_s))
        if k == 0:
            status, spent = found.status, time.perf_counter() - began
            if not found.ok:  # lost in space it stays lost here: another head hands its attitude over
                rough = _handed_over(camera, truth, number)
                tracker.begin(at_s, rough)
                found = tracker(frame, at_s, velocity_km_per_s=known, near=rough)
        second = tracker(
            camera.read(image, at_s, key, "second"), at_s, velocity_km_per_s=known, near=found.attitude or truth
        )
        for n, one in enumerate((found, second)):
            if one.attitude is not None:
                # the alignment turns what the tracker says against the body that it is asked for
                errors[n, k] = attitude_error_arcsec(aligned * one.attitude, truth)
        if found.ok:
            stars[k], rejected[k] = len(found.star_id), found.rejected
            off = errors[0, k] - camera.budget.bias_arcsec()
            wrong += bool((np.abs(off) > camera.config.tracker.wrong_sigma * found.sigma_arcsec).any())
            if k < setting.switched:
                warm[k], moving[k] = _switched(camera, tracker, found, frame, at_s, key, state)
        advance()
    return Segment(
        start_s=start_s,
        blinded=blinded,
        error_arcsec=errors,
        stars=stars,
        rejected=rejected,
        false_stars=false_stars,
        thermal_arcsec=warm,
        aberration_arcsec=moving,
        acquired=status,
        acquisition_s=spent,
        wrong=wrong,
    )


def _handed_over(camera: Camera, truth: Rotation, number: int) -> Rotation:
    error = ROUGH_PX * camera.budget.pixel_rad * camera.streams.generator("rough", number).standard_normal(3)
    return Rotation.from_rotvec(error) * truth


def _switched(
    camera: Camera,
    tracker: StarTracker,
    found: TrackedAttitude,
    frame: Frame,
    at_s: float,
    key: int,
    state_k: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Thermo-elastic error, and aberration that is left: this attitude less the one without, noise as it was."""
    flight = camera.flight
    truth, known = flight.trajectory.attitude(at_s), flight.known_velocity_km_per_s(at_s)
    cold = camera.read(camera.expected(at_s, 0.0 * state_k), at_s, key, "first")
    without = tracker(cold, at_s, velocity_km_per_s=known, near=found.attitude)
    exact = tracker(frame, at_s, velocity_km_per_s=flight.velocity_km_per_s(at_s), near=found.attitude)
    own = tracker(frame, at_s, velocity_km_per_s=known, near=found.attitude)
    out = []
    for other in (without, exact):
        if own.attitude is None or other.attitude is None:
            out.append(np.full(3, np.nan))
        else:
            out.append(attitude_error_arcsec(own.attitude, truth) - attitude_error_arcsec(other.attitude, truth))
    return out[0], out[1]
