"""Figures of the report on a dataset."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from experiments.harness.plotting import INK, PALETTE, log_ticks, new_figure
from experiments.harness.quantities import Outcome
from optics.figures import draw_image

__all__ = ["attitude_errors", "centroid_curve", "completeness_curves", "example_frame", "sky_coverage"]


def example_frame(outcome: Outcome) -> Figure:
    """The first frame: detections circled by what they are."""
    example = outcome.result.evaluation.example
    height, width = example.electrons.shape
    figure, axis = new_figure(aspect_ratio=min(0.75, 0.08 + 0.92 * height / width))
    draw_image(example.electrons, axis)
    place, fit = example.measured.detected_px, example.measured.fit
    axis.scatter(*place[fit].T, s=26, facecolors="none", edgecolors=PALETTE[5], linewidths=0.8)
    axis.scatter(*place[~fit].T, s=26, marker="s", facecolors="none", edgecolors=PALETTE[4], linewidths=0.8)
    return figure


def attitude_errors(outcome: Outcome) -> Figure:
    """Boresight errors of the solved frames, and how they compare with their predicted sigma."""
    solved = outcome.values("status") == "identified"
    error, sigma = (outcome.values(f"frame_{name}_arcsec")[solved] for name in ("error", "sigma"))
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.42, width_ratios=(1.0, 1.25))
    left.scatter(error[:, 0], error[:, 1], s=9, color=PALETTE[0], alpha=0.75, linewidths=0)
    for name, style, text in (("median_arcsec", "-", "50 %"), ("p95_arcsec", "--", "95 %")):
        radius = float(outcome.values(name))
        left.add_patch(Circle((0, 0), radius, fill=False, linestyle=style, color=INK, linewidth=0.9))
        left.annotate(text, (0, radius), fontsize=7, ha="center", va="bottom", color=INK)
    reach = 1.15 * max(outcome.value("largest_arcsec"), 1e-6)
    left.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="about x [″]", ylabel="about y [″]")
    left.set_title("boresight error")
    bins = np.linspace(-4, 4, 25)
    for axis, name in enumerate(outcome.names("axis")):
        pull = error[:, axis] / sigma[:, axis]
        right.hist(pull, bins, histtype="step", color=PALETTE[axis], linewidth=1.3, label=name, density=True)
    grid = np.linspace(-4, 4, 200)
    right.plot(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), color=INK, linewidth=0.9, label="normal")
    right.set(xlabel="error over predicted sigma", xlim=(-4, 4))
    right.set_title("pulls")
    right.legend()
    return figure


def completeness_curves(outcome: Outcome) -> Figure:
    """Share of stars found against magnitude and against signal-to-noise ratio."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.38, sharey=True)
    for axis, name in zip(axes, ("magnitude_bin", "snr_bin"), strict=True):
        share, low, high = (outcome.values(f"{name}_{part}") for part in ("share", "low", "high"))
        bars = np.abs(np.stack([share - low, high - share]))
        axis.errorbar(outcome.data[name], share, bars, fmt="o", color=PALETTE[0], markersize=3.5)
        axis.set(xlabel=outcome.heading(name), ylim=(-0.03, 1.03))
    axes[0].set(ylabel=outcome.heading("magnitude_bin_share"))
    axes[1].set_xscale("log")
    log_ticks(axes[1], "x")
    return figure


def centroid_curve(outcome: Outcome) -> Figure:
    """Centroid error against signal-to-noise ratio, beside the Cramer-Rao bound of the same stars."""
    stars = outcome.result.evaluation.stars
    figure, axis = new_figure(aspect_ratio=0.5)
    placed = np.isfinite(stars.error_px).all(axis=1) & (stars.snr > 0)
    for mine, colour, label in (
        (placed & stars.clean & stars.fit, PALETTE[5], "undisturbed stars"),
        (placed & stars.found & ~stars.clean, PALETTE[3], "flagged in the truth"),
    ):
        off = np.maximum(np.hypot(*stars.error_px[mine].T) / np.sqrt(2.0), 1e-4)
        axis.scatter(stars.snr[mine], off, s=3, color=colour, alpha=0.35, linewidths=0, label=label, rasterized=True)
    snr, bound = outcome.values("centroid_snr"), outcome.values("centroid_bound_px")
    axis.errorbar(
        snr,
        outcome.values("centroid_error_px"),
        outcome.errors("centroid_error_px"),
        fmt="o",
        color=PALETTE[0],
        label="standard deviation per axis",
    )
    axis.plot(snr, bound, color=INK, label="Cramér-Rao bound of the same stars")
    axis.set(xscale="log", yscale="log", xlabel="signal-to-noise ratio", ylabel="centroid error [px]")
    axis.set_ylim(bottom=max(1e-3, 0.3 * float(bound.min())) if len(bound) else 1e-3)
    log_ticks(axis, "x")
    legend = axis.legend()
    for handle in legend.legend_handles:
        if hasattr(handle, "set_sizes"):
            handle.set_sizes([14])
            handle.set_alpha(0.9)
    return figure


def sky_coverage(outcome: Outcome) -> Figure:
    """Where the frames look; icrs, east to the left."""
    figure, axis = new_figure(aspect_ratio=0.52, subplot_kw={"projection": "mollweide"})
    records, evaluation = outcome.result.records, outcome.result.evaluation
    ra, dec = (np.radians([getattr(one, f"{name}_deg") for one in records]) for name in ("ra", "dec"))
    stars = np.array([one.stars for one in records], float)
    shown = axis.scatter(
        _leftwards(ra), dec, c=stars, s=np.clip(2000 / max(len(ra), 1), 4, 30), cmap="viridis", linewidths=0
    )
    figure.colorbar(shown, ax=axis, shrink=0.7, label="stars", pad=0.03)
    failed = {one.frame for one in evaluation.solved if not one.solved} if evaluation else set()
    lost = [place for place, one in enumerate(records) if one.frame in failed]
    if lost:
        axis.scatter(_leftwards(ra[lost]), dec[lost], s=60, marker="x", color=PALETTE[1], label="not solved")
        axis.legend(loc="lower right")
    axis.set_xticks(np.radians(np.arange(-120, 121, 60)), ["8h", "4h", "0h", "20h", "16h"])
    axis.tick_params(labelsize=7)
    return figure


def _leftwards(ra: Any) -> Any:
    """Abscissa of a map in which right ascension grows to the left, 0h in the middle."""
    return -((ra + np.pi) % (2 * np.pi) - np.pi)
