"""Tables of the temporal-error test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from experiments.laboratory.point_settings import METHOD_NAMES
from experiments.temporal.evaluate import ratio
from experiments.temporal.result import PUBLISHED_ARCSEC

if TYPE_CHECKING:
    from experiments.temporal.result import Result

__all__ = ["all_tables"]


def _main(result: Result) -> Table:
    """TE at the signal of the source by every centroider."""
    rows: list[tuple[Cell, ...]] = []
    for method in result.config.methods:
        dark, raw = result.nominal.te_arcsec(method), result.nominal.te_arcsec(method, 0, "raw")
        for axis, letter in enumerate("xy"):
            rows.append(
                (
                    METHOD_NAMES[method],
                    letter,
                    Measured(value=dark[axis].value, uncertainty=dark[axis].uncertainty),
                    Measured(value=raw[axis].value, uncertainty=raw[axis].uncertainty),
                    float(result.predicted_nominal.te_arcsec(method)[axis]),
                    float(result.predicted_nominal.sampled_te_arcsec(method)[axis]),
                    ratio(result.nominal, result.predicted_nominal, method, 0)[axis],
                )
            )
    bound = result.predicted_nominal.bound_te_arcsec()
    rows += [("Cramér-Rao", "xy"[a], None, None, float(bound[a]), None, None) for a in range(2)]
    return Table(
        columns=(
            "Centroider",
            "Axis",
            Column(name="Dark sub.", unit="″", key="dark_arcsec"),
            Column(name="Raw", unit="″", key="raw_arcsec"),
            Column(name="Influence", unit="″", key="influence_arcsec", format=".4f"),
            Column(name="Drawn noise", unit="″", key="drawn_arcsec", format=".4f"),
            Column(name="Ratio", key="ratio"),
        ),
        rows=rows,
        caption=f"Temporal error (3 σ) of one star at {result.config.source.signal_e:g} e⁻ per frame, dark-subtracted "
        f"and raw; published {PUBLISHED_ARCSEC[0]}″ in x and {PUBLISHED_ARCSEC[1]}″ in y.",
        note=f"{result.nominal.frames} frames of {len(result.nominal.light)} stars. Measured values carry the "
        "small-sample factor of a standard deviation, as the document's do; it is taken out of *Ratio*, measured over "
        "drawn noise.",
    )


def _levels(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for level, signal in enumerate(result.measured.levels_e):
        bound = result.predicted.bound_te_arcsec(level)
        for method in result.config.methods:
            dark, raw = (result.measured.te_arcsec(method, level, s) for s in ("dark", "raw"))
            linear, drawn = result.predicted.te_arcsec(method, level), result.predicted.sampled_te_arcsec(method, level)
            for axis, letter in enumerate("xy"):
                rows.append(
                    (
                        float(signal),
                        METHOD_NAMES[method],
                        letter,
                        Measured(value=dark[axis].value, uncertainty=dark[axis].uncertainty),
                        Measured(value=raw[axis].value, uncertainty=raw[axis].uncertainty),
                        float(linear[axis]),
                        float(drawn[axis]),
                        float(bound[axis]),
                    )
                )
    return Table(
        columns=(
            Column(name="Signal", unit="e⁻", key="signal_e", format=".0f"),
            "Centroider",
            "Axis",
            Column(name="Dark sub.", unit="″", key="dark_arcsec"),
            Column(name="Raw", unit="″", key="raw_arcsec"),
            Column(name="Influence", unit="″", key="influence_arcsec"),
            Column(name="Drawn noise", unit="″", key="drawn_arcsec"),
            Column(name="Cramér-Rao", unit="″", key="cramer_rao_arcsec"),
        ),
        rows=rows,
        caption="Temporal error (3 σ) against signal.",
    )


def _stars(result: Result) -> Table:
    """Every star at the signal of the source."""
    rows: list[tuple[Cell, ...]] = []
    first = result.config.methods[0]
    sigma, expected = result.nominal.sigma_px["dark"][first][0], result.predicted_nominal.sampled_px[first][0]
    for star, place in enumerate(result.nominal.light.photon_px):
        values = [*place, *sigma[star], *expected[star], *result.predicted_nominal.bound_px[0, star]]
        rows.append((star + 1, *(float(v) for v in values)))
    names = (("Light", "light"), ("Measured σ", "sigma"), ("Predicted σ", "predicted"), ("Cramér-Rao σ", "bound"))
    columns = [Column(name=f"{name} {a}", unit="px", key=f"{key}_{a}_px") for name, key in names for a in "xy"]
    return Table(
        columns=("Star", *columns),
        rows=rows,
        caption=f"Standard deviation of each star, {METHOD_NAMES[first]}, at {result.config.source.signal_e:g} e⁻.",
    )


def all_tables(result: Result) -> Mapping[str, Table]:
    """Tables of the result by file name."""
    return {"temporal_error": _main(result), "levels": _levels(result), "stars": _stars(result)}
