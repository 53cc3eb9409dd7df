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
from optics.arrays import FloatArray
from render.detector.spec import Detector
from render.engine.random import Streams
from render.observation import Observation
from render.sensor import build_star_sensor
from render.simulator import SkySimulator
from render.sky.sky import Sky, load_sky

FAINTEST_MAG = 10.0
"""Faintest rendered stars."""
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
    zero_point_mag: float  # Zero point on the axis, of stars of the reference temperature
    corner_vignetting_mag: float  # Loss of light in the corner relative to the axis

    @property
    def field_deg(self) -> float:
        """Field along the width to 0.1 deg, the precision of a data sheet."""
        geometry = self.camera.geometry
        edge_px = geometry.centre_px - [[geometry.width_px / 2, 0.0]]
        x, y, z = self.camera.unproject(edge_px)[0]
        half_deg = np.degrees(np.arctan2(np.hypot(x, y), z))
        return float(round(2.0 * half_deg, 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _NoiselessStars:
    """n stars completely on the detector."""

    magnitude: FloatArray  # (n,)
    inverse_temperature: FloatArray  # (n,) Reference temperature over the star's
    squared_radius: FloatArray  # (n,) Squared distance from the centre, 1 in the corner
    electrons: FloatArray  # (n,)


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
    frames: list[NightFrame] = []
    stars: list[_NoiselessStars] = []
    for number in progress.track(range(config.frames), "frames rendered", total=config.frames):
        simulator.background_e_per_s = float(levels[number])
        observation = simulator.observe(attitudes[number], frame=number)
        stars.append(_complete_stars(observation, sky))
        name = f"rendered {number + 1}"
        image = sensor_image(observation.frame.dn, saturation_dn=float(sensor.detector.largest_dn), source=name)
        frames.append(NightFrame(name=name, image=image))
    zero_point_mag, corner_vignetting_mag = noiseless_zero_point(
        magnitude=np.concatenate([frame.magnitude for frame in stars]),
        colour=np.concatenate([frame.inverse_temperature for frame in stars]),
        u2=np.concatenate([frame.squared_radius for frame in stars]),
        flux_e=np.concatenate([frame.electrons for frame in stars]),
    )
    return RenderedNight(
        frames=tuple(frames),
        sky=sky,
        camera=camera_model(sensor),
        detector=sensor.detector,
        exposure_s=config.exposure_s,
        zero_point_mag=zero_point_mag,
        corner_vignetting_mag=corner_vignetting_mag,
    )


def _complete_stars(observation: Observation, sky: Sky) -> _NoiselessStars:
    """Noiseless stars of a frame farther than `EDGE_PX` from the edge."""
    truth = observation.truth
    size = np.array(observation.frame.dn.shape[::-1])
    electrons = truth.electrons_image[:, 0]
    position_px = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
    inside = np.all((position_px > EDGE_PX) & (position_px < size - 1.0 - EDGE_PX), axis=1)
    complete = inside & (electrons > 0.0)
    offset_px = position_px[complete] - (size - 1.0) / 2.0
    return _NoiselessStars(
        magnitude=observation.field.stars.magnitude[complete],
        inverse_temperature=REFERENCE_K / sky.temperature_k[observation.field.row[complete]],
        squared_radius=4.0 * (offset_px**2).sum(axis=1) / (size @ size),
        electrons=electrons[complete],
    )
