"""Words of the turntable report."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import Table, cell_text
from experiments.laboratory.single_star.sketch import bench_sketch
from experiments.turntable.evaluate import crossover_arcsec, point_over_line, principal_point_arcsec
from experiments.turntable.figures import error_maps, residual_arrows, star_windows, visited_places
from experiments.turntable.plots import correlation_matrix, field_curves, lean_curves, pull_bars, reading_curves
from experiments.turntable.result import Case, Result
from experiments.turntable.tables import all_tables
from optics.units import RAD_ARCSEC

__all__ = ["build_report"]

MODEL = r"v_k = M\; R_k^{T}\; s, \qquad (x_k, y_k) = \mathrm{project}\,(v_k;\; x_0, y_0, f, q_1, q_2, q_3, p_1, p_2)"
VECTORS = r"w_k = R_k\; M^{T}\; u(x_k, y_k)"
DEGENERACY = (
    r"\delta x_0:\;(1,\,0) \qquad \delta\theta_2:\;(1+t_x^2,\;\; t_x t_y) \qquad "
    r"\sigma_{x_0} \approx \sigma \,/\, \sqrt{n\,\langle t^4 \rangle}"
)


def _cases(result: Result) -> tuple[Case, Case]:
    two, three = result.cases
    return two, three


def _bench(result: Result) -> Section:
    config, camera = result.config, result.instrument.camera
    text = (
        f"A collimated star of {config.star.temperature_k:g} K stands still in the laboratory. The camera "
        f"({camera.lens.name}, f = {result.instrument.focal_length_mm:.1f} mm, {camera.width_px} × {camera.height_px} "
        f"px of {result.instrument.pixel_arcsec:.2f}″) is carried by a table of two, then of three axes, "
        f"{_axes(result)}. At zero angles the table's frame and the laboratory's agree; every angle counts by the "
        "right-hand rule, the outermost rotation acts last. The lens's axis meets the detector at "
        f"({', '.join(cell_text(v, '+g') for v in config.principal_point_px)}) px from its centre, and the camera is "
        f"mounted with {', '.join(cell_text(v, 'g') + '°' for v in config.installation_deg)} of rotation: none of it "
        "is known to the reduction, which starts at zero, with a focal length wrong by 5 % and no distortion."
    )
    return Section(
        title="The bench",
        blocks=(
            Figure(
                drawing=bench_sketch(config.two_axis.axes),
                caption="The bench of FISHER23, drawn with two axes; a third, inner one turns the camera about its own "
                "axis. In colour: what the calibration has to find.",
            ),
            Text(text),
            Equation(latex=MODEL, note="FISHER23 eq. 1–6, ACF17 eq. 3–4"),
        ),
    )


def _axes(result: Result) -> str:
    words = []
    for case in result.cases:
        noise = " and ".join(f"{v:g}″" for v in case.config.reading_noise_arcsec)
        lean = " and ".join(f"{cell_text(v, 'g')}″" for v in case.config.non_orthogonality_arcsec)
        words.append(f"the {case.name} one read to {noise} per reading, its axes leaning by {lean}")
    return "; ".join(words)


def _measured(result: Result, every: Mapping[str, Table]) -> Section:
    config = result.config
    places = Figure(
        drawing=visited_places(result),
        caption="Places that the image visited, in order. On the three-axis table the camera is rolled between places.",
    )
    windows = Figure(
        drawing=star_windows(result),
        caption="One frame at nine places of the field, edges and middle (column, row); cross: mean of the traced "
        "rays.",
        raster=True,
    )
    text = Text(
        f"At every place {config.frames} frames of {config.star.signal_e:g} e⁻ are read out in windows of "
        f"{config.window_px} px around the star, {config.dark_frames} dark ones subtracted, and the centroids (ePSF) "
        f"averaged; with each frame the table is read, and the readings are averaged too.\n\nThe covariance of a mean "
        "centroid is predicted pixel by pixel from the linear response of the centroider: photons, read noise, "
        "rounding, dark frames, and the response pattern of the pixels, which frames do not average away."
    )
    return Section(title="What is measured", blocks=(places, Row((windows, text)), every["vectors"]))


def _found(result: Result, every: Mapping[str, Table]) -> Section:
    two, _ = _cases(result)
    maps = Figure(
        drawing=error_maps(result, result.cases),
        caption="Line of sight of the rendered run against the traced lens, the best rotation removed: length of the "
        "error (white arrows: its direction) and the standard deviation that the estimator's covariance predicts.",
        raster=True,
    )
    arrows = Figure(
        drawing=residual_arrows(result),
        caption="Residuals on the two-axis table before any reading error is fitted. What leaning axes do to the "
        f"images ({two.config.non_orthogonality_arcsec[0]:g}″) hides below the noise of the readings, and in wrong "
        "parameters.",
    )
    words = Text(
        "Truth has two meanings here. Star, installation and axes are what they were set to. The camera is a traced "
        "lens, not a Brown–Conrady model: its *parameters* are those of the model fitted to the rays without noise, "
        "its *map* is the rays themselves. "
        + _model_text(result)
        + " The distortion coefficients are strongly correlated among themselves: their pulls are honest, their values "
        "mean little one by one."
    )
    return Section(
        title="What comes out", blocks=(words, every["unknowns_two_axis"], every["unknowns_three_axis"], maps, arrows)
    )


def _model_text(result: Result) -> str:
    two, _ = _cases(result)
    alone = two.split["model"].line_of_sight
    predicted = two.reductions["estimated"].line_of_sight.predicted_rms_arcsec
    share = alone.rms_arcsec / predicted
    if share < 0.1:
        return (
            f"For this lens the two differ by {cell_text(alone.rms_arcsec, '.1g')}″, {cell_text(share, '.0e')} of the "
            "noise of the calibration: the model is not what limits it."
        )
    return (
        f"For this lens the two differ by {alone.rms_arcsec:.3f}″ RMS, {share:.0%} of the predicted error: the camera "
        "model is part of what limits this calibration."
    )


def _degenerate(result: Result, every: Mapping[str, Table]) -> Section:
    two, three = _cases(result)
    lines = []
    for case in (two, three):
        sigma = principal_point_arcsec(result, case)
        line = case.reductions["estimated"].line_of_sight
        reduction = case.reductions["estimated"]
        lines.append(
            f"On the {case.name} table x₀ is known to {reduction.sigma('x0_px'):.1f} px and y₀ to "
            f"{reduction.sigma('y0_px'):.1f} px "
            f"({sigma[0]:.0f}″ and {sigma[1]:.0f}″ on the axis), while the line of sight over the whole detector is "
            f"known to {line.predicted_rms_arcsec:.3f}″ RMS (length), per axis "
            f"{point_over_line(sigma.max(), line.predicted_rms_arcsec):.0f} times better"
        )
    matrix = Row(
        tuple(
            Figure(
                drawing=correlation_matrix(case),
                caption=f"Correlations of the unknowns, {case.name} table; numbers from 0.3, without sign.",
            )
            for case in result.cases
        )
    )
    curves = Figure(
        drawing=field_curves(result),
        caption="Cramér–Rao bounds of ideal cameras of 2048 × 2048 px over their field of view, all drawn as angles "
        f"per axis, for images good to {result.field_sigma_px:.2g} px.",
    )
    return Section(
        title="Principal point and installation: known together, not apart",
        blocks=(
            Text(
                "Moving the principal point and turning the camera on its mount do almost the same to every image; "
                "what "
                "tells them apart is second order in the field angle. " + ". ".join(lines) + "."
            ),
            Equation(latex=DEGENERACY, note="t: tangents of the field angles"),
            Text(_star_text(result)),
            matrix,
            Text(_field_text(result)),
            curves,
            every["field_sweep"],
        ),
    )


def _star_text(result: Result) -> str:
    two, three = _cases(result)
    name = "star_elevation_rad"
    sigmas = [case.reductions["estimated"].sigma(name) * RAD_ARCSEC for case in (two, three)]
    known = two.knowledge["the star's direction"].map_sigma_arcsec
    return (
        "The star's direction joins in. On two axes, turning it in the laboratory and turning the camera back on its "
        "mount leaves every image where it was, but for terms of second order, and those look like tangential "
        f"distortion: the elevation of the star comes out to {sigmas[0]:.1f}″ only. Unlike the principal point this "
        "*does* reach the map: it takes a quadratic pattern in or out of the camera. Rolling the camera about a third "
        f"axis turns the installation and leaves the star ({sigmas[1]:.2f}″ on the three-axis table); so does knowing "
        "the star from elsewhere, which would bring the bound of the two-axis map from "
        f"{two.bound.map_sigma_arcsec:.3f}″ "
        f"to {known:.3f}″."
    )


def _field_text(result: Result) -> str:
    narrow, wide = result.field_sweep[0], result.field_sweep[-1]
    ratio = [point_over_line(p.full.of("x0_px") * p.arcsec_per_px, p.full.map_sigma_arcsec) for p in (narrow, wide)]
    return (
        f"At {narrow.field_deg:g}° of field the principal point alone is {ratio[0]:.0f} times worse known than the "
        f"line of sight (per axis), at {wide.field_deg:g}° {ratio[1]:.0f} times. In pixels its error "
        "falls with the square of the field, the error of the line of sight not at all: it is always a fraction of "
        "that of one image. A calibration should therefore be judged by its map after the best rotation, and nobody "
        "should be surprised that the principal points of two good calibrations differ by tens of pixels."
    )


def _limits(result: Result, every: Mapping[str, Table]) -> Section:
    half = crossover_arcsec(result)
    two, three = _cases(result)
    text = (
        "**Readings.** Centroids and readings contribute alike when the mean reading of a place is good to "
        f"{half:.3f}″ per axis; every table coarser than that limits the calibration, not the camera. On these tables "
        f"{_dominant(two)} on two axes and {_dominant(three)} on three.\n\n**Covariance.** "
        f"{_pull_text(result)}\n\n**Non-orthogonality.** {_lean_text(result)}"
    )
    curves = Row(
        (
            Figure(
                drawing=reading_curves(result),
                caption=f"Map error against the error of the mean reading, two-axis table, "
                f"{result.config.study.sweep_runs} runs each.",
            ),
            Figure(
                drawing=lean_curves(result),
                caption=f"Map error against the lean of the axes, two-axis table, "
                f"{result.config.study.sweep_runs} runs each, 3 σ.",
            ),
        )
    )
    return Section(
        title="What limits it",
        blocks=(
            Text(text),
            curves,
            every["noise_shares"],
            every["knowledge"],
            every["map_error"],
            every["lenses"],
            every["reading_sweep"],
            every["lean_sweep"],
        ),
    )


def _lean_text(result: Result) -> str:
    """What leaning axes cost, ignored and estimated."""
    points, (two, three) = result.lean_sweep, _cases(result)
    first, last = points[0], points[-1]
    loud = [p.lean_arcsec for p in points if p.ignored_reduced_chi2 > 1.3]
    betray = (
        f"the residuals betray it only from {min(loud):g}″ on (χ²/dof above 1.3)"
        if loud
        else f"the residuals do not betray it (χ²/dof {last.ignored_reduced_chi2:.2f})"
    )
    unneeded, square = two.bound.map_sigma_arcsec, two.knowledge["the axes' angles"].map_sigma_arcsec
    rolled = three.split["leans"].line_of_sight.rms_arcsec
    return (
        f"A two-axis table that is taken as square although its axes lean by {last.lean_arcsec:g}″ spoils the map to "
        f"{last.ignored_arcsec:.2f}″, and {betray}. Estimated, the lean costs nothing that grows with it "
        f"({last.estimated_arcsec:.3f}″ against {first.estimated_arcsec:.3f}″ for square axes); the unknown itself "
        f"costs {unneeded / square - 1:.0%} of map error (bound {unneeded:.3f}″ against {square:.3f}″). On two axes a "
        "lean looks like a skew of the detector, which the camera model does not have; that is how it can be "
        "estimated. A third axis that rolls the camera keeps it out of the map altogether: ignored there, it leaves "
        f"{rolled:.3f}″."
    )


def _pull_text(result: Result) -> str:
    """Where the covariance stops being honest."""
    worst = max(result.reading_sweep, key=lambda p: p.reading_arcsec)
    honest = [p.reading_arcsec for p in result.reading_sweep if p.pull_rms < 1.1]
    if not honest or worst.pull_rms < 1.1:
        return "It is honest at every reading noise of the sweep."
    return (
        f"It is honest (RMS pull below 1.1) up to {max(honest):g}″ of reading noise on the two-axis table. Beyond, the "
        "principal point and the star wander so far that second derivatives count, which neither covariance nor bound "
        f"know of: at {worst.reading_arcsec:g}″ {worst.runs} of {result.config.study.sweep_runs} calibrations "
        f"converge, with an RMS pull of {worst.pull_rms:.2f} and a map error "
        f"{worst.measured_arcsec / worst.bound_arcsec:.2f} times what the bound says."
    )


def _dominant(case: Case) -> str:
    name = max(case.shares, key=lambda key: case.shares[key])
    share = case.shares[name] ** 2 / sum(v**2 for v in case.shares.values())
    return f"{name.replace('readings, ', 'the readings of the ')} make {share:.0%} of the variance"


def _honest(result: Result) -> Section:
    bars = Figure(
        drawing=pull_bars(result),
        caption="RMS of (estimate − truth) / σ over the Monte-Carlo, unknown by unknown; bars: what chance allows "
        "for so many runs; band: 10 %.",
    )
    parts = [
        f"On the {case.name} table the map error is {case.monte_carlo.map_arcsec:.4f}″ where the Cramér–Rao bound is "
        f"{case.bound.map_sigma_arcsec:.4f}″, and {case.monte_carlo.lost} of "
        f"{case.monte_carlo.runs + case.monte_carlo.lost} runs did not converge."
        for case in result.cases
    ]
    text = Text(
        "The rendered run is one draw. On coordinates, with the model that was fitted to the rays as the camera and "
        "the same places and noise, the calibration is repeated from the poor start every time. "
        + " ".join(parts)
        + " The bound is computed apart from the estimator, from the readings' noise carried to the images."
    )
    return Section(title="Is the covariance honest?", blocks=(text, bars))


def _vectors_text(result: Result) -> Section:
    text = (
        "With the calibration every image becomes a direction in the table's frame at zero angles; all of them "
        "should be the star. Their scatter (table of the centroids above) is the accuracy that FISHER23 goes on to "
        "estimate; here it is mostly the reading noise of the table, not the camera."
    )
    limits = (
        "The collimator has no colour and no divergence, and its star does not move when the table turns (a camera "
        "off the rotation axes only sees parallax of a point at infinity: none). Axes wobble by nothing but their "
        "constant lean; sinusoidal encoder errors can be switched on (encoder_amplitude_arcsec) and do not average "
        "out. Rays only, no diffraction. Readings are white: an encoder with errors that are the same at every visit "
        "would not gain from reading it with every frame."
    )
    return Section(
        title="Star vectors, and what is left out",
        blocks=(Equation(latex=VECTORS, note="FISHER23 eq. 7"), Text(text), Text(limits)),
    )


def _key_numbers(result: Result) -> tuple[KeyNumber, ...]:
    two, three = _cases(result)
    lines = [case.reductions["estimated"].line_of_sight for case in (two, three)]
    x0 = two.reductions["estimated"]
    return (
        *(
            KeyNumber(
                label=f"Map error, {case.name} table",
                value=line.rms_arcsec,
                unit="″",
                format=".3f",
                note=f"predicted {line.predicted_rms_arcsec:.3f}″",
            )
            for case, line in zip((two, three), lines, strict=True)
        ),
        KeyNumber(
            label="Principal point x₀ alone",
            value=Measured(value=x0.value("x0_px"), uncertainty=x0.sigma("x0_px"), unit="px"),
            note=f"truth {result.config.principal_point_px[0]:g} px, two-axis table",
        ),
        KeyNumber(
            label="Readings as good as centroids",
            value=crossover_arcsec(result),
            unit="″",
            format=".3f",
            note="error of the mean reading of a place",
        ),
    )


def build_report(result: Result) -> Report:
    """The report of a run."""
    two, three = _cases(result)
    every = all_tables(result)
    lines = [case.reductions["estimated"].line_of_sight for case in (two, three)]
    return Report(
        title="Joint calibration on a turntable",
        lead=f"A single star, rendered through {result.instrument.camera.lens.name} onto "
        f"{result.instrument.detector.name}, visits {len(two.measurement.visits)} places of the detector on a "
        "two-axis and on a three-axis table. One least-squares fit finds the camera, the direction of the star, the "
        "installation and the angle between the axes (FISHER23, *laboratory evaluation of star-vector accuracy*, "
        "2023, S100–S300).",
        verdict=f"The line of sight comes out to {lines[0].rms_arcsec:.3f}″ on two axes and "
        f"{lines[1].rms_arcsec:.3f}″ on "
        f"three (predicted {lines[0].predicted_rms_arcsec:.3f}″ and {lines[1].predicted_rms_arcsec:.3f}″), though the "
        f"principal point is uncertain by {two.reductions['estimated'].sigma('x0_px'):.0f} and "
        f"{two.reductions['estimated'].sigma('y0_px'):.0f} px.",
        key_numbers=_key_numbers(result),
        sections=(
            _bench(result),
            _measured(result, every),
            _found(result, every),
            _degenerate(result, every),
            _limits(result, every),
            _honest(result),
            _vectors_text(result),
        ),
    )
