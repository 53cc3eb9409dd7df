"""Figures of the cube-mirror experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from calib.measure.circle_fit import CircleFit
from experiments.cube.trim import Picture
from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure
from experiments.harness.quantities import Outcome
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from experiments.cube.result import Result

__all__ = ["budget_bars", "error_dots", "pictures", "spot_edge", "sun_sensor", "trim_paths", "view"]


BEAM = np.array([1.0, 0.58, 0.08])
PAPER = np.array([1.0, 0.99, 0.965])


def view(outcome: Outcome, number: int) -> Figure:
    """A view of the bench: bodies in grey under room light, the traced beam in orange."""
    result: Result = outcome.result
    from scipy.ndimage import gaussian_filter

    bodies, beam = result.views[number]
    grey = np.clip(bodies / np.percentile(bodies, 99.5), 0, 1) ** 0.45
    glow = gaussian_filter(beam, 0.7)
    lit = glow[glow > 0.02 * glow.max()]
    shown = np.clip(glow / np.percentile(lit, 70), 0, 1) ** 0.7
    picture = grey[..., None] * PAPER * (1 - shown[..., None]) + shown[..., None] * BEAM
    height, width = bodies.shape
    figure, axis = new_figure(aspect_ratio=height / width)
    axis.imshow(np.clip(picture, 0, 1), interpolation="lanczos")
    axis.set_axis_off()
    return figure


def _outline(axis: Any, picture: Picture, circle: CircleFit, **style: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    points = circle.centre + circle.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    axis.plot(*picture.camera.to_pixel(points).T, **style)
    axis.plot(*picture.camera.to_pixel(circle.centre[None]).T, "+", markersize=7, **style)


def pictures(outcome: Outcome, face: int) -> Figure:
    """Aperture, first and last spot of a face with the fitted circles."""
    result: Result = outcome.result
    trim = result.shown.trims[face]
    figure, axes = new_figure(1, 3, aspect_ratio=0.42, sharex=True, sharey=True)
    glowing, first, last = trim.pictures
    titles = ("aperture, glowing", f"spot, trim 1 of {len(trim.rows)}", f"spot, trim {len(trim.rows)}")
    for axis, picture, title in zip(axes, (glowing, first, last), titles, strict=True):
        light = picture.electrons / 1e3
        axis.imshow(light, vmin=0, vmax=np.percentile(light, 99.8))
        axis.set_title(title)
        axis.grid(visible=False)
        _outline(axis, picture, trim.offset.aperture, color="white", linewidth=0.7)
    _outline(axes[2], last, trim.offset.spot, color="#ff9d3c", linewidth=0.9)
    low, high = _window(glowing, result)
    axes[0].set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), ylabel="row [px]")
    for axis in axes:
        axis.set(xlabel="column [px]")
    return figure


def _window(picture: Picture, result: Result) -> tuple[FloatArray, FloatArray]:
    reach = 1.25 * np.max([t.offset.spot.radius for t in result.shown.trims]) + 0.35
    corners = picture.camera.to_pixel(np.array([[-reach, -reach], [reach, reach], [-reach, reach], [reach, -reach]]))
    size = np.array([picture.camera.width_px, picture.camera.height_px]) - 0.5
    return np.maximum(corners.min(0), -0.5), np.minimum(corners.max(0), size)


def spot_edge(outcome: Outcome) -> Figure:
    """Profile of the spot, and how far it moves, both beside the closed forms."""
    result: Result = outcome.result
    light, geometry = result.light, result.laboratory.geometry
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.36)
    left.plot(light.radius_mm, light.closed_profile, color=PALETTE[0], label="two circles overlapping")
    left.plot(light.radius_mm, light.profile, ".", color=PALETTE[1], markersize=3.5, label="particles counted")
    left.axvline(geometry.aperture_mm / 2, color="#8a9099", linewidth=0.8, linestyle=":")
    left.text(geometry.aperture_mm / 2, 0.06, "edge of the aperture ", ha="right", fontsize=8)
    left.set(xlabel="distance from the middle of the spot [mm]", ylabel="irradiance / that of the beam")
    left.legend(loc="upper right")
    difference = (light.displacement_mm - light.law_mm) * 1e3
    right.axhline(0, color=INK, linewidth=0.8)
    right.plot(light.tilt_arcsec, difference, "o", color=PALETTE[1])
    reach = max(0.05, 1.4 * float(np.abs(difference).max()))
    right.set(xlabel="tilt of the face [arcsec]", ylabel="rendered − 2 × tilt × distance [µm]", ylim=(-reach, reach))
    return figure


def trim_paths(outcome: Outcome) -> Figure:
    """Offsets of the spot, trim after trim, and the square in which the trimming stops."""
    result: Result = outcome.result
    trims = result.shown.trims
    figure, axes = new_figure(1, 2, aspect_ratio=0.5, squeeze=False)
    stop = result.config.trim.stop_px
    for panel, (axis, reach) in enumerate(zip(axes[0], (None, 3.0 * stop), strict=True)):
        axis.add_patch(Rectangle((-stop, -stop), 2 * stop, 2 * stop, facecolor="#dfe9f2", edgecolor="none", zorder=0))
        for number, trim in enumerate(trims):
            way = np.array([row.offset_px for row in trim.rows])
            style = {"color": PALETTE[number], "marker": MARKERS[number], "linewidth": 1.0, "markersize": 4.5}
            axis.plot(*way.T, label=f"face {trim.face}", **style)
            if panel == 1:
                sigma = np.array([row.sigma_px for row in trim.rows])
                axis.errorbar(*way.T, xerr=sigma[:, 0], yerr=sigma[:, 1], fmt="none", ecolor=PALETTE[number])
        axis.axhline(0, color="#8a9099", linewidth=0.6)
        axis.axvline(0, color="#8a9099", linewidth=0.6)
        axis.set(xlabel="offset x [px]", ylabel="offset y [px]", aspect="equal", adjustable="datalim")
        if reach:
            axis.set(xlim=(-reach, reach), ylim=(-reach, reach), adjustable="box")
    axes[0, 0].set_title("all trims")
    axes[0, 1].set_title("the end of it; shaded: where trimming stops")
    axes[0, 0].legend(loc="best")
    return figure


def sun_sensor(outcome: Outcome) -> Figure:
    """A spot of the sun sensor, and what the fit leaves of all spots."""
    result: Result = outcome.result
    run, sensor = result.shown_run, result.shown.sensor
    figure, (left, right) = new_figure(1, 2, aspect_ratio=0.46, width_ratios=(1, 1.25))
    shown = left.imshow(run.stamp / 1e3)
    left.grid(visible=False)
    left.set(xlabel="column [px]", ylabel="row [px]", title="spot with the Sun ahead [1000 e⁻]")
    figure.colorbar(shown, ax=left, shrink=0.8)
    residual = residuals_px(result)
    scale = 40 / max(float(np.abs(residual).max()), 1e-9)
    right.quiver(
        *run.pixel_px.T, *residual.T, angles="xy", scale_units="xy", scale=1 / scale, color=PALETTE[0], width=0.004
    )
    truth = result.truths[0].sensor
    right.set(xlim=(-20, truth.width_px + 20), ylim=(truth.height_px + 20, -20), aspect="equal", xlabel="column [px]")
    right.set(title=f"residuals × {scale:.0f}; {sensor.sigma_px:.4f} px per axis")
    return figure


def residuals_px(result: Result) -> FloatArray:
    """Spots minus the fitted sensor, for the true angles of the table (n, 2)."""
    from dataclasses import replace

    run, sensor, truth = result.shown_run, result.shown.sensor, result.truths[0]
    from experiments.cube.bench import Case, build_table

    table = build_table(result.config, truth, Case(name="", label="")).nominal
    sun = (sensor.rotation * table.rotation(run.angle_rad).inv()).apply([0.0, 0.0, 1.0])
    fitted = replace(truth.sensor, gap_mm=sensor.focal_length_mm, offset_px=sensor.offset_px)
    return np.asarray(run.pixel_px - fitted.spot_px(sun))


def budget_bars(outcome: Outcome) -> Figure:
    """Predicted (bars) and measured (marks) error of each axis, case by case."""
    figure, axis = new_figure(aspect_ratio=0.46)
    count = outcome.data.sizes["row"]
    for i, letter in enumerate("xyz"):
        place = np.arange(count) + (i - 1) * 0.26
        predicted, measured = outcome.values("predicted", axis=letter), outcome.values("measured", axis=letter)
        sigma = outcome.errors("measured", axis=letter)
        axis.bar(place, predicted, width=0.22, color=PALETTE[i], alpha=0.3, label=f"{letter} predicted")
        axis.errorbar(place, measured, yerr=sigma, fmt=MARKERS[i], color=PALETTE[i], label=f"{letter} measured")
    for at, published in enumerate(outcome.values("published_arcsec")):
        axis.plot([at - 0.42, at + 0.42], [published] * 2, color=INK, linewidth=1.0, linestyle="--")
    axis.plot([], [], color=INK, linewidth=1.0, linestyle="--", label="CUBE09")
    axis.axhline(4.0, color="#8a9099", linewidth=0.8)
    axis.text(count - 0.5, 4.04, "claim: 4″", ha="right", fontsize=8)
    axis.set(xticks=range(count), ylabel="error of R_sp, 1 sigma [arcsec]", ylim=(0, 4.6))
    axis.set_xticklabels([_wrapped(label) for label in outcome.values("meaning")], fontsize=7.5)
    axis.grid(visible=False, axis="x")
    axis.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.16), columnspacing=1.2)
    return figure


def _wrapped(text: str, width: int = 14) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, width))


def error_dots(outcome: Outcome) -> Figure:
    """Errors of R_sp bench by bench: as performed, and the same pictures reduced better."""
    result: Result = outcome.result
    figure, axes = new_figure(1, 3, aspect_ratio=0.36)
    pairs = ((0, 1), (0, 2), (1, 2))
    reach = 1.1 * float(np.abs(result.cases["procedure"].error_arcsec).max())
    for axis, (i, j) in zip(axes, pairs, strict=True):
        for number, name in enumerate(("procedure", "improved")):
            case = result.cases[name]
            axis.plot(
                *case.error_arcsec[:, (i, j)].T,
                MARKERS[number],
                color=PALETTE[number],
                markersize=3,
                alpha=0.75,
                label="as performed" if name == "procedure" else "reduced better",
            )
        angle = np.linspace(0, 2 * np.pi, 181)
        axis.plot(4 * np.cos(angle), 4 * np.sin(angle), color="#8a9099", linewidth=0.8)
        axis.set(xlabel=f"about {'xyz'[i]} [arcsec]", ylabel=f"about {'xyz'[j]} [arcsec]", aspect="equal")
        axis.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes[0].legend(loc="upper left", fontsize=7)
    return figure
