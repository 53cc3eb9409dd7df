"""The error budget: what geometry predicts for each term on each axis, without a picture, beside CUBE09's eq. 13 and
14.

Eq. 14 adds four numbers as if each hit every axis. They do not: R_pr gets its x and y from the first face and its z
from the second, one component each, so an error of a normal across one direction is an error of one axis. Per axis:

* one pixel: arctan(pixel / distance) / 2 on every axis (eq. 13);
* trim: what the stop rule leaves, from playing it with the operator's gain and the table's steps on numbers;
* axes out of square: nothing on x and y; on z what the second face gets (all of it) less what the sun sensor, which was
  calibrated on the same table, got too: from the reduction of positions that geometry gives;
* camera mount: on every axis;
* reading: the outer axis on x and z, the inner one on y.

What eq. 14 leaves out, sun sensor and pictures, follows from the noise of their detectors (`experiments.cube.noise`):
nothing that was fitted or measured enters a prediction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.calibration.cube_mirror import cube_from_table, normal_in_table, pixel_angle_rad, rotation_error_rad
from experiments.cube.bench import (
    NOMINAL_CUBE,
    SQUARE,
    Case,
    Laboratory,
    build_table,
    concentric_angles,
    nominal_normal,
)
from experiments.cube.bench import Truth as BenchTruth
from experiments.cube.montecarlo import CaseResult
from experiments.cube.noise import PictureNoise, sensor_noise
from experiments.cube.reduce import measured_normal
from experiments.cube.sensor import field_angles, fit_sensor
from experiments.cube.settings import Config
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, DEG_RAD, RAD_ARCSEC, RAD_DEG
from render.bench.sensor import MaskSensor
from render.engine.random import Streams

__all__ = [
    "PUBLISHED_ARCSEC",
    "TABLE1_DEG",
    "BudgetRow",
    "build_budget",
    "face_angles_deg",
    "lean_rates",
    "play_trim",
    "reading_term",
    "stratified_variance_ratio",
]


PUBLISHED_ARCSEC = {"pixel": 2.34, "square": 2.0, "mounting": 2.0, "reading": 0.4, "all": 3.69}
"""CUBE09 as printed; its 2.34 comes from 65000 um for 650 mm and should be 2.38."""

TABLE1_DEG = ((181.398, 0.528), (91.386, -0.048))
"""Last rows of CUBE09 Table 1: (theta1, theta2), (theta3, theta4)."""

PLAYED = 40000

PICTURES_RELATIVE = 1.0
"""How far the linear response may be off for pictures of the Monte-Carlo: the line of a spoke is fitted to some thirty
particles, which scatter its slope too. Found 1.4 to 2.3 times as large with 2^15 to 2^20 particles. No limit hangs on
it: a laboratory's pictures have no particles."""
DETECTOR_RELATIVE = 0.1
"""How far that of the detector may be off: at 18 deg a pixel is 5 % longer on the screen, and bilinear interpolation
leaves 2/3 of the variance along the rows only, less along diagonals."""
SENSOR_RELATIVE = 0.15
"""How far the noise of the spots may be off: closed form for a disk of even light that is cut by no pixel."""

STRATIFIED = ("pixel", "square", "mounting")
"""Terms that follow one stratified input of a bench each; the others come from noise, or from inputs in a tangle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetRow:
    """One line of the budget."""

    name: str  # Term
    label: str  # Term
    published_arcsec: float | None  # CUBE09
    term_arcsec: FloatArray  # (3,) What geometry predicts for the term by itself: x, y, z of the cube frame
    # (3,) The same with the noise of pictures and sun sensor, which no case is without; how far it may be off
    predicted_arcsec: FloatArray
    # (3,) The same with the noise of pictures and sun sensor, which no case is without; how far it may be off
    predicted_sigma_arcsec: FloatArray
    measured_arcsec: FloatArray  # (3,) Monte-Carlo, and its standard deviation (`stratified_variance_ratio`)
    uncertainty_arcsec: FloatArray  # (3,) Monte-Carlo, and its standard deviation (`stratified_variance_ratio`)
    acts: NDArray[np.bool_]  # (3,) Axes on which the term is at least a third of the prediction
    benches: int  # Number of benches

    @property
    def ratio(self) -> float:
        """Predicted over measured, both as the root sum of squares over the axes on which the term acts."""
        return float(np.linalg.norm(self.predicted_arcsec[self.acts]) / np.linalg.norm(self.measured_arcsec[self.acts]))

    @property
    def ratio_sigma(self) -> float:
        """Standard deviation of `ratio`."""
        parts = [
            float(np.linalg.norm((value * sigma)[self.acts]) / np.sum(value[self.acts] ** 2))
            for value, sigma in (
                (self.measured_arcsec, self.uncertainty_arcsec),
                (self.predicted_arcsec, self.predicted_sigma_arcsec),
            )
        ]
        return self.ratio * float(np.hypot(parts[0], parts[1]))


def play_trim(config: Config, tilt_per_px: float, noise_px: float, streams: Streams) -> FloatArray:
    """RMS of the offset [px] that the stop rule leaves, x and y: the rule played on numbers."""
    generator = streams.generator("played trims")
    step_px = config.trim.step_deg * DEG_RAD / tilt_per_px
    where = generator.uniform(-1, 1, (PLAYED, 2)) * config.trim.start_px
    phase = generator.uniform(0, 1, (PLAYED, 2)) * step_px
    going = np.ones(PLAYED, bool)

    def on_steps(offset: FloatArray) -> FloatArray:
        return np.asarray(np.rint((offset - phase) / step_px) * step_px + phase) if step_px > 0 else offset

    where = on_steps(where)
    for _ in range(config.trim.allowed):
        seen = where + generator.standard_normal((PLAYED, 2)) * noise_px
        going = going & ~np.all(np.abs(seen) < config.trim.stop_px, axis=1)
        where = np.where(going[:, None], on_steps(where - config.trim.gain_ratio * seen), where)
    return np.asarray(np.sqrt(np.mean(where[~going] ** 2, axis=0)))


def perfect_bench(config: Config, sensor: MaskSensor) -> BenchTruth:
    """A bench without any misalignment."""
    none = np.zeros((len(config.cube.faces), config.cube.repeats, 2))
    return BenchTruth(
        number=0,
        table_from_cube=NOMINAL_CUBE,
        normal=SQUARE,
        sensor_from_table=np.eye(3),
        sensor=sensor,
        start=none,
        aim=none,
        mounting=none,
        lean=0.0,
    )


def geometric_error(
    config: Config, sensor: MaskSensor, *, lean_arcsec: float = 0.0, beam: tuple[float, float] = (0.0, 0.0)
) -> FloatArray:
    """Error of R_sp (3,) [arcsec] on a perfect bench but for the table's axes and the beam, by geometry alone."""
    truth = perfect_bench(config, sensor)
    case = Case(name="", label="", lean=True)
    unit = config.model_copy(update={"table": config.table.model_copy(update={"square_arcsec": 1.0})})
    table = build_table(unit, _with_lean(truth, lean_arcsec), case)
    sun = np.array([*(np.array(beam) * ARCSEC_RAD), 1.0])
    sun /= np.linalg.norm(sun)
    angle = field_angles(config)
    spots = sensor.spot_px(table.rotation(angle).inv().apply(sun))
    calibrated = fit_sensor(config, spots, angle, table, sensor, free=False)
    faces = _first_faces(config)
    normals = [
        measured_normal(table.nominal, concentric_angles(table, truth.normal_in_table(f), f, sun), None, 1.0)
        for f in faces
    ]
    nominal = [nominal_normal(face) for face in faces]
    cube = cube_from_table(nominal, normals, covariance_rad2=np.zeros((2, 3, 3)))
    true = Rotation.from_matrix(truth.cube_from_table(faces))
    return rotation_error_rad(cube.rotation * calibrated.rotation.inv(), true) * RAD_ARCSEC


def _first_faces(config: Config) -> list[str]:
    first = config.cube.faces[0]
    return [first, next(face for face in config.cube.faces if face[1] != first[1])]


def _with_lean(truth: BenchTruth, lean_arcsec: float) -> BenchTruth:
    return replace(truth, lean=lean_arcsec)


def lean_rates(config: Config, sensor: MaskSensor) -> FloatArray:
    """Error of R_sp (3,) per unit of the axes' non-orthogonality."""
    return geometric_error(config, sensor, lean_arcsec=10.0) / 10.0


def beam_rates(config: Config, sensor: MaskSensor) -> FloatArray:
    """Error of R_sp (3, 2) per unit of the beam's direction off the table's Z axis, in x and in y."""
    off = [geometric_error(config, sensor, beam=(10.0, 0.0)), geometric_error(config, sensor, beam=(0.0, 10.0))]
    return np.column_stack(off) / 10.0


def face_angles_deg() -> tuple[float, float]:
    """Angle between the faces from Table 1 [deg]: with its heads (X' first), and as the text names the axes.

    The first is the check of the corrected eq. 8; the second the reading in which the bench can be built.
    """

    def between(pairs: tuple[tuple[float, float], ...]) -> float:
        first, second = (normal_in_table(outer * DEG_RAD, inner * DEG_RAD) for outer, inner in pairs)
        return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second) * RAD_DEG)

    return between(TABLE1_DEG), between(tuple((b, a) for a, b in TABLE1_DEG))


def terms(laboratory: Laboratory, sensor: MaskSensor, trim_px: FloatArray) -> dict[str, FloatArray]:
    """What geometry predicts for each term by itself, per axis of the cube frame [arcsec]."""
    config, repeats = laboratory.config, np.sqrt(laboratory.config.cube.repeats)
    pixel = pixel_angle_rad(laboratory.pitch_mm, laboratory.geometry.distance_mm) * RAD_ARCSEC
    ones = np.ones(3) / repeats
    return {
        "pixel": pixel * ones,
        # x and z come from the offset in y (outer axis), y from the one in x
        "trim": pixel * trim_px[[1, 0, 1]] * ones,
        "square": np.abs(lean_rates(config, sensor)) * config.table.square_arcsec,
        "mounting": config.camera.mounting_arcsec * ones,
        "reading": reading_term(config.table.outer_reading_arcsec, config.table.inner_reading_arcsec) * ones,
    }


def reading_term(outer_arcsec: float, inner_arcsec: float) -> FloatArray:
    """What readings of both faces do (3,): the outer axis acts on x (first face) and z (second), the inner one on y."""
    return np.array([outer_arcsec, inner_arcsec, outer_arcsec])


def build_budget(laboratory: Laboratory, cases: Mapping[str, CaseResult], pictures: PictureNoise) -> list[BudgetRow]:
    """All lines of the budget."""
    played = play_trim(laboratory.config, laboratory.tilt_per_px, pictures.two_px, laboratory.streams)
    single = terms(laboratory, perfect_sensor(laboratory), played)
    rows = []
    for name, result in cases.items():
        case = result.case
        active = {
            "pixel": case.aim_px > 0,
            "trim": case.coarse and not case.improved,
            "square": case.lean and not case.improved,
            "mounting": case.mounting and not case.improved,
            "reading": case.reading,
        }
        term = np.sqrt(sum((single[key] ** 2 for key, on in active.items() if on), np.zeros(3)))
        seen, sensor = _noise(laboratory, case, pictures)
        predicted = np.sqrt(term**2 + seen**2 + sensor**2)
        known = np.hypot(PICTURES_RELATIVE * seen**2, SENSOR_RELATIVE * sensor**2) / predicted
        even = [single[key] for key in STRATIFIED if active[key]]
        ratio = stratified_variance_ratio(even, predicted, benches=len(result.bench))
        acts = term > predicted / 3
        if case.improved or not acts.any():  # noise is all there is
            acts = np.ones(3, bool)
        rows.append(
            BudgetRow(
                name=name,
                label=case.label,
                published_arcsec=PUBLISHED_ARCSEC.get(name),
                term_arcsec=term,
                predicted_arcsec=predicted,
                predicted_sigma_arcsec=known,
                measured_arcsec=result.rms_arcsec,
                uncertainty_arcsec=result.rms_arcsec * np.sqrt(ratio / (2 * len(result.bench))),
                acts=acts,
                benches=len(result.bench),
            )
        )
    return rows


def stratified_variance_ratio(even: list[FloatArray], predicted: FloatArray, *, benches: int) -> FloatArray:
    """Variance of a measured mean square over that of independent draws (3,).

    The mean square of a sum of terms holds the mean squares of the terms and their products. Stratified inputs
    (`experiments.cube.bench.draw_truths`) bring the mean square of their own term to its expectation, so its part
    ``term^4 / predicted^4`` of the variance is missing; what it is off by is at most of the order of one bench.
    """
    missing = sum(((term / predicted) ** 4 for term in even), np.zeros(3))
    return np.maximum(1.0 - missing, 1.0 / benches)


def perfect_sensor(laboratory: Laboratory) -> MaskSensor:
    """The sun sensor as designed."""
    detector, config = laboratory.sensor_detector, laboratory.config.sensor
    return MaskSensor(
        width_px=detector.width_px,
        height_px=detector.height_px,
        pitch_mm=detector.pixel_pitch_mm,
        hole_mm=config.hole_um * 1e-3,
        gap_mm=config.gap_mm,
        offset_px=np.zeros(2),
    )


def _noise(laboratory: Laboratory, case: Case, pictures: PictureNoise) -> tuple[FloatArray, FloatArray]:
    """Pictures and sun sensor, (3,) each [arcsec]; in coarse trims the stop rule already counts the pictures."""
    covariance = sensor_noise(laboratory, reading=case.reading, lean=case.improved).covariance_rad2
    sensor = np.sqrt(np.diag(covariance)) * RAD_ARCSEC
    if case.coarse and not case.improved:
        return np.zeros(3), sensor
    seen_px = pictures.own_px if case.improved else pictures.two_px
    seen = seen_px * laboratory.tilt_per_px * RAD_ARCSEC / np.sqrt(laboratory.config.cube.repeats)
    return np.full(3, seen), sensor
