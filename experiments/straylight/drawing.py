"""Pictures: lens and baffle with the worst paths, transmittance by cause, frames under the Sun."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, PALETTE, new_figure
from experiments.harness.quantities import Outcome
from optics.figures import draw_image, draw_lens
from render.baffle import drawing


def draw_baffle(outcome: Outcome) -> Figure:
    """Section through lens and baffle; lines from scattering surfaces to the entrance, thicker for more light."""
    sensor: Any = outcome.result["sensor"]
    lens, scene = sensor.camera.focused_lens, sensor.stray.scene
    figure = draw_lens(lens, fields_deg=[0.0, float(0.9 * sensor.half_field_deg)])
    panel, first_mm = figure.axes[0], float(lens.surfaces[0].position_mm[2])
    panel.set_title("")
    if scene is not None:
        parts = scene.baffle or scene.mesh
        length, radius = drawing.draw_baffle(panel, parts, first_mm=first_mm, entrance_mm=sensor.entrance_radius_mm)
        drawing.draw_paths(panel, sensor.worst, first_mm=first_mm)
        drawing.frame_section(panel, length, radius, first_mm=first_mm, sun_deg=sensor.worst_deg)
    return figure


def draw_causes(outcome: Outcome) -> Figure:
    """PST by cause, a panel per azimuth; right axis: electrons from the Sun."""
    sensor: Any = outcome.result["sensor"]
    pst, scale = sensor.stray.pst, sensor.sun_e_at_unit_pst
    count = len(pst.azimuth_deg)
    figure, axes = new_figure(1, count, aspect_ratio=0.5 if count == 1 else 0.45, squeeze=False, sharey=True)
    labels = {"ghosts": "ghosts", "polish": "polish", "dust": "dust", "walls": "walls, vanes", "edges": "vane edges"}
    top = float(pst.total.max())
    bottom = max(float(pst.total[pst.total > 0].min()) / 30.0, top * 1e-12)
    for z, panel in enumerate(axes[0]):
        for row, (cause, colour) in enumerate(zip(pst.causes, PALETTE * 3, strict=False)):
            value, error = pst.value[row, z], pst.error[row, z]
            positive = value > 0.0
            if positive.any():
                panel.plot(pst.angle_deg[positive], value[positive], color=colour, label=labels.get(cause, cause))
                low, high = np.maximum(value - error, bottom * 1e-3)[positive], (value + error)[positive]
                panel.fill_between(pst.angle_deg[positive], low, high, color=colour, alpha=0.2, linewidth=0)
        panel.plot(pst.angle_deg, np.maximum(pst.total[z], bottom * 1e-3), color=INK, linewidth=1.6, label="total")
        if np.isfinite(sensor.shade_deg):
            panel.axvline(sensor.shade_deg, color="0.6", linewidth=0.8, dashes=(4, 3))
        panel.set(xscale="log", yscale="log", xlabel="Angle of the source [°]", ylim=(bottom, 3.0 * top))
        panel.set_title(f"azimuth {pst.azimuth_deg[z]:g}°", fontsize=9)
        if z == count - 1:
            electrons = panel.secondary_yaxis("right", functions=(lambda v: v * scale, lambda v: v / scale))
            electrons.set_ylabel("Sun [e⁻ per pixel]")
    axes[0][0].set_ylabel("PST")
    axes[0][0].legend(fontsize=7.5, loc="lower left")
    return figure


def draw_frames(outcome: Outcome) -> Figure:
    """The first attitude at the largest Sun angle, at the exclusion angle, and at the smallest."""
    rows = outcome.result["frames"]
    exclusion_deg = outcome.result["exclusion"].sun_exclusion_deg
    nearest = min(range(len(rows)), key=lambda k: abs(rows[k].sun_deg - exclusion_deg))
    chosen = sorted({0, nearest, len(rows) - 1}, reverse=True)
    figure, axes = new_figure(1, len(chosen), aspect_ratio=0.36, squeeze=False)
    for panel, k in zip(axes[0], chosen, strict=True):
        draw_image(rows[k].frames.example_e, panel)
        panel.set_title(f"Sun at {rows[k].sun_deg:.1f}°, {_light(rows[k].stray_light_e)} e⁻", fontsize=8.5)
        panel.set(xticks=[], yticks=[], xlabel="", ylabel="")
        panel.grid(False)
    return figure


def _light(electrons: float) -> str:
    """Three digits below 1000, above rounded to hundreds with spaced thousands."""
    return f"{electrons:.3g}" if electrons < 1000.0 else f"{round(electrons, -2):,.0f}".replace(",", "\u2009")
