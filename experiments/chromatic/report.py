"""Words of the chromatic report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.chromatic.evaluate import lsfe_arcsec, rule_of_third
from experiments.chromatic.figures import (
    arrow_map,
    calibration_dots,
    element_bars,
    fig7,
    spot_gallery,
    star_shifts,
    target_image,
)
from experiments.chromatic.result import PUBLISHED_TABLE1_PX
from experiments.chromatic.tables import all_tables, moved_label
from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import Table, cell_text
from experiments.laboratory.centroid_methods import needs_epsf

if TYPE_CHECKING:
    from experiments.chromatic.result import Result

__all__ = ["build_report"]

EQ16 = (
    r"\bar\delta_{X(800-600)} = \frac{1}{2}\;\cdot\;\frac{1}{4 W}\;\; \sum_{k=1}^{4}\;\; \sum_{j=1}^{W}\;\; "
    r"\left( \bar X_{j,800}^{(k)} - \bar X_{j,600}^{(k)} \right)"
)
FILTER_INDEX = 1.5
"""Of a filter's glass, for the wedge that would move an image; the size matters here, not the glass."""


def _number(value: float, spec: str) -> str:
    """A number with a real minus sign, as the tables set it."""
    return cell_text(float(value), spec)


def _prediction_text(result: Result) -> str:
    worst = max(
        float(np.abs(e.photon_shift_px[n] - e.predicted_shift_px[n]).max())
        for e in (result.centred, result.moved)
        for n in e.photon_shift_px
    )
    return (
        "What each comparison proves: the noiseless light and the mean of the rays come from the rendering. The "
        "ray-trace prediction never sees an image; it evaluates the same prescription again on NumPy instead of the "
        "just-in-time compiled kernel, with other pupil points and other wavelengths, and agrees with the rendered "
        f"light to {_number(worst, '.1e')} px at every point. It shares the formulas of the trace, so it cannot find "
        "an "
        "error in them: that is what the tests against batoid and optiland are for. The paraxial column below is a "
        "path of its own.\n\n"
        "The default centroider knows the shape of the light behind each filter from the lens, with its origin at the "
        "mean of the rays. It shows what noise, pixels and fixed pattern leave of the shift when the PSF is known "
        "perfectly; it does not show what a laboratory that knows it less well would find. That is in the last section."
    )


def _why_zero(result: Result) -> str:
    pair, axis = result.config.decentre.pair, "xy".index(result.config.decentre.axis)
    s, moved, centred = result.chosen, result.moved, result.centred
    verb = "decentred" if s.kind == "decentre" else "tilted"
    unit = "µm" if s.unit == "um" else s.unit
    found, with_moved = (
        cell_text(Measured(value=float(e.table1_px[pair][axis]), uncertainty=float(e.table1_sigma_px[pair][axis])))
        for e in (centred, moved)
    )
    return (
        "Lateral colour of a centred lens lies along the radius and is odd across the field; over four symmetric "
        "positions the *signed* mean of eq. 16 removes it, whatever its size. Here the points shift by "
        f"{centred.residual_px[pair]['as found']:.3f} px RMS between the two filters of {pair} nm, and eq. 16 gives "
        f"{found} px. Only an even term survives the mean: the prism of a decentred or tilted element. With "
        f"{s.element} {verb} by {abs(s.amount):.0f} {unit} the same procedure gives {with_moved} px. That is no "
        "small error: "
        f"it moves the whole image by {float(np.linalg.norm(s.boresight_px)):.0f} px "
        f"({float(np.linalg.norm(s.boresight_px)) * result.instrument.pixel_arcsec:.0f}″) and adds coma that an "
        "alignment "
        "bench would see; elements of such lenses are usually centred to 10 to 30 µm." + _witness_text(result)
    )


def _witness_text(result: Result) -> str:
    """What the pairs that were not fitted say; nothing if there is no other pair."""
    wanted = result.config.decentre
    pair, axis = wanted.pair, "xy".index(wanted.axis)
    able = [one for one in result.solutions if np.isfinite(one.amount)]
    parts = []
    for other in (name for name, _, _ in result.pairs if name != pair and wanted.wanted_px):
        ratio = [float(one.table1_px[other][axis] / one.table1_px[pair][axis]) for one in able]
        parts.append(f"{_number(min(ratio), '.2f')} to {_number(max(ratio), '.2f')} of it in {other}")
    if not parts:
        return ""
    shift_arcsec = 2 * abs(wanted.wanted_px) * result.instrument.pixel_arcsec
    wedge_arcsec = shift_arcsec / (FILTER_INDEX - 1.0)
    text = (
        f"\n\nThe other filters are a witness. Whichever element is moved until {pair} shows {wanted.wanted_px:g} "
        f"px, the same axis shows {' and '.join(parts)}."
    )
    published = PUBLISHED_TABLE1_PX.get(pair)
    if published is None or published[axis] != wanted.wanted_px:
        return text
    return (
        f"{text} The document finds almost nothing there. As long as the centroid is that of all the light, one "
        f"displaced element of this lens can produce the document's {wanted.wanted_px:g} px, but not the document's "
        "Table "
        "1. A centroider that follows the core of the spot can come closer, because axial colour changes with the "
        "filter "
        "how much of the coma it sees (last section); the document gives neither its focus nor its window. Something "
        "that "
        f"acts on one filter alone also can: {wanted.wanted_px:g} px after halving is a common image motion of "
        f"{shift_arcsec:.1f}″ between "
        f"two filters. A wedge of {wedge_arcsec:.1f}″ in one filter would give it in collimated light (a larger one "
        "near the target, where the document puts its filters), or a drift of the bench while filters were "
        "exchanged. The document's procedure cannot tell these from the lens."
    )


def _calibration_text(result: Result) -> str:
    pair = result.config.decentre.pair
    steps, light = result.centred.residual_px[pair], result.centred.photon_residual_px[pair]
    return (
        "A principal point per band removes what eq. 16 sees; a focal length per band removes what it does not. For "
        f"the centred lens the {pair} nm shift falls from {steps['as found']:.3f} px to {steps['both']:.3f} px when "
        f"the camera model has both. Without the noise of the centroids {light['both']:.3f} px are left: the part of "
        "lateral colour that is not linear in the field."
    )


def _stars_text(result: Result) -> str:
    stellar, stars = result.stellar, result.config.stars
    half = 3 * next(iter(rule_of_third(result).values()))
    worst, apart = float(stellar.rms_px.max()), stellar.most_different_rms_px
    extreme = f"{float(stellar.temperature_k[int(np.argmax(stellar.rms_px))]):g} K"
    bound = "so here a third bounds it" if apart <= half / 3 else "so a third is the right size but no upper bound"
    if apart > half:
        bound = "so a third is far too little"
    return (
        "The document divides by three because starlight fills the pass band of the camera, not of one filter. "
        f"Black bodies were rendered through {stars.passband_nm[0]:g} to {stars.passband_nm[1]:g} nm at {stars.grid} "
        f"× {stars.grid} places over the whole detector.\n\n**Centred lens.** The star that moves most ({extreme}) "
        f"shifts by {worst:.3f} px RMS against one of {stars.reference_k:g} K, and by up to "
        f"{float(stellar.max_px.max()):.3f} px at one place; the two stars of the list that differ most are "
        f"{apart:.3f} px apart. Half the filter shift of a *point* is {half:.3f} px RMS at the same places: stars "
        f"shift by {worst / half:.2f} and {apart / half:.2f} of it, {bound}. Applied to the document's signed mean, "
        "which is zero here, the rule would predict no stellar shift at all." + _moved_stars_text(result)
    )


def _moved_stars_text(result: Result) -> str:
    """The rule on the lens whose signed mean is not zero; nothing where nothing was moved."""
    moved, wanted = result.moved_stellar, result.config.decentre
    if wanted.wanted_px == 0:
        return ""
    means, allowed = moved.mean_px[:, "xy".index(wanted.axis)], abs(wanted.wanted_px) / 3
    farthest = int(np.argmax(np.abs(means)))
    largest = float(np.abs(means[farthest]))
    outcome = "There the document's third holds."
    if largest > allowed:
        outcome = (
            f"There the document's third is too small by a factor of {largest / allowed:.1f}: a wedge disperses the "
            "blue end of the pass band most, and eq. 16 halves what a star feels in full."
        )
    return (
        f"\n\n**Element moved**, where the signed mean is {_number(wanted.wanted_px, 'g')} px and the rule allows "
        f"{allowed:.3f} px: {moved.temperature_k[farthest]:g} K stars shift, averaged over the field, by "
        f"{_number(means[farthest], '+.3f')} px in {wanted.axis.upper()}, and the means of the list span "
        f"{float(np.ptp(np.append(means, 0.0))):.3f} px. {outcome}"
    )


def _lsfe_text(result: Result) -> str:
    x, y, moved_x, moved_y = (
        cell_text(one) for evaluation in (result.centred, result.moved) for one in lsfe_arcsec(result, evaluation)
    )
    return (
        "Read as the document reads it (per axis the largest entry, divided by three, times three sigma), the "
        f"chromatic LSFE of the centred lens is {x}″ in x and {y}″ in y, that of the lens with the moved element "
        f"{moved_x}″ and {moved_y}″; published are 0.03″ and 0.66″. An absolute value of noise is not zero: entries "
        "within their uncertainty mean none was found. The document has its 0.12 px in X of its Table 1 and in y of "
        "its result; here it stays in the axis where it is."
    )


def _centroider_text(result: Result) -> str:
    """What the choice of the method changes."""
    wanted = result.config.decentre
    axis = "xy".index(wanted.axis)
    light = float(result.moved.photon_table1_px[wanted.pair][axis])
    return (
        "ACC18 names frame differences and the centre of gravity. For the centred lens every method agrees on zero in "
        "eq. 16, because its errors are as odd over the field as the lens is; the RMS error column shows that they do "
        f"not agree point by point. With the moved element the light itself gives {_number(light, '.3f')} px in "
        f"{wanted.pair} nm and the methods disagree: the displaced element makes comatic spots, the focus differs from "
        "filter to filter (axial colour), and a method that weights the core follows the tail only in part. *ePSF of "
        "the "
        "reference filter* is the same fit with one PSF for all filters, as a laboratory has that measured its PSF "
        "once: "
        "the shape error goes straight into the shift. None of these is wrong; they answer different questions, and a "
        "published chromatic error means little without the centroider, the window and the focus."
    )


def _limits_text(result: Result) -> str:
    return (
        "Rays only: diffraction is not in the spots. Its Airy radius at F/2.95 is 1.8 to 2.9 µm from 500 to 800 nm, "
        "comparable with the sharpest spots here. The mean of all light, hence the truth and Table 1, does not "
        "depend on "
        "it; spot shapes, noise and the errors of core-weighted centroiders do. Coatings and glass absorb as on the "
        "axis for every ray. Charge diffusion is the same at all wavelengths; in silicon it grows to the red. The "
        "collimator has no colour of its own. The PRNU pattern is that of one simulated detector; its size, which the "
        "uncertainties use, is known."
    )


def _frames_text(result: Result) -> str:
    config = result.config
    radii = ", ".join(
        f"{radius:.1f} µm at {centre:g} nm"
        for radius, centre in zip(result.centred.measurement.rms_spot_um, config.filters.centres_nm, strict=True)
    )
    model = ": the pixel model of each point is rendered from the lens, its origin is the mean of the traced rays"
    model = model if needs_epsf(config.centroid) else ""
    return (
        f"Every point gives {config.signal_e:g} e⁻ per frame behind every filter; a V = 7.5 star of "
        f"{config.stars.reference_k:g} K gives {result.star_e:.0f} e⁻ through the full pass band in the same "
        f"{config.instrument.exposure_s:g} s. RMS spot radii (rays, mean of the points) are {radii}. "
        f"{config.dark_frames} frames with the lamp off are averaged and subtracted. The centroider is "
        f"*{config.centroid}*{model}."
    )


def _frames(result: Result) -> Section:
    target = Figure(
        drawing=target_image(result),
        caption="The target at the upper left position behind all filters at once, each in its own colour; points are "
        "blurred to be visible at this size.",
        raster=True,
    )
    spots = Figure(
        drawing=spot_gallery(result, result.centred),
        caption="One point behind each filter, each column on its own scale; the cross is the centroid of the "
        "noiseless light.",
        raster=True,
    )
    return Section(title="The frames", blocks=(Row((target, spots)), Text(_frames_text(result))))


def _table1(result: Result, every: Mapping[str, Table]) -> Section:
    arrows = Figure(
        drawing=arrow_map(result, result.centred, "centred"),
        caption="Shift of every point between two filters. Coloured: measured; grey beneath: ray-trace prediction. The "
        "vertical line is the seam between the two chips.",
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
            every["table1"],
            Text(_lsfe_text(result)),
            Text(_prediction_text(result)),
            every["anatomy"],
            arrows,
            points,
        ),
    )


def _signed_mean(result: Result, every: Mapping[str, Table]) -> Section:
    arrows = Figure(
        drawing=arrow_map(result, result.moved, "moved"),
        caption=f"The same with {moved_label(result)}: an even term that all points share is added to the odd one.",
    )
    spots = Figure(
        drawing=spot_gallery(result, result.moved),
        caption=f"The same point with {moved_label(result)}.",
        raster=True,
    )
    bars = Figure(
        drawing=element_bars(result),
        caption="Size of the movement that gives the wanted mean, element by element (written: with its sign); "
        "orange: the one that was rendered.",
    )
    return Section(
        title=f"Why the signed mean vanishes, and what makes it {result.config.decentre.wanted_px:g} px",
        blocks=(Text(_why_zero(result)), arrows, Row((spots,)), bars, every["elements"]),
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
        KeyNumber(
            label="Stars, largest RMS shift",
            value=float(result.stellar.rms_px.max()),
            unit="px",
            format=".3f",
            note=f"against {result.config.stars.reference_k:g} K",
        ),
    )


def build_report(result: Result) -> Report:
    """The report of a run."""
    config, wanted = result.config, result.config.decentre
    axis = "xy".index(wanted.axis)
    calibration = Figure(
        drawing=calibration_dots(result),
        caption="RMS length of the shift, by what the camera model has of its own for each band; dots: measured, "
        "dashes: noiseless light.",
    )
    stars = Figure(
        drawing=star_shifts(result, rule_of_third(result)),
        caption="Chromatic shift of black-body stars through the full pass band, against the reference star. Black "
        "lines: a third of half the shift between filters at the same places, centred lens.",
    )
    every = all_tables(result)
    seen = cell_text(
        Measured(
            value=float(result.centred.table1_px[wanted.pair][axis]),
            uncertainty=float(result.centred.table1_sigma_px[wanted.pair][axis]),
        )
    )
    return Report(
        title="Chromatic LSFE of a star camera",
        lead=f"A {config.target.rows} × {config.target.columns} point target at four edge positions behind "
        f"{len(config.filters.centres_nm)} filters, {config.frames} noisy frames each, rendered through the "
        f"prescription {result.instrument.camera.lens.name} (defocus {config.instrument.defocus_mm * 1e3:+g} µm, "
        f"away from the lens) onto {result.instrument.detector.name} and reduced by the equations of ACC18 (*Accuracy "
        "determination for sub-arcsec star camera*, 2018).",
        verdict=f"The published statistic gives {seen} px ({wanted.pair} nm, {wanted.axis.upper()}) where points "
        f"really shift by {result.centred.residual_px[wanted.pair]['as found']:.2f} px RMS; {moved_label(result)} "
        f"turns it into {_number(result.moved.table1_px[wanted.pair][axis], '.3f')} px.",
        key_numbers=_key_numbers(result),
        sections=(
            _frames(result),
            _table1(result, every),
            _signed_mean(result, every),
            Section(
                title="What is left for a camera that calibrates its colour",
                blocks=(Text(_calibration_text(result)), calibration, every["calibration"]),
            ),
            Section(title="Stars instead of filters: is it one third?", blocks=(Text(_stars_text(result)), stars)),
            Section(title="Does the centroider matter?", blocks=(Text(_centroider_text(result)), every["centroiders"])),
            Section(title="What is left out", blocks=(Text(_limits_text(result)),)),
        ),
    )
