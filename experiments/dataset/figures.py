"""Figures of the report on a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from experiments.dataset.statistics import centroid_bins, completeness, solver
from experiments.harness.plotting import INK, PALETTE, new_figure
from optics.figures import draw_image

if TYPE_CHECKING:
    from experiments.dataset.evaluate import Evaluation
    from experiments.dataset.result import Result

__all__ = ["attitude_errors", "centroid_curve", "completeness_curves", "example_frame", "sky_coverage"]

MAGNITUDE_STEP = 0.25


def example_frame(evaluation: Evaluation) -> Figure:
    """The first frame: detections circled by what they are."""
    example = evaluation.example
    assert example is not None
    height, width = example.electrons.shape
    figure, axis = new_figure(aspect_ratio=min(0.75, 0.08 + 0.92 * height / width))
    draw_image(example.electrons, axis)
    place, fit = example.measured.detected_px, example.measured.fit
    axis.scatter(*place[fit].T, s=26, facecolors="none", edgecolors=PALETTE[5], linewidths=0.8)
    axis.scatter(*place[~fit].T, s=26, marker="s", facecolors="none", edgecolors=PALETTE[4], linewidths=0.8)
    return figure


def attitude_errors(evaluation: Evaluation) -> Figure:
    """Boresight errors of the solved frames, and how they compare with their predicted sigma."""
    good = [one for one in evaluation.solved if one.solved]
    error = np.array([one.error_arcsec for one in good]).reshape(-1, 3)
    pull = error / np.array([one.sigma_arcsec for one in good]).reshape(-1, 3)
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.42, width_ratios=(1.0, 1.25))
    found = solver(evaluation.solved)
    left.scatter(error[:, 0], error[:, 1], s=9, color=PALETTE[0], alpha=0.75, linewidths=0)
    for radius, style, text in ((found.median_arcsec, "-", "50 %"), (found.p95_arcsec, "--", "95 %")):
        left.add_patch(Circle((0, 0), radius, fill=False, linestyle=style, color=INK, linewidth=0.9))
        left.annotate(text, (0, radius), fontsize=7, ha="center", va="bottom", color=INK)
    reach = 1.15 * max(found.largest_arcsec, 1e-6)
    left.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="about x [″]", ylabel="about y [″]")
    left.set_title("boresight error")
    bins = np.linspace(-4, 4, 25)
    for axis, name in enumerate(("x", "y", "roll")):
        right.hist(pull[:, axis], bins, histtype="step", color=PALETTE[axis], linewidth=1.3, label=name, density=True)
    grid = np.linspace(-4, 4, 200)
    right.plot(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), color=INK, linewidth=0.9, label="normal")
    right.set(xlabel="error over predicted sigma", xlim=(-4, 4))
    right.set_title("pulls")
    right.legend()
    return figure


def completeness_curves(evaluation: Evaluation) -> Figure:
    """Share of stars found against magnitude and against signal-to-noise ratio."""
    stars = evaluation.stars
    figure, axes = new_figure(1, 2, aspect_ratio=0.38, sharey=True)
    low, high = stars.magnitude.min(), stars.magnitude.max()
    steps = np.arange(np.floor(low), high + MAGNITUDE_STEP, MAGNITUDE_STEP)
    snr = np.geomspace(max(0.5, stars.snr[stars.snr > 0].min()), stars.snr.max() * 1.001, 24)
    for axis, value, edges, label in (
        (axes[0], stars.magnitude, steps, "magnitude"),
        (axes[1], stars.snr, snr, "signal-to-noise ratio"),
    ):
        one = completeness(stars, value, edges)
        seen = one.stars > 0
        middle = one.middle if label == "magnitude" else np.sqrt(one.edges[1:] * one.edges[:-1])
        bars = np.abs(np.stack([one.share - one.low, one.high - one.share])[:, seen])
        axis.errorbar(middle[seen], one.share[seen], bars, fmt="o", color=PALETTE[0], markersize=3.5)
        axis.set(xlabel=label, ylim=(-0.03, 1.03))
    axes[0].set(ylabel="share found")
    axes[1].set_xscale("log")
    return figure


def centroid_curve(evaluation: Evaluation) -> Figure:
    """Centroid error against signal-to-noise ratio, beside the Cramer-Rao bound of the same stars."""
    stars, bins = evaluation.stars, centroid_bins(evaluation)
    figure, axis = new_figure(aspect_ratio=0.5)
    disturbed = stars.found & ~stars.clean & np.isfinite(stars.error_px).all(axis=1) & (stars.snr > 0)
    good = stars.clean & stars.fit & np.isfinite(stars.error_px).all(axis=1) & (stars.snr > 0)
    for mine, colour, label in (
        (good, PALETTE[5], "undisturbed stars"),
        (disturbed, PALETTE[3], "flagged in the truth"),
    ):
        off = np.maximum(np.hypot(*stars.error_px[mine].T) / np.sqrt(2.0), 1e-4)
        axis.scatter(stars.snr[mine], off, s=3, color=colour, alpha=0.35, linewidths=0, label=label, rasterized=True)
    axis.errorbar(
        bins.snr, bins.error_px, bins.error_sigma_px, fmt="o", color=PALETTE[0], label="standard deviation per axis"
    )
    axis.plot(bins.snr, bins.bound_px, color=INK, label="Cramér-Rao bound of the same stars")
    axis.set(xscale="log", yscale="log", xlabel="signal-to-noise ratio", ylabel="centroid error [px]")
    axis.set_ylim(bottom=max(1e-3, 0.3 * float(bins.bound_px.min())) if len(bins.snr) else 1e-3)
    legend = axis.legend()
    for handle in legend.legend_handles:
        if hasattr(handle, "set_sizes"):
            handle.set_sizes([14])
            handle.set_alpha(0.9)
    return figure


def sky_coverage(result: Result) -> Figure:
    """Where the frames look; icrs, east to the left."""
    figure, axis = new_figure(aspect_ratio=0.52, subplot_kw={"projection": "mollweide"})
    ra = np.radians([one.ra_deg for one in result.facts])
    dec = np.radians([one.dec_deg for one in result.facts])
    stars = np.array([one.stars for one in result.facts], float)
    shown = axis.scatter(
        _leftwards(ra), dec, c=stars, s=np.clip(2000 / max(len(ra), 1), 4, 30), cmap="viridis", linewidths=0
    )
    figure.colorbar(shown, ax=axis, shrink=0.7, label="stars", pad=0.03)
    failed = {one.frame for one in result.evaluation.solved if not one.solved} if result.evaluation else set()
    lost = [place for place, one in enumerate(result.facts) if one.frame in failed]
    if lost:
        axis.scatter(_leftwards(ra[lost]), dec[lost], s=60, marker="x", color=PALETTE[1], label="not solved")
        axis.legend(loc="lower right")
    axis.set_xticks(np.radians(np.arange(-120, 121, 60)), ["8h", "4h", "0h", "20h", "16h"])
    axis.tick_params(labelsize=7)
    return figure


def _leftwards(ra: Any) -> Any:
    """Abscissa of a map in which right ascension grows to the left, 0h in the middle."""
    return -((ra + np.pi) % (2 * np.pi) - np.pi)
