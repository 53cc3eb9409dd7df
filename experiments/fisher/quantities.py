"""The numbers of the experiment on star vectors, each described once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from calib.directional.fisher import FisherFit
from experiments.fisher.bench import Case
from experiments.fisher.coverage import DISTRIBUTIONS, LEVELS
from experiments.fisher.degrees_of_freedom import VarianceRatio
from experiments.fisher.field_of_view import Ratio, closed_form, pixel_noise_form, vectors_needed
from experiments.fisher.independent import known_noise, mean_probability, written_out_arcsec, written_out_vectors
from experiments.fisher.reduce import CONFIDENCE, Evaluation
from experiments.fisher.result import Result
from experiments.harness.quantities import Quantities
from experiments.harness.summary import Measured
from experiments.laboratory.signal import add_signal
from experiments.laboratory.single_star.setup import star_signal
from optics.units import RAD_ARCSEC
from render.engine.random import Streams

__all__ = ["describe"]

Row = tuple[str, str, str, str, str, Callable[[Any], Any]]
"""Name, label, unit, format, column in ECSV files, and what it is of one item of a series."""
CAUSES = {
    "centroids": "centroids",
    "readings": "readings of the table",
    "clocks": "clocks of table and camera",
    "table": "… readings and clocks together",
    "calibration": "calibration and camera model",
    "all": "all",
}
"""What makes the scatter: key -> words."""


def describe(result: Result) -> Quantities:
    """Quantities of a run: of both acquisitions, over fields, samples, places, digits and tables."""
    q = Quantities()
    q.axis("acquisition", [case.acquisition.name for case in result.bench.cases], "Acquisition")
    _accuracy(q, result.bench.cases)
    _independent(q, result)
    _distribution(q, result.bench.cases)
    _causes(q, result.bench.cases)
    _pixel_method(q, result)
    _rendered_same_data(q, result)
    _fields(q, result)
    _coverage(q, result)
    _same_data(q, result)
    _precision(q, result)
    _other_tables(q, result)
    config, instrument = result.config, result.instrument
    add_signal(q, star_signal(config, instrument), "calibration_")
    add_signal(q, star_signal(config, instrument, config.evaluation), "")
    return q


def _series(
    q: Quantities, dim: str, items: Sequence[Any], place: str, rows: Sequence[Row], *, prefix: str = "", dims: str = ""
) -> None:
    """Quantities of every item along a dimension; ``place``, if any, is the record of an item in ``summary.json``."""
    for name, label, unit, style, key, of in rows:
        q.add(
            f"{prefix}{name}",
            [of(item) for item in items],
            label,
            unit=unit,
            dims=f"{dim} {dims}",
            format=style,
            key=key,
            json=f"{place}.{name}" if place else "",
        )


def _interval(
    q: Quantities, cases: Sequence[Case], name: str, unit: str, style: str, of: Callable[[Evaluation], Sequence[float]]
) -> None:
    """A confidence interval: whole for ``summary.json``, its ends for tables."""
    found = [of(case.evaluation) for case in cases]
    described = {"unit": unit, "format": style}
    q.add(name, found, f"{CONFIDENCE:.0%} interval", dims="acquisition end", json=f"[acquisition].{name}", **described)
    for n, (key, head) in enumerate((("low", f"{100 * CONFIDENCE:g} % from"), ("high", "to"))):
        ends = [one[n] for one in found]
        q.add(f"{name}_{key}", ends, head, dims="acquisition", key=key, json="", **described)


def _accuracy(q: Quantities, cases: Sequence[Case]) -> None:
    """Concentration of the vectors (S400) and their standard deviation per axis (S500), beside its prediction."""
    dim, place = "acquisition", "[acquisition]"
    rows: list[Row] = [
        ("n", "n", "", "", "n", lambda f: f.count),
        ("one_minus_resultant_length", "1 − R", "", ".4e", "one_minus_r", lambda f: f.deficit),
        ("concentration_document", "1/(1 − R)", "", ".4e", "k_document", lambda f: f.concentration_document),
        ("concentration", "(n−1)/(n(1−R))", "", ".4e", "k", lambda f: f.concentration),
        ("concentration_unbiased", "(n−2)/(n(1−R))", "", ".4e", "k_unbiased", lambda f: f.concentration_unbiased),
        ("sigma_arcsec", "σ per axis", "arcsec", "", "sigma", _sigma),
    ]
    _series(q, dim, [case.evaluation.fit for case in cases], place, rows)
    rows = [
        ("sigma_predicted_arcsec", "Predicted", "arcsec", ".4f", "predicted", lambda c: c.predicted.sigma_arcsec),
        ("z_score", "off by", "sigma", "+.2f", "z_score", lambda c: c.z_score),
        ("sigma_without_table_arcsec", "Without table", "arcsec", ".4f", "camera", lambda c: c.camera_arcsec),
        ("streak_px", "Streak", "px", ".1f", "streak", lambda c: c.smear_px),
    ]
    _series(q, dim, cases, place, rows)
    _interval(q, cases, "concentration_interval_95", "", ".3e", lambda e: e.fit.concentration_interval(CONFIDENCE))
    _interval(q, cases, "sigma_interval_95_arcsec", "arcsec", ".4f", lambda e: e.interval_arcsec(CONFIDENCE))


def _independent(q: Quantities, result: Result) -> None:
    """The same by written-out equations, and vectors of known noise (`experiments.fisher.independent`)."""
    calibration, off, chance = result.bench.calibration, [], []
    for case in result.bench.cases:
        vectors, own = written_out_vectors(result.config, calibration, case.acquisition), case.evaluation
        off.append(written_out_arcsec(vectors[~own.outlier]) / own.sigma_arcsec)
        chance.append(mean_probability(result.config, calibration, vectors, own.sigma_arcsec))
    known = known_noise(Streams(result.config.seed).child("fisher"))
    place = "independent."
    of_case = {"dims": "acquisition"}
    q.add("written_out", off, "σ of S300 to S500 written out over that found", **of_case, json=f"{place}written_out")
    q.add("mean_probability", chance, "Mean star vector, probability", **of_case, json=f"{place}mean_probability")
    for name, label, value, error in (
        ("variance", "Variance found over variance put in", known.variance, known.variance_sigma),
        ("cone", "Cone of confidence off its closed form", known.cone, None),
        ("held", "Cones that hold the true direction", known.held, known.held_sigma),
    ):
        q.add(f"known_{name}", value, label, error=error, json=f"{place}known_{name}")


def _sigma(fit: FisherFit) -> Measured:
    sigma, error = fit.sigma_rad * RAD_ARCSEC, fit.sigma_uncertainty_rad * RAD_ARCSEC
    return Measured(value=sigma, unit="arcsec", uncertainty=error, n=fit.count)


def _distribution(q: Quantities, cases: Sequence[Case]) -> None:
    """Whether the vectors follow the distribution, and the interval of sigma by their own degrees of freedom."""
    evaluations = [case.evaluation for case in cases]
    rows: list[Row] = [
        ("isotropy_p_value", "p", "", ".2g", "p_value", lambda e: e.isotropy.p_value),
        ("isotropy_ratio", "Major over minor", "", ".2f", "ratio", lambda e: e.isotropy.ratio),
        ("exponential_statistic", "KS", "", ".3f", "statistic", lambda e: e.tails.statistic),
        ("outliers", "Outliers", "", "", "outliers", lambda e: int(e.outlier.sum())),
        ("effective_degrees", "Own ν", "", ".0f", "effective_degrees", lambda e: e.effective_degrees),
    ]
    _series(q, "acquisition", evaluations, "[acquisition]", rows)
    rows = [
        ("major_arcsec", "Major", "arcsec", ".4f", "major", lambda e: e.isotropy.major_rad * RAD_ARCSEC),
        ("minor_arcsec", "Minor", "arcsec", ".4f", "minor", lambda e: e.isotropy.minor_rad * RAD_ARCSEC),
    ]
    _series(q, "acquisition", evaluations, "", rows)
    expected = [case.predicted.satterthwaite for case in cases]
    q.add("expected_degrees", expected, "expected", dims="acquisition", format=".0f", json="")
    own = "sigma_interval_95_own_degrees_arcsec"
    _interval(q, cases, own, "arcsec", ".4f", lambda e: e.own_interval_arcsec(CONFIDENCE))


def _causes(q: Quantities, cases: Sequence[Case]) -> None:
    """Scatter per axis by cause: expected from covariances, and realised in this run."""
    q.axis("cause", list(CAUSES), "Cause", names=CAUSES)
    expected = [
        {**case.expected_arcsec, "table": case.table_arcsec, "all": case.predicted.sigma_arcsec} for case in cases
    ]
    realised = [
        {**case.realised_arcsec, "calibration": case.realised_arcsec["camera"], "all": case.evaluation.sigma_arcsec}
        for case in cases
    ]
    for name, by_case, places in (
        ("expected", expected, {cause: cause for cause in ("centroids", "readings", "clocks", "calibration")}),
        ("realised", realised, {"centroids": "centroids", "table": "table", "calibration": "camera"}),
    ):
        q.add(
            f"{name}_arcsec",
            [[one.get(cause, np.nan) for one in by_case] for cause in CAUSES],
            name,
            unit="arcsec",
            dims="cause acquisition",
            format=".4f",
            key=f"{{acquisition}}_{name}",
            json={cause: f"[acquisition].{name}_arcsec.{place}" for cause, place in places.items()},
        )


def _pixel_method(q: Quantities, result: Result) -> None:
    """The pixel-residual method on the same frames, with every angle per pixel that may be assumed."""
    angles, cases = result.bench.resolutions_arcsec, result.bench.cases
    calibrated = angles["calibrated"]
    q.axis("source", list(angles), "Angle per pixel from", key="source")
    angle = {"unit": "arcsec", "dims": "source", "format": ".5f", "key": "resolution"}
    q.add("resolutions_arcsec", list(angles.values()), "Angle", **angle)

    def over_fisher(case: Case, angle_arcsec: float) -> float:
        return case.evaluation.baseline_arcsec(angle_arcsec) / case.evaluation.sigma_arcsec

    def each(of: Callable[[Case, float], float]) -> Callable[[Case], list[float]]:
        return lambda case: [of(case, angle) for angle in angles.values()]

    baseline, excess = each(lambda c, angle: c.evaluation.baseline_arcsec(angle)), "excess_percent"
    found = each(lambda c, angle: 100 * (over_fisher(c, angle) - 1))
    expected = each(lambda c, angle: 100 * (c.expected_ratio * angle / calibrated - 1))
    rows: list[Row] = [("baseline_arcsec", "Pixel method", "arcsec", ".4f", "baseline", baseline)]
    _series(q, "acquisition", cases, "[acquisition]", rows, dims="source")
    rows = [
        (excess, "over Fisher", "percent", "+.3f", "excess", found),
        (f"predicted_{excess}", "predicted", "percent", "+.3f", "predicted_excess", expected),
    ]
    _series(q, "acquisition", cases, "", rows, dims="source")
    rows = [
        ("baseline_over_fisher", "Pixel method over Fisher", "", ".4f", "ratio", lambda c: over_fisher(c, calibrated)),
        ("baseline_over_fisher_predicted", "predicted", "", ".4f", "predicted_ratio", lambda c: c.expected_ratio),
    ]
    _series(q, "acquisition", cases, "[acquisition]", rows)


def _rendered_same_data(q: Quantities, result: Result) -> None:
    """Vectors at rest, evaluated with a calibration that was fitted to them."""
    same, place = result.bench.same_data, "same_data_rendered"
    q.add(f"{place}_n", same.naive.fit.count, "Star vectors", json="")
    q.add(f"{place}_unknowns", same.unknowns, "Unknowns", json=f"{place}.unknowns")
    for name, label, value in (
        ("naive", "2(n − 1) degrees of freedom", same.naive.sigma_arcsec),
        ("corrected", "2n − q degrees of freedom", same.corrected.sigma_arcsec),
        ("predicted_naive", "predicted", same.predicted.sigma_arcsec),
    ):
        json = f"{place}.{name}_arcsec"
        q.add(f"{place}_{name}_arcsec", value, label, unit="arcsec", format=".4f", json=json)
    q.add(f"{place}_z_score", same.predicted.z_score(same.naive.fit.chord_sum_rad2), "off by", unit="sigma", json="")


def _fields(q: Quantities, result: Result) -> None:
    """Ideal cameras over a range of fields: by how much sigma comes out too large."""
    points, place = result.field_sweep, "field_sweep[field]"
    fields = [point.field_deg for point in points]
    q.axis("field", fields, "Field", unit="deg", format="g", key="field")
    q.add("field_deg", fields, "Field", unit="deg", dims="field", json=f"{place}.field_deg")
    wrong = f"angle {100 * result.config.field.resolution_error_fraction:+g} %".replace("-", "−")
    for name, label, style, key, values in (
        ("baseline_bias", "Pixel method", "", "baseline", [_percent(p.baseline) for p in points]),
        ("closed_form", "closed form", ".4f", "closed_form", [100 * (closed_form(f) - 1) for f in fields]),
        ("fisher_bias", "Fisher", "", "fisher", [_percent(p.fisher) for p in points]),
        ("wrong_resolution", wrong, "+.3f", "wrong_resolution", [p.wrong_resolution.percent for p in points]),
        (
            "field_over_pixels",
            "angle = field/pixels",
            "+.3f",
            "field_over_pixels",
            [p.field_over_pixels.percent for p in points],
        ),
        ("pixel_noise_fisher", "Pixel noise: Fisher", "", "opposite", [_percent(p.pixel_noise_fisher) for p in points]),
        (
            "pixel_noise_quadrature",
            "quadrature",
            ".4f",
            "quadrature",
            [100 * (pixel_noise_form(f) - 1) for f in fields],
        ),
    ):
        described = {"unit": "percent", "format": style, "key": key, "json": f"{place}.{name}_percent"}
        q.add(f"{name}_percent", values, label, dims="field", **described)
    needed = [vectors_needed(closed_form(field) - 1) for field in fields]
    q.add("vectors_needed", needed, "Vectors to see it", dims="field", format=".2g", json=f"{place}.vectors_needed")


def _percent(ratio: Ratio) -> Measured:
    return Measured(value=ratio.percent, unit="percent", uncertainty=ratio.percent_error)


def _coverage(q: Quantities, result: Result) -> None:
    """How often the interval holds the truth, by distribution and size of the sample."""
    points, place = result.coverage, "coverage[sample]"
    levels = [round(100 * level) for level in LEVELS]
    q.axis("level", levels, "Confidence", unit="percent", names=[f"{level:.0%}" for level in LEVELS])
    rows: list[Row] = [
        ("kind", "Distribution", "", "", "kind", lambda p: p.kind),
        ("count", "n", "", "", "n", lambda p: p.count),
    ]
    _series(q, "sample", points, place, rows, prefix="coverage_")
    words = [DISTRIBUTIONS[p.kind] for p in points]
    q.add("coverage_distribution", words, "Distribution", dims="sample", key="distribution", json="")
    covered, error = (np.array([getattr(p, name) for p in points]) for name in ("covered", "error"))
    own = np.array([p.covered_effective for p in points])
    bias, bias_error = (np.array([getattr(p, name) for p in points]) for name in ("bias", "bias_error"))
    shares = {"dims": "sample level"}
    q.add(
        "covered",
        covered,
        "Intervals that hold the truth",
        **shares,
        error=error,
        json=f"{place}.covered",
        json_error=f"{place}.error",
    )
    q.add("covered_effective", own, "Intervals by own ν", **shares, json=f"{place}.covered_effective")
    place_error = f"{place}.bias_error"
    q.add(
        "variance_bias",
        bias,
        "bias of σ²",
        dims="sample",
        error=bias_error,
        json=f"{place}.bias",
        json_error=place_error,
    )
    for name, label, style, key, values, spread in (
        ("covered_percent", "held,", ".1f", "covered", covered, error),
        ("effective_percent", "own ν,", ".1f", "effective", own, None),
        ("variance_bias_percent", "bias of σ²", "", "bias", bias, bias_error),
    ):
        described: dict[str, Any] = {"unit": "percent", "format": style, "key": key, "json": ""}
        dims = "sample level" if values.ndim > 1 else "sample"
        q.add(name, 100 * values, label, dims=dims, error=None if spread is None else 100 * spread, **described)


def _same_data(q: Quantities, result: Result) -> None:
    """Estimated over true variance and sigma, by which data the camera was calibrated with."""
    points = result.same_data
    q.axis("places", [p.count for p in points], "Places", key="n")
    rows: list[Row] = [
        ("count", "Places", "", "", "n", lambda p: p.count),
        ("unknowns", "Unknowns", "", "", "unknowns", lambda p: p.unknowns),
        ("predicted_naive", "predicted", "", ".4f", "predicted_naive", lambda p: p.predicted_naive),
        ("predicted_independent", "predicted", "", ".4f", "predicted_independent", lambda p: p.predicted_independent),
        ("effective_degrees", "ν, unbiased", "", ".2f", "degrees", lambda p: p.effective_degrees),
        ("lost", "Lost", "", "", "lost", lambda p: p.lost),
    ]
    _series(q, "places", points, "same_data[places]", rows, prefix="same_data_")
    for name in ("naive", "corrected", "independent"):
        found: list[VarianceRatio] = [getattr(p, name) for p in points]
        q.add(
            f"same_data_{name}",
            [one.value for one in found],
            "variance over the truth",
            dims="places",
            error=[one.error for one in found],
            json=f"same_data[places].{name}.value",
            json_error=f"same_data[places].{name}.error",
        )
    for name, label in (("naive", "Same, 2(n − 1)"), ("corrected", "Same, 2n − q"), ("independent", "Own data")):
        found = [getattr(p, name) for p in points]
        error = [one.root_error for one in found]
        q.add(f"sigma_ratio_{name}", [one.root for one in found], label, dims="places", error=error, key=name, json="")
    for name in ("naive", "independent"):
        roots = np.sqrt([getattr(p, f"predicted_{name}") for p in points])
        described: dict[str, Any] = {"dims": "places", "format": ".4f", "key": f"{name}_predicted", "json": ""}
        q.add(f"sigma_ratio_{name}_predicted", roots, "predicted", **described)


def _precision(q: Quantities, result: Result) -> None:
    """Relative error of the concentration by three ways to estimate it; NaN: no answer, infinite: 1 - R is 0."""
    points = result.digits
    q.axis("noise", [p.sigma_arcsec for p in points], "σ", unit="arcsec", format="g", key="sigma")
    rows: list[Row] = [
        ("sigma_arcsec", "σ", "arcsec", "g", "sigma", lambda p: p.sigma_arcsec),
        ("chords", "Squared chords", "", ".1e", "chords", lambda p: p.chords),
        ("subtraction", "1 − R subtracted", "", ".1e", "subtraction", lambda p: p.subtraction),
        ("scipy", "SciPy", "", ".1e", "scipy", lambda p: p.scipy),
    ]
    _series(q, "noise", points, "digits[noise]", rows, prefix="digits_")


def _other_tables(q: Quantities, result: Result) -> None:
    """The same camera on tables that are read better or worse."""
    points, place = result.table_sweep, "table_sweep[reading]"
    readings = [p.reading_arcsec for p in points]
    q.axis("reading", readings, "Noise of a reading", unit="arcsec", format="g", key="reading")
    rows: list[Row] = [
        ("reading_arcsec", "Noise of a reading", "arcsec", "g", "reading", lambda p: p.reading_arcsec),
        ("expected_arcsec", "expected", "arcsec", ".4f", "expected", lambda p: p.expected_arcsec),
    ]
    _series(q, "reading", points, place, rows, prefix="table_sweep_")
    q.add(
        "table_sweep_sigma_arcsec",
        [p.sigma_arcsec for p in points],
        "σ by Fisher",
        unit="arcsec",
        dims="reading",
        error=[p.error_arcsec for p in points],
        key="sigma",
        json=f"{place}.sigma_arcsec",
        json_error=f"{place}.error_arcsec",
    )
