"""Figures of the turntable calibration: what the data can tell, and what limits it."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure
from experiments.turntable.bound import closed_form_px
from experiments.turntable.result import Case, Result

__all__ = ["correlation_matrix", "field_curves", "lean_curves", "pull_bars", "reading_curves", "short_name"]

_SHORT = {
    "x0_px": "$x_0$",
    "y0_px": "$y_0$",
    "focal_length_mm": "$f$",
    "q1_per_mm2": "$q_1$",
    "q2_per_mm4": "$q_2$",
    "q3_per_mm6": "$q_3$",
    "p1_per_mm": "$p_1$",
    "p2_per_mm": "$p_2$",
    "star_azimuth_rad": "star az",
    "star_elevation_rad": "star el",
    "theta1_rad": r"$\theta_1$",
    "theta2_rad": r"$\theta_2$",
    "theta3_rad": r"$\theta_3$",
    "lean1_rad": "lean 1",
    "lean2_rad": "lean 2",
}


def short_name(name: str) -> str:
    """A name as it stands beside an axis."""
    return _SHORT.get(name, name)


def correlation_matrix(case: Case) -> Figure:
    """Correlations of all unknowns, of the estimator's own covariance."""
    solution = case.reductions["estimated"].calibration.solution
    sigma = solution.sigma
    matrix = solution.covariance / np.outer(sigma, sigma)
    names = [short_name(name) for name in solution.names]
    figure, axis = new_figure(width="half", aspect_ratio=1.05)
    axis.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    for i, row in enumerate(matrix):
        for j, value in enumerate(row):
            if i != j and abs(value) >= 0.3:
                colour = "white" if abs(value) > 0.75 else INK
                text = f"{abs(value):.2f}".lstrip("0") if abs(value) < 0.995 else "1"
                axis.text(j, i, text, ha="center", va="center", fontsize=4.6, color=colour)
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize=6.5)
    axis.set_yticks(range(len(names)), names, fontsize=6.5)
    axis.grid(visible=False)
    axis.spines[:].set_visible(False)
    axis.tick_params(length=0)
    axis.set_title(f"{case.name} table")
    return figure


def field_curves(result: Result) -> Figure:
    """Error of the principal point against that of the line of sight, over the field of view."""
    figure, axis = new_figure(aspect_ratio=0.5)
    points = result.field_sweep
    field = np.array([p.field_deg for p in points])
    scale = np.array([p.arcsec_per_px for p in points])
    for key, label, colour, marker in (
        ("full", "principal point, two axes", PALETTE[1], "o"),
        ("rolled", "principal point, three axes", PALETTE[4], "s"),
        ("plain", "principal point, only $x_0, y_0, f, M$ unknown", PALETTE[3], "^"),
    ):
        sigma = np.array([getattr(p, key).of("x0_px") for p in points]) * scale
        axis.plot(field, sigma, marker=marker, color=colour, label=label)
    closed = np.array([closed_form_px(f, result.field_sigma_px) for f in field]) * scale
    axis.plot(field, closed, color=INK, linewidth=0.9, linestyle="--", label="its closed form")
    for key, label, colour in (
        ("full", "line of sight, two axes", PALETTE[0]),
        ("rolled", "line of sight, three axes", PALETTE[5]),
    ):
        judged = np.array([getattr(p, key).map_sigma_arcsec for p in points]) / np.sqrt(2.0)  # length to one axis
        axis.plot(field, judged, marker="o", color=colour, linewidth=2.0, label=label)
    axis.plot(field, result.field_sigma_px * scale, color="#9aa1a9", linestyle=":", label="a single image")
    axis.set(xscale="log", yscale="log", xlabel="full field of view [deg]", ylabel="1 σ per axis [arcsec]")
    axis.set_xticks(field, [f"{f:g}" for f in field])
    axis.minorticks_off()
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7.5)
    return figure


def reading_curves(result: Result) -> Figure:
    """Map error against the reading noise of the table."""
    from experiments.turntable.evaluate import crossover_arcsec

    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    points = [p for p in result.reading_sweep if p.reading_arcsec > 0]
    noise = np.array([p.reading_arcsec for p in points])
    axis.plot(noise, [p.bound_arcsec for p in points], color=INK, linewidth=1.0, label="Cramér-Rao bound")
    axis.errorbar(
        noise,
        [p.measured_arcsec for p in points],
        [3 * p.uncertainty_arcsec for p in points],
        fmt="o",
        color=PALETTE[0],
        label="measured, 3 σ",
    )
    half = crossover_arcsec(result)
    if np.isfinite(half):
        axis.axvline(half, color=PALETTE[1], linewidth=1.0, linestyle="--", label=f"as much as centroids: {half:.3f}″")
    _log_log(axis)
    axis.set(xlabel="noise of the mean reading [arcsec]", ylabel="map error, RMS length [arcsec]")
    axis.legend(loc="upper left")
    return figure


def lean_curves(result: Result) -> Figure:
    """Map error against the non-orthogonality of the axes."""
    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    points = result.lean_sweep
    lean = [p.lean_arcsec for p in points]
    for key, label, colour, marker in (
        ("ignored", "taken as square", PALETTE[1], "s"),
        ("estimated", "estimated", PALETTE[0], "o"),
    ):
        axis.errorbar(
            lean,
            [getattr(p, f"{key}_arcsec") for p in points],
            [3 * getattr(p, f"{key}_uncertainty_arcsec") for p in points],
            marker=marker,
            color=colour,
            label=label,
        )
    axis.set(xlabel="non-orthogonality [arcsec]", ylabel="map error, RMS length [arcsec]", ylim=(0, None))
    axis.legend(loc="upper left")
    return figure


def pull_bars(result: Result) -> Figure:
    """RMS of the pulls of every unknown over the Monte-Carlo, with the spread that chance allows."""
    figure, axis = new_figure(aspect_ratio=0.3)
    names = max((case.monte_carlo.names for case in result.cases), key=len)
    for k, case in enumerate(result.cases):
        found = case.monte_carlo
        if not found.runs:
            continue
        place = [names.index(name) + 0.18 * (2 * k - 1) for name in found.names]
        axis.errorbar(
            place,
            found.pull_std,
            np.full(len(place), 1 / np.sqrt(2 * found.runs)),
            fmt=MARKERS[k],
            color=PALETTE[k],
            label=f"{case.name} table, {found.runs} runs",
        )
    axis.axhspan(0.9, 1.1, color=PALETTE[0], alpha=0.1, linewidth=0)
    axis.axhline(1.0, color=INK, linewidth=0.8)
    axis.set_xticks(range(len(names)), [short_name(name) for name in names])
    axis.set(ylabel="RMS pull")
    axis.grid(visible=False, axis="x")
    axis.legend(ncols=2, loc="upper center", bbox_to_anchor=(0.5, 1.22))
    return figure


def _log_log(axis: Any) -> None:
    axis.set(xscale="log", yscale="log")
    axis.minorticks_off()
