"""All benches in all cases: pictures rendered and read out, R_sp from the measured values.

Reduction as in CUBE09, steps 4 and 5: normals of the faces from the angles of the table, R_pr from them, R_sp = R_pr
R_sr^-1, and its error against the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.attitude.triad import angle_between_rad
from calib.calibration.cube_mirror import (
    MirrorSolution,
    cube_from_table,
    lean_covariance,
    normal_covariance,
    normal_in_table,
    normal_of_offset,
    rotation_error_rad,
    sensor_to_cube,
)
from calib.calibration.mask_sensor import MaskSensorCalibration
from calib.calibration.table_axes import TableAxes
from experiments.cube.bench import CubeCase, CubeLaboratory, TrueBench, build_table, nominal_normal
from experiments.cube.sensor import SensorRun, calibrate_sensor, observe_spots
from experiments.cube.settings import CubeMirrorConfig
from experiments.cube.trim import FaceTrim, trim_face
from experiments.harness.progress import Progress
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, RAD_ARCSEC

CASES = (
    CubeCase(name="pixel", label="adjustment error of one pixel (eq. 13)", aim_px=1.0),
    CubeCase(name="trim", label="stopping criterion", coarse=True),
    CubeCase(name="square", label="non-orthogonal axes", non_orthogonal=True),
    CubeCase(name="mounting", label="camera mount", mounting=True),
    CubeCase(name="reading", label="angle reading", reading=True),
    CubeCase(name="all", label="all of eq. 14", aim_px=1.0, non_orthogonal=True, mounting=True, reading=True),
    CubeCase(name="procedure", label="as performed", coarse=True, non_orthogonal=True, mounting=True, reading=True),
    CubeCase(
        name="improved",
        label="improved reduction",
        coarse=True,
        non_orthogonal=True,
        mounting=True,
        reading=True,
        improved=True,
        pictures_of="procedure",
    ),
)
"""Single terms, all terms as eq. 14 adds them, the procedure with its stopping criterion, and an improved reduction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchResult:
    """A bench in a case; errors are rotation vectors in the cube frame."""

    error_arcsec: FloatArray  # (3,) Error of R_sp: rotation vector in the cube frame
    cube_error_arcsec: FloatArray  # (3,) Contribution of R_pr
    sensor_error_arcsec: FloatArray  # (3,) Contribution of R_sr
    # (3,) Standard deviation of the contribution of R_sr, stated by the fit, with that of a fitted non-orthogonality
    sensor_sigma_arcsec: FloatArray
    face_angle_rad: float  # Between the first two faces, measured
    true_face_angle_rad: float
    trims: tuple[FaceTrim, ...]  # Face by face, repeat by repeat
    sensor: MaskSensorCalibration  # R_sr


def solve_cube(
    config: CubeMirrorConfig, truth: TrueBench, names: Sequence[str], normals: FloatArray, covariance: FloatArray
) -> MirrorSolution:
    """R_pr; Wahba's problem gets the cube's certificate (its true normals), TRIAD needs none."""
    certificate = config.cube.method == "wahba"
    faces = config.cube.faces
    reference = [truth.normal_in_cube(n, faces) if certificate else nominal_normal(n) for n in names]
    return cube_from_table(reference, normals, covariance_rad2=covariance, method=config.cube.method)


def reduce_bench(
    laboratory: CubeLaboratory,
    truth: TrueBench,
    table: Turntable,
    trims: Sequence[FaceTrim],
    sensor: MaskSensorCalibration,
    *,
    improved: bool,
) -> BenchResult:
    """R_sp of a bench and its error."""
    config = laboratory.config
    fitted_table = replace(table.nominal, non_orthogonality_arcsec=np.array([sensor.lean_rad * RAD_ARCSEC]))
    normals, covariances = [], []
    for trim in trims:
        offset = trim.one_picture_offset if improved else trim.offset
        offset_mm = offset.offset_px * laboratory.pitch_mm if improved else np.zeros(2)
        normal = normal_of_offset(offset_mm, laboratory.geometry.distance_mm)
        normals.append(normal_in_table(fitted_table, trim.reading_rad, normal))
        tilt_rad2 = offset.covariance_px2 * laboratory.tilt_per_px**2
        covariances.append(normal_covariance(fitted_table, trim.reading_rad, tilt_rad2))
    cube = solve_cube(config, truth, [trim.face for trim in trims], np.array(normals), np.array(covariances))
    rotation, covariance = sensor_to_cube(cube, sensor.rotation, sensor.covariance_rad2)
    if sensor.lean_sigma_rad > 0:
        rate = _non_orthogonality_rate(config, truth, fitted_table, trims)
        covariance = covariance + lean_covariance(rate, rotation, sensor.lean_sigma_rad, sensor.lean_cross_rad2)
    true_cube = Rotation.from_matrix(truth.cube_from_table(config.cube.faces))
    true_sensor = Rotation.from_matrix(truth.sensor_from_table)
    true_rotation = true_cube * true_sensor.inv()
    sensor_error_rad = rotation_error_rad(sensor.rotation, true_sensor)
    first, second = (truth.normal_in_table(trims[i].face) for i in (0, config.cube.repeats))
    return BenchResult(
        error_arcsec=rotation_error_rad(rotation, true_rotation) * RAD_ARCSEC,
        cube_error_arcsec=rotation_error_rad(cube.rotation, true_cube) * RAD_ARCSEC,
        sensor_error_arcsec=-true_rotation.apply(sensor_error_rad) * RAD_ARCSEC,
        sensor_sigma_arcsec=np.sqrt(np.diag(covariance - cube.covariance_rad2)) * RAD_ARCSEC,
        face_angle_rad=cube.face_angle_rad,
        true_face_angle_rad=angle_between_rad(first, second),
        trims=tuple(trims),
        sensor=sensor,
    )


def _non_orthogonality_rate(
    config: CubeMirrorConfig, truth: TrueBench, table: TableAxes, trims: Sequence[FaceTrim]
) -> FloatArray:
    """Difference quotient (3,) of R_pr by the fitted non-orthogonality [rad/rad]."""
    step_arcsec = 1.0
    stepped = replace(table, non_orthogonality_arcsec=table.non_orthogonality_arcsec + step_arcsec)
    names = [trim.face for trim in trims]
    no_covariance = np.zeros((len(trims), 3, 3))

    def cube(axes: TableAxes) -> Rotation:
        normals = np.array([normal_in_table(axes, trim.reading_rad) for trim in trims])
        return solve_cube(config, truth, names, normals, no_covariance).rotation

    return rotation_error_rad(cube(stepped), cube(table)) / (step_arcsec * ARCSEC_RAD)


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseResult:
    """All benches in a case."""

    case: CubeCase
    bench: tuple[BenchResult, ...]

    @property
    def error_arcsec(self) -> FloatArray:
        """Errors of R_sp (n, 3)."""
        return np.array([bench.error_arcsec for bench in self.bench])

    @property
    def rms_arcsec(self) -> FloatArray:
        """1 sigma per axis (3,): root of the mean square about zero, which includes a bias."""
        return np.asarray(np.sqrt(np.mean(self.error_arcsec**2, axis=0)))

    @property
    def mean_arcsec(self) -> tuple[FloatArray, FloatArray]:
        """Mean error per axis (3,) and its standard deviation (3,)."""
        return _mean(self.error_arcsec)

    @property
    def sensor_mean_arcsec(self) -> tuple[FloatArray, FloatArray]:
        """Mean contribution of R_sr (3,), and its standard deviation (3,)."""
        return _mean(np.array([bench.sensor_error_arcsec for bench in self.bench]))

    @property
    def sensor_rms_pull(self) -> FloatArray:
        """RMS of the errors of R_sr over their stated standard deviations (3,)."""
        pulls = [bench.sensor_error_arcsec / bench.sensor_sigma_arcsec for bench in self.bench]
        return np.asarray(np.sqrt(np.mean(np.square(pulls), axis=0)))

    @property
    def sensor_rms_arcsec(self) -> FloatArray:
        """RMS contribution of R_sr (3,)."""
        return np.asarray(np.sqrt(np.mean([bench.sensor_error_arcsec**2 for bench in self.bench], axis=0)))

    @property
    def trims(self) -> FloatArray:
        """Settings of the table per face, all benches."""
        return np.array([len(trim.rows) for bench in self.bench for trim in bench.trims])


def _mean(error: FloatArray) -> tuple[FloatArray, FloatArray]:
    return error.mean(0), error.std(0, ddof=1) / np.sqrt(len(error))


class SensorCache:
    """Spots and calibrations of the sun sensor of a bench.

    The spots depend on the axes of the table, not on the angle readings: a run serves all cases with the same axes, a
    calibration all cases with the same axes, readings and fit.
    """

    def __init__(self) -> None:
        self.runs: dict[bool, SensorRun] = {}
        self.calibrations: dict[tuple[bool, bool, bool], MaskSensorCalibration] = {}


def _sensor(
    laboratory: CubeLaboratory, truth: TrueBench, case: CubeCase, table: Turntable, cache: SensorCache
) -> MaskSensorCalibration:
    """Calibration of the sun sensor for a case, from the cache where it depends on nothing that the case changes."""
    streams = laboratory.streams.child("bench", truth.number)
    axes = case.non_orthogonal
    if axes not in cache.runs:
        without_reading_noise = build_table(laboratory.config, truth, CubeCase(name="", label="", non_orthogonal=axes))
        spots = streams.child("spots", int(axes))
        cache.runs[axes] = observe_spots(laboratory, truth, without_reading_noise, spots)
    key = (axes, case.reading, case.improved)
    if key not in cache.calibrations:
        readings = streams.child("readings")
        cache.calibrations[key] = calibrate_sensor(
            laboratory, truth, table, cache.runs[axes], readings, fit_non_orthogonality=case.improved
        )
    return cache.calibrations[key]


def run_bench(
    laboratory: CubeLaboratory,
    truth: TrueBench,
    case: CubeCase,
    cache: SensorCache,
    *,
    log2_particles: int,
    keep_pictures: bool = False,
    trims: Sequence[FaceTrim] = (),
) -> BenchResult:
    """Steps 1 to 5 on a bench; ``trims`` of the case `CubeCase.pictures_of`."""
    table = build_table(laboratory.config, truth, case)
    streams = laboratory.streams.child("bench", truth.number)
    sensor = _sensor(laboratory, truth, case, table, cache)
    if not case.pictures_of:
        trims = [
            trim_face(
                laboratory,
                truth,
                case,
                table,
                face,
                repeat,
                streams=streams.child(case.name, face, repeat),
                log2_particles=log2_particles,
                keep_pictures=keep_pictures,
            )
            for face in range(len(laboratory.config.cube.faces))
            for repeat in range(laboratory.config.cube.repeats)
        ]
    return reduce_bench(laboratory, truth, table, trims, sensor, improved=case.improved)


def run_cases(
    laboratory: CubeLaboratory, truths: Sequence[TrueBench], cases: Sequence[CubeCase], progress: Progress
) -> dict[str, CaseResult]:
    """Every bench in every case."""
    results: dict[str, list[BenchResult]] = {case.name: [] for case in cases}
    particles = laboratory.config.benches.log2_particles
    for truth in progress.track(truths, "benches"):
        cache = SensorCache()
        for case in cases:
            trims = results[case.pictures_of][-1].trims if case.pictures_of else ()
            results[case.name].append(run_bench(laboratory, truth, case, cache, log2_particles=particles, trims=trims))
    return {case.name: CaseResult(case=case, bench=tuple(results[case.name])) for case in cases}
