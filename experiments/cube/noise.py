"""Noise of the screen pictures and of the sun sensor, predicted from detector, light and geometry.

Pictures: `calib.measure.targets.circle_noise` for the detector; the particles of the rendering add noise that a
laboratory does not have (`render.bench.spot`). The rim of the spot and its slope follow from the overlap of two
circles.

Sun sensor: closed form of a centre of light (`calib.measure.centroiding.moments`); the noise of spots and readings at
each position is propagated through the least squares of a pinhole on a table (`calib.calibration.mask_sensor`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.calibration.mask_sensor import mask_sensor_noise
from calib.calibration.table_axes import TableAxes
from calib.measure.centroiding.moments import disk_centre_variance_px2
from calib.measure.targets.circle_noise import (
    Contour,
    blurred_step_slope,
    centre_variance_px2,
    light_offsets_px,
    rim_contour,
)
from calib.measure.targets.screen_circles import EDGE_HALF_WIDTH_PX, RAYS, RIM_LEVEL, RIM_PX, SPOKES
from experiments.cube.bench import CubeLaboratory
from experiments.cube.sensor import EXPOSURE_S, field_angles
from optics.arrays import FloatArray
from render.bench.spot import landing_points_px, mask_spot_variance_px2, spot_profile
from render.detector.noise import PixelNoise
from render.detector.spec import Detector

NETS = 48
"""Scrambled nets that estimate the noise by the particles; relative error of its sigma 1 / sqrt(4 NETS) = 7 %."""
PROFILE_MARGIN_PX, PROFILE_STEP_PX = 25.0, 0.25
"""Sampling of the spot's radial profile, from half the hole's radius to this distance outside the spot's edge."""
BILINEAR_VARIANCE_PX2 = 1.0 / 6.0
"""Variance per axis of the triangle kernel of bilinear interpolation; that of a square pixel is 1 / 12."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureNoise:
    """Standard deviation per axis of a measured offset [px of the screen]."""

    two_pictures_px: float  # Aperture and spot from two pictures
    one_picture_px: float  # Both from the picture of the spot
    two_pictures_detector_px: float  # Two pictures, by detector and shot noise alone, as in a laboratory
    one_picture_detector_px: float  # One picture, by detector and shot noise alone


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """Scatter of the calibration of the sun sensor."""

    spot_px: float  # Standard deviation of a spot per axis, RMS over the positions
    # (3, 3) Covariance of the error that R_sr and the fitted non-orthogonality add to R_sp: rotation vector, cube frame
    covariance_rad2: FloatArray


def pixel_noise(detector: Detector, exposure_s: float) -> PixelNoise:
    """Temporal and fixed noise of a pixel at the detector's reference temperature."""
    return PixelNoise.of(detector, temperature_c=detector.dark_reference_c, exposure_s=exposure_s)


def detector_variance_px2(laboratory: CubeLaboratory, edge: Contour, full_e: float) -> float:
    """Variance of the fitted centre of a circle, by shot noise, read-out and response of the pixels on its edge."""
    noise = pixel_noise(laboratory.detector, laboratory.config.camera.exposure_s)

    def variance_e2(brightness: float) -> float:
        light_e = brightness * full_e
        return float(noise.temporal_e2(light_e) + noise.response_e2(light_e)) + noise.offset_e**2

    at_edge, at_rim = variance_e2(edge.brightness), variance_e2(edge.rim)
    return centre_variance_px2(edge, full_e, SPOKES * RAYS, at_edge, at_rim, RIM_PX)


def picture_noise(laboratory: CubeLaboratory) -> PictureNoise:
    """Noise of the offset spot minus aperture, for a concentric face after the autocollimation adjustment.

    Detector: variance of the two circle centres. Particles: scatter of the offset over `NETS` scrambled nets.
    """
    geometry = laboratory.geometry
    pitch = laboratory.pitch_mm
    hole = geometry.aperture_mm / 2 / pitch
    rim_width = geometry.blur_mm(geometry.path_mm) / pitch
    blur = blur_px(laboratory)
    radius = np.arange(0.5 * hole, hole + rim_width + PROFILE_MARGIN_PX, PROFILE_STEP_PX)
    spot = rim_contour(spot_profile(geometry, radius * pitch), radius, hole, EDGE_HALF_WIDTH_PX["spot"], RIM_LEVEL)
    half = EDGE_HALF_WIDTH_PX["hole"]
    step = blurred_step_slope(blur, half)
    rim = float(spot_profile(geometry, [(hole + 1.0) * pitch])[0])
    hole_edge = Contour(radius=hole, slope=step * rim, brightness=rim / 2, half=half, rim=rim)
    aperture = Contour(radius=hole, slope=step, brightness=0.5, half=EDGE_HALF_WIDTH_PX["aperture"])
    plateau_e = laboratory.config.camera.plateau_e
    aperture_e = float(np.percentile(laboratory.aperture_e, 99.0))  # Brightness inside the aperture
    spot2, hole2, aperture2 = (
        detector_variance_px2(laboratory, edge, full_e)
        for edge, full_e in ((spot, plateau_e), (hole_edge, plateau_e), (aperture, aperture_e))
    )
    detector2 = np.array([spot2 + aperture2, spot2 + hole2])
    log2_particles = laboratory.config.benches.log2_particles
    nets = (landing_points_px(hole, rim_width, log2_particles, seed) for seed in range(NETS))
    offsets = np.array([light_offsets_px(*net, spot, hole_edge, blur, SPOKES * RAYS, RIM_PX) for net in nets])
    total, detector = np.sqrt([detector2 + np.mean(offsets**2, axis=(0, 2)), detector2]).tolist()
    return PictureNoise(
        two_pictures_px=total[0],
        one_picture_px=total[1],
        two_pictures_detector_px=detector[0],
        one_picture_detector_px=detector[1],
    )


def blur_px(laboratory: CubeLaboratory) -> float:
    """Standard deviation per axis of a point's light in the interpolated picture: diffusion, pixel, interpolation."""
    return float(np.sqrt(laboratory.detector.diffusion_sigma_px**2 + 1.0 / 12.0 + BILINEAR_VARIANCE_PX2))


def sensor_noise(laboratory: CubeLaboratory, *, reading: bool, fit_non_orthogonality: bool) -> SensorNoise:
    """Noise of the sun sensor's calibration over all positions of the field."""
    table = laboratory.config.table
    noise_arcsec = (table.outer_reading_arcsec, table.inner_reading_arcsec) if reading else 0.0
    axes = TableAxes.create("xy", reading_noise_arcsec=noise_arcsec)
    angle = field_angles(laboratory.config)
    cosine = axes.rotation(angle).as_matrix()[:, 2, 2]
    spot2 = spot_variance_px2(laboratory, cosine)
    per_rad = laboratory.config.sensor.gap_mm / laboratory.sensor_detector.pixel_pitch_mm
    covariance = mask_sensor_noise(axes, angle, spot2, per_rad, fit_non_orthogonality=fit_non_orthogonality)
    return SensorNoise(spot_px=float(np.sqrt(spot2.mean())), covariance_rad2=covariance)


def spot_variance_px2(laboratory: CubeLaboratory, cosine: FloatArray) -> FloatArray:
    """Variance (n,) of a spot's centre of light per axis, at cosines of the angle from the sensor's axis."""
    config = laboratory.config.sensor
    noise = pixel_noise(laboratory.sensor_detector, EXPOSURE_S)
    variance = disk_centre_variance_px2(
        config.plateau_e * cosine,
        hole_px(laboratory),
        config.window_px,
        frames=config.frames,
        floor_e2=noise.floor_e2,
        offset_e=noise.offset_e,
        column_e=noise.column_e,
        prnu=noise.prnu,
    )
    return variance + spot_particles_px2(laboratory, cosine)


def hole_px(laboratory: CubeLaboratory) -> float:
    """Radius of the hole of the mask [px]."""
    return laboratory.config.sensor.hole_um * 1e-3 / 2 / laboratory.sensor_detector.pixel_pitch_mm


def spot_particles_px2(laboratory: CubeLaboratory, cosine: FloatArray) -> float:
    """Variance of a spot's centre of light by the finite number of rendered particles."""
    config = laboratory.config.sensor
    sun_px = np.tan(laboratory.geometry.half_angle_rad) * config.gap_mm / laboratory.sensor_detector.pixel_pitch_mm
    return mask_spot_variance_px2(hole_px(laboratory), float(sun_px), cosine, config.log2_particles)
