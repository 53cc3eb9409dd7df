"""Words of the temporal-error report."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import cell_text
from experiments.laboratory.point_settings import METHOD_NAMES
from experiments.temporal.evaluate import ratio
from experiments.temporal.figures import frame_cloud, level_curves, ratio_plot, star_scatter, target_frame
from experiments.temporal.result import PUBLISHED_ARCSEC
from experiments.temporal.tables import all_tables

if TYPE_CHECKING:
    from experiments.temporal.result import Result

__all__ = ["build_report"]

EQ1 = r"\bar\sigma = \frac{1}{W} \sum_{j=1}^{W} \sigma_j \, , \qquad \mathrm{TE} = 3\,\bar\sigma \times 5.5''"


def _short(one: Measured) -> str:
    return cell_text(Measured(value=one.value, uncertainty=one.uncertainty))


def _signal_text(result: Result) -> str:
    parts = []
    for method in result.config.methods:
        level = result.published_level_e[method]
        if np.isfinite(level).all():
            parts.append(f"{level[0]:.0f} and {level[1]:.0f} e⁻ for *{METHOD_NAMES[method]}*")
    found = "; ".join(parts) if parts else "no level between 50 and 20 000 e⁻ for any of the centroiders"
    return (
        f"The document gives {PUBLISHED_ARCSEC[0]}″ and {PUBLISHED_ARCSEC[1]}″ (x, y) and says that the brightness was "
        "matched to the camera, not which brightness. With this lens and detector those values belong to signals of "
        f"{found}. A published temporal error without its signal and centroider says little: between the plainest and "
        "the best method lies more than the step from one level to the next."
    )


def _prediction_text(result: Result) -> str:
    return (
        "Both predictions take the PSF of each point from traced bundles, its place from a second trace, and the noise "
        "from the detector's data sheet: photons, dark current, read noise with its spread over the pixels, rounding. "
        "*Influence* carries the variance of each pixel through the derivative of the centroid by that pixel; it is "
        f"exact where a centroid is linear in the noise. *Drawn noise* centroids {result.config.draws} noisy copies of "
        "each window; it also holds where a method has a threshold or iterates, and at low signal, where no method is "
        "linear. Neither sees a frame or the detector chain. What they cannot know is the individual chip: a pixel in "
        "the core of a star with more read noise than the median shows in one star's scatter, and a known bad pixel "
        "that the reduction leaves out."
    )


def _raw_text(result: Result) -> str:
    first = result.config.methods[0]
    dark, raw = result.nominal.te_arcsec(first)[0], result.nominal.te_arcsec(first, 0, "raw")[0]
    return (
        "Dark-subtracted frames lose the mean of frames with the lamp off; raw ones lose the nominal offset and one "
        "background value per window. A fixed pattern shifts centroids but does not make them scatter, so the two "
        f"hardly differ at this signal ({_short(dark)}″ and {_short(raw)}″ in x). They part at low signal, where the "
        "pattern moves the window's centre of mass or its threshold decides which pixels count. The same pattern is "
        "half of another experiment: `hsfe`."
    )


def _limits_text(result: Result) -> str:
    return (
        "Rays only, no diffraction; the spots are as sharp as the prescription makes them. The platform is at rest and "
        "the air is still: no vibration, no seeing. The lamp does not flicker (a common factor moves no centroid). "
        "Random telegraph noise and the tail of the read-noise distribution are not modelled, only its spread. The "
        f"reduction starts every frame at the same place, found once at {result.config.source.signal_e:g} e⁻, as for a "
        "target that stands still; a camera that detects anew in every frame adds jumps of its windows."
    )


def build_report(result: Result) -> Report:
    """The report of a run; call inside `plotting.house_style`."""
    config, every = result.config, all_tables(result)
    first = config.methods[0]
    x, y = result.nominal.te_arcsec(first)
    found = ratio(result.nominal, result.predicted_nominal, first, 0)
    bound = result.predicted_nominal.bound_te_arcsec()
    keys = (
        KeyNumber(
            label="Temporal error, x", value=x.value, unit="″", format=".3f", note=f"± {x.uncertainty:.3f}″, 3 σ"
        ),
        KeyNumber(
            label="Temporal error, y", value=y.value, unit="″", format=".3f", note=f"± {y.uncertainty:.3f}″, 3 σ"
        ),
        KeyNumber(
            label="Measured / predicted, x",
            value=found[0].value,
            format=".3f",
            note=f"± {found[0].uncertainty:.3f}; predicted without frames",
        ),
        KeyNumber(
            label="Published", value=f"{PUBLISHED_ARCSEC[0]} / {PUBLISHED_ARCSEC[1]}", unit="″", note="signal not given"
        ),
    )
    clouds = Row(
        (
            Figure(
                drawing=target_frame(result),
                caption="One frame: the windows around the stars, compressed brightness.",
                raster=True,
            ),
            Figure(
                drawing=frame_cloud(result),
                caption=f"All frames of all stars about each star's mean, {METHOD_NAMES[first]}.",
                raster=True,
            ),
        )
    )
    sections = (
        Section(
            title="Against signal",
            blocks=(
                Equation(latex=EQ1, note="ACC18 eq. 1-2"),
                Figure(
                    drawing=level_curves(result),
                    caption="ACC18 Fig. 5 redrawn. Points: measured; lines: predicted by drawn noise; grey: below the "
                    "Cramér-Rao bound, where no unbiased estimator can be.",
                ),
                Text(_signal_text(result)),
            ),
        ),
        Section(
            title="Measured against predicted",
            blocks=(
                every["temporal_error"],
                Figure(
                    drawing=ratio_plot(result),
                    caption="Measured over predicted at every level, colours as above; the band is ten per cent.",
                ),
                Text(_prediction_text(result)),
            ),
        ),
        Section(
            title="Frames and stars",
            blocks=(
                clouds,
                Figure(
                    drawing=star_scatter(result),
                    caption=f"Scatter star by star, {METHOD_NAMES[first]}. It differs from star to star because the "
                    "light falls differently on the pixels.",
                ),
                Text(_raw_text(result)),
            ),
        ),
        Section(title="What is not in it", blocks=(Text(_limits_text(result)),)),
    )
    return Report(
        title="Temporal error",
        lead=f"{result.nominal.frames} frames of a static target of {len(result.nominal.light)} points at each of "
        f"{len(result.measured.levels_e)} brightness levels were rendered, read out and centroided by "
        f"{len(config.methods)} methods; the scatter is compared with what the noise model predicts without frames.",
        verdict=f"At {config.source.signal_e:g} e⁻ the {METHOD_NAMES[first]} scatters by {_short(x)}″ in x and "
        f"{_short(y)}″ in y (3 σ); the Cramér-Rao bound is {bound[0]:.3f}″ and {bound[1]:.3f}″.",
        key_numbers=keys,
        sections=sections,
    )
