"""Words of the step test's report."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.tables import Table
from experiments.hsfe.evaluate import ratio, three_sigma
from experiments.hsfe.figures import cause_bars, error_tracks, residual_cloud, s_curve_plot, step_path_plot
from experiments.hsfe.result import PUBLISHED_ARCSEC
from experiments.hsfe.tables import CAUSE_NAMES, all_tables
from experiments.laboratory.high_frequency import CAUSES
from experiments.laboratory.point_settings import METHOD_NAMES

if TYPE_CHECKING:
    from experiments.hsfe.result import Result

__all__ = ["build_report"]

EQ9 = (
    r"\sigma_x = \sqrt{ \frac{1}{W (M-1)} \sum_{k=1}^{M-1} \sum_{j=1}^{W} "
    r"\left( \Delta \bar X_j^{(k)} - "
    r"\frac{1}{W} \sum_{j=1}^{W} \Delta \bar X_j^{(k)} \right)^2 } \, , "
    r"\qquad \mathrm{HSFE}_x = 3\,\sigma_x \times 5.5''"
)


def _xy(values: np.ndarray) -> str:
    return f"{values[0]:.3f}″ and {values[1]:.3f}″"


def _figure_text(result: Result) -> str:
    first = result.config.methods[0]
    document = three_sigma(result, result.measured.document_px(first))
    halved = three_sigma(result, result.measured.halved_px(first))
    single = three_sigma(result, result.measured.single_px(first))
    factor = float(np.sqrt((document**2).sum() / (single**2).sum()))
    return (
        "The document takes the RMS difference of *neighbouring* positions. Were their errors independent, dividing by "
        "√2 (and taking out the averaged temporal noise) would give the error of one position. They are not: a step of "
        f"{result.config.steps.step_px:g} px carries a star only a fraction of the way along the S-curve and leaves "
        "most of its light in the same pixels. For the "
        f"{METHOD_NAMES[first]} the figure as printed is {_xy(document)}, over √2 it is {_xy(halved)}, and what a star "
        f"really errs by at one position is {_xy(single)}. The printed figure is {factor:.2f} times the real error "
        "here, by luck of two opposite slips; the factor depends on the step and the centroider, so the document's "
        "number is no error of a star until it is known."
    )


def _cause_text(result: Result) -> str:
    parts = []
    for method in result.config.methods:
        size = {c: float(np.hypot(*result.measured.cause_px(method, c))) for c in CAUSES}
        parts.append(f"{CAUSE_NAMES[max(size, key=lambda c: size[c])]} for the {METHOD_NAMES[method]}")
    what = (
        "With the mean dark frame subtracted the offset pattern is gone, and the noise of the dark frames has come in "
        "its place. Set subtraction=raw to see the pattern."
        if result.config.subtraction == "dark"
        else "Without dark subtraction the offset pattern stays, and a plain centre of gravity adds it up over its "
        "whole window."
    )
    return (
        f"The largest cause is {'; '.join(parts)}. An S-curve is not a property of the detector: it is what a method "
        "with no knowledge, or wrong knowledge, of the light's shape makes of whole pixels, and it does not average "
        "out over frames. The ePSF fit knows the true shape and has none; in a real camera it would have as much as "
        f"its PSF is wrong. {what} Bad pixels are known to the camera and left out; on this chip "
        f"{_hit(result)} windows hold one."
    )


def _hit(result: Result) -> str:
    model = result.after.method[result.config.methods[0]]
    return "some of the" if model.cause_single_px["defects"].any() else "none of the"


def _prediction_text(result: Result) -> str:
    first = result.config.methods[0]
    before, scatter = (
        three_sigma(result, v)
        for v in (result.before.method[first].document_px, result.before.method[first].scatter_px)
    )
    found = ratio(result, first)
    return (
        "Predicted without a frame: the S-curve by centroiding windows sampled from the PSF, patterns by the "
        "derivative of the centroid by each pixel, their size from the data sheet, on pixels that stand still while "
        "the star moves over them. Two predictions are made. Before the test only the hexapod's errors are known: "
        f"{before[0]:.3f} ± {scatter[0]:.3f}″ in x and {before[1]:.3f} ± {scatter[1]:.3f}″ in y for the "
        f"{METHOD_NAMES[first]}. After it the common motion has been seen in the images, and the prediction is made "
        f"for that path (the table); measured over predicted is {found[0].value:.3f} and {found[1].value:.3f}."
    )


def _hexapod_text(result: Result) -> str:
    this = next(g for g in result.geometry if g.label == "this one")
    return (
        "The mean over the stars takes out what the hexapod does to all of them: a step that is wrong by "
        f"{this.motion_px:.3f} px leaves {float(this.document_px.max()):.5f} px. Roll does not cancel, since it moves "
        "the outer stars of the target more than the inner ones, but it takes a poor platform to matter. What does "
        "*not* cancel is subtler: longer and shorter steps sample the S-curve otherwise, so the document's figure "
        "itself scatters from run to run with the quality of the steps. A finer or a longer path helps, not more "
        "frames."
    )


def _short_causes(result: Result, table: Table) -> Table:
    """The causes of two methods; the file has them all."""
    names = {METHOD_NAMES[m] for m in (result.config.methods[0], "epsf")}
    return replace(table, rows=[row for row in table.rows if row[0] in names])


def build_report(result: Result) -> Report:
    """The report of a run; call inside `plotting.house_style`."""
    config, every = result.config, all_tables(result)
    first = config.methods[0]
    x, y = result.measured.document_arcsec(first)
    single = three_sigma(result, result.measured.single_px(first))
    found = ratio(result, first)
    keys = (
        KeyNumber(
            label="HSFE as printed, x", value=x.value, unit="″", format=".3f", note="3 σ, neighbouring positions"
        ),
        KeyNumber(
            label="HSFE as printed, y", value=y.value, unit="″", format=".3f", note="3 σ, neighbouring positions"
        ),
        KeyNumber(
            label="One position, x / y",
            value=f"{single[0]:.3f} / {single[1]:.3f}",
            unit="″",
            note="3 σ, against the truth",
        ),
        KeyNumber(
            label="Published, x / y",
            value=f"{PUBLISHED_ARCSEC[0]:.2f} / {PUBLISHED_ARCSEC[1]:.2f}",
            unit="″",
            note="as printed",
        ),
    )
    sections = (
        Section(
            title="The document's figure",
            blocks=(
                Equation(latex=EQ9, note="ACC18 eq. 7-12"),
                Figure(
                    drawing=residual_cloud(result),
                    caption=f"ACC18 Fig. 6 redrawn, {METHOD_NAMES[first]}: residual of every star in every step, the "
                    "mean over the stars removed.",
                ),
                every["hsfe"],
                Text(_figure_text(result)),
            ),
        ),
        Section(
            title="Where it comes from",
            blocks=(
                Figure(
                    drawing=cause_bars(result),
                    caption="Contributions to the document's figure. Bars: each cause alone; strokes: what is missing "
                    "when it is switched off; circles: predicted.",
                ),
                Row(
                    (
                        Figure(
                            drawing=s_curve_plot(result),
                            caption="S-curves of the middle star: noiseless centroid minus truth across a pixel.",
                        ),
                        Figure(
                            drawing=step_path_plot(result),
                            caption="ACC18 Fig. 2: path of the middle star over the pixels (grey lines: their edges).",
                        ),
                    )
                ),
                Text(_cause_text(result)),
                _short_causes(result, every["causes"]),
            ),
        ),
        Section(
            title="Prediction",
            blocks=(
                Figure(
                    drawing=error_tracks(result),
                    caption="Error along the path, every star (grey) and a few of them (points), with the predicted "
                    "S-curve (lines): neighbouring positions err alike.",
                ),
                Text(_prediction_text(result)),
            ),
        ),
        Section(title="The hexapod", blocks=(every["hexapods"], Text(_hexapod_text(result)))),
    )
    return Report(
        title="High spatial frequency error",
        lead=f"A target of {result.measured.photon_px.shape[1]} points was stepped over the pixels, "
        f"{config.steps.positions} positions of {config.steps.step_px:g} px along {config.steps.direction_deg:g}°, "
        f"{result.measured.frames} rendered and noisy frames at each, and the whole repeated with single causes "
        "switched off.",
        verdict=f"As printed, the HSFE of the {METHOD_NAMES[first]} is {x.value:.3f}″ in x and {y.value:.3f}″ in y "
        f"(3 σ), {found[0].value:.3f} and {found[1].value:.3f} of what is predicted without frames.",
        key_numbers=keys,
        sections=sections,
    )
