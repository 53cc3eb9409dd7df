"""Figures of the page of a lens."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.tri import Triangulation

from experiments.harness.plotting import INK, PALETTE, band_colours, new_figure
from experiments.harness.quantities import Outcome
from optics.figures import draw_lens
from optics.lens_study import SHOWN, airy_radius_mm
from optics.rays.best_focus import white_focus
from optics.waves.wavefront import Wavefront

LONG_SIDE = 0.2
"""Side of a triangle between rays of a pupil, in its radii, that spans an obscuration."""


def drawing(outcome: Outcome) -> Figure:
    """Section through the lens with fans of rays."""
    figure = draw_lens(outcome.result.file.lens)
    figure.axes[0].set_title("")
    width, height = figure.get_size_inches()
    figure.set_size_inches(7.6, 7.6 * height / width)
    return figure


def spots(outcome: Outcome) -> Figure:
    """Spots of all wavelengths about their common mean, at one scale, with the Airy circle."""
    study = outcome.result
    airy = 1e3 * airy_radius_mm(study)
    figure, axes = new_figure(1, 3, aspect_ratio=0.4, sharex=True, sharey=True)
    colours, reach = band_colours(study.wavelength_nm.tolist()), 0.0
    for panel, at in zip(axes, SHOWN, strict=True):
        area = study.spots.area_mm2[at]
        total = max(float(area.sum()), 1e-300)
        for band, (wave, colour) in enumerate(zip(study.wavelength_nm, colours, strict=True)):
            lit = area[band] > 0.0
            rays = study.spots.rays
            x, y = (
                1e3 * (v[at, band][lit] - float((np.where(area > 0, v[at], 0.0) * area).sum() / total))
                for v in (rays.x, rays.y)
            )
            reach = max(reach, float(np.abs([*x, *y, 0.0]).max()))
            panel.plot(x, y, ".", color=colour, markersize=1.6, label=f"{wave:.0f} nm")
        panel.set(title=f"{study.field_deg[at]:.3g}°", xlabel="along the field [µm]", aspect="equal")
        if np.isfinite(airy):
            panel.add_patch(Circle((0.0, 0.0), airy, fill=False, color=INK, linewidth=1.0, label="Airy", zorder=5))
            reach = max(reach, airy)
    for panel in axes:
        panel.set(xlim=(-1.1 * reach, 1.1 * reach), ylim=(-1.1 * reach, 1.1 * reach))
    axes[0].set_ylabel("across [µm]")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, markerscale=5)
    return figure


def distortion(outcome: Outcome) -> Figure:
    """Chief-ray distortion over the field."""
    study = outcome.result
    figure, axes = new_figure(width="half", aspect_ratio=0.8)
    axes.plot(100.0 * study.performance.distortion, study.field_deg, "o-", color=PALETTE[0])
    axes.axvline(0.0, color=INK, linewidth=0.6)
    axes.set(xlabel="distortion [%]", ylabel="field [°]")
    return figure


def lateral(outcome: Outcome) -> Figure:
    """Chief rays of the wavelengths against that of the design wavelength."""
    study = outcome.result
    reference = int(np.argmin(np.abs(study.wavelength_nm - study.file.lens.design_wavelength_nm)))
    figure, axes = new_figure(width="half", aspect_ratio=0.8)
    for band, colour in enumerate(band_colours(study.wavelength_nm.tolist())):
        shift = 1e3 * (study.chief_mm[:, band] - study.chief_mm[:, reference])
        axes.plot(shift, study.field_deg, "o-", color=colour, label=f"{study.wavelength_nm[band]:.0f} nm")
    axes.set(xlabel="chief-ray shift [µm]", ylabel="field [°]")
    axes.legend(frameon=False)
    return figure


def curvature(outcome: Outcome) -> Figure:
    """Best focus along and across the field, of all wavelengths together."""
    study = outcome.result
    figure, axes = new_figure(width="half", aspect_ratio=0.8)
    for column, (name, style) in enumerate((("along the field (tangential)", "o-"), ("across (sagittal)", "s--"))):
        axes.plot(1e3 * study.focus[:, column], study.field_deg, style, color=PALETTE[column], label=name)
    axes.axvline(0.0, color=INK, linewidth=0.6)
    axes.set(xlabel="best focus from the image plane [µm]", ylabel="field [°]")
    axes.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def wavefronts(outcome: Outcome) -> Figure:
    """Wavefront errors over the pupil, each at its own scale."""
    study = outcome.result
    figure, axes = new_figure(1, 3, aspect_ratio=0.36)
    for panel, at, error in zip(axes, SHOWN, study.waves.wavefront, strict=True):
        waves = error.error_nm / error.wavelength_nm
        reach = max(float(np.abs(waves).max()), 1e-6)
        filled = panel.tripcolor(_lit(error), waves, shading="gouraud", cmap="RdBu_r", vmin=-reach, vmax=reach,
                                 rasterized=True)  # fmt: skip
        figure.colorbar(filled, ax=panel, shrink=0.8, format="%.2g")
        panel.set(title=f"{study.field_deg[at]:.3g}°", aspect="equal", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))
        panel.set(xlabel="pupil, along the field")
    axes[0].set_ylabel("pupil, across")
    return figure


def _lit(error: Wavefront) -> Triangulation:
    """Triangles between rays that arrive, none across an obscuration."""
    triangles = Triangulation(error.x, error.y)
    x, y = error.x[triangles.triangles], error.y[triangles.triangles]
    side = np.hypot(x - np.roll(x, 1, 1), y - np.roll(y, 1, 1)).max(1)
    triangles.set_mask(side > LONG_SIDE)
    return triangles


def images(outcome: Outcome) -> Figure:
    """Images of a star by diffraction, logarithmic, all at one scale."""
    study = outcome.result
    shot = study.waves.images
    figure, axes = new_figure(1, 3, aspect_ratio=0.36, sharex=True, sharey=True)
    half = 1e3 * study.waves.half_mm
    shown: Any = None
    for panel, at, image in zip(axes, SHOWN, shot.intensity, strict=True):
        decibel = np.log10(np.maximum(image / shot.intensity.max(), 1e-12))
        shown = panel.imshow(decibel, extent=(-half, half, -half, half), origin="lower", vmin=-4.0, vmax=0.0,
                             interpolation="nearest")  # fmt: skip
        panel.set(title=f"{study.field_deg[at]:.3g}°", xlabel="along the field [µm]")
        panel.grid(visible=False)
    axes[0].set_ylabel("across [µm]")
    figure.colorbar(shown, ax=axes, shrink=0.8, label="log₁₀ of the brightest")
    return figure


def encircled(outcome: Outcome) -> Figure:
    """Share of the light within circles: by diffraction at the design wavelength, by rays of all wavelengths."""
    study = outcome.result
    shot = study.waves.images
    figure, axes = new_figure(width="half", aspect_ratio=0.8)
    weight = study.weight / study.weight.sum()
    for row, at in enumerate(SHOWN):
        light = study.spots.area_mm2[at] * weight[:, None]
        x, y = (np.where(light > 0, v[at], 0.0) for v in (study.spots.rays.x, study.spots.rays.y))
        radius = np.hypot(x - (light * x).sum() / light.sum(), y - (light * y).sum() / light.sum())
        within = [float(light[radius <= r].sum() / light.sum()) for r in study.waves.radius_mm]
        axes.plot(1e3 * study.waves.radius_mm, within, "--", color=PALETTE[row], linewidth=0.9)
        if shot is not None:
            axes.plot(1e3 * study.waves.radius_mm, shot.encircled[row], "-", color=PALETTE[row])
        axes.plot([], [], color=PALETTE[row], label=f"{study.field_deg[at]:.3g}°")
    axes.set(xlabel="radius [µm]", ylabel="encircled light", ylim=(0.0, 1.02), xlim=(0.0, None))
    axes.legend(frameon=False)
    return figure


def through_focus(outcome: Outcome) -> Figure:
    """RMS spot of all wavelengths through focus; above it the Strehl ratio where there is one."""
    study = outcome.result
    shot = study.waves.images
    figure, panels = new_figure(1 if shot is None else 2, 1, width="half", aspect_ratio=1.0, sharex=True, squeeze=False)
    curve = white_focus(study.spots, study.weight / study.weight.sum())
    shift = np.linspace(study.waves.focus_mm[0], study.waves.focus_mm[-1], 101)
    spot = 1e3 * curve.rms_mm(shift[:, None])
    upper, lower = panels[0, 0], panels[-1, 0]
    for row, at in enumerate(SHOWN):
        lower.plot(1e3 * shift, spot[:, at], color=PALETTE[row], label=f"{study.field_deg[at]:.3g}°")
        if shot is not None:
            upper.plot(1e3 * study.waves.focus_mm, shot.strehl_through_focus[row], "o-", markersize=2.5,
                       color=PALETTE[row])  # fmt: skip
    if shot is not None:
        upper.set(ylabel="Strehl ratio", ylim=(0.0, None))
    lower.set(xlabel="shift of the image plane [µm]", ylabel="RMS spot [µm]", ylim=(0.0, None))
    lower.legend(frameon=False)
    return figure


def mtf(outcome: Outcome) -> Figure:
    """Modulation over spatial frequency."""
    study = outcome.result
    figure, axes = new_figure(1, 3, aspect_ratio=0.38, sharey=True)
    for row, (panel, at) in enumerate(zip(axes, SHOWN, strict=True)):
        for axis, name in enumerate(("along", "across")):
            panel.plot(study.mtf.frequency, study.mtf.geometric[row, axis], "--", color=PALETTE[axis], linewidth=0.9,
                       label=f"{name}, rays")  # fmt: skip
            if study.mtf.diffraction is not None:
                panel.plot(study.mtf.frequency, study.mtf.diffraction[row, axis], "-", color=PALETTE[axis],
                           label=f"{name}, waves")  # fmt: skip
            if study.mtf.limit is not None:
                panel.plot(study.mtf.frequency, study.mtf.limit[row, axis], ":", color=INK, linewidth=0.9,
                           label="" if axis else "limit")  # fmt: skip
        panel.set(title=f"{study.field_deg[at]:.3g}°", xlabel="frequency [1/mm]", ylim=(0.0, 1.02))
    axes[0].set_ylabel("modulation")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure
