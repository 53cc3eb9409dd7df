"""Tables of the turntable calibration."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.harness.summary import Measured
from experiments.harness.tables import Column, Table
from experiments.turntable.evaluate import vector_scatter_arcsec
from experiments.turntable.result import Case, Result
from optics.units import RAD_ARCSEC

__all__ = ["all_tables", "unknown_label"]

_LABELS = {
    "x0_px": ("x₀", "px", 1.0),
    "y0_px": ("y₀", "px", 1.0),
    "focal_length_mm": ("f", "mm", 1.0),
    "q1_per_mm2": ("q₁", "mm⁻²", 1.0),
    "q2_per_mm4": ("q₂", "mm⁻⁴", 1.0),
    "q3_per_mm6": ("q₃", "mm⁻⁶", 1.0),
    "p1_per_mm": ("p₁", "mm⁻¹", 1.0),
    "p2_per_mm": ("p₂", "mm⁻¹", 1.0),
    "star_azimuth_rad": ("star az.", "″", RAD_ARCSEC),
    "star_elevation_rad": ("star el.", "″", RAD_ARCSEC),
    "theta1_rad": ("θ₁", "″", RAD_ARCSEC),
    "theta2_rad": ("θ₂", "″", RAD_ARCSEC),
    "theta3_rad": ("θ₃", "″", RAD_ARCSEC),
    "lean1_rad": ("lean, axis 2", "″", RAD_ARCSEC),
    "lean2_rad": ("lean, axis 3", "″", RAD_ARCSEC),
}


def unknown_label(name: str) -> tuple[str, str, float]:
    """Label, unit and factor of an unknown."""
    return _LABELS.get(name, (name, "", 1.0))


def _unknowns(case: Case) -> Table:
    solution, found = case.reductions["estimated"].calibration.solution, case.monte_carlo
    truth, pulls = found.truth, solution.pulls(found.truth)
    rows = []
    for i, name in enumerate(solution.names):
        label, unit, factor = unknown_label(name)
        estimate = Measured(value=float(solution.value[i] * factor), uncertainty=float(solution.sigma[i] * factor))
        spread = float(found.error[:, i].std(ddof=1) * factor) if found.runs > 1 else None
        rows.append(
            (
                label,
                unit,
                float(truth[i] * factor),
                estimate,
                float(pulls[i]),
                case.bound.of(name) * factor,
                spread,
                float(found.pull_std[i]) if found.runs else None,
            )
        )
    return Table(
        columns=(
            "Unknown",
            Column(name="in", key="unit_of_row"),
            Column(name="Truth", key="truth"),
            Column(name="Rendered run", key="estimate"),
            Column(name="Pull", key="pull", format="+.2f"),
            Column(name="Cramér–Rao σ", key="bound"),
            Column(name="Monte-Carlo σ", key="monte_carlo"),
            Column(name="RMS pull", key="rms_pull", format=".3f"),
        ),
        rows=rows,
        caption=f"Unknowns on the {case.name} table.",
        note="Truth of the camera: the model fitted to the traced rays without noise; of star, installation (θ), axes: "
        f"as set. Uncertainties are 1 σ of the estimator's covariance. Monte-Carlo: {found.runs} runs on coordinates.",
    )


def _split(result: Result) -> Table:
    labels = {
        "model": "camera model alone (noise-free rays)",
        "centroids": "rendered centroids, true angles",
        "readings": "noise-free rays, angles as read",
        "leans": "noise-free rays, true angles, axes taken as square",
        "everything": "everything, leans estimated",
    }
    rows: list[tuple[str | float, ...]] = []
    for key, label in labels.items():
        values = [case.split[key].line_of_sight.rms_arcsec for case in result.cases]
        rows.append((label, *values))
    rows.append(
        ("… predicted", *(case.reductions["estimated"].line_of_sight.predicted_rms_arcsec for case in result.cases))
    )
    rows.append(("everything, axes taken as square", *_of(result, "ignored")))
    rows.append(("everything, leans known", *_of(result, "known")))
    return Table(
        columns=(
            "Map error of a calibration with",
            *(Column(name=case.name, unit="″", key=case.name.replace("-", "_"), format=".3g") for case in result.cases),
        ),
        rows=rows,
        caption="Where the map error comes from.",
        note="RMS length of the line-of-sight error over the detector after the best rotation, one realisation each.",
    )


def _of(result: Result, key: str) -> list[float]:
    return [case.reductions[key].line_of_sight.rms_arcsec for case in result.cases]


def _shares(result: Result) -> Table:
    names = max((list(case.shares) for case in result.cases), key=len)
    rows: list[tuple[str | float | None, ...]] = [
        (name, *(case.shares.get(name) for case in result.cases)) for name in names
    ]
    rows.append(("together", *(case.bound.map_sigma_arcsec for case in result.cases)))
    return Table(
        columns=(
            "Cause",
            *(Column(name=case.name, unit="″", key=case.name.replace("-", "_"), format=".4f") for case in result.cases),
        ),
        rows=rows,
        caption="What the noise contributes to the map error, predicted.",
        note="Each noise carried through the best estimator; the squares add up to the Cramér–Rao bound.",
    )


def _knowledge(result: Result) -> Table:
    rows: list[tuple[str | float, ...]] = []
    for label in result.cases[0].knowledge:
        line: list[str | float] = [label]
        for case in result.cases:
            found = case.knowledge[label]
            line += [found.of("x0_px"), found.of("y0_px"), found.map_sigma_arcsec]
        rows.append(tuple(line))
    columns = [
        Column(name=f"{what} ({axes})", unit=unit, key=f"{case.name.replace('-', '_')}_{key}", format=".3g")
        for case, axes in zip(result.cases, "23", strict=True)
        for what, unit, key in (("σ(x₀)", "px", "x0_px"), ("σ(y₀)", "px", "y0_px"), ("map", "″", "map_arcsec"))
    ]
    return Table(
        columns=("Known besides", *columns),
        rows=rows,
        caption="What it would be worth to know more (Cramér–Rao).",
        note="(2), (3): on the table of two, of three axes. Map: RMS length of the error after the best rotation.",
    )


def _readings(result: Result) -> Table:
    rows = [
        (
            p.reading_arcsec,
            Measured(value=p.measured_arcsec, uncertainty=p.uncertainty_arcsec, n=p.runs),
            p.bound_arcsec,
            p.measured_arcsec / p.bound_arcsec,
            p.pull_rms,
            p.runs,
        )
        for p in result.reading_sweep
    ]
    return Table(
        columns=(
            Column(name="Mean reading", unit="″", key="reading_noise_arcsec", format="g"),
            Column(name="Map error", unit="″", key="map_error"),
            Column(name="Cramér–Rao bound", unit="″", key="bound", format=".4f"),
            Column(name="Ratio", key="ratio", format=".3f"),
            Column(name="RMS pull", key="rms_pull", format=".3f"),
            Column(name=f"converged of {result.config.study.sweep_runs}", key="runs"),
        ),
        rows=rows,
        caption="Map error against the reading noise, two-axis table.",
    )


def _leans(result: Result) -> Table:
    rows = [
        (
            p.lean_arcsec,
            Measured(value=p.ignored_arcsec, uncertainty=p.ignored_uncertainty_arcsec, n=p.runs),
            p.ignored_reduced_chi2,
            Measured(value=p.estimated_arcsec, uncertainty=p.estimated_uncertainty_arcsec, n=p.runs),
        )
        for p in result.lean_sweep
    ]
    return Table(
        columns=(
            Column(name="Non-orthogonality", unit="″", key="non_orthogonality_arcsec", format="g"),
            Column(name="Taken as square", unit="″", key="ignored"),
            Column(name="its χ²/dof", key="ignored_reduced_chi2", format=".2f"),
            Column(name="Estimated", unit="″", key="estimated"),
        ),
        rows=rows,
        caption="Map error against the non-orthogonality, two-axis table.",
    )


def _fields(result: Result) -> Table:
    rows = [
        (
            p.field_deg,
            p.full.of("x0_px"),
            p.full.of("x0_px") * p.arcsec_per_px,
            p.full.inflation("x0_px"),
            p.full.map_sigma_arcsec,
            p.rolled.of("x0_px"),
            p.rolled.map_sigma_arcsec,
            p.full.condition,
        )
        for p in result.field_sweep
    ]
    return Table(
        columns=(
            Column(name="Field", unit="deg", key="field_deg", format="g"),
            Column(name="σ(x₀)", unit="px", key="x0_px", format=".3g"),
            Column(name="σ(x₀)", unit="″", key="x0_arcsec", format=".3g"),
            Column(name="inflated", key="inflation", format=".0f"),
            Column(name="Map", unit="″", key="map_arcsec", format=".4f"),
            Column(name="σ(x₀), rolled", unit="px", key="rolled_x0_px", format=".3g"),
            Column(name="Map, rolled", unit="″", key="rolled_map_arcsec", format=".4f"),
            Column(name="Condition", key="condition", format=".1e"),
        ),
        rows=rows,
        caption="The near-degeneracy over the field of view (Cramér–Rao).",
        note=f"Ideal cameras of 2048 × 2048 px, 13 × 13 places, images good to {result.field_sigma_px:.3g} px per "
        "axis, all unknowns, perfect tables. Inflated: σ(x₀) over what it would be with everything else known. Rolled: "
        "quarter turns of a third axis from place to place. Map: RMS length after the best rotation.",
    )


def _lenses(result: Result) -> Table:
    return Table(
        columns=(
            "Lens",
            Column(name="Diagonal field", unit="deg", key="field_deg", format=".1f"),
            Column(name="RMS", unit="″", key="rms_arcsec", format=".3g"),
            Column(name="largest", unit="″", key="max_arcsec", format=".3g"),
            Column(name="largest", unit="px", key="max_px", format=".2g"),
        ),
        rows=[(p.label, p.field_deg, p.rms_arcsec, p.max_arcsec, p.max_px) for p in result.lenses],
        caption="What the camera model leaves of a lens: fitted to noise-free rays over the whole detector.",
    )


def _vectors(result: Result) -> Table:
    rows = []
    for case in result.cases:
        scatter = vector_scatter_arcsec(case)
        readings = case.measurement.readings
        bias = readings.position_px - case.measurement.bundle_px
        predicted = np.sqrt(np.einsum("nii->ni", readings.covariance_px2).mean(0))
        rows.append(
            (
                case.name,
                len(bias),
                *np.sqrt((bias**2).mean(0)).tolist(),
                *predicted.tolist(),
                *scatter.tolist(),
            )
        )
    return Table(
        columns=(
            "Table",
            Column(name="Places", key="places"),
            Column(name="Centroid error x", unit="px", key="centroid_x", format=".4f"),
            Column(name="y", unit="px", key="centroid_y", format=".4f"),
            Column(name="predicted x", unit="px", key="predicted_x", format=".4f"),
            Column(name="y", unit="px", key="predicted_y", format=".4f"),
            Column(name="Star vectors 1", unit="″", key="vector_1_arcsec", format=".3f"),
            Column(name="2", unit="″", key="vector_2_arcsec", format=".3f"),
        ),
        rows=rows,
        caption="Centroids against the traced rays, and star vectors in the table's initial frame.",
        note="Centroid errors of the mean over the frames, RMS over the places; prediction from photons, read noise, "
        "dark frames and PRNU. Star vectors (S300): scatter about their mean, along the laboratory's X and across.",
    )


def _places(result: Result) -> Table:
    rows = []
    for case in result.cases:
        measurement, fit = case.measurement, case.reductions["estimated"]
        visits, readings = measurement.visits, measurement.readings
        padded = [np.full((len(visits), 3), np.nan) for _ in range(2)]
        for target, angle in zip(padded, (visits.true_rad, visits.reading_rad), strict=True):
            target[:, : angle.shape[1]] = np.degrees(angle)
        numbers = np.hstack(
            [
                visits.wanted_px,
                *padded,
                measurement.bundle_px,
                readings.position_px,
                np.sqrt(np.einsum("nii->ni", readings.covariance_px2)),
                fit.residual_px,
            ]
        )
        rows += [(case.name, *line) for line in numbers.tolist()]
    columns = [
        *(Column(name=f"Wanted {a}", unit="px", key=f"wanted_{a}_px") for a in "xy"),
        *(Column(name=f"True angle {i}", unit="deg", key=f"true_{i}_deg") for i in (1, 2, 3)),
        *(Column(name=f"Reading {i}", unit="deg", key=f"reading_{i}_deg") for i in (1, 2, 3)),
        *(Column(name=f"Rays {a}", unit="px", key=f"bundle_{a}_px") for a in "xy"),
        *(Column(name=f"Centroid {a}", unit="px", key=f"centroid_{a}_px") for a in "xy"),
        *(Column(name=f"Sigma {a}", unit="px", key=f"sigma_{a}_px") for a in "xy"),
        *(Column(name=f"Residual {a}", unit="px", key=f"residual_{a}_px") for a in "xy"),
    ]
    return Table(columns=("Table", *columns), rows=rows, caption="All places.")


def _correlations(case: Case) -> Table:
    solution = case.reductions["estimated"].calibration.solution
    matrix = solution.covariance / np.outer(solution.sigma, solution.sigma)
    rows = [(name, *line) for name, line in zip(solution.names, matrix.tolist(), strict=True)]
    columns = [Column(name=name, key=name, format=".4f") for name in solution.names]
    return Table(columns=("Unknown", *columns), rows=rows, caption=f"Correlations on the {case.name} table.")


def all_tables(result: Result) -> Mapping[str, Table]:
    """Tables of the result by file name."""
    per_case = {}
    for case in result.cases:
        key = case.name.replace("-", "_")
        per_case[f"unknowns_{key}"] = _unknowns(case)
        per_case[f"correlation_{key}"] = _correlations(case)
    return {
        **per_case,
        "map_error": _split(result),
        "noise_shares": _shares(result),
        "knowledge": _knowledge(result),
        "reading_sweep": _readings(result),
        "lean_sweep": _leans(result),
        "field_sweep": _fields(result),
        "vectors": _vectors(result),
        "lenses": _lenses(result),
        "places": _places(result),
    }
