"""Tables of the chromatic test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome
from experiments.harness.tables import Cell, Column, Table
from experiments.laboratory.collimator_effects import chromatic_table

__all__ = ["tables"]


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name."""
    config, wanted = outcome.config, outcome.config.decentre
    points = outcome.result.centred.measurement.nominal_px[..., 0].size
    shifts = ("measured", "sigma", "photon", "bundle", "predicted", "paraxial")
    every_point = Pivot(
        rows="lens pair position point",
        hidden="position point",
        across="axis",
        columns=f"nominal_px {' '.join(f'{name}_shift_px' for name in shifts)}",
        caption="All points.",
    )
    found: dict[str, Table | Pivot] = {}
    if outcome.result.collimator is not None:
        found["collimator"] = chromatic_table()
    return found | {
        "table1": Pivot(
            rows="lens pair axis",
            columns=("published_px " if "published_px" in outcome.data else "")
            + "predicted_table1_px photon_table1_px table1_px",
            caption="ACC18 Table 1: mean shift between filters, halved (eq. 16), beside prediction and truth.",
            note=f"One standard deviation, from {config.frames} frames x {points} points per filter and the fixed "
            "pattern's size.",
        ),
        "calibration": _calibration(outcome),
        "elements": Pivot(
            rows="solution",
            hidden="solution",
            across="pair",
            where={"axis": wanted.axis},
            columns="solution_element solution_kind solution_amount solution_shown_unit solution_table1_px "
            "solution_boresight_px",
            caption=f"Movement of each element that gives {wanted.wanted_px:g} px in {outcome.config.pair}, "
            f"{wanted.axis.upper()}; and what the other pair then shows.",
            note="By ray trace. Empty: not within 3 mm or 3 deg. Tilts are about the element's first vertex. Decentres "
            "count along increasing column (x), against increasing row (y).",
        ),
        "centroiders": _centroiders(outcome),
        "anatomy": Pivot(
            rows="pair",
            columns="radial_paraxial_px radial_chief_px radial_bundle_px",
            caption="Radial shift of the centred lens, mean over the points: paraxial lateral colour; the chief ray "
            "adds chromatic distortion; all rays add coma and spherical aberration that change with colour.",
        ),
        "stars": Pivot(
            rows="temperature",
            where={"lens": "centred"},
            columns="star_rms_px star_max_px",
            caption=f"Shift of black-body stars against {config.stars.reference_k:g} K over the field.",
        ),
        "points": pivot(outcome.data.drop_vars("lens_label"), every_point),
    }


def _calibration(outcome: Outcome) -> Table:
    """Shifts with camera parameters of its own for each band; last, the noiseless light with both."""
    table = pivot(
        outcome.data,
        Pivot(
            rows="lens pair",
            across="step",
            columns="residual_px",
            caption="RMS length of the shift of a point, as found and with camera parameters of its own for each band.",
            note="Noise of the centroids included, except in the last column, which is of the noiseless light.",
        ),
    )
    steps = zip(table.heads[2:], outcome.names("step"), strict=True)
    heads = [*table.heads[:2], *(replace(head, name=step.capitalize()) for head, step in steps)]
    heads.append(Column(name="Both, no noise", unit="px", key="both_photon_px", format=".4f"))
    light = outcome.values("photon_residual_px", step="both").ravel().tolist()
    rows = [(*row, one) for row, one in zip(table.rows, light, strict=True)]
    return Table(columns=heads, rows=rows, caption=table.caption, note=table.note)


def _centroiders(outcome: Outcome) -> Table:
    """The same frames by every centroider, in the axis of Table 1 that is to be reproduced."""
    config = outcome.config
    axis, names = config.decentre.axis, outcome.data["pair"].values.tolist()
    columns: list[tuple[str, dict[str, str]]] = [("method_noise_px", {}), ("method_error_px", {})]
    columns += [("method_table1_px", {"lens": "centred", "pair": config.pair, "axis": axis})]
    columns += [("method_table1_px", {"lens": "moved", "pair": name, "axis": axis}) for name in names]
    found = np.stack([outcome.values(name, **part) for name, part in columns], axis=1)
    rows: list[tuple[Cell, ...]] = [
        (method, *(float(v) if np.isfinite(v) else None for v in row))
        for method, row in zip(outcome.names("method"), found, strict=True)
    ]
    letter = axis.upper()
    return Table(
        columns=(
            "Centroider",
            Column(name="Noise", unit="px", key="noise_px", format=".4f"),
            Column(name="RMS error", unit="px", key="rms_bias_px", format=".4f"),
            Column(name=f"{config.pair} {letter}, centred", unit="px", key="centred_px", format=".5f"),
            *(Column(name=f"{n} {letter}, moved", unit="px", key=f"moved_{n}_px", format=".4f") for n in names),
        ),
        rows=rows,
        caption="The same frames through every centroider, and the entries of Table 1 each finds.",
        note="Noise: standard deviation of a single frame. RMS error: mean centroid against the centroid of the "
        "noiseless light, centred lens. Both per axis, over all points and filters. Empty: the method does not "
        "converge on some point.",
    )
