"""Words of the report on attitude-correlated frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.acf.evaluate import comparison, fig3, fig4, gains, pulls, table2_runs
from experiments.acf.figures import count_curves, fig3_curves, fig4_scatter, fig5_curves, sky_path, star_tracks
from experiments.acf.figures_more import (
    coefficient_cloud,
    correlation_map,
    gain_curves,
    gain_map,
    inference_curves,
    pull_figure,
    sight_maps,
    table2_sizes,
)
from experiments.acf.judge import degrees_of, own_misses, worse_by
from experiments.acf.pixels import pixel_sections
from experiments.acf.published import RUNS, TABLE2_CALIBRATED, TABLE2_TRUE
from experiments.acf.tables import all_tables, fig3_at_a_glance
from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import Table, cell_text

if TYPE_CHECKING:
    from experiments.acf.result import Result

__all__ = ["build_report"]

EQ6 = r"C_i^{S_k} = \left( C_b^S \; C_{b_1}^{b_k} \; C_S^b \right) C_i^{S_1}"
EQ_RMS = (
    r"\left\langle \Delta x^2 + \Delta y^2 \right\rangle \; = \; \frac{\sigma^2}{n} \; \mathrm{tr} \left[ H_e \, "
    r"(H^T H)^{-1} H_e^T \right] \; \approx \; \frac{14 \, \sigma^2}{n}"
)


def _signed(value: float, spec: str = "+.3f") -> str:
    """A number with its sign, set as the tables set it."""
    return cell_text(float(value), spec)


def _night_text(result: Result) -> str:
    config, scene = result.config, result.scene
    turned = float(np.degrees((scene.body * scene.body[0].inv()).magnitude().max()))
    return (
        f"{config.frames} frames at {config.frame_rate_hz:g} Hz; the {config.camera.focal_length_mm:g} mm camera of "
        f"Table 1 with {config.camera.width_px} × {config.camera.height_px} pixels. Three things are not in the "
        f"document and chosen here. *The pixel*: {config.camera.pixel_um:g} µm ({scene.pixel_arcsec:.1f}″). *The "
        f"stars*: a uniform random sky, its limiting magnitude set so that {result.stars_per_frame:.0f} stars are in "
        f"a frame on average. *The axes of the motion*: the rate keeps its {config.gyro.angular_speed_deg_per_s:g} "
        f"°/s while its direction goes round in the body once, so that the body gets {turned:.1f}° away from its "
        "start. It has to: while a body turns about one fixed axis, the installation's turn about that axis does not "
        "show in any star, and only 13 of the 14 unknowns can be found. The gyro gives angle increments at "
        f"{config.gyro.rate_hz:g} Hz; its bias has the stated size about each axis, with a sign drawn for each run."
        f"\n\n{_start_text(result)}"
    )


def _start_text(result: Result) -> str:
    start, table2 = result.config.start, result.outcome[result.plan.table2.name]
    steps = float(table2.of("acc", "iterations").mean())
    away = float(np.degrees(result.scene.attitude[0].magnitude()))
    phi = (
        "φ from the stars as that camera sees them"
        if start.phi_from_stars
        else f"φ = 0, {away:.0f}° from the attitude's truth"
    )
    return (
        f"ACC starts where Table 2 does ({start.x0_px:g} px, {start.focal_length_mm:g} mm, no distortion, θ = 0, "
        f"{phi}) and goes in two steps, first without distortion; it needs {steps:.0f} iterations on average. The "
        "other methods start from the same camera, with the attitudes it gives."
    )


def _fig3_text(result: Result) -> str:
    rows, config = fig3(result), result.config
    biases = len(config.bias_deg_per_h)
    low, high = rows[0], rows[-1]
    bias, walk = config.bias_deg_per_h[-1], config.angle_random_walk_deg_per_sqrt_h[-1]
    return (
        "The document reads from its curves that star noise decides and gyro error hardly matters. For the bias that "
        f"is so: at {config.noise_px[0]:g} px the largest ({bias:g} °/h) raises the error from {low[0].value:.4f} to "
        f"{low[biases].value:.4f} px, at {config.noise_px[-1]:g} px it does not show ({high[0].value:.4f} and "
        f"{high[biases].value:.4f} px). A constant drift looks much like a wrong installation, and the adjustment "
        "takes it up there. A random walk finds no such place: the "
        f"largest ({walk:g} °/√h) raises {low[0].value:.4f} to {low[-1].value:.4f} px at the small end and "
        f"{high[0].value:.4f} to {high[-1].value:.4f} px at the large one. The lines are no fits: they are computed "
        "from the design alone, stars and gyro error carried through eq. 11 to the even frames, where the gyro's error "
        "counts a second time."
    )


def _fig4_text(result: Result) -> str:
    found, there = fig4(result), fig4(result, inferred=True)
    assumed, inferred = result.forecast.matching
    return (
        f"Published are 0.0132 and 0.0123 px; here {found.rms_px[0]:.4f} and {found.rms_px[1]:.4f} px, over "
        f"{found.runs.n} runs. A single run scatters by {100 * found.runs.scatter / found.runs.expected:.0f} % (only "
        "14 numbers are drawn, however many stars are reprojected), and the published RMS of "
        f"{found.published_px:.4f} px is {found.published_deviation:+.1f} such standard deviations from our mean. "
        f"As the mean of {RUNS} runs that the text calls it, it is {found.published_deviation * RUNS**0.5:+.0f} "
        f"errors of such a mean away{_away_text(found.published_deviation * RUNS**0.5)}; the criteria ask only whether "
        "it could be one run. What the document leaves out, and what this hangs on, is the number of stars. "
        "For a perfect gyro and even frames like the odd ones the expectation "
        "does not know the pixel, the field or the motion, only the number n of stars that calibrate. That form "
        f"gives the published value with {assumed.closed_form:.0f} stars in a frame; with the gyro of Table 1, which "
        f"alone gives {assumed.gyro_px:.4f} px at this pixel, it takes {assumed.with_gyro:.0f}, and anything from "
        f"{assumed.low:.0f} to {assumed.high:.0f} stars has it within one standard deviation of a run. With the "
        f"pixel and the stars that the next section infers ({inferred.pixel_um:g} µm, {result.plan.inferred.stars}) "
        f"the runs give {there.rms_px[0]:.4f} and {there.rms_px[1]:.4f} px."
    )


def _away_text(sigma: float) -> str:
    return ": with the stars assumed here the mean is not reproduced" if abs(sigma) > 3.0 else ""


def _inference_text(result: Result) -> str:
    guess, camera = result.inference, result.config.camera
    at_least = guess.reprojected_px[np.argmin((guess.reprojected_px**2).sum(1))]
    at_ten = guess.reprojected_px[np.argmin(np.abs(guess.pixel_um - 10.0))]
    field = _field_deg(guess.best_um, 1024, 25.6)
    text = (
        "Table 2 prints a calibrated camera and attitude beside the true ones, and that tells what the document leaves "
        "out. A shift of the principal point and a turn of the camera all but cancel in the image; the printed errors "
        "of x0, y0 (in pixels) and of φ (in arcseconds) are such a pair, and they cancel for one size of the pixel "
        f"only. Reprojected on the first frame, printed against true, they leave {at_ten[0]:.2f} and {at_ten[1]:.2f} "
        f"px with a 10 µm pixel, and {at_least[0]:.3f} and {at_least[1]:.3f} px with {guess.least_um:.2f} µm: the "
        "size of Fig. 4. Their likelihood under the covariance of eq. 11 (the eleven errors of camera and first "
        f"attitude, rounding of the printed digits included) gives **{guess.best_um:.2f} ± {guess.sigma_um:.2f} µm** "
        f"and {guess.best_stars:.0f} stars in a frame ({guess.low_stars:.0f} to {guess.high_stars:.0f}), with χ² = "
        f"{guess.chi2:.1f} for 11 numbers and two that were fitted; at 10 µm χ² is {guess.chi2_assumed:.0f}. The "
        f"printed values thus fit a field of {field:.1f}°.\n\n"
        "They also have the size of *one* run. As the mean of a hundred runs, which the text calls them, they are ten "
        "times too large: it would take a hundredth of the stars."
    )
    if abs(camera.pixel_um - guess.best_um) < 3 * guess.sigma_um:
        return text
    return (
        f"{text} The runs here keep a pixel of {camera.pixel_um:g} µm and a field of "
        f"{_field_deg(camera.pixel_um, camera.width_px, camera.focal_length_mm):.1f}°; with the settings "
        f"camera.pixel_um={result.plan.inferred.pixel_um:g} and sky.stars_per_frame={result.plan.inferred.stars} all "
        "of it runs with the other camera."
    )


def _field_deg(pixel_um: float, width_px: int, focal_length_mm: float) -> float:
    return float(2 * np.degrees(np.arctan(0.5e-3 * width_px * pixel_um / focal_length_mm)))


def _table2_text(result: Result) -> str:
    spread = table2_runs(result).std(0, ddof=1)
    ratio = np.abs((TABLE2_CALIBRATED - TABLE2_TRUE) / spread)
    covariance = result.forecast.table2.perfect
    size = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(size, size)
    return (
        f"The mean of our {len(table2_runs(result))} runs is at the truth within its error. The printed errors are "
        f"between {ratio.min():.2f} and {np.sort(ratio)[-2]:.1f} standard deviations of one run, except q3 with "
        f"{ratio[5]:.0f}; the inferred smaller pixel explains that too, because the same error of q3 moves the image "
        "by less. q2 and q3 are not recovered by the document, and cannot be: their correlation is "
        f"{_signed(correlation[4, 5])} (q1 and q2 {_signed(correlation[3, 4])}), and r⁴ and r⁶ over one detector are "
        "nearly the same shape. What the camera needs is their sum. The same holds for x0 with p1, φ2 and θ2, and "
        "for y0 with p2, φ1 and θ1: blocks of the correlation map in which only one combination is known well. So the "
        "coefficients are the wrong thing to judge; the map of the line of sight after the best rotation is the "
        "right one."
    )


def _pull_text(result: Result) -> str:
    found = pulls(result)
    own, carried, linked = (found.rms(which) for which in ("own", "carried", "linked"))
    worst = int(np.argmax(own))
    name = ("x0", "y0", "f", "q1", "q2", "q3", "p1", "p2", "φ1", "φ2", "φ3", "θ1", "θ2", "θ3")[worst]
    return (
        "ACC takes the gyro as perfect, and its own covariance lacks the gyro's error. For the camera that is almost "
        f"true (RMS pulls {own[:8].min():.2f} to {own[:8].max():.2f}), for the roll angles it is not ({name}: "
        f"{own[worst]:.2f}): the star noise averages out over thousands of stars, the drift does not. With the "
        f"gyro's error carried through eq. 11 all 14 pulls lie between {carried.min():.3f} and {carried.max():.3f}. "
        "An adjustment that knows the noise of its gyro (bias and one small rotation per frame as unknowns with a "
        f"prior) needs no such help: {linked.min():.3f} to {linked.max():.3f} by its own covariance."
    )


def _own_text(result: Result) -> str:
    """Whether ACC's own covariance is honest within 10 %, in one sentence."""
    found = pulls(result)
    missed, carried, linked = own_misses(found), found.rms("carried"), found.rms("linked")
    if not missed:
        return "The errors agree with ACC's own covariance within 10 %, or what chance allows."
    said = [f"{name.replace('phi', 'φ').replace('theta', 'θ')} {value:.2f}" for name, value in missed.items()]
    return (
        f"ACC's own covariance misses the 10 % (RMS pulls: {', '.join(said)}; the other {14 - len(said)} of 14 "
        "unknowns within), because it takes the gyro as perfect; with the gyro's error added they are "
        f"{carried.min():.2f} to {carried.max():.2f}, with a gyro of stated noise {linked.min():.2f} to "
        f"{linked.max():.2f}."
    )


def _methods_text(result: Result) -> str:
    found = comparison(result)
    iac, free = worse_by(found, "iac", "acc"), worse_by(found, "free", "acc")
    full = worse_by(found, "iac_full", "free")
    points = [found["iac"].camera[:, k] > found["acc"].camera[:, k] for k in range(3)]
    points += [
        found["iac"].distortion_px > found["acc"].distortion_px,
        found["iac"].sight_arcsec > found["acc"].sight_arcsec,
    ]
    held, every = int(np.sum(points)), int(np.size(points))
    return (
        "ACC is better than unweighted interstar angles, as published: by "
        f"{iac['x0']:.2f} and {iac['y0']:.2f} in the principal point, {iac['f']:.2f} in the focal length, "
        f"{iac['distortion']:.2f} in the largest residual distortion, {iac['line_of_sight']:.2f} in the line of sight "
        f"(ratios, all noises together; at {held} of the {every} single points). It is not better because it has a "
        "gyro. Interstar angles with their full covariance, the 2n − 3 measurements of a frame kept and counted once, "
        f"are free attitudes to {100 * max(abs(v - 1) for v in full.values()):.1f} %, and those are within "
        f"{100 * max(abs(v - 1) for v in free.values()):.0f} % of ACC at {result.stars_per_frame:.0f} stars a frame. "
        "What the unweighted method loses it loses by its weights: the cosine of a large angle feels an error more "
        "than that of a small one, and the pairs of a star share its error."
    )


def _gain_text(result: Result) -> str:
    found, sweep = gains(result), result.config.sweep
    stars, factors = sweep.stars, sweep.gyro_factor
    first, point, last = found.acc_bound[:, 0], found.point_bound[:, 0], len(stars) - 1
    null = [n for n, gain in zip(stars, first, strict=True) if gain < 1.05]
    where = f"from {null[0]} stars on the gain is below 5 %" if null else "it stays above 5 % in this range"
    gyro = "a perfect gyro" if factors[0] == 0 else f"{factors[0]:g} times the noise of Table 1"
    text = (
        "A frame with an attitude of its own spends three of its 2n measurements on it. With many stars that is cheap, "
        f"with few it is not. With {gyro} the line of sight of ACC is expected {first[0]:.2g} times better with "
        f"{stars[0]} stars, {first[1]:.2f} times with {stars[1]} and {first[last]:.2f} times with {stars[last]}; "
        f"{where}. In the principal point alone it is {point[0]:.2g}, {point[1]:.2f} and {point[last]:.2f}. "
    )
    if stars[0] == 2:
        text += (
            "Two stars are a case of their own: the two brightest of a sky stay in the field for many frames, and the "
            "few different distances between them do not hold a camera of eight unknowns. "
        )
    worst = len(factors) - 1
    harm = float(found.acc_bound[last, worst])
    if harm < 0.95:
        text += (
            f"\n\nTrusting a gyro has a price. With {factors[worst]:g} times the noise of Table 1 ACC is "
            f"{1 / harm:.2g} times *worse* than free attitudes at {stars[last]} stars, and its covariance does not "
            "say so (its residuals do). Weighted as it deserves, a gyro never harms: its gain goes to 1, not below."
        )
    return text


def _limits_text(result: Result) -> str:
    del result
    return (
        "Coordinates: star positions have Gaussian noise of one size, no bias that follows the pixels, no smear "
        "of the motion, no wrong matches, no colour; rendered frames are at the end and in the experiment *skycal*. "
        "The gyro has no scale error, no misalignment of its axes and no drift of its bias. The published "
        "curves are pictures without numbers; only Table 2 and the numbers of Fig. 4 can be compared."
    )


def _figure(drawing: object, caption: str, *, raster: bool = False) -> Figure:
    return Figure(drawing=drawing, caption=caption, raster=raster)  # type: ignore[arg-type]


def _night(result: Result) -> Section:
    tracks = _figure(
        star_tracks(result),
        "All stars of all frames on one detector (the document's Fig. 2), coloured by time; the cross is the "
        "principal point.",
        raster=True,
    )
    path = _figure(sky_path(result), "The boresight on the sky as seen from the first frame, and the body's rates.")
    return Section(
        title="The night",
        blocks=(Row((tracks, path)), Equation(latex=EQ6, note="ACF17 eq. 6"), Text(_night_text(result))),
    )


def _reprojection(result: Result, every: Mapping[str, Table]) -> tuple[Section, ...]:
    runs = result.config.runs
    return (
        Section(
            title="Fig. 3: star noise and gyro noise",
            blocks=(
                _figure(
                    fig3_curves(result),
                    f"RMS reprojection error of noise-free even frames, mean of {runs} runs with its standard error; "
                    "lines: expected from the design.",
                ),
                Text(_fig3_text(result)),
                fig3_at_a_glance(result),
            ),
        ),
        Section(
            title="Fig. 4: 0.0132 and 0.0123 px, and how many stars make them",
            blocks=(
                _figure(
                    fig4_scatter(result),
                    "Reprojection errors at 0.1 px of star noise with Table 1's gyro. Ellipses: RMS in x and y. One "
                    "run is not round: it has one set of wrong parameters.",
                    raster=True,
                ),
                every["fig4"],
                Equation(latex=EQ_RMS, note="n stars calibrate; H, He: eq. 11"),
                Text(_fig4_text(result)),
                _figure(
                    count_curves(result),
                    "RMS reprojection error against the number of stars. Bands: scatter of one run. Points: runs "
                    "(squares: perfect gyro; diamond: inferred pixel and stars).",
                ),
            ),
        ),
        Section(
            title="Which pixel the document had",
            blocks=(
                _figure(
                    inference_curves(result),
                    "(a) The printed camera and attitude of Table 2 against the true ones, on the first frame, for "
                    "other pixels. (b) Likelihood of the printed errors under the covariance of eq. 11.",
                ),
                Text(_inference_text(result)),
            ),
        ),
    )


def _parameters(result: Result, every: Mapping[str, Table]) -> tuple[Section, ...]:
    return (
        Section(
            title="Table 2",
            blocks=(
                every["table2"],
                _figure(
                    table2_sizes(result),
                    "Errors of the 14 unknowns in units of the expected standard deviation of one run.",
                ),
                Text(_table2_text(result)),
                Row(
                    (
                        _figure(
                            correlation_map(result),
                            "Correlations of the unknowns; numbers: percent, where above 85.",
                        ),
                        _figure(coefficient_cloud(result), "q2 against q3: only one combination of them is known."),
                    )
                ),
                _figure(
                    sight_maps(result),
                    "RMS over the detector at the noise of Table 2: residual distortion (the five coefficients alone), "
                    "and the line of sight after the best rotation, found and expected.",
                ),
            ),
        ),
        Section(
            title="Are the errors as large as the adjustment says?",
            blocks=(
                Text(_pull_text(result)),
                _figure(
                    pull_figure(result),
                    "Error over predicted standard deviation, all noises of Fig. 5 together; band: within 10 % of 1. "
                    "Dashed: the normal distribution.",
                ),
                every["pulls"],
            ),
        ),
    )


def _comparisons(result: Result, every: Mapping[str, Table]) -> tuple[Section, ...]:
    return (
        Section(
            title="Fig. 5: attitudes against angles",
            blocks=(
                _figure(
                    fig5_curves(result),
                    f"RMS errors over {result.config.runs} runs, all {result.config.frames} frames; (d) mean of the "
                    "largest residual distortion, (e) RMS over the detector after the best rotation.",
                ),
                every["methods"],
                Text(_methods_text(result)),
            ),
        ),
        Section(
            title="Where the gyro gains, and where it does not",
            blocks=(
                Text(_gain_text(result)),
                _figure(
                    gain_curves(result),
                    "Gain over free attitudes in the line of sight: median errors of "
                    f"{result.config.sweep.skies} skies and their standard errors; lines: expected.",
                ),
                _figure(gain_map(result), "The same expectations as a map: blue, the gyro gains; red, it harms."),
                every["gain_weighted"],
            ),
        ),
        Section(title="What is left out", blocks=(Text(_limits_text(result)),)),
    )


def _key_numbers(result: Result) -> tuple[KeyNumber, ...]:
    found, guess, sweep = fig4(result), result.inference, gains(result)
    carried = pulls(result).rms("carried")
    return (
        KeyNumber(
            label="Reprojection RMS, x and y [px]",
            value=f"{found.rms_px[0]:.4f}, {found.rms_px[1]:.4f}",
            note="published 0.0132, 0.0123",
        ),
        KeyNumber(
            label="Pixel that Table 2 implies",
            value=Measured(value=guess.best_um, uncertainty=guess.sigma_um),
            unit="µm",
            note=f"with {guess.best_stars:.0f} stars a frame",
        ),
        KeyNumber(
            label="RMS pulls of 14 unknowns",
            value=f"{carried.min():.2f} to {carried.max():.2f}",
            note="gyro error carried through",
        ),
        KeyNumber(
            label=f"Gain of a perfect gyro, {result.config.sweep.stars[-1]} stars",
            value=float(sweep.acc_bound[-1, 0]),
            format=".2f",
            note=f"{sweep.acc_bound[1, 0]:.2f} with {result.config.sweep.stars[1]} stars",
        ),
    )


def build_report(result: Result) -> Report:
    """The report of a run."""
    every = all_tables(result)
    found, config = comparison(result), result.config
    iac, free = worse_by(found, "iac", "acc"), worse_by(found, "free", "acc")
    bound = degrees_of(np.sqrt(np.diag(result.forecast.table2.acc)))
    sight = float(np.sqrt((result.outcome[result.plan.table2.name].of("acc", "sight_arcsec") ** 2).mean()))
    return Report(
        title="Calibration with attitude-correlated frames",
        lead=f"{config.frames} frames of a turning star sensor are correlated by a gyro and calibrated, {config.runs} "
        "times for each setting, as in ACF17 (*A star sensor calibration method based on attitude correlated frame*, "
        "2017); its Fig. 3 to 5 and Table 2 beside the truth, the Cramér–Rao bound and other methods.",
        verdict=f"At {config.table_noise_px:g} px of star noise {(config.frames + 1) // 2} frames give the principal "
        f"point to {bound[0]:.2f} px and the line of sight to {sight:.1f}″. In the line of sight equally weighted "
        f"interstar angles are {iac['line_of_sight']:.2f} times worse, free attitudes {free['line_of_sight']:.2f} "
        f"times. {_own_text(result)}",
        key_numbers=_key_numbers(result),
        sections=(
            _night(result),
            *_reprojection(result, every),
            *_parameters(result, every),
            *_comparisons(result, every),
            *pixel_sections(result),
        ),
    )
