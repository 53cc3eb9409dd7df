"""Figures of the experiment on star vectors: the rendered bench, and the studies on coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle, Ellipse

from calib.directional.fisher import tangent_basis, tangent_plane
from experiments.fisher.bench import Case
from experiments.fisher.coverage import DISTRIBUTIONS, LEVELS
from experiments.fisher.field_of_view import closed_form, pixel_noise_form
from experiments.fisher.reduce import CONFIDENCE
from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure, scale_bar
from experiments.harness.quantities import Outcome
from experiments.laboratory.point_figures import detector_outline
from experiments.laboratory.single_star import sketch
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

__all__ = [
    "bench_sketch",
    "cause_bars",
    "coverage_plot",
    "digits_plot",
    "error_arrows",
    "field_bias",
    "quantile_plots",
    "same_data_plot",
    "star_windows",
    "table_plot",
    "vector_scatter",
]


_FAINT = "#9aa1a9"
_HELD = float(np.sqrt(-2.0 * np.log(1.0 - CONFIDENCE)))
"""Radius in sigmas of the circle that holds 95 % of an isotropic normal distribution."""
_SHOWN_ERRORS = 3.0
_THIN = {"linewidth": 0.9, "linestyle": (0, (4, 3))}


def bench_sketch(outcome: Outcome) -> Figure:
    """The bench from the side."""
    return sketch.bench_sketch(outcome.config.table.axes)


def vector_scatter(outcome: Outcome) -> Figure:
    """Vectors w_i about their mean, with the fitted circle, its confidence band, and the ellipse."""
    cases = outcome.result.bench.cases
    figure, axes = new_figure(1, len(cases), aspect_ratio=0.56, squeeze=False)
    offsets = [_offsets(case) for case in cases]
    reach = 1.08 * max(float(np.abs(offset).max()) for offset in offsets)
    for axis, case, offset in zip(axes[0], cases, offsets, strict=True):
        at, outlier = {"acquisition": case.acquisition.name}, case.evaluation.outlier
        sigma = float(outcome.values("sigma_arcsec", **at))
        low, high = outcome.values("sigma_interval_95_arcsec", **at)
        axis.scatter(*offset[~outlier].T, s=7, color=PALETTE[0], alpha=0.55, linewidths=0, zorder=2)
        if outlier.any():
            axis.scatter(*offset[outlier].T, s=18, marker="x", color=PALETTE[1], label="outlier")
        axis.add_patch(Annulus((0, 0), high, high - low, color=PALETTE[1], alpha=0.30, linewidth=0, zorder=3))
        axis.add_patch(Circle((0, 0), sigma, fill=False, color=PALETTE[1], linewidth=1.6, zorder=4))
        axis.add_patch(Circle((0, 0), _HELD * sigma, fill=False, color=PALETTE[1], **_THIN))
        axis.plot([], [], color=PALETTE[1], linewidth=1.6, label=f"σ = {sigma:.3f}″ ({low:.3f} … {high:.3f})")
        inside = np.mean(np.linalg.norm(offset[~outlier], axis=1) <= _HELD * sigma)
        held = f"holds {100 * CONFIDENCE:g} %: here {100 * inside:.1f} %"
        axis.plot([], [], color=PALETTE[1], label=held, **_THIN)
        if outcome.values("isotropy_p_value", **at) < 1.0 - CONFIDENCE:
            axis.add_patch(_ellipse(case))
            axis.plot([], [], color=INK, linewidth=1.0, label="its ellipse, 1 σ")
        axis.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="across the star, along X [″]")
        axis.set_title(f"{case.acquisition.name}: {outcome.values('n', **at)} vectors")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), fontsize=7.5)
    axes[0, 0].set_ylabel("along Y [″]")
    return figure


def _offsets(case: Case) -> FloatArray:
    return tangent_plane(case.evaluation.vectors, case.evaluation.fit.mean) * RAD_ARCSEC


def _ellipse(case: Case) -> Ellipse:
    found = case.evaluation.isotropy
    along = tangent_basis(case.evaluation.fit.mean) @ found.direction
    turn = float(np.degrees(np.arctan2(along[1], along[0])))
    size = 2 * found.major_rad * RAD_ARCSEC, 2 * found.minor_rad * RAD_ARCSEC
    return Ellipse((0, 0), *size, angle=turn, fill=False, color=INK, linewidth=1.0, zorder=5)


def quantile_plots(outcome: Outcome) -> Figure:
    """k (1 - cos) of every vector against the exponential distribution."""
    cases = outcome.result.bench.cases
    figure, axes = new_figure(1, len(cases), aspect_ratio=0.45, squeeze=False, sharey=True)
    for axis, case in zip(axes[0], cases, strict=True):
        tails = case.evaluation.tails
        rank = np.arange(1, len(tails.found) + 1) / (len(tails.found) + 1)
        spread = 1.96 * np.sqrt(rank / (1 - rank) / len(tails.found))  # of an exponential quantile, to first order
        low, high = np.maximum(tails.expected - spread, 0), tails.expected + spread
        axis.fill_between(tails.expected, low, high, color=_FAINT, alpha=0.25, lw=0, label="95 % of a quantile")
        axis.plot(tails.expected, tails.expected, color=INK, linewidth=0.8)
        axis.plot(tails.expected, tails.found, ".", color=PALETTE[0], markersize=3.5)
        verdict = "not refused at 15 %" if tails.level == 1.0 else f"refused at {100 * tails.level:g} %"
        axis.set_title(f"{case.acquisition.name}: Kolmogorov {tails.statistic:.2f}, {verdict}")
        axis.set_xlabel("exponential quantile")
    axes[0, 0].set_ylabel("k (1 − cos θ)")
    axes[0, 0].legend(loc="upper left")
    return figure


def cause_bars(outcome: Outcome) -> Figure:
    """Expected and realised causes of the scatter."""
    names, shown = outcome.names("acquisition"), ("centroids", "table", "calibration", "all")
    figure, axes = new_figure(1, len(names), aspect_ratio=0.36, squeeze=False, sharey=True)
    place = np.arange(len(shown))
    for axis, name in zip(axes[0], names, strict=True):
        expected, realised = (
            [float(outcome.values(quantity, cause=cause, acquisition=name)) for cause in shown]
            for quantity in ("expected_arcsec", "realised_arcsec")
        )
        axis.bar(place - 0.18, expected, 0.34, color=_FAINT, label="expected")
        axis.bar(place[:-1] + 0.18, realised[:-1], 0.34, color=PALETTE[0], label="realised")
        low, high = outcome.values("sigma_interval_95_arcsec", acquisition=name)
        sigma, style = realised[-1], {"fmt": "o", "color": PALETTE[1], "label": "Fisher, 95 %"}
        axis.errorbar([place[-1] + 0.18], [sigma], [[sigma - low], [high - sigma]], **style)
        axis.set_xticks(place, shown)
        axis.grid(visible=False, axis="x")
        axis.set_title(name)
    axes[0, 0].set_ylabel("per axis [″]")
    axes[0, 0].legend(loc="upper left")
    return figure


def error_arrows(outcome: Outcome) -> Figure:
    """Star vectors over the detector: where the image was, and how far the vector is from their mean."""
    cases, camera = outcome.result.bench.cases, outcome.result.instrument.camera
    figure, axes = new_figure(1, len(cases), aspect_ratio=0.32, squeeze=False, sharey=True)
    longest = max(float(np.linalg.norm(_offsets(case), axis=1).max()) for case in cases)
    scale = longest / (2.2 * camera.width_px / outcome.config.evaluation.columns)
    for axis, case in zip(axes[0], cases, strict=True):
        place = case.acquisition.position_px
        style = {"angles": "xy", "scale_units": "xy", "scale": scale, "color": PALETTE[0], "width": 0.0022}
        drawn = axis.quiver(*place.T, *_offsets(case).T, **style)
        axis.scatter(*place.T, s=1.5, color=INK, linewidths=0)
        key = float(f"{longest / 2:.0e}")
        axis.quiverkey(drawn, 0.86, 1.04, key, f"{key:g}″", labelpos="E", fontproperties={"size": 7.5})
        detector_outline(axis, camera.width_px, camera.height_px)
        axis.set(xlabel="column [px]", title=case.acquisition.name)
    axes[0, 0].set_ylabel("row [px]")
    return figure


def star_windows(outcome: Outcome) -> Figure:
    """Single frames of five places, at rest and on the move."""
    figure, axes = new_figure(2, 5, aspect_ratio=0.42)
    for row, case in zip(axes, outcome.result.bench.cases, strict=True):
        chosen = np.linspace(0, case.acquisition.windows.dn.shape[1] - 1, len(row)).astype(int)
        for axis, at in zip(row, chosen, strict=True):
            _window(axis, case, int(at))
        row[0].set_ylabel(case.acquisition.name)
    return figure


def _window(axis: Any, case: Case, at: int) -> None:
    stack = case.acquisition.windows
    size = stack.dn.shape[-1]
    electrons = (stack.dn[0, at].astype(float) - stack.offset_dn) / stack.gain_dn_per_e
    column, row = (int(v) for v in stack.corner_px[at])
    extent = (column - 0.5, column + size - 0.5, row + size - 0.5, row - 0.5)
    axis.imshow(np.where(stack.defect[at], np.nan, electrons), extent=extent, vmin=-40)
    centre = np.array([column, row]) + size / 2
    near = int(np.argmin(np.linalg.norm(case.acquisition.bundle_px - centre, axis=1)))
    axis.plot(*case.acquisition.bundle_px[near], "+", color="white", markersize=7, markeredgewidth=0.9)
    axis.plot(*case.acquisition.position_px[near], "x", color=PALETTE[1], markersize=4, markeredgewidth=0.9)
    axis.set(xticks=[], yticks=[], xlim=extent[:2], ylim=extent[2:])
    scale_bar(axis)
    axis.grid(visible=False)
    axis.set_title(f"{centre[0]:.0f}, {centre[1]:.0f}", fontsize=7, pad=3)


def _points(
    axis: Any, outcome: Outcome, name: str, x: FloatArray, *, errors: float = _SHOWN_ERRORS, **style: Any
) -> None:
    """A quantity with its uncertainty, times ``errors``."""
    axis.errorbar(x, outcome.values(name), errors * outcome.errors(name), **{"fmt": "o", "color": PALETTE[0]} | style)


def field_bias(outcome: Outcome) -> Figure:
    """Bias of the pixel method over the field, and the opposite case."""
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.50, width_ratios=(1.15, 1.0))
    field, count = outcome.values("field_deg"), int(outcome.values("n", acquisition="static"))
    fine = np.geomspace(field[0], field[-1], 200)
    left.plot(fine, [100 * (closed_form(f) - 1) for f in fine], color=INK, linewidth=1.0, label="closed form")
    _points(left, outcome, "baseline_bias_percent", field, label="pixel method, Monte-Carlo")
    even, wrong = outcome.values("field_over_pixels_percent"), outcome.values("wrong_resolution_percent")
    error = f"{100 * outcome.config.field.resolution_error_fraction:+g} %".replace("-", "−")
    left.plot(field, even, "s", color=PALETTE[4], label="angle = field over pixels")
    left.plot(field, np.abs(wrong), "^", color=PALETTE[1], label=f"angle wrong by {error}")
    seen = 98.0 / np.sqrt(count)
    left.axhspan(seen, 1e3, color=_FAINT, alpha=0.18, linewidth=0)
    words = {"fontsize": 7, "color": "#5b636d", "va": "bottom"}
    left.text(field[0], seen * 1.12, f"95 % interval of σ from {count} vectors", **words)
    left.set(xscale="log", yscale="log", ylabel="pixel method over Fisher, too large by [%]")
    left.set_ylim(0.006, max(14.0, 3 * seen))
    log_ticks(left, "x", (3, 5, 8, 12, 20, 40))
    left.minorticks_off()
    left.legend(loc="lower right", fontsize=7)
    left.set_title("noise isotropic on the sphere")
    right.plot(fine, [100 * (pixel_noise_form(f) - 1) for f in fine], color=INK, linewidth=1.0, label="quadrature")
    _points(right, outcome, "pixel_noise_fisher_percent", field, label="Fisher over the axis")
    right.axhline(0.0, color=PALETTE[1], linewidth=1.0, label="pixel method")
    right.set(ylabel="relative to the noise on the axis [%]")
    right.legend(loc="lower left", fontsize=7)
    right.set_title("the opposite: noise isotropic in pixels")
    for axis in (left, right):
        axis.set_xlabel("full width of a square field [°]")
    return figure


def coverage_plot(outcome: Outcome) -> Figure:
    """Share of intervals that hold the truth, over the size of the sample."""
    figure, axes = new_figure(1, len(LEVELS), aspect_ratio=0.46)
    kinds, counts = outcome.values("coverage_kind"), outcome.values("coverage_count")
    for axis, nominal, level in zip(axes, LEVELS, outcome.data.coords["level"].values.tolist(), strict=True):
        error = float(outcome.errors("covered", level=level)[0])
        axis.axhspan(100 * (nominal - 2 * error), 100 * (nominal + 2 * error), color=_FAINT, alpha=0.35, linewidth=0)
        axis.axhline(100 * nominal, color=INK, linewidth=0.8)
        covered, own = (outcome.values(f"{name}_percent", level=level) for name in ("covered", "effective"))
        for (kind, words), marker, colour in zip(DISTRIBUTIONS.items(), MARKERS, PALETTE, strict=False):
            some, style = kinds == kind, {"marker": marker, "color": colour}
            axis.plot(counts[some], covered[some], linewidth=1.0, label=words, **style)
            if kind in ("ellipse", "tails"):
                axis.plot(counts[some], own[some], markerfacecolor="white", linewidth=0.8, linestyle=":", **style)
        axis.set(xscale="log", xlabel="star vectors n", title=f"nominal {nominal:.0%}")
        log_ticks(axis, "x", sorted(set(counts.tolist())))
    axes[0].set_ylabel("intervals that hold the truth [%]")
    axes[0].plot([], [], marker="o", color=INK, markerfacecolor="white", linestyle=":", label="ν from the vectors")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7.5)
    return figure


def same_data_plot(outcome: Outcome) -> Figure:
    """Estimated over true sigma against the number of places, by which data calibrated the camera."""
    figure, axis = new_figure(aspect_ratio=0.42)
    count, unknowns = outcome.values("same_data_count"), int(outcome.values("same_data_unknowns")[0])
    dense = np.geomspace(count[0], count[-1], 100)
    axis.plot(dense, np.sqrt((2 * dense - unknowns) / (2 * dense - 2)), color=PALETTE[1], linewidth=0.9)
    axis.plot(dense, np.sqrt((2 * dense + unknowns - 4) / (2 * dense - 2)), color=PALETTE[2], linewidth=0.9)
    for i, (key, label) in enumerate(
        (
            ("corrected", f"the same data, 2n − {unknowns} degrees of freedom"),
            ("naive", "the same data, 2(n − 1) degrees of freedom"),
            ("independent", "data of their own, 2(n − 1)"),
        )
    ):
        style = {"fmt": MARKERS[i], "color": PALETTE[i], "label": label}
        _points(axis, outcome, f"sigma_ratio_{key}", count * (1 + 0.012 * (i - 1)), errors=2.0, **style)
    axis.axhline(1.0, color=INK, linewidth=0.8)
    axis.set(xscale="log", xlabel="places n", ylabel="σ over that of the noise")
    log_ticks(axis, "x", count.tolist())
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def digits_plot(outcome: Outcome) -> Figure:
    """Relative error of the concentration over the noise of the vectors."""
    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    for key, label, colour, marker in (
        ("subtraction", "1 − R, subtracted", PALETTE[1], "s"),
        ("scipy", "SciPy", PALETTE[4], "^"),
        ("chords", "squared chords", PALETTE[0], "o"),
    ):
        error = outcome.values(f"digits_{key}")
        shown = np.where(np.isfinite(error), np.clip(error, 1e-17, 10.0), np.nan)
        axis.plot(outcome.values("digits_sigma_arcsec"), shown, marker=marker, color=colour, label=label)
    axis.axhline(1.0, color=_FAINT, linewidth=0.8, linestyle=":")
    axis.set(xscale="log", yscale="log", xlabel="σ per axis [″]", ylabel="relative error of k")
    axis.invert_xaxis()
    axis.minorticks_off()
    axis.legend(loc="upper left", fontsize=7.5)
    return figure


def table_plot(outcome: Outcome) -> Figure:
    """What is measured, over the reading noise of the table."""
    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    reading, expected = outcome.values("table_sweep_reading_arcsec"), outcome.values("table_sweep_expected_arcsec")
    camera = float(outcome.values("expected_arcsec", cause="centroids", acquisition="static"))
    axis.plot(reading, expected, color=INK, linewidth=1.0, label="camera and table")
    axis.axhline(camera, color=PALETTE[2], linewidth=1.0, linestyle="--", label=f"camera alone, {camera:.3f}″")
    _points(axis, outcome, "table_sweep_sigma_arcsec", reading, label="Fisher")
    axis.set(xscale="log", yscale="log", xlabel=outcome.heading("reading"), ylabel="σ per axis [″]")
    log_ticks(axis, "x", reading.tolist())
    log_ticks(axis, "y")
    axis.legend(loc="upper left", fontsize=7.5)
    return figure
