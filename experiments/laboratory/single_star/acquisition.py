"""Acquisition of star vectors (S200): a frame and a table reading at every position, at rest or in motion.

In motion the second axis turns at a constant rate during the exposure, and the image is a streak, rendered as the star
at several instants of the exposure with equal fractions of the light. The reading belongs to the middle of the
exposure; jitter between the clocks of table and camera is an error of the reading, the rate times the time error.

The reduction uses the calibrated camera, the readings and the rate. Windows are placed at the predicted star, and
centroids use the PSF of the lens, smeared along the path of the image for a moving table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.calibration.star_bench import StarBench, aiming_angles
from calib.measure.centroid_error.linear_response import centroid_covariance, linear_response
from calib.measure.centroiding.registry import get_centroider
from calib.measure.reduced_windows import dark_subtracted, refuse_saturated
from calib.measure.statistics.frame_positions import measured_positions
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench.readout.windows import WindowReader, cut_windows, window_corners
from experiments.laboratory.devices.turntable import Turntable
from experiments.laboratory.single_star.star import SingleStar
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.forward import StarRenderer
from render.records import EffectivePsf, StarField
from render.sensor_file.instrument import Instrument
from render.tracing.psf import epsf_tracer, render_epsf

CHUNK = 32
"""Windows whose response is computed at once; bounds the memory."""
DETECTION_SIGMA = 5.0
"""Least signal-to-noise ratio of a window with a star."""
DETECTED_FRACTION = 0.9
"""Least fraction of positions at which the star is detected."""
ENCLOSED_FRACTION = 0.5
"""Least fraction of the star's electrons within its window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableMotion:
    """Motion of the table during the exposure."""

    rate_rad_per_s: float = 0.0  # Of the second axis (the inner one of two); 0: at rest
    jitter_s: float = 0.0  # Standard deviation between mid-exposure and reading
    samples: int = 1  # Instants that are rendered

    def instants_s(self, exposure_s: float) -> FloatArray:
        """Instants about mid-exposure, equally spaced (midpoint rule)."""
        return np.asarray(((np.arange(self.samples) + 0.5) / self.samples - 0.5) * exposure_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePositions:
    """Angles of a table with k axes at n positions, at mid-exposure."""

    true_rad: FloatArray  # (n, k)
    reading_rad: FloatArray  # (n, k)
    rate_rad_per_s: FloatArray  # (n, k) Of the axes
    motion: TableMotion  # Of the second axis

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("true_rad", "reading_rad", "rate_rad_per_s"):
            freeze(self, name, shape=("n", "k"), sizes=sizes)

    def __len__(self) -> int:
        return len(self.true_rad)

    def directions(self, bench: StarBench, exposure_s: float) -> FloatArray:
        """Unit vectors (n, t, 3) in cam towards the star at the instants of the exposure."""
        instants = self.motion.instants_s(exposure_s)
        angle = self.true_rad[:, None] + self.rate_rad_per_s[:, None] * instants[None, :, None]
        count, axes = self.true_rad.shape
        return bench.star_in_cam(angle.reshape(-1, axes)).reshape(count, len(instants), 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Acquisition:
    """Star images of an acquisition at n positions where the star was detected."""

    name: str  # "static" or "dynamic"
    places: TablePositions  # Angles
    position_px: FloatArray  # (n, 2) Centroids of single frames
    covariance_px2: FloatArray  # (n, 2, 2) Predicted: photons, read noise, rounding, dark frames, response pattern
    bundle_px: FloatArray  # (n, 2) Truth: mean of the traced rays over the exposure
    lost: int  # Positions without detection

    def __post_init__(self) -> None:
        sizes = {"n": len(self.places)}
        freeze_all(self, position_px=("n", 2), covariance_px2=("n", 2, 2), bundle_px=("n", 2), sizes=sizes)


def visit_once(
    bench: StarBench, wanted_cam: FloatArray, roll_rad: FloatArray, motion: TableMotion, columns: int, streams: Streams
) -> TablePositions:
    """Turn the table to every position, or through it; read each axis once."""
    assert isinstance(bench.table, Turntable)
    true = bench.table.set(aiming_angles(bench, wanted_cam, roll_rad), streams)
    rate = np.zeros_like(true)
    rate[:, 1] = np.where(np.arange(len(true)) // columns % 2, -1, 1)
    rate *= motion.rate_rad_per_s
    delay_s = motion.jitter_s * streams.child("clock").generator("jitter").standard_normal((len(true), 1))
    reading = bench.table.read(true + rate * delay_s, streams)
    return TablePositions(true_rad=true, reading_rad=reading, rate_rad_per_s=rate, motion=motion)


def merged_nodes(stars: StarField) -> StarField:
    """The same light on half the wavelengths: neighbours become one node at their photon-weighted mean.

    First moments in wavelength are conserved, and with them a linear lateral colour. A streak has ten times as many
    stars, for which half the nodes are half the time.
    """
    if stars.wavelength_nm.shape[1] % 2:
        return stars
    rate = np.array(stars.photon_rate).reshape(*stars.photon_rate.shape[:2], -1, 2)
    wavelength = np.array(stars.wavelength_nm).reshape(len(stars.wavelength_nm), -1, 2)
    weight = np.maximum(rate.mean(0), 1e-300)
    return replace(
        stars,
        wavelength_nm=(wavelength * weight).sum(-1) / weight.sum(-1),
        photon_rate=rate.sum(-1),
    )


def place_psfs(star: SingleStar, direction: FloatArray, instrument: Instrument, half_px: int) -> FloatArray:
    """PSFs (n, m, m) at directions (n, 3); the oversampling is that of `render.tracing.psf.render_epsf`."""
    light = merged_nodes(star.field(direction, instrument))
    tracer = epsf_tracer(instrument.camera)
    return np.stack([row[0].values for row in render_epsf(tracer, light, half_size_px=half_px)])


def acquire(
    name: str,
    places: TablePositions,
    bench: StarBench,
    star: SingleStar,
    psfs: Sequence[EffectivePsf],
    expected_px: FloatArray,
    instrument: Instrument,
    *,
    window_px: int,
    dark_frames: int,
    streams: Streams,
) -> Acquisition:
    """Render, read out, centroid."""
    exposure_s = instrument.config.exposure_s
    direction = places.directions(bench, exposure_s)
    count, instants, _ = direction.shape
    light = merged_nodes(star.field(direction.reshape(-1, 3), instrument))
    renderer = StarRenderer(instrument.camera, exposure_s=exposure_s)
    expected = renderer.render(replace(light, photon_rate=light.photon_rate / instants))
    truth = expected.truth
    assert truth is not None
    bundle = np.column_stack([truth.bundle_x_px, truth.bundle_y_px]).reshape(count, instants, 2).mean(1)
    size = instrument.camera.width_px, instrument.camera.height_px
    where = f"{name} acquisition"
    corner = window_corners(expected_px, window_px, size, where=where, advice="raise evaluation.edge_px")
    window_e = cut_windows(expected.electrons[:, :, 0], corner, window_px)
    _check_inside(name, window_e, truth.electrons_in.reshape(count, instants).sum(1), expected_px, window_px)

    reader = WindowReader(instrument, streams)
    stack = reader.expose(window_e, corner, frames=1, label=f"{name} star")
    dark_e = reader.dark(corner, window_px, frames=dark_frames, label=f"{name} dark")
    stamps, noise = dark_subtracted(stack, dark_e, start_px=expected_px)
    return _measured(name, places, stamps, noise, psfs, window_e, bundle, instrument, dark_frames)


def _measured(
    name: str,
    places: TablePositions,
    stamps: Stamps,
    noise: NoiseModel,
    psfs: Sequence[EffectivePsf],
    light_e: NDArray[Any],
    bundle_px: FloatArray,
    instrument: Instrument,
    dark_frames: int,
) -> Acquisition:
    """Centroids and their covariance; positions without detection are dropped."""
    advice = f"lower evaluation.signal_e (up to {float(light_e.sum((1, 2)).max()):.0f} e- in a window)"
    refuse_saturated(stamps, len(stamps), where=f"{name} acquisition", advice=advice)
    position = measured_positions(get_centroider("epsf", epsf=list(psfs)), stamps, noise, 1)[0]
    electrons, pixel = light_e.astype(np.float64), instrument.pixel_noise()
    temporal_e2 = pixel.temporal_e2(electrons, dark_frames=dark_frames)
    faint = stamps.electrons.sum((1, 2)) < DETECTION_SIGMA * np.sqrt(temporal_e2.sum((1, 2)))
    good = np.isfinite(position[:, 0]) & ~faint
    if good.mean() < DETECTED_FRACTION:
        raise DomainError(
            f"{name} acquisition: the star gives a position at {int(good.sum())} of {len(good)} places only, at least "
            f"{DETECTED_FRACTION:.0%} are needed; raise evaluation.signal_e or narrow the window"
        )
    variance = temporal_e2 + pixel.response_e2(electrons)
    chunks = [slice(first, first + CHUNK) for first in range(0, len(electrons), CHUNK)]
    covariance = np.concatenate(
        [_covariance(psfs[k], stamps.select(k), noise, electrons[k], variance[k]) for k in chunks]
    )
    return Acquisition(
        name=name,
        places=replace(
            places,
            true_rad=places.true_rad[good],
            reading_rad=places.reading_rad[good],
            rate_rad_per_s=places.rate_rad_per_s[good],
        ),
        position_px=position[good],
        covariance_px2=covariance[good],
        bundle_px=bundle_px[good],
        lost=int((~good).sum()),
    )


def _covariance(
    psfs: Sequence[EffectivePsf], stamps: Stamps, noise: NoiseModel, light_e: FloatArray, variance_e2: FloatArray
) -> FloatArray:
    """Covariance (k, 2, 2) of the centroids of k windows through their linear response."""
    indexed = replace(stamps, psf_index=np.arange(len(psfs)))
    gain = linear_response(get_centroider("epsf", epsf=list(psfs)), indexed, noise, light_e)
    return centroid_covariance(gain, variance_e2)


def _check_inside(
    name: str, window_e: NDArray[Any], star_e: FloatArray, expected_px: FloatArray, window_px: int
) -> None:
    fraction = window_e.sum((1, 2)) / np.maximum(star_e, 1e-300)
    if fraction.min() < ENCLOSED_FRACTION:
        at = int(np.argmin(fraction))
        raise DomainError(
            f"{name} acquisition: only {fraction[at]:.0%} of the star's light falls into the window of {window_px} px "
            f"at column {expected_px[at, 0]:.0f}, row {expected_px[at, 1]:.0f}; the image is vignetted, off the "
            "detector or smeared beyond the window (dynamic.rate_deg_per_s times the exposure)"
        )


def smear_px(motion: TableMotion, instrument: Instrument) -> float:
    """Length of the streak on the axis [px]."""
    return abs(motion.rate_rad_per_s) * instrument.config.exposure_s / (instrument.pixel_arcsec * ARCSEC_RAD)
