"""Detector pose behind a lens of known prescription: focus, tilt and decentre, fitted to the frames.

Widths of Gaussian fits to stars over the field are compared with fits to PSFs of the prescription, rendered by rays
at several shifts of the detector (`calib.psf.focus_tilt`). Decentre is the principal point of the lens minus that of
the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.camera_order import as_calibrated
from calib.cameras.base import CameraModel
from calib.cameras.fit import camera_model
from calib.psf.focus_tilt import WINDOW_PX, DetectorPose, fit_detector_pose, gaussian_widths
from experiments.harness.sections import col
from experiments.harness.summary import Measured, measured
from experiments.twin.compare import BRIGHT_MAG
from experiments.twin.measure import CameraFit
from optics.arrays import FloatArray
from optics.export.write import toml_lens
from optics.lens.perturb import tilt_image
from optics.lens_file import read_lens_file
from optics.rays.paraxial import axial_paraxial
from render.psf_lattice import inset_axes, render_psf_grid
from render.sensor_file.instrument import Instrument, build_instrument, configured_lens
from render.sky.star_light import star_light

STAR_K = 5000.0
STEPS, LONG_SIDE = 9, 5
REACH_DEPTHS = 6.0
"""Range of searched detector shifts on both sides of the stated focus, in pixels times the F-number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPose:
    """Pose of the detector behind a known lens."""

    stars: int = col("Stars")
    defocus_mm: Measured = col("Detector away from the lens, beyond the sensor file", "mm")
    tilt_x_deg: Measured = col("Tilt of the detector about x of the lens", "deg")
    tilt_y_deg: Measured = col("Tilt about y", "deg")
    decentre_x_mm: Measured = col("Detector off the axis, along x of the lens", "mm")
    decentre_y_mm: Measured = col("Along y", "mm")
    added_width_px: Measured = col("Width that diffraction and air add, in quadrature", "px")
    focal_length_ratio: float = col("Focal length, frames over prescription", "", ".5f")
    residual_percent: float = col("Widths, scatter about the fitted lens", "percent", ".2f")
    stated_residual_percent: float = col("The same as the sensor file states it", "percent", ".2f")
    second_focus: str = col("Second focus that fits equally well", default="")


def fit_lens_pose(file: Path, fit: CameraFit, limit_mag: float) -> LensPose:
    """Focus, tilt and decentre of the detector behind the lens of a sensor file, from a camera measured in frames."""
    from render.sensor_file.file import SensorFile, complete_sensor

    config = SensorFile.model_validate(complete_sensor(file))
    width, height = fit.psf.size_px
    stated = build_instrument(config.instrument.model_copy(update={"width_px": width, "height_px": height}))
    stars = fit.gaussian
    good = (stars.magnitude < limit_mag - BRIGHT_MAG) & np.isfinite(stars.width_px)
    pose = pose_of_widths(stated, stars.observations.pixel_px[good], stars.width_px[good])
    tilted = build_instrument(stated.config, lens=tilt_image(configured_lens(stated.config), *pose.value[1:3]))
    # camera model of the tilted lens as stars would calibrate it: a tilt shifts the principal point
    nominal = as_calibrated(camera_model(tilted), fit.order, focal_length_mm=tilted.focal_length_mm)
    sigma = np.sqrt(np.diag(fit.calibration.covariance))
    pitch_mm = stated.detector.pixel_pitch_mm

    def decentre(name: str, sign: float) -> Measured:
        """Offset of the principal points: x of the lens runs along the columns, y against the rows."""
        names = fit.camera.parameter_names
        if name not in names or name not in nominal.parameter_names:
            return Measured(value=float("nan"))
        offset_mm = sign * pitch_mm * (nominal.value(name) - fit.camera.value(name))
        return Measured(value=offset_mm, uncertainty=pitch_mm * float(sigma[names.index(name)]))

    defocus, tilt_x, tilt_y, added_width = measured(pose.value, pose.sigma)
    return LensPose(
        stars=pose.stars,
        defocus_mm=defocus,
        tilt_x_deg=tilt_x,
        tilt_y_deg=tilt_y,
        decentre_x_mm=decentre("x0_px", 1.0),
        decentre_y_mm=decentre("y0_px", -1.0),
        added_width_px=added_width,
        focal_length_ratio=_central_scale(fit.camera) / _central_scale(nominal),
        residual_percent=100.0 * pose.scatter,
        stated_residual_percent=100.0 * pose.scatter_before,
        second_focus=", ".join(f"{focus:+.3f} mm" for focus in pose.other_focus_mm[:1]),
    )


def _central_scale(camera: CameraModel) -> float:
    """Pixels per unit of tan(field angle) in the middle of the image."""
    ray = camera.unproject(camera.geometry.centre_px + np.array([[-50.0, 0.0], [50.0, 0.0]]))
    return float(100.0 / np.ptp(ray[:, 0] / ray[:, 2]))


def pose_of_widths(stated: Instrument, position_px: FloatArray, width_px: FloatArray) -> DetectorPose:
    """Focus and tilt from widths (n,) of Gaussian fits to stars at positions (n, 2), by rendered PSFs of the lens."""
    pitch, light = stated.detector.pixel_pitch_mm, star_light([stated.passband()], nodes=4, magnitude_system="G")
    lens = stated.camera.focused_lens
    f_number = axial_paraxial(lens, lens.design_wavelength_nm).f_number
    reach = REACH_DEPTHS * pitch * max(f_number, 1.0)
    shift = np.linspace(-reach, reach, STEPS)
    grids = []
    for step in shift:
        focus = float(stated.config.defocus_mm) + float(step)
        moved = build_instrument(stated.config.model_copy(update={"defocus_mm": focus, "diffraction": "rays"}))
        axes = inset_axes(moved.camera, LONG_SIDE)
        grids.append(render_psf_grid(moved, light, temperature_k=STAR_K, window_px=2 * WINDOW_PX, axes=axes))
    return fit_detector_pose(
        position_px,
        width_px,
        shift_mm=shift,
        grid_px=grids[0].place_px,
        grid_width_px=np.stack([gaussian_widths(grid.psfs) for grid in grids]),
        centre_px=np.array(stated.camera.centre_px),
        pitch_mm=pitch,
    )


def write_prescription(file: Path, pose: LensPose, folder: Path) -> tuple[Path, ...]:
    """``glass.toml`` and ``glass_sensor.toml``: the lens of a sensor file with its detector in the fitted pose."""
    from render.sensor_file.file import SensorFile, complete_sensor

    sensor_tables = complete_sensor(file)
    config = SensorFile.model_validate(sensor_tables)
    tables: dict[str, Any] = dict(read_lens_file(str(config.instrument.lens)).tables)
    image = dict(tables.get("image", {}))
    stated_tilt_deg = [*image.get("tilt_deg", [0.0, 0.0]), 0.0][:3]
    tilt = Rotation.from_rotvec([pose.tilt_x_deg.value, pose.tilt_y_deg.value, 0.0], degrees=True)
    decentre_mm = np.nan_to_num([pose.decentre_x_mm.value, pose.decentre_y_mm.value])
    stated_decentre_mm = [*image.get("decentre_mm", [0.0, 0.0]), 0.0][:3]
    image["decentre_mm"] = np.add(stated_decentre_mm, [*decentre_mm, 0.0]).tolist()
    image["tilt_deg"] = np.add(stated_tilt_deg, tilt.as_euler("xyz", degrees=True)).tolist()
    tables["image"] = image
    lens, sensor = folder / "glass.toml", folder / "glass_sensor.toml"
    lens.write_text(toml_lens(tables), encoding="utf-8")
    instrument = {**sensor_tables["instrument"], "lens": lens.name}
    instrument["defocus_mm"] = float(config.instrument.defocus_mm) + pose.defocus_mm.value
    sensor.write_text(toml_lens(_without_none({**sensor_tables, "instrument": instrument})), encoding="utf-8")
    return lens, sensor


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }
