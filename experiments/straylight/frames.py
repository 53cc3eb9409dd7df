"""Frames of the real sky under the light of the Sun: stars detected, lost and false, centroids, attitude.

The sky is rendered once per attitude; every angle of the Sun adds its light, and the frame is read out and measured
again. The camera is calibrated without error (a model fitted to its traced map), the attitude approximately known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.star_attitude import identify_stars, solve_attitude
from calib.cameras.fit import fit_camera
from calib.measure.reduced_frame import FrameReduction, MeasuredFrame, measure_frame
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import mean_dark_frame, true_noise
from experiments.straylight.settings import Config
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from render.engine.random import Streams
from render.observation import SkyLight
from render.psf_lattice import inset_axes, render_psf_grid
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


class SunFields:
    """Light of the attitudes, and what all frames share."""

    def __init__(self, config: Config, instrument: Instrument, advance: Callable[[], None] = lambda: None) -> None:
        self.config, self.instrument = config, instrument
        streams = Streams(config.seed).child("straylight")
        band = open_band(config.passband, instrument)
        sky = load_sky(
            load_catalogue(config.catalogue),
            faintest_mag=config.frames.faintest_mag,
            epoch_year=config.catalogue.epoch_year,
            temperature=config.catalogue.temperature,
        )
        self.simulator = SkySimulator(
            instrument,
            sky,
            exposure_s=config.instrument.exposure_s,
            passband=band,
            temperature_c=config.instrument.chip_temperature_c,
            background_e_per_s=config.background_e_per_s,
            seed=streams,
        )
        psfs = None
        if needs_epsf(config.centroid):
            psfs = render_psf_grid(
                instrument,
                self.simulator.light,
                temperature_k=TYPICAL_K,
                window_px=config.window_px,
                axes=inset_axes(instrument.camera, 7),
            )
        self.reduction = FrameReduction(
            dark_dn=mean_dark_frame(instrument, config.dark_frames, streams=streams, label="dark"),
            noise=true_noise(instrument, dark_frames=config.dark_frames),
            centroid=config.centroid,
            window_px=config.window_px,
            threshold_sigma=config.threshold_sigma,
            psfs=psfs,
        )
        self.model = fit_camera(instrument.pixel_map(band, temperature_k=TYPICAL_K)).camera
        rough_rad = ROUGH_PX * math.radians(instrument.pixel_arcsec / 3600.0)
        self.fields: list[tuple[SkyLight, Rotation]] = []
        for number, truth in enumerate(Rotation.random(config.frames.attitudes, rng=streams.generator("attitudes"))):
            error = Rotation.from_rotvec(rough_rad * streams.generator("rough", number).standard_normal(3))
            self.fields.append((self.simulator.expected(truth), error * truth))
            advance()

    def look(self, light_e: FloatArray | float, label: str, before: SunFrames | None = None) -> SunFrames:
        """Read all fields out under more light [e-] and measure them; ``before``: without it."""
        rows = [self._look(number, light_e, label, before) for number in range(len(self.fields))]
        detected, false, lost, centroid, error, example = zip(*rows, strict=True)
        error_arcsec = np.array(error)
        return SunFrames(
            found=np.array([int(stars.sum()) for stars in detected], np.int64),
            false=np.array(false, np.int64),
            lost=np.array(lost),
            error_px=np.concatenate(centroid),
            solved=np.isfinite(error_arcsec).all(axis=1),
            error_arcsec=error_arcsec,
            stars=detected,
            example_e=example[0],
        )

    def _look(self, number: int, light_e: FloatArray | float, label: str, before: SunFrames | None) -> tuple[Any, ...]:
        """One field: stars detected, false detections, fraction lost, centroid and attitude errors, the frame."""
        light, rough = self.fields[number]
        position_px = np.column_stack([light.truth.photon_x_px[:, 0], light.truth.photon_y_px[:, 0]])
        frame = self.simulator.read(light, frame=number, label=label, added_e=np.asarray(light_e, np.float32))
        measured = measure_frame(frame, self.reduction)
        partner, false = measured.matched(position_px, self.config.window_px, MATCH_PX)
        detected = partner >= 0
        known = detected if before is None else before.stars[number]
        lost = float((known & ~detected).sum() / max(known.sum(), 1))
        fit = detected.copy()
        fit[detected] = measured.fit[partner[detected]]
        centroid = (measured.stars.pixel_px[partner[fit]] - position_px[fit]).ravel()
        example = (frame.dn - self.reduction.dark_dn) / np.float32(frame.gain_dn_per_e)
        return detected, false, lost, centroid, self._attitude(measured, light, rough), example.astype(np.float32)

    def _attitude(self, measured: MeasuredFrame, light: SkyLight, rough: Rotation) -> FloatArray:
        assert light.field is not None
        known = SimpleNamespace(id=np.asarray(light.field.stars.id), direction=np.asarray(light.field.direction))
        matches = identify_stars(measured.stars, self.model, known, near=rough, radius_px=4.0 * ROUGH_PX)
        solution = solve_attitude(measured.stars, matches, self.model, known)
        if not solution.ok:
            return np.full(3, np.nan)
        return attitude_error_arcsec(solution.solution.rotation, light.attitude)


def rms(values: Sequence[float] | FloatArray) -> float:
    """Root mean square; NaN of nothing."""
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return float(np.sqrt((known**2).mean())) if known.size else math.nan
