"""The numbers of the experiment on attitude-correlated frames, each described once."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.acf.points import COMPARED
from experiments.acf.published import (
    FIG4_LARGEST_PX,
    FIG4_RMS_PX,
    RUNS,
    TABLE2_CALIBRATED,
    TABLE2_NAMES,
    TABLE2_TRUE,
    TABLE2_UNITS,
)
from experiments.acf.result import Result
from experiments.acf.statistics import (
    FIGURES,
    angles_in_degrees,
    correlation_of,
    expected_errors,
    failures,
    gains,
    method_errors,
    outside_limit,
    pooled_errors,
    published_deviation,
    pulls,
    reprojection_lengths,
    root_mean_square,
    table2_errors,
)
from experiments.harness.quantities import Quantities
from experiments.harness.summary import Measured

__all__ = ["METHOD_NAMES", "describe"]

METHOD_NAMES = {
    "acc": "ACC (as published)",
    "linked": "gyro of stated noise",
    "free": "free attitudes",
    "iac": "IAC, equal weights (as published)",
    "iac_full": "IAC, full weights",
}
CASES = {"assumed": "fig4", "inferred": "fig4_inferred"}
"""Pixel and stars of Fig. 4 -> where they stand: those that the settings assume; those that Table 2 implies."""


def describe(result: Result) -> Quantities:
    """Quantities of a run: Fig. 3 to 5 and Table 2, pulls, gains, and what the document leaves out."""
    q = Quantities()
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("noise", result.config.noise_px, "Star noise", unit="px", format=".2f", key="noise_px")
    q.axis("method", COMPARED, "Method", names=METHOD_NAMES)
    greek = {"phi": "φ", "theta": "θ"}
    names = [greek.get(name[:-1], name[:-1]) + name[-1] if name != "f" else name for name in TABLE2_NAMES]
    q.axis("unknown", TABLE2_NAMES, "Unknown", names=names)
    _night(q, result)
    _fig3(q, result)
    _fig4(q, result)
    _counts(q, result)
    _table2(q, result)
    _pulls(q, result)
    _fig5(q, result)
    _method_ratios(q)
    _gains(q, result)
    _inference(q, result)
    _failures(q, result)
    for name, label, unit in (
        ("images_off_px", "Stars off where eq. 1 to 6 put them, largest", "px"),
        ("adjusted_off_sigma", "Unknowns off those of eq. 11 written out, largest", "sigma"),
        ("moved_part", "Known moves of stars and sky, part that did not come back", ""),
    ):
        q.add(name, getattr(result.check, name), label, unit=unit, format=".1e", json=f"independent.{name}")
    return q


def _night(q: Quantities, result: Result) -> None:
    """The simulated night."""
    scene, table2 = result.scene, result.trials[result.plan.table2.name]
    q.add("stars_per_frame", len(result.stars) / result.config.frames, "Stars", unit="per frame", format=".0f")
    turned = np.degrees((scene.body * scene.body[0].inv()).magnitude().max())
    q.add("turned_deg", float(turned), "Largest turn of the body", unit="deg", format=".1f", json="")
    start_deg = float(np.degrees(scene.attitude[0].magnitude()))
    q.add("start_deg", start_deg, "First attitude", unit="deg", format=".0f", json="")
    q.add("iterations", float(table2.of("acc", "iterations").mean()), "Iterations of ACC", format=".0f", json="")


def _settings(q: Quantities, part: str, **values: tuple[str, object]) -> None:
    """Settings (dimension, values) that a part of ``summary.json`` repeats, so that it can be read alone."""
    for name, (dims, value) in values.items():
        q.add(f"{part}_{name}", value, dims=dims, json=f"{part}.{name}")


def _fig3(q: Quantities, result: Result) -> None:
    """Reprojection error by noise and gyro: a perfect one, then biases (a), then random walks (b)."""
    config = result.config
    found = reprojection_lengths(result, result.plan.fig3, result.expected.fig3)
    biases = (0.0, *config.bias_deg_per_h)
    walks = (0.0, *config.angle_random_walk_deg_per_sqrt_h)
    q.axis("bias", biases, "Bias", unit="°/h", format="g")
    q.axis("walk", walks, "Angle random walk", unit="°/√h", format="g")
    columns = list(range(len(biases) + len(walks) - 1))
    for part, gyro, of in (("fig3a", "bias", columns[: len(biases)]), ("fig3b", "walk", [0, *columns[len(biases) :]])):
        pixel: dict[str, Any] = {"unit": "px", "dims": ("noise", gyro), "format": ".4f"}
        q.add(
            f"{part}_rms_px",
            found["mean"][:, of],
            "RMS reprojection error",
            **pixel,
            error=found["error"][:, of],
            json=f"{part}.rms_px",
            json_error=f"{part}.error_px",
        )
        q.add(f"{part}_expected_px", found["expected"][:, of], "expected", **pixel, json=f"{part}.expected_px")
        q.add(f"{part}_deviation", found["deviation"][:, of], "Deviation", unit="sigma", dims=("noise", gyro), json="")
    both = {"noise_px": ("noise", config.noise_px), "n": ("", config.runs)}
    _settings(q, "fig3a", **both, bias_deg_per_h=("bias", biases))
    _settings(q, "fig3b", **both, angle_random_walk_deg_per_sqrt_h=("walk", walks))


def _fig4(q: Quantities, result: Result) -> None:
    """Reprojection errors at one noise, with the assumed pixel and stars and with the inferred ones."""
    plan, config = result.plan, result.config
    points, expected = (plan.table2, plan.inferred), (result.expected.fig4, result.expected.inferred)
    trials = [result.trials[point.name] for point in points]
    q.axis("case", list(CASES), "Fig. 4", names=["ours", "inferred"])

    def place(name: str) -> dict[str, str]:
        return {case: f"{part}.{name}" for case, part in CASES.items()}

    rms, error = np.swapaxes([root_mean_square(one.of("acc", "reprojection_px2"), 0) for one in trials], 0, 1)
    lengths = [np.linalg.norm(one.of("acc", "reprojected_px"), axis=2) for one in trials]
    by_axis = {"unit": "px", "dims": "case axis", "format": ".4f"}
    q.add(
        "fig4_rms_px", rms, "RMS", **by_axis, error=error, json=place("rms_px"), json_error=place("error_px"), key="rms"
    )
    q.add("fig4_expected_axis_px", [one.axis_px for one in expected], **by_axis, json=place("expected_px"))
    q.add("fig4_published_px", [FIG4_RMS_PX] * 2, "Published RMS", **by_axis, json=place("published_px"))
    q.add("fig4_assumed_rms_px", rms[0], "RMS", unit="px", dims="axis", json="fig4_rms_px")
    runs = reprojection_lengths(result, points, [[one] for one in expected])
    mean = [
        Measured(value=float(value), unit="px", uncertainty=float(error), n=config.runs)
        for value, error in zip(runs["mean"][:, 0], runs["error"][:, 0], strict=True)
    ]
    q.add("published_length_px", float(np.linalg.norm(FIG4_RMS_PX)), "Published RMS", unit="px", format=".4f", json="")
    q.add("published_runs", RUNS, "Runs", json="")
    stars = [len(result.stars) / config.frames, float(plan.inferred.stars or 0)]
    apart = [published_deviation(one) for one in expected]
    apart_of_mean = [one * RUNS**0.5 for one in apart]
    for name, label, unit, format, key, values, json in (
        ("length_px", "Length", "px", ".4f", "rms_length_px", mean, "mean_rms_length_px"),
        ("expected_px", "Expected", "px", ".4f", "expected_px", runs["expected"][:, 0], ""),
        ("scatter_px", "One run ±", "px", ".4f", "scatter_px", runs["scatter"][:, 0], "scatter_of_a_run_px"),
        ("deviation", "Deviation", "sigma", "", "", runs["deviation"][:, 0], ""),
        ("published_deviation", "Published", "sigma", "+.1f", "", apart, "published_deviation_sigma"),
        ("published_deviation_of_mean", "", "sigma", "+.0f", "", apart_of_mean, "published_deviation_sigma_of_a_mean"),
        ("largest_px", "Largest, median", "px", ".4f", "", [np.median(one.max(1)) for one in lengths], "largest_px"),
        ("inside", "< 0.04 px", "", "", "", [(one < FIG4_LARGEST_PX).mean() for one in lengths], "part_below_0_04_px"),
        ("pixel_um", "Pixel", "um", ".2f", "pixel_um", [config.camera.pixel_um, plan.inferred.pixel_um], ""),
        ("stars", "Stars", "per frame", ".0f", "stars_per_frame", stars, ""),
    ):
        q.add(f"fig4_{name}", values, label, unit=unit, dims="case", format=format, key=key, json=json and place(json))


def _counts(q: Quantities, result: Result) -> None:
    """Reprojection error by stars per frame."""
    q.axis("count", result.config.counts, "Stars per frame")
    q.axis("count_gyro", ["perfect", "table1"], "Gyro", names=["perfect gyro", "Table 1's gyro"])
    found, dims = reprojection_lengths(result, result.plan.counts, result.expected.counts), "count count_gyro"
    label = "RMS reprojection error"
    q.add("counts_rms_px", found["mean"], label, unit="px", dims=dims, error=found["error"], json="")
    q.add("counts_deviation", found["deviation"], "Deviation", unit="sigma", dims=dims, json="")


def _table2(q: Quantities, result: Result) -> None:
    """Errors of the 14 unknowns, and what the design says of them."""
    found, expected, config = table2_errors(result), result.expected.table2, result.config
    true = np.concatenate([result.scene.camera.parameters, config.sky.phi_deg, config.gyro.installation_deg])
    mean, std = (np.array([of(column) for column in found.T]) for of in (np.mean, lambda one: one.std(ddof=1)))
    printed = TABLE2_CALIBRATED - TABLE2_TRUE
    bound, carried = (angles_in_degrees(np.sqrt(np.diag(one))) for one in (expected.perfect, expected.acc))
    for name, label, key, format, values in (
        ("unit", "Unit", "unit", "", TABLE2_UNITS),
        ("true", "True", "true", ".6g", true),
        ("published", "Published value", "published", "", TABLE2_CALIBRATED),
        ("published_error", "Published", "published_error", ".3g", printed),
        ("mean", "Mean", "mean", "", true + mean),
        ("mean_error", "Ours, mean", "mean_error", "", mean),
        ("std", "one run", "std", ".3g", std),
        ("bound", "Bound", "bound", ".3g", bound),
        ("bound_with_gyro_error", "with gyro", "bound_with_gyro", ".3g", carried),
        ("n", "Runs", "n", "", np.full(14, len(found))),
    ):
        json = f"table2[unknown].{name}"
        q.add(f"table2_{name}", values, label, dims="unknown", format=format, key=key, json=json)
    q.add("table2_published_ratio", np.abs(printed / std), "Published error", unit="sigma", dims="unknown", json="")
    deviation = np.abs(mean / carried) * np.sqrt(len(found))
    q.add("table2_deviation", deviation, "Deviation of the mean", unit="sigma", dims="unknown", json="")
    sight = result.trials[result.plan.table2.name].of("acc", "sight_arcsec")
    q.add(
        "table2_sight_arcsec", float(np.sqrt((sight**2).mean())), "Line of sight", unit="arcsec", format=".1f", json=""
    )
    correlation = correlation_of(expected.perfect)
    q.axis("coefficients", ["q1_q2", "q1_q3", "q2_q3"], "Coefficients")
    pairs = [correlation[3, 4], correlation[3, 5], correlation[4, 5]]
    q.add("correlation", pairs, "Correlation", dims="coefficients", format="+.3f")


def _pulls(q: Quantities, result: Result) -> None:
    """RMS errors over predicted standard deviations."""
    found = pulls(result)
    labels = {"own": "ACC, own covariance", "carried": "ACC, gyro carried through", "linked": "gyro of stated noise"}
    rms = {which: np.sqrt((found[which] ** 2).mean(0)) for which in labels}
    for which, label in labels.items():
        json = f"pulls.{which}"
        q.add(f"pull_{which}", rms[which], label, dims="unknown", format=".3f", key=which, json=json)
    n = len(found["own"])
    q.add("pull_n", n, "Runs", json="pulls.n")
    missed = outside_limit(rms["own"], n)
    q.axis("missed", np.array(TABLE2_NAMES)[missed], "Unknowns that miss ACC's own covariance")
    q.add("pull_own_missed", rms["own"][missed], "RMS pull", dims="missed", json="pulls.own_outside_limit")


def _fig5(q: Quantities, result: Result) -> None:
    """Errors of the methods against star noise, and with all noises together."""
    noise = np.array(result.config.noise_px)
    found = np.stack([method_errors(result, method)[0] for method in COMPARED], axis=1)
    error = np.stack([method_errors(result, method)[1] for method in COMPARED], axis=1)
    expected = np.stack([expected_errors(result, method) for method in COMPARED], axis=1)
    labels = ("x0", "y0", "f", "Distortion", "Line of sight")
    places = {"distortion_px": "largest_residual_distortion", "sight_arcsec": "line_of_sight"}
    for k, (name, label) in enumerate(zip(FIGURES, labels, strict=True)):
        place, _, unit = name.rpartition("_")
        json = f"fig5[method].{places.get(name, place)}"
        described = {"unit": unit, "dims": "method noise"}
        errors = {"error": error[k - 3], "json_error": f"{json}_error_{unit}"} if name in places else {}
        q.add(name, found[k], label, **described, **errors, json=f"{json}_{unit}")
        shown = f"fig5[method].expected_line_of_sight_{unit}" if name == "sight_arcsec" else ""
        q.add(f"expected_{name}", expected[k], "Expected", **described, json=shown)
    pooled = np.array([pooled_errors(result, method) for method in COMPARED])
    sight, sight_expected = found[4], expected[4]
    for name, label, unit, format, values in (
        ("x0_px", "x0", "px", ".2f", pooled[:, 0]),
        ("y0_px", "y0", "px", ".2f", pooled[:, 1]),
        ("f_um", "f", "um", ".2f", 1e3 * pooled[:, 2]),
        ("distortion_px", "Distortion, largest", "px", ".3f", (found[3] / noise).mean(1)),
        ("sight_arcsec", "Line of sight", "arcsec", ".2f", (sight / noise).mean(1)),
        ("expected_sight_arcsec", "expected", "arcsec", ".2f", (sight_expected / noise).mean(1)),
        ("over_acc", "over ACC", "", ".3f", (sight / sight[0]).mean(1)),
    ):
        q.add(f"pooled_{name}", values, label, unit=unit, dims="method", format=format, key=name, json="")
    _settings(q, "fig5", noise_px=("noise", noise), n=("", result.config.runs))


def _method_ratios(q: Quantities) -> None:
    """Ratios of RMS errors of two methods, all noises together."""
    data = q.dataset
    q.axis("ratio", ["iac_over_acc", "iac_full_over_free", "free_over_acc"], "Methods")
    q.axis("figure", ["x0", "y0", "f", "distortion", "line_of_sight"], "Error")

    def of(method: str, than: str) -> list[float]:
        a, b = (data.isel(method=COMPARED.index(name)) for name in (method, than))
        pooled = [float(a[name] / b[name]) for name in ("pooled_x0_px", "pooled_y0_px", "pooled_f_um")]
        return pooled + [float(np.mean(a[name].values / b[name].values)) for name in FIGURES[3:]]

    ratios = [of("iac", "acc"), of("iac_full", "free"), of("free", "acc")]
    q.add("method_ratio", ratios, "Ratio of errors", dims="ratio figure", format=".2f", json="fig5[ratio]")


def _gains(q: Quantities, result: Result) -> None:
    """Gain over free attitudes against stars per frame and gyro noise."""
    sweep, found = result.config.sweep, gains(result)
    q.axis("stars", sweep.stars, "Stars", key="stars_per_frame")
    q.axis("factor", sweep.gyro_factor, "Gyro noise", format="g")
    for name, label, error, json in (
        ("acc", "ACC", "acc_error", "acc"),
        ("acc_bound", "expected", "", "acc_bound"),
        ("linked", "weighted", "linked_error", "linked"),
        ("linked_bound", "bound", "", "linked_bound"),
        ("point", "ACC, principal point", "", "principal_point_acc"),
        ("point_bound", "expected", "", "principal_point_acc_bound"),
    ):
        errors: dict[str, Any] = {"error": found[error], "json_error": f"gain_sweep.{error}"} if error else {}
        q.add(
            f"gain_{name}", found[name], label, dims="stars factor", format=".2f", **errors, json=f"gain_sweep.{json}"
        )
    known = {"stars_per_frame": ("stars", sweep.stars), "gyro_factor": ("factor", sweep.gyro_factor)}
    _settings(q, "gain_sweep", **known, n=("", sweep.skies))


def _inference(q: Quantities, result: Result) -> None:
    """Pixel and stars that the document's own numbers imply."""
    found = result.inference
    pixel = Measured(value=found.best_um, unit="um", uncertainty=found.sigma_um, n=11)
    q.add("implied_pixel_um", pixel, "Pixel", json="inference.pixel_um")
    q.add("implied_stars", found.best_stars, "Stars", unit="per frame", format=".0f", json="inference.stars_per_frame")
    between = [found.low_stars, found.high_stars]
    q.add("implied_stars_range", between, "Stars", dims="end", json="inference.stars_per_frame_range")
    q.add("implied_chi2", found.chi2, "χ² of 11", format=".1f", json="inference.chi2_of_11")
    at_assumed = "inference.chi2_of_11_at_assumed_pixel"
    q.add("implied_chi2_assumed", found.chi2_assumed, "χ² of 11", format=".0f", json=at_assumed)
    matching = result.expected.matching
    for name, label, values in (
        ("pixel_um", "Pixel", [one.pixel_um for one in matching]),
        ("closed_form", "Stars, perfect gyro", [one.closed_form for one in matching]),
        ("with_gyro", "Stars, Table 1's gyro", [one.with_gyro for one in matching]),
        ("range", "Stars", [(one.low, one.high) for one in matching]),
    ):
        dims = "pixel end" if name == "range" else "pixel"
        q.add(f"fig4_stars_{name}", values, label, dims=dims, json=f"inference.stars_for_fig4[pixel].{name}")


def _failures(q: Quantities, result: Result) -> None:
    """Adjustments that did not converge; in the sweep some are expected: two stars in a frame, a gyro too bad."""
    plan, sweep = result.plan, {point.name for point in result.plan.sweep}
    q.axis("swept", ["acc", "linked", "free"], "Method")
    for part, dim, points in (
        ("figures", "method", [point for point in plan.points if point.name not in sweep]),
        ("gain_sweep", "swept", plan.sweep),
    ):
        found = failures(result.trials, points)
        counts = np.array([found[str(method)] for method in q.dataset.coords[dim].values])
        for k, name in enumerate(("failed", "n")):
            json = f"not_converged.{part}[{dim}].{name}"
            q.add(f"{part}_adjustments_{name}", counts[:, k], name, dims=dim, json=json)
