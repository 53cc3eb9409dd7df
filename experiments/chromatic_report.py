"""Words of the chromatic report."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.chromatic_evaluate import lsfe_arcsec, rule_of_third
from experiments.chromatic_figures import (
    arrow_map,
    calibration_bars,
    element_bars,
    fig7,
    spot_gallery,
    star_shifts,
    target_image,
)
from experiments.chromatic_model import PUBLISHED_TABLE1_PX
from experiments.chromatic_tables import all_tables, moved_label
from experiments.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.summary import Measured

if TYPE_CHECKING:
    from experiments.chromatic import Result

__all__ = ["build_report"]

EQ16 = (
    r"\bar\delta = \frac{1}{2 \cdot 4 W} \sum_{k=1}^{4} \sum_{j=1}^{W} "
    r"\left( \bar X_{j,800}^{(k)} - \bar X_{j,600}^{(k)} \right)"
)


def _prediction_text(result: Result) -> str:
    worst = max(
        float(np.abs(e.photon_shift_px[n] - e.predicted_shift_px[n]).max())
        for e in (result.centred, result.moved)
        for n in e.photon_shift_px
    )
    real, paraxial = [], []
    for name, high, low in result.pairs:
        real.append(np.linalg.norm(result.centred.predicted_shift_px[name], axis=-1))
        paraxial.append(np.linalg.norm(result.paraxial_px[..., high, :] - result.paraxial_px[..., low, :], axis=-1))
    ratios = " and ".join(
        f"{float(p.mean() / r.mean()):.2f} ({name})"
        for (name, _, _), r, p in zip(result.pairs, real, paraxial, strict=True)
    )
    return (
        "Three predictions stand behind the measured shift. The centroid of the noiseless light and the mean of the "
        "rays "
        "come from the rendering itself. The third never sees an image: another trace of the same prescription, on "
        "NumPy "
        "instead of the just-in-time compiled kernel, with other pupil points and other wavelengths; it agrees with "
        "the "
        f"rendered light to {worst:.1e} px at every point. Paraxial lateral colour, the number in a lens designer's "
        "first "
        f"table, gives {ratios} of the real shift: spherochromatism and the colour of coma move the centroid as well."
    )


def _why_zero(result: Result) -> str:
    pair, axis = result.config.decentre.pair, "xy".index(result.config.decentre.axis)
    s, moved = result.chosen, result.moved
    able = [one for one in result.solutions if np.isfinite(one.amount)]
    other = next(name for name, _, _ in result.pairs if name != pair)
    ratio = [float(one.table1_px[other][axis] / one.table1_px[pair][axis]) for one in able]
    verb = "decentred" if s.kind == "decentre" else "tilted"
    unit = "µm" if s.unit == "um" else s.unit
    shift_arcsec = 2 * result.config.decentre.wanted_px * result.instrument.pixel_arcsec
    return (
        f"Lateral colour of a centred lens points away from the axis and is odd across the field; over four symmetric "
        f"positions the *signed* mean of eq. 16 removes it, whatever its size. Here the points shift by "
        f"{result.centred.residual_px[pair]['as found']:.3f} px RMS between the filters of {pair} nm, and eq. 16 gives "
        f"{result.centred.table1_px[pair][axis]:+.5f} px. Only an even term survives the mean: a prism, hence a "
        "decentred or "
        f"tilted element. With {s.element} {verb} by {abs(s.amount):.0f} {unit} the same procedure gives "
        f"{moved.table1_px[pair][axis]:+.4f} px, as published.\n\n"
        f"The other pair is a witness. For every element the two entries of Table 1 rise together, {other} being "
        f"{min(ratio):.2f} to {max(ratio):.2f} of {pair}; the document finds almost nothing in {other}. A displaced "
        "element of "
        f"this lens can therefore produce the document's {result.config.decentre.wanted_px:g} px, but not the "
        "document's "
        f"Table 1. Something that acts on one filter alone can: {result.config.decentre.wanted_px:g} px after "
        "halving is a "
        f"common image motion of {shift_arcsec:.1f}\" between two filters, which a wedge of that size in the filter's "
        "parallelism, or a drift of the bench while filters were exchanged, would give. The document's procedure "
        "cannot tell "
        f"these from the lens."
    )


def _calibration_text(result: Result) -> str:
    steps = result.centred.residual_px[result.config.decentre.pair]
    return (
        "A principal point per band removes what eq. 16 sees; a focal length per band removes what it does not. For "
        "the "
        f"centred lens the {result.config.decentre.pair} shift falls from {steps['as found']:.3f} px to "
        f"{steps['both']:.3f} px "
        f"when the camera model has both: what is left is the part of lateral colour that is not linear in the field."
    )


def _stars_text(result: Result) -> str:
    rule, stellar = rule_of_third(result), result.stellar
    low, high = rule.values()
    worst = float(stellar.rms_px.max())
    hottest = float(stellar.temperature_k[int(np.argmax(stellar.rms_px))])
    holds = "within" if worst <= low else "beyond"
    spread = float(np.sqrt(((stellar.shift_px[:, None] - stellar.shift_px[None]) ** 2).sum(-1).mean(-1)).max())
    return (
        "The document divides by three because stars fill the pass band. Rendered with black-body spectra through the "
        f"full {result.config.stars.passband_nm[0]:g} to {result.config.stars.passband_nm[1]:g} nm, the star that "
        "moves most "
        f"({hottest:g} K) shifts by {worst:.3f} px RMS over the field against {result.config.stars.reference_k:g} K, "
        "and by up to "
        f"{float(stellar.max_px.max()):.3f} px at one place. A third of the halved filter shift of a *point* is "
        f"{low:.3f} px RMS "
        f"and {high:.3f} px at most, so the rule is {holds} the RMS bound for this lens and this reference star; "
        "between the "
        f"extremes of the list, without a reference, it is {spread:.3f} px. Applied to the document's signed mean, "
        "which is "
        "zero for a centred lens, the rule would predict no stellar shift at all."
    )


def _lsfe_text(result: Result) -> str:
    x, y = lsfe_arcsec(result, result.centred)
    moved_x, moved_y = lsfe_arcsec(result, result.moved)
    return (
        "Read as the document reads it (the largest entry divided by three, times three sigma), the chromatic LSFE "
        "of the "
        f'centred lens is {x.value:.3f}" (x) and {y.value:.3f}" (y), that of the lens with the moved element '
        f'{moved_x.value:.2f}" and {moved_y.value:.2f}"; published are 0.03" and 0.66". The document has its 0.12 px in '
        "X of the table and in y of the result; here it stays in X."
    )


def _frames_text(result: Result) -> str:
    config = result.config
    radii = ", ".join(
        f"{radius:.1f} µm at {centre:g} nm"
        for radius, centre in zip(result.centred.measurement.rms_spot_um, config.filters.centres_nm, strict=True)
    )
    return (
        f"Every point gives {config.signal_e:g} e⁻ per frame behind every filter; a V = 7.5 star of "
        f"{config.stars.reference_k:g} K gives {result.star_e:.0f} e⁻ through the full pass band in the same "
        f"{config.instrument.exposure_s:g} s. RMS spot radii are {radii}. {config.dark_frames} frames with the lamp "
        "off are "
        f"averaged and subtracted. The centroider is *{config.centroid}*: the pixel model of each point is rendered "
        "from the "
        "lens, its origin is the mean of the traced rays."
    )


def _frames(result: Result) -> Section:
    target = Figure(
        drawing=target_image(result),
        caption="The target at the upper left position behind all filters at once, each in its own colour; points are "
        "blurred to be visible at this size.",
        raster=True,
    )
    spots = Figure(
        drawing=spot_gallery(result),
        caption="One point behind each filter; the cross is the centroid of the noiseless light.",
        raster=True,
    )
    return Section(title="The frames", blocks=(Row((target, spots)), Text(_frames_text(result))))


def _table1(result: Result) -> Section:
    arrows = Figure(
        drawing=arrow_map(result, result.centred, "centred"),
        caption="Shift of every point between two filters. Coloured: measured; grey beneath: ray-trace prediction. The "
        "vertical line is the seam between the two detectors.",
    )
    points = Figure(
        drawing=fig7(result, result.centred),
        caption="ACC18 Fig. 7 redrawn: the shift of each point, position after position; dashed, the signed mean that "
        "eq. 16 halves.",
    )
    return Section(
        title="Table 1",
        blocks=(
            Equation(latex=EQ16, note="ACC18 eq. 16"),
            all_tables(result)["table1"],
            Text(_lsfe_text(result)),
            Text(_prediction_text(result)),
            arrows,
            points,
        ),
    )


def _signed_mean(result: Result) -> Section:
    arrows = Figure(
        drawing=arrow_map(result, result.moved, "moved"),
        caption=f"The same with {moved_label(result)}: an even term that all points share is added to the odd one.",
    )
    bars = Figure(
        drawing=element_bars(result),
        caption="Movement that gives the wanted mean, element by element; orange: the one that was rendered.",
    )
    return Section(
        title=f"Why the signed mean vanishes, and what makes it {result.config.decentre.wanted_px:g} px",
        blocks=(Text(_why_zero(result)), arrows, bars, all_tables(result)["elements"]),
    )


def _key_numbers(result: Result) -> tuple[KeyNumber, ...]:
    wanted, chosen, centred = result.config.decentre, result.chosen, result.centred
    axis = "xy".index(wanted.axis)
    published = PUBLISHED_TABLE1_PX.get(wanted.pair)
    value, sigma = centred.table1_px[wanted.pair][axis], centred.table1_sigma_px[wanted.pair][axis]
    steps = centred.residual_px[wanted.pair]
    return (
        KeyNumber(
            label=f"Table 1, {wanted.pair} nm, {wanted.axis.upper()}",
            value=Measured(value=float(value), unit="px", uncertainty=float(sigma)),
            note=f"published {published[axis]:g} px" if published else "",
        ),
        KeyNumber(
            label="RMS shift of a point",
            value=steps["as found"],
            unit="px",
            format=".3f",
            note=f"{steps['both']:.3f} px after calibrating the band",
        ),
        KeyNumber(
            label=f"{chosen.element} {chosen.kind} for {wanted.wanted_px:g} px",
            value=abs(chosen.amount),
            unit="µm" if chosen.unit == "um" else chosen.unit,
            format=".0f",
        ),
        KeyNumber(label="Stars, largest RMS shift", value=float(result.stellar.rms_px.max()), unit="px", format=".3f"),
    )


def build_report(result: Result) -> Report:
    """The report of a run."""
    config, wanted = result.config, result.config.decentre
    axis = "xy".index(wanted.axis)
    calibration = Figure(drawing=calibration_bars(result), caption="RMS length of the shift, by camera model.")
    stars = Figure(
        drawing=star_shifts(result, rule_of_third(result)),
        caption="Chromatic shift of black-body stars through the full pass band.",
    )
    every = all_tables(result)
    return Report(
        title="Chromatic LSFE of a star camera",
        lead=f"A {config.target.rows} x {config.target.columns} point target at four edge positions behind "
        f"{len(config.filters.centres_nm)} filters, {config.frames} noisy frames each, rendered through the "
        "prescription "
        f"{config.instrument.lens} (defocus {config.instrument.defocus_mm * 1e3:g} µm) onto "
        f"{result.instrument.detector.name} and reduced as ACC18 (*Accuracy determination for sub-arcsec star camera*, "
        "2018) reduces it.",
        verdict=f"The published statistic sees {abs(result.centred.table1_px[wanted.pair][axis]):.4f} px where points "
        f"really shift by {result.centred.residual_px[wanted.pair]['as found']:.2f} px; {moved_label(result)} turns it "
        f"into {result.moved.table1_px[wanted.pair][axis]:.3f} px.",
        key_numbers=_key_numbers(result),
        sections=(
            _frames(result),
            _table1(result),
            _signed_mean(result),
            Section(
                title="What is left for a camera that calibrates its colour",
                blocks=(Text(_calibration_text(result)), calibration, every["calibration"]),
            ),
            Section(title="Stars instead of filters: is it one third?", blocks=(Text(_stars_text(result)), stars)),
            Section(title="Does the centroider matter?", blocks=(every["centroiders"],)),
        ),
    )
