"""Figures of the page of a lens."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, PALETTE, band_colours, new_figure
from experiments.harness.quantities import Outcome
from experiments.lens.study import SHOWN, Study
from optics.figures import draw_lens

__all__ = ["curvature", "distortion", "drawing", "lateral", "mtf", "spots"]


def _made(outcome: Outcome) -> Study:
    made: Study = outcome.result
    return made


def drawing(outcome: Outcome) -> Figure:
    """Section through the lens with fans of rays."""
    figure = draw_lens(_made(outcome).file.lens)
    figure.axes[0].set_title("")
    width, height = figure.get_size_inches()
    figure.set_size_inches(7.6, 7.6 * height / width)
    return figure


def spots(outcome: Outcome) -> Figure:
    """Spots of all wavelengths about their common mean, at one scale."""
    made = _made(outcome)
    assert made.spots is not None
    figure, axes = new_figure(1, 3, aspect_ratio=0.4, sharex=True, sharey=True)
    colours, reach = band_colours(made.wavelength_nm.tolist()), 0.0
    for panel, at in zip(axes, SHOWN, strict=True):
        area = made.spots.area_mm2[at]
        total = max(float(area.sum()), 1e-300)
        for band, (wave, colour) in enumerate(zip(made.wavelength_nm, colours, strict=True)):
            lit = area[band] > 0.0
            rays = made.spots.rays
            x, y = (
                1e3 * (v[at, band][lit] - float((np.where(area > 0, v[at], 0.0) * area).sum() / total))
                for v in (rays.x, rays.y)
            )
            reach = max(reach, float(np.abs([*x, *y, 0.0]).max()))
            panel.plot(x, y, ".", color=colour, markersize=1.6, label=f"{wave:.0f} nm")
        panel.set(title=f"{made.field_deg[at]:.3g}°", xlabel="along the field [µm]", aspect="equal")
    for panel in axes:
        panel.set(xlim=(-1.1 * reach, 1.1 * reach), ylim=(-1.1 * reach, 1.1 * reach))
    axes[0].set_ylabel("across [µm]")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, markerscale=5)
    return figure


def distortion(outcome: Outcome) -> Figure:
    """Chief-ray distortion over the field."""
    made = _made(outcome)
    assert made.performance is not None
    figure, axes = new_figure(width="half", aspect_ratio=0.8)
    axes.plot(100.0 * made.performance.distortion, made.field_deg, "o-", color=PALETTE[0])
    axes.axvline(0.0, color=INK, linewidth=0.6)
    axes.set(xlabel="distortion [%]", ylabel="field [°]")
    return figure


def lateral(outcome: Outcome) -> Figure:
    """Chief rays of the wavelengths against that of the design wavelength."""
    made = _made(outcome)
    assert made.chief_mm is not None
    reference = int(np.argmin(np.abs(made.wavelength_nm - made.file.lens.design_wavelength_nm)))
    figure, axes = new_figure(width="half", aspect_ratio=0.8)
    for band, colour in enumerate(band_colours(made.wavelength_nm.tolist())):
        shift = 1e3 * (made.chief_mm[:, band] - made.chief_mm[:, reference])
        axes.plot(shift, made.field_deg, "o-", color=colour, label=f"{made.wavelength_nm[band]:.0f} nm")
    axes.set(xlabel="chief-ray shift [µm]", ylabel="field [°]")
    axes.legend(frameon=False)
    return figure


def curvature(outcome: Outcome) -> Figure:
    """Best focus along and across the field, of all wavelengths together."""
    made = _made(outcome)
    assert made.focus is not None
    figure, axes = new_figure(width="half", aspect_ratio=0.8)
    for column, (name, style) in enumerate((("along the field (tangential)", "o-"), ("across (sagittal)", "s--"))):
        axes.plot(1e3 * made.focus[:, column], made.field_deg, style, color=PALETTE[column], label=name)
    axes.axvline(0.0, color=INK, linewidth=0.6)
    axes.set(xlabel="best focus from the image plane [µm]", ylabel="field [°]")
    axes.legend(frameon=False)
    return figure


def mtf(outcome: Outcome) -> Figure:
    """Modulation over spatial frequency."""
    made = _made(outcome)
    assert made.mtf is not None
    figure, axes = new_figure(1, 3, aspect_ratio=0.38, sharey=True)
    for row, (panel, at) in enumerate(zip(axes, SHOWN, strict=True)):
        for axis, name in enumerate(("along", "across")):
            panel.plot(made.mtf.frequency, made.mtf.geometric[row, axis], "--", color=PALETTE[axis], linewidth=0.9,
                       label=f"{name}, rays")  # fmt: skip
            if made.mtf.diffraction is not None:
                panel.plot(made.mtf.frequency, made.mtf.diffraction[row, axis], "-", color=PALETTE[axis],
                           label=f"{name}, waves")  # fmt: skip
        panel.set(title=f"{made.field_deg[at]:.3g}°", xlabel="frequency [1/mm]", ylim=(0.0, 1.02))
    axes[0].set_ylabel("modulation")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure
