"""The joint calibration: from images and readings to the camera, the star, the installation and the table's axes.

The inputs are the data of a laboratory: images with their covariance, readings with their noise, the assumed axes of
the table, poor start values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.turntable import TableErrors, TurntableAttitudes, star_direction
from calib.cameras import BrownConrady, CameraModel, SensorGeometry
from experiments.laboratory.devices.turntable import Turntable
from experiments.laboratory.single_star.bench import Bench
from experiments.laboratory.single_star.measure import Measurement
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD, RAD_ARCSEC
from render.sensor_file.instrument import Instrument

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
    """Input data from the laboratory."""

    pixel_px: FloatArray  # (n, 2) Mean images
    covariance_px2: FloatArray  # (n, 2, 2) Of the centroids alone
    reading_rad: FloatArray  # (n, k) Readings of the table

    @classmethod
    def of(cls, measurement: Measurement) -> Data:
        """Positions and readings of a rendered run."""
        return cls(
            pixel_px=np.array(measurement.readings.position_px),
            covariance_px2=np.array(measurement.readings.covariance_px2),
            reading_rad=np.array(measurement.visits.reading_rad),
        )


def start_model(instrument: Instrument, focal_length_mm: float | None) -> BrownConrady:
    """Start camera from a data sheet: no distortion, principal point in the centre, f rounded."""
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
    """Joint calibration (S100 of FISHER23) from data and belief."""
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


def calibrated_bench(calibration: Calibration, table: Turntable) -> Bench:
    """The bench as a calibration knows it."""
    solution = calibration.solution
    leans = [float(v) for n, v in zip(solution.names, solution.value, strict=True) if n.startswith("lean")]
    if leans:
        found = table.non_orthogonality_arcsec + np.array(leans) * RAD_ARCSEC
        table = replace(table, non_orthogonality_arcsec=found)
    assert calibration.installation is not None
    return Bench(table=table, star=star_direction(calibration), installation=calibration.installation)


def check_count(places: int, table: Turntable, *, advice: str = "raise grid.columns or grid.rows") -> None:
    """Refuse fewer measurements than unknowns, before anything is rendered; ``advice`` says what to do."""
    unknowns = 8 + POSE_UNKNOWNS + len(table.axis) - 1
    if 2 * places <= unknowns:
        raise DomainError(
            f"{places} places give {2 * places} measurements for {unknowns} unknowns (8 of the camera, 2 of the star, "
            f"3 of the installation, {len(table.axis) - 1} of the axes); {advice}"
        )


def check_parity(
    data: Data, table: Turntable, start: CameraModel, start_star: FloatArray, *, key: str = "reduction.axes"
) -> None:
    """Refuse axes that turn opposite to the assumption; ``key`` is its setting.

    The affine map from where the believed table puts the star to where it was seen keeps its orientation, with any
    camera at any roll, as long as the axes are right: a camera cannot mirror.
    """
    on_table = table.rotation(data.reading_rad).inv().apply(start_star)
    middle = on_table.mean(0) / np.linalg.norm(on_table.mean(0))
    across = np.linalg.svd(middle[None])[2][1:]
    across[1] *= np.sign(np.linalg.det(np.vstack([across, middle])))
    forward = on_table @ middle
    if np.any(forward <= 0):
        raise DomainError(
            f"with the assumed axes ({key}) the star would be behind the camera at some readings; check order and "
            f"signs of the axes"
        )
    design = np.column_stack([on_table @ across.T / forward[:, None], np.ones(len(on_table))])
    affine = np.linalg.lstsq(design, data.pixel_px, rcond=None)[0][:2]
    scale = start.value("focal_length_mm") / start.geometry.pixel_pitch_mm
    if np.linalg.det(affine) / scale**2 < 0:
        raise DomainError(
            "the images are mirrored against the readings: a single axis of the table has the wrong sign, or two "
            f"axes are exchanged; put a minus before a letter of {key}, or exchange its letters"
        )


def check_fit(calibration: Calibration, what: str, advice: str) -> None:
    """Refuse a calibration that did not converge or whose residuals are far above their noise."""
    solution = calibration.solution
    if not (solution.status in ("converged", "refuted") and solution.reduced_chi2 <= LARGEST_REDUCED_CHI2):
        raise DomainError(
            f"{what}: the calibration ended as {solution.status!r} with residuals of "
            f"{np.sqrt(solution.reduced_chi2):.3g} times their noise; {advice}"
        )
