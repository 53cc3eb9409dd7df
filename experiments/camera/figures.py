"""Figures of the camera report."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure

from experiments.camera.confirmation import bright_stars
from experiments.camera.result import Result
from experiments.harness.plotting import INK, MARKERS, PALETTE, band_colours, log_ticks, new_figure
from experiments.harness.quantities import Outcome
from optics.figures import draw_image, draw_lens
from optics.rays.spots import trace_spots

__all__ = [
    "accuracy",
    "chart_detections",
    "chart_noise",
    "completeness",
    "distortion_and_vignetting",
    "electrons",
    "focus",
    "frame",
    "lateral_colour",
    "lens",
    "sky_distributions",
    "spots",
    "thermal",
    "what_to_change",
]

SMALLEST_PERCENT, SMALLEST_PX = 1e-3, 1e-3
"""Axes of distortion and colour show no less: below is what rounding makes of a lens that has none."""
STAR_COLOURS = ("#c8501e", "#b58a00", "#2f6fb5", "#7a4fa3", "#2a8c4a", "#555555")


def lens(outcome: Outcome) -> Figure:
    """Section through the lens with fans of rays to the middle, the edge and the corner of the detector."""
    state = outcome.result.prediction.state
    fields = state.performance.field_deg
    figure = draw_lens(state.instrument.camera.focused_lens, fields_deg=[0.0, float(fields[2]), float(fields[-1])])
    figure.axes[0].set_title("")
    width, height = figure.get_size_inches()
    figure.set_size_inches(7.6, 7.6 * height / width)
    return figure


def spots(outcome: Outcome) -> Figure:
    """Rays of the pass band at three fields, the pixels of the detector behind them."""
    state = outcome.result.prediction.state
    focused, pitch = state.instrument.camera.focused_lens, state.instrument.camera.pixel_pitch_mm
    chosen = [0, 2, 4]
    angles, waves = state.performance.field_deg[chosen], state.performance.wavelength_nm[[0, 2, 5]]
    traced = trace_spots(focused, angles, np.zeros(3), waves, order=(8, 30))
    figure, axes = new_figure(1, 3, aspect_ratio=0.38, sharex=True, sharey=True)
    middle = state.performance.white_mm[chosen]
    reach = 0.0
    for column, panel in enumerate(axes):
        for band, (wave, colour) in enumerate(zip(waves, band_colours(waves.tolist()), strict=True)):
            lit = traced.area_mm2[column, band] > 0
            x = (traced.rays.x[column, band][lit] - middle[column]) / pitch
            y = traced.rays.y[column, band][lit] / pitch
            reach = max(reach, float(np.abs(np.concatenate([x, y])).max(initial=0.0)))
            panel.plot(x, y, ".", color=colour, markersize=1.6, label=f"{wave:.0f} nm")
        rms = outcome.values("field_spot_um")[chosen[column]]
        panel.set_title(f"{angles[column]:.2f}°, RMS {rms:.1f} µm", fontsize=8.5)
        panel.set(xlabel="x [px]", aspect="equal")
    side = np.ceil(1.1 * reach - 0.5) + 0.5
    for panel in axes:
        panel.set(xlim=(-side, side), ylim=(-side, side))
        step = max(1, int(np.ceil(side / 3.0)))
        panel.set_xticks(step * np.arange(-(side // step), side // step + 1))
        panel.set_yticks(step * np.arange(-(side // step), side // step + 1))
        if side <= 12:
            for line in np.arange(-side, side + 1):
                panel.axhline(line, color="0.88", linewidth=0.5, zorder=0)
                panel.axvline(line, color="0.88", linewidth=0.5, zorder=0)
        panel.grid(False)
    axes[0].set_ylabel("y [px]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, markerscale=5)
    return figure


def focus(outcome: Outcome) -> Figure:
    """White spot against a shift of the detector, over the field; and the best focus of every wavelength."""
    performance = outcome.result.prediction.state.performance
    depth, best = outcome.value("depth_of_focus_um"), outcome.value("best_focus_um")
    shift = np.linspace(min(-1.5 * depth, best - depth), max(1.5 * depth, best + depth), 121)
    rms = 1e3 * performance.white.rms_mm(shift[:, None] * 1e-3)
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.38, width_ratios=(1.35, 1.0))
    for k, colour in zip(range(len(performance.field_deg)), PALETTE, strict=False):
        left.plot(shift, rms[:, k], color=colour, label=f"{performance.field_deg[k]:.1f}°")
    left.axvspan(best - depth, best + depth, color="0.93", zorder=0)
    left.axvline(0.0, color=INK, linewidth=0.9)
    left.annotate("detector", (0.0, 0.98), xycoords=("data", "axes fraction"), xytext=(3, 0),
                  textcoords="offset points", va="top", fontsize=7.5)  # fmt: skip
    left.set(xlabel="shift of the detector [µm]", ylabel="RMS spot radius [µm]", ylim=(0, None))
    left.legend(title="field", title_fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=5)
    wave, axial = performance.wavelength_nm, outcome.values("axial_colour_focus_um")
    right.plot(axial, wave, color=PALETTE[0], marker="o", markersize=3.5)
    right.axvline(0.0, color=INK, linewidth=0.9)
    right.set(xlabel="best focus on axis [µm]", ylabel="wavelength [nm]")
    return figure


def distortion_and_vignetting(outcome: Outcome) -> Figure:
    """Distortion and light over the field."""
    figure, (left, right) = new_figure(1, 2, width="full", aspect_ratio=0.33)
    angle = outcome.values("field")
    left.plot(outcome.values("field_distortion_percent"), angle, color=PALETTE[0], marker="o")
    left.axvline(0.0, color="0.6", linewidth=0.8)
    left.set(xlabel="distortion [%]", ylabel="field angle [°]", ylim=(0, None))
    left.locator_params(axis="x", nbins=5)
    _span(left, "x", SMALLEST_PERCENT)
    right.plot(angle, 100.0 - outcome.values("field_vignetting_percent"), color=PALETTE[2], marker="o")
    right.set(xlabel="field angle [°]", ylabel="light of a star [% of the axis]", ylim=(0, 105), xlim=(0, None))
    return figure


def _span(panel: Any, which: Literal["x", "y"], least: float) -> None:
    """Show at least ``least`` to both sides of nothing where all that is drawn is smaller."""
    low, high = panel.get_xlim() if which == "x" else panel.get_ylim()
    if max(-low, high) < least:
        panel.set(**{f"{which}lim": (-least, least)})


def lateral_colour(outcome: Outcome) -> Figure:
    """Where wavelengths lie against all light, and where stars of other colours do."""
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.36)
    angle, shift = outcome.values("field"), outcome.values("field_colour_px")
    state = outcome.result.prediction.state
    waves = outcome.values("wavelength")
    for k, (wave, colour) in enumerate(zip(waves, band_colours(waves.tolist()), strict=True)):
        left.plot(angle, shift[:, k], color=colour, label=f"{wave:.0f} nm")
    left.set(xlabel="field angle [°]", ylabel="radial shift of light [px]", xlim=(0, None))
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
    for t, colour in zip(outcome.config.star.colours_k, STAR_COLOURS, strict=False):
        values = state.colour_shift_px(np.full(len(state.radius_px), t), state.radius_px)
        right.plot(angle, values, color=colour, label=f"{t:g} K")
    right.set(xlabel="field angle [°]", ylabel="radial shift of stars [px]", xlim=(0, None))
    for panel in (left, right):
        _span(panel, "y", SMALLEST_PX)
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
    return figure


def electrons(outcome: Outcome) -> Figure:
    """Electrons against magnitude for star colours, with saturation and the detection limit."""
    figure, panel = new_figure(aspect_ratio=0.4)
    magnitude, values = outcome.values("magnitude"), outcome.values("star_electrons_e")
    for row, t, colour in zip(values, outcome.config.star.colours_k, STAR_COLOURS, strict=False):
        panel.plot(magnitude, row, color=colour, label=f"{t:g} K")
    for name, words, height, align in (
        ("saturation_mag", "saturates", 0.55, "center"),
        ("complete_magnitude_mag", "90 % found", 0.97, "top"),
        ("limiting_magnitude_mag", "50 % found", 0.97, "top"),
    ):
        at = outcome.value(name)
        panel.axvline(at, color="0.45", linewidth=0.8, dashes=(4, 3))
        panel.annotate(words, (at, height), xycoords=("data", "axes fraction"), xytext=(-3, 0), rotation=90,
                       textcoords="offset points", ha="right", va=align, fontsize=7.5)  # fmt: skip
    panel.set(yscale="log", xlabel="magnitude", ylabel="electrons in one exposure [e⁻]")
    panel.legend(loc="lower left")
    return figure


def completeness(outcome: Outcome) -> Figure:
    """Share of stars that are found against magnitude; and detection limits against false alarms."""
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.36)
    left.plot(outcome.values("magnitude"), 100.0 * outcome.values("magnitude_found"), color=PALETTE[0])
    limit = outcome.value("limiting_magnitude_mag")
    left.set(xlabel="magnitude", ylabel="stars found [%]", ylim=(0, 105), xlim=(limit - 2.5, limit + 1.0))
    left.axvline(limit, color="0.45", linewidth=0.8, dashes=(4, 3))
    processing = outcome.result.prediction.processing
    level = np.linspace(3.5, 8.0, 60)
    right.plot(level, processing.false_alarms_at(level), color=PALETTE[1])
    at = processing.threshold_sigma
    right.plot([at], [outcome.value("false_alarms_per_frame")], "o", color=INK)
    right.set(yscale="log", xlabel="detection limit [σ]", ylabel="false alarms per frame", ylim=(1e-4, None))
    return figure


def accuracy(outcome: Outcome) -> Figure:
    """NEA, its bound and the single-star accuracy against magnitude."""
    figure, panel = new_figure(aspect_ratio=0.4)
    magnitude = outcome.values("magnitude")
    for name, colour, words, style in (
        ("single", PALETTE[1], "single star, all terms", {}),
        ("nea", PALETTE[0], "NEA (noise alone)", {}),
        ("bound", INK, "Cramér-Rao bound of the NEA", {"linewidth": 0.9, "dashes": (3, 2)}),
    ):
        panel.plot(magnitude, outcome.values(f"magnitude_{name}_arcsec"), color=colour, label=words, **style)
    rendered = outcome.result.rendered
    if rendered is not None:
        one = {c.name: c for c in outcome.result.compared}["nea"]
        panel.errorbar([rendered.chart.bright_mag], [one.measured], [3.0 * one.error], fmt="o", color=INK,
                       label="NEA, rendered frames (3σ)")  # fmt: skip
    limit, full = outcome.value("limiting_magnitude_mag"), outcome.value("saturation_mag")
    panel.set(yscale="log", xlabel="magnitude", ylabel="one axis, 1σ [″]", xlim=(full, limit + 0.3))
    shown = (magnitude >= full) & (magnitude <= limit + 0.3)
    high = float(outcome.values("magnitude_single_arcsec")[shown].max())
    low = float(outcome.values("magnitude_bound_arcsec")[shown].min())
    panel.set_ylim(0.7 * low, 1.5 * high)
    log_ticks(panel, "y")
    panel.legend(loc="upper left")
    return figure


def sky_distributions(outcome: Outcome) -> Figure:
    """Stars per frame, attitude across and roll over the sky, worst 1 % marked."""
    figure, axes = new_figure(1, 3, aspect_ratio=0.34)
    for panel, name, words, worst, colour in (
        (axes[0], "sky_stars", "stars per frame", "stars_worst_per_frame", PALETTE[2]),
        (axes[1], "sky_cross_arcsec", "attitude across, 1σ [″]", "attitude_cross_worst_arcsec", PALETTE[0]),
        (axes[2], "sky_roll_arcsec", "roll, 1σ [″]", "attitude_roll_worst_arcsec", PALETTE[1]),
    ):
        values = outcome.values(name)
        known = values[np.isfinite(values)]
        at = outcome.value(worst)
        if known.size:
            top = float(np.quantile(known, 0.995)) * 1.1
            panel.hist(np.clip(known, None, top), bins=28, color=colour, alpha=0.7)
            panel.margins(y=0.3)  # room for the words above the bars
        if np.isfinite(at):
            panel.axvline(at, color=INK, linewidth=0.9, dashes=(4, 3))
            panel.annotate("worst 1 %", (at, 0.97), xycoords=("data", "axes fraction"), xytext=(3, 0),
                           textcoords="offset points", va="top", fontsize=7.5, rotation=90)  # fmt: skip
        panel.set(xlabel=words, yticks=[])
        panel.spines["left"].set_visible(False)
    axes[0].set_ylabel("attitudes")
    return figure


def thermal(outcome: Outcome) -> Figure:
    """Focus, scale, spot and accuracy over temperature."""
    figure, axes = new_figure(1, 4, aspect_ratio=0.27)
    at = outcome.values("temperature")
    depth = outcome.value("depth_of_focus_um")
    for panel, name, words, colour in zip(
        axes,
        ("thermal_focus_um", "thermal_scale_ppm", "thermal_spot_px", "thermal_nea_arcsec"),
        ("best focus [µm]", "plate scale [ppm]", "RMS spot radius [px]", "NEA [″]"),
        PALETTE,
        strict=False,
    ):
        panel.plot(at, outcome.values(name), color=colour, marker="o")
        panel.set(xlabel="temperature [°C]", title=words)
    axes[0].axhspan(-depth, depth, color="0.93", zorder=0)
    for panel, name in zip(axes[2:], ("thermal_spot_px", "thermal_nea_arcsec"), strict=True):
        known = outcome.values(name)[np.isfinite(outcome.values(name))]
        panel.set_ylim(0, 1.15 * float(known.max()) if len(known) else 1.0)
    return figure


def what_to_change(outcome: Outcome) -> Figure:
    """Tornado: change of the attitude error and of the limiting magnitude when keys move."""
    swings = outcome.result.swings
    figure, axes = new_figure(1, 2, aspect_ratio=0.1 + 0.045 * len(swings), sharey=True)
    for panel, name, words in (
        (axes[0], "attitude_cross_arcsec", "attitude across [%]"),
        (axes[1], "limiting_magnitude_mag", "limiting magnitude [mag]"),
    ):
        scale = 1.0 if name.endswith("_mag") else 100.0
        for row, swing in enumerate(swings):
            for end, colour in ((swing.at_low, PALETTE[5]), (swing.at_high, PALETTE[1])):
                if end and np.isfinite(end[name]):
                    panel.barh(row, scale * end[name], height=0.62, color=colour, alpha=0.85)
        panel.axvline(0.0, color=INK, linewidth=0.8)
        panel.set(xlabel=f"change of {words}")
        panel.grid(axis="y", visible=False)
    axes[0].set_yticks(range(len(swings)), [f"{s.label}: {s.low:.3g} | {s.high:.3g} {s.unit}".strip() for s in swings])
    axes[0].invert_yaxis()
    for colour, words in ((PALETTE[5], "lower value"), (PALETTE[1], "upper value")):
        axes[1].barh([0], [0], color=colour, label=words)
    axes[1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
    return figure


def chart_noise(outcome: Outcome) -> Figure:
    """Scatter of the readouts of each chart star against its distance from the middle, beside the prediction."""
    result: Result = outcome.result
    assert result.rendered is not None
    errors, electrons, radius = bright_stars(result.prediction, result.rendered)
    scale, stars = result.prediction.state.pixel_arcsec, result.prediction.stars
    sigma = scale * np.sqrt(errors.var(axis=0, ddof=1).mean(axis=1))
    figure, panel = new_figure(width="half", aspect_ratio=0.8)
    panel.plot(radius, sigma, ".", color=PALETTE[5], markersize=4, label="one star")
    order = np.argsort(radius)
    groups = [part for part in np.array_split(order, 6) if len(part) > 1]
    place = [float(radius[part].mean()) for part in groups]
    seen = [float(np.sqrt((sigma[part] ** 2).mean())) for part in groups]
    error = [s / np.sqrt(4.0 * len(part) * (len(errors) - 1)) for s, part in zip(seen, groups, strict=True)]
    panel.errorbar(place, seen, error, fmt="o", color=INK, label="mean of a ring")
    curve = np.linspace(0.0, float(stars.radius_px[-1]), 60)
    light = np.interp(curve, radius[order], electrons[order])
    panel.plot(
        curve, scale * stars.sigma_at(stars.centroid.noise_px, light, curve), color=PALETTE[1], label="predicted"
    )
    panel.set(xlabel="distance from the middle [px]", ylabel="scatter, one axis [″]", ylim=(0, None))
    panel.legend(loc="best")
    return figure


def chart_detections(outcome: Outcome) -> Figure:
    """Share of chart stars that are found against magnitude, beside the prediction."""
    result: Result = outcome.result
    assert result.rendered is not None
    chart, stars = result.rendered.chart, result.prediction.stars
    faint = chart.magnitude != chart.bright_mag
    magnitude, share = chart.magnitude[faint], chart.found[:, faint].mean(axis=0)
    expected = stars.found_at(chart.electrons[faint], chart.radius_px[faint])
    edges = np.quantile(magnitude, np.linspace(0, 1, 9))
    figure, panel = new_figure(width="half", aspect_ratio=0.8)
    group = np.clip(np.searchsorted(edges, magnitude, side="right") - 1, 0, 7)
    rows: list[tuple[float, ...]] = []
    for k in np.unique(group):
        mine = group == k
        error = share[mine].std(ddof=1) / np.sqrt(mine.sum()) if mine.sum() > 1 else 0.0
        rows.append((magnitude[mine].mean(), share[mine].mean(), max(error, 0.5 / mine.sum()), expected[mine].mean()))
    at, seen, error_bars, wanted = np.array(rows).T
    panel.errorbar(at, 100 * seen, 100 * error_bars, fmt="o", color=INK, label="rendered frames")
    panel.plot(at, 100 * wanted, color=PALETTE[1], marker=MARKERS[1], markersize=3.5, label="predicted, same stars")
    panel.set(xlabel="magnitude", ylabel="stars found [%]", ylim=(-3, 105))
    panel.legend(loc="lower left")
    return figure


def frame(outcome: Outcome) -> Any:
    """The first frame of the sky, with what was found in it."""
    result: Result = outcome.result
    assert result.rendered is not None
    image = result.rendered.example_e
    height, width = image.shape
    figure, panel = new_figure(aspect_ratio=min(1.05, 0.92 * height / width + 0.05))
    draw_image(image, panel)
    panel.plot(*result.rendered.example_px.T, "o", markersize=9, markerfacecolor="none", markeredgecolor="#f0b000",
               markeredgewidth=0.8)  # fmt: skip
    panel.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="column [px]", ylabel="row [px]")
    panel.grid(False)
    return figure
