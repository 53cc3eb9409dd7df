"""The numbers of the turntable calibration, each described once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.harness.quantities import Quantities
from experiments.laboratory.signal import add_signal
from experiments.laboratory.single_star.setup import star_signal
from experiments.turntable.bound import closed_form_px
from experiments.turntable.case import Case
from experiments.turntable.evaluation import vector_scatter_arcsec
from experiments.turntable.independent import Check, check_case
from experiments.turntable.monte_carlo import equal_reading_noise_arcsec
from experiments.turntable.result import Result
from optics.units import RAD_ARCSEC, RAD_DEG

__all__ = ["UNKNOWNS", "describe", "point_over_line", "unit_of"]

TABLES = ("two_axis", "three_axis")
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
    "lean1_rad": "lean, axis 2",
    "lean2_rad": "lean, axis 3",
}
"""Unknowns of the calibration, the last one on three axes only, and how they are written."""
SPLIT = {
    "model": "camera model alone (noise-free rays)",
    "centroids": "rendered centroids, true angles",
    "readings": "noise-free rays, angles as read",
    "leans": "noise-free rays, true angles, axes taken as square",
    "everything": "everything, leans estimated",
}
REDUCTIONS = {
    "estimated": "everything, leans estimated",
    "ignored": "everything, axes taken as square",
    "known": "everything, leans known",
}
HONEST_PULL = 1.1
"""RMS pull below which a covariance is called honest."""
LOUD_CHI2 = 1.3
"""Chi-square per degree of freedom from which residuals betray a wrong model."""


def unit_of(name: str) -> str:
    """Unit that the name of an unknown ends in."""
    return f"1/{name.rpartition('_per_')[2]}" if "_per_" in name else name.rpartition("_")[2]


def point_over_line(sigma_arcsec: float, map_arcsec: float) -> float:
    """How many times worse one coordinate of the principal point is known than the line of sight, both per axis.

    ``map_arcsec`` is an RMS length over two axes.
    """
    return float(sigma_arcsec / map_arcsec * np.sqrt(2.0))


def describe(result: Result) -> Quantities:
    """Quantities of a run: of both tables, of the sweeps, of ideal cameras and of lenses."""
    q = Quantities()
    q.axis("table", TABLES, "Table", names=[case.name for case in result.cases])
    q.axis("axis", ["x", "y"], "Axis")
    add_signal(q, star_signal(result.config, result.instrument))
    for name, label in UNKNOWNS.items():
        _unknown(q, result, name, label)
    _fit(q, result)
    _map(q, result)
    _independent(q, result)
    _bounds(q, result)
    _images(q, result)
    _places(q, result)
    _reading_sweep(q, result)
    _lean_sweep(q, result)
    _field_sweep(q, result)
    _lenses(q, result)
    return q


def _each(place: str) -> dict[str, str]:
    """Where ``summary.json`` has a quantity of the two tables."""
    return {key: f"{key}.{place}" for key in TABLES}


def _of_both(result: Result, part: Callable[[Case], Any]) -> list[Any]:
    return [part(case) for case in result.cases]


def _unknown(q: Quantities, result: Result, name: str, label: str) -> None:
    """One unknown: truth, rendered run, bound, Monte-Carlo."""
    truth, value, sigma, pull, bound, spread, rms_pull = np.array(_of_both(result, lambda c: _found(c, name))).T
    estimated = [key for key, case in zip(TABLES, result.cases, strict=True) if name in case.monte_carlo.names]
    of_camera = name in result.cases[0].coordinates.model.parameter_names

    def place(end: str) -> dict[str, Any]:
        return {key: f"{key}.unknowns.{name}.{end}" for key in estimated}

    given: dict[str, Any] = {"unit": unit_of(name), "dims": "table"}
    fitted = {key: [at, f"{key}.camera_model_fitted_to_rays.{name}"] for key, at in place("truth").items()}
    q.add(name, value, label, **given, error=sigma, json=place("estimate"))
    q.add(f"{name}_truth", truth, f"{label}, truth", **given, json=fitted if of_camera else place("truth"))
    q.add(f"{name}_bound", bound, f"{label}, Cramér–Rao σ", **given, json="")
    q.add(f"{name}_monte_carlo", spread, f"{label}, Monte-Carlo σ", **given, json="")
    q.add(f"{name}_pull", pull, f"{label}, pull of the rendered run", dims="table", json="")
    q.add(f"{name}_rms_pull", rms_pull, f"{label}, RMS pull", dims="table", json=place("monte_carlo_rms_pull"))


def _found(case: Case, name: str) -> list[float]:
    """Truth, estimate, sigma and pull of the rendered run, bound, Monte-Carlo sigma and RMS pull; NaN if it is none."""
    found, solution = case.monte_carlo, case.reductions["estimated"].calibration.solution
    if name not in found.names:
        return [np.nan] * 7
    at = found.names.index(name)
    rendered = [solution.value[at], solution.sigma[at], solution.pulls(found.truth)[at]]
    return [found.truth[at], *rendered, case.bound.of(name), found.error[:, at].std(ddof=1), found.pull_std[at]]


def _fit(q: Quantities, result: Result) -> None:
    """How the calibrations ended."""
    q.axis("reduction", list(REDUCTIONS), "Calibration with", names=REDUCTIONS)
    solutions = _of_both(result, lambda c: [c.reductions[name].calibration.solution for name in REDUCTIONS])
    chi2 = [[one.reduced_chi2 for one in row] for row in solutions]
    q.add("reduced_chi2", chi2, "χ²/dof", dims="table reduction", json=_each("reduced_chi2"))
    for name, label, values in (
        ("degrees_of_freedom", "Degrees of freedom", [row[0].degrees_of_freedom for row in solutions]),
        ("condition", "Condition", [row[0].condition for row in solutions]),
        ("iterations", "Iterations", [row[0].iterations for row in solutions]),
        ("runs", "Runs that converged", _of_both(result, lambda c: c.monte_carlo.runs)),
        ("lost_runs", "Runs that did not converge", _of_both(result, lambda c: c.monte_carlo.lost)),
    ):
        shown = name not in ("degrees_of_freedom", "runs")
        q.add(name, values, label, dims="table", json=_each(name) if shown else "")
    lost = sum(not one.converged for row in solutions for one in row) + sum(c.monte_carlo.lost for c in result.cases)
    q.add("lost", lost, "Calibrations that did not converge", json="")


def _map(q: Quantities, result: Result) -> None:
    """Line of sight of the rendered run against the traced lens, the best rotation removed, RMS length."""
    q.axis("split", list(SPLIT), "Map error of a calibration with", names=SPLIT)
    angle: dict[str, Any] = {"unit": "arcsec", "format": ".3g"}
    for name, dim, part, keys in (
        ("map_error_arcsec", "reduction", "reductions", REDUCTIONS),
        ("map_split_arcsec", "split", "split", SPLIT),
    ):
        values = [[getattr(c, part)[key].line_of_sight.rms_arcsec for key in keys] for c in result.cases]
        q.add(name, values, "Map error", **angle, dims=f"table {dim}", key="{table}", json=_each(name))
    predicted = np.array(_of_both(result, lambda c: c.reductions["estimated"].line_of_sight.predicted_rms_arcsec))
    found = [c.monte_carlo for c in result.cases]
    bounds = np.array(_of_both(result, lambda c: c.bound.map_sigma_arcsec))
    simulated, runs = np.array([one.map_arcsec for one in found]), [one.runs for one in found]
    for name, label, one, n in (
        ("map_predicted_arcsec", "Map error, predicted", predicted, None),
        ("map_bound_arcsec", "Map error, Cramér–Rao", bounds, None),
        ("map_monte_carlo_arcsec", "Map error, Monte-Carlo", simulated, runs),
    ):
        q.add(name, one, label, **angle, dims="table", n=n, json=_each(name))
    sigma = np.stack([q.dataset[f"{name}_error"].values for name in ("x0_px", "y0_px")], axis=1)
    sigma = sigma * result.instrument.pixel_arcsec
    name = "principal_point_sigma_arcsec"
    q.add(name, sigma, "Principal point alone", unit="arcsec", dims="table axis", format=".0f", json=_each(name))
    elevation = q.dataset["star_elevation_rad_error"].values * RAD_ARCSEC
    q.add("star_elevation_sigma_arcsec", elevation, "Star's elevation, σ", unit="arcsec", dims="table", json="")
    ratio = [point_over_line(s.max(), p) for s, p in zip(sigma, predicted, strict=True)]
    q.add("point_over_line", ratio, "Principal point over line of sight", dims="table", format=".0f", json="")


def _independent(q: Quantities, result: Result) -> None:
    """What written-out equations say of the same data (`experiments.turntable.independent`)."""
    found = _of_both(result, lambda case: check_case(result, case))
    for name, label in Check.LABELS.items():
        values = [getattr(one, name) for one in found]
        q.add(name, values, label, dims="table", format=".2g", json=_each(f"independent.{name}"))


def _bounds(q: Quantities, result: Result) -> None:
    """What the noise contributes, and what it would be worth to know more; both predicted."""
    q.axis("known", list(result.cases[0].knowledge), "Known besides")
    given: dict[str, Any] = {"dims": "table known", "format": ".3g"}
    for name, unit, label, part, json in (
        ("known_x0_px", "px", "σ(x₀)", lambda b: b.of("x0_px"), ""),
        ("known_y0_px", "px", "σ(y₀)", lambda b: b.of("y0_px"), ""),
        ("known_map_arcsec", "arcsec", "map", lambda b: b.map_sigma_arcsec, _each("map_bound_if_known_arcsec")),
    ):
        values = [[part(b) for b in c.knowledge.values()] for c in result.cases]
        q.add(name, values, label, unit=unit, **given, key=name.replace("known", "{table}"), json=json)
    causes = list(result.cases[1].shares)
    q.axis("cause", causes, "Cause")
    name, label = "noise_shares_arcsec", "Map error"
    shares = np.array([[c.shares.get(cause, np.nan) for cause in causes] for c in result.cases])
    given = {"unit": "arcsec", "format": ".4f", "key": "{table}", "json": _each(name)}
    q.add(name, shares, label, dims="table cause", **given)
    largest = np.nanargmax(shares, axis=1)
    fraction = np.nanmax(shares, axis=1) ** 2 / np.nansum(shares**2, axis=1)
    q.add("largest_share", [causes[at] for at in largest], "Largest cause", dims="table", json="")
    q.add("largest_share_fraction", fraction, "Its part of the variance", dims="table", format=".0%", json="")


def _images(q: Quantities, result: Result) -> None:
    """Centroids against the traced rays, RMS over the places; star vectors made of them."""
    bias = [c.measurement.readings.position_px - c.measurement.bundle_px for c in result.cases]
    predicted = _of_both(result, lambda c: np.einsum("nii->ni", c.measurement.readings.covariance_px2).mean(0))
    pixel: dict[str, Any] = {"unit": "px", "dims": "table axis", "format": ".4f"}
    q.add("places", [len(one) for one in bias], "Places", dims="table", json=_each("centroid_error_px.n"))
    q.add(
        "centroid_error_px",
        [np.sqrt((one**2).mean(0)) for one in bias],
        "Error",
        **pixel,
        key="centroid_{axis}",
        json=_each("centroid_error_px.rms"),
    )
    q.add(
        "centroid_predicted_px",
        np.sqrt(predicted),
        "Predicted",
        **pixel,
        key="predicted_{axis}",
        json=_each("centroid_predicted_px"),
    )
    scatter = np.array(_of_both(result, lambda c: vector_scatter_arcsec(c.reductions["known"], c.measurement)))
    angle: dict[str, Any] = {"unit": "arcsec", "dims": "table", "format": ".3f"}
    for number, (name, label) in enumerate((("along_x", "Vectors along X"), ("across", "across"))):
        key, place = f"vector_{number + 1}_arcsec", _each(f"star_vector_scatter_arcsec.{name}")
        q.add(f"vector_{name}_arcsec", scatter[:, number], label, **angle, key=key, json=place)


def _places(q: Quantities, result: Result) -> None:
    """Every place that the image visited."""

    def add(name: str, label: str, part: Callable[[Case], Any]) -> None:
        key = name.replace("_px", "_{axis}_px").removeprefix("place_")
        q.add(name, _of_both(result, part), label, unit="px", dims="table place axis", key=key, json="")

    def angles(name: str, label: str, part: Callable[[Case], Any]) -> None:
        for number in range(3):
            degrees = _of_both(result, lambda c: _column(part(c) * RAD_DEG, number))  # noqa: B023  # called at once
            one = f"{name}_{number + 1}_deg"
            q.add(one, degrees, f"{label} {number + 1}", unit="deg", dims="table place", json="")

    add("wanted_px", "Wanted", lambda c: c.measurement.visits.wanted_px)
    angles("true", "True angle", lambda c: c.measurement.visits.true_rad)
    angles("reading", "Reading", lambda c: c.measurement.visits.reading_rad)
    add("bundle_px", "Rays", lambda c: c.measurement.bundle_px)
    add("place_centroid_px", "Centroid", lambda c: c.measurement.readings.position_px)
    add("sigma_px", "Sigma", lambda c: np.sqrt(np.einsum("nii->ni", c.measurement.readings.covariance_px2)))
    add("residual_px", "Residual", lambda c: c.reductions["estimated"].residual_px)


def _column(values: Any, number: int) -> Any:
    """A column of an array, NaN if it has none of that number."""
    return values[:, number] if number < values.shape[1] else np.full(len(values), np.nan)


def _reading_sweep(q: Quantities, result: Result) -> None:
    """Map error against the error of a place's mean reading, two-axis table."""
    points = result.reading_sweep
    noise, bound = (np.array([getattr(p, part) for p in points]) for part in ("reading_arcsec", "bound_arcsec"))
    measured, pull = (np.array([getattr(p, part) for p in points]) for part in ("measured_arcsec", "pull_rms"))
    q.axis("reading", noise, "Mean reading", unit="arcsec", format="g", key="reading_noise_arcsec")
    angle, place = {"unit": "arcsec", "dims": "reading"}, "reading_sweep[reading]"
    q.add("reading_arcsec", noise, "Noise of the mean reading", **angle, json=f"{place}.reading_arcsec")
    q.add(
        "reading_map_arcsec",
        measured,
        "Map error",
        **angle,
        error=[p.uncertainty_arcsec for p in points],
        n=[p.runs for p in points],
        key="map_error",
        json=f"{place}.measured_arcsec",
        json_error=f"{place}.uncertainty_arcsec",
    )
    q.add(
        "reading_bound_arcsec",
        bound,
        "Cramér–Rao bound",
        **angle,
        format=".4f",
        key="bound",
        json=f"{place}.bound_arcsec",
    )
    q.add("reading_ratio", measured / bound, "Ratio", dims="reading", format=".3f", key="ratio", json="")
    q.add("reading_pull", pull, "RMS pull", dims="reading", format=".3f", key="rms_pull", json=f"{place}.pull_rms")
    runs, label = [p.runs for p in points], f"converged of {result.config.study.sweep_runs}"
    q.add("reading_runs", runs, label, dims="reading", key="runs", json=f"{place}.runs")
    honest = noise[pull < HONEST_PULL].tolist()
    q.add("honest_reading_arcsec", max(honest, default=np.nan), "Honest up to", unit="arcsec", format="g", json="")
    name = "reading_noise_equal_to_centroids_arcsec"
    equal = equal_reading_noise_arcsec(points, result.centroid_bound_arcsec)
    q.add(name, equal, "Reading noise that counts like the centroids", unit="arcsec", format=".3f")


def _lean_sweep(q: Quantities, result: Result) -> None:
    """Map error against the non-orthogonality, two-axis table."""
    points, place = result.lean_sweep, "lean_sweep[lean]"
    lean, chi2 = (np.array([getattr(p, part) for p in points]) for part in ("lean_arcsec", "ignored_reduced_chi2"))
    key = "non_orthogonality_arcsec"
    q.axis("lean", lean, "Non-orthogonality", unit="arcsec", format="g", key=key)
    q.add("lean_arcsec", lean, "Non-orthogonality", unit="arcsec", dims="lean", json=f"{place}.lean_arcsec")
    for name, label in (("ignored", "Taken as square"), ("estimated", "Estimated")):
        q.add(
            f"lean_{name}_arcsec",
            [getattr(p, f"{name}_arcsec") for p in points],
            label,
            unit="arcsec",
            dims="lean",
            error=[getattr(p, f"{name}_uncertainty_arcsec") for p in points],
            n=[p.runs for p in points],
            key=name,
            json=f"{place}.{name}_arcsec",
            json_error=f"{place}.{name}_uncertainty_arcsec",
        )
    chi2_place = {"key": "ignored_reduced_chi2", "json": f"{place}.ignored_reduced_chi2"}
    q.add("lean_ignored_chi2", chi2, "its χ²/dof", dims="lean", format=".2f", **chi2_place)
    q.add("lean_runs", [p.runs for p in points], "Runs", dims="lean", json=f"{place}.runs")
    loud = lean[chi2 > LOUD_CHI2].tolist()
    q.add("loud_lean_arcsec", min(loud, default=np.nan), "Betrayed from", unit="arcsec", format="g", json="")


def _field_sweep(q: Quantities, result: Result) -> None:
    """Bounds for ideal cameras over their field of view."""
    points, place = result.field_sweep, "field_sweep[field]"
    field, scale = (np.array([getattr(p, part) for p in points]) for part in ("field_deg", "arcsec_per_px"))
    q.axis("field", field, "Field", unit="deg", format="g", key="field_deg")
    q.add("field_deg", field, "Full field of view", unit="deg", dims="field", json=f"{place}.field_deg")
    full, rolled, plain = (np.array([getattr(p, k).of("x0_px") for p in points]) for k in ("full", "rolled", "plain"))
    full_map, rolled_map = (np.array([getattr(p, k).map_sigma_arcsec for p in points]) for k in ("full", "rolled"))
    rolled_place = "map_sigma_rolled_arcsec"
    closed = [closed_form_px(float(one), result.field_sigma_px) for one in field]
    ratio = [point_over_line(*one) for one in zip(full * scale, full_map, strict=True)]
    inflation, condition = [p.full.inflation("x0_px") for p in points], [p.full.condition for p in points]
    for name, values, label, unit, form, key, json in (
        ("field_x0_px", full, "σ(x₀)", "px", ".3g", "x0_px", "principal_point_sigma_px"),
        ("field_x0_arcsec", full * scale, "σ(x₀)", "arcsec", ".3g", "x0_arcsec", "principal_point_sigma_arcsec"),
        ("field_inflation", inflation, "inflated", "", ".0f", "inflation", "principal_point_inflation"),
        ("field_map_arcsec", full_map, "Map", "arcsec", ".4f", "map_arcsec", "map_sigma_arcsec"),
        ("field_rolled_x0_px", rolled, "σ(x₀), rolled", "px", ".3g", "rolled_x0_px", ""),
        ("field_rolled_x0_arcsec", rolled * scale, "σ(x₀), rolled", "arcsec", ".3g", "", ""),
        ("field_rolled_map_arcsec", rolled_map, "Map, rolled", "arcsec", ".4f", "rolled_map_arcsec", rolled_place),
        ("field_condition", condition, "Condition", "", ".1e", "condition", "condition"),
        ("field_plain_x0_px", plain, "σ(x₀), only x₀, y₀, f, M unknown", "px", ".3g", "", ""),
        ("field_plain_x0_arcsec", plain * scale, "σ(x₀), only x₀, y₀, f, M unknown", "arcsec", ".3g", "", ""),
        ("field_closed_px", closed, "its closed form", "px", ".3g", "", ""),
        ("field_closed_arcsec", closed * scale, "its closed form", "arcsec", ".3g", "", ""),
        ("field_image_arcsec", result.field_sigma_px * scale, "A single image", "arcsec", ".3g", "", ""),
        ("field_point_over_line", ratio, "Principal point over line of sight", "", ".0f", "", ""),
    ):
        at = f"{place}.{json}" if json else ""
        q.add(name, values, label, unit=unit, dims="field", format=form, key=key, json=at)
    q.add("field_sigma_px", result.field_sigma_px, "Error of an image", unit="px", format=".3g", json="")


def _lenses(q: Quantities, result: Result) -> None:
    """What the camera model leaves of a lens."""
    for part, label, unit, form in (
        ("label", "Lens", "", ""),
        ("field_deg", "Diagonal field", "deg", ".1f"),
        ("rms_arcsec", "RMS", "arcsec", ".3g"),
        ("max_arcsec", "largest", "arcsec", ".3g"),
        ("max_px", "largest", "px", ".2g"),
    ):
        values = [getattr(point, part) for point in result.lenses]
        place = f"camera_model_on_lenses[lens].{part}"
        key = "lens" if part == "label" else part
        q.add(f"lens_{part}", values, label, unit=unit, dims="lens", format=form, key=key, json=place)
