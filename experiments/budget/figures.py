"""Figures of the budget."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from experiments.budget.combine import PRINTED, TERMS
from experiments.budget.result import Result
from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure

__all__ = ["attitude_curves", "budget_bars", "cause_bars", "layout_bars", "share_bars"]

COLUMNS = ("predicted", "measured", "published")
SHADES = (PALETTE[5], PALETTE[0], "#b9bec5")
TERM_COLOURS = dict(zip(TERMS, (PALETTE[0], PALETTE[2], PALETTE[1], PALETTE[4], "#b9bec5"), strict=True))
SHOWN = (*TERMS, "LSFE", "total")


def _values(result: Result, column: str, name: str) -> tuple[Any, Any]:
    if column == "published":
        return np.array(PRINTED[name]) if name in PRINTED else result.published[name].arcsec, np.zeros(2)
    value = (result.predicted.budget if column == "predicted" else result.measured.budget)[name]
    return value.arcsec, value.uncertainty_arcsec


def budget_bars(result: Result) -> Figure:
    """Every term and sum: predicted, measured, published, side by side, x and y."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.44, sharey=True)
    place = np.arange(len(SHOWN))
    for axis, (panel, letter) in enumerate(zip(axes, "xy", strict=True)):
        for k, (column, colour) in enumerate(zip(COLUMNS, SHADES, strict=True)):
            height, error = zip(*(_values(result, column, name) for name in SHOWN), strict=True)
            bars, spread = np.array(height)[:, axis], np.array(error)[:, axis]
            at = place + 0.27 * (k - 1)
            panel.bar(at, bars, width=0.25, color=colour, label=column)
            if column != "published":
                panel.errorbar(at, bars, yerr=3 * spread, fmt="none", ecolor=INK, elinewidth=0.8)
            if column == "measured":
                for x, value in zip(at, bars, strict=True):
                    text = f"{value:.2f}" if value >= 0.005 else "0"
                    panel.text(x, value, text, ha="center", va="bottom", fontsize=6.5, color=INK)
        panel.axvline(len(TERMS) - 0.5, color="#c9cdd3", linewidth=0.8)
        panel.set_xticks(place, [name.replace("LSFE-", "LSFE\n") for name in SHOWN])
        panel.set_title(letter)
        panel.grid(visible=False, axis="x")
    axes[0].set(ylabel="3σ [″]", ylim=(0, None))
    axes[0].legend(loc="upper left")
    return figure


def share_bars(result: Result) -> Figure:
    """Share of each term in the squared total."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.26, sharey=True)
    for axis, (panel, letter) in enumerate(zip(axes, "xy", strict=True)):
        for row, column in enumerate(COLUMNS):
            term = {name: float(_values(result, column, name)[0][axis]) for name in TERMS}
            linear = term["LSFE-C1"] + term["LSFE-C2"]
            # C1 and C2 add before they are squared: the cross term is shared out in their proportion
            square = {name: term[name] ** 2 for name in TERMS[:3]}
            square |= {name: term[name] * linear for name in TERMS[3:]}
            total, left = sum(square.values()), 0.0
            for name, value in square.items():
                share = 100.0 * value / total
                panel.barh(row, share, left=left, color=TERM_COLOURS[name], height=0.62)
                if share > 7:
                    panel.text(
                        left + share / 2, row, f"{share:.0f}", ha="center", va="center", fontsize=7, color="white"
                    )
                left += share
        panel.set_yticks(range(3), COLUMNS)
        panel.set(xlim=(0, 100), title=letter, xlabel="share of the squared total [%]")
        panel.grid(visible=False)
    axes[0].invert_yaxis()
    figure.legend(
        handles=[Patch(color=colour, label=name) for name, colour in TERM_COLOURS.items()],
        loc="outside lower center",
        ncols=5,
    )
    return figure


def cause_bars(result: Result) -> Figure:
    """What the pixel term is made of, predicted."""
    figure, panel = new_figure(width="half", aspect_ratio=0.75)
    causes = result.predicted.causes_arcsec
    place = np.arange(len(causes))
    for axis, letter in enumerate("xy"):
        values = [float(value[axis]) for value in causes.values()]
        panel.barh(place + 0.2 * (2 * axis - 1), values, height=0.36, color=PALETTE[axis], label=letter)
    whole = result.predicted.budget["HSFE"].arcsec
    for axis in range(2):
        panel.axvline(whole[axis], color=PALETTE[axis], linewidth=0.9, linestyle="--")
    panel.set_yticks(place, list(causes))
    panel.invert_yaxis()
    panel.grid(visible=False, axis="y")
    panel.set(xlabel="3σ [″]; dashed: all of them", xlim=(0, None))
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


READING_LABELS = {
    "independent": "LSFE independent",
    "as it is": "colour common, distortion smooth",
    "common": "LSFE common",
}


def attitude_curves(result: Result) -> Figure:
    """Attitude error against the number of stars, with the rule."""
    study = result.attitude
    figure, axes = new_figure(1, 3, aspect_ratio=0.42, sharex=True)
    for column, (panel, title) in enumerate(zip(axes, ("x", "y", "roll"), strict=True)):
        panel.plot(study.counts, study.rule[:, column], color=INK, linewidth=1.0, linestyle="--", label="rule 1/√N")
        for k, (name, curve) in enumerate(study.curve.items()):
            panel.plot(study.counts, curve[:, column], marker=MARKERS[k], color=PALETTE[k], label=READING_LABELS[name])
        panel.axvline(study.stars, color="#c9cdd3", linewidth=0.8)
        panel.set(xscale="log", yscale="log", title=title, xlabel="stars N")
        shown = [int(n) for n in study.counts if int(str(n)[0]) in (2, 5, 1) and n not in (15,)]
        panel.set_xticks(shown, [str(n) for n in shown])
        panel.xaxis.set_minor_formatter("")
        panel.yaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_minor_formatter("")
    axes[0].set_ylabel("attitude error, 3σ [″]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def layout_bars(result: Result) -> Figure:
    """What the places of the stars do, at N of the budget, against the rule."""
    study = result.attitude
    figure, panel = new_figure(width="half", aspect_ratio=0.75)
    place = np.arange(len(study.layout))
    for column, letter in enumerate(("x", "y", "roll")):
        values = [float(v[column] / study.rule_at[column]) for v in study.layout.values()]
        panel.barh(place + 0.26 * (column - 1), values, height=0.24, color=PALETTE[column], label=letter)
    panel.axvline(1.0, color=INK, linewidth=0.9, linestyle="--")
    panel.set_yticks(place, list(study.layout))
    panel.invert_yaxis()
    panel.grid(visible=False, axis="y")
    panel.set(xlabel=f"error / (total / √{study.stars})")
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure
