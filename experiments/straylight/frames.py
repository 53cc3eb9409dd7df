"""Frames of the real sky in sunlight: detected, lost and false stars, centroids, attitude.

The sky is rendered once per attitude; for every angle of the Sun its light is added, the frame is read out and
measured. The camera is calibrated without error (a model fitted to its traced map), the attitude approximately known.
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
from calib.measure.reduced_frame import FrameReduction, MeasuredFrame, measure_frame
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import mean_dark_frame, true_noise
from experiments.straylight.settings import StraylightConfig
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
"""Match radius of detections and stars."""
PRIOR_SIGMA_PX = 5.0
"""Standard deviation per axis of the a-priori attitude."""
STAR_K = 5800.0
"""Temperature of the star of the calibrated PSFs and of the camera model."""
PSF_GRID = 7
"""PSFs along the longer side of the detector."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SunFrames:
    """Measurements at m attitudes under the same stray light."""

    stars: NDArray[np.int64]  # (m,) Number of detected stars
    false: NDArray[np.int64]  # (m,) Number of false detections
    lost_fraction: FloatArray  # (m,) Fraction lost of the stars detected without the Sun
    error_px: FloatArray  # (k,) Centroid minus photocentre, per axis, of stars with a valid fit
    solved: NDArray[np.bool_]  # (m,)
    error_arcsec: FloatArray  # (m, 3) Attitude error; NaN: not solved
    detected: tuple[NDArray[np.bool_], ...]  # For each attitude, whether each star is detected
    example_e: NDArray[np.float32]  # (h, w) First frame, electrons above the mean dark frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _MeasuredField:
    """Measurements at one attitude; fields as `SunFrames`."""

    detected: NDArray[np.bool_]
    false: int
    lost_fraction: float
    error_px: FloatArray
    error_arcsec: FloatArray
    image_e: NDArray[np.float32]


class SunFields:
    """Expected images of the attitudes, simulator and reduction."""

    def __init__(
        self, config: StraylightConfig, instrument: Instrument, advance: Callable[[], None] = lambda: None
    ) -> None:
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
                temperature_k=STAR_K,
                window_px=config.window_px,
                axes=inset_axes(instrument.camera, PSF_GRID),
            )
        self.reduction = FrameReduction(
            dark_dn=mean_dark_frame(instrument, config.dark_frames, streams=streams, label="dark"),
            noise=true_noise(instrument, dark_frames=config.dark_frames),
            centroid=config.centroid,
            window_px=config.window_px,
            threshold_sigma=config.threshold_sigma,
            psfs=psfs,
        )
        self.model = fit_camera(instrument.pixel_map(band, temperature_k=STAR_K)).camera
        sigma_rad = PRIOR_SIGMA_PX * math.radians(instrument.pixel_arcsec / 3600.0)
        self.fields: list[tuple[SkyLight, Rotation]] = []
        for number, truth in enumerate(Rotation.random(config.frames.attitudes, rng=streams.generator("attitudes"))):
            error = Rotation.from_rotvec(sigma_rad * streams.generator("rough", number).standard_normal(3))
            self.fields.append((self.simulator.expected(truth), error * truth))
            advance()

    def observe(self, stray_light_e: FloatArray | float, label: str, dark: SunFrames | None = None) -> SunFrames:
        """Frames of all attitudes with added light [e-], measured; ``dark``: frames without it."""
        fields = [self._observe(number, stray_light_e, label, dark) for number in range(len(self.fields))]
        error_arcsec = np.array([field.error_arcsec for field in fields])
        return SunFrames(
            stars=np.array([int(field.detected.sum()) for field in fields], np.int64),
            false=np.array([field.false for field in fields], np.int64),
            lost_fraction=np.array([field.lost_fraction for field in fields]),
            error_px=np.concatenate([field.error_px for field in fields]),
            solved=np.isfinite(error_arcsec).all(axis=1),
            error_arcsec=error_arcsec,
            detected=tuple(field.detected for field in fields),
            example_e=fields[0].image_e,
        )

    def _observe(
        self, number: int, stray_light_e: FloatArray | float, label: str, dark: SunFrames | None
    ) -> _MeasuredField:
        """Read out and measure the field of an attitude."""
        light, prior = self.fields[number]
        position_px = np.column_stack([light.truth.photon_x_px[:, 0], light.truth.photon_y_px[:, 0]])
        frame = self.simulator.read(light, frame=number, label=label, added_e=np.asarray(stray_light_e, np.float32))
        measured = measure_frame(frame, self.reduction)
        detection, false = measured.matched(position_px, self.config.window_px, MATCH_PX)
        detected = detection >= 0
        detectable = detected if dark is None else dark.detected[number]
        lost = float((detectable & ~detected).sum() / max(detectable.sum(), 1))
        usable = detected.copy()
        usable[detected] = measured.fit[detection[detected]]
        image_e = (frame.dn - self.reduction.dark_dn) / np.float32(frame.gain_dn_per_e)
        return _MeasuredField(
            detected=detected,
            false=false,
            lost_fraction=lost,
            error_px=(measured.stars.pixel_px[detection[usable]] - position_px[usable]).ravel(),
            error_arcsec=self._attitude_error(measured, light, prior),
            image_e=image_e.astype(np.float32),
        )

    def _attitude_error(self, measured: MeasuredFrame, light: SkyLight, prior: Rotation) -> FloatArray:
        """Error (3,) of the attitude, stars identified from the a-priori attitude; NaN: not solved."""
        assert light.field is not None
        catalogue = SimpleNamespace(id=np.asarray(light.field.stars.id), direction=np.asarray(light.field.direction))
        matches = identify_stars(measured.stars, self.model, catalogue, near=prior, radius_px=4.0 * PRIOR_SIGMA_PX)
        solution = solve_attitude(measured.stars, matches, self.model, catalogue)
        if not solution.ok:
            return np.full(3, np.nan)
        return attitude_error_arcsec(solution.solution.rotation, light.attitude)


def rms(values: Sequence[float] | FloatArray) -> float:
    """Root mean square of the finite values; NaN without any."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    return float(np.sqrt((finite**2).mean())) if finite.size else math.nan
