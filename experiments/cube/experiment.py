"""Sun sensor to cube mirror: the run and the example bench; the budget is in `experiments.cube.budget`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from calib.measure.targets.circle_fit import CircleFit
from calib.measure.targets.screen_circles import ScreenPicture
from experiments.cube.bench import CubeCase, CubeLaboratory, TrueBench, build_laboratory, build_table, draw_truths
from experiments.cube.budget import (
    BUDGET,
    RELATIVE_DETECTOR_UNCERTAINTY,
    RELATIVE_PICTURE_UNCERTAINTY,
    RELATIVE_SPOT_UNCERTAINTY,
    BudgetRow,
    beam_sensitivity,
    build_budget,
    eq13_arcsec,
    eq14_arcsec,
    non_orthogonality_sensitivity,
    perfect_sensor,
)
from experiments.cube.montecarlo import CASES, BenchResult, CaseResult, SensorCache, run_bench, run_cases
from experiments.cube.noise import PictureNoise, picture_noise, sensor_noise
from experiments.cube.sensor import SensorRun
from experiments.cube.settings import CubeMirrorConfig
from experiments.cube.trim import FaceTrim
from experiments.harness.drawings import arrows
from experiments.harness.plotting import new_figure
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, agree, col, ratio_near
from experiments.harness.summary import Measured, measured
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC, RAD_DEG
from render.bench.scene import CubePose
from render.bench.spot import reflected_spot_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class CubeSetup:
    """Sizes, eq. 13 and 14, and errors by geometry that are not in eq. 14."""

    r_sp_error_arcsec: Sequence[Measured] = col("R_sp, as performed", "arcsec", dims="axis")
    r_sp_error_improved_arcsec: Sequence[Measured] = col("R_sp, improved reduction", "arcsec", dims="axis")
    eq13_arcsec: float = col("Eq. 13", "arcsec", ".2f")
    eq14_arcsec: float = col("Eq. 14", "arcsec", ".2f")
    benches: int = col("Benches")
    settings_per_face: float = col("Settings per face", format=".1f")
    pitch_um: float = col("Pixel on the screen", "um", "g")
    spot_mm: float = col("Width of the spot", "mm", ".2f")
    rim_mm: float = col("Rim of the spot", "mm", ".2f")
    error_per_non_orthogonality: FloatArray = col("Error of R_sp per non-orthogonality", dims="component")
    error_per_beam_x: FloatArray = col("Error of R_sp per beam in x", dims="component")
    error_per_beam_y: FloatArray = col("Error of R_sp per beam in y", dims="component")


def describe_setup(laboratory: CubeLaboratory, cases: Mapping[str, CaseResult], rows: Sequence[BudgetRow]) -> CubeSetup:
    """Results of all benches, and sizes of the bench."""
    geometry = laboratory.geometry
    sensor = perfect_sensor(laboratory)
    rim_mm = geometry.blur_mm(geometry.path_mm)
    per_beam = beam_sensitivity(laboratory.config, sensor)
    by_name = {row.term: row for row in rows}
    return CubeSetup(
        r_sp_error_arcsec=by_name["procedure"].measured,
        r_sp_error_improved_arcsec=by_name["improved"].measured,
        eq13_arcsec=eq13_arcsec(laboratory),
        eq14_arcsec=eq14_arcsec(laboratory),
        benches=laboratory.config.benches.count,
        settings_per_face=float(cases["procedure"].trims.mean()),
        pitch_um=laboratory.pitch_mm * 1e3,
        spot_mm=geometry.aperture_mm + 2 * rim_mm,
        rim_mm=rim_mm,
        error_per_non_orthogonality=non_orthogonality_sensitivity(laboratory.config, sensor),
        error_per_beam_x=per_beam[:, 0],
        error_per_beam_y=per_beam[:, 1],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseErrors:
    """Error of R_sp, bench by bench, in a case."""

    name: str = col("Case")
    mean_error_arcsec: Sequence[Measured] = col("Mean error of R_sp", "arcsec", dims="axis", shown=False)
    error_arcsec: FloatArray = col("Error", "arcsec", dims="bench axis")
    settings_first_face: Sequence[int] = col("Settings, first face", dims="bench")
    settings_second_face: Sequence[int] = col("Settings, second face", dims="bench")


def case_errors(case: CaseResult) -> CaseErrors:
    """All benches of a case."""
    first, second = ([len(bench.trims[face].rows) for bench in case.bench] for face in (0, -1))
    return CaseErrors(
        name=case.case.name,
        mean_error_arcsec=measured(*case.mean_arcsec, len(case.bench)),
        error_arcsec=case.error_arcsec,
        settings_first_face=first,
        settings_second_face=second,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CubeNoise:
    """Errors of R_sr on all benches with orthogonal table axes, and noise of an offset measured in pictures."""

    r_sr_predicted_arcsec: Sequence[Measured] = col("Error of R_sr, predicted", "arcsec", dims="axis")
    r_sr_mean_error_arcsec: Sequence[Measured] = col("Mean error of R_sr", "arcsec", dims="axis")
    r_sr_error_over_stated: FloatArray = col("Error of R_sr over the stated one", dims="axis")
    r_sr_error_over_predicted: Measured = col("Error of R_sr over predicted, RMS")
    spot_noise_predicted_px: float = col("Scatter of the spots, predicted", "px", ".4f")
    # By the detector and by the finite number of rendered particles
    picture_noise_px: Sequence[Measured] = col("Scatter of an offset, predicted", "px", dims="reduced")
    detector_noise_px: Sequence[Measured] = col(
        "Scatter of an offset by the detector alone, predicted", "px", dims="reduced"
    )
    non_orthogonality_sigma_arcsec: float = col("Standard deviation of the fitted non-orthogonality", "arcsec", ".2f")
    r_sr_improved_arcsec: FloatArray = col("Part of R_sr, improved reduction", "arcsec", ".2f", "axis")


def compare_noise(laboratory: CubeLaboratory, cases: Mapping[str, CaseResult], pictures: PictureNoise) -> CubeNoise:
    """Predicted noise of R_sr and of an offset, against the errors of all benches."""
    reading, improved = cases["reading"], cases["improved"]
    predicted = sensor_noise(laboratory, reading=True, fit_non_orthogonality=False)
    sigma = np.sqrt(np.diag(predicted.covariance_rad2)) * RAD_ARCSEC
    pull = np.array([bench.sensor_error_arcsec for bench in reading.bench]) / sigma
    picture = np.array([pictures.two_pictures_px, pictures.one_picture_px])
    detector = np.array([pictures.two_pictures_detector_px, pictures.one_picture_detector_px])
    lean_sigma_rad = [bench.sensor.lean_sigma_rad for bench in improved.bench]
    return CubeNoise(
        r_sr_predicted_arcsec=measured(sigma, RELATIVE_SPOT_UNCERTAINTY * sigma),
        r_sr_mean_error_arcsec=measured(*reading.sensor_mean_arcsec, len(reading.bench)),
        r_sr_error_over_stated=reading.sensor_rms_pull,
        r_sr_error_over_predicted=Measured(
            value=float(np.sqrt(np.mean(pull**2))), uncertainty=1 / np.sqrt(2 * pull.size), n=pull.size
        ),
        spot_noise_predicted_px=predicted.spot_px,
        picture_noise_px=measured(picture, RELATIVE_PICTURE_UNCERTAINTY * picture),
        detector_noise_px=measured(detector, RELATIVE_DETECTOR_UNCERTAINTY * detector),
        non_orthogonality_sigma_arcsec=float(np.mean(lean_sigma_rad)) * RAD_ARCSEC,
        r_sr_improved_arcsec=improved.sensor_rms_arcsec,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ExampleBench:
    """The first bench, as performed, with more particles."""

    trims: tuple[FaceTrim, ...]  # With their pictures
    error_arcsec: FloatArray = col("Error of R_sp", "arcsec", ".2f", "component")
    face_angle_deg: float = col("Faces", "deg", ".5f")
    true_face_angle_deg: float = col("Faces, true", "deg", ".5f")
    # Spot minus aperture at the end of the trims, and by the law of reflection
    offset_px: Sequence[Measured] = col("Remaining offset", "px", dims="face direction")
    true_offset_px: FloatArray = col("Remaining offset, true", "px", dims="face direction")
    rotation_arcsec: FloatArray = col("R_sr", "arcsec", dims="component")
    covariance_arcsec2: FloatArray = col("Covariance of R_sr", dims="component other")
    r_sr_error_arcsec: FloatArray = col("Error of R_sr", "arcsec", ".2f", "component")
    spot_residual_rms_px: float = col("Scatter of the spots", "px", ".4f")
    positions: int = col("Positions of the table")
    mask_gap_mm: float = col("Mask to detector", "mm", ".5f")
    true_mask_gap_mm: float = col("Mask to detector, true", "mm", ".5f")
    free_beam_arcsec: Sequence[Measured] = col("Beam off the Z axis", "arcsec", dims="angle")
    spot_px: FloatArray = col("Spot of the sun sensor", "px", dims="position direction")
    residual_px: FloatArray = col("Spots minus fit", "px", dims="position direction")


def example_bench(laboratory: CubeLaboratory, truth: TrueBench, bench: BenchResult, spots: SensorRun) -> ExampleBench:
    """Numbers of the example bench."""
    sensor, config = bench.sensor, laboratory.config
    error = sensor.rotation * Rotation.from_matrix(truth.sensor_from_table).inv()
    table = build_table(config, truth, next(case for case in CASES if case.name == "procedure"))
    offsets = [trim.one_picture_offset for trim in bench.trims]
    return ExampleBench(
        trims=bench.trims,
        error_arcsec=bench.error_arcsec,
        face_angle_deg=bench.face_angle_rad * RAD_DEG,
        true_face_angle_deg=bench.true_face_angle_rad * RAD_DEG,
        offset_px=[measured(offset.offset_px, offset.sigma_px) for offset in offsets],
        true_offset_px=np.array([true_offset_px(laboratory, truth, table, trim) for trim in bench.trims]),
        rotation_arcsec=sensor.rotation.as_rotvec() * RAD_ARCSEC,
        covariance_arcsec2=sensor.covariance_rad2 * RAD_ARCSEC**2,
        r_sr_error_arcsec=error.as_rotvec() * RAD_ARCSEC,
        spot_residual_rms_px=sensor.sigma_px,
        positions=len(spots.pixel_px),
        mask_gap_mm=sensor.focal_length_mm,
        true_mask_gap_mm=truth.sensor.gap_mm,
        free_beam_arcsec=measured(sensor.free_beam_rad * RAD_ARCSEC, sensor.free_beam_sigma_rad * RAD_ARCSEC),
        spot_px=spots.pixel_px,
        residual_px=residuals_px(config, truth, bench, spots),
    )


def true_offset_px(laboratory: CubeLaboratory, truth: TrueBench, table: Turntable, trim: FaceTrim) -> FloatArray:
    """Remaining offset (2,) of a face, by the law of reflection."""
    angle = np.radians([[trim.rows[-1].outer_deg, trim.rows[-1].inner_deg]])
    lab_from_table = table.rotation(angle)[0].as_matrix()
    pose = CubePose.of_table(laboratory.geometry, lab_from_table, truth.table_from_cube, truth.normal)
    return reflected_spot_mm(laboratory.geometry, pose, trim.face) / laboratory.pitch_mm


def residuals_px(config: CubeMirrorConfig, truth: TrueBench, bench: BenchResult, spots: SensorRun) -> FloatArray:
    """Spots minus the fitted sensor, for the true angles of the table (n, 2)."""
    table, sensor = build_table(config, truth, CubeCase(name="", label="")).nominal, bench.sensor
    sun = (sensor.rotation * table.rotation(spots.angle_rad).inv()).apply([0.0, 0.0, 1.0])
    fitted = replace(truth.sensor, gap_mm=sensor.focal_length_mm, offset_px=sensor.offset_px)
    return np.asarray(spots.pixel_px - fitted.spot_px(sun))


@dataclass(frozen=True, slots=True, kw_only=True)
class Trim:
    """A setting of the table, as in CUBE09 Table 1."""

    face: str = col("Face")
    trim: int = col("Trim")
    inner_deg: float = col("Inner", "deg", ".4f")
    outer_deg: float = col("Outer", "deg", ".4f")
    offset_px: Sequence[Any] = col("Offset", "px", ".3f", "direction")


def trims_of(bench: BenchResult) -> list[Trim]:
    """Trims of both faces, one after the other."""
    return [
        Trim(
            face=trim.face,
            trim=number + 1,
            inner_deg=row.inner_deg,
            outer_deg=row.outer_deg,
            offset_px=measured(row.offset_px, row.sigma_px),
        )
        for trim in bench.trims
        for number, row in enumerate(trim.rows)
    ]


def draw_pictures(outcome: Outcome, face: int) -> Figure:
    """Aperture, first and last spot of a face with the fitted circles."""
    trim = outcome.result["example"].trims[face]
    figure, panels = new_figure(1, 3, aspect_ratio=0.42, sharex=True, sharey=True)
    titles = ("aperture, glowing", f"spot, trim 1 of {len(trim.rows)}", f"spot, trim {len(trim.rows)}")
    for axis, picture, title in zip(panels, trim.pictures, titles, strict=True):
        light = picture.electrons / 1e3
        axis.imshow(light, vmin=0, vmax=np.percentile(light, 99.8))
        axis.set(title=title, xlabel="column [px]")
        axis.grid(visible=False)
        _outline(axis, picture, trim.offset.aperture, color="white", linewidth=0.7)
    _outline(panels[2], trim.pictures[2], trim.offset.spot, color="#ff9d3c", linewidth=0.9)
    reach = 1.25 * trim.offset.spot.radius + 0.35
    camera = trim.pictures[0].camera
    corners = camera.to_pixel(reach * np.array([[-1, -1], [1, 1], [-1, 1], [1, -1]]))
    low = np.maximum(corners.min(0), -0.5)
    high = np.minimum(corners.max(0), np.array([camera.width_px, camera.height_px]) - 0.5)
    panels[0].set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), ylabel="row [px]")
    return figure


def _outline(axis: Any, picture: ScreenPicture, circle: CircleFit, **style: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    points = circle.centre + circle.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    axis.plot(*picture.camera.to_pixel(points).T, **style)
    axis.plot(*picture.camera.to_pixel(circle.centre[None]).T, "+", markersize=7, **style)


def axes(config: CubeMirrorConfig) -> Quantities:
    """Dimensions that several sections share; "reduced": aperture and spot from two pictures, or both from one."""
    q = Quantities()
    q.axis("axis", ["x", "y", "z"], "Axis")
    q.axis("direction", ["x", "y"], "Direction")
    q.axis("reduced", ["two_pictures", "one_picture"], "Aperture and spot")
    q.axis("angle", ["azimuth", "elevation"], "Angle")
    q.axis("bench", list(range(config.benches.count)), "Bench")
    return q


def run(config: CubeMirrorConfig, *, progress: Progress) -> dict[str, Any]:
    """Build the bench, trim, calibrate, and repeat on every misaligned bench."""
    with progress.stage("bench"):
        laboratory = build_laboratory(config)
        truths = draw_truths(config, laboratory.streams)
    performed, cache = next(case for case in CASES if case.name == "procedure"), SensorCache()
    with progress.stage("example bench"):
        particles = config.benches.shown_log2_particles
        bench = run_bench(laboratory, truths[0], performed, cache, log2_particles=particles, keep_pictures=True)
    cases = run_cases(laboratory, truths, CASES, progress)
    with progress.stage("budget"):
        pictures = picture_noise(laboratory)
        rows = build_budget(laboratory, cases, pictures)
    return {
        "setup": describe_setup(laboratory, cases, rows),
        "budget": rows,
        "benches": [case_errors(case) for case in cases.values()],
        "noise": compare_noise(laboratory, cases, pictures),
        "example": example_bench(laboratory, truths[0], bench, cache.runs[performed.non_orthogonal]),
        "trims": trims_of(bench),
    }


SECTIONS = {
    "setup": Section(record=CubeSetup),
    "budget": BUDGET,
    "benches": Section(
        record=CaseErrors,
        dim="case",
        along="name",
        rows="case bench",
        across="axis",
        caption="Error of R_sp, bench by bench.",
    ),
    "noise": Section(
        record=CubeNoise,
        verdicts=[
            ratio_near(
                "r_sr_error_over_predicted",
                within=RELATIVE_SPOT_UNCERTAINTY,
                title="errors of R_sr over their prediction from spot noise, RMS",
            )
        ],
    ),
    "example": Section(
        record=ExampleBench,
        figures={"pictures": draw_pictures, "sensor_residuals": arrows("spot_px", "residual_px")},
        verdicts=[
            agree(
                "offset_px",
                "true_offset_px",
                title="remaining offsets of the shown bench, circle fits against the law of reflection",
            )
        ],
    ),
    "trims": Section(
        record=Trim,
        dim="setting",
        hidden="setting",
        rows="setting",
        across="direction",
        caption="Trims of the example bench, as in CUBE09 Table 1: spot minus aperture, from the pictures.",
        note="One standard deviation, from the two circle fits.",
    ),
}
