"""A known prescription in place of the measured lens: focus, tilt and decentre of its detector, fitted to the frames.

Widths of Gaussian fits over the field are compared with fits to the prescription's own PSFs, rendered at several shifts
of the detector by rays and fitted alike: defocus over the detector is linear, z = z0 + a x + b y; diffraction and air
add a width in quadrature. Decentre is the principal point of the lens minus that of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.calibration.observations import Observations
from calib.cameras import BrownConrady
from calib.cameras.base import CameraModel
from calib.cameras.fit import camera_model
from calib.measure.centroid import get_centroider
from calib.records import NoiseModel, Stamps
from experiments.harness.sections import col
from experiments.harness.summary import Measured
from experiments.laboratory.bench.readout.psf_grid import PsfGrid, render_psf_grid
from experiments.twin.camera import calibrated
from experiments.twin.measure import CameraFit
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.export.write import toml_lens
from optics.lens.perturb import tilt_image
from optics.lens_file import read_lens_file
from render.sensor_file.instrument import Instrument, build_instrument, configured_lens
from render.sky.star_light import star_light

STAR_K = 5000.0
STEPS = 9
LONG_SIDE = 5
REACH_DEPTHS = 6.0
"""Range of searched detector shifts on both sides of the stated focus, in pixels times the F-number."""
WINDOW_PX = 11
FEWEST_STARS = 30
BRIGHTER_MAG = 1.5
STEEPEST = 0.05
"""Slope of the detector [rad] that is searched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPose:
    """Pose of the detector behind a known lens."""

    stars: int = col("Stars")
    defocus_mm: Measured = col("Detector away from the lens, beyond the sensor file", "mm")
    tilt_x_deg: Measured = col("Tilt of the detector about x of the lens", "deg")
    tilt_y_deg: Measured = col("Tilt about y", "deg")
    decentre_x_mm: Measured = col("Detector off the axis, along x of the lens", "mm")
    decentre_y_mm: Measured = col("Along y", "mm")
    blur_px: Measured = col("Width that diffraction and air add, in quadrature", "px")
    focal_ratio: float = col("Focal length, frames over prescription", "", ".5f")
    residual_percent: float = col("Widths, scatter about the fitted lens", "percent", ".2f")
    before_percent: float = col("The same as the sensor file states it", "percent", ".2f")
    other_focus: str = col("Second focus that fits equally well", default="")


def has_prescription(file: Path) -> bool:
    """Whether the lens of a sensor file has surfaces that can be traced."""
    from render.sensor_file.file import SensorFile, read_sensor
    from render.sensor_file.instrument import stated_lens

    lens = stated_lens(SensorFile.model_validate(read_sensor(file)).instrument)
    return bool(lens.surfaces)


def fit_lens_pose(file: Path, fit: CameraFit, limit_mag: float) -> LensPose:
    """Focus, tilt and decentre of the detector behind the lens of a sensor file, from a camera measured in frames."""
    from render.sensor_file.file import SensorFile, whole_sensor

    config = SensorFile.model_validate(whole_sensor(file))
    width, height = fit.psf.size_px
    stated = build_instrument(config.instrument.model_copy(update={"width_px": width, "height_px": height}))
    stars = fit.gaussian
    good = (stars.magnitude < limit_mag - BRIGHTER_MAG) & np.isfinite(stars.width_px)
    pose = pose_of_widths(stated, stars.observations.pixel_px[good], stars.width_px[good])
    turned = tilt_image(configured_lens(stated.config), pose.tilt_x_deg.value, pose.tilt_y_deg.value)
    own = _as_calibrated(build_instrument(stated.config, lens=turned), fit)
    sigma = np.sqrt(np.diag(fit.calibration.covariance))
    pitch_mm = stated.detector.pixel_pitch_mm

    def away(name: str, sign: float) -> Measured:
        """Along x of the lens, which is that of the columns, or y, against that of the rows."""
        names = fit.camera.parameter_names
        if name not in names or name not in own.parameter_names:
            return Measured(value=float("nan"))
        off = sign * pitch_mm * (own.value(name) - fit.camera.value(name))
        return Measured(value=off, uncertainty=pitch_mm * float(sigma[names.index(name)]))

    return replace(
        pose,
        decentre_x_mm=away("x0_px", 1.0),
        decentre_y_mm=away("y0_px", -1.0),
        focal_ratio=_focal(fit.camera) / _focal(own) * pitch_mm / fit.camera.geometry.pixel_pitch_mm,
    )


def _as_calibrated(instrument: Instrument, fit: CameraFit) -> CameraModel:
    """The camera model of the frames' order that stars behind a lens would give: a tilt shifts its principal point."""
    exact = camera_model(instrument)
    grid = exact.geometry.grid_px(15)
    stars = Observations(
        pixel_px=grid,
        covariance_px2=np.broadcast_to(1e-4 * np.eye(2), (len(grid), 2, 2)),
        direction=exact.unproject(grid),
        frame=np.zeros(len(grid), np.int64),
        frames=1,
        star=np.arange(len(grid)),
    )
    start = BrownConrady.create(exact.geometry, focal_length_mm=instrument.focal_length_mm)
    return calibrated(stars, start, fit.order).model


def _focal(camera: CameraModel) -> float:
    """Scale of a camera in its middle [mm]."""
    centre = camera.geometry.centre_px
    ray = camera.unproject(centre + np.array([[-50.0, 0.0], [50.0, 0.0]]))
    return float(100.0 * camera.geometry.pixel_pitch_mm / np.ptp(ray[:, 0] / ray[:, 2]))


def pose_of_widths(stated: Instrument, place_px: FloatArray, width_px: FloatArray) -> LensPose:
    """Focus and tilt from widths (n,) of Gaussian fits to stars at places (n, 2); the decentre is left open."""
    if len(width_px) < FEWEST_STARS:
        raise DomainError(f"{len(width_px)} bright stars; focus and tilt of a lens need {FEWEST_STARS}")
    pitch, light = stated.detector.pixel_pitch_mm, star_light([stated.passband()], nodes=4, magnitude_system="G")
    reach = REACH_DEPTHS * pitch * max(_f_number(stated), 1.0)
    steps = np.linspace(-reach, reach, STEPS)
    variance = []
    for step in steps:
        focus = float(stated.config.defocus_mm) + float(step)
        moved = build_instrument(stated.config.model_copy(update={"defocus_mm": focus, "diffraction": "rays"}))
        grid = render_psf_grid(moved, light, temperature_k=STAR_K, window_px=2 * WINDOW_PX, long_side=LONG_SIDE)
        variance.append(_widths(grid) ** 2)
    x, y = (np.unique(np.round(grid.place_px[:, k], 6)) for k in (0, 1))
    table = RegularGridInterpolator(
        (steps, y, x), np.log(np.reshape(variance, (STEPS, len(y), len(x)))), method="cubic", bounds_error=False
    )
    middle = np.array(stated.camera.centre_px)
    off = (place_px - middle) * pitch
    at = np.clip(place_px, [x[0], y[0]], [x[-1], y[-1]])

    def model(p: FloatArray) -> FloatArray:
        z = np.clip(p[0] + off @ p[1:3], -reach, reach)
        return 0.5 * np.log(np.exp(table(np.column_stack([z, at[:, 1], at[:, 0]]))) + p[3] ** 2)

    measured = np.log(width_px)
    half = np.abs(off).max()
    fits = []
    for start in np.linspace(-0.6, 0.6, 5) * reach:
        found = least_squares(
            lambda p: model(p) - measured,
            [start, 0.0, 0.0, 0.2],
            bounds=([-reach, *[-STEEPEST] * 2, 0.0], [reach, *[STEEPEST] * 2, 3.0]),
            x_scale=[0.1 * reach, 0.1 * reach / half, 0.1 * reach / half, 0.1],
            loss="soft_l1",
            f_scale=0.05,
        )
        fits.append(found)
    best = min(fits, key=lambda one: float(one.cost))
    left = measured - model(best.x)
    spread = 1.4826 * float(np.median(np.abs(left)))
    free = best.x[3] > 1e-3
    jacobian = best.jac if free else best.jac[:, :3]
    sigma = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian))) * spread
    sigma = sigma if free else np.append(sigma, 0.0)
    noise = best.cost * 2.0 / (len(measured) - 4)
    others = [
        one.x[0] for one in fits if one.cost - best.cost < 4.5 * noise and abs(one.x[0] - best.x[0]) > 0.1 * reach
    ]
    nothing = Measured(value=float("nan"))
    about = [-np.degrees(best.x[2]), -np.degrees(best.x[1])]
    return LensPose(
        stars=len(measured),
        defocus_mm=Measured(value=float(best.x[0]), uncertainty=float(sigma[0])),
        tilt_x_deg=Measured(value=float(about[0]), uncertainty=float(np.degrees(sigma[2]))),
        tilt_y_deg=Measured(value=float(about[1]), uncertainty=float(np.degrees(sigma[1]))),
        decentre_x_mm=nothing,
        decentre_y_mm=nothing,
        blur_px=Measured(value=float(best.x[3]), uncertainty=float(sigma[3])),
        focal_ratio=float("nan"),
        residual_percent=100.0 * spread,
        before_percent=100.0 * 1.4826 * float(np.median(np.abs(measured - model(np.zeros(4))))),
        other_focus=", ".join(f"{one:+.3f} mm" for one in others[:1]),
    )


def _f_number(sensor: Instrument) -> float:
    from optics.rays.paraxial import axial_paraxial

    lens = sensor.camera.focused_lens
    found = axial_paraxial(lens, lens.design_wavelength_nm)
    return float(abs(found.efl_mm) / (2.0 * found.entrance_pupil_radius_mm))


def _widths(grid: PsfGrid) -> FloatArray:
    """Widths (places,) [px] of Gaussian fits to PSFs, mean of all phases of the pixel."""
    out = []
    noise = NoiseModel(read_noise_e=5.0)
    fit = get_centroider("gaussian", fit_background=True)
    for psf in grid.psfs:
        fine, half = psf.oversampling, len(psf.values) // 2
        start = half - (WINDOW_PX // 2) * fine - fine // 2
        phases = [(i, j) for i in range(fine) for j in range(fine)]
        cut = [
            psf.values[start + i : start + i + WINDOW_PX * fine : fine, start + j : start + j + WINDOW_PX * fine : fine]
            for i, j in phases
        ]
        place = np.array([[fine // 2 - j, fine // 2 - i] for i, j in phases]) / fine + WINDOW_PX // 2
        count = len(cut)
        stamps = Stamps(
            electrons=3e4 * np.stack(cut) + 100.0,
            valid=np.ones((count, WINDOW_PX, WINDOW_PX), bool),
            corner_px=np.zeros((count, 2), np.int64),
            background_e=np.full(count, 100.0),
            start_px=place,
            flags=np.zeros(count, np.uint32),
            psf_index=np.zeros(count, np.int64),
        )
        out.append(float(np.nanmean(fit.measure(stamps, noise).width_px)))
    return np.array(out)


def write_prescription(file: Path, pose: LensPose, folder: Path) -> tuple[Path, ...]:
    """``glass.toml`` and ``glass_sensor.toml``: the lens of a sensor file with its detector where the frames put it."""
    from render.sensor_file.file import SensorFile, whole_sensor

    given = whole_sensor(file)
    config = SensorFile.model_validate(given)
    tables: dict[str, Any] = dict(read_lens_file(str(config.instrument.lens)).tables)
    image = dict(tables.get("image", {}))
    before = [*image.get("tilt_deg", [0.0, 0.0]), 0.0][:3]
    turn = Rotation.from_rotvec([pose.tilt_x_deg.value, pose.tilt_y_deg.value, 0.0], degrees=True)
    away = np.nan_to_num([pose.decentre_x_mm.value, pose.decentre_y_mm.value])
    moved = [*image.get("decentre_mm", [0.0, 0.0]), 0.0][:3]
    image["decentre_mm"] = [float(one) for one in np.add(moved, [*away, 0.0])]
    image["tilt_deg"] = [float(a + b) for a, b in zip(before, turn.as_euler("xyz", degrees=True), strict=True)]
    tables["image"] = image
    lens, sensor = folder / "glass.toml", folder / "glass_sensor.toml"
    lens.write_text(toml_lens(tables), encoding="utf-8")
    instrument = {**given["instrument"], "lens": lens.name}
    instrument["defocus_mm"] = float(config.instrument.defocus_mm) + pose.defocus_mm.value
    sensor.write_text(toml_lens(_without_none({**given, "instrument": instrument})), encoding="utf-8")
    return lens, sensor


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }
