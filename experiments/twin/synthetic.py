"""Night frames of a known camera: rendered through glass, read out, passed on like a folder's frames.

Of the truth only the data sheet's black level reaches the reduction; the results are compared with the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from calib.cameras.fit import camera_model
from calib.cameras.line_of_sight import line_of_sight_map
from calib.measure.images.sensor_image import sensor_image
from calib.photometry.spectral_response import REFERENCE_K
from calib.photometry.zero_point import noiseless_zero_point
from experiments.harness.progress import Progress
from experiments.harness.summary import Measured
from experiments.twin.folder import NightFrame
from experiments.twin.measure import CameraFit
from experiments.twin.settings import NightConfig
from optics.units import RAD_ARCSEC
from render.detector.spec import Detector
from render.engine.random import Streams
from render.sensor import build_star_sensor
from render.simulator import SkySimulator
from render.sky.sky import Sky, load_sky

FAINTEST_MAG = 10.0
EDGE_PX = 12.0
"""Stars nearer to the edge lose light beyond it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownNight:
    """Rendered frames and their truth."""

    frames: tuple[NightFrame, ...]
    sky: Sky
    camera: CameraModel  # Fitted to the traced lens
    detector: Detector
    exposure_s: float
    zero_point_mag: float  # Of stars of the reference colour in the middle
    corner_loss_mag: float  # Vignetting

    @property
    def field_deg(self) -> float:
        """Field along the width, as a user would state it."""
        geometry = self.camera.geometry
        x, y, z = self.camera.unproject(geometry.centre_px - [[geometry.width_px / 2, 0.0]])[0]
        return float(round(2.0 * np.degrees(np.arctan2(np.hypot(x, y), z)), 1))


def render_night(config: NightConfig, seed: int, progress: Progress) -> KnownNight:
    """Render the frames."""
    sensor = build_star_sensor(
        config.lens, config.detector, window_px=(config.width_px, config.height_px), defocus_mm=0.0
    )
    sky = load_sky(faintest_mag=FAINTEST_MAG)
    streams = Streams(seed).child("twin night")
    attitudes = Rotation.random(config.frames, rng=streams.generator("attitudes"))
    levels = np.geomspace(max(config.darkest_e_per_s, 1.0), max(config.brightest_e_per_s, 1.0), config.frames)
    simulator = SkySimulator(sensor, sky, exposure_s=config.exposure_s, seed=seed)
    frames, rows = [], []
    size = np.array([config.width_px, config.height_px])
    for number in progress.track(range(config.frames), "frames rendered", total=config.frames):
        simulator.background_e_per_s = float(levels[number])
        observation = simulator.observe(attitudes[number], frame=number)
        truth = observation.truth
        light = truth.electrons_image[:, 0]
        position = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
        inside = np.all((position > EDGE_PX) & (position < size - 1.0 - EDGE_PX), axis=1)
        known = inside & (light > 0.0)
        u2 = 4.0 * ((position[known] - (size - 1.0) / 2.0) ** 2).sum(axis=1) / (size @ size)
        colour = REFERENCE_K / sky.temperature_k[observation.field.row[known]]
        rows.append(np.stack([observation.field.stars.magnitude[known], colour, u2, light[known]]))
        name = f"rendered {number + 1}"
        image = sensor_image(observation.frame.dn, saturation_dn=float(sensor.detector.largest_dn), source=name)
        frames.append(NightFrame(name=name, image=image))
    zero, loss = noiseless_zero_point(*np.concatenate(rows, axis=1))
    return KnownNight(
        frames=tuple(frames),
        sky=sky,
        camera=camera_model(sensor),
        detector=sensor.detector,
        exposure_s=config.exposure_s,
        zero_point_mag=zero,
        corner_loss_mag=loss,
    )


def true_values(truth: KnownNight, numbers: Any, fit: CameraFit) -> list[tuple[str, str, Measured, float]]:
    """Name, unit, measured value and true value; ``numbers`` as of the report."""
    chip, focal = truth.detector, truth.camera.value("focal_length_mm")
    grid = truth.camera.geometry.grid_px(13)
    line_of_sight = line_of_sight_map(
        fit.camera, truth.camera.unproject(grid), grid, covariance=fit.calibration.covariance
    )
    error, predicted = (
        float(np.sqrt(np.nanmean(np.square(part)))) * focal / chip.pixel_pitch_mm / RAD_ARCSEC
        for part in (line_of_sight.error_arcsec, line_of_sight.predicted_sigma_arcsec)
    )
    return [
        ("map of the camera, RMS error", "px", Measured(value=error, uncertainty=predicted), 0.0),
        ("gain", "e-/DN", numbers.gain_e_per_dn, 1.0 / chip.gain_dn_per_e),
        ("PRNU", "percent", numbers.prnu_percent, 100.0 * chip.prnu),
        ("zero point", "mag", numbers.zero_point_mag, truth.zero_point_mag),
        ("vignetting at the corner", "mag", numbers.vignetting_mag, truth.corner_loss_mag),
        ("focal length", "px", numbers.focal_length_px, focal / chip.pixel_pitch_mm),
    ]
