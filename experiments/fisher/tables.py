"""Tables of the experiment on star vectors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.fisher.bench import Case
from experiments.fisher.coverage import KINDS, LEVELS
from experiments.fisher.evaluate import LEVEL, baseline_expected, vectors_needed
from experiments.fisher.field import Ratio, closed_form, opposite_form
from experiments.fisher.result import Result
from experiments.fisher.same import Mean
from experiments.harness.summary import Measured
from experiments.harness.tables import Column, Table
from optics.units import RAD_ARCSEC

__all__ = ["all_tables"]


def _accuracy(result: Result) -> Table:
    rows = []
    for case in result.bench.cases:
        judged = case.evaluation
        low, high = judged.interval_arcsec(LEVEL)
        rows.append(
            (
                case.acquisition.name,
                judged.fit.count,
                Measured(value=judged.sigma_arcsec, uncertainty=judged.fit.sigma_uncertainty_rad * RAD_ARCSEC),
                low,
                high,
                case.predicted.sigma_arcsec,
                case.predicted.z_score(judged.fit.chord_sum_rad2),
                case.camera_arcsec,
            )
        )
    return Table(
        columns=(
            "Acquisition",
            Column(name="n", key="n"),
            Column(name="σ per axis", unit="″", key="sigma"),
            Column(name="95 % from", unit="″", key="low", format=".4f"),
            Column(name="to", unit="″", key="high", format=".4f"),
            Column(name="Predicted", unit="″", key="predicted", format=".4f"),
            Column(name="off by", unit="σ", key="z_score", format="+.2f"),
            Column(name="Without table", unit="″", key="camera", format=".4f"),
        ),
        rows=rows,
        caption="Accuracy of single-frame star vectors (S300–S500).",
        note="Uncertainty 1 σ, interval by χ² with 2(n − 1) degrees of freedom. Predicted: "
        "from the covariances of centroids, readings, clocks, calibration. Without table: what readings and clocks are "
        "known to add taken off in quadrature.",
    )


def _causes(result: Result) -> Table:
    labels = {
        "centroids": ("centroids", "centroids"),
        "readings": ("readings of the table", None),
        "clocks": ("clocks of table and camera", None),
        "table": ("… readings and clocks together", "table"),
        "camera": ("calibration and camera model", "camera"),
    }
    rows: list[tuple[str | float | None, ...]] = []
    for key, (label, realised) in labels.items():
        row: list[str | float | None] = [label]
        for case in result.bench.cases:
            row += [_expected(case, key), case.realised_arcsec[realised] if realised else None]
        rows.append(tuple(row))
    whole: list[str | float | None] = ["all"]
    for case in result.bench.cases:
        whole += [case.predicted.sigma_arcsec, case.evaluation.sigma_arcsec]
    rows.append(tuple(whole))
    return Table(
        columns=(
            "Cause",
            *(
                Column(
                    name=f"{case.acquisition.name}, {what}",
                    unit="″",
                    key=f"{case.acquisition.name}_{what}",
                    format=".4f",
                )
                for case in result.bench.cases
                for what in ("expected", "realised")
            ),
        ),
        rows=rows,
        caption="Where the scatter comes from, per axis.",
        note="Expected: from covariances. Realised: in this run, with the truth put in place of what was measured, "
        "which only a simulation can do; in the last row what the method measured.",
    )


def _expected(case: Case, key: str) -> float:
    expected = case.expected_arcsec
    if key == "table":
        return float(np.hypot(expected["readings"], expected["clocks"]))
    return expected["calibration"] if key == "camera" else expected[key]


def _baseline(result: Result) -> Table:
    rows = []
    for case in result.bench.cases:
        judged = case.evaluation
        for name, resolution in result.bench.resolutions_arcsec.items():
            value = judged.baseline_arcsec(resolution)
            expected = baseline_expected(result, case) * resolution / result.bench.resolutions_arcsec["calibrated"]
            rows.append(
                (
                    case.acquisition.name,
                    name,
                    resolution,
                    value,
                    100 * (value / judged.sigma_arcsec - 1),
                    100 * (expected - 1),
                )
            )
    return Table(
        columns=(
            "Acquisition",
            Column(name="Angle per pixel from", key="source"),
            Column(name="Angle", unit="″", key="resolution", format=".5f"),
            Column(name="Pixel method", unit="″", key="baseline", format=".4f"),
            Column(name="over Fisher", unit="%", key="excess", format="+.3f"),
            Column(name="predicted", unit="%", key="predicted_excess", format="+.3f"),
        ),
        rows=rows,
        caption="The pixel-residual method on the same frames.",
        note="Data sheet: the rounded focal length that the calibration starts from. Field over pixels: full width of "
        "the field divided by the columns. Predicted: from the noise on the detector and the lens.",
    )


def _concentration(result: Result) -> Table:
    rows = []
    for case in result.bench.cases:
        fit = case.evaluation.fit
        low, high = fit.concentration_interval(LEVEL)
        rows.append(
            (
                case.acquisition.name,
                fit.deficit,
                fit.concentration_document,
                fit.concentration,
                fit.concentration_unbiased,
                low,
                high,
            )
        )
    return Table(
        columns=(
            "Acquisition",
            Column(name="1 − R", key="one_minus_r", format=".4e"),
            Column(name="1/(1 − R)", key="k_document", format=".4e"),
            Column(name="(n−1)/(n(1−R))", key="k", format=".4e"),
            Column(name="(n−2)/(n(1−R))", key="k_unbiased", format=".4e"),
            Column(name="95 % from", key="low", format=".3e"),
            Column(name="to", key="high", format=".3e"),
        ),
        rows=rows,
        caption="Concentration k (S400).",
        note="FISHER23 eq. 11; the estimate whose inverse is unbiased, from which σ is taken; the one that is unbiased "
        "for k itself.",
    )


def _checks(result: Result) -> Table:
    rows = []
    for case in result.bench.cases:
        judged = case.evaluation
        low, high = judged.own_interval_arcsec(LEVEL)
        rows.append(
            (
                case.acquisition.name,
                judged.isotropy.major_rad * RAD_ARCSEC,
                judged.isotropy.minor_rad * RAD_ARCSEC,
                f"{judged.isotropy.p_value:.2g}",
                judged.tails.statistic,
                int(judged.outlier.sum()),
                judged.effective_degrees,
                case.predicted.satterthwaite,
                low,
                high,
            )
        )
    return Table(
        columns=(
            "Acquisition",
            Column(name="Major", unit="″", key="major", format=".4f"),
            Column(name="Minor", unit="″", key="minor", format=".4f"),
            Column(name="p", key="p_value"),
            Column(name="KS", key="statistic", format=".3f"),
            Column(name="Outliers", key="outliers"),
            Column(name="Own ν", key="effective_degrees", format=".0f"),
            Column(name="expected", key="expected_degrees", format=".0f"),
            Column(name="95 % from", unit="″", key="low", format=".4f"),
            Column(name="to", unit="″", key="high", format=".4f"),
        ),
        rows=rows,
        caption="Whether the vectors follow the distribution.",
        note="Standard deviations along the axes of the ellipse and the chance p of such an ellipse by Mauchly's test; "
        "modified Kolmogorov statistic of k(1 − cos) against the exponential distribution, refused at 5 % above 1.094; "
        "degrees of freedom from the scatter of the squared chords themselves, as expected from covariances, and the "
        "interval of σ with them.",
    )


def _percent(ratio: Ratio) -> Measured:
    return Measured(value=ratio.percent, uncertainty=ratio.percent_error)


def _field(result: Result) -> Table:
    rows = [
        (
            p.field_deg,
            _percent(p.baseline),
            100 * (closed_form(p.field_deg) - 1),
            _percent(p.fisher),
            float(f"{vectors_needed(closed_form(p.field_deg) - 1):.2g}"),
        )
        for p in result.field_sweep
    ]
    return Table(
        columns=(
            Column(name="Field", unit="°", key="field", format="g"),
            Column(name="Pixel method", unit="%", key="baseline"),
            Column(name="closed form", unit="%", key="closed_form", format=".4f"),
            Column(name="Fisher", unit="%", key="fisher"),
            Column(name="Vectors to see it", key="vectors_needed", format=".2g"),
        ),
        rows=rows,
        caption="Noise isotropic on the sphere: by how much σ comes out too large.",
        note=f"Full widths of square fields; {result.config.field.runs} runs of {result.config.field.directions} "
        "vectors, ± 1 standard error. Pixel method over Fisher on the same vectors, Fisher over the truth. Last: "
        "vectors for which the 95 % interval of σ is as narrow as the bias.",
    )


def _variants(result: Result) -> Table:
    rows = [
        (
            p.field_deg,
            p.field_over_pixels.percent,
            p.wrong_resolution.percent,
            _percent(p.opposite_fisher),
            100 * (opposite_form(p.field_deg) - 1),
        )
        for p in result.field_sweep
    ]
    wrong = f"angle {100 * result.config.field.resolution_error_fraction:+g} %".replace("-", "−")
    return Table(
        columns=(
            Column(name="Field", unit="°", key="field", format="g"),
            Column(name="angle = field/pixels", unit="%", key="field_over_pixels", format="+.3f"),
            Column(name=wrong, unit="%", key="wrong_resolution", format="+.3f"),
            Column(name="Pixel noise: Fisher", unit="%", key="opposite"),
            Column(name="quadrature", unit="%", key="quadrature", format=".4f"),
        ),
        rows=rows,
        caption="Other angles per pixel, and the opposite case.",
        note="Columns 2 and 3: noise isotropic on the sphere, pixel method over Fisher. Columns 4 and 5: noise "
        "isotropic in pixels, Fisher over the noise on the axis.",
    )


def _coverage(result: Result) -> Table:
    rows: list[tuple[str | float | Measured, ...]] = [
        (
            KINDS[p.kind],
            p.count,
            *(100 * c for c in p.covered),
            *(100 * c for c in p.covered_effective),
            Measured(value=100 * p.bias, uncertainty=100 * p.bias_error),
        )
        for p in result.coverage
    ]
    return Table(
        columns=(
            Column(name="Distribution", key="distribution"),
            Column(name="n", key="n"),
            *(
                Column(name=f"{level:.0%}", unit="%", key=f"covered_{round(100 * level)}", format=".1f")
                for level in LEVELS
            ),
            *(
                Column(name=f"{level:.0%}, own ν", unit="%", key=f"effective_{round(100 * level)}", format=".1f")
                for level in LEVELS
            ),
            Column(name="bias of σ²", unit="%", key="bias"),
        ),
        rows=rows,
        caption="How often the interval holds the truth.",
        note=f"{result.config.coverage.runs} samples per row; a share of 95 % is known to "
        f"{100 * result.coverage[0].error[1]:.2f} points. Own ν: degrees of freedom from the scatter of the squared "
        "chords themselves.",
    )


def _root(mean: Mean) -> Measured:
    return Measured(value=mean.root, uncertainty=mean.root_error)


def _same(result: Result) -> Table:
    rows = [
        (
            p.count,
            _root(p.naive),
            float(np.sqrt(p.predicted_naive)),
            _root(p.corrected),
            _root(p.independent),
            float(np.sqrt(p.predicted_independent)),
            p.effective_degrees,
        )
        for p in result.same_data
    ]
    return Table(
        columns=(
            Column(name="Places", key="n"),
            Column(name="Same, 2(n − 1)", key="naive"),
            Column(name="predicted", key="naive_predicted", format=".4f"),
            Column(name="Same, 2n − q", key="corrected"),
            Column(name="Own data", key="independent"),
            Column(name="predicted", key="independent_predicted", format=".4f"),
            Column(name="ν, unbiased", key="degrees", format=".2f"),
        ),
        rows=rows,
        caption="σ over that of the noise, by which data the camera was calibrated with.",
        note=f"On coordinates, {result.config.same_data.runs} joint calibrations per row with q = "
        f"{result.same_data[0].unknowns} unknowns; root of the mean variance. Same: calibrated and evaluated with the "
        "same data; own: vectors of a second acquisition. Last: degrees of freedom of the same data, by covariances.",
    )


def _digits(result: Result) -> Table:
    def text(value: float) -> str:
        return "fails" if np.isnan(value) else "1 − R = 0" if np.isinf(value) else f"{value:.1e}"

    rows: list[tuple[str | float, ...]] = [
        (p.sigma_arcsec, text(p.chords), text(p.subtraction), text(p.scipy)) for p in result.digits
    ]
    return Table(
        columns=(
            Column(name="σ", unit="″", key="sigma", format="g"),
            Column(name="Squared chords", key="chords"),
            Column(name="1 − R subtracted", key="subtraction"),
            Column(name="SciPy", key="scipy"),
        ),
        rows=rows,
        caption="Relative error of the concentration, double precision against 50 digits.",
        note="One sample of 400 vectors per row; scipy.stats.vonmises_fisher.fit solves coth k − 1/k = R.",
    )


def _table(result: Result) -> Table:
    return Table(
        columns=(
            Column(name="Noise of a reading", unit="″", key="reading", format="g"),
            Column(name="σ by Fisher", unit="″", key="sigma"),
            Column(name="expected", unit="″", key="expected", format=".4f"),
        ),
        rows=[
            (p.reading_arcsec, Measured(value=p.sigma_arcsec, uncertainty=p.error_arcsec), p.expected_arcsec)
            for p in result.table_sweep
        ],
        caption="The same camera on other tables.",
        note="On coordinates, 20 runs per row, calibration known.",
    )


def all_tables(result: Result) -> dict[str, Table]:
    """Every table by file name."""
    builders: Mapping[str, Table] = {
        "accuracy": _accuracy(result),
        "concentration": _concentration(result),
        "causes": _causes(result),
        "pixel_method": _baseline(result),
        "distribution": _checks(result),
        "field_of_view": _field(result),
        "field_variants": _variants(result),
        "coverage": _coverage(result),
        "same_data": _same(result),
        "digits": _digits(result),
        "other_tables": _table(result),
    }
    return dict(builders)
