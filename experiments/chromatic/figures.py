"""Figures of the chromatic test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.harness.plotting import INK, MARKERS, PALETTE, band_colours, log_ticks, new_figure, scale_bar
from experiments.harness.quantities import Outcome
from experiments.laboratory import sketches
from optics.arrays import FloatArray

__all__ = [
    "arrow_map",
    "arrow_panels",
    "bench_sketch",
    "calibration_dots",
    "element_bars",
    "fig7",
    "place_sketch",
    "spot_gallery",
    "star_shifts",
    "target_image",
]


def bench_sketch(outcome: Outcome) -> Figure:
    """What ACC18 Fig. 1 shows, drawn anew, with a filter in front of the target."""
    return sketches.collimator_bench(filters=True)


def place_sketch(outcome: Outcome) -> Figure:
    """What ACC18 Fig. 3 shows, drawn anew and to scale: the target in its four places."""
    return sketches.field_places(outcome.config.target, outcome.result.instrument)


def spot_gallery(outcome: Outcome, lens: str) -> Figure:
    """One target point behind each filter: noiseless, one frame, mean of all frames."""
    measured, centres = getattr(outcome.result, lens).measurement, outcome.config.filters.centres_nm
    figure, axes = new_figure(3, len(centres), aspect_ratio=1.0, width="half", sharex=True, sharey=True)
    size = outcome.config.window_px
    for band, (centre, colour) in enumerate(zip(centres, band_colours(centres), strict=True)):
        stack = measured.windows[band]
        column, row = (int(v) for v in stack.corner_px[0])
        light = measured.example.electrons[row : row + size, column : column + size, band]
        frames = (stack.dn[:, 0].astype(float) - stack.offset_dn) / stack.gain_dn_per_e
        for axis, image in zip(axes[:, band], (light, frames[0], frames.mean(0)), strict=True):
            axis.imshow(
                image,
                extent=(column - 0.5, column + size - 0.5, row + size - 0.5, row - 0.5),
                vmin=-30,
                vmax=light.max(),
            )
            axis.plot(*measured.photon_px[0, 0, band], "+", color="white", markersize=7, markeredgewidth=0.9)
            axis.grid(visible=False)
            axis.set(xticks=[], yticks=[])
        scale_bar(axes[2, band])
        axes[0, band].set_title(f"{centre:g} nm", color=colour)
    for axis, label in zip(axes[:, 0], ("noiseless", "one frame", f"mean of {len(stack.dn)}"), strict=True):
        axis.set_ylabel(label)
    return figure


def target_image(outcome: Outcome) -> Figure:
    """The whole target at the first position, all filters in their own colour, points enlarged to be seen."""
    from scipy.ndimage import gaussian_filter

    measured, centres = outcome.result.centred.measurement, outcome.config.filters.centres_nm
    nominal = measured.nominal_px[0]
    low = np.maximum(np.floor(nominal.min(0)).astype(int) - 60, 0)
    high = np.ceil(nominal.max(0)).astype(int) + 61
    crop = measured.example.electrons[low[1] : high[1], low[0] : high[0]]
    colour = np.zeros((*crop.shape[:2], 3))
    for band, name in enumerate(band_colours(centres)):
        rgb = np.array([int(name[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        glow = gaussian_filter(crop[..., band], 4.0)
        colour += (glow / glow.max())[..., None] * rgb
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    extent = (low[0] - 0.5, low[0] + crop.shape[1] - 0.5, low[1] + crop.shape[0] - 0.5, low[1] - 0.5)
    axis.imshow(np.clip(1.6 * colour, 0, 1) ** 0.6, extent=extent)
    axis.grid(visible=False)
    axis.set(xlabel="column [px]", ylabel="row [px]")
    return figure


def _arrows(axis: Any, place: FloatArray, shift: FloatArray, scale: float, **style: Any) -> None:
    axis.quiver(
        *place.reshape(-1, 2).T, *shift.reshape(-1, 2).T, angles="xy", scale_units="xy", scale=1 / scale, **style
    )


def arrow_map(outcome: Outcome, lens: str) -> Figure:
    """Shift of every point over the field, one panel per pair of bands."""
    return arrow_panels(outcome, [(lens, name, f"{name} nm, {lens}") for name in outcome.names("pair")])


def arrow_panels(outcome: Outcome, panels: Sequence[tuple[str, str, str]]) -> Figure:
    """Shift of every point over the field, the ray-trace prediction beneath; each panel has its own scale."""
    figure, axes = new_figure(1, len(panels), aspect_ratio=0.33, sharey=True, squeeze=False)
    place = outcome.values("nominal_px")
    for axis, (lens, pair, title), colour in zip(axes[0], panels, PALETTE, strict=False):
        shift = outcome.values("measured_shift_px", lens=lens, pair=pair)
        predicted = outcome.values("predicted_shift_px", lens=lens, pair=pair)
        longest = float(np.linalg.norm(shift, axis=-1).max())
        scale = 1.2 * outcome.config.target.pitch_px / longest
        _arrows(axis, place, predicted, scale, color="#c3c8ce", width=0.009, headwidth=3)
        _arrows(axis, place, shift, scale, color=colour, width=0.0035, headwidth=4)
        _field_frame(outcome, axis, float(f"{longest:.0e}"), scale)
        axis.set_title(title)
    axes[0, 0].set_ylabel("row [px]")
    return figure


def _field_frame(outcome: Outcome, axis: Any, key_px: float, scale: float) -> None:
    """Outline of the detector, its seams, and an arrow of known length between the target's places."""
    camera, chips = outcome.result.instrument.camera, outcome.result.instrument.detector.chips
    width, height = camera.width_px, camera.height_px
    place = 0.62 * width if chips == 2 else 0.5 * width - 0.5, (height - 1) / 2  # not on the seam of two chips
    axis.quiver(*place, key_px, 0, angles="xy", scale_units="xy", scale=1 / scale, color=INK, width=0.0045)
    axis.text(place[0], place[1] - 110, f"{key_px:g} px", fontsize=8)
    left, right, upper, lower = -0.5, width - 0.5, -0.5, height - 0.5
    axis.plot([left, right, right, left, left], [upper, upper, lower, lower, upper], color="#8a9099", linewidth=0.8)
    for seam in range(1, chips):
        column = seam * (width / chips) - 0.5
        axis.plot([column, column], [upper, lower], color="#c9cdd3", linewidth=0.7)
    axis.grid(visible=False)
    axis.set(xlim=(-280, width + 280), ylim=(height + 200, -200), aspect="equal", xlabel="column [px]")
    axis.set(xticks=range(0, width + 1, 1024), yticks=range(0, height + 1, 512))


def fig7(outcome: Outcome, lens: str) -> Figure:
    """ACC18 Fig. 7 redrawn: the shift of every point, position after position, with what the ray trace predicts."""
    pairs = outcome.names("pair")
    figure, axes = new_figure(len(pairs), 2, aspect_ratio=0.5, sharex=True)
    count = outcome.data.sizes["point"]
    for row, pair in zip(np.atleast_2d(axes), pairs, strict=True):
        for n, (axis, letter) in enumerate(zip(row, "xy", strict=True)):
            at = {"lens": lens, "pair": pair, "axis": letter}
            found, sigma, light = (
                outcome.values(f"{name}_shift_px", **at).ravel() for name in ("measured", "sigma", "predicted")
            )
            index = np.arange(len(found))
            axis.plot(index, light, color="#9aa1a9", linewidth=1.0, drawstyle="steps-mid", label="ray trace")
            axis.errorbar(
                index,
                found,
                3 * sigma,
                fmt=".",
                markersize=2.5,
                elinewidth=0.5,
                color=PALETTE[n],
                label="measured, 3σ",
            )
            mean = 2 * float(outcome.values("table1_px", **at))
            axis.axhline(mean, color=INK, linewidth=0.7, linestyle="--", label="mean")
            for edge in range(count, len(found), count):
                axis.axvline(edge - 0.5, color="#d6dade", linewidth=0.7)
            axis.set_title(f"{pair} nm, {letter.upper()}")
    for axis in np.atleast_2d(axes)[-1]:
        axis.set_xlabel(f"target point (four positions of {count})")
    for axis in np.atleast_2d(axes)[:, 0]:
        axis.set_ylabel("shift [px]")
    corner = np.atleast_2d(axes)[0, 1]
    corner.margins(y=0.25)
    corner.legend(loc="upper right", ncols=3, fontsize=7)
    return figure


def calibration_dots(outcome: Outcome) -> Figure:
    """RMS shift as found and with band-dependent camera parameters, centred and moved."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.36, sharey=True)
    pairs, steps = outcome.names("pair"), outcome.names("step")
    width = 0.72 / len(pairs)
    for axis, lens, title in zip(axes, ("centred", "moved"), ("centred lens", "element moved"), strict=True):
        for k, (pair, colour) in enumerate(zip(pairs, PALETTE, strict=False)):
            place = np.arange(len(steps)) + width * (k - (len(pairs) - 1) / 2)
            found, light = (
                outcome.values(name, lens=lens, pair=pair) for name in ("residual_px", "photon_residual_px")
            )
            axis.plot(place, found, MARKERS[0], color=colour, label=f"{pair} nm")
            axis.plot(place, light, "_", color=colour, markersize=13, label="noiseless light" if k == 0 else None)
        axis.set_xticks(np.arange(len(steps)), [s.replace(" ", "\n") for s in steps])
        axis.set_title(title)
        axis.grid(visible=False, axis="x")
    axes[0].set(ylabel=outcome.heading("residual_px"), ylim=(0, None))
    axes[0].legend()
    return figure


def element_bars(outcome: Outcome) -> Figure:
    """How far each element has to move for the published mean shift."""
    result = outcome.result
    figure, axes = new_figure(1, 2, aspect_ratio=0.32)
    for axis, kind in zip(axes, ("decentre", "tilt"), strict=True):
        solutions = [s for s in result.solutions if s.kind == kind]
        amounts = [abs(s.amount) if np.isfinite(s.amount) else 0.0 for s in solutions]
        colours = [PALETTE[1] if s is result.chosen else PALETTE[0] for s in solutions]
        axis.barh([s.element for s in solutions], amounts, color=colours, height=0.6)
        for y, s in enumerate(solutions):
            text = f" {s.amount:.0f}" if np.isfinite(s.amount) else " not within reach"
            axis.text(amounts[y], y, text, va="center", fontsize=7.5)
        axis.invert_yaxis()
        axis.grid(visible=False, axis="y")
        axis.margins(x=0.18)
        axis.set(xlabel=f"{kind} [{solutions[0].shown_unit}]")
    return figure


def star_shifts(outcome: Outcome) -> Figure:
    """Chromatic shift of stars over temperature, beside one third of the filter shift."""
    temperature = outcome.values("temperature_k")
    figure, axis = new_figure(aspect_ratio=0.42)
    for k, (values, label) in enumerate(
        (
            (outcome.values("star_rms_px", lens="centred"), "centred, RMS over the field"),
            (outcome.values("star_max_px"), "centred, largest in the field"),
            (outcome.values("star_rms_px", lens="moved"), "element moved, RMS over the field"),
            (np.linalg.norm(outcome.values("moved_star_mean_px"), axis=1), "element moved, mean over the field"),
        )
    ):
        axis.plot(temperature, values, marker=MARKERS[k], color=PALETTE[k], label=label)
    handles, _ = axis.get_legend_handles_labels()
    rules = zip(outcome.names("rule"), outcome.values("third_px"), ("--", ":"), strict=True)
    for name, value, style in rules:
        axis.axhline(value, color=INK, linewidth=0.9, linestyle=style)
        handles.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=style, label=name))
    axis.set(xscale="log", xlabel="effective temperature [K]", ylabel="shift against the reference star [px]")
    axis.set_ylim(0, None)
    log_ticks(axis, "x", (3000, 4000, 5000, 6000, 8000, 10000, 15000, 20000, 30000))
    axis.legend(handles=handles, loc="upper center", ncols=2, bbox_to_anchor=(0.5, -0.2))
    return figure
