"""Tables of the experiment on star vectors, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.fisher.precision import VECTORS
from experiments.fisher.table_noise import RUNS
from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome
from experiments.harness.tables import Table

__all__ = ["tables"]


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name."""
    return {**_of_the_bench(outcome), **_on_coordinates(outcome)}


def _of_the_bench(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    return {
        "accuracy": Pivot(
            rows="acquisition",
            columns="n sigma_arcsec sigma_interval_95_arcsec_low sigma_interval_95_arcsec_high sigma_predicted_arcsec "
            "z_score sigma_without_table_arcsec",
            caption="Accuracy of single-frame star vectors (S300–S500).",
            note="Uncertainty 1 σ, interval by χ² with 2(n − 1) degrees of freedom. Predicted: "
            "from the covariances of centroids, readings, clocks, calibration. Without table: what readings and clocks "
            "are known to add taken off in quadrature.",
        ),
        "concentration": Pivot(
            rows="acquisition",
            columns="one_minus_resultant_length concentration_document concentration concentration_unbiased "
            "concentration_interval_95_low concentration_interval_95_high",
            caption="Concentration k (S400).",
            note="FISHER23 eq. 11; the estimate whose inverse is unbiased, from which σ is taken; the one that is "
            "unbiased for k itself.",
        ),
        "causes": _causes(outcome),
        "pixel_method": Pivot(
            rows="acquisition source",
            columns="resolutions_arcsec baseline_arcsec excess_percent predicted_excess_percent",
            caption="The pixel-residual method on the same frames.",
            note="Data sheet: the rounded focal length that the calibration starts from. Field over pixels: full width "
            "of the field divided by the columns. Predicted: from the noise on the detector and the lens.",
        ),
        "distribution": Pivot(
            rows="acquisition",
            columns="major_arcsec minor_arcsec isotropy_p_value exponential_statistic outliers effective_degrees "
            "expected_degrees sigma_interval_95_own_degrees_arcsec_low sigma_interval_95_own_degrees_arcsec_high",
            caption="Whether the vectors follow the distribution.",
            note="Standard deviations along the axes of the ellipse and the chance p of such an ellipse by Mauchly's "
            "test; modified Kolmogorov statistic of k(1 − cos) against the exponential distribution, refused at 5 % "
            "above 1.094; degrees of freedom from the scatter of the squared chords themselves, as expected from "
            "covariances, and the interval of σ with them.",
        ),
    }


def _causes(outcome: Outcome) -> Table:
    """Expected and realised scatter side by side for each acquisition."""
    table = pivot(
        outcome.data,
        Pivot(
            rows="cause",
            across="acquisition",
            columns="expected_arcsec realised_arcsec",
            caption="Where the scatter comes from, per axis.",
            note="Expected: from covariances. Realised: in this run, with the truth put in place of what was measured, "
            "which only a simulation can do; in the last row what the method measured.",
        ),
    )
    count = outcome.data.sizes["acquisition"]
    order = [0, *(1 + n + part * count for n in range(count) for part in range(2))]
    return Table(
        columns=[table.columns[n] for n in order],
        rows=[[row[n] for n in order] for row in table.rows],
        caption=table.caption,
        note=table.note,
    )


def _on_coordinates(outcome: Outcome) -> Mapping[str, Pivot]:
    config = outcome.config
    return {
        "field_of_view": Pivot(
            rows="field",
            columns="baseline_bias_percent closed_form_percent fisher_bias_percent vectors_needed",
            caption="Noise isotropic on the sphere: by how much σ comes out too large.",
            note=f"Full widths of square fields; {config.field.runs} runs of {config.field.directions} "
            "vectors, ± 1 standard error. Pixel method over Fisher on the same vectors, Fisher over the truth. Last: "
            "vectors for which the 95 % interval of σ is as narrow as the bias.",
        ),
        "field_variants": Pivot(
            rows="field",
            columns="field_over_pixels_percent wrong_resolution_percent pixel_noise_fisher_percent "
            "pixel_noise_quadrature_percent",
            caption="Other angles per pixel, and the opposite case.",
            note="Columns 2 and 3: noise isotropic on the sphere, pixel method over Fisher. Columns 4 and 5: noise "
            "isotropic in pixels, Fisher over the noise on the axis.",
        ),
        "coverage": Pivot(
            rows="sample",
            hidden="sample",
            across="level",
            columns="coverage_distribution coverage_count covered_percent effective_percent variance_bias_percent",
            plain="covered_percent",
            caption="How often the interval holds the truth.",
            note=f"{config.coverage.runs} samples per row; a share of 95 % is known to "
            f"{100 * outcome.errors('covered', sample=0, level=95):.2f} points. Own ν: degrees of freedom from the "
            "scatter of the squared chords themselves.",
        ),
        "same_data": Pivot(
            rows="places",
            columns="sigma_ratio_naive sigma_ratio_naive_predicted sigma_ratio_corrected sigma_ratio_independent "
            "sigma_ratio_independent_predicted same_data_effective_degrees",
            caption="σ over that of the noise, by which data the camera was calibrated with.",
            note=f"On coordinates, {config.same_data.runs} joint calibrations per row with q = "
            f"{outcome.values('same_data_unknowns')[0]} unknowns; root of the mean variance. Same: calibrated and "
            "evaluated with the same data; own: vectors of a second acquisition. Last: degrees of freedom of the same "
            "data, by covariances.",
        ),
        "digits": Pivot(
            rows="noise",
            columns="digits_chords digits_subtraction digits_scipy",
            caption="Relative error of the concentration, double precision against 50 digits.",
            note=f"One sample of {VECTORS} vectors per row; infinite where 1 − R is 0. "
            "scipy.stats.vonmises_fisher.fit solves coth k − 1/k = R and fails where the line is empty.",
        ),
        "other_tables": Pivot(
            rows="reading",
            columns="table_sweep_sigma_arcsec table_sweep_expected_arcsec",
            caption="The same camera on other tables.",
            note=f"On coordinates, {RUNS} runs per row, calibration known.",
        ),
    }
