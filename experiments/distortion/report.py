"""Words of the distortion test's report."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.distortion.evaluate import expected_forecast, noise_removed_arcsec, one_survey, over_surveys
from experiments.distortion.figures import forecast_plot, map_panels, point_arrows, survey_histogram
from experiments.distortion.result import MARKING_ARCSEC, PUBLISHED_ARCSEC
from experiments.distortion.tables import all_tables
from experiments.harness.report import Equation, Figure, KeyNumber, Report, Section, Text
from experiments.laboratory.point_settings import METHOD_NAMES

if TYPE_CHECKING:
    from experiments.distortion.result import Result

__all__ = ["build_report"]

EQ29 = (
    r"\sigma_{C1} = \sqrt{ \sigma_{\delta}^2 - \sigma_{\Delta\delta}^2 } \, , \qquad "
    r"\delta = \bar X - X^{(0)} \, , \qquad \Delta\delta = \delta - \hat\delta"
)


def _xy(values: np.ndarray) -> str:
    return f"{values[0]:.2f}″ and {values[1]:.2f}″"


def _numbers_text(result: Result) -> str:
    first = result.config.methods[0]
    aligned, calibrated = (one_survey(result, first, r) for r in ("aligned", "calibrated"))
    return (
        "Three numbers come out of the procedure and only one is published. σδ is what was *found*: everything by "
        "which the centroids differ from the surveyed coordinates. σΔδ is what the cubic polynomial *left*. "
        "σC1 = √(σδ² − σΔδ²) is printed as the error, but it is the size of what the polynomial *removed*: the "
        "larger the distortion that was corrected, the larger this error of the correction.\n\n"
        "Before anything can be subtracted, surveyed coordinates must become pixels. The document does not say how. "
        f"With shift, roll and scale fitted, σC1 is {_xy(aligned[2])} and measures the lens: its distortion is "
        "corrected very well and counted as error. With coordinates that went through a camera model from an earlier "
        f"session it is {_xy(calibrated[2])}, and the heading of the section, *residual of the distortion "
        "calibration*, fits. What is left is the same in the first two cases, because the cubic contains shift, roll "
        "and scale."
    )


def _published_text(result: Result) -> str:
    first, reference = result.config.methods[0], result.config.reference
    mean, spread = over_surveys(result, first, reference)
    alone = noise_removed_arcsec(result)
    every = result.scale * result.measured.over_surveys(first, reference)[:, 2]
    above = 100.0 * (every >= np.array(PUBLISHED_ARCSEC)).mean(0)
    terms = (result.config.order + 1) * (result.config.order + 2) // 2
    points = result.config.target.rows * result.config.target.columns
    return (
        f"A polynomial of {terms} terms fitted to {points} points removes ({terms} − 1)/({points} − 1) of the variance "
        "of pure noise. Of a "
        f"marking error of {3 * result.config.target.marking_error_arcsec:.2f}″ (3 σ) that is {alone:.2f}″, with no "
        "distortion in the lens at all. The test gives "
        f"{mean[2, 0]:.2f} ± {spread[2, 0]:.2f}″ and {mean[2, 1]:.2f} ± {spread[2, 1]:.2f}″ over "
        f"{result.config.surveys} surveys of one target; {above[0]:.0f} % of them reach the document's "
        f"{PUBLISHED_ARCSEC[0]}″ in x, {above[1]:.0f} % its {PUBLISHED_ARCSEC[1]}″ in y. If it was reduced like this, "
        f"most of its σC1 is its marking error of {MARKING_ARCSEC}″ seen through the polynomial, and eq. 31 adds the "
        "same error once more as σC2."
    )


def _map_text(result: Result) -> str:
    one, forecast = result.maps[result.config.reference], expected_forecast(result)
    seen = result.scale * np.sqrt((one.rms_px**2).mean(0))
    bias, noise = result.scale * forecast.bias_px, result.scale * forecast.noise_px
    return (
        "What a user of the camera feels is neither of the three, but the error of the correction between the points. "
        "It is known here, because the true map is: traced bundles on a dense grid, against camera and polynomial "
        f"of the noisy test. Over the whole detector it is {_xy(seen)} (3 σ, RMS over the surveys). The forecast "
        f"for the cubic splits it: {_xy(bias)} are distortion that a cubic cannot follow, {_xy(noise)} are errors of "
        "the points carried into the map, nearly all of them marking errors. The frames contribute next to nothing; "
        "more of them would not help."
    )


def _study_text(result: Result) -> str:
    best = min(result.forecast, key=lambda one: float((one.rms_px**2).sum()))
    total = float(np.sqrt(((result.scale * best.rms_px) ** 2).mean()))
    return (
        "Dotted lines are the distortion that an order cannot follow, however many points there are; what the full "
        "lines have above them falls with the square root of the number of points. Even orders bring nothing, since a "
        "centred lens has odd distortion. A higher order only pays when the points are many or surveyed better: of "
        f"those shown, the best is order {best.order} on {best.points} points with {total:.2f}″. An order needs more "
        "rows of points than its number; where a curve starts later, the smaller grids do not determine it."
    )


def build_report(result: Result) -> Report:
    """The report of a run; call inside `plotting.house_style`."""
    config, every = result.config, all_tables(result)
    first = config.methods[0]
    one = one_survey(result, first, config.reference)
    seen = result.scale * np.sqrt((result.maps[config.reference].rms_px ** 2).mean(0))
    keys = (
        KeyNumber(
            label="σC1, removed, x / y",
            value=f"{one[2, 0]:.2f} / {one[2, 1]:.2f}",
            unit="″",
            note=f"3 σ; published {PUBLISHED_ARCSEC[0]} / {PUBLISHED_ARCSEC[1]}",
        ),
        KeyNumber(label="σδ, found, x / y", value=f"{one[0, 0]:.2f} / {one[0, 1]:.2f}", unit="″", note="3 σ"),
        KeyNumber(label="σΔδ, left, x / y", value=f"{one[1, 0]:.2f} / {one[1, 1]:.2f}", unit="″", note="3 σ"),
        KeyNumber(
            label="True map error, x / y",
            value=f"{seen[0]:.2f} / {seen[1]:.2f}",
            unit="″",
            note="3 σ, whole detector, all surveys",
        ),
    )
    sections = (
        Section(
            title="Found, left, removed",
            blocks=(
                Equation(latex=EQ29, note="ACC18 eq. 19-30"),
                Figure(
                    drawing=point_arrows(result),
                    caption=f"Residuals at the {len(result.measured.light)} points, {METHOD_NAMES[first]}, one survey; "
                    "each panel on its own scale.",
                ),
                every["distortion"],
                Text(_numbers_text(result)),
            ),
        ),
        Section(
            title="The published value",
            blocks=(
                Figure(
                    drawing=survey_histogram(result),
                    caption=f"σC1 of the same frames reduced with {config.surveys} independent surveys of the target.",
                ),
                Text(_published_text(result)),
            ),
        ),
        Section(
            title="The true map",
            blocks=(
                Figure(
                    drawing=map_panels(result),
                    caption="ACC18 Fig. 8 on a dense grid: true distortion (shift, roll and scale taken out; crosses: "
                    "target points), and the true error of the correction.",
                    raster=True,
                ),
                Text(_map_text(result)),
                every["map"],
            ),
        ),
        Section(
            title="How many points, which order",
            blocks=(
                Figure(
                    drawing=forecast_plot(result),
                    caption="Map error to be expected; dotted: distortion alone.",
                ),
                Text(_study_text(result)),
            ),
        ),
    )
    return Report(
        title="Distortion error",
        lead=f"A grid target of {len(result.measured.light)} surveyed points over the whole detector was rendered, "
        f"read out {result.measured.frames} times in each of two sessions, and reduced as the document does; the "
        "correction that results is compared with the true map of the lens.",
        verdict=f"The number published as error is what the polynomial removed: {_xy(one[2])} here (3 σ). The "
        f"correction itself is wrong by {_xy(seen)} over the detector.",
        key_numbers=keys,
        sections=sections,
    )
