"""Figures of the calibration under the sky."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure, scale_bar
from experiments.harness.quantities import Outcome
from experiments.harness.tables import significant
from experiments.laboratory.direction_maps import VectorPanel, pixel_axes, vector_maps
from experiments.skycal.settings import parse_model_name
from optics.arrays import FloatArray
from optics.figures import draw_image

__all__ = [
    "centroid_errors",
    "close_ups",
    "decomposition",
    "error_and_uncertainty",
    "method_bars",
    "model_curves",
    "part_maps",
    "sky_frame",
    "star_cover",
]


PART_COLOURS = {"mismatch": PALETTE[2], "chromatic": PALETTE[4], "noise": PALETTE[0], "psf": PALETTE[3]}
STAR_COLOURS = (
    (3000.0, "#ff9d5c"),
    (4300.0, "#ffc48f"),
    (5300.0, "#ffe9cf"),
    (7000.0, "#f4f3ff"),
    (12000.0, "#a9c4ff"),
)
"""Colours of black bodies on a screen, a little more saturated than they are."""
MAP_LABEL = "line of sight [arcsec]"
RMS_LABEL = "map error, RMS [arcsec]"


def _star_colour(temperature_k: FloatArray) -> FloatArray:
    """RGB (n, 3) of stars."""
    knots = np.log([t for t, _ in STAR_COLOURS])
    rgb = np.array([[int(name[i : i + 2], 16) / 255 for i in (1, 3, 5)] for _, name in STAR_COLOURS])
    at = np.log(temperature_k)
    return np.stack([np.interp(at, knots, channel) for channel in rgb.T], axis=1)


def _size_px(outcome: Outcome, name: str) -> tuple[int, int]:
    camera = outcome.result.cameras[name].scene.instrument.camera
    return camera.width_px, camera.height_px


def _panels(outcome: Outcome, aspect_ratio: float, **subplots: Any) -> tuple[Figure, Any, Iterator[tuple[Any, str]]]:
    """A figure with a panel for every camera, its axes, and axes with names of cameras."""
    cameras = outcome.result.cameras
    figure, axes = new_figure(1, len(cameras), aspect_ratio=aspect_ratio, squeeze=False, **subplots)
    for axis, lens in zip(axes[0], outcome.names("camera"), strict=True):
        axis.set_title(f"{lens} lens")
    return figure, axes[0], zip(axes[0], cameras, strict=True)


def sky_frame(outcome: Outcome, name: str, half: bool = False) -> Figure:
    """One frame with the stars that were matched; columns less their medians, stars enlarged."""
    from scipy.ndimage import gaussian_filter

    camera = outcome.result.cameras[name]
    example = camera.recording.example
    height, width = example.dn.shape
    figure, axis = new_figure(width="half" if half else "full", aspect_ratio=0.1 + 0.9 * height / width)
    light = gaussian_filter(example.dn.astype(np.float32) - np.median(example.dn, axis=0).astype(np.float32), 0.8)
    kind = {"widest_px": 600, "grow": 3} if half else {"widest_px": 1200, "grow": 5}
    draw_image(light, axis, percentiles=(99.0 if half else 98.0, 99.98), **kind)
    frame = camera.recording.frames[camera.recording.example_index]
    mine = (camera.matched.frame == camera.recording.example_index) & camera.evaluation.used
    place, star = camera.matched.pixel_px[mine], camera.matched.star[mine]
    colour = _star_colour(camera.scene.sky.temperature_k[star])
    axis.scatter(*place.T, s=28 if half else 52, facecolors="none", edgecolors=colour, linewidths=0.9)
    rest = np.ones(len(frame.found), bool)
    rest[camera.matched.row[mine] - frame.first_row] = False
    x, y = frame.found.x_px[rest], frame.found.y_px[rest]
    saturated = has_flag(frame.found.flags[rest], StarFlag.SATURATED)
    axis.scatter(x[~saturated], y[~saturated], s=14 if half else 26, marker="x", color="#ff5d8f", linewidths=0.7)
    axis.scatter(x[saturated], y[saturated], s=60, marker="s", facecolors="none", edgecolors="#ff5d8f", linewidths=0.9)
    pixel_axes(axis, (width, height))
    return figure


def close_ups(outcome: Outcome, name: str, half: bool = False) -> Figure:
    """Stars of that frame as the centroider sees them, brightest first; the cross is where the light fell."""
    camera = outcome.result.cameras[name]
    matched, stamps, sky = camera.matched, camera.recording.stamps, camera.scene.sky
    mine = np.flatnonzero((matched.frame == camera.recording.example_index) & camera.evaluation.used)
    mine = mine[np.argsort(-matched.snr[mine])]
    chosen = mine[np.unique(np.linspace(0, len(mine) - 1, min(12, len(mine))).round().astype(int))]
    shape, ratio = ((3, 4), 0.88) if half else ((2, 6), 0.38)
    figure, axes = new_figure(*shape, width="half" if half else "full", aspect_ratio=ratio, squeeze=False)
    for axis in axes.ravel():
        axis.set_axis_off()
    for axis, row in zip(axes.ravel(), chosen, strict=False):
        window, star = matched.row[row], matched.star[row]
        light = stamps.electrons[window] - stamps.background_e[window]
        column, line = stamps.corner_px[window]
        size = len(light)
        axis.set_axis_on()
        extent = (column - 0.5, column + size - 0.5, line + size - 0.5, line - 0.5)
        axis.imshow(np.arcsinh(light / 40.0), extent=extent, vmin=-0.8, cmap="cividis")
        axis.plot(*matched.photon_px[row], "+", color="white", markersize=8, markeredgewidth=1.0)
        axis.grid(visible=False)
        axis.set(xticks=[], yticks=[])
        scale_bar(axis)
        axis.set_title(f"G {sky.magnitude[star]:.1f}, {sky.temperature_k[star] / 1000:.1f} kK", fontsize=6.5, pad=3)
    return figure


def error_and_uncertainty(outcome: Outcome, name: str) -> Figure:
    """Error map of the measured calibration beside its predicted uncertainty; below, with star colours known."""
    panels = []
    for data, label in (("", "measured"), ("corrected_", "colours known")):
        for quantity, what, arrows in (("error", "error", True), ("sigma", "predicted σ", False)):
            vector = outcome.values(f"{name}_{data}{quantity}_arcsec")
            size = np.sqrt(np.nanmean((vector**2).sum(axis=-1)))
            panels.append(VectorPanel(title=f"{label}: {what}, RMS {size:.3g}″", vector=vector, arrows=arrows))
    place = outcome.values(f"{name}_map_px")
    return vector_maps(panels, place, size_px=_size_px(outcome, name), label=MAP_LABEL)


def part_maps(outcome: Outcome, name: str) -> Figure:
    """The parts of the error, each with its own scale of arrows, all with one scale of colour."""
    sizes = outcome.values("part_rms_arcsec", camera=name)
    panels = [
        VectorPanel(
            title=f"{label}: RMS {significant(float(size), 2)}″",
            vector=outcome.values(f"{name}_{part}_arcsec"),
            arrows=size > 1e-3 * sizes.max(),
        )
        for (part, label), size in zip(outcome.labels("part").items(), sizes, strict=True)
    ]
    place = outcome.values(f"{name}_map_px")
    return vector_maps(panels, place, size_px=_size_px(outcome, name), label=MAP_LABEL)


def decomposition(outcome: Outcome) -> Figure:
    """Parts, their root sum square, the total, and what was predicted."""
    figure, axes, panels = _panels(outcome, 0.38)
    place = np.array([0, 1, 2, 3, 4.4, 5.4, 6.4, 7.8, 8.8])
    whole = (
        ("total, measured", "measured_rms_arcsec", INK),
        ("its predicted σ", "measured_predicted_arcsec", "#9aa1a9"),
        ("total, colours known", "corrected_rms_arcsec", PALETTE[1]),
        ("its predicted σ", "corrected_predicted_arcsec", "#f0b48a"),
    )
    labels = [*outcome.names("part"), "root sum square", *(label for label, *_ in whole)]
    colours = [*PART_COLOURS.values(), "#c3c8ce", *(colour for *_, colour in whole)]
    for axis, name in panels:
        sizes = [float(outcome.values(one, method="free", camera=name)) for _, one, _ in whole]
        parts, quadrature = (outcome.values(one, camera=name) for one in ("part_rms_arcsec", "quadrature_arcsec"))
        values = np.array([*parts, float(quadrature), *sizes])
        axis.barh(place, values, color=colours, height=0.72)
        for y, value in zip(place, values, strict=True):
            axis.text(value, y, f" {significant(value, 2)}″", va="center", fontsize=7.5)
        axis.set_yticks(place, labels if axis is axes[0] else [])
        axis.invert_yaxis()
        axis.margins(x=0.2)
        axis.grid(visible=False, axis="y")
        axis.set_xlabel(RMS_LABEL)
    return figure


def _short(model: str) -> str:
    family, degree = parse_model_name(model)
    return {"pinhole": "pinhole", "brown_conrady": "Brown–\nConrady"}.get(family, f"poly-\nnomial {degree}")


def model_curves(outcome: Outcome) -> Figure:
    """Map error against camera model: what the model cannot say, what noise does to it, what comes out."""
    figure, axes, panels = _panels(outcome, 0.4)
    curves = (
        ("cannot be described", "mismatch_arcsec", PALETTE[2], "-"),
        ("noise, predicted", "predicted_arcsec", "#9aa1a9", ":"),
        ("colours known", "corrected_arcsec", PALETTE[1], "-"),
        ("measured", "measured_arcsec", INK, "-"),
    )
    for axis, name in panels:
        models = outcome.data[f"{name}_model"].values.tolist()
        place = np.arange(len(models))
        for (label, quantity, colour, style), marker in zip(curves, MARKERS, strict=False):
            values = outcome.values(f"{name}_model_{quantity}")
            axis.plot(place, values, marker=marker, color=colour, linestyle=style, label=label, linewidth=1.1)
        axis.set_xticks(place, [_short(model) for model in models], fontsize=7)
        axis.set_yscale("log")
        axis.grid(visible=False, axis="x")
    axes[0].set_ylabel(RMS_LABEL)
    axes[-1].legend(fontsize=7.5)
    return figure


def centroid_errors(outcome: Outcome) -> Figure:
    """Errors of single positions against signal-to-noise ratio: noise, PSF of one colour, colour shift."""
    figure, axes, panels = _panels(outcome, 0.42, sharey=True)
    for axis, name in panels:
        snr = outcome.values(f"{name}_star_snr")
        measured, own, light, reference = (
            outcome.values(f"{name}_star_{kind}_px") for kind in ("measured", "own", "light", "reference")
        )
        edges = np.geomspace(snr.min() * 0.999, snr.max() * 1.001, 11)
        member = np.clip(np.digitize(snr, edges) - 1, 0, 9)
        shown = np.linalg.norm(own - light, axis=1) / np.sqrt(2)
        axis.plot(snr, shown, ",", color="#c9d6e2", zorder=0, rasterized=True)
        for label, error, part, marker in (
            ("PSF of one colour", measured - light, "psf", "o"),
            ("PSF of the star's colour", own - light, "noise", "s"),
            ("colour shift of the light", light - reference, "chromatic", "^"),
        ):
            curve = _binned(snr, np.sqrt((error**2).mean(axis=1)), member)
            axis.plot(*curve, marker=marker, color=PART_COLOURS[part], label=label, linewidth=1.0)
        sigma = outcome.result.cameras[name].noise_sigma_px
        curve = _binned(snr, np.sqrt((sigma**2).mean(axis=1)), member)
        axis.plot(*curve, color=INK, linestyle="--", linewidth=1.0, label="noise, predicted")
        axis.set(xscale="log", yscale="log", xlabel="signal-to-noise ratio")
        log_ticks(axis, "x", (10, 20, 50, 100, 200, 500, 1000))
    axes[0].set_ylabel("error per axis, RMS [px]")
    axes[0].set_ylim(bottom=1e-3)
    axes[-1].legend(fontsize=7.5, loc="lower left")
    return figure


def _binned(x: FloatArray, y: FloatArray, member: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Geometric mean of x and root mean square of y in every bin with ten stars or more."""
    bins = [k for k in np.unique(member) if np.count_nonzero(member == k) >= 10]
    return (
        np.array([np.exp(np.log(x[member == k]).mean()) for k in bins]),
        np.array([np.sqrt((y[member == k] ** 2).mean()) for k in bins]),
    )


def star_cover(outcome: Outcome, name: str) -> Figure:
    """Where the stars of all frames fell."""
    width, height = _size_px(outcome, name)
    figure, axis = new_figure(width="half", aspect_ratio=0.2 + 0.8 * height / width)
    colour = _star_colour(outcome.values(f"{name}_star_temperature"))
    size = np.clip(0.02 * outcome.values(f"{name}_star_snr"), 0.4, 6.0)
    axis.set_facecolor("#14161c")
    axis.scatter(*outcome.values(f"{name}_star_measured_px").T, s=size, c=colour, linewidths=0, rasterized=True)
    pixel_axes(axis, (width, height))
    stars, frames = outcome.value("stars", camera=name), outcome.value("frames", camera=name)
    axis.set_title(f"{outcome.labels('camera')[name]} lens: {stars} stars in {frames} frames")
    return figure


def method_bars(outcome: Outcome) -> Figure:
    """Map error by how the attitudes are treated, and what each method believes of itself."""
    figure, axes, panels = _panels(outcome, 0.32)
    methods = outcome.names("method")
    place = np.arange(len(methods))
    for axis, name in panels:
        axis.barh(place, outcome.values("corrected_rms_arcsec", camera=name), height=0.55, color=PALETTE[0])
        predicted = outcome.quantity("corrected_predicted_arcsec", camera=name)
        bars = {"fmt": "|", "color": PALETTE[1], "markersize": 11, "elinewidth": 1.2}
        axis.errorbar(predicted.values, place, xerr=predicted.error, **bars)
        axis.set_yticks(place, methods if axis is axes[0] else [])
        axis.invert_yaxis()
        axis.grid(visible=False, axis="y")
        axis.set(xlabel=RMS_LABEL, xlim=(0, None))
    handles = [
        Line2D([], [], color=PALETTE[0], linewidth=5, label="error"),
        Line2D([], [], color=PALETTE[1], marker="|", linestyle="-", label="predicted, and its scatter"),
    ]
    figure.legend(handles=handles, fontsize=7.5, loc="outside lower center", ncols=2)
    return figure
