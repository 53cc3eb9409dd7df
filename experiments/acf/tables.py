"""Tables of the attitude-correlated-frames experiment, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.acf.evaluate import COMPARED, comparison, fig3, fig4, gains, pulls, table2_runs
from experiments.acf.figures import METHOD_LABELS
from experiments.acf.judge import degrees_of
from experiments.acf.published import FIG4_RMS_PX, TABLE2_CALIBRATED, TABLE2_NAMES, TABLE2_TRUE, TABLE2_UNITS
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table

if TYPE_CHECKING:
    from experiments.acf.result import Result

__all__ = ["all_tables", "fig3_at_a_glance"]

NAMES = {
    "phi1": "φ1", "phi2": "φ2", "phi3": "φ3", "theta1": "θ1", "theta2": "θ2", "theta3": "θ3",
}  # fmt: skip


def _table2(result: Result) -> Table:
    """Table 2 of ACF17: published | ours | Cramer-Rao bound, as errors; angles in arcsec."""
    errors, expected = table2_runs(result), result.forecast.table2
    bound, carried = (degrees_of(np.sqrt(np.diag(one))) for one in (expected.perfect, expected.acc))
    true = np.concatenate(
        [result.scene.camera.parameters, result.config.sky.phi_deg, result.config.gyro.installation_deg]
    )
    rows: list[tuple[Cell, ...]] = []
    for k, name in enumerate(TABLE2_NAMES):
        angle = TABLE2_UNITS[k] == "deg"
        scale = 3600.0 if angle else 1.0
        spread = float(errors[:, k].std(ddof=1))
        printed = float(TABLE2_CALIBRATED[k] - TABLE2_TRUE[k])
        label = NAMES.get(name, name)
        rows.append(
            (
                f"{label} [″]" if angle else f"{label} [{TABLE2_UNITS[k]}]",
                float(true[k]),
                scale * printed,
                Measured(value=scale * float(errors[:, k].mean()), uncertainty=scale * spread / len(errors) ** 0.5),
                scale * spread,
                scale * float(bound[k]),
                scale * float(carried[k]),
            )
        )
    return Table(
        columns=(
            "Unknown",
            Column(name="True", key="true", format=".6g"),
            Column(name="Published", key="published_error", format=".3g"),
            Column(name="Ours, mean", key="mean_error"),
            Column(name="one run", key="std", format=".3g"),
            Column(name="Bound", key="bound", format=".3g"),
            Column(name="with gyro", key="bound_with_gyro", format=".3g"),
        ),
        rows=rows,
        caption=f"ACF17 Table 2: errors after calibration with {result.config.table_noise_px:g} px of star noise, "
        "published, ours, and the Cramér–Rao bound of one run.",
        note=f"{len(errors)} runs, {(result.config.frames + 1) // 2} odd frames each. True angles in degrees, their "
        "errors in arcseconds. The bound takes the gyro as perfect, as eq. 11 does; the last column carries the gyro's "
        "error through.",
    )


def _fig4(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            "published",
            None,
            None,
            *(float(v) for v in FIG4_RMS_PX),
            float(np.linalg.norm(FIG4_RMS_PX)),
            *[None] * 2,
            100.0,
        )
    ]
    for inferred, label in ((False, "ours"), (True, "inferred")):
        found = fig4(result, inferred=inferred)
        um = result.plan.inferred.pixel_um if inferred else result.config.camera.pixel_um
        stars = float(result.plan.inferred.stars or 0) if inferred else result.stars_per_frame
        rows.append(
            (
                label,
                um,
                stars,
                float(found.rms_px[0]),
                float(found.rms_px[1]),
                found.runs.value,
                found.runs.expected,
                found.runs.scatter,
                100.0 * found.inside,
            )
        )
    return Table(
        columns=(
            "Fig. 4",
            Column(name="Pixel", unit="µm", key="pixel_um", format=".2f"),
            Column(name="Stars", unit="per frame", key="stars_per_frame", format=".0f"),
            Column(name="RMS x", unit="px", key="rms_x_px", format=".4f"),
            Column(name="RMS y", unit="px", key="rms_y_px", format=".4f"),
            Column(name="Length", unit="px", key="rms_length_px", format=".4f"),
            Column(name="Expected", unit="px", key="expected_px", format=".4f"),
            Column(name="One run ±", unit="px", key="scatter_px", format=".4f"),
            Column(name="< 0.04 px", unit="%", key="part_below_0_04_px_percent", format=".1f"),
        ),
        rows=rows,
        caption=f"Reprojection of noise-free even frames at {result.config.table_noise_px:g} px, gyro of Table 1.",
        note=f"Ours: {result.config.runs} runs; x and y over all of them, the length as the mean of the runs' RMS, "
        f"known to ±{fig4(result).runs.error:.4f} px. Inferred: pixel and stars that Table 2 implies (next section).",
    )


def _fig3(result: Result) -> Table:
    config = result.config
    heads = ["perfect gyro"]
    heads += [f"bias {value:g} °/h" for value in config.bias_deg_per_h]
    heads += [f"walk {value:g} °/√h" for value in config.angle_random_walk_deg_per_sqrt_h]
    rows: list[tuple[Cell, ...]] = [
        (noise, *(Measured(value=one.value, uncertainty=one.error) for one in row))
        for noise, row in zip(config.noise_px, fig3(result), strict=True)
    ]
    return Table(
        columns=(Column(name="Star noise", unit="px", key="noise_px", format=".2f"), *(Column(name=h) for h in heads)),
        rows=rows,
        caption="ACF17 Fig. 3: RMS reprojection error [px].",
        note=f"Mean of {config.runs} runs and its standard error.",
    )


def fig3_at_a_glance(result: Result) -> Table:
    """The ends of Fig. 3, beside what was expected."""
    config = result.config
    biases = len(config.bias_deg_per_h)
    columns = {
        "perfect gyro": 0,
        f"bias {config.bias_deg_per_h[-1]:g} °/h": biases,
        f"walk {config.angle_random_walk_deg_per_sqrt_h[-1]:g} °/√h": -1,
    }
    heads: list[Column | str] = [Column(name="Star noise", unit="px", key="noise_px", format=".2f")]
    for head in columns:
        heads += [Column(name=head, unit="px", format=".4f"), Column(name="expected", unit="px", format=".4f")]
    rows: list[tuple[Cell, ...]] = [
        (noise, *(v for k in columns.values() for v in (row[k].value, row[k].expected)))
        for noise, row in zip(config.noise_px, fig3(result), strict=True)
    ]
    return Table(
        columns=heads,
        rows=rows,
        caption="RMS reprojection error at the ends of Fig. 3. The document prints no numbers for its curves.",
        note=f"Mean of {config.runs} runs, known to {100 * 0.19 / config.runs**0.5:.0f} %; all gyros are in fig3.ecsv.",
    )


def _methods(result: Result) -> Table:
    found = comparison(result)
    noise, acc = np.array(result.config.noise_px), found["acc"]
    rows: list[tuple[Cell, ...]] = []
    for method in COMPARED:
        one = found[method]
        sight, expected = float(np.mean(one.sight_arcsec / noise)), one.expected_sight_arcsec
        rows.append(
            (
                METHOD_LABELS[method],
                float(one.pooled[0]),
                float(one.pooled[1]),
                1e3 * float(one.pooled[2]),
                float(np.mean(one.distortion_px / noise)),
                sight,
                None if expected is None else float(np.mean(expected / noise)),
                float(np.mean(one.sight_arcsec / acc.sight_arcsec)),
            )
        )
    return Table(
        columns=(
            "Method",
            Column(name="x0", unit="px", format=".2f"),
            Column(name="y0", unit="px", format=".2f"),
            Column(name="f", unit="µm", format=".2f"),
            Column(name="Distortion, largest", unit="px", key="distortion_px", format=".3f"),
            Column(name="Line of sight", unit="″", key="sight_arcsec", format=".2f"),
            Column(name="expected", unit="″", key="expected_sight_arcsec", format=".2f"),
            Column(name="over ACC", key="over_acc", format=".3f"),
        ),
        rows=rows,
        caption="Errors of the methods of Fig. 5 per pixel of star noise, all noises together.",
        note=f"{acc.runs} runs at each of {len(noise)} noises, {result.config.frames} frames of "
        f"{result.stars_per_frame:.0f} stars; line of sight: RMS over the detector after the best rotation.",
    )


def _fig5(result: Result) -> Table:
    """All numbers behind Fig. 5, for machines."""
    found = comparison(result)
    rows: list[tuple[Cell, ...]] = []
    for method in COMPARED:
        one = found[method]
        for k, noise in enumerate(result.config.noise_px):
            rows.append(
                (
                    method,
                    noise,
                    float(one.camera[k, 0]),
                    float(one.camera[k, 1]),
                    float(one.camera[k, 2]),
                    Measured(value=float(one.distortion_px[k]), uncertainty=float(one.distortion_error_px[k])),
                    Measured(value=float(one.sight_arcsec[k]), uncertainty=float(one.sight_error_arcsec[k])),
                    None if one.expected_sight_arcsec is None else float(one.expected_sight_arcsec[k]),
                )
            )
    return Table(
        columns=(
            "Method",
            Column(name="Star noise", unit="px", key="noise_px"),
            Column(name="x0", unit="px", key="x0_px"),
            Column(name="y0", unit="px", key="y0_px"),
            Column(name="f", unit="mm", key="focal_length_mm"),
            Column(name="Distortion", unit="px", key="distortion_px"),
            Column(name="Line of sight", unit="arcsec", key="sight_arcsec"),
            Column(name="Expected", unit="arcsec", key="expected_sight_arcsec"),
        ),
        rows=rows,
        caption="ACF17 Fig. 5 with further methods: RMS errors; mean of the largest residual distortion.",
        note=f"{result.config.runs} runs each.",
    )


def _pulls(result: Result) -> Table:
    found = pulls(result)
    rows: list[tuple[Cell, ...]] = [
        (NAMES.get(name, name), *(float(found.rms(which)[k]) for which in ("own", "carried", "linked")))
        for k, name in enumerate(TABLE2_NAMES)
    ]
    n = len(found.own)
    return Table(
        columns=(
            "Unknown",
            Column(name="ACC, own covariance", key="own", format=".3f"),
            Column(name="ACC, gyro carried through", key="carried", format=".3f"),
            Column(name="gyro of stated noise", key="linked", format=".3f"),
        ),
        rows=rows,
        caption="RMS pull (error over predicted standard deviation); 1 is right.",
        note=f"{n} runs at all noises of Fig. 5; each number is known to ±{1 / np.sqrt(2 * n):.3f}.",
    )


def _gain(result: Result) -> Table:
    found, sweep = gains(result), result.config.sweep
    columns: list[Column | str] = [Column(name="Stars", key="stars_per_frame")]
    for factor in sweep.gyro_factor:
        label = "perfect" if factor == 0 else f"{factor:g} ×"
        columns += [
            Column(name=f"ACC, {label}", key=f"acc_{factor:g}"),
            Column(name="expected", key=f"acc_{factor:g}_expected", format=".2f"),
            Column(name=f"weighted, {label}", key=f"linked_{factor:g}"),
            Column(name="bound", key=f"linked_{factor:g}_bound", format=".2f"),
        ]
    rows: list[tuple[Cell, ...]] = []
    for i, stars in enumerate(sweep.stars):
        cells: list[Cell] = [stars]
        for k in range(len(sweep.gyro_factor)):
            cells += [
                Measured(value=float(found.acc[i, k]), uncertainty=float(found.acc_error[i, k])),
                float(found.acc_bound[i, k]),
                Measured(value=float(found.linked[i, k]), uncertainty=float(found.linked_error[i, k])),
                float(found.linked_bound[i, k]),
            ]
        rows.append(tuple(cells))
    return Table(
        columns=columns,
        rows=rows,
        caption="Gain over free attitudes: ratio of the median line-of-sight errors.",
        note=f"{found.runs} skies per row, {result.config.frames} frames, {sweep.noise_px:g} px of star noise.",
    )


def _corners(result: Result) -> Table:
    """The gain at a glance: what the report shows of it."""
    found, sweep = gains(result), result.config.sweep
    rows: list[tuple[Cell, ...]] = []
    for i, stars in enumerate(sweep.stars):
        cells: list[Cell] = [stars]
        for k in range(len(sweep.gyro_factor)):
            cells.append(Measured(value=float(found.linked[i, k]), uncertainty=float(found.linked_error[i, k])))
            cells.append(float(found.linked_bound[i, k]))
        rows.append(tuple(cells))
    columns: list[Column | str] = [Column(name="Stars")]
    for factor in sweep.gyro_factor:
        columns += [
            Column(name="perfect gyro" if factor == 0 else f"{factor:g} × Table 1", key=f"gain_{factor:g}"),
            Column(name="bound", key=f"bound_{factor:g}", format=".2f"),
        ]
    return Table(
        columns=columns,
        rows=rows,
        caption="Gain of a gyro of stated noise over free attitudes, found beside its bound.",
        note=f"Ratio of the median line-of-sight errors over {found.runs} skies; standard errors from resampled skies.",
    )


def all_tables(result: Result) -> Mapping[str, Table]:
    """All tables by file name."""
    return {
        "table2": _table2(result),
        "fig4": _fig4(result),
        "fig3": _fig3(result),
        "methods": _methods(result),
        "fig5": _fig5(result),
        "pulls": _pulls(result),
        "gain": _gain(result),
        "gain_weighted": _corners(result),
    }
