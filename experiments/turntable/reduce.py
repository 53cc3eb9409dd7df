"""The reduction: from images and readings to the camera, the star, the installation and the table's axes.

What goes in is what a laboratory has: images with their covariance, readings with their noise, the axes of the table as
believed, a poor start. What comes out is set against the traced lens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.turntable import TableErrors, TurntableAttitudes, star_direction
from calib.cameras import BrownConrady, CameraModel, SensorGeometry
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.turntable import Turntable
from experiments.turntable.measure import TracedMap
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD, RAD_ARCSEC

__all__ = ["Data", "Reduction", "check_count", "check_fit", "check_parity", "judge", "reduce_data", "start_model"]


START_ROUNDING = 0.05
"""A start focal length is the paraxial one rounded to this part of it."""
READING_FLOOR_ARCSEC = 1e-4
"""Readings better than this count as exact."""
AHEAD = np.array([0.0, 0.0, 1.0])
LARGEST_REDUCED_CHI2 = 25.0
"""Residuals of five times their noise on average: no confident answer."""
POSE_UNKNOWNS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Data:
    """What the laboratory hands over.

    Attributes
    ----------
    pixel_px : (n, 2)
        Mean images.
    covariance_px2 : (n, 2, 2)
        Of the centroids alone.
    reading_rad : (n, k)
        Readings of the table.
    """

    pixel_px: FloatArray
    covariance_px2: FloatArray
    reading_rad: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduction:
    """One calibration, judged.

    Attributes
    ----------
    calibration : Calibration
        As the estimator gives it.
    star : (3,)
        Direction of the star in the laboratory.
    line_of_sight : LineOfSightMap
        Error against the traced lens after the best rotation, and what the covariance predicts.
    residual_px : (n, 2)
        Images minus what the calibration says at the angles as read, before any reading error is fitted.
    """

    calibration: Calibration
    star: FloatArray
    line_of_sight: LineOfSightMap
    residual_px: FloatArray

    def value(self, name: str) -> float:
        """One unknown."""
        return float(self.calibration.solution.value[self.calibration.solution.index(name)])

    def sigma(self, name: str) -> float:
        """Its standard deviation."""
        return float(self.calibration.solution.sigma[self.calibration.solution.index(name)])


def start_model(instrument: Instrument, focal_length_mm: float | None) -> BrownConrady:
    """A camera as poor as a data sheet makes it: no distortion, principal point in the centre, f rounded."""
    camera = instrument.camera
    step = START_ROUNDING * instrument.focal_length_mm
    rounded = step * np.floor(instrument.focal_length_mm / step - 0.5)
    geometry = SensorGeometry(
        width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm
    )
    return BrownConrady.create(geometry, focal_length_mm=float(rounded if focal_length_mm is None else focal_length_mm))


def reduce_data(
    data: Data,
    table: Turntable,
    start: CameraModel,
    *,
    leans: bool,
    start_star: FloatArray | None = None,
) -> Calibration:
    """Joint calibration (S100 of FISHER23) from data and belief.

    Parameters
    ----------
    data : Data
        Images and readings.
    table : Turntable
        As believed: axes, leans if they are known, reading noise.
    start : CameraModel
        Start of the camera; the installation starts by Wahba's problem.
    leans : bool
        Whether the non-orthogonality is an unknown, counted from what ``table`` holds.
    start_star : (3,), optional
        Start of the star's direction; at zero angles if left out.
    """
    count = len(data.pixel_px)
    observations = Observations(
        pixel_px=data.pixel_px,
        covariance_px2=data.covariance_px2,
        direction=np.tile(AHEAD if start_star is None else start_star, (count, 1)),
        frame=np.arange(count),
        frames=count,
    )
    sigma = table.reading_noise_arcsec * ARCSEC_RAD
    noisy = table.reading_noise_arcsec > READING_FLOOR_ARCSEC
    errors = TableErrors(reading_rate=table.angle_rates(data.reading_rad)[:, noisy], reading_sigma_rad=sigma[noisy])
    if leans:
        names = tuple(f"lean{i + 1}_rad" for i in range(len(table.axis) - 1))
        errors = replace(errors, axis_rate=table.lean_rates(data.reading_rad), axis_names=names, axis_sigma_rad=None)
    family = TurntableAttitudes(table_rotation=table.rotation(data.reading_rad), errors=errors)
    return calibrate(observations, start, family)


def judge(calibration: Calibration, data: Data, table: Turntable, traced: TracedMap) -> Reduction:
    """Set a calibration against the traced lens."""
    star = star_direction(calibration)
    names = calibration.solution.names
    leans = [calibration.solution.value[names.index(n)] for n in names if n.startswith("lean")]
    if leans:
        table = replace(table, non_orthogonality_arcsec=table.non_orthogonality_arcsec + np.array(leans) * RAD_ARCSEC)
    assert calibration.installation is not None
    seen = calibration.installation.apply(table.rotation(data.reading_rad).inv().apply(star.copy()))
    return Reduction(
        calibration=calibration,
        star=star,
        line_of_sight=line_of_sight_map(
            calibration.model, traced.direction.copy(), traced.pixel_px, covariance=calibration.covariance
        ),
        residual_px=data.pixel_px - calibration.model.project(seen),
    )


def check_count(places: int, table: Turntable) -> None:
    """Refuse fewer measurements than unknowns, before anything is rendered.

    Raises
    ------
    DomainError
        With both numbers.
    """
    unknowns = 8 + POSE_UNKNOWNS + len(table.axis) - 1
    if 2 * places <= unknowns:
        raise DomainError(
            f"{places} places give {2 * places} measurements for {unknowns} unknowns (8 of the camera, 2 of the star, "
            f"3 of the installation, {len(table.axis) - 1} of the axes); raise grid.columns or grid.rows"
        )


def check_parity(data: Data, table: Turntable, start: CameraModel, start_star: FloatArray) -> None:
    """Refuse axes that turn the other way than believed.

    The affine map from where the believed table puts the star to where it was seen keeps its orientation, whatever the
    camera and its roll, as long as the axes are right: a camera cannot mirror.

    Raises
    ------
    DomainError
        If the map mirrors, or the star would stand behind the camera.
    """
    on_table = table.rotation(data.reading_rad).inv().apply(start_star)
    middle = on_table.mean(0) / np.linalg.norm(on_table.mean(0))
    across = np.linalg.svd(middle[None])[2][1:]
    across[1] *= np.sign(np.linalg.det(np.vstack([across, middle])))
    forward = on_table @ middle
    if np.any(forward <= 0):
        raise DomainError(
            "with the axes as believed (reduction.axes) the star would stand behind the camera at some readings; look "
            "at the order and the sense of the axes"
        )
    design = np.column_stack([on_table @ across.T / forward[:, None], np.ones(len(on_table))])
    affine = np.linalg.lstsq(design, data.pixel_px, rcond=None)[0][:2]
    scale = start.value("focal_length_mm") / start.geometry.pixel_pitch_mm
    if np.linalg.det(affine) / scale**2 < 0:
        raise DomainError(
            "the images are mirrored against the readings: one axis of the table turns the other way than believed; "
            "put a minus before one letter of reduction.axes, or exchange its letters"
        )


def check_fit(calibration: Calibration, what: str) -> None:
    """Refuse a calibration that did not converge or whose residuals are far above their noise.

    Raises
    ------
    DomainError
        With the state of the fit, and what to look at.
    """
    solution = calibration.solution
    if solution.converged and solution.reduced_chi2 <= LARGEST_REDUCED_CHI2:
        return
    raise DomainError(
        f"{what}: the calibration ended as {solution.status!r} with residuals of {np.sqrt(solution.reduced_chi2):.3g} "
        "times their noise; the axes (reduction.axes), the start of the star (reduction.star_deg), the reading noise "
        "or the camera model are wrong, or too little of the field is visited"
    )
