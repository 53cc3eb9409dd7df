"""Figures of the studies on coordinates: bias over the field, coverage, same data, digits, other tables."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.fisher.coverage import KINDS, LEVELS
from experiments.fisher.evaluate import vectors_needed
from experiments.fisher.field import closed_form, opposite_form
from experiments.fisher.result import Result
from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure

__all__ = ["coverage_plot", "digits_plot", "field_bias", "same_data_plot", "table_plot"]

_FAINT = "#9aa1a9"
_SHOWN_ERRORS = 3.0


def field_bias(result: Result) -> Figure:
    """Bias of the pixel method over the field, and the opposite case."""
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.50, width_ratios=(1.15, 1.0))
    points = result.field_sweep
    field = np.array([p.field_deg for p in points])
    fine = np.geomspace(field[0], field[-1], 200)
    left.plot(fine, [100 * (closed_form(f) - 1) for f in fine], color=INK, linewidth=1.0, label="closed form")
    left.errorbar(
        field,
        [p.baseline.percent for p in points],
        [_SHOWN_ERRORS * p.baseline.percent_error for p in points],
        fmt="o",
        color=PALETTE[0],
        label="pixel method, Monte-Carlo",
    )
    left.plot(
        field, [p.field_over_pixels.percent for p in points], "s", color=PALETTE[4], label="angle = field over pixels"
    )
    wrong = f"{100 * result.config.field.resolution_error_fraction:+g} %".replace("-", "−")
    left.plot(
        field,
        [abs(p.wrong_resolution.percent) for p in points],
        "^",
        color=PALETTE[1],
        label=f"angle wrong by {wrong}",
    )
    count = result.bench.cases[0].evaluation.fit.count
    seen = 98.0 / np.sqrt(count)
    left.axhspan(seen, 1e3, color=_FAINT, alpha=0.18, linewidth=0)
    left.text(
        field[0], seen * 1.12, f"95 % interval of σ from {count} vectors", fontsize=7, color="#5b636d", va="bottom"
    )
    left.set(
        xscale="log",
        yscale="log",
        xlabel="full width of a square field [deg]",
        ylabel="pixel method over Fisher, too large by [%]",
    )
    left.set_ylim(0.006, max(14.0, 3 * seen))
    left.set_xticks([f for f in (3, 5, 8, 12, 20, 40) if field[0] <= f <= field[-1]])
    left.set_xticklabels([f"{f:g}" for f in left.get_xticks()])
    left.minorticks_off()
    left.legend(loc="lower right", fontsize=7)
    left.set_title("noise isotropic on the sphere")
    right.plot(fine, [100 * (opposite_form(f) - 1) for f in fine], color=INK, linewidth=1.0, label="quadrature")
    right.errorbar(
        field,
        [p.opposite_fisher.percent for p in points],
        [_SHOWN_ERRORS * p.opposite_fisher.percent_error for p in points],
        fmt="o",
        color=PALETTE[0],
        label="Fisher over the axis",
    )
    right.axhline(0.0, color=PALETTE[1], linewidth=1.0, label="pixel method")
    right.set(xlabel="full width of a square field [deg]", ylabel="relative to the noise on the axis [%]")
    right.legend(loc="lower left", fontsize=7)
    right.set_title("the opposite: noise isotropic in pixels")
    return figure


def coverage_plot(result: Result) -> Figure:
    """Share of intervals that hold the truth, over the size of the sample."""
    figure, axes = new_figure(1, len(LEVELS), aspect_ratio=0.46)
    counts = sorted({p.count for p in result.coverage})
    for k, (axis, level) in enumerate(zip(axes, LEVELS, strict=True)):
        error = result.coverage[0].error[k]
        axis.axhspan(100 * (level - 2 * error), 100 * (level + 2 * error), color=_FAINT, alpha=0.35, linewidth=0)
        axis.axhline(100 * level, color=INK, linewidth=0.8)
        for i, (kind, words) in enumerate(KINDS.items()):
            points = [p for p in result.coverage if p.kind == kind]
            axis.plot(
                [p.count for p in points],
                [100 * p.covered[k] for p in points],
                marker=MARKERS[i],
                color=PALETTE[i],
                linewidth=1.0,
                label=words,
            )
            if kind in ("ellipse", "tails"):
                axis.plot(
                    [p.count for p in points],
                    [100 * p.covered_effective[k] for p in points],
                    marker=MARKERS[i],
                    color=PALETTE[i],
                    markerfacecolor="white",
                    linewidth=0.8,
                    linestyle=":",
                )
        axis.set(xscale="log", xlabel="star vectors n", title=f"nominal {level:.0%}")
        axis.set_xticks(counts, [f"{c}" for c in counts])
        axis.minorticks_off()
    axes[0].set_ylabel("intervals that hold the truth [%]")
    axes[0].plot([], [], marker="o", color=INK, markerfacecolor="white", linestyle=":", label="ν from the vectors")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7.5)
    return figure


def same_data_plot(result: Result) -> Figure:
    """Estimated over true sigma against the number of places, by which data calibrated the camera."""
    figure, axis = new_figure(aspect_ratio=0.42)
    points = result.same_data
    count = np.array([p.count for p in points])
    dense = np.geomspace(count[0], count[-1], 100)
    unknowns = points[0].unknowns
    axis.plot(dense, np.sqrt((2 * dense - unknowns) / (2 * dense - 2)), color=PALETTE[1], linewidth=0.9)
    axis.plot(dense, np.sqrt((2 * dense + unknowns - 4) / (2 * dense - 2)), color=PALETTE[2], linewidth=0.9)
    for i, (key, label) in enumerate(
        (
            ("corrected", f"the same data, 2n − {unknowns} degrees of freedom"),
            ("naive", "the same data, 2(n − 1) degrees of freedom"),
            ("independent", "data of their own, 2(n − 1)"),
        )
    ):
        axis.errorbar(
            count * (1 + 0.012 * (i - 1)),
            [getattr(p, key).root for p in points],
            [2 * getattr(p, key).root_error for p in points],
            fmt=MARKERS[i],
            color=PALETTE[i],
            label=label,
        )
    axis.axhline(1.0, color=INK, linewidth=0.8)
    axis.set(xscale="log", xlabel="places n", ylabel="σ over that of the noise")
    axis.set_xticks(count, [f"{c}" for c in count])
    axis.minorticks_off()
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def digits_plot(result: Result) -> Figure:
    """Relative error of the concentration over the noise of the vectors."""
    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    sigma = [p.sigma_arcsec for p in result.digits]
    for key, label, colour, marker in (
        ("subtraction", "1 − R, subtracted", PALETTE[1], "s"),
        ("scipy", "SciPy", PALETTE[4], "^"),
        ("chords", "squared chords", PALETTE[0], "o"),
    ):
        error = np.array([getattr(p, key) for p in result.digits])
        shown = np.where(np.isfinite(error), np.clip(error, 1e-17, 10.0), np.nan)
        axis.plot(sigma, shown, marker=marker, color=colour, label=label)
    axis.axhline(1.0, color=_FAINT, linewidth=0.8, linestyle=":")
    axis.set(xscale="log", yscale="log", xlabel="σ per axis [arcsec]", ylabel="relative error of k")
    axis.invert_xaxis()
    axis.minorticks_off()
    axis.legend(loc="upper left", fontsize=7.5)
    return figure


def table_plot(result: Result) -> Figure:
    """What is measured, over the reading noise of the table."""
    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    points = result.table_sweep
    reading = np.array([p.reading_arcsec for p in points])
    expected = np.array([p.expected_arcsec for p in points])
    camera = result.bench.cases[0].expected_arcsec["centroids"]
    axis.plot(reading, expected, color=INK, linewidth=1.0, label="camera and table")
    axis.axhline(camera, color=PALETTE[2], linewidth=1.0, linestyle="--", label=f"camera alone, {camera:.3f}″")
    axis.errorbar(
        reading,
        [p.sigma_arcsec for p in points],
        [_SHOWN_ERRORS * p.error_arcsec for p in points],
        fmt="o",
        color=PALETTE[0],
        label="Fisher",
    )
    axis.set(xscale="log", yscale="log", xlabel="noise of a reading [arcsec]", ylabel="σ per axis [arcsec]")
    ticks = [t for t in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if 0.8 * camera <= t <= 1.3 * expected.max()]
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_xticks(reading, [f"{noise:g}" for noise in reading])
    axis.minorticks_off()
    axis.legend(loc="upper left", fontsize=7.5)
    return figure


def needed_text(result: Result) -> str:
    """How many vectors it takes to see the bias, at the fields of the sweep that lie nearest 3, 12 and 20 degrees."""
    fields = [p.field_deg for p in result.field_sweep]
    chosen = sorted({min(fields, key=lambda f: abs(f - wanted)) for wanted in (3.0, 12.0, 20.0)})
    words = [f"{_round(vectors_needed(closed_form(f) - 1))} at {f:g}°" for f in chosen]
    return words[0].replace(" at", " star vectors at") + "".join(f", {word}" for word in words[1:])


def _round(value: float) -> str:
    rounded = float(f"{value:.2g}")
    return f"{rounded / 1e6:g} million" if rounded >= 1e6 else f"{rounded:,.0f}".replace(",", "\u202f")
