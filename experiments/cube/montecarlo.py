"""The Monte-Carlo: every bench through every case, all pictures rendered and read out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.cube.bench import Case, Laboratory, Truth, build_table
from experiments.cube.reduce import BenchResult, reduce_bench
from experiments.cube.sensor import SensorCalibration, SensorRun, calibrate_sensor, observe_spots
from experiments.cube.trim import FaceTrim, trim_face
from experiments.harness.progress import Progress
from experiments.laboratory.turntable import Turntable
from optics.arrays import FloatArray

__all__ = ["CASES", "CaseResult", "SensorCache", "run_bench", "run_cases"]


CASES = (
    Case(name="pixel", label="one pixel (eq. 13)", aim_px=1.0),
    Case(name="trim", label="stop rule", coarse=True),
    Case(name="square", label="axes out of square", lean=True),
    Case(name="mounting", label="camera mount", mounting=True),
    Case(name="reading", label="angle reading", reading=True),
    Case(name="all", label="all of eq. 14", aim_px=1.0, lean=True, mounting=True, reading=True),
    Case(name="procedure", label="as performed", coarse=True, lean=True, mounting=True, reading=True),
    Case(
        name="improved",
        label="reduced better",
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
        """Mean of what R_sr contributes (3,), and its standard deviation (3,)."""
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

    @property
    def offsets_px(self) -> FloatArray:
        """Measured offsets at which the faces were left (m, 2)."""
        return np.array([trim.offset.offset_px for one in self.bench for trim in one.trims])


def _mean(error: FloatArray) -> tuple[FloatArray, FloatArray]:
    return error.mean(0), error.std(0, ddof=1) / np.sqrt(len(error))


class SensorCache:
    """Spots and calibrations of one bench's sensor.

    Only the axes of the table change where the spots fall; what is read of the angles does not. So one run serves all
    cases with the same axes, and one calibration all cases with the same axes, readings and fit.
    """

    def __init__(self) -> None:
        self.runs: dict[bool, SensorRun] = {}
        self.calibrations: dict[tuple[bool, bool, bool], SensorCalibration] = {}


def _sensor(
    laboratory: Laboratory, truth: Truth, case: Case, table: Turntable, known: SensorCache
) -> SensorCalibration:
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
