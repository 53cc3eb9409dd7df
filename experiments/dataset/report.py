"""``report.html`` of a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.dataset.figures import (
    attitude_errors,
    centroid_curve,
    completeness_curves,
    example_frame,
    sky_coverage,
)
from experiments.dataset.statistics import solver
from experiments.dataset.tables import all_tables
from experiments.harness.report import Equation, Figure, KeyNumber, Report, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import cell_text

if TYPE_CHECKING:
    from experiments.dataset.evaluate import Evaluation
    from experiments.dataset.result import Result

__all__ = ["build_report"]


def build_report(result: Result) -> Report:
    """What was made, and what others find in it."""
    evaluation = result.evaluation
    sections = [_made(result)]
    if evaluation is not None and len(evaluation.stars.magnitude):
        tables = all_tables(result)
        if any(one.solved for one in evaluation.solved):
            sections.append(_solved(evaluation, tables["solver"]))
        sections += [_detected(evaluation, tables), _centroided(evaluation, tables["centroids"])]
    sections.append(Section(title="What is left out", blocks=(Text(_limits()),)))
    return Report(
        title="Star frames with exact truth",
        lead=_lead(result),
        verdict=_verdict(result),
        key_numbers=_key_numbers(result),
        sections=tuple(sections),
    )


def _lead(result: Result) -> str:
    camera, scene = result.scene.instrument.camera, result.scene
    half = np.array([camera.width_px, camera.height_px]) * camera.pixel_pitch_mm / 2
    wide, high = np.degrees(2 * np.arctan(half / scene.instrument.focal_length_mm))
    stars = sum(one.stars for one in result.facts)
    return (
        f"{len(result.facts)} frames of the real sky ({scene.catalogue.catalog.name}, to "
        f"{result.scene.faintest_mag:g} mag) through the lens {camera.lens.name}, {wide:.1f}° × {high:.1f}° on "
        f"{camera.width_px} × {camera.height_px} px: {stars} star images, each with its chief ray, its bundle, the "
        "centroid of its light, its electrons and what disturbs it."
    )


def _verdict(result: Result) -> str:
    evaluation = result.evaluation
    if evaluation is None:
        return "The frames were made and not looked at (verify.frames = 0)."
    if not evaluation.solved:
        return f"The frames were not solved: {evaluation.without_solver}."
    found = solver(evaluation.solved)
    if not found.solved:
        return f"tetra3rs solves none of {found.attempted} frames: {evaluation.solved[0].message}."
    return (
        f"tetra3rs solves {found.solved} of {found.attempted} frames blind; the boresight is off by "
        f"{cell_text(found.median_arcsec, '.2f')}″ in the median, {found.mirrored} frames mirrored."
    )


def _key_numbers(result: Result) -> tuple[KeyNumber, ...]:
    shown = [KeyNumber(value=len(result.facts), label="frames")]
    if np.isfinite(result.frames_per_s):
        shown.append(KeyNumber(value=Measured(value=result.frames_per_s), label="frames per second"))
    evaluation = result.evaluation
    if evaluation is not None and any(one.solved for one in evaluation.solved):
        found = solver(evaluation.solved)
        shown += [
            KeyNumber(value=f"{found.solved} of {found.attempted}", label="solved blind"),
            KeyNumber(
                value=Measured(value=found.median_arcsec, unit="arcsec", uncertainty=found.median_error_arcsec),
                label="median boresight error",
            ),
        ]
    if evaluation is not None and len(evaluation.wcs_miss_px):
        shown.append(
            KeyNumber(value=Measured(value=float(evaluation.wcs_miss_px.max()), unit="px"), label="largest WCS error")
        )
    return tuple(shown)


def _made(result: Result) -> Section:
    caption = "Boresights of all frames, icrs, east to the left; the colour is the number of stars on the detector."
    sky = Figure(drawing=sky_coverage(result), caption=caption)
    speed = (
        f"This run made {result.made} of the frames with {result.workers} "
        f"process{'es' if result.workers != 1 else ''}"
        + (f", {result.frames_per_s:.1f} a second" if np.isfinite(result.frames_per_s) else "")
        + ". Frame k is a function of the configuration and k: it is the same bytes made alone, in any order, by any "
        "number of processes."
    )
    if result.resume is not None:
        speed += (
            f" A run of {result.resume.frames} of them was killed when {result.resume.whole_when_killed} were whole, "
            f"and taken up again: {result.resume.same_bytes} of {result.resume.frames} are the same bytes."
        )
    if result.evaluation is None or result.evaluation.example is None:
        return Section(title="The frames", blocks=(Text(speed), sky))
    number = result.evaluation.example.frame
    frame = Figure(
        drawing=example_frame(result.evaluation),
        caption=f"Frame {number} above its dark, stars enlarged. Circles: detections; squares: those with a flag "
        "(saturated, blended, at the edge, sharper than a star).",
        raster=True,
    )
    return Section(title="The frames", blocks=(Text(speed), frame, sky))


def _solved(evaluation: Evaluation, table: object) -> Section:
    return Section(
        title="Solved by a stranger",
        blocks=(
            Text(
                "tetra3rs gets centroids and a camera model fitted to the traced lens (within "
                f"{cell_text(evaluation.calibration.max_px, '.1e')} px, stars of "
                f"{evaluation.temperature_k:.0f} K), no attitude, and the whole sky. From all detections within a "
                "pixel of a star the attitude follows with weights"
            ),
            Equation(
                latex=r"w_i = 1 / (\sigma_i^2 + s^2), \quad \mathrm{median}_i\, w_i r_i^2 = 2 \ln 2",
                note="after Paule & Mandel 1982",
            ),
            Text(
                "in which *σ* is the centroid's own covariance and *s* an error common to all that nobody modelled "
                "(undersampling, star colours), found from the residuals alone: "
                f"{cell_text(float(np.nanmedian([one.common_px for one in evaluation.solved])), '.3f')} px in the "
                "median. Errors are against the truth."
            ),
            table,  # type: ignore[arg-type]
            Figure(
                drawing=attitude_errors(evaluation),
                caption="Boresight errors of all solved frames, with the circles that hold half and 95 % of them; "
                "errors in units of what the covariance of each attitude says.",
            ),
        ),
    )


def _detected(evaluation: Evaluation, tables: object) -> Section:
    stars = evaluation.stars
    every = dict(tables)  # type: ignore[call-overload]
    unflagged = int((~stars.false_spike).sum())
    return Section(
        title="What is detected",
        blocks=(
            Figure(
                drawing=completeness_curves(evaluation),
                caption="Share of the rendered stars that are found, with 68 % intervals. Stars that lose light over "
                "the edge do not count; blended ones do.",
            ),
            every["completeness"],
            every["flags"],
            Text(
                f"{len(stars.false)} detections in {stars.frames} frames belong to no rendered star; {unflagged} of "
                f"them carry no flag, {unflagged / stars.frames:.2f} a frame; in frames without stars there are "
                f"{evaluation.empty_detections / evaluation.empty_frames:.2f}. "
                "Those with a flag are hot pixels and cosmic rays sharper than any star; a cosmic ray that crosses "
                "several pixels looks like a star to the detection."
            ),
        ),
    )


def _centroided(evaluation: Evaluation, table: object) -> Section:
    return Section(
        title="How well stars are placed",
        blocks=(
            Figure(
                drawing=centroid_curve(evaluation),
                caption="Centroid minus centroid of the noiseless light. Dots: single stars (length of the error over "
                "√2); circles: standard deviation per axis of stars without any flag; line: Cramér-Rao bound of the "
                "same stars.",
                raster=True,
            ),
            table,  # type: ignore[arg-type]
        ),
    )


def _limits() -> str:
    return (
        "Rays only, no diffraction. Stars are black bodies of their colour's temperature, single and constant: binary "
        "companions closer than the catalogue resolves and variability are not in it. Stars fainter than the magnitude "
        "limit are not rendered one by one."
    )
