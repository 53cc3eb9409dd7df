"""From what was read and measured on a bench to R_sp, and how far it is from the truth (CUBE09, steps 4 and 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.cube_mirror import (
    MirrorSolution,
    cube_from_table,
    normal_of_offset,
    rotation_error_rad,
    sensor_to_cube,
)
from experiments.cube.bench import Laboratory, Truth, nominal_normal
from experiments.cube.sensor import SensorCalibration
from experiments.cube.settings import Config
from experiments.cube.trim import FaceTrim
from experiments.laboratory.turntable import Turntable
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, RAD_ARCSEC

__all__ = ["BenchResult", "measured_normal", "reduce_bench"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchResult:
    """One bench in one case."""

    error_arcsec: FloatArray  # (3,) R_sp against the truth: rotation vector in the cube frame
    cube_error_arcsec: FloatArray  # (3,) What R_pr and R_sr contribute, both turned into the cube frame
    sensor_error_arcsec: FloatArray  # (3,) What R_pr and R_sr contribute, both turned into the cube frame
    sigma_arcsec: FloatArray  # (3,) Standard deviations that the fits state: pictures and spots, nothing else
    # (3,) Part of the sun sensor in that, and of the table's axes where they are fitted with it
    sensor_sigma_arcsec: FloatArray
    face_angle_rad: float  # Between the first two faces
    true_face_angle_rad: float  # Between the first two faces
    trims: tuple[FaceTrim, ...]  # Face by face, repeat by repeat
    sensor: SensorCalibration  # R_sr


def measured_normal(
    table: Turntable, reading_rad: FloatArray, offset_mm: FloatArray | None, distance_mm: float
) -> FloatArray:
    """Normal in the table frame (3,) from the angles that were read."""
    normal = normal_of_offset(np.zeros(2) if offset_mm is None else offset_mm, distance_mm)
    return np.asarray(table.rotation(reading_rad[None])[0].inv().apply(normal))


def solve_cube(
    config: Config, truth: Truth, names: Sequence[str], normals: FloatArray, covariance: FloatArray
) -> MirrorSolution:
    """R_pr; Wahba's problem gets the cube's certificate (its true normals), TRIAD needs none."""
    certificate = config.cube.method == "wahba"
    order = config.cube.faces
    known = [truth.normal_in_cube(n, order) if certificate else nominal_normal(n) for n in names]
    return cube_from_table(known, normals, covariance_rad2=covariance, method=config.cube.method)


def reduce_bench(
    laboratory: Laboratory,
    truth: Truth,
    table: Turntable,
    trims: Sequence[FaceTrim],
    sensor: SensorCalibration,
    *,
    improved: bool,
) -> BenchResult:
    """R_sp of a bench and its error."""
    config, geometry = laboratory.config, laboratory.geometry
    known = replace(table.nominal, non_orthogonality_arcsec=np.array([sensor.lean_rad * RAD_ARCSEC]))
    normals, spreads = [], []
    for trim in trims:
        offset = trim.own.offset_px * laboratory.pitch_mm if improved else None
        normals.append(measured_normal(known, trim.reading_rad, offset, geometry.distance_mm))
        pictures = trim.own if improved else trim.offset
        spreads.append(_normal_covariance(known, trim, pictures.covariance_px2 * laboratory.tilt_per_px**2))
    cube = solve_cube(config, truth, [trim.face for trim in trims], np.array(normals), np.array(spreads))
    rotation, covariance = sensor_to_cube(cube, sensor.rotation, sensor.covariance_rad2)
    if sensor.lean_sigma_rad > 0:
        covariance = covariance + _lean_covariance(config, truth, known, trims, cube, rotation, sensor)
    true_cube = Rotation.from_matrix(truth.cube_from_table(config.cube.faces))
    true_sensor = Rotation.from_matrix(truth.sensor_from_table)
    sensor_part = rotation_error_rad(sensor.rotation, true_sensor)
    first, second = (truth.normal_in_table(trims[i].face) for i in (0, config.cube.repeats))
    return BenchResult(
        error_arcsec=rotation_error_rad(rotation, true_cube * true_sensor.inv()) * RAD_ARCSEC,
        cube_error_arcsec=rotation_error_rad(cube.rotation, true_cube) * RAD_ARCSEC,
        sensor_error_arcsec=-(true_cube * true_sensor.inv()).apply(sensor_part) * RAD_ARCSEC,
        sigma_arcsec=np.sqrt(np.diag(covariance)) * RAD_ARCSEC,
        sensor_sigma_arcsec=np.sqrt(np.diag(covariance - cube.covariance_rad2)) * RAD_ARCSEC,
        face_angle_rad=cube.face_angle_rad,
        true_face_angle_rad=float(np.arccos(first @ second)),
        trims=tuple(trims),
        sensor=sensor,
    )


def _lean_covariance(
    config: Config,
    truth: Truth,
    known: Turntable,
    trims: Sequence[FaceTrim],
    cube: MirrorSolution,
    rotation: Rotation,
    sensor: SensorCalibration,
) -> FloatArray:
    """What the error of the fitted non-orthogonality adds to the covariance of R_sp (3, 3).

    e = J dl - R e_s, with J how R_pr moves with the lean (a difference quotient) and e_s the error of R_sr.
    """
    step = 1.0
    moved = replace(known, non_orthogonality_arcsec=known.non_orthogonality_arcsec + step)
    names = [trim.face for trim in trims]
    normals = [moved.rotation(t.reading_rad[None])[0].inv().apply([0.0, 0.0, 1.0]) for t in trims]
    before = [known.rotation(t.reading_rad[None])[0].inv().apply([0.0, 0.0, 1.0]) for t in trims]
    spread = np.zeros((len(trims), 3, 3))
    pair = [solve_cube(config, truth, names, np.array(n), spread).rotation for n in (normals, before)]
    rate = rotation_error_rad(*pair) / (step * ARCSEC_RAD)
    cross = np.outer(rate, rotation.as_matrix() @ sensor.lean_cross_rad2)
    return np.asarray(np.outer(rate, rate) * sensor.lean_sigma_rad**2 - cross - cross.T)


def _normal_covariance(table: Turntable, trim: FaceTrim, covariance_rad2: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a measured normal from its circle fits, table frame."""
    spread = np.zeros((3, 3))
    spread[:2, :2] = covariance_rad2
    turn = table.rotation(trim.reading_rad[None])[0].inv().as_matrix()
    return np.asarray(turn @ spread @ turn.T)
