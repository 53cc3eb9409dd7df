"""Night frames of a known camera: rendered through glass, read out, passed on like a folder's frames.

The reduction takes only the black level from the truth; its results are compared with the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from calib.cameras.fit import camera_model
from calib.measure.images.sensor_image import sensor_image
from calib.photometry.spectral_response import REFERENCE_K
from calib.photometry.zero_point import noiseless_zero_point
from experiments.harness.progress import Progress
from experiments.twin.folder import NightFrame
from experiments.twin.settings import NightConfig
from render.detector.spec import Detector
from render.engine.random import Streams
from render.sensor import build_star_sensor
from render.simulator import SkySimulator
from render.sky.sky import Sky, load_sky

FAINTEST_MAG = 10.0
EDGE_PX = 12.0
"""Margin: the image of a star nearer to the edge is not complete."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedNight:
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


def render_night(config: NightConfig, seed: int, progress: Progress) -> RenderedNight:
    """Render frames at random attitudes, the background rising from frame to frame."""
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
        electrons = truth.electrons_image[:, 0]
        position = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
        inside = np.all((position > EDGE_PX) & (position < size - 1.0 - EDGE_PX), axis=1)
        complete = inside & (electrons > 0.0)
        u2 = 4.0 * ((position[complete] - (size - 1.0) / 2.0) ** 2).sum(axis=1) / (size @ size)
        colour = REFERENCE_K / sky.temperature_k[observation.field.row[complete]]
        rows.append(np.stack([observation.field.stars.magnitude[complete], colour, u2, electrons[complete]]))
        name = f"rendered {number + 1}"
        image = sensor_image(observation.frame.dn, saturation_dn=float(sensor.detector.largest_dn), source=name)
        frames.append(NightFrame(name=name, image=image))
    zero, loss = noiseless_zero_point(*np.concatenate(rows, axis=1))
    return RenderedNight(
        frames=tuple(frames),
        sky=sky,
        camera=camera_model(sensor),
        detector=sensor.detector,
        exposure_s=config.exposure_s,
        zero_point_mag=zero,
        corner_loss_mag=loss,
    )
