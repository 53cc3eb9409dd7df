"""Words of the report on the calibration under the sky."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import Table, cell_text
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.skycal.calibrate import METHODS
from experiments.skycal.evaluate import PARTS
from experiments.skycal.figures import (
    centroid_errors,
    close_ups,
    decomposition,
    error_and_uncertainty,
    method_bars,
    model_curves,
    part_maps,
    sky_frame,
    star_cover,
)
from experiments.skycal.result import CameraResult, Result
from experiments.skycal.settings import model_label
from experiments.skycal.tables import all_tables

__all__ = ["build_report"]


def build_report(result: Result) -> Report:
    """The report of a run."""
    every, cameras = all_tables(result), list(result.cameras.values())
    return Report(
        title="Star cameras calibrated under the sky, from pixels",
        lead=_lead(result),
        verdict=_verdict(cameras),
        key_numbers=_key_numbers(cameras),
        sections=(
            _frames(result, every),
            _maps(cameras, every),
            _made_of(cameras, every),
            _which_model(cameras, every),
            _gyro(cameras, every),
            _wrong(cameras, every),
            Section(title="Parameters", blocks=(every["parameters"],)),
            Section(title="What is left out", blocks=(Text(_limits(result)),)),
        ),
    )


def _number(value: float, digits: int = 2) -> str:
    """A number with some significant digits, set as the tables set it."""
    if value == 0 or not np.isfinite(value):
        return cell_text(float(value))
    if abs(value) < 1e-3:
        return cell_text(float(value), f".{digits - 1}e")
    return cell_text(float(value), f".{max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))}f")


def _lead(result: Result) -> str:
    config, one = result.config, next(iter(result.cameras.values()))
    lenses = " and ".join(
        "the {} ({:.1f}° × {:.1f}°)".format(camera.title, *camera.scene.instrument.field_deg)
        for camera in result.cameras.values()
    )
    return (
        f"{config.frames} frames of a moving sky ({one.scene.sky.name.split(' to ')[0]}), rendered star by star "
        "through "
        f"{lenses}, read out with noise, detected, centroided, matched from an attitude known to "
        f"{config.motion.attitude_error_arcmin:g}′, and calibrated from a start "
        f"{100 * abs(1 - config.start.focal_ratio):.0f} % "
        "off in focal length. The truth is the traced lens."
    )


def _verdict(cameras: list[CameraResult]) -> str:
    said = []
    for camera in cameras:
        said.append(
            f"{camera.title}: {_number(camera.total.rms_arcsec)}″ as measured, "
            f"{_number(camera.of('corrected').rms_arcsec)}″ with star colours known"
        )
    return "Map error after removing the best rotation, RMS over the detector. " + "; ".join(said) + "."


def _key_numbers(cameras: list[CameraResult]) -> tuple[KeyNumber, ...]:
    shown = []
    for camera in cameras:
        fine = camera.of("corrected")
        shown.append(
            KeyNumber(
                label=f"Map error, {camera.title}",
                value=camera.total.rms_arcsec,
                unit="arcsec",
                format=".2g",
                note=f"1/{camera.scene.pixel_arcsec / camera.total.rms_arcsec:.0f} of a pixel; it says "
                f"{_number(camera.total.predicted_arcsec)}″",
            )
        )
        shown.append(
            KeyNumber(
                label="with star colours known",
                value=fine.rms_arcsec,
                unit="arcsec",
                format=".2g",
                note=f"it says {_number(fine.predicted_arcsec)} ± {_number(fine.predicted_spread_arcsec, 1)}″",
            )
        )
    return tuple(shown)


def _frames(result: Result, every: Mapping[str, Table]) -> Section:
    blocks: list[Figure | Row | Text | Table] = [Text(_frames_text(result))]
    for camera in result.cameras.values():
        half = camera.scene.instrument.field_deg[1] > 0.75 * camera.scene.instrument.field_deg[0]
        frame = Figure(
            drawing=sky_frame(camera, half=half),
            caption=f"Frame {camera.recording.example_index} of the {camera.title}: column medians taken off, stars "
            "enlarged, logarithmic. Rings: stars matched and used, in their colours. Pink crosses: detections left "
            "out; squares: saturated.",
            raster=True,
        )
        stars = Figure(
            drawing=close_ups(camera, half=half),
            caption=f"Stars of that frame, {camera.title}, brightest to faintest, with G magnitude and colour "
            "temperature; the cross is the centroid of the noiseless light.",
            raster=True,
        )
        blocks += [Row((frame, stars))] if half else [frame, stars]
    covers = [
        Figure(
            drawing=star_cover(camera),
            caption="Where the stars of all frames fell, in their colours; larger: brighter.",
            raster=True,
        )
        for camera in result.cameras.values()
    ]
    blocks += [Row(tuple(covers)), every["detections"]]
    return Section(title="The frames", blocks=tuple(blocks))


def _frames_text(result: Result) -> str:
    config = result.config
    source = next(iter(result.cameras.values())).scene.sky
    exposures = "; ".join(
        f"{camera.title}: {camera.scene.config.instrument.exposure_s:g} s, stars to G = "
        f"{camera.scene.config.faintest_mag:g}, "
        f"{camera.stars_per_frame:.0f} used per frame"
        for camera in result.cameras.values()
    )
    text = (
        f"The camera turns by {config.motion.rate_deg_per_s:g} °/s about an axis that itself turns; motion during the "
        "exposure is switched off. Every star has its own magnitude and colour and is traced through the full pass "
        "band "
        f"({config.sky.passband_nm[0]:g} to {config.sky.passband_nm[1]:g} nm, {config.sky.nodes} wavelengths). "
        f"{exposures}. "
        f"A mean of {config.dark_frames} dark frames is subtracted. Stars are found by a matched filter over the whole "
        f"frame, without looking at the catalogue. The centroider is *{config.centroid}*"
    )
    if needs_epsf(config.centroid):
        text += (
            f": PSFs of one colour ({config.sky.reference_k:g} K) rendered from the prescription on a grid over the "
            "field, "
            "interpolated to the place of the star, with the mean of the rays as origin"
        )
    text += (
        ". Names come from the brightest detections, a data-sheet focal length that is "
        f"{100 * abs(config.start.sheet_error_fraction):g} % wrong, no knowledge of the distortion, and the rough "
        "attitude; a first camera made of these matches names the rest."
    )
    return text + (f"\n\n{source.attribution}" if source.attribution else "")


def _maps(cameras: list[CameraResult], every: Mapping[str, Table]) -> Section:
    blocks: list[Figure | Text | Table | Equation] = [
        Equation(
            latex=r"e_i = R\,d_i(\hat\theta) - t_i, \quad R = \mathrm{arg\,min} \sum_i |R\,d_i - t_i|^2, \quad "
            r"\mathrm{cov}(e_i) = K_i\, C_\theta\, K_i^T",
            note="map error and its prediction",
        ),
        Text(_maps_text(cameras)),
        every["cameras"],
    ]
    for camera in cameras:
        blocks.append(
            Figure(
                drawing=error_and_uncertainty(camera),
                caption=f"Line-of-sight error of the calibrated {camera.title} over the detector (left: length as "
                "colour, "
                "direction as arrows, each panel with its own length of arrows) beside the uncertainty that the "
                "calibration predicts for itself (right). Above as measured, below with star colours known.",
                raster=True,
            )
        )
    return Section(title="Line of sight against the traced lens", blocks=tuple(blocks))


def _maps_text(cameras: list[CameraResult]) -> str:
    text = (
        "A pixel of the calibrated camera looks along d, light of the reference colour that falls there comes from "
        "t, as "
        "traced through the prescription. A turn of the whole camera means nothing and is removed from the error and "
        "from "
        "the prediction. The prediction comes from residuals and weights alone: every centroid carries its photon "
        "and read "
        "noise, and one more error per axis, the same for all stars, that makes the residuals what they should be ("
        + ", ".join(f"{camera.evaluation.floor_px:.3f} px, {camera.title}" for camera in cameras)
        + "). It covers what looks like noise. It cannot know errors that every star of a colour makes in the same "
        "direction at the same place, and these decide: "
    )
    said = []
    for camera in cameras:
        ratio = camera.total.rms_arcsec / camera.total.predicted_arcsec
        said.append(f"the error of the {camera.title} is {ratio:.1f} times the prediction")
    text += " and ".join(said) + ". Where star colours are known the two agree: "
    agreed = []
    for camera in cameras:
        fine = camera.of("corrected")
        predicted = cell_text(Measured(value=fine.predicted_arcsec, uncertainty=fine.predicted_spread_arcsec))
        agreed.append(
            f"noise moves the map of the {camera.title} by {_number(camera.noise_map_rms_arcsec)}″, predicted "
            f"{predicted}″ "
            f"(probability of a deviation as large: {_number(camera.noise_map_chance)})"
        )
    return text + "; ".join(agreed) + "."


def _made_of(cameras: list[CameraResult], every: Mapping[str, Table]) -> Section:
    blocks: list[Figure | Text | Table] = [
        Text(_made_of_text()),
        Figure(
            drawing=decomposition(cameras),
            caption="RMS of each part over the detector, their root sum square, and the whole; beneath, the same "
            "measured with the PSF of each star's own colour, and its colour shift taken off.",
        ),
        every["parts"],
    ]
    for camera in cameras:
        blocks.append(
            Figure(
                drawing=part_maps(camera),
                caption=f"The parts as maps, {camera.title}: one scale of colour, each panel with its own length of "
                "arrows.",
                raster=True,
            )
        )
    blocks += [
        Text(_cancel_text(cameras)),
        Figure(
            drawing=centroid_errors(cameras),
            caption="Errors of single star positions against signal-to-noise ratio. Dashed: what the centroider "
            "states. "
            "Bright stars leave the line where fixed pattern and the wrong PSF take over. Triangles: how far the light "
            "itself is off because of the star's colour.",
            raster=True,
        ),
    ]
    return Section(title="What the error is made of", blocks=tuple(blocks))


def _made_of_text() -> str:
    names = list(PARTS.values())
    return (
        "The same stars with the same weights are calibrated four times, and every time one more error is switched on. "
        f"First the places where light of the reference colour would fall, from the ray trace: only the *{names[0]}* "
        "is "
        f"left to blame. Then the places where the light of each star did fall: *{names[1]}*. Then centroids "
        "measured with "
        f"the PSF of each star's own colour: *{names[2]}* (photon and read noise, fixed pattern, interpolation of "
        "the PSF, "
        f"blends). Then what the camera does by itself, one PSF for all: *{names[3]}*. Each part is the difference "
        "between "
        "a map and the one before, so that they add up exactly as vectors."
    )


def _cancel_text(cameras: list[CameraResult]) -> str:
    said = []
    for camera in cameras:
        evaluation = camera.evaluation
        alike = evaluation.alike("chromatic", "psf")
        said.append(
            f"{camera.title}: root sum square {_number(evaluation.quadrature_arcsec)}″, total "
            f"{_number(camera.total.rms_arcsec)}″, correlation of colour shift and PSF error {_number(alike)}"
        )
    text = "Do the parts add in quadrature? " + "; ".join(said) + ". "
    if min(camera.evaluation.alike("chromatic", "psf") for camera in cameras) < -0.5:
        text += (
            "They do not where the two colour errors are opposite. The mean of all light of a red or blue star is "
            "drawn "
            "aside by a faint out-of-focus tail; a fit of one sharp PSF follows the core and sees little of that tail. "
            "What counts as a centroid error against the light is then partly the colour shift that was not followed. "
            "An error budget that lists both and adds their squares is too large; one that lists only one of them "
            "need not be."
        )
    return text


def _which_model(cameras: list[CameraResult], every: Mapping[str, Table]) -> Section:
    return Section(
        title="Which camera model is enough",
        blocks=(
            Text(_models_text(cameras)),
            Figure(
                drawing=model_curves(cameras),
                caption="Map error by camera model: what it cannot describe (noiseless stars), what noise does to it "
                "as "
                "predicted, and what comes out with and without knowledge of the star colours.",
            ),
            every["models"],
        ),
    )


def _models_text(cameras: list[CameraResult]) -> str:
    said = []
    for camera in cameras:
        models = camera.scene.config.models
        best = min(models, key=lambda m: camera.of("corrected", model=m).rms_arcsec)
        fine = camera.of("corrected", model=best)
        text = (
            f"**{camera.title}.** Enough is {model_label(best)}: {_number(fine.rms_arcsec)}″ with colours known, of "
            "which "
            f"the model itself makes {_number(camera.of('reference', model=best).rms_arcsec)}″ and noise, as "
            "predicted, "
            f"{_number(fine.predicted_arcsec)}″."
        )
        richest = max(models, key=lambda m: _unknowns(camera, m))
        if richest != best:
            rich = camera.of("corrected", model=richest)
            text += (
                f" A {model_label(richest)} with its {_unknowns(camera, richest)} parameters describes the lens to "
                f"{_number(camera.of('reference', model=richest).rms_arcsec)}″, but its noise is "
                f"{_number(rich.predicted_arcsec)}″: {rich.predicted_arcsec / fine.predicted_arcsec:.1f} times as much."
            )
        said.append(text)
    return (
        "More parameters describe the lens better and noise worse. The models are fitted to the same stars, and once "
        "to "
        "the traced map itself. A centred lens is what Brown and Conrady had in mind: radial terms to the seventh "
        "order. "
        "A general polynomial spends most of its parameters on what such a lens cannot do.\n\n" + "\n\n".join(said)
    )


def _unknowns(camera: CameraResult, model: str) -> int:
    """Free parameters of a camera model."""
    return len(camera.of("measured", model=model).calibration.solution.names)


def _gyro(cameras: list[CameraResult], every: Mapping[str, Table]) -> Section:
    return Section(
        title="Free attitudes against attitudes linked by a gyro, on pixels",
        blocks=(
            Text(_gyro_text(cameras)),
            Figure(
                drawing=method_bars(cameras),
                caption="Map error from the same centroids (star colours known) by how attitudes are treated, and what "
                "each method predicts for itself.",
            ),
            every["methods"],
        ),
    )


def _gyro_text(cameras: list[CameraResult]) -> str:
    said = []
    for camera in cameras:
        free, acc, linked, ideal = (camera.of("corrected", method=method) for method in METHODS)
        gain = free.predicted_arcsec / ideal.predicted_arcsec
        chi2 = acc.calibration.solution.reduced_chi2
        text = (
            f"**{camera.title}**, {camera.stars_per_frame:.0f} stars per frame: a perfect gyro would lower the "
            "predicted "
            f"error by {100 * (gain - 1):.1f} %. With the gyro of ACF17, taken as perfect, the residuals grow to a "
            "χ² of "
            f"{chi2:.1f} per degree of freedom and the map error from {_number(free.rms_arcsec)}″ to "
            f"{_number(acc.rms_arcsec)}″"
        )
        if chi2 > 1.5:
            text += ": between two frames it drifts by more than the stars of one frame can tell"
        text += f"; with its noise in the adjustment the error is {_number(linked.rms_arcsec)}″."
        said.append(text)
    return (
        "ACF17 links the attitudes of all frames by a gyro (eq. 6) and finds the calibration better for it. With "
        "many stars "
        "in every frame the attitudes are known from the stars already, and there is nothing to gain; the document's "
        "gain is that of sparse frames.\n\n" + "\n\n".join(said)
    )


def _wrong(cameras: list[CameraResult], every: Mapping[str, Table]) -> Section:
    said = []
    for camera in cameras:
        plain, robust, hopeless = camera.evaluation.wrong
        said.append(
            f"**{camera.title}.** With {100 * robust.fraction:.0f} % wrong matches the robust fit moves the map by "
            f"{_number(robust.apart_arcsec)}″ and gives no weight to {100 * robust.caught_fraction:.1f} % of them; "
            "least "
            f"squares is off by {_number(plain.rms_arcsec)}″ and {'does not notice' if plain.accepted else 'says so'}. "
            f"With {100 * hopeless.fraction:.0f} % wrong the robust fit is "
            f"{'accepted' if hopeless.accepted else 'refused'}."
        )
    return Section(title="Wrong matches", blocks=(Text("\n\n".join(said)), every["wrong"]))


def _limits(result: Result) -> str:
    return (
        "Rays only: diffraction is not in the spots. Motion during the exposure, aberration of light, proper motion "
        "since "
        "2016.0 and the bending of the camera are switched off; they move stars, not the camera's map. Stars are black "
        "bodies with the colour that the catalogue gives; binaries are single. PSFs come from the prescription, not "
        "from "
        "the frames: the centroider knows the shape of the light better than a laboratory would. *Colours known* uses "
        "the colour shift of the prescription itself; it is the limit that a camera reaches whose colour has been "
        "calibrated as well. The bundles of a lens with its stop inside are sums over Sobol points, the same for all "
        "stars; sums and truth share their error of some 10⁻³ px. One detector, one pattern, one seed "
        f"({result.config.seed})."
    )
