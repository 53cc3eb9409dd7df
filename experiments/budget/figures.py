"""Figures of the budget."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.stats import norm

from experiments.budget.combine import TERMS
from experiments.budget.tables import SWEPT
from experiments.budget.tolerances import MOVES
from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure, spaced_axis
from experiments.harness.quantities import Outcome
from experiments.harness.range import value_at

__all__ = [
    "attitude_curves",
    "budget_bars",
    "cause_bars",
    "element_map",
    "layout_bars",
    "predicted_bars",
    "share_bars",
    "sweep_curves",
    "tolerance_histograms",
    "tornado_chart",
]

SHADES = (PALETTE[5], PALETTE[0], "#b9bec5")
TERM_COLOURS = dict(zip(TERMS, (PALETTE[0], PALETTE[2], PALETTE[1], PALETTE[4], "#b9bec5"), strict=True))
SHOWN = (*TERMS, "LSFE", "total")


def _columns(outcome: Outcome) -> tuple[str, ...]:
    known = ("published",) if outcome.result.published is not None else ()
    return ("predicted", "measured", *known)


def budget_bars(outcome: Outcome) -> Figure:
    """Every term and sum: predicted, measured, published, side by side, x and y."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.44, sharey=True)
    place = np.arange(len(SHOWN))
    for panel, axis in zip(axes, "xy", strict=True):
        for k, (column, colour) in enumerate(zip(_columns(outcome), SHADES, strict=False)):
            bars, spread = (
                np.array([float(read(f"{column}_arcsec", term=name, axis=axis)) for name in SHOWN])
                for read in (outcome.values, outcome.errors)
            )
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
        panel.set_title(axis)
        panel.grid(visible=False, axis="x")
    axes[0].set(ylabel="3σ [″]", ylim=(0, None))
    axes[0].legend(loc="upper left")
    return figure


def predicted_bars(outcome: Outcome) -> Figure:
    """Every term and sum, predicted alone, x and y."""
    figure, panel = new_figure(aspect_ratio=0.36)
    place = np.arange(len(SHOWN))
    for k, axis in enumerate("xy"):
        bars, spread = (
            np.array([float(read("predicted_arcsec", term=name, axis=axis)) for name in SHOWN])
            for read in (outcome.values, outcome.errors)
        )
        at = place + 0.2 * (2 * k - 1)
        panel.bar(at, bars, width=0.36, color=PALETTE[k], label=axis)
        panel.errorbar(at, bars, yerr=3 * spread, fmt="none", ecolor=INK, elinewidth=0.8)
    panel.set_xticks(place, [name.replace("LSFE-", "LSFE\n") for name in SHOWN])
    panel.set(ylabel="3σ [″]", ylim=(0, None))
    panel.grid(visible=False, axis="x")
    panel.legend(loc="upper left")
    return figure


def share_bars(outcome: Outcome) -> Figure:
    """Share of each term in the squared total."""
    columns = _columns(outcome)
    figure, axes = new_figure(1, 2, aspect_ratio=0.26, sharey=True)
    for panel, axis in zip(axes, "xy", strict=True):
        for row, column in enumerate(columns):
            term = {name: float(outcome.values(f"{column}_arcsec", term=name, axis=axis)) for name in TERMS}
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
        panel.set_yticks(range(len(columns)), columns)
        panel.set(xlim=(0, 100), title=axis, xlabel="share of the squared total [%]")
        panel.grid(visible=False)
    axes[0].invert_yaxis()
    figure.legend(
        handles=[Patch(color=colour, label=name) for name, colour in TERM_COLOURS.items()],
        loc="outside lower center",
        ncols=5,
    )
    return figure


def cause_bars(outcome: Outcome) -> Figure:
    """What the pixel term is made of, predicted."""
    figure, panel = new_figure(width="half", aspect_ratio=0.75)
    causes = outcome.names("cause")
    place = np.arange(len(causes))
    for k, axis in enumerate("xy"):
        values = outcome.values("cause_arcsec", axis=axis)
        panel.barh(place + 0.2 * (2 * k - 1), values, height=0.36, color=PALETTE[k], label=axis)
        whole = float(outcome.values("predicted_arcsec", term="HSFE", axis=axis))
        panel.axvline(whole, color=PALETTE[k], linewidth=0.9, linestyle="--")
    panel.set_yticks(place, causes)
    panel.invert_yaxis()
    panel.grid(visible=False, axis="y")
    panel.set(xlabel=f"{outcome.heading('cause_arcsec')}; dashed: all of them", xlim=(0, None))
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


READING_LABELS = {
    "independent": "LSFE independent",
    "as it is": "colour common, distortion smooth",
    "common": "LSFE common",
}


def attitude_curves(outcome: Outcome) -> Figure:
    """Attitude error against the number of stars, with the rule."""
    counts = outcome.data["stars"].values
    figure, axes = new_figure(1, 3, aspect_ratio=0.42, sharex=True)
    for panel, component in zip(axes, outcome.names("component"), strict=True):
        rule = outcome.values("curve_rule_arcsec", component=component)
        panel.plot(counts, rule, color=INK, linewidth=1.0, linestyle="--", label="rule 1/√N")
        for k, (reading, label) in enumerate(READING_LABELS.items()):
            curve = outcome.values(f"curve_{reading.replace(' ', '_')}_arcsec", component=component)
            panel.plot(counts, curve, marker=MARKERS[k], color=PALETTE[k], label=label)
        panel.axvline(outcome.value("attitude_stars"), color="#c9cdd3", linewidth=0.8)
        panel.set(xscale="log", yscale="log", title=component, xlabel="stars N")
        log_ticks(panel, "x", [n for n in counts.tolist() if int(str(n)[0]) in (2, 5, 1) and n != 15])
        log_ticks(panel, "y")
    axes[0].set_ylabel("attitude error, 3σ [″]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def layout_bars(outcome: Outcome) -> Figure:
    """What the places of the stars do, at N of the budget, against the rule."""
    layouts = outcome.names("layout")
    figure, panel = new_figure(width="half", aspect_ratio=0.75)
    place = np.arange(len(layouts))
    for k, component in enumerate(outcome.names("component")):
        rule = outcome.values("attitude_rule_arcsec", component=component)
        values = outcome.values("layout_arcsec", component=component) / rule
        panel.barh(place + 0.26 * (k - 1), values, height=0.24, color=PALETTE[k], label=component)
    panel.axvline(1.0, color=INK, linewidth=0.9, linestyle="--")
    panel.set_yticks(place, layouts)
    panel.invert_yaxis()
    panel.grid(visible=False, axis="y")
    panel.set(xlabel=f"error / (total / √{outcome.value('attitude_stars')})")
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure


def sweep_curves(outcome: Outcome) -> Figure:
    """Every term against the parameter; measured values are open circles, refused ones grey."""
    sweep = outcome.result.sweep
    figure, axes = new_figure(1, 2, aspect_ratio=0.46, sharey=True)
    x, here = outcome.values("sweep_value").astype(float), value_at(outcome.config, sweep.key)
    for panel, axis in zip(axes, "xy", strict=True):
        for k, name in enumerate(SWEPT):
            colour, at = TERM_COLOURS.get(name, INK), {"term": name, "axis": axis}
            panel.plot(x, outcome.values("sweep_predicted_arcsec", **at), marker=MARKERS[k], color=colour, label=name)
            if "sweep_measured_arcsec" in outcome.data:
                panel.errorbar(
                    x,
                    outcome.values("sweep_measured_arcsec", **at),
                    yerr=3 * outcome.errors("sweep_measured_arcsec", **at),
                    fmt="o",
                    markersize=6,
                    markerfacecolor="none",
                    color=colour,
                    elinewidth=0.8,
                )
        for one in sweep.settings:
            if one.predicted is None:
                panel.axvline(one.value, color="#c9cdd3", linewidth=5, alpha=0.6)
        if here is not None and x.min() <= here <= x.max():
            panel.axvline(here, color="#8a9099", linewidth=0.8, linestyle=":")
        panel.set(title=axis, xlabel=sweep.key)
        panel.xaxis.set_major_locator(MaxNLocator(5))
        spaced_axis(panel, "x", x.tolist())
    axes[0].set(ylabel=outcome.heading("sweep_predicted_arcsec"), ylim=(0, None))
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def tornado_chart(outcome: Outcome) -> Figure:
    """Change of the total when one parameter moves down or up."""
    names = [swing.label for swing in outcome.result.tornado.swings]
    figure, axes = new_figure(1, 2, aspect_ratio=0.16 + 0.034 * len(names), sharey=True, sharex=True)
    place = np.arange(len(names))
    for panel, axis in zip(axes, "xy", strict=True):
        change = outcome.values("total_change_arcsec", axis=axis)
        # nested: the longer bar behind, so that two changes of one sign are both seen
        for (low, high), y in zip(np.nan_to_num(change), place, strict=True):
            for value, colour in sorted(((low, PALETTE[5]), (high, PALETTE[1])), key=lambda one: -abs(one[0])):
                panel.barh(y, value, height=0.66, color=colour)
        panel.axvline(0.0, color=INK, linewidth=0.8)
        panel.set_yticks(place, names)
        panel.grid(visible=False, axis="y")
        total = outcome.value("tornado_total_arcsec", axis=axis)
        panel.set(title=f"{axis}: total {total:.3f}″", xlabel=f"{outcome.heading('total_change_arcsec')}, 3σ")
    axes[0].invert_yaxis()
    ends = [Patch(color=PALETTE[5], label="parameter lower"), Patch(color=PALETTE[1], label="parameter higher")]
    figure.legend(handles=ends, loc="outside lower center", ncols=2)
    return figure


def tolerance_histograms(outcome: Outcome) -> Figure:
    """Signed chromatic entries of built lenses with the linear prediction, and the LSFE they amount to."""
    built = outcome.result.tolerances
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


def element_map(outcome: Outcome) -> Figure:
    """Which movement of which element makes the chromatic term."""
    built = outcome.result.tolerances
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
