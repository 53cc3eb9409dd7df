"""Tables of the attitude-correlated-frames experiment, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from experiments.acf.published import FIG4_RMS_PX, TABLE2_UNITS
from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome, Quantity, shown_unit
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table

__all__ = ["tables"]

NOISE = Column(name="Star noise", unit="px", key="noise_px", format=".2f")


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name."""
    config, runs = outcome.config, outcome.config.runs
    pulls = outcome.value("pull_n")
    frames_of_stars = f"{config.frames} frames of {outcome.value('stars_per_frame'):.0f} stars"
    fig5 = Pivot(
        rows="method noise",
        columns="x0_px y0_px focal_length_mm distortion_px sight_arcsec expected_sight_arcsec",
        caption="ACF17 Fig. 5 with further methods: RMS errors; mean of the largest residual distortion.",
        note=f"{runs} runs each.",
    )
    return {
        "table2": _table2(outcome),
        "fig4": _fig4(outcome),
        "fig3": _fig3(outcome),
        "fig3_ends": _fig3_ends(outcome),
        "methods": Pivot(
            rows="method",
            columns="pooled_x0_px pooled_y0_px pooled_f_um pooled_distortion_px pooled_sight_arcsec "
            "pooled_expected_sight_arcsec pooled_over_acc",
            caption="Errors of the methods of Fig. 5 per pixel of star noise, all noises together.",
            note=f"{runs} runs at each of {len(config.noise_px)} noises, {frames_of_stars}; line of sight: RMS over "
            "the detector after the best rotation.",
        ),
        "fig5": pivot(outcome.data.drop_vars("method_label"), fig5),  # names of methods as in summary.json
        "pulls": Pivot(
            rows="unknown",
            columns="pull_own pull_carried pull_linked",
            caption="RMS pull (error over predicted standard deviation); 1 is right.",
            note=f"{pulls} runs at all noises of Fig. 5; each number is known to ±{1 / np.sqrt(2 * pulls):.3f}.",
        ),
        "gain": _gain(outcome),
        "gain_weighted": _gain_weighted(outcome),
    }


def _table2(outcome: Outcome) -> Table:
    """Table 2 of ACF17: published | ours | Cramer-Rao bound, as errors; angles in arcsec."""
    shown = ("true", "published_error", "mean_error", "std", "bound", "bound_with_gyro_error")
    quantities, n = [outcome.quantity(f"table2_{name}") for name in shown], int(outcome.values("table2_n")[0])
    rows: list[tuple[Cell, ...]] = []
    for k, (name, unit) in enumerate(zip(outcome.names("unknown"), TABLE2_UNITS, strict=True)):
        scale = 3600.0 if unit == "deg" else 1.0
        true, printed, mean, spread, *bounds = (float(one.values[k]) for one in quantities)
        ours = Measured(value=scale * mean, uncertainty=scale * spread / n**0.5)
        head = f"{name} [{'″' if unit == 'deg' else unit}]"
        rows.append((head, true, scale * printed, ours, scale * spread, *(scale * bound for bound in bounds)))
    return Table(
        columns=("Unknown", *(_column(one) for one in quantities)),
        rows=rows,
        caption=f"ACF17 Table 2: errors after calibration with {outcome.config.table_noise_px:g} px of star noise, "
        "published, ours, and the Cramér–Rao bound of one run.",
        note=f"{n} runs, {(outcome.config.frames + 1) // 2} odd frames each. True angles in degrees, their "
        "errors in arcseconds. The bound takes the gyro as perfect, as eq. 11 does; the last column carries the gyro's "
        "error through.",
    )


def _column(one: Quantity, name: str = "", key: str = "") -> Column:
    """Column of a quantity, under its own head or another one."""
    return Column(name=name or one.label, unit=shown_unit(one.unit), key=key or one.key, format=one.format)


def _fig4(outcome: Outcome) -> Table:
    rms, length = outcome.quantity("fig4_rms_px"), outcome.quantity("fig4_length_px")
    others = [outcome.quantity(f"fig4_{name}") for name in ("expected_px", "scatter_px")]
    inside = outcome.values("fig4_inside")
    rows: list[tuple[Cell, ...]] = [
        (
            "published",
            None,
            None,
            *(float(v) for v in FIG4_RMS_PX),
            float(np.linalg.norm(FIG4_RMS_PX)),
            None,
            None,
            100.0,
        )
    ]
    for k, label in enumerate(outcome.names("case")):
        set_up = (float(outcome.values(f"fig4_{name}")[k]) for name in ("pixel_um", "stars"))
        found = (*rms.values[k].tolist(), float(length.values[k]), *(float(one.values[k]) for one in others))
        rows.append((label, *set_up, *found, 100.0 * float(inside[k])))
    return Table(
        columns=(
            "Fig. 4",
            *(_column(outcome.quantity(f"fig4_{name}")) for name in ("pixel_um", "stars")),
            *(_column(rms, f"RMS {axis}", f"rms_{axis}_px") for axis in "xy"),
            _column(length),
            *(_column(one) for one in others),
            Column(name="< 0.04 px", unit="%", key="part_below_0_04_px_percent", format=".1f"),
        ),
        rows=rows,
        caption=f"Reprojection of noise-free even frames at {outcome.config.table_noise_px:g} px, gyro of Table 1.",
        note=f"Ours: {outcome.config.runs} runs; x and y over all of them, the length as the mean of the runs' RMS, "
        f"known to ±{outcome.errors('fig4_length_px', case='assumed'):.4f} px. Inferred: pixel and stars that Table 2 "
        "implies (next section).",
    )


def _fig3(outcome: Outcome) -> Table:
    """Every gyro of Fig. 3, the perfect one first."""
    config = outcome.config
    bias, walk = outcome.quantity("fig3a_rms_px"), outcome.quantity("fig3b_rms_px")
    heads = ["perfect gyro", *(f"bias {value:g} °/h" for value in config.bias_deg_per_h)]
    heads += [f"walk {value:g} °/√h" for value in config.angle_random_walk_deg_per_sqrt_h]
    columns = [*(bias.at(bias=k) for k in range(bias.values.shape[1]))]
    columns += [walk.at(walk=k) for k in range(1, walk.values.shape[1])]
    return Table(
        columns=(NOISE, *(Column(name=head) for head in heads)),
        rows=[(noise, *(one.at(noise=k).scalar() for one in columns)) for k, noise in enumerate(config.noise_px)],
        caption="ACF17 Fig. 3: RMS reprojection error [px].",
        note=f"Mean of {config.runs} runs and its standard error.",
    )


def _fig3_ends(outcome: Outcome) -> Table:
    """The ends of Fig. 3, beside what was expected."""
    config = outcome.config
    bias, walk = config.bias_deg_per_h[-1], config.angle_random_walk_deg_per_sqrt_h[-1]
    ends: dict[str, tuple[str, str, dict[str, int]]] = {
        "perfect gyro": ("perfect", "fig3a", {"bias": 0}),
        f"bias {bias:g} °/h": ("bias", "fig3a", {"bias": -1}),
        f"walk {walk:g} °/√h": ("walk", "fig3b", {"walk": -1}),
    }
    columns = [NOISE]
    cells: list[list[float]] = [list(config.noise_px)]
    for head, (key, part, at) in ends.items():
        for name, label in (("rms_px", head), ("expected_px", "expected")):
            one = outcome.quantity(f"{part}_{name}").at(**at)
            columns.append(_column(one, label, f"{key}_{name}"))
            cells.append(one.values.tolist())
    return Table(
        columns=columns,
        rows=list(zip(*cells, strict=True)),
        caption="RMS reprojection error at the ends of Fig. 3. The document prints no numbers for its curves.",
        note=f"Mean of {config.runs} runs, known to {100 * 0.19 / config.runs**0.5:.0f} %; all gyros are in fig3.ecsv.",
    )


def _by_factor(
    outcome: Outcome, columns: Mapping[str, tuple[Callable[[float], str], str]]
) -> tuple[list[Column], list[list[Cell]]]:
    """Gains by number of stars, for every gyro the quantities ``columns`` -> (head by gyro noise, key)."""
    heads: list[Column] = []
    cells: list[list[Cell]] = [[stars] for stars in outcome.config.sweep.stars]
    for k, factor in enumerate(outcome.config.sweep.gyro_factor):
        for name, (head, key) in columns.items():
            one = outcome.quantity(name).at(factor=k)
            heads.append(_column(one, head(factor), key.format(f"{factor:g}")))
            for n, row in enumerate(cells):
                row.append(one.at(stars=n).scalar())
    return heads, cells


def _gain(outcome: Outcome) -> Table:
    """Gains of ACC and of a gyro of stated noise, found beside what was expected."""
    sweep = outcome.config.sweep
    heads, rows = _by_factor(
        outcome,
        {
            "gain_acc": (lambda factor: f"ACC, {_times(factor)}", "acc_{}"),
            "gain_acc_bound": (lambda _: "expected", "acc_{}_expected"),
            "gain_linked": (lambda factor: f"weighted, {_times(factor)}", "linked_{}"),
            "gain_linked_bound": (lambda _: "bound", "linked_{}_bound"),
        },
    )
    return Table(
        columns=(Column(name="Stars", key="stars_per_frame"), *heads),
        rows=rows,
        caption="Gain over free attitudes: ratio of the median line-of-sight errors.",
        note=f"{sweep.skies} skies per row, {outcome.config.frames} frames, {sweep.noise_px:g} px of star noise.",
    )


def _times(factor: float) -> str:
    return "perfect" if factor == 0 else f"{factor:g} ×"


def _gain_weighted(outcome: Outcome) -> Table:
    """What the report shows of the gain."""
    heads, rows = _by_factor(
        outcome,
        {
            "gain_linked": (lambda factor: f"{_times(factor)} {'gyro' if factor == 0 else 'Table 1'}", "gain_{}"),
            "gain_linked_bound": (lambda _: "bound", "bound_{}"),
        },
    )
    return Table(
        columns=("Stars", *heads),
        rows=rows,
        caption="Gain of a gyro of stated noise over free attitudes, found beside its bound.",
        note=f"Ratio of the median line-of-sight errors over {outcome.config.sweep.skies} skies; standard errors from "
        "resampled skies.",
    )
