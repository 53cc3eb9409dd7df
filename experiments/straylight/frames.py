"""Frames of the real sky under the light of the Sun: stars detected, lost and false, centroids, attitude.

The sky is rendered once per attitude; every angle of the Sun adds its light, and the frame is read out and measured
again. The camera is calibrated without error (a model fitted to its traced map), the attitude approximately known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.star_attitude import identify_stars, solve_attitude
from calib.cameras.fit import fit_camera
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import mean_dark_frame
from experiments.laboratory.bench.readout.noise_model import true_noise
from experiments.laboratory.bench.readout.psf_grid import render_psf_grid
from experiments.laboratory.bench.readout.reduction import MeasuredFrame, Reduction, measure_frame
from experiments.straylight.settings import Config
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from render.detector.readout import expose
from render.engine.random import Streams
from render.observation import Observation
from render.sensor_file.catalogue import load_catalogue
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument
from render.simulator import SkySimulator
from render.sky.sky import load_sky

MATCH_PX = 2.0
ROUGH_PX = 5.0
TYPICAL_K = 5800.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SunFrames:
    """Frames with one light; over the attitudes."""

    found: NDArray[np.int64]  # (m,) Stars
    false: NDArray[np.int64]  # (m,) Detections that are none
    lost: FloatArray  # (m,) Share of the stars that are found without the Sun
    error_px: FloatArray  # (k,) Centroids minus light of the stars that are fit, per axis
    solved: NDArray[np.bool_]  # (m,)
    error_arcsec: FloatArray  # (m, 3) Attitude, NaN where there is none
    stars: tuple[NDArray[np.bool_], ...]  # Which are found
    example_e: NDArray[np.float32]  # The first frame


class Bench:
    """Everything that all frames share."""

    def __init__(self, config: Config, instrument: Instrument, advance: Callable[[], None] = lambda: None) -> None:
        self.config, self.instrument = config, instrument
        self.streams = Streams(config.seed).child("straylight")
        setting = config.instrument
        band = open_band(config.passband, instrument)
        catalogue = load_catalogue(config.catalogue)
        sky = load_sky(
            catalogue, faintest_mag=config.frames.faintest_mag, epoch_year=config.catalogue.epoch_year,
            temperature=config.catalogue.temperature,
        )  # fmt: skip
        simulator = SkySimulator(instrument, sky, exposure_s=setting.exposure_s, passband=band)
        self.pixel_rad = math.radians(instrument.pixel_arcsec / 3600.0)
        psfs = None
        if needs_epsf(config.centroid):
            psfs = render_psf_grid(
                instrument, simulator.light, temperature_k=TYPICAL_K, window_px=config.window_px, long_side=7
            )
        self.reduction = Reduction(
            dark_dn=mean_dark_frame(instrument, config.dark_frames, streams=self.streams, label="dark"),
            noise=true_noise(instrument, dark_frames=config.dark_frames),
            centroid=config.centroid,
            window_px=config.window_px,
            threshold_sigma=config.threshold_sigma,
            psfs=psfs,
        )
        self.model = fit_camera(instrument.pixel_map(band, temperature_k=TYPICAL_K)).camera
        turned = Rotation.random(config.frames.attitudes, rng=self.streams.generator("attitudes"))
        self.fields: list[tuple[Observation, Rotation]] = []
        for number, truth in enumerate(turned):
            away = ROUGH_PX * self.pixel_rad * self.streams.generator("rough", number).standard_normal(3)
            self.fields.append((simulator.observe(truth), Rotation.from_rotvec(away) * truth))
            advance()

    def look(self, light_e: FloatArray | float, label: str, before: SunFrames | None = None) -> SunFrames:
        """Read all fields out under more light [e-] and measure them; ``before``: without it."""
        config, shape = self.config, self.instrument.detector.shape
        added = np.broadcast_to(np.asarray(light_e, dtype=np.float32), shape)
        found, false, lost, solved, errors, centroids, which = [], [], [], [], [], [], []
        example = None
        for number, (sky, rough) in enumerate(self.fields):
            truth = sky.truth
            place_px = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
            frame = expose(
                sky.expected.electrons[:, :, 0] + added,
                self.instrument.detector,
                streams=self.streams,
                frame=number,
                exposure_s=config.instrument.exposure_s,
                temperature_c=config.instrument.chip_temperature_c,
                background_e_per_s=config.background_e_per_s,
                band=label,
            )
            measured = measure_frame(frame, self.reduction)
            partner, wrong = measured.matched(place_px, config.window_px, MATCH_PX)
            seen = partner >= 0
            base = seen if before is None else before.stars[number]
            which.append(seen)
            found.append(int(seen.sum()))
            false.append(wrong)
            lost.append(float((base & ~seen).sum() / max(base.sum(), 1)))
            fit = seen.copy()
            fit[seen] = measured.fit[partner[seen]]
            centroids.append((measured.stars.pixel_px[partner[fit]] - place_px[fit]).ravel())
            error = self._attitude(measured, sky, rough)
            solved.append(bool(np.isfinite(error).all()))
            errors.append(error)
            if example is None:
                example = ((frame.dn - self.reduction.dark_dn) / np.float32(frame.gain_dn_per_e)).astype(np.float32)
        assert example is not None
        return SunFrames(
            found=np.array(found, np.int64),
            false=np.array(false, np.int64),
            lost=np.array(lost),
            error_px=np.concatenate(centroids),
            solved=np.array(solved),
            error_arcsec=np.array(errors),
            stars=tuple(which),
            example_e=example,
        )

    def _attitude(self, measured: MeasuredFrame, sky: Observation, rough: Rotation) -> FloatArray:
        known = SimpleNamespace(id=np.asarray(sky.field.stars.id), direction=np.asarray(sky.field.direction))
        found = identify_stars(measured.stars, self.model, known, near=rough, radius_px=4.0 * ROUGH_PX)
        solution = solve_attitude(measured.stars, found, self.model, known)
        return attitude_error_arcsec(solution.solution.rotation, sky.attitude) if solution.ok else np.full(3, np.nan)


def rms(values: Sequence[float] | FloatArray) -> float:
    """Root mean square; NaN of nothing."""
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return float(np.sqrt((known**2).mean())) if known.size else math.nan
