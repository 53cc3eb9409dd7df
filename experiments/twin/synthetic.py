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
from calib.measure.image import sensor_image
from experiments.harness.progress import Progress
from experiments.harness.summary import Measured
from experiments.twin.folder import NightFrame
from experiments.twin.measure import CameraFit
from experiments.twin.settings import NightConfig
from optics.arrays import FloatArray
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
    # Of all stars of all frames: magnitude, 5040 K / T, place from the middle over half of the diagonal, squared, and
    # electrons on the detector
    magnitude: FloatArray
    colour: FloatArray
    u2: FloatArray
    electrons: FloatArray


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
    half = 0.5 * float(np.hypot(config.width_px, config.height_px))
    middle = (np.array([config.width_px, config.height_px]) - 1.0) / 2.0
    for number in progress.track(range(config.frames), "frames rendered", total=config.frames):
        simulator.background_e_per_s = float(levels[number])
        seen = simulator.observe(attitudes[number], frame=number)
        truth = seen.truth
        light = truth.electrons_image[:, 0]
        place = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
        end = np.array([config.width_px, config.height_px]) - 1.0 - EDGE_PX
        inside = np.all((place > EDGE_PX) & (place < end), axis=1)
        known = inside & (light > 0.0)
        rows.append(
            np.column_stack(
                [
                    seen.field.stars.magnitude[known],
                    5040.0 / sky.temperature_k[seen.field.row[known]],
                    ((place[known] - middle) ** 2).sum(axis=1) / half**2,
                    light[known],
                ]
            )
        )
        frames.append(
            NightFrame(
                name=f"rendered {number + 1}",
                image=sensor_image(
                    seen.frame.dn, saturation_dn=float(sensor.detector.largest_dn), source=f"rendered {number + 1}"
                ),
            )
        )
    stars = np.concatenate(rows)
    return KnownNight(
        frames=tuple(frames),
        sky=sky,
        camera=camera_model(sensor),
        detector=sensor.detector,
        exposure_s=config.exposure_s,
        magnitude=stars[:, 0],
        colour=stars[:, 1],
        u2=stars[:, 2],
        electrons=stars[:, 3],
    )


def true_values(truth: KnownNight, numbers: Any, fit: CameraFit) -> list[tuple[str, str, Measured, float]]:
    """Name, unit, measured value and true value; ``numbers`` as of the report."""
    chip, pitch = truth.detector, truth.detector.pixel_pitch_mm
    gain = 1.0 / chip.gain_dn_per_e
    zero, loss = _true_light(truth)
    error_px, predicted_px = _map_error(truth, fit)
    return [
        ("map of the camera, RMS error", "px", Measured(value=error_px, uncertainty=predicted_px), 0.0),
        ("gain", "e-/DN", numbers.gain_e_per_dn, gain),
        ("PRNU", "percent", numbers.prnu_percent, 100.0 * chip.prnu),
        ("zero point", "mag", numbers.zero_point_mag, zero),
        ("vignetting at the corner", "mag", numbers.vignetting_mag, loss),
        ("focal length", "px", numbers.focal_length_px, truth.camera.value("focal_length_mm") / pitch),
    ]


def _true_light(truth: KnownNight) -> tuple[float, float]:
    """Zero point of stars of 5040 K in the middle, and loss at the corner [mag], fitted to the rendered electrons."""
    near = (np.abs(truth.colour - 1.0) < 0.15) & (truth.u2 < 0.9)
    value = truth.magnitude[near] + 2.5 * np.log10(truth.electrons[near])
    design = np.column_stack([np.ones(near.sum()), truth.colour[near] - 1.0, -truth.u2[near], -(truth.u2[near] ** 2)])
    found = np.linalg.lstsq(design, value, rcond=None)[0]
    return float(found[0]), float(found[2] + found[3])


def _map_error(truth: KnownNight, fit: CameraFit) -> tuple[float, float]:
    """RMS distance per axis of the two maps after the best rotation, and what the covariance predicts [px]."""
    grid = truth.camera.geometry.grid_px(13)
    found = line_of_sight_map(fit.camera, truth.camera.unproject(grid), grid, covariance=fit.calibration.covariance)
    scale = truth.camera.value("focal_length_mm") / truth.detector.pixel_pitch_mm / RAD_ARCSEC
    error = np.asarray(found.error_arcsec) * scale
    predicted = np.asarray(found.predicted_sigma_arcsec) * scale
    return float(np.sqrt(np.nanmean(error**2))), float(np.sqrt(np.nanmean(predicted**2)))
