"""Figures of the chromatic test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.harness.plotting import INK, MARKERS, PALETTE, band_colours, new_figure
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from experiments.chromatic.result import Result
    from experiments.laboratory.chromatic_error import ChromaticMeasurement, ChromaticReduction

__all__ = [
    "arrow_map",
    "arrow_panels",
    "calibration_dots",
    "element_bars",
    "fig7",
    "spot_gallery",
    "star_shifts",
    "target_image",
]


def spot_gallery(result: Result, evaluation: ChromaticReduction) -> Figure:
    """One target point behind each filter: noiseless, one frame, mean of all frames."""
    measured: ChromaticMeasurement = evaluation.measurement
    centres = result.config.filters.centres_nm
    figure, axes = new_figure(3, len(centres), aspect_ratio=1.0, width="half", sharex=True, sharey=True)
    size = result.config.window_px
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
        axes[0, band].set_title(f"{centre:g} nm", color=colour)
    for axis, label in zip(axes[:, 0], ("noiseless", "one frame", f"mean of {len(stack.dn)}"), strict=True):
        axis.set_ylabel(label)
    return figure


def target_image(result: Result) -> Figure:
    """The whole target at the first position, all filters in their own colour, points enlarged to be seen."""
    from scipy.ndimage import gaussian_filter

    measured = result.centred.measurement
    centres = result.config.filters.centres_nm
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


def arrow_map(result: Result, evaluation: ChromaticReduction, title: str) -> Figure:
    """Shift of every point over the field, one panel per pair of bands."""
    return arrow_panels(result, [(evaluation, name, f"{name} nm, {title}") for name, _, _ in result.pairs])


def arrow_panels(result: Result, panels: Sequence[tuple[ChromaticReduction, str, str]]) -> Figure:
    """Shift of every point over the field, the ray-trace prediction beneath; each panel has its own scale.

    Parameters
    ----------
    result : Result
        The run.
    panels : sequence of (ChromaticReduction, str, str)
        What is shown: lens, pair of bands, title.
    """
    figure, axes = new_figure(1, len(panels), aspect_ratio=0.33, sharey=True, squeeze=False)
    for axis, (evaluation, name, title), colour in zip(axes[0], panels, PALETTE, strict=False):
        place, shift = evaluation.measurement.nominal_px, evaluation.shift_px[name]
        longest = float(np.linalg.norm(shift, axis=-1).max())
        scale = 1.2 * result.config.target.pitch_px / longest
        _arrows(axis, place, evaluation.predicted_shift_px[name], scale, color="#c3c8ce", width=0.009, headwidth=3)
        _arrows(axis, place, shift, scale, color=colour, width=0.0035, headwidth=4)
        _field_frame(result, axis, float(f"{longest:.0e}"), scale)
        axis.set_title(title)
    axes[0, 0].set_ylabel("row [px]")
    return figure


def _field_frame(result: Result, axis: Any, key_px: float, scale: float) -> None:
    """Outline of the detector, its seam, and an arrow of known length in the middle."""
    width, height = result.instrument.camera.width_px, result.instrument.camera.height_px
    middle = (width - 1) / 2, (height - 1) / 2
    axis.quiver(*middle, key_px, 0, angles="xy", scale_units="xy", scale=1 / scale, color=INK, width=0.0045)
    axis.text(middle[0], middle[1] - 110, f"{key_px:g} px", fontsize=8)
    left, right, upper, lower = -0.5, width - 0.5, -0.5, height - 0.5
    axis.plot([left, right, right, left, left], [upper, upper, lower, lower, upper], color="#8a9099", linewidth=0.8)
    for seam in range(1, result.instrument.detector.chips):
        column = seam * (width / result.instrument.detector.chips) - 0.5
        axis.plot([column, column], [upper, lower], color="#c9cdd3", linewidth=0.7)
    axis.grid(visible=False)
    axis.set(xlim=(-280, width + 280), ylim=(height + 200, -200), aspect="equal", xlabel="column [px]")
    axis.set(xticks=range(0, width + 1, 1024), yticks=range(0, height + 1, 512))


def fig7(result: Result, evaluation: ChromaticReduction) -> Figure:
    """ACC18 Fig. 7 redrawn: the shift of every point, position after position, with what the ray trace predicts."""
    names = [name for name, _, _ in result.pairs]
    figure, axes = new_figure(len(names), 2, aspect_ratio=0.5, sharex=True)
    count = evaluation.shift_px[names[0]].shape[1]
    for row, name in zip(np.atleast_2d(axes), names, strict=True):
        for axis, direction in zip(row, range(2), strict=True):
            found, sigma, light = (
                v[name][..., direction].ravel()
                for v in (evaluation.shift_px, evaluation.shift_sigma_px, evaluation.predicted_shift_px)
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
                color=PALETTE[direction],
                label="measured, 3σ",
            )
            axis.axhline(
                2 * evaluation.table1_px[name][direction], color=INK, linewidth=0.7, linestyle="--", label="mean"
            )
            for edge in range(count, len(found), count):
                axis.axvline(edge - 0.5, color="#d6dade", linewidth=0.7)
            axis.set_title(f"{name} nm, {'XY'[direction]}")
    for axis in np.atleast_2d(axes)[-1]:
        axis.set_xlabel(f"target point (four positions of {count})")
    for axis in np.atleast_2d(axes)[:, 0]:
        axis.set_ylabel("shift [px]")
    corner = np.atleast_2d(axes)[0, 1]
    corner.margins(y=0.25)
    corner.legend(loc="upper right", ncols=3, fontsize=7)
    return figure


def calibration_dots(result: Result) -> Figure:
    """RMS shift as found and with band-dependent camera parameters, centred and moved."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.36, sharey=True)
    for axis, evaluation, title in zip(
        axes, (result.centred, result.moved), ("centred lens", "element moved"), strict=True
    ):
        width = 0.72 / len(evaluation.residual_px)
        for k, ((name, steps), colour) in enumerate(zip(evaluation.residual_px.items(), PALETTE, strict=False)):
            place = np.arange(len(steps)) + width * (k - (len(evaluation.residual_px) - 1) / 2)
            axis.plot(place, list(steps.values()), MARKERS[0], color=colour, label=f"{name} nm")
            light = list(evaluation.photon_residual_px[name].values())
            axis.plot(place, light, "_", color=colour, markersize=13, label="noiseless light" if k == 0 else None)
        axis.set_xticks(np.arange(len(steps)), [s.replace(" ", "\n") for s in steps])
        axis.set_title(title)
        axis.grid(visible=False, axis="x")
    axes[0].set(ylabel="RMS shift [px]", ylim=(0, None))
    axes[0].legend()
    return figure


def element_bars(result: Result) -> Figure:
    """How far each element has to move for the published mean shift."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.32)
    for axis, kind, unit in zip(axes, ("decentre", "tilt"), ("um", "arcmin"), strict=True):
        chosen = [s for s in result.solutions if s.kind == kind]
        amounts = [abs(s.amount) if np.isfinite(s.amount) else 0.0 for s in chosen]
        colours = [PALETTE[1] if s is result.chosen else PALETTE[0] for s in chosen]
        axis.barh([s.element for s in chosen], amounts, color=colours, height=0.6)
        for y, s in enumerate(chosen):
            text = f" {s.amount:.0f}" if np.isfinite(s.amount) else " not within reach"
            axis.text(amounts[y], y, text, va="center", fontsize=7.5)
        axis.invert_yaxis()
        axis.grid(visible=False, axis="y")
        axis.margins(x=0.18)
        axis.set(xlabel=f"{kind} [{'µm' if unit == 'um' else unit}]")
    return figure


def star_shifts(result: Result, rule_px: Mapping[str, float]) -> Figure:
    """Chromatic shift of stars over temperature, beside one third of the filter shift."""
    stellar, moved = result.stellar, result.moved_stellar
    figure, axis = new_figure(aspect_ratio=0.42)
    for k, (values, label) in enumerate(
        (
            (stellar.rms_px, "centred, RMS over the field"),
            (stellar.max_px, "centred, largest in the field"),
            (moved.rms_px, "element moved, RMS over the field"),
            (np.linalg.norm(moved.mean_px, axis=1), "element moved, mean over the field"),
        )
    ):
        axis.plot(stellar.temperature_k, values, marker=MARKERS[k], color=PALETTE[k], label=label)
    handles, _ = axis.get_legend_handles_labels()
    for (name, value), style in zip(rule_px.items(), ("--", ":", "-."), strict=False):
        axis.axhline(value, color=INK, linewidth=0.9, linestyle=style)
        handles.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=style, label=name))
    axis.set(
        xscale="log", xlabel="effective temperature [K]", ylabel="shift against the reference star [px]", ylim=(0, None)
    )
    ticks: Sequence[int] = (3000, 4000, 5000, 6000, 8000, 10000, 15000, 20000, 30000)
    axis.set_xticks(ticks, [f"{t}" for t in ticks])
    axis.minorticks_off()
    axis.legend(handles=handles, loc="upper center", ncols=2, bbox_to_anchor=(0.5, -0.2))
    return figure
