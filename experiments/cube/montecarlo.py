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
from experiments.cube.bench import Case, Laboratory, Truth, build_table, nominal_normal
from experiments.cube.sensor import SensorRun, calibrate_sensor, observe_spots
from experiments.cube.settings import Config
from experiments.cube.trim import FaceTrim, trim_face
from experiments.harness.progress import Progress
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, RAD_ARCSEC

CASES = (
    Case(name="pixel", label="trim error of one pixel (eq. 13)", aim_px=1.0),
    Case(name="trim", label="stop rule", coarse=True),
    Case(name="square", label="non-orthogonal axes", lean=True),
    Case(name="mounting", label="camera mount", mounting=True),
    Case(name="reading", label="angle reading", reading=True),
    Case(name="all", label="all of eq. 14", aim_px=1.0, lean=True, mounting=True, reading=True),
    Case(name="procedure", label="as performed", coarse=True, lean=True, mounting=True, reading=True),
    Case(
        name="improved",
        label="improved reduction",
        coarse=True,
        lean=True,
        mounting=True,
        reading=True,
        improved=True,
        pictures_of="procedure",
    ),
)
"""Terms alone, all of them as eq. 14 adds them, the procedure with its stop rule, and what would be better."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchResult:
    """One bench in one case."""

    error_arcsec: FloatArray  # (3,) R_sp against the truth: rotation vector in the cube frame
    cube_error_arcsec: FloatArray  # (3,) What R_pr contributes
    sensor_error_arcsec: FloatArray  # (3,) What R_sr contributes, in the cube frame
    # (3,) Part of the sun sensor in that, and of the table's axes where they are fitted with it
    sensor_sigma_arcsec: FloatArray
    face_angle_rad: float  # Between the first two faces, measured
    true_face_angle_rad: float
    trims: tuple[FaceTrim, ...]  # Face by face, repeat by repeat
    sensor: MaskSensorCalibration  # R_sr


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
    sensor: MaskSensorCalibration,
    *,
    improved: bool,
) -> BenchResult:
    """R_sp of a bench and its error."""
    config, geometry = laboratory.config, laboratory.geometry
    known = replace(table.nominal, non_orthogonality_arcsec=np.array([sensor.lean_rad * RAD_ARCSEC]))
    normals, spreads = [], []
    for trim in trims:
        offset_mm = trim.own.offset_px * laboratory.pitch_mm if improved else np.zeros(2)
        normals.append(normal_in_table(known, trim.reading_rad, normal_of_offset(offset_mm, geometry.distance_mm)))
        pictures = trim.own if improved else trim.offset
        tilts = pictures.covariance_px2 * laboratory.tilt_per_px**2
        spreads.append(normal_covariance(known, trim.reading_rad, tilts))
    cube = solve_cube(config, truth, [trim.face for trim in trims], np.array(normals), np.array(spreads))
    rotation, covariance = sensor_to_cube(cube, sensor.rotation, sensor.covariance_rad2)
    if sensor.lean_sigma_rad > 0:
        rate = _lean_rate(config, truth, known, trims)
        covariance = covariance + lean_covariance(rate, rotation, sensor.lean_sigma_rad, sensor.lean_cross_rad2)
    true_cube = Rotation.from_matrix(truth.cube_from_table(config.cube.faces))
    true_sensor = Rotation.from_matrix(truth.sensor_from_table)
    true_rotation = true_cube * true_sensor.inv()
    sensor_part = rotation_error_rad(sensor.rotation, true_sensor)
    first, second = (truth.normal_in_table(trims[i].face) for i in (0, config.cube.repeats))
    return BenchResult(
        error_arcsec=rotation_error_rad(rotation, true_rotation) * RAD_ARCSEC,
        cube_error_arcsec=rotation_error_rad(cube.rotation, true_cube) * RAD_ARCSEC,
        sensor_error_arcsec=-true_rotation.apply(sensor_part) * RAD_ARCSEC,
        sensor_sigma_arcsec=np.sqrt(np.diag(covariance - cube.covariance_rad2)) * RAD_ARCSEC,
        face_angle_rad=cube.face_angle_rad,
        true_face_angle_rad=angle_between_rad(first, second),
        trims=tuple(trims),
        sensor=sensor,
    )


def _lean_rate(config: Config, truth: Truth, known: TableAxes, trims: Sequence[FaceTrim]) -> FloatArray:
    """Difference quotient (3,) of R_pr by the fitted non-orthogonality [rad/rad]."""
    step = 1.0
    moved = replace(known, non_orthogonality_arcsec=known.non_orthogonality_arcsec + step)
    names, spread = [trim.face for trim in trims], np.zeros((len(trims), 3, 3))
    pair = []
    for table in (moved, known):
        normals = np.array([normal_in_table(table, trim.reading_rad) for trim in trims])
        pair.append(solve_cube(config, truth, names, normals, spread).rotation)
    return rotation_error_rad(*pair) / (step * ARCSEC_RAD)


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseResult:
    """All benches in one case."""

    case: Case  # Which errors were on
    bench: tuple[BenchResult, ...]  # Bench by bench

    @property
    def error_arcsec(self) -> FloatArray:
        """Errors of R_sp (n, 3)."""
        return np.array([one.error_arcsec for one in self.bench])

    @property
    def rms_arcsec(self) -> FloatArray:
        """1 sigma per axis (3,): root of the mean square about zero, so that a bias counts."""
        return np.asarray(np.sqrt(np.mean(self.error_arcsec**2, axis=0)))

    @property
    def mean_arcsec(self) -> tuple[FloatArray, FloatArray]:
        """Mean error per axis (3,) and its standard deviation (3,)."""
        return _mean(self.error_arcsec)

    @property
    def sensor_mean_arcsec(self) -> tuple[FloatArray, FloatArray]:
        """Mean contribution of R_sr (3,), and its standard deviation (3,)."""
        return _mean(np.array([one.sensor_error_arcsec for one in self.bench]))

    @property
    def sensor_pull(self) -> FloatArray:
        """RMS of the errors of R_sr over their stated standard deviations (3,); 1 where the fit states them well."""
        pulls = [one.sensor_error_arcsec / one.sensor_sigma_arcsec for one in self.bench]
        return np.asarray(np.sqrt(np.mean(np.square(pulls), axis=0)))

    @property
    def sensor_rms_arcsec(self) -> FloatArray:
        """What R_sr contributes (3,)."""
        return np.asarray(np.sqrt(np.mean([one.sensor_error_arcsec**2 for one in self.bench], axis=0)))

    @property
    def trims(self) -> FloatArray:
        """Settings of the table per face, all benches."""
        return np.array([len(trim.rows) for one in self.bench for trim in one.trims])


def _mean(error: FloatArray) -> tuple[FloatArray, FloatArray]:
    return error.mean(0), error.std(0, ddof=1) / np.sqrt(len(error))


class SensorCache:
    """Spots and calibrations of one bench's sensor.

    Only the axes of the table change where the spots fall; the angle readings do not. So one run serves all cases with
    the same axes, and one calibration all cases with the same axes, readings and fit.
    """

    def __init__(self) -> None:
        self.runs: dict[bool, SensorRun] = {}
        self.calibrations: dict[tuple[bool, bool, bool], MaskSensorCalibration] = {}


def _sensor(
    laboratory: Laboratory, truth: Truth, case: Case, table: Turntable, known: SensorCache
) -> MaskSensorCalibration:
    bench = laboratory.streams.child("bench", truth.number)
    if case.lean not in known.runs:
        exact = build_table(laboratory.config, truth, Case(name="", label="", lean=case.lean))
        known.runs[case.lean] = observe_spots(laboratory, truth, exact, bench.child("spots", int(case.lean)))
    key = (case.lean, case.reading, case.improved)
    if key not in known.calibrations:
        known.calibrations[key] = calibrate_sensor(
            laboratory, truth, table, known.runs[case.lean], bench.child("readings"), free=case.improved
        )
    return known.calibrations[key]


def run_bench(
    laboratory: Laboratory,
    truth: Truth,
    case: Case,
    known: SensorCache,
    *,
    log2_particles: int,
    keep: bool = False,
    taken: Sequence[FaceTrim] = (),
) -> BenchResult:
    """Step 1 to 5 on one bench."""
    table = build_table(laboratory.config, truth, case)
    bench = laboratory.streams.child("bench", truth.number)
    sensor = _sensor(laboratory, truth, case, table, known)
    if case.pictures_of:
        return reduce_bench(laboratory, truth, table, taken, sensor, improved=case.improved)
    trims: list[FaceTrim] = []
    for face in range(len(laboratory.config.cube.faces)):
        for repeat in range(laboratory.config.cube.repeats):
            trims.append(
                trim_face(
                    laboratory,
                    truth,
                    case,
                    table,
                    face,
                    repeat,
                    streams=bench.child(case.name, face, repeat),
                    log2_particles=log2_particles,
                    keep=keep,
                )
            )
    return reduce_bench(laboratory, truth, table, trims, sensor, improved=case.improved)


def run_cases(
    laboratory: Laboratory, truths: Sequence[Truth], cases: Sequence[Case], progress: Progress
) -> dict[str, CaseResult]:
    """Every bench through every case."""
    found: dict[str, list[BenchResult]] = {case.name: [] for case in cases}
    particles = laboratory.config.benches.log2_particles
    for truth in progress.track(truths, "benches"):
        known = SensorCache()
        for case in cases:
            taken = found[case.pictures_of][-1].trims if case.pictures_of else ()
            found[case.name].append(run_bench(laboratory, truth, case, known, log2_particles=particles, taken=taken))
    return {case.name: CaseResult(case=case, bench=tuple(found[case.name])) for case in cases}
