"""Tables of the chromatic test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from experiments.chromatic.result import PUBLISHED_TABLE1_PX
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from experiments.laboratory.centroid_methods import MethodLabels

if TYPE_CHECKING:
    from experiments.chromatic.result import Result

__all__ = ["all_tables", "moved_label"]

METHOD_NAMES = MethodLabels(own="PSF of each filter", reference="PSF of the reference filter")


def moved_label(result: Result) -> str:
    s = result.chosen
    amount = f"{s.amount:+.0f} µm" if s.kind == "decentre" else f"{s.amount:+.1f} arcmin"
    return f"{s.element} {'decentred' if s.kind == 'decentre' else 'tilted'} {amount}"


def _table1(result: Result) -> Table:
    """Table 1 of ACC18: published, predicted, measured, for the centred lens and with the moved element."""
    rows: list[tuple[Cell, ...]] = []
    for label, evaluation in (("centred", result.centred), (moved_label(result), result.moved)):
        for name in evaluation.table1_px:
            for axis, letter in enumerate("XY"):
                rows.append(
                    (
                        label,
                        name,
                        letter,
                        PUBLISHED_TABLE1_PX[name][axis] if name in PUBLISHED_TABLE1_PX else None,
                        float(evaluation.predicted_table1_px[name][axis]),
                        float(evaluation.photon_table1_px[name][axis]),
                        Measured(
                            value=float(evaluation.table1_px[name][axis]),
                            uncertainty=float(evaluation.table1_sigma_px[name][axis]),
                        ),
                    )
                )
    frames, points = result.config.frames, int(np.prod(result.centred.measurement.nominal_px.shape[:2]))
    return Table(
        columns=(
            "Lens",
            Column(name="Bands", unit="nm", key="bands"),
            "Axis",
            Column(name="Published", unit="px", key="published_px", format=".4f"),
            Column(name="Ray trace", unit="px", key="ray_trace_px", format=".5f"),
            Column(name="Noiseless light", unit="px", key="photon_px", format=".5f"),
            Column(name="Measured", unit="px", key="measured_px"),
        ),
        rows=rows,
        caption="ACC18 Table 1: mean shift between filters, halved (eq. 16), beside prediction and truth.",
        note=f"One standard deviation, from {frames} frames x {points} points per filter and the fixed pattern's size.",
    )


def _methods(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    pair, axis = result.config.decentre.pair, "xy".index(result.config.decentre.axis)
    letter = result.config.decentre.axis.upper()
    for method in result.centred.method_table1_px:
        mean = result.centred.measurement.mean_px[method] - result.centred.measurement.photon_px
        sigma = result.centred.measurement.sigma_px[method]
        moved = result.moved.method_table1_px[method]
        rows.append(
            (
                METHOD_NAMES[method],
                _found(np.sqrt((sigma**2).mean())),
                _found(np.sqrt((mean**2).mean())),
                _found(result.centred.method_table1_px[method][pair][axis]),
                *(_found(moved[name][axis]) for name, _, _ in result.pairs),
            )
        )
    return Table(
        columns=(
            "Centroider",
            Column(name="Noise", unit="px", key="noise_px", format=".4f"),
            Column(name="RMS error", unit="px", key="rms_bias_px", format=".4f"),
            Column(name=f"{pair} {letter}, centred", unit="px", key="centred_px", format=".5f"),
            *(
                Column(name=f"{name} {letter}, moved", unit="px", key=f"moved_{name}_px", format=".4f")
                for name, _, _ in result.pairs
            ),
        ),
        rows=rows,
        caption="The same frames through every centroider, and the entries of Table 1 each finds.",
        note="Noise: standard deviation of a single frame. RMS error: mean centroid against the centroid of the "
        "noiseless light, centred lens. Both per axis, over all points and filters. Empty: the method does not "
        "converge on some point.",
    )


def _found(value: float) -> float | None:
    """A number for a cell; None where a method found none."""
    return float(value) if np.isfinite(value) else None


def _anatomy(result: Result) -> Table:
    """What the shift of the centred lens is made of: its radial part, from the axis outwards, mean over the points."""
    place = result.centred.measurement.nominal_px - result.instrument.camera.centre_px
    outward = place / np.linalg.norm(place, axis=-1, keepdims=True)
    rows: list[tuple[Cell, ...]] = []
    for name, high, low in result.pairs:
        positions = (result.paraxial_px, result.centred.measurement.chief_px, result.centred.measurement.bundle_px)
        radial = [float(((p[..., high, :] - p[..., low, :]) * outward).sum(-1).mean()) for p in positions]
        rows.append((name, *radial))
    return Table(
        columns=(
            Column(name="Bands", unit="nm", key="bands"),
            Column(name="Paraxial", unit="px", key="paraxial_px", format="+.4f"),
            Column(name="Chief ray", unit="px", key="chief_px", format="+.4f"),
            Column(name="All rays", unit="px", key="bundle_px", format="+.4f"),
        ),
        rows=rows,
        caption="Radial shift of the centred lens, mean over the points: paraxial lateral colour; the chief ray adds "
        "chromatic distortion; all rays add coma and spherical aberration that change with colour.",
    )


def _elements(result: Result) -> Table:
    names = [name for name, _, _ in result.pairs]
    axis = "xy".index(result.config.decentre.axis)
    rows: list[tuple[Cell, ...]] = [
        (
            s.element,
            s.kind,
            float(s.amount) if np.isfinite(s.amount) else None,
            {"um": "µm"}.get(s.unit, s.unit),
            *(float(s.table1_px[n][axis]) if np.isfinite(s.amount) else None for n in names),
            float(s.boresight_px[axis]) if np.isfinite(s.amount) else None,
        )
        for s in result.solutions
    ]
    letter = result.config.decentre.axis.upper()
    return Table(
        columns=(
            "Element",
            "Movement",
            Column(name="Amount", key="amount", format=".1f"),
            "Unit",
            *(Column(name=f"{n} {letter}", unit="px", key=f"mean_{n}_px", format=".4f") for n in names),
            Column(name="Image moves", unit="px", key="boresight_px", format=".1f"),
        ),
        rows=rows,
        caption=f"Movement of each element that gives {result.config.decentre.wanted_px:g} px in "
        f"{result.config.decentre.pair}, {letter}; and what the other pair then shows.",
        note="By ray trace. Empty: not within 3 mm or 3 deg. Tilts are about the element's first vertex. Decentres "
        "count along increasing column (x), against increasing row (y).",
    )


def _residuals(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (label, name, *steps.values(), evaluation.photon_residual_px[name]["both"])
        for label, evaluation in (("centred", result.centred), (moved_label(result), result.moved))
        for name, steps in evaluation.residual_px.items()
    ]
    return Table(
        columns=(
            "Lens",
            Column(name="Bands", unit="nm", key="bands"),
            Column(name="As found", unit="px", key="as_found_px", format=".4f"),
            Column(name="Principal point", unit="px", key="principal_point_px", format=".4f"),
            Column(name="Focal length", unit="px", key="focal_length_px", format=".4f"),
            Column(name="Both", unit="px", key="both_px", format=".4f"),
            Column(name="Both, no noise", unit="px", key="both_photon_px", format=".4f"),
        ),
        rows=rows,
        caption="RMS length of the shift of a point, as found and with camera parameters of its own for each band.",
        note="Noise of the centroids included, except in the last column, which is of the noiseless light.",
    )


def _stellar(result: Result) -> Table:
    s = result.stellar
    return Table(
        columns=(
            Column(name="Temperature", unit="K", key="temperature_k", format=".0f"),
            Column(name="RMS shift", unit="px", key="rms_px", format=".4f"),
            Column(name="Largest shift", unit="px", key="max_px", format=".4f"),
        ),
        rows=[tuple(float(v) for v in row) for row in zip(s.temperature_k, s.rms_px, s.max_px, strict=True)],
        caption=f"Shift of black-body stars against {result.config.stars.reference_k:g} K over the field.",
    )


def _points(result: Result) -> Table:
    """Every point: where it is, its measured shift, the truth, the predictions."""
    rows: list[tuple[Cell, ...]] = []
    for label, evaluation in (("centred", result.centred), ("moved", result.moved)):
        place = evaluation.measurement.nominal_px.reshape(-1, 2)
        for name, high, low in result.pairs:
            flat = [
                v[name].reshape(-1, 2)
                for v in (
                    evaluation.shift_px,
                    evaluation.shift_sigma_px,
                    evaluation.photon_shift_px,
                    evaluation.bundle_shift_px,
                    evaluation.predicted_shift_px,
                )
            ]
            paraxial = (result.paraxial_px[..., high, :] - result.paraxial_px[..., low, :]).reshape(-1, 2)
            for numbers in np.hstack([place, *flat, paraxial]).tolist():
                rows.append((label, name, *numbers))
    columns = [
        Column(name=f"{what} {axis}", unit="px", key=f"{key}_{axis}_px")
        for what, key in (
            ("Nominal", "nominal"),
            ("Measured shift", "measured"),
            ("Uncertainty", "sigma"),
            ("Noiseless light", "photon"),
            ("Ray bundle", "bundle"),
            ("Ray-trace prediction", "predicted"),
            ("Paraxial prediction", "paraxial"),
        )
        for axis in "xy"
    ]
    return Table(
        columns=("Lens", Column(name="Bands", unit="nm", key="bands"), *columns), rows=rows, caption="All points."
    )


def all_tables(result: Result) -> Mapping[str, Table]:
    """Tables of the result by file name."""
    return {
        "table1": _table1(result),
        "calibration": _residuals(result),
        "elements": _elements(result),
        "centroiders": _methods(result),
        "anatomy": _anatomy(result),
        "stars": _stellar(result),
        "points": _points(result),
    }
