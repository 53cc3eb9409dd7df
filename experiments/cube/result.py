"""What a run of the cube-mirror experiment gives back, and what follows from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.calibration.cube_mirror import pixel_angle_rad
from experiments.cube.bench import Laboratory, Truth, build_table
from experiments.cube.budget import BudgetRow
from experiments.cube.checks import reflected_spot_mm
from experiments.cube.montecarlo import CaseResult
from experiments.cube.noise import PictureNoise
from experiments.cube.reduce import BenchResult
from experiments.cube.sensor import SensorRun
from experiments.cube.settings import Config
from experiments.cube.verify import LightCheck, Repeatability
from optics.arrays import FloatArray
from optics.units import DEG_RAD, RAD_ARCSEC
from render.bench.scene import CubePose

__all__ = ["Result", "eq14_arcsec", "offset_errors_px", "sensor_error_arcsec", "sigma1_arcsec"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A run."""

    config: Config  # Settings
    laboratory: Laboratory  # The rendered bench
    truths: Sequence[Truth]  # The benches
    shown: BenchResult  # The first bench, as performed, with its pictures, traced with more particles
    shown_run: SensorRun  # Spots of its sun sensor
    cases: Mapping[str, CaseResult]  # Case name -> results of all benches
    budget: Sequence[BudgetRow]  # Prediction beside measurement
    lean_rate: FloatArray  # (3,) Error of R_sp per unit of the axes' non-orthogonality
    beam_rate: FloatArray  # (3, 2) Error of R_sp per unit of the beam's direction off the table's Z axis
    light: LightCheck  # Rendered light against closed forms
    repeatability: Repeatability  # Noise of the pictures, measured
    picture_noise: PictureNoise  # The same, predicted
    # (bodies, beam) Pictures of the bench, radiances (h, w)
    views: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]

    def row(self, name: str) -> BudgetRow:
        """A line of the budget."""
        return next(row for row in self.budget if row.name == name)


def sigma1_arcsec(result: Result) -> float:
    """Eq. 13 with the right units."""
    laboratory = result.laboratory
    return pixel_angle_rad(laboratory.pitch_mm, laboratory.geometry.distance_mm) * RAD_ARCSEC


def eq14_arcsec(result: Result) -> float:
    """Eq. 14 with the terms of this configuration."""
    config = result.config
    terms = (sigma1_arcsec(result), config.table.square_arcsec, config.camera.mounting_arcsec)
    return float(np.linalg.norm([*terms, config.table.inner_reading_arcsec]))


def offset_errors_px(result: Result) -> FloatArray:
    """Measured offset less the true one, where the faces of the shown bench were left (faces, 2).

    The true one is where the law of reflection puts the middle of the spot, on the table as it is built.
    """
    laboratory, truth = result.laboratory, result.truths[0]
    table = build_table(result.config, truth, result.cases["procedure"].case)
    errors = []
    for trim in result.shown.trims:
        angle = np.array([trim.rows[-1].outer_deg, trim.rows[-1].inner_deg]) * DEG_RAD
        top = table.rotation(angle[None])[0].as_matrix()
        pose = CubePose.of_table(laboratory.geometry, top, truth.table_from_cube, truth.normal)
        true_px = reflected_spot_mm(laboratory.geometry, pose, trim.face) / laboratory.pitch_mm
        errors.append(trim.own.offset_px - true_px)
    return np.array(errors)


def sensor_error_arcsec(result: Result) -> FloatArray:
    """Error of R_sr of the shown bench, in the sensor frame (3,)."""
    true = Rotation.from_matrix(result.truths[0].sensor_from_table)
    return np.asarray((result.shown.sensor.rotation * true.inv()).as_rotvec() * RAD_ARCSEC)
