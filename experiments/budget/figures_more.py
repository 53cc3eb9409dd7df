"""Figures of the budget that look beyond one setting: sweep, tornado, lenses as built."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.stats import norm

from experiments.budget.combine import TERMS
from experiments.budget.figures import TERM_COLOURS
from experiments.budget.range import value_at
from experiments.budget.result import Result
from experiments.budget.tolerances import MOVES
from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure

__all__ = ["element_map", "sweep_curves", "tolerance_histograms", "tornado_chart"]


def sweep_curves(result: Result) -> Figure:
    """Every term against the parameter."""
    sweep = result.sweep
    assert sweep is not None
    figure, axes = new_figure(1, 2, aspect_ratio=0.46, sharey=True)
    x = np.array([one.value for one in sweep.settings])
    here = value_at(result.config, sweep.key)
    for axis, (panel, letter) in enumerate(zip(axes, "xy", strict=True)):
        for k, name in enumerate((*TERMS[:-1], "total")):
            colour = TERM_COLOURS.get(name, INK)
            panel.plot(x, sweep.series(name)[:, axis], marker=MARKERS[k], color=colour, label=name)
        for one in sweep.settings:
            if one.measured is not None:
                for name in (*TERMS[:-1], "total"):
                    value = one.measured.budget[name]
                    panel.errorbar(
                        one.value,
                        value.arcsec[axis],
                        yerr=3 * value.uncertainty_arcsec[axis],
                        fmt="o",
                        markersize=6,
                        markerfacecolor="none",
                        color=TERM_COLOURS.get(name, INK),
                        elinewidth=0.8,
                    )
            if one.predicted is None:
                panel.axvline(one.value, color="#c9cdd3", linewidth=5, alpha=0.6)
        if here is not None and x.min() <= here <= x.max():
            panel.axvline(here, color="#8a9099", linewidth=0.8, linestyle=":")
        panel.set(title=letter, xlabel=sweep.key)
        panel.xaxis.set_major_locator(MaxNLocator(5))
    axes[0].set(ylabel="3σ [″]", ylim=(0, None))
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def tornado_chart(result: Result) -> Figure:
    """Change of the total when one parameter moves down or up."""
    tornado = result.tornado
    assert tornado is not None
    names = [f"{swing.label}" for swing in tornado.swings]
    figure, axes = new_figure(1, 2, aspect_ratio=0.16 + 0.034 * len(names), sharey=True, sharex=True)
    place = np.arange(len(names))
    for axis, (panel, letter) in enumerate(zip(axes, "xy", strict=True)):
        change = np.stack([swing.change("total", tornado.base)[:, axis] for swing in tornado.swings])
        # nested: the longer bar behind, so that two changes of one sign are both seen
        for (low, high), y in zip(np.nan_to_num(change), place, strict=True):
            for value, colour in sorted(((low, PALETTE[5]), (high, PALETTE[1])), key=lambda one: -abs(one[0])):
                panel.barh(y, value, height=0.66, color=colour)
        panel.axvline(0.0, color=INK, linewidth=0.8)
        panel.set_yticks(place, names)
        panel.grid(visible=False, axis="y")
        panel.set(title=f"{letter}: total {tornado.base.total.arcsec[axis]:.3f}″", xlabel="change of the total, 3σ [″]")
    axes[0].invert_yaxis()
    ends = [Patch(color=PALETTE[5], label="parameter lower"), Patch(color=PALETTE[1], label="parameter higher")]
    figure.legend(handles=ends, loc="outside lower center", ncols=2)
    return figure


def tolerance_histograms(result: Result) -> Figure:
    """Signed chromatic entries of built lenses with the linear prediction, and the LSFE they amount to."""
    built = result.tolerances
    figure, axes = new_figure(1, 3, aspect_ratio=0.36)
    widest = int(np.argmax(built.linear_arcsec.max(1)))
    pair = built.pairs[widest]
    entries = built.signed_arcsec[:, widest]
    edges = np.linspace(entries.min(), entries.max(), 26)
    x = np.linspace(edges[0], edges[-1], 300)
    for axis, letter in enumerate("xy"):
        axes[0].hist(entries[:, axis], edges, histtype="step", color=PALETTE[axis], linewidth=1.3, label=letter)
        law = norm(built.nominal_arcsec[widest, axis], max(float(built.linear_arcsec[widest, axis]), 1e-9))
        expected = len(entries) * (edges[1] - edges[0]) * law.pdf(x)
        axes[0].plot(x, expected, color=PALETTE[axis], linewidth=1.0, linestyle="--")
    axes[0].set(title=f"chromatic, {pair} nm, signed", xlabel="entry [″]", ylabel="lenses")
    axes[0].legend(fontsize=7)
    for panel, values, title in (
        (axes[1], built.lsfe_arcsec, "LSFE after calibration"),
        (axes[2], built.uncalibrated_arcsec, "moved after calibration"),
    ):
        bins = np.linspace(0, float(np.percentile(values, 99.5)) * 1.1 + 1e-9, 26)
        for axis, letter in enumerate("xy"):
            panel.hist(values[:, axis], bins, histtype="step", color=PALETTE[axis], linewidth=1.3, label=letter)
            panel.axvline(np.percentile(values[:, axis], 95), color=PALETTE[axis], linewidth=0.9, linestyle=":")
        panel.set(title=title, xlabel="3σ [″]; dotted: 95 %")
    return figure


def element_map(result: Result) -> Figure:
    """Which movement of which element makes the chromatic term."""
    built = result.tolerances
    size = np.sqrt((built.sensitivity_arcsec**2).sum(3).max(2))
    figure, panel = new_figure(width="half", aspect_ratio=0.75)
    panel.imshow(size, aspect="auto", cmap="Blues", vmin=0)
    for (e, m), value in np.ndenumerate(size):
        dark = value > 0.6 * size.max()
        panel.text(m, e, f"{value:.3f}", ha="center", va="center", fontsize=7, color="white" if dark else INK)
    panel.set_yticks(range(len(built.elements)), built.elements)
    panel.set_xticks(range(len(MOVES)), [name.replace(" ", "\n") for name in MOVES])
    panel.grid(visible=False)
    return figure
