"""Tables, figures and words of the reduction of frames from outside."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from experiments.harness.plotting import MARKERS, PALETTE, new_figure
from experiments.harness.report import Figure, KeyNumber, Report, Section, Text
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table, cell_text
from experiments.laboratory.frame_reduction import GridFrames, StepFrames, TemporalFrames
from experiments.laboratory.point_folder import FolderResult
from experiments.laboratory.point_settings import METHOD_NAMES
from experiments.laboratory.step_statistics import step_residual_px
from experiments.laboratory.temporal_error import small_sample_factor

__all__ = ["build_report", "folder_tables"]

_TITLES = {
    "temporal": "Temporal error of frames from outside",
    "hsfe": "High spatial frequency error of frames from outside",
    "distortion": "Distortion error of frames from outside",
}
_MAIN = {"temporal": "temporal_error", "hsfe": "hsfe", "distortion": "distortion"}


def _plain(one: Measured) -> Measured:
    return Measured(value=one.value, uncertainty=one.uncertainty)


def _temporal(result: FolderResult, reduced: TemporalFrames) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for level, series in enumerate(reduced.series):
        c4 = small_sample_factor(series.frames)
        for method in result.methods:
            found, predicted = reduced.te_arcsec(method, level), reduced.predicted_te_arcsec(method, level)
            for axis, letter in enumerate("xy"):
                ratio = found[axis].value / (c4 * predicted[axis])
                one, value = _plain(found[axis]), float(predicted[axis])
                rows.append((series.name, series.signal_e, METHOD_NAMES[method], letter, one, value, float(ratio)))
    return Table(
        columns=(
            "Series",
            Column(name="Signal", unit="e⁻", key="signal_e", format=".0f"),
            "Centroider",
            "Axis",
            Column(name="Measured", unit="″", key="measured_arcsec"),
            Column(name="Noise model", unit="″", key="noise_model_arcsec", format=".4f"),
            Column(name="Ratio", key="ratio", format=".3f"),
        ),
        rows=rows,
        caption="Temporal error (ACC18 eq. 1-2, 3 σ) of every series, and what the stated noise of the camera gives.",
        note="Measured values carry the small-sample factor of a standard deviation; it is taken out of *Ratio*.",
    )


def _steps(result: FolderResult, reduced: StepFrames) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for method in result.methods:
        found, halved = reduced.document_arcsec(method), reduced.halved_arcsec(method)
        for axis, letter in enumerate("xy"):
            rows.append((METHOD_NAMES[method], letter, _plain(found[axis]), float(halved[axis])))
    return Table(
        columns=(
            "Centroider",
            "Axis",
            Column(name="As printed", unit="″", key="hsfe_arcsec"),
            Column(name="One position", unit="″", key="single_arcsec", format=".4f"),
        ),
        rows=rows,
        caption=f"High spatial frequency error (ACC18 eq. 3-12, 3 σ) from {len(reduced.series)} positions.",
        note="*One position*: temporal noise taken away, divided by √2 as if neighbouring positions were independent.",
    )


def _positions(result: FolderResult, reduced: StepFrames) -> Table:
    shift = reduced.common_px(result.methods[0])
    rows: list[tuple[Cell, ...]] = []
    for one, seen, told in zip(reduced.series, shift, reduced.shift_px, strict=True):
        commanded = [float(v) if np.isfinite(v) else None for v in told]
        rows.append((one.name, one.frames, *(float(v) for v in seen), *commanded))
    return Table(
        columns=(
            "Position",
            "Frames",
            *(Column(name=f"Seen {a}", unit="px", key=f"seen_{a}_px", format=".4f") for a in "xy"),
            *(Column(name=f"Commanded {a}", unit="px", key=f"commanded_{a}_px", format=".4f") for a in "xy"),
        ),
        rows=rows,
        caption="Shift of the whole image since the first position, as measured and as commanded.",
    )


def _grid(result: FolderResult, reduced: GridFrames) -> Table:
    rows: list[tuple[Cell, ...]] = []
    scale = 3.0 * reduced.pixel_arcsec
    for method in result.methods:
        for reference in reduced.references:
            one = reduced.statistics(method, reference)
            for axis, letter in enumerate("xy"):
                sigmas = (one.sigma_d_px, one.sigma_left_px, one.sigma_c1_px)
                rows.append((METHOD_NAMES[method], reference, letter, *(float(scale * s[axis]) for s in sigmas)))
    return Table(
        columns=(
            "Centroider",
            "Reference",
            "Axis",
            Column(name="σ_d, found", unit="″", key="sigma_d_arcsec", format=".3f"),
            Column(name="σ_Δd, left", unit="″", key="sigma_left_arcsec", format=".3f"),
            Column(name="σ_C1, removed", unit="″", key="sigma_c1_arcsec", format=".3f"),
        ),
        rows=rows,
        caption=f"Distortion error (ACC18 eq. 17-30, 3 σ), polynomial of order {reduced.order}.",
        note="*nominal*: stated coordinates as they are; *aligned*: shift, roll and scale fitted; *calibrated*: a "
        "camera model from the earlier session.",
    )


def _points(result: FolderResult) -> Table:
    """Mean centroid and scatter of every point in the last series."""
    one, method = result.reduced.series[-1], result.methods[0]
    mean, sigma = one.points.mean_px(method), one.points.sigma_px(method)
    names = (("Mean", "mean"), ("σ", "sigma"))
    columns = [
        Column(name=f"{name} {a}", unit="px", key=f"{key}_{a}_px", format=".4f") for name, key in names for a in "xy"
    ]
    return Table(
        columns=("Point", *columns),
        rows=[(n + 1, *(float(v) for v in (*mean[n], *sigma[n]))) for n in range(len(mean))],
        caption=f"Centroids of {one.name}, {METHOD_NAMES[method]}; σ of a single frame.",
    )


def folder_tables(result: FolderResult) -> Mapping[str, Table]:
    """Tables by file name; the first is the one that is printed."""
    reduced = result.reduced
    if isinstance(reduced, TemporalFrames):
        return {"temporal_error": _temporal(result, reduced), "points": _points(result)}
    if isinstance(reduced, StepFrames):
        return {"hsfe": _steps(result, reduced), "positions": _positions(result, reduced), "points": _points(result)}
    return {"distortion": _grid(result, reduced), "points": _points(result)}


def _cloud(result: FolderResult) -> Drawing:
    """Centroids of all frames of all points about their means, last series."""
    position = result.reduced.series[-1].points.position_px[result.methods[0]]
    place = (position - np.nanmean(position, axis=0)) * result.reduced.pixel_arcsec
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    axis.plot(*place.reshape(-1, 2).T, ".", color=PALETTE[0], markersize=2, alpha=0.5)
    reach = 1.15 * float(np.nanmax(np.abs(place)))
    axis.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="x [″]", ylabel="y [″]", aspect="equal")
    return figure


def _step_plot(result: FolderResult, reduced: StepFrames) -> Drawing:
    """Residuals of the steps."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.42, sharey=True)
    residual = step_residual_px(reduced.mean_px(result.methods[0])) * reduced.pixel_arcsec
    number = np.arange(len(residual)) + 1
    for axis, letter in enumerate("xy"):
        axes[axis].plot(number, residual[:, :, axis], marker=".", color=PALETTE[0], linewidth=0.6, alpha=0.7)
        axes[axis].set(xlabel="step", title=letter)
        axes[axis].xaxis.get_major_locator().set_params(integer=True)
    axes[0].set_ylabel("residual [″]")
    return figure


def _grid_plot(result: FolderResult, reduced: GridFrames) -> Drawing:
    """Residuals before and after the polynomial as arrows over the detector."""
    statistics = reduced.statistics(result.methods[0], reduced.references[-1])
    figure, axes = new_figure(1, 2, aspect_ratio=0.5, sharey=True)
    for axis, values, title in ((axes[0], statistics.d_px, "found"), (axes[1], statistics.left_px, "left")):
        longest = float(np.linalg.norm(values, axis=1).max())
        axis.quiver(*reduced.nominal_px.T, *values.T, color=PALETTE[0], angles="xy")
        axis.set(xlabel="column [px]", title=f"{title}: longest {longest * reduced.pixel_arcsec:.2f}″", aspect="equal")
        axis.set_xlim(0, result.folder.width_px)
    axes[0].set_ylabel("row [px]")
    axes[0].set_ylim(result.folder.height_px, 0)
    return figure


def _level_plot(result: FolderResult, reduced: TemporalFrames) -> Drawing:
    """Scatter of every series beside the noise model; the centroiders stand side by side."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.42, sharey=True)
    number, spread = np.arange(len(reduced.series)) + 1.0, 0.6 / len(result.methods)
    c4 = [small_sample_factor(one.frames) for one in reduced.series]
    for axis, letter in enumerate("xy"):
        for place, method in enumerate(result.methods):
            colour, marker, at = PALETTE[place], MARKERS[place], number + spread * place - 0.3 + spread / 2
            seen = [reduced.te_arcsec(method, n)[axis] for n in range(len(number))]
            model = [c4[n] * reduced.predicted_te_arcsec(method, n)[axis] for n in range(len(number))]
            values, errors, label = [o.value for o in seen], [o.uncertainty for o in seen], METHOD_NAMES[method]
            axes[axis].errorbar(at, values, errors, fmt=marker, color=colour, markerfacecolor="white", label=label)
            axes[axis].hlines(model, at - 0.4 * spread, at + 0.4 * spread, color=colour, linewidth=0.9)
        axes[axis].set_xticks(number, [f"{one.signal_e:.0f}" for one in reduced.series])
        axes[axis].set(xlabel="signal of the series [e⁻]", title=letter, xlim=(0.5, len(number) + 0.5))
    axes[0].set_ylabel("temporal error, 3 σ [″]")
    axes[1].legend()
    return figure


def _figure(result: FolderResult) -> tuple[Drawing, str]:
    reduced, first = result.reduced, METHOD_NAMES[result.methods[0]]
    if isinstance(reduced, TemporalFrames):
        return _level_plot(result, reduced), "Points: measured; dashes: the noise model for as many frames."
    if isinstance(reduced, StepFrames):
        return _step_plot(result, reduced), f"Differences of consecutive positions without their mean, {first}."
    return _grid_plot(result, reduced), f"Residuals {first}, reference {reduced.references[-1]}: before and after."


def _values(result: FolderResult) -> tuple[str, Any]:
    """Label and (x, y) of the number that counts."""
    reduced, method = result.reduced, result.methods[0]
    if isinstance(reduced, TemporalFrames):
        return "Temporal error", reduced.te_arcsec(method, len(reduced.series) - 1)
    if isinstance(reduced, StepFrames):
        return "High spatial frequency error", reduced.document_arcsec(method)
    left = 3.0 * reduced.pixel_arcsec * reduced.statistics(method, reduced.references[-1]).sigma_left_px
    return "Left after the polynomial", tuple(Measured(value=float(v), unit="arcsec") for v in left)


def build_report(result: FolderResult) -> Report:
    """The report of a folder; call inside `plotting.house_style`."""
    every = folder_tables(result)
    label, pair = _values(result)
    folder, frames = result.folder, sum(one.frames for one in result.reduced.series)
    x, y = (cell_text(_plain(one)) if one.uncertainty else f"{one.value:.3f}" for one in pair)
    drawing, caption = _figure(result)
    removed = (
        f"The mean of {folder.dark_frames} frames with the lamp off was taken away."
        if folder.dark_frames
        else "There were no frames with the lamp off: the stated offset and one background value per window were taken "
        "away, fixed patterns stay."
    )
    words = (
        f"{removed} Gain, read noise, offset and the angle of a pixel are as the folder states them; every number in "
        "seconds of arc is proportional to that angle. There is no truth to compare with, and no PSF: fits of a PSF "
        "take no part."
    )
    main = every[_MAIN[result.test]]
    others = [table for name, table in every.items() if name != _MAIN[result.test]]
    return Report(
        title=_TITLES[result.test],
        lead=f"{frames} frames of {folder.width_px} x {folder.height_px} px in {len(result.reduced.series)} series, "
        f"{len(folder.series[0].found_px)} target points, centroided by {len(result.methods)} methods.",
        verdict=f"{label}: {x}″ in x and {y}″ in y (3 σ, {METHOD_NAMES[result.methods[0]]}).",
        key_numbers=[
            KeyNumber(label=f"{label}, {axis}", value=one.value, unit="″", format=".3f", note="3 σ")
            for axis, one in zip("xy", pair, strict=True)
        ],
        sections=(
            Section(title="Result", blocks=(main, Figure(drawing=drawing, caption=caption), Text(words))),
            Section(
                title="Frames and points",
                blocks=(
                    *others,
                    Figure(
                        drawing=_cloud(result),
                        caption="All frames of all points about each point's mean, last series.",
                        raster=True,
                    ),
                ),
            ),
        ),
    )
