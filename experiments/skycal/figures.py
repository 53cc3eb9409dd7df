"""Figures of the calibration under the sky."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure
from experiments.harness.tables import cell_text
from experiments.skycal.calibrate import METHODS, rms
from experiments.skycal.evaluate import PARTS
from experiments.skycal.result import CameraResult
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


PART_COLOURS = dict(zip(PARTS, (PALETTE[2], PALETTE[4], PALETTE[0], PALETTE[3]), strict=True))
STAR_COLOURS = (
    (3000.0, "#ff9d5c"),
    (4300.0, "#ffc48f"),
    (5300.0, "#ffe9cf"),
    (7000.0, "#f4f3ff"),
    (12000.0, "#a9c4ff"),
)
"""Colours of black bodies on a screen, a little more saturated than they are."""
ARROWS = 11


def _star_colour(temperature_k: FloatArray) -> FloatArray:
    """RGB (n, 3) of stars."""
    knots = np.log([t for t, _ in STAR_COLOURS])
    rgb = np.array([[int(name[i : i + 2], 16) / 255 for i in (1, 3, 5)] for _, name in STAR_COLOURS])
    at = np.log(temperature_k)
    return np.stack([np.interp(at, knots, channel) for channel in rgb.T], axis=1)


def _frame(axis: Any, camera: CameraResult, *, labels: bool = True) -> None:
    """The detector's outline as limits, row axis downwards."""
    geometry = camera.scene.instrument.camera
    axis.set(xlim=(-0.5, geometry.width_px - 0.5), ylim=(geometry.height_px - 0.5, -0.5), aspect="equal")
    axis.grid(visible=False)
    for spine in axis.spines.values():
        spine.set_visible(True)
    if labels:
        axis.set(xlabel="column [px]", ylabel="row [px]")
    else:
        axis.set(xticks=[], yticks=[])


def sky_frame(camera: CameraResult, *, half: bool = False) -> Figure:
    """One frame with the stars that were matched; columns less their medians, stars enlarged."""
    from scipy.ndimage import gaussian_filter

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
    burnt = has_flag(frame.found.flags[rest], StarFlag.SATURATED)
    axis.scatter(x[~burnt], y[~burnt], s=14 if half else 26, marker="x", color="#ff5d8f", linewidths=0.7)
    axis.scatter(x[burnt], y[burnt], s=60, marker="s", facecolors="none", edgecolors="#ff5d8f", linewidths=0.9)
    _frame(axis, camera)
    return figure


def close_ups(camera: CameraResult, *, half: bool = False) -> Figure:
    """Stars of that frame as the centroider sees them, brightest first; the cross is where the light fell."""
    matched, stamps = camera.matched, camera.recording.stamps
    mine = np.flatnonzero((matched.frame == camera.recording.example_index) & camera.evaluation.used)
    mine = mine[np.argsort(-matched.snr[mine])]
    chosen = mine[np.unique(np.linspace(0, len(mine) - 1, min(12, len(mine))).round().astype(int))]
    shape = (3, 4) if half else (2, 6)
    figure, axes = new_figure(
        *shape, width="half" if half else "full", aspect_ratio=0.88 if half else 0.38, squeeze=False
    )
    for axis in axes.ravel():
        axis.set_axis_off()
    for axis, row in zip(axes.ravel(), chosen, strict=False):
        window, star = matched.row[row], matched.star[row]
        light = stamps.electrons[window] - stamps.background_e[window]
        column, line = stamps.corner_px[window]
        size = len(light)
        axis.set_axis_on()
        axis.imshow(
            np.arcsinh(light / 40.0),
            extent=(column - 0.5, column + size - 0.5, line + size - 0.5, line - 0.5),
            vmin=-0.8,
            cmap="cividis",
        )
        axis.plot(*matched.photon_px[row], "+", color="white", markersize=8, markeredgewidth=1.0)
        axis.grid(visible=False)
        axis.set(xticks=[], yticks=[])
        sky = camera.scene.sky
        axis.set_title(f"G {sky.magnitude[star]:.1f}, {sky.temperature_k[star] / 1000:.1f} kK", fontsize=6.5, pad=3)
    return figure


def _heat(axis: Any, camera: CameraResult, error: FloatArray, high: float, *, arrows: bool = True) -> Any:
    """Length of vectors over the detector as colour, direction as arrows."""
    chart = camera.evaluation.chart
    shape = (chart.rows, chart.columns)
    x, y = (chart.pixel_px[:, k].reshape(shape) for k in (0, 1))
    size = np.linalg.norm(error, axis=1).reshape(shape)
    mesh = axis.pcolormesh(x, y, size, shading="gouraud", vmin=0.0, vmax=high, cmap="magma_r", rasterized=True)
    if arrows and np.nanmax(size) > 0:
        step = max(1, round(chart.columns / ARROWS))
        pick = (slice(step // 2, None, step), slice(step // 2, None, step))
        u, v = (error[:, k].reshape(shape) for k in (0, 1))
        width = camera.scene.instrument.camera.width_px
        typical = np.nanpercentile(size, 85)
        u, v = (value * np.minimum(1.0, typical / np.maximum(size, 1e-300)) for value in (u, v))
        scale = typical / (0.9 * step * width / chart.columns)
        axis.quiver(
            x[pick], y[pick], u[pick], v[pick], angles="xy", scale_units="xy", scale=scale, width=0.005, color="#2b6ca3"
        )
    _frame(axis, camera, labels=False)
    return mesh


def error_and_uncertainty(camera: CameraResult) -> Figure:
    """Error map of the measured calibration beside its predicted uncertainty; below, with star colours known."""
    total, fine = camera.total, camera.of("corrected")
    panels = (
        (total.error_arcsec, f"measured: error, RMS {total.rms_arcsec:.3g}″", True),
        (total.sigma_arcsec, f"measured: predicted σ, RMS {rms(total.sigma_arcsec):.3g}″", False),
        (fine.error_arcsec, f"colours known: error, RMS {fine.rms_arcsec:.3g}″", True),
        (fine.sigma_arcsec, f"colours known: predicted σ, RMS {rms(fine.sigma_arcsec):.3g}″", False),
    )
    geometry = camera.scene.instrument.camera
    ratio = geometry.height_px / geometry.width_px
    figure, axes = new_figure(2, 2, aspect_ratio=0.16 + 0.86 * ratio, squeeze=False)
    high = max(float(np.nanpercentile(np.linalg.norm(values, axis=1), 99.5)) for values, _, _ in panels)
    mesh: Any = None
    for axis, (values, title, arrows) in zip(axes.ravel(), panels, strict=True):
        mesh = _heat(axis, camera, values, high, arrows=arrows)
        axis.set_title(title)
    figure.colorbar(mesh, ax=axes, label="line of sight [arcsec]", shrink=0.9, aspect=30)
    return figure


def part_maps(camera: CameraResult) -> Figure:
    """The parts of the error, each with its own scale of arrows, all with one scale of colour."""
    geometry = camera.scene.instrument.camera
    ratio = geometry.height_px / geometry.width_px
    figure, axes = new_figure(2, 2, aspect_ratio=0.16 + 0.86 * ratio, squeeze=False)
    parts = camera.evaluation.part_arcsec
    high = max(float(np.nanpercentile(np.linalg.norm(part, axis=1), 99.5)) for part in parts.values())
    mesh: Any = None
    for axis, (name, label) in zip(axes.ravel(), PARTS.items(), strict=True):
        mesh = _heat(axis, camera, parts[name], high, arrows=rms(parts[name]) > 1e-3 * high)
        axis.set_title(f"{label}: RMS {cell_text(rms(parts[name]), '.1e' if rms(parts[name]) < 1e-3 else '.2g')}″")
    figure.colorbar(mesh, ax=axes, label="line of sight [arcsec]", shrink=0.9, aspect=30)
    return figure


def decomposition(cameras: Sequence[CameraResult]) -> Figure:
    """Parts, their root sum square, the total, and what was predicted."""
    figure, axes = new_figure(1, len(cameras), aspect_ratio=0.38, squeeze=False)
    for axis, camera in zip(axes[0], cameras, strict=True):
        evaluation = camera.evaluation
        bars = [(label, rms(evaluation.part_arcsec[name]), PART_COLOURS[name]) for name, label in PARTS.items()]
        bars += [
            ("root sum square", evaluation.quadrature_arcsec, "#c3c8ce"),
            ("total, measured", camera.total.rms_arcsec, INK),
            ("its predicted σ", camera.total.predicted_arcsec, "#9aa1a9"),
            ("total, colours known", camera.of("corrected").rms_arcsec, PALETTE[1]),
            ("its predicted σ ", camera.of("corrected").predicted_arcsec, "#f0b48a"),
        ]
        place = np.array([0, 1, 2, 3, 4.4, 5.4, 6.4, 7.8, 8.8])
        values = np.array([value for _, value, _ in bars])
        axis.barh(place, values, color=[colour for _, _, colour in bars], height=0.72)
        for y, value in zip(place, values, strict=True):
            text = f" {cell_text(value, '.1e' if value < 1e-3 else '.2g')}″"
            axis.text(value, y, text, va="center", fontsize=7.5)
        axis.set_yticks(place, [label for label, _, _ in bars])
        axis.invert_yaxis()
        axis.margins(x=0.2)
        axis.grid(visible=False, axis="y")
        axis.set(xlabel="map error, RMS [arcsec]", title=camera.title)
        if axis is not axes[0, 0]:
            axis.set_yticklabels([])
    return figure


def _short(model: str) -> str:
    family, degree = parse_model_name(model)
    return {"pinhole": "pinhole", "brown_conrady": "Brown–\nConrady"}.get(family, f"poly-\nnomial {degree}")


def model_curves(cameras: Sequence[CameraResult]) -> Figure:
    """Map error against camera model: what the model cannot say, what noise does to it, what comes out."""
    figure, axes = new_figure(1, len(cameras), aspect_ratio=0.4, squeeze=False)
    for axis, camera in zip(axes[0], cameras, strict=True):
        models = camera.scene.config.models
        place = np.arange(len(models))
        lines = (
            ("cannot be described", [camera.of("reference", model=m).rms_arcsec for m in models]),
            ("noise, predicted", [camera.of("corrected", model=m).predicted_arcsec for m in models]),
            ("colours known", [camera.of("corrected", model=m).rms_arcsec for m in models]),
            ("measured", [camera.of("measured", model=m).rms_arcsec for m in models]),
        )
        colours = (PALETTE[2], "#9aa1a9", PALETTE[1], INK)
        for (label, values), colour, marker in zip(lines, colours, MARKERS, strict=False):
            style = ":" if label.startswith("noise") else "-"
            axis.plot(place, values, marker=marker, color=colour, linestyle=style, label=label, linewidth=1.1)
        axis.set_xticks(place, [_short(model) for model in models], fontsize=7)
        axis.set(yscale="log", title=camera.title)
        axis.grid(visible=False, axis="x")
    axes[0, 0].set_ylabel("map error, RMS [arcsec]")
    axes[0, -1].legend(fontsize=7.5)
    return figure


def centroid_errors(cameras: Sequence[CameraResult]) -> Figure:
    """Errors of single positions against signal-to-noise ratio: noise, PSF of one colour, colour shift."""
    figure, axes = new_figure(1, len(cameras), aspect_ratio=0.42, squeeze=False, sharey=True)
    for axis, camera in zip(axes[0], cameras, strict=True):
        snr = camera.matched.snr[camera.evaluation.used]
        edges = np.geomspace(snr.min() * 0.999, snr.max() * 1.001, 11)
        member = np.clip(np.digitize(snr, edges) - 1, 0, 9)
        curves = (
            ("PSF of one colour", camera.shift_px("measured", "light"), PART_COLOURS["psf"], "o"),
            ("PSF of the star's colour", camera.shift_px("own", "light"), PART_COLOURS["noise"], "s"),
            ("colour shift of the light", camera.shift_px("light", "reference"), PART_COLOURS["chromatic"], "^"),
        )
        axis.plot(
            snr, np.linalg.norm(curves[1][1], axis=1) / np.sqrt(2), ",", color="#c9d6e2", zorder=0, rasterized=True
        )
        for label, error, colour, marker in curves:
            x, y = _binned(snr, np.sqrt((error**2).mean(axis=1)), member)
            axis.plot(x, y, marker=marker, color=colour, label=label, linewidth=1.0)
        x, y = _binned(snr, np.sqrt((camera.noise_sigma_px**2).mean(axis=1)), member)
        axis.plot(x, y, color=INK, linestyle="--", linewidth=1.0, label="noise, predicted")
        axis.set(xscale="log", yscale="log", xlabel="signal-to-noise ratio", title=camera.title)
        ticks = [tick for tick in (10, 20, 50, 100, 200, 500, 1000) if edges[0] <= tick <= edges[-1]]
        axis.set_xticks(ticks, [str(tick) for tick in ticks])
        axis.minorticks_off()
    axes[0, 0].set(ylabel="error per axis, RMS [px]")
    axes[0, 0].set_ylim(bottom=1e-3)
    axes[0, -1].legend(fontsize=7.5, loc="lower left")
    return figure


def _binned(x: FloatArray, y: FloatArray, member: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Geometric mean of x and root mean square of y in every bin with ten stars or more."""
    bins = [k for k in np.unique(member) if np.count_nonzero(member == k) >= 10]
    return (
        np.array([np.exp(np.log(x[member == k]).mean()) for k in bins]),
        np.array([np.sqrt((y[member == k] ** 2).mean()) for k in bins]),
    )


def star_cover(camera: CameraResult) -> Figure:
    """Where the stars of all frames fell."""
    geometry = camera.scene.instrument.camera
    ratio = geometry.height_px / geometry.width_px
    figure, axis = new_figure(width="half", aspect_ratio=0.2 + 0.8 * ratio)
    used, matched = camera.evaluation.used, camera.matched
    colour = _star_colour(camera.scene.sky.temperature_k[matched.star[used]])
    axis.set_facecolor("#14161c")
    size = np.clip(0.02 * matched.snr[used], 0.4, 6.0)
    axis.scatter(*matched.pixel_px[used].T, s=size, c=colour, linewidths=0, rasterized=True)
    _frame(axis, camera)
    axis.set_title(f"{camera.title}: {int(used.sum())} stars in {camera.scene.frames} frames")
    return figure


def method_bars(cameras: Sequence[CameraResult]) -> Figure:
    """Map error by how the attitudes are treated, and what each method believes of itself."""
    figure, axes = new_figure(1, len(cameras), aspect_ratio=0.32, squeeze=False)
    for axis, camera in zip(axes[0], cameras, strict=True):
        runs = [camera.of("corrected", method=method) for method in METHODS]
        place = np.arange(len(runs))
        axis.barh(place, [run.rms_arcsec for run in runs], height=0.55, color=PALETTE[0])
        believed = np.array([run.predicted_arcsec for run in runs])
        spread = np.array([run.predicted_spread_arcsec for run in runs])
        axis.errorbar(believed, place, xerr=spread, fmt="|", color=PALETTE[1], markersize=11, elinewidth=1.2)
        axis.set_yticks(place, METHODS.values() if axis is axes[0, 0] else [])
        axis.invert_yaxis()
        axis.grid(visible=False, axis="y")
        axis.set(xlabel="map error, RMS [arcsec]", title=camera.title, xlim=(0, None))
    handles = [
        Line2D([], [], color=PALETTE[0], linewidth=5, label="error"),
        Line2D([], [], color=PALETTE[1], marker="|", linestyle="-", label="predicted, and its scatter"),
    ]
    figure.legend(handles=handles, fontsize=7.5, loc="outside lower center", ncols=2)
    return figure
