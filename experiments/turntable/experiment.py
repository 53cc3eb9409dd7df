"""Joint calibration with a single star on tables of two and three axes: rendered, tested, repeated on coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.calibration.record import Calibration
from calib.calibration.star_bench import StarBench, reading_covariance_px2, residual_px, star_direction
from calib.calibration.table_axes import TableAxes, axis_directions
from calib.calibration.table_bound import TableBound, map_error_by_noise, table_bound
from calib.calibration.table_reduction import (
    PoseData,
    calibrate_on_table,
    calibrated_bench,
    check_count,
    check_fit,
    check_parity,
)
from calib.cameras.base import CameraModel
from calib.cameras.line_of_sight import LineOfSightMap
from experiments.harness.drawings import maps
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities, shown_unit
from experiments.harness.sections import Section, agree, below, col
from experiments.harness.summary import Measured, measured
from experiments.laboratory.single_star.measure import Measurement, TracedMap, measure, traced_map
from experiments.laboratory.single_star.settings import TurntableConfig
from experiments.laboratory.single_star.setup import (
    build_star,
    build_table,
    camera_under_test,
    check_table,
    grid_px,
    star_signal,
    start_model,
)
from experiments.turntable.fields import FIELDS, field_sweep
from experiments.turntable.monte_carlo import (
    READINGS,
    Coordinates,
    MonteCarlo,
    equal_reading_noise_arcsec,
    map_error,
    monte_carlo,
    reading_sweep,
)
from experiments.turntable.settings import TurntableCalibrationConfig
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

TABLES = {"two_axis": "two-axis", "three_axis": "three-axis"}
UNKNOWNS = {
    "x0_px": "x₀",
    "y0_px": "y₀",
    "focal_length_mm": "f",
    "q1_per_mm2": "q₁",
    "q2_per_mm4": "q₂",
    "q3_per_mm6": "q₃",
    "p1_per_mm": "p₁",
    "p2_per_mm": "p₂",
    "star_azimuth_rad": "star az.",
    "star_elevation_rad": "star el.",
    "theta1_rad": "θ₁",
    "theta2_rad": "θ₂",
    "theta3_rad": "θ₃",
    "lean1_rad": "non-orthogonality, axis 2",
    "lean2_rad": "non-orthogonality, axis 3",
}
"""Unknowns of the calibration, the last one on three axes only."""
REDUCTIONS = {"estimated": "axis angles fitted", "ignored": "axes taken as orthogonal", "known": "axis angles known"}
MIN_RUNS = 10
"""Smallest number of converged runs of a Monte-Carlo."""
RENDERED_QUANTILE = 0.998
"""Quantile of the map error that limits the rendered run, from the Cramér-Rao bound at the truth. The covariance at the
estimate is not used: on two axes the errors are so large in one direction that it differs from that at the truth
(standard deviation of the principal point 25 px instead of 32 px in one of 40 runs)."""
SECOND_ORDER = 1.15
"""Factor on `RENDERED_QUANTILE` by second derivatives on two axes: in 1500 runs of the Monte-Carlo this quantile is 3.2
times the RMS of the bound, for normal errors 2.8 times."""
PULL_SLACK = 0.05
"""Relative increase of the pulls that second derivatives may cause."""
MAX_MODEL_RATIO = 0.1
"""Largest error of the camera model over the predicted map error."""
ADVICE = (
    "the axes (reduction.axes), the start of the star (reduction.star_deg), the reading noise or the camera model are "
    "wrong, or too little of the field is visited"
)
"""Advice for a calibration that does not fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableReduction:
    """A calibration and its errors."""

    calibration: Calibration
    # Error against the traced lens after the best rotation, and the error predicted by the covariance
    line_of_sight: LineOfSightMap
    # (n, 2) Measured minus predicted images at the angles as read, before any reading error is fitted
    residual_px: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class TableCase:
    """Calibration of one table."""

    measurement: Measurement  # The rendered run
    # Non-orthogonality of the axes ``estimated``, ``ignored`` (taken as zero) or ``known``
    reductions: Mapping[str, TableReduction]
    # Of noise-free rays at true angles, non-orthogonality known: the error of the camera model
    model: TableReduction
    coordinates: Coordinates  # The bench with this model as its camera: the truth of the Monte-Carlo
    bound: TableBound  # Cramer-Rao bound, non-orthogonality unknown
    bounds_if_known: Mapping[str, float]  # Bounds of the map error [arcsec, RMS length] with prior knowledge
    noise: Mapping[str, float]  # Map error by each source of noise [arcsec, RMS length]; squares add up
    monte_carlo: MonteCarlo  # Runs on coordinates


def prepare(config: TurntableCalibrationConfig) -> Instrument:
    """The camera; all checks that need no rendering."""
    check_table("two_axis", config.two_axis, 2)
    check_table("three_axis", config.three_axis, 3)
    if config.reduction.axes is not None and len(axis_directions(config.reduction.axes)) != 2:
        raise ConfigError(f"reduction.axes = {config.reduction.axes!r}: two axes are needed")
    for table in (config.two_axis, config.three_axis):
        check_count(config.grid.columns * config.grid.rows, build_table(table))
    instrument = camera_under_test(config)
    grid_px(config, instrument)
    build_star(config, instrument)
    return instrument


def calibrate_table(
    config: TurntableCalibrationConfig,
    instrument: Instrument,
    traced: TracedMap,
    key: str,
    streams: Streams,
    progress: Progress,
) -> TableCase:
    """Render and calibrate a table, compute its bounds, and repeat the calibration on coordinates."""
    name = TABLES[key]
    table = getattr(config, key)
    streams = streams.child(name)
    with progress.stage(f"{name} table", total=5) as stage:
        measurement = measure(config, instrument, table, streams, advance=stage.advance)
        reductions, noise_free = calibrate_rendered(config, instrument, traced, key, table, measurement)
        stage.advance()
    model = noise_free.calibration.model
    single_frame = measurement.bench
    bench = replace(single_frame, table=single_frame.table.averaged(config.frames))
    angle = np.array(measurement.visits.true_rad)
    centroid_px2 = measurement.readings.covariance_px2
    coordinates = Coordinates(
        model=model,
        bench=bench,
        true_rad=angle,
        covariance_px2=centroid_px2,
        start=start_model(instrument, config.reduction.focal_length_mm),
        start_star=star_direction(*config.reduction.star_deg),
    )
    noise = centroid_px2 + reading_covariance_px2(model, bench, angle)
    with progress.stage(f"{name} Monte-Carlo", total=config.study.runs) as stage:
        runs = monte_carlo(coordinates, traced, streams.child("Monte-Carlo"), config.study.runs, advance=stage.advance)
    if runs.runs < MIN_RUNS:
        raise DomainError(
            f"{name} table: {runs.not_converged} of {config.study.runs} calibrations of the Monte-Carlo did not "
            "converge; use better start values (reduction.star_deg, reduction.focal_length_mm) or cover more of the "
            "field"
        )
    return TableCase(
        measurement=measurement,
        reductions=reductions,
        model=noise_free,
        coordinates=coordinates,
        bound=table_bound(model, bench, angle, noise, traced.direction, leans=True),
        bounds_if_known=bounds_if_known(model, bench, angle, noise, traced.direction),
        noise=map_error_by_noise(model, bench, angle, centroid_px2, traced.direction),
        monte_carlo=runs,
    )


def bounds_if_known(
    model: CameraModel, bench: StarBench, angle_rad: FloatArray, noise_px2: FloatArray, map_direction: FloatArray
) -> dict[str, float]:
    """Bounds of the map error [arcsec, RMS length] of the joint calibration with some unknowns known."""
    options: dict[str, dict[str, Any]] = {
        "nothing more": {"leans": True},
        "the axes' angles": {"leans": False},
        "the star's direction": {"leans": True, "star": False},
        "star and axes": {"leans": False, "star": False},
        "no tangential distortion": {
            "leans": True,
            "free": [name for name in model.parameter_names if not name.startswith(("p1", "p2"))],
        },
    }
    design = model, bench, angle_rad, noise_px2, map_direction
    return {label: table_bound(*design, **unknowns).map_sigma_arcsec for label, unknowns in options.items()}


def calibrate_rendered(
    config: TurntableCalibrationConfig,
    instrument: Instrument,
    traced: TracedMap,
    key: str,
    table: TurntableConfig,
    measurement: Measurement,
) -> tuple[dict[str, TableReduction], TableReduction]:
    """Calibrations of the rendered run, and of noise-free rays."""
    start = start_model(instrument, config.reduction.focal_length_mm)
    start_star = star_direction(*config.reduction.star_deg)
    assumed = build_table(table, config.reduction.axes if key == "two_axis" else None).averaged(config.frames)
    true = measurement.bench.table.averaged(config.frames)
    without_noise = replace(true, reading_noise_arcsec=np.zeros(len(true.axis)))
    rendered = measurement.pose_data
    rays = replace(rendered, pixel_px=measurement.bundle_px, reading_rad=measurement.visits.true_rad)

    def reduction(data: PoseData, table: TableAxes, *, leans: bool = False) -> TableReduction:
        calibration = calibrate_on_table(data, table, start, leans=leans, start_star=start_star)
        bench = calibrated_bench(calibration, table)
        return TableReduction(
            calibration=calibration,
            line_of_sight=map_error(calibration, traced),
            residual_px=residual_px(calibration.model, bench, data.pixel_px, data.reading_rad),
        )

    check_parity(rendered, assumed.nominal, start, start_star)
    estimated = reduction(rendered, assumed.nominal, leans=True)
    check_fit(estimated.calibration, f"{TABLES[key]} table", ADVICE)
    ignored = reduction(rendered, assumed.nominal)
    known = reduction(rendered, assumed)
    noise_free = reduction(rays, without_noise)
    check_fit(noise_free.calibration, f"{TABLES[key]} table, camera model against noise-free rays", ADVICE)
    return {"estimated": estimated, "ignored": ignored, "known": known}, noise_free


@dataclass(frozen=True, slots=True, kw_only=True)
class LineOfSight:
    """Calibration on one table: RMS length over the map of the line-of-sight error after the best rotation."""

    map_error_arcsec: Sequence[float] = col("Run,", "arcsec", ".3g", "reduction")
    map_predicted_arcsec: float = col("Predicted", "arcsec", ".3g")  # By the estimator's covariance
    # `RENDERED_QUANTILE` of the map error
    map_limit_arcsec: float = col("Limit of chance", "arcsec", ".3g", shown=False)
    map_monte_carlo_arcsec: Measured = col("Monte-Carlo", "arcsec", ".3g")
    map_bound_arcsec: float = col("Cramér–Rao", "arcsec", ".3g")
    # Misfit of the camera model to noise-free rays, non-orthogonality known
    camera_model_arcsec: float = col("Camera model", "arcsec", ".3g")
    camera_model_ratio: float = col("Camera model over predicted", "", ".2g", shown=False)
    reduced_chi2: Sequence[Measured] = col("χ²/dof,", "", ".3f", "reduction", shown=False)
    principal_point_sigma_arcsec: FloatArray = col("Principal point alone, σ", "arcsec", ".0f", "axis", shown=False)
    principal_point_ratio: float = col("Principal point over line of sight", "", ".0f", shown=False)  # Per axis
    runs_not_converged: int = col("Runs that did not converge", shown=False)
    positions: int = col("Positions", shown=False)
    centroid_error_px: FloatArray = col("Centroid error, RMS", "px", ".4f", "axis", shown=False)
    centroid_predicted_px: FloatArray = col("Centroid error, predicted", "px", ".4f", "axis", shown=False)
    error_map_arcsec: FloatArray = col("Error of the line of sight", "arcsec", dims="point", shown=False)
    sigma_map_arcsec: FloatArray = col("Predicted σ of the line of sight", "arcsec", dims="point", shown=False)


def summarise_table(case: TableCase, pixel_arcsec: float) -> LineOfSight:
    """The rendered run and the Monte-Carlo of one table."""
    solutions = [reduction.calibration.solution for reduction in case.reductions.values()]
    estimated = case.reductions["estimated"].line_of_sight
    readings = case.measurement.readings
    sigma = dict(zip(solutions[0].names, solutions[0].sigma, strict=True))
    principal_point_arcsec = pixel_arcsec * np.array([sigma["x0_px"], sigma["y0_px"]])
    predicted = estimated.predicted_rms_arcsec
    model = case.model.line_of_sight.rms_arcsec
    return LineOfSight(
        map_error_arcsec=[reduction.line_of_sight.rms_arcsec for reduction in case.reductions.values()],
        map_predicted_arcsec=predicted,
        map_limit_arcsec=SECOND_ORDER * case.bound.line_of_sight.rms_limit_arcsec(RENDERED_QUANTILE),
        map_monte_carlo_arcsec=case.monte_carlo.map_arcsec,
        map_bound_arcsec=case.bound.map_sigma_arcsec,
        camera_model_arcsec=model,
        camera_model_ratio=model / predicted,
        reduced_chi2=[
            Measured(value=fit.reduced_chi2, uncertainty=float(np.sqrt(2.0 / fit.degrees_of_freedom)))
            for fit in solutions
        ],
        principal_point_sigma_arcsec=principal_point_arcsec,
        # sqrt(2): the map error is the length of a vector of two axes
        principal_point_ratio=float(np.sqrt(2.0) * principal_point_arcsec.max() / predicted),
        runs_not_converged=case.monte_carlo.not_converged,
        positions=len(readings.position_px),
        centroid_error_px=np.sqrt(((readings.position_px - case.measurement.bundle_px) ** 2).mean(0)),
        centroid_predicted_px=np.sqrt((readings.sigma_px**2).mean(0)),
        error_map_arcsec=estimated.error_length_arcsec,
        sigma_map_arcsec=estimated.predicted_length_arcsec,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TableUnknown:
    """An unknown on both tables, in the unit that its name ends with; NaN on a table that does not have it.

    Truth of the camera: the model fitted to noise-free rays; of star, installation and axes: as set.
    """

    truth: FloatArray = col("Truth", "{unknown}", dims="table", shown=False)
    estimate: Sequence[Measured] = col("Run", "{unknown}", dims="table")
    pull: FloatArray = col("Pull", "", "+.2f", "table")
    sigma_bound: FloatArray = col("Cramér–Rao σ", "{unknown}", dims="table", shown=False)
    sigma_monte_carlo: FloatArray = col("Monte-Carlo σ", "{unknown}", dims="table", shown=False)
    rms_pull: Sequence[Measured] = col("RMS pull", "", ".2f", "table")
    correlation: FloatArray = col("Correlation", dims="table other", shown=False)


UNKNOWN_VALUES = (
    "truth",
    "estimate",
    "sigma",
    "pull",
    "sigma_bound",
    "sigma_monte_carlo",
    "rms_pull",
    "rms_pull_error",
)


def compare_unknown(name: str, cases: Sequence[TableCase]) -> TableUnknown:
    """Estimate, bound and Monte-Carlo of an unknown on all tables."""
    values = {field: np.full(len(cases), np.nan) for field in UNKNOWN_VALUES}
    correlation = np.full((len(cases), len(UNKNOWNS)), np.nan)
    for number, case in enumerate(cases):
        runs = case.monte_carlo
        solution = case.reductions["estimated"].calibration.solution
        if name not in runs.names:
            continue
        row = runs.names.index(name)
        values["truth"][number] = runs.truth[row]
        values["estimate"][number] = solution.value[row]
        values["sigma"][number] = solution.sigma[row]
        values["pull"][number] = solution.pulls(runs.truth)[row]
        values["sigma_bound"][number] = case.bound.of(name)
        values["sigma_monte_carlo"][number] = runs.error[:, row].std(ddof=1)
        values["rms_pull"][number] = runs.rms_pull[row]
        values["rms_pull_error"][number] = 1.0 / np.sqrt(2.0 * runs.runs)
        others = [list(UNKNOWNS).index(other) for other in runs.names]
        correlation[number, others] = solution.covariance[row] / (solution.sigma * solution.sigma[row])
    return TableUnknown(
        truth=values["truth"],
        estimate=measured(values["estimate"], values["sigma"], unit=unit_of(name)),
        pull=values["pull"],
        sigma_bound=values["sigma_bound"],
        sigma_monte_carlo=values["sigma_monte_carlo"],
        rms_pull=measured(values["rms_pull"], values["rms_pull_error"]),
        correlation=correlation,
    )


def unit_of(name: str) -> str:
    """Unit that the name of an unknown ends in."""
    return f"1/{name.rpartition('_per_')[2]}" if "_per_" in name else name.rpartition("_")[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseContribution:
    """Map error by a source of noise, propagated through the best estimator; squares add up to the bound."""

    noise_source: str = col("Noise of")
    contribution_arcsec: Sequence[float] = col("Map error,", "arcsec", ".3g", "table")


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorKnowledge:
    """Cramér-Rao bound of the map error with prior knowledge."""

    known: str = col("Known")
    map_bound_if_known_arcsec: Sequence[float] = col("Map error,", "arcsec", ".3g", "table")


@dataclass(frozen=True, slots=True, kw_only=True)
class VisitedPosition:
    """Positions of the star's image on a table."""

    commanded_px: FloatArray = col("Commanded", "px", dims="position axis")
    true_deg: FloatArray = col("True angle", "deg", dims="position turn")
    reading_deg: FloatArray = col("Reading", "deg", dims="position turn")
    bundle_px: FloatArray = col("Rays", "px", dims="position axis")
    centroid_px: FloatArray = col("Centroid", "px", dims="position axis")
    sigma_px: FloatArray = col("σ", "px", dims="position axis")
    # Centroid minus image predicted by the calibration (non-orthogonality estimated) at the angles as read
    residual_px: FloatArray = col("Residual", "px", dims="position axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class TurntableSetup:
    """Test conditions common to both tables."""

    lens: str = col("Lens")
    detector: str = col("Detector")
    focal_length_mm: float = col("Focal length", "mm", ".1f")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".2f")
    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    reading_noise_equal_to_centroids_arcsec: float = col("Reading noise equivalent to the centroids", "arcsec", ".3f")
    map_px: FloatArray = col("Points of the map", "px", dims="point axis")


def tabulate_positions(case: TableCase) -> VisitedPosition:
    """Images and angles of a table; NaN for the middle axis of a table of two."""
    visits = case.measurement.visits
    readings = case.measurement.readings
    angles = np.full((2, len(visits), 3), np.nan)
    axes = [0, 2] if visits.true_rad.shape[1] == 2 else [0, 1, 2]
    angles[:, :, axes] = np.degrees([visits.true_rad, visits.reading_rad])
    return VisitedPosition(
        commanded_px=visits.wanted_px,
        true_deg=angles[0],
        reading_deg=angles[1],
        bundle_px=case.measurement.bundle_px,
        centroid_px=readings.position_px,
        sigma_px=readings.sigma_px,
        residual_px=case.reductions["estimated"].residual_px,
    )


def describe_setup(
    config: TurntableCalibrationConfig, instrument: Instrument, traced: TracedMap, equal_arcsec: float
) -> TurntableSetup:
    """Light and lens."""
    star = star_signal(config, instrument)
    return TurntableSetup(
        lens=instrument.camera.lens.name,
        detector=instrument.detector.name,
        focal_length_mm=instrument.focal_length_mm,
        pixel_arcsec=instrument.pixel_arcsec,
        signal_e=star.signal_e,
        signal_star=star.star,
        reading_noise_equal_to_centroids_arcsec=equal_arcsec,
        map_px=traced.pixel_px,
    )


def axes(config: TurntableCalibrationConfig) -> Quantities:
    """Dimensions that sections share."""
    q = Quantities()
    q.axis("table", list(TABLES), "Table", names=TABLES)
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("turn", ["outer", "middle", "inner"], "Axis of the table")
    q.axis("reduction", list(REDUCTIONS), "Calibration with", names=REDUCTIONS)
    units = {name: unit_of(name) for name in UNKNOWNS}
    shown = {name: shown_unit(unit).translate(str.maketrans("246", "²⁴⁶")) for name, unit in units.items()}  # 1/mm²
    named = [f"{label} [{shown[name]}]" for name, label in UNKNOWNS.items()]
    q.axis("unknown", list(UNKNOWNS), "Unknown", names=named, units=list(units.values()))
    q.axis("other", list(UNKNOWNS), "Unknown", names=UNKNOWNS)
    return q


def run(config: TurntableCalibrationConfig, *, progress: Progress) -> dict[str, Any]:
    """Render, read, calibrate, and judge against the traced lens; then bounds and sweeps on coordinates."""
    instrument = prepare(config)
    streams = Streams(config.seed).child("turntable")
    study = config.study
    with progress.stage("trace"):
        traced = traced_map(config, instrument)
    cases = [calibrate_table(config, instrument, traced, key, streams, progress) for key in TABLES]
    two_axis = cases[0].coordinates
    with progress.stage("reading noise", total=len(study.reading_noise_arcsec)) as stage:
        readings = reading_sweep(
            two_axis,
            traced,
            streams.child("reading sweep"),
            study.reading_noise_arcsec,
            study.sweep_runs,
            advance=stage.advance,
        )
    with progress.stage("field of view"):
        sigma_px = float(np.sqrt((cases[0].measurement.readings.sigma_px ** 2).mean()))
        fields = field_sweep(study.field_deg, sigma_px)
    equal = equal_reading_noise_arcsec(readings, two_axis.with_reading_noise(0.0).map_bound_arcsec(traced))
    sources = list(dict.fromkeys(source for case in cases[::-1] for source in case.noise))
    return {
        "setup": describe_setup(config, instrument, traced, equal),
        "line_of_sight": [summarise_table(case, instrument.pixel_arcsec) for case in cases],
        "unknowns": [compare_unknown(name, cases) for name in UNKNOWNS],
        "noise": [
            NoiseContribution(
                noise_source=source, contribution_arcsec=[case.noise.get(source, np.nan) for case in cases]
            )
            for source in sources
        ],
        "prior_knowledge": [
            PriorKnowledge(known=known, map_bound_if_known_arcsec=[case.bounds_if_known[known] for case in cases])
            for known in cases[0].bounds_if_known
        ],
        "positions": [tabulate_positions(case) for case in cases],
        "readings": readings,
        "fields": fields,
    }


SECTIONS = {
    "setup": Section(
        record=TurntableSetup,
    ),
    "line_of_sight": Section(
        record=LineOfSight,
        dim="table",
        table="map_error",
        across="reduction axis",
        caption="Line of sight over the detector after the best rotation: RMS length of its error.",
        note="Run: rendered, against the traced lens; non-orthogonality of the axes estimated, ignored, "
        "or known. Predicted: by the estimator's covariance. Monte Carlo: without frames, ± "
        "standard error. Camera model: fitted to noise-free rays, against the traced lens.",
        figures={"error_map": maps("error_map_arcsec", place="map_px", panels="table")},
        verdicts=[
            below(
                "map_error_arcsec",
                "map_limit_arcsec",
                each="table",
                at={"reduction": "estimated"},
                whole="map_bound_arcsec",
                false_alarm=1 - RENDERED_QUANTILE,
                title="map error of the rendered run",
                advice="the readings, the centroids or the camera model are worse than stated",
            ),
            agree(
                "reduced_chi2",
                1.0,
                at={"reduction": "estimated"},
                square=True,
                title="mean square of the residuals over its prediction from centroids and readings",
                advice="the noise of readings or centroids differs from the stated noise",
            ),
            agree(
                "map_monte_carlo_arcsec",
                with_="map_bound_arcsec",
                slack=0.1,
                title="map error of the Monte-Carlo against its Cramér–Rao bound",
                advice="readings too coarse or field too small: the problem is not linear, as a covariance assumes",
            ),
            below(
                "camera_model_ratio",
                MAX_MODEL_RATIO,
                title="camera model against traced lens, over the predicted map error",
                advice="the lens needs a model with more terms than Brown-Conrady, or a smaller detector",
            ),
        ],
    ),
    "unknowns": Section(
        record=TableUnknown,
        dim="unknown",
        across="table",
        caption="Unknowns of the joint calibration.",
        note="Run: rendered, axis angles fitted, ± 1 σ of the estimator's covariance. Pull: (estimate − "
        "truth) / σ; the camera's truth is the model fitted to noise-free rays. RMS pull: over the "
        "Monte Carlo.",
        figures={"correlations": maps("correlation", panels="table", zero=True)},
        verdicts=[
            agree(
                "rms_pull",
                1.0,
                slack=PULL_SLACK,
                title="RMS pulls of the Monte-Carlo",
                advice="the covariance is wrong, because the problem is not linear: use finer readings or more of "
                "the field",
            )
        ],
    ),
    "noise": Section(
        record=NoiseContribution,
        dim="source",
        along="noise_source",
        table="noise_contributions",
        across="table",
        caption="Predicted contributions of the noise to the map error; their squares add up to the "
        "squared Cramér–Rao bound.",
    ),
    "prior_knowledge": Section(
        record=PriorKnowledge,
        dim="knowledge",
        along="known",
        across="table",
        caption="Cramér–Rao bound of the map error with additional knowledge.",
    ),
    "positions": Section(
        record=VisitedPosition,
        dim="table",
        rows="table position",
        across="axis turn",
        hidden="position",
        caption="All positions.",
    ),
    "readings": READINGS,
    "fields": FIELDS,
}
