"""Tables of the turntable calibration, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from experiments.turntable.case import Case
from experiments.turntable.quantities import UNKNOWNS
from optics.units import RAD_ARCSEC

__all__ = ["tables"]

SHOWN = {
    "rad": ("″", RAD_ARCSEC),
    **{f"1/mm{power}": (f"mm⁻{raised}", 1.0) for power, raised in (("", "¹"), ("2", "²"), ("4", "⁴"), ("6", "⁶"))},
}
"""Unit of an unknown -> how readers see it, and the factor to there."""


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name."""
    of_table = {}
    for key, case in zip(outcome.data.coords["table"].values, outcome.result.cases, strict=True):
        of_table[f"unknowns_{key}"] = _unknowns(outcome, key, case)
        of_table[f"correlation_{key}"] = _correlations(case)
    return of_table | _maps(outcome) | _sweeps(outcome) | _images()


def _unknowns(outcome: Outcome, key: str, case: Case) -> Table:
    rows = []
    for name in case.monte_carlo.names:
        one = outcome.quantity(name)
        unit, factor = SHOWN.get(one.unit, (one.unit, 1.0))
        estimate = outcome.value(name, table=key)
        truth, pull, bound, spread, rms_pull = (
            float(outcome.values(f"{name}_{part}", table=key))
            for part in ("truth", "pull", "bound", "monte_carlo", "rms_pull")
        )
        shown = Measured(value=estimate.value * factor, uncertainty=estimate.uncertainty * factor)
        rows.append((one.label, unit, truth * factor, shown, pull, bound * factor, spread * factor, rms_pull))
    return Table(
        columns=(
            "Unknown",
            Column(name="in", key="unit_of_row"),
            Column(name="Truth", key="truth"),
            Column(name="Rendered run", key="estimate"),
            Column(name="Pull", key="pull", format="+.2f"),
            Column(name="Cramér–Rao σ", key="bound"),
            Column(name="Monte-Carlo σ", key="monte_carlo"),
            Column(name="RMS pull", key="rms_pull", format=".3f"),
        ),
        rows=rows,
        caption=f"Unknowns on the {case.name} table.",
        note="Truth of the camera: the model fitted to the traced rays without noise; of star, installation (θ), axes: "
        f"as set. Uncertainties are 1 σ of the estimator's covariance. Monte-Carlo: {case.monte_carlo.runs} runs on "
        "coordinates.",
    )


def _correlations(case: Case) -> Table:
    names, matrix = case.monte_carlo.names, case.reductions["estimated"].correlation
    rows = [(name, *line) for name, line in zip(names, matrix.tolist(), strict=True)]
    columns = [Column(name=UNKNOWNS[name], key=name, format=".4f") for name in names]
    return Table(columns=("Unknown", *columns), rows=rows, caption=f"Correlations on the {case.name} table.")


def _more(outcome: Outcome, spec: Pivot, rows: Mapping[str, np.ndarray]) -> Table:
    """A pivot with further rows of one number per table."""
    table = pivot(outcome.data, spec)
    further: list[tuple[Cell, ...]] = [(label, *(float(value) for value in values)) for label, values in rows.items()]
    return replace(table, rows=[*table.rows, *further])


def _short_heads(outcome: Outcome, spec: Pivot) -> Table:
    """A pivot across the tables, whose names in the heads of columns are their numbers of axes."""
    table = pivot(outcome.data, spec)
    heads = list(table.heads)
    for name, short in zip(outcome.names("table"), ("(2)", "(3)"), strict=True):
        heads = [replace(head, name=head.name.replace(name, short)) for head in heads]
    return replace(table, columns=heads)


def _maps(outcome: Outcome) -> dict[str, Table | Pivot]:
    """Where the map error comes from."""
    predicted = {"… predicted": outcome.values("map_predicted_arcsec")}
    others: Sequence[str] = ("ignored", "known")
    reduced = {outcome.label("reduction", one): outcome.values("map_error_arcsec", reduction=one) for one in others}
    split = Pivot(
        rows="split",
        across="table",
        columns="map_split_arcsec",
        caption="Where the map error comes from.",
        note="RMS length of the line-of-sight error over the detector after the best rotation, one realisation each.",
    )
    shares = Pivot(
        rows="cause",
        across="table",
        columns="noise_shares_arcsec",
        caption="What the noise contributes to the map error, predicted.",
        note="Each noise carried through the best estimator; the squares add up to the Cramér–Rao bound.",
    )
    knowledge = Pivot(
        rows="known",
        across="table",
        columns="known_x0_px known_y0_px known_map_arcsec",
        caption="What it would be worth to know more (Cramér–Rao).",
        note="(2), (3): on the table of two, of three axes. Map: RMS length of the error after the best rotation.",
    )
    return {
        "map_error": _more(outcome, split, predicted | reduced),
        "noise_shares": _more(outcome, shares, {"together": outcome.values("map_bound_arcsec")}),
        "knowledge": _short_heads(outcome, knowledge),
        "lenses": Pivot(
            rows="lens",
            hidden="lens",
            columns="lens_label lens_field_deg lens_rms_arcsec lens_max_arcsec lens_max_px",
            caption="What the camera model leaves of a lens: fitted to noise-free rays over the whole detector.",
        ),
    }


def _sweeps(outcome: Outcome) -> dict[str, Table | Pivot]:
    """Over reading noise, non-orthogonality and field."""
    sigma_px = float(outcome.values("field_sigma_px"))
    return {
        "reading_sweep": Pivot(
            rows="reading",
            columns="reading_map_arcsec reading_bound_arcsec reading_ratio reading_pull reading_runs",
            caption="Map error against the reading noise, two-axis table.",
        ),
        "lean_sweep": Pivot(
            rows="lean",
            columns="lean_ignored_arcsec lean_ignored_chi2 lean_estimated_arcsec",
            caption="Map error against the non-orthogonality, two-axis table.",
        ),
        "field_sweep": Pivot(
            rows="field",
            columns="field_x0_px field_x0_arcsec field_inflation field_map_arcsec field_rolled_x0_px "
            "field_rolled_map_arcsec field_condition",
            caption="The near-degeneracy over the field of view (Cramér–Rao).",
            note=f"Ideal cameras of 2048 × 2048 px, 13 × 13 places, images good to {sigma_px:.3g} px per axis, all "
            "unknowns, perfect tables. Inflated: σ(x₀) over what it would be with everything else known. Rolled: "
            "quarter turns of a third axis from place to place. Map: RMS length after the best rotation.",
        ),
    }


def _images() -> dict[str, Table | Pivot]:
    """Images, and the star vectors that are made of them."""
    angles = " ".join(f"{name}_{number}_deg" for name in ("true", "reading") for number in (1, 2, 3))
    return {
        "vectors": Pivot(
            rows="table",
            across="axis",
            columns="places centroid_error_px centroid_predicted_px vector_along_x_arcsec vector_across_arcsec",
            caption="Centroids against the traced rays, and star vectors in the table's initial frame.",
            note="Centroid errors of the mean over the frames, RMS over the places; prediction from photons, read "
            "noise, dark frames and PRNU. Star vectors (S300): scatter about their mean, along the laboratory's X and "
            "across.",
        ),
        "places": Pivot(
            rows="table place",
            hidden="place",
            across="axis",
            columns=f"wanted_px {angles} bundle_px place_centroid_px sigma_px residual_px",
            caption="All places.",
        ),
    }
