"""Words of the report on star vectors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.fisher.evaluate import LEVEL, baseline_expected
from experiments.fisher.field import closed_form
from experiments.fisher.figures import cause_bars, error_arrows, quantile_plots, star_windows, vector_scatter
from experiments.fisher.plots import coverage_plot, digits_plot, field_bias, needed_text, same_data_plot, table_plot
from experiments.fisher.result import Result
from experiments.fisher.tables import all_tables
from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import Table
from experiments.laboratory.single_star.sketch import bench_sketch

__all__ = ["build_report"]

VECTORS = r"w_i = R_i\; M^{T}\; u(x_i, y_i)"
CONCENTRATION = (
    r"1 - R = \frac{1}{2n} \sum_i |w_i - m|^2, \qquad k = \frac{n-1}{n\,(1-R)}, \qquad \sigma = 1/\sqrt{k}, \qquad "
    r"2 n k\,(1-R) \sim \chi^2_{2(n-1)}"
)
BASELINE = (
    r"\sigma_b = \frac{p}{f} \sqrt{\frac{s_x^2 + s_y^2}{2}}, \qquad "
    r"\frac{\sigma_b}{\sigma} = \sqrt{1 + a^2 + \frac{14}{45} a^4}, \quad a = \tan(\mathrm{field}/2)"
)


def _bench(result: Result) -> Section:
    config, run, camera = result.config, result.bench, result.instrument.camera
    dynamic = run.cases[-1]
    chosen = config.evaluation
    text = (
        f"The calibration (S100) has frames of its own: {config.grid.columns} × {config.grid.rows} places, "
        f"{config.frames} frames each of a star of {config.star.signal_e:g} e⁻. The vectors come from a second visit "
        f"to {chosen.columns} × {chosen.rows} other places (S200), one frame and one reading each, with the star "
        f"dimmed to {chosen.signal_e:g} e⁻: the accuracy asked for is that of one star in one frame. Lens "
        f"{camera.lens.name}, {result.instrument.pixel_arcsec:.2f}″ per pixel; table read to "
        f"{' and '.join(f'{v:g}″' for v in config.table.reading_noise_arcsec)} per axis.\n\nOn the move the second "
        f"axis turns at {config.dynamic.rate_deg_per_s:g}°/s, rows forwards and backwards in turn, and the image runs "
        f"over {dynamic.smear_px:.1f} px while the shutter is open. The streak is rendered from "
        f"{config.dynamic.samples} instants; clocks of table and camera jitter by {config.dynamic.jitter_ms:g} ms. The "
        "centroid uses the lens's PSF smeared along the path that readings and rate predict."
    )
    return Section(
        title="Bench and frames",
        blocks=(
            Figure(drawing=bench_sketch(config.table.axes), caption="The bench; in colour what S100 has to find."),
            Text(text),
            Figure(
                drawing=star_windows(result),
                caption="Single frames (column, row), at rest and on the move. Plus: mean of the traced rays over the "
                "exposure; cross: centroid.",
                raster=True,
            ),
        ),
    )


def _accuracy(result: Result, every: Mapping[str, Table]) -> Section:
    return Section(
        title="Star vectors and their concentration",
        blocks=(
            Equation(latex=VECTORS, note="FISHER23 eq. 7: pixel, undistorted direction, installation, table"),
            Equation(latex=CONCENTRATION, note="eq. 8–12; Mardia & Jupp 2000, sec. 10.3"),
            Text(_estimator_text(result)),
            every["concentration"],
            every["accuracy"],
            Figure(
                drawing=vector_scatter(result),
                caption="Star vectors in the table's frame at zero angles. Full circle: σ with its 95 % interval; "
                "dashed: the circle that should hold 95 %.",
            ),
            Text(_shape_text(result)),
            every["distribution"],
            Figure(
                drawing=quantile_plots(result), caption="Angles from the mean against the exponential distribution."
            ),
            Figure(drawing=error_arrows(result), caption="The same vectors where their images lie on the detector."),
        ),
    )


def _estimator_text(result: Result) -> str:
    count = result.bench.cases[0].evaluation.fit.count
    return (
        "1 − R is some 10⁻¹³ here; it is not subtracted but summed from squared chords. Unbiased by the factor n − 1 "
        "is 1/k, that is σ², not k: k itself comes out too large by (n − 1)/(n − 2). The interval follows "
        f"from χ²: σ is known to σ/(2√n), so that {count} vectors give it to ±{98 / np.sqrt(count):.1f} % (95 %)."
    )


def _shape_text(result: Result) -> str:
    parts = []
    for case in result.bench.cases:
        found = case.evaluation.isotropy
        if found.p_value < 0.05:
            parts.append(
                f"The {case.acquisition.name} vectors are not isotropic ({_chance(found.p_value)}): their ellipse is "
                f"{found.ratio:.2f} : 1. One k describes its mean square only, and the interval of χ² is too narrow; "
                "with the degrees of freedom that the vectors themselves show it is wider"
            )
        else:
            parts.append(f"The {case.acquisition.name} vectors pass the test of isotropy (p = {found.p_value:.2f})")
    dynamic = result.bench.cases[-1]
    return (
        ". ".join(parts)
        + f". On the move two things lengthen the scatter along the path: the streak, whose middle is known less well "
        f"along it, and the clocks ({dynamic.expected_arcsec['clocks'] * np.sqrt(2):.3f}″ along the path)."
    )


def _chance(p_value: float) -> str:
    return "p < 0.0001" if p_value < 1e-4 else f"p = {p_value:.2g}"


def _causes(result: Result, every: Mapping[str, Table]) -> Section:
    static = result.bench.cases[0]
    text = (
        "The simulation knows what the laboratory does not: which part of a vector's error the centroid made, which "
        "the table, which the calibration. A laboratory sees their sum. The method cannot tell camera and table apart: "
        f"at rest {static.evaluation.sigma_arcsec:.3f}″ are measured, of which "
        f"{static.expected_arcsec['readings']:.3f}″ are the table's; taken off in quadrature "
        f"{static.camera_arcsec:.3f}″ are left ({static.expected_arcsec['centroids']:.3f}″ expected). On a table read "
        "to 0.3″ and 0.4″ (CUBE09) it would measure the table."
    )
    return Section(
        title="What the number is made of",
        blocks=(
            Text(text),
            Figure(
                drawing=cause_bars(result), caption="Causes of the scatter, expected from covariances and realised."
            ),
            every["causes"],
            Row(
                (
                    Figure(
                        drawing=table_plot(result), caption="The same camera on other tables; bars 3 σ of the mean."
                    ),
                    Figure(
                        drawing=digits_plot(result),
                        caption="Digits: 1 − R at 0.1″ is 2·10⁻¹³. Curves end where an answer ends.",
                    ),
                )
            ),
        ),
    )


def _field(result: Result, every: Mapping[str, Table]) -> Section:
    static = result.bench.cases[0]
    excess = 100 * (baseline_expected(result, static) - 1)
    sheet = result.bench.resolutions_arcsec["data sheet"] / result.bench.resolutions_arcsec["calibrated"]
    text = (
        "The usual method takes the standard deviation of the pixel residuals times one angle per pixel. It sees "
        "angles stretched towards the edge, by (1 + t²) along the radius and √(1 + t²) across it. The bias is real and "
        "as computed, and small beside the interval of either method: for the 95 % interval to be as narrow as the "
        f"bias it takes {needed_text(result)}. What does show is a wrong angle per pixel: it goes into the "
        f"result in full. On the rendered bench the pixel method is {excess:+.2f} % off with the calibrated focal "
        f"length and {100 * (sheet - 1):+.1f} % more with the data sheet's. Taking the field over the pixels as the "
        "angle per pixel makes it smaller by tan h / h, h half the field, and undoes two thirds of the bias."
    )
    opposite = (
        "Which of the two is *right* depends on the noise. That of a centroid is the same in pixels everywhere, to "
        "first order; as an angle it then shrinks towards the edge. Fisher gives the root mean square of the angles "
        "over the field, the pixel method the value on the axis, and neither is wrong: they answer different "
        "questions. Strictly it is a mixture then and no Fisher distribution, but at these fields no test sees it."
    )
    return Section(
        title="The pixel method, and its bias over the field",
        blocks=(
            Equation(latex=BASELINE, note="square field, noise isotropic on the sphere; p pixel, f focal length"),
            Text(text),
            every["pixel_method"],
            Figure(
                drawing=field_bias(result),
                caption="Ideal cameras, calibration known, vectors spread evenly; bars 3 standard errors. Grey: what "
                "chance alone does to σ with as many vectors as the bench took.",
            ),
            Text(opposite),
            every["field_of_view"],
            every["field_variants"],
        ),
    )


def _coverage(result: Result, every: Mapping[str, Table]) -> Section:
    text = (
        "The interval is exact in the limit of high concentration, and good to the noise of this simulation down to "
        "k = 20. It rests on the distribution, not on the number of vectors: for an ellipse of 3 : 1, and for vectors "
        "of which one in fifty has four times the noise, it stays too narrow however many there are. Degrees of "
        "freedom from the scatter of the squared chords themselves (hollow) mend it, from some 50 vectors on; against "
        "rare outliers it takes more."
    )
    return Section(
        title="Does the interval hold the truth?",
        blocks=(
            Text(text),
            Figure(drawing=coverage_plot(result), caption="Coverage; grey: two standard deviations of the simulation."),
            every["coverage"],
        ),
    )


def _same(result: Result, every: Mapping[str, Table]) -> Section:
    same, point = result.bench.same_data, result.same_data[0]
    text = (
        f"A joint calibration has {same.unknowns} unknowns, and bends them to the noise of its data. Evaluated with "
        f"the same data, the vectors scatter less than they should: with {point.count} places σ comes out as "
        f"{point.naive.root:.2f} of the truth if 2(n − 1) degrees of freedom are counted. 2n minus the unknowns is the "
        f"right number: the covariances make it {point.effective_degrees:.2f} for {point.count} places. Data of "
        "their own (what this experiment does) err to the other side, and rightly: the error of the calibration is "
        "part of the vectors' error. Lines: √((2n − q)/(2n − 2)) and √((2n + q − 4)/(2n − 2)); two of the unknowns are "
        "the star itself, which vectors of their own do not use.\n\n"
        f"Rendered, at rest, calibrated with its own {same.naive.fit.count} frames: {same.naive.sigma_arcsec:.4f}″ "
        f"with 2(n − 1), {same.corrected.sigma_arcsec:.4f}″ with 2n − {same.unknowns}; "
        f"{result.bench.cases[0].evaluation.sigma_arcsec:.4f}″ with the calibration of S100."
    )
    limits = (
        "What is left out: the collimator is perfect; the table's readings are white (an encoder error that repeats is "
        "not averaged, and is partly taken up by the calibration); the rate is constant over the exposure. Rays only, "
        "no diffraction."
    )
    return Section(
        title="Calibrating and evaluating with the same data",
        blocks=(
            Text(text),
            Figure(
                drawing=same_data_plot(result), caption="Estimated σ over that of the noise; bars 2 standard errors."
            ),
            every["same_data"],
            Text(limits),
        ),
    )


def _key_numbers(result: Result) -> tuple[KeyNumber, ...]:
    numbers = []
    for case in result.bench.cases:
        low, high = case.evaluation.interval_arcsec(LEVEL)
        numbers.append(
            KeyNumber(
                label=f"Star vector, {case.acquisition.name}",
                value=case.evaluation.sigma_arcsec,
                unit="″",
                format=".3f",
                note=f"per axis, 1 σ; 95 %: {low:.3f} … {high:.3f}; predicted {case.predicted.sigma_arcsec:.3f}",
            )
        )
    widest = min(result.field_sweep, key=lambda p: abs(p.field_deg - 20.0))
    held = next(p for p in reversed(result.coverage) if p.kind == "fisher")
    return (
        *numbers,
        KeyNumber(
            label=f"Bias of the pixel method, {widest.field_deg:g}° field",
            value=Measured(value=widest.baseline.percent, uncertainty=widest.baseline.percent_error),
            unit="%",
            note=f"closed form {100 * (closed_form(widest.field_deg) - 1):.2f} %",
        ),
        KeyNumber(
            label="95 % intervals that hold the truth",
            value=Measured(value=100 * held.covered[1], uncertainty=100 * held.error[1]),
            unit="%",
            note=f"{held.count} vectors, Fisher distribution",
        ),
    )


def build_report(result: Result) -> Report:
    """The report of a run."""
    every = all_tables(result)
    static, dynamic = result.bench.cases
    return Report(
        title="Accuracy of star vectors by the Fisher distribution",
        lead=f"A single star, rendered through {result.instrument.camera.lens.name}, visits the whole detector on a "
        "turntable; every image becomes a vector in the table's frame at zero angles, and their concentration a "
        "standard deviation (FISHER23, *laboratory evaluation of star-vector accuracy*, 2023, S100–S500). Beside it "
        "the pixel-residual method that it is to replace.",
        verdict=f"One frame gives a star vector to {static.evaluation.sigma_arcsec:.3f}″ per axis at rest and "
        f"{dynamic.evaluation.sigma_arcsec:.3f}″ over a streak of {dynamic.smear_px:.1f} px (predicted "
        f"{static.predicted.sigma_arcsec:.3f}″ and {dynamic.predicted.sigma_arcsec:.3f}″). The bias of the pixel "
        f"method is as its closed form says; to see it takes {needed_text(result)}.",
        key_numbers=_key_numbers(result),
        sections=(
            _bench(result),
            _accuracy(result, every),
            _causes(result, every),
            _field(result, every),
            _coverage(result, every),
            _same(result, every),
        ),
    )
