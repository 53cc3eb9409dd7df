"""R_sp by a path of its own: CUBE09's equations written out, and what readings and errors do to it by differences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.cube_mirror import MirrorSolution, sensor_to_cube
from experiments.cube.noise import cube_matrix, sun_spots_px
from experiments.laboratory.plain_formulae import ARCSEC, acf_matrix, small_turn_rad, table_matrices, turn_matrix
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from experiments.cube.bench import Truth
    from experiments.cube.reduce import BenchResult
    from experiments.cube.sensor import SensorRun
    from experiments.cube.settings import Config

__all__ = ["covariance_off", "reading_effect_arcsec", "written_out_off_arcsec"]


TURNS_DEG = ((35.0, -50.0, 110.0), (-20.0, 70.0, 40.0))
"""Angles of a sensor and of a cube that stand askew, so that no matrix is its own transpose."""
SPREAD_ARCSEC = (1.0, 3.0, 0.3)


def reading_effect_arcsec(outer_arcsec: float, inner_arcsec: float) -> FloatArray:
    """Standard deviation (3,) of R_pr about x, y, z of the cube by the readings of both faces, from differences."""
    outer, inner, step = np.zeros(2), np.radians([180.0, 90.0]), 1e-6
    start, total = cube_matrix(outer, inner), np.zeros(3)
    for face in np.eye(2):
        for moved, sigma in (
            (cube_matrix(outer + step * face, inner), outer_arcsec),
            (cube_matrix(outer, inner + step * face), inner_arcsec),
        ):
            total += (small_turn_rad(moved @ start.T) / step * sigma) ** 2
    return np.asarray(np.sqrt(total))


def covariance_off() -> float:
    """Covariance of R_sp by an uneven one of R_sr against differences, largest part of its largest element."""
    sensor, cube = (acf_matrix(*np.radians(angles)) for angles in TURNS_DEG)
    none = MirrorSolution(rotation=Rotation.from_matrix(cube), covariance_rad2=np.zeros((3, 3)), face_angle_rad=1.0)
    stated = sensor_to_cube(none, Rotation.from_matrix(sensor), np.diag(np.square(SPREAD_ARCSEC)))[1]
    step, found = 1e-6, np.zeros((3, 3))
    for axis, sigma in zip(np.eye(3), SPREAD_ARCSEC, strict=True):
        moved = cube @ (turn_matrix(axis, step) @ sensor).T  # R_pr R_sr^-1
        effect = small_turn_rad(moved @ (cube @ sensor.T).T) / step * sigma
        found += np.outer(effect, effect)
    return float(np.abs(stated - found).max() / np.abs(found).max())


def written_out_off_arcsec(config: Config, truth: Truth, result: BenchResult, run: SensorRun) -> float:
    """Error of R_sp from readings and spots by written-out equations, less the one reported, largest component.

    For faces taken as concentric; NaN for Wahba's problem, which has no equation of its own in CUBE09.
    """
    if config.cube.method != "triad":
        return float("nan")
    first = config.cube.faces[0]
    normals = []
    for own in (True, False):
        readings = np.array([t.reading_rad for t in result.trims if (t.face == first) == own])
        mean = table_matrices("xy", readings, [0.0])[:, 2, :].mean(0)
        sign = -1.0 if not own and any(t.face == "-X" for t in result.trims) else 1.0
        normals.append(sign * mean / np.sqrt(mean @ mean))
    found = _frame(*normals) @ _written_out_sensor(truth, result, run).T
    second = "-X" if any(t.face == "-X" for t in result.trims) else "+X"
    sides = truth.normal_in_table(first), truth.normal_in_table(second) * (-1.0 if second == "-X" else 1.0)
    true = _frame(*sides) @ np.asarray(truth.sensor_from_table).T
    return float(np.abs(small_turn_rad(found @ true.T) / ARCSEC - result.error_arcsec).max())


def _frame(first: FloatArray, second: FloatArray) -> FloatArray:
    """Rows X, Y, Z of the cube (ECSS): Z the first normal, X the part of the second that is square to it."""
    across = second - (second @ first) * first
    across = across / np.sqrt(across @ across)
    return np.array([across, np.cross(first, across), first])


def _written_out_sensor(truth: Truth, result: BenchResult, run: SensorRun) -> FloatArray:
    """R_sr (3, 3) by Gauss and Newton on the spots, pinhole, beam along Z, axes square; derivatives by differences."""
    mask, sensor = truth.sensor, result.sensor
    middle = np.array([mask.width_px - 1, mask.height_px - 1]) / 2
    per_rad = sensor.focal_length_mm / mask.pitch_mm
    turn, foot, scale, step = np.eye(3), np.array(sensor.offset_px), 0.0, 1e-5
    for _ in range(6):
        values = np.array([*foot, scale, 0.0, 0.0, 0.0, 0.0])

        def spots(values: FloatArray, about: FloatArray = turn) -> FloatArray:
            return sun_spots_px(values, sensor.reading_rad, per_rad, about)

        jacobian = np.stack(
            [(spots(values + step * one) - spots(values - step * one)) / (2 * step) for one in np.eye(7)[:6]], axis=-1
        )
        left = run.pixel_px - middle - spots(values)
        move = np.linalg.lstsq(jacobian.reshape(-1, 6), left.ravel(), rcond=None)[0]
        foot, scale = foot + move[:2], scale + move[2]
        for axis, part in zip(np.eye(3), move[3:], strict=True):
            turn = turn_matrix(axis, part) @ turn
    return turn
