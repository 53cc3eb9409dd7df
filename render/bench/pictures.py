"""Read-out pictures of the bench: the screen through its camera, and windows of an aperture-mask sun sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from optics.arrays import FloatArray
from optics.errors import DomainError
from render.bench.camera import BenchCamera
from render.bench.scene import BenchGeometry
from render.bench.sensor import MaskSensor, mask_scene, trace_mask
from render.bench.trace import trace_screen
from render.detector.diffusion import diffuse, diffusion_kernel
from render.detector.readout import expose, expose_windows
from render.detector.spec import Detector
from render.engine.random import Streams


def screen_light(
    scene: Any,
    sensor: Any,
    camera: BenchCamera,
    geometry: BenchGeometry,
    detector: Detector,
    *,
    electrons_per_radiance: float,
    **options: Any,
) -> NDArray[np.float32]:
    """Expected electrons (h, w) of a picture of the screen; options are those of `render.bench.trace.trace_screen`."""
    light = trace_screen(scene, sensor, camera, geometry, **options)
    return diffuse(light * np.float32(electrons_per_radiance), detector.diffusion_sigma_px)


def screen_picture(
    electrons: NDArray[np.float32], detector: Detector, streams: Streams, exposure_s: float
) -> FloatArray:
    """Electrons (h, w) as read from a picture of expected electrons: (DN - offset) / gain."""
    frame = expose(electrons, detector, streams=streams, exposure_s=exposure_s)
    return (frame.dn.astype(np.float64) - frame.offset_dn) / frame.gain_dn_per_e


def mask_windows(
    sensor: MaskSensor,
    sun: FloatArray,
    detector: Detector,
    *,
    window_px: int,
    half_angle_rad: float,
    plateau_e: float,
    frames: int,
    exposure_s: float,
    log2_particles: int,
    streams: Streams,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Windows around the spots of an aperture-mask sun sensor, averaged over frames.

    Suns at unit vectors (n, 3) in the sensor frame, of angular radius ``half_angle_rad`` and ``plateau_e`` electrons
    per pixel in the full light; windows of ``window_px`` pixels are centred on the spots by geometry. Returns electrons
    (n, window, window), and the first column and row (n, 2) of each window; `DomainError` if one leaves the detector.
    """
    corner = np.rint(sensor.spot_px(sun)).astype(np.int64) - window_px // 2
    limit = np.array([sensor.width_px, sensor.height_px]) - window_px
    if np.any(corner < 0) or np.any(corner > limit):
        raise DomainError(
            f"a spot of the sun sensor leaves its detector of {sensor.width_px} x {sensor.height_px} px; make "
            "sensor.field_deg or sensor.gap_mm smaller"
        )
    light = trace_mask(
        mask_scene(sensor),
        sensor,
        sun,
        corner,
        window_px,
        half_angle_rad=half_angle_rad,
        log2_particles=log2_particles,
        seed=streams.key("particles") >> 1,
    )
    stack = expose_windows(
        _diffused(light, detector.diffusion_sigma_px) * plateau_e,
        corner,
        detector,
        streams=streams,
        frames=frames,
        exposure_s=exposure_s,
    )
    return (stack.dn.astype(np.float64).mean(0) - stack.offset_dn) / stack.gain_dn_per_e, corner


def _diffused(windows: NDArray[np.float32], sigma_px: float) -> FloatArray:
    """Charge diffusion on all windows (n, h, w) at once; what `render.detector.diffusion.diffuse` does to one image."""
    kernel = diffusion_kernel(sigma_px)
    rows = correlate1d(windows.astype(np.float64), kernel, axis=1, mode="reflect")
    return np.asarray(correlate1d(rows, kernel, axis=2, mode="reflect"))
