"""Tables of the comparison: one column per sensor."""

from __future__ import annotations

import math
from typing import Any

from experiments.camera.comparison.study import SideBySide
from experiments.camera.tables import ACCURACY, OPTICS, SKY
from experiments.harness.quantities import Outcome, shown_unit
from experiments.harness.tables import Column, Table, cell_text

__all__ = ["tables"]

MAIN = (
    "focal_length_mm", "f_number", "field_diagonal_deg", "pixel_arcsec", "limiting_magnitude_mag",
    "stars_worst_per_frame", "nea_arcsec", "single_star_arcsec", "attitude_cross_arcsec", "attitude_roll_arcsec",
    "update_rate_hz",
)  # fmt: skip


def tables(outcome: Outcome) -> dict[str, Table]:
    """Every table by name."""
    result: SideBySide = outcome.result
    everything = tuple(dict.fromkeys((*OPTICS, *SKY, *ACCURACY, *result.sensors[0].scalars)))
    made = {
        "sensors": _rows(outcome, MAIN, "Sensors side by side, by prediction."),
        "all": _rows(outcome, everything, "Everything that is predicted."),
    }
    if result.differences:
        rows = [(key, *(_plain(value) for value in values)) for key, values in result.differences.items()]
        made["differences"] = Table(
            columns=("Key", *_heads(result)), rows=rows, caption="In what the configurations differ."
        )
    if any(sensor.verdicts for sensor in result.sensors):
        made["requirements"] = _requirements(result)
    return made


def _heads(result: SideBySide) -> list[Column]:
    return [Column(name=name, key=f"sensor_{n}") for n, name in enumerate(result.names, start=1)]


def _rows(outcome: Outcome, names: tuple[str, ...], caption: str) -> Table:
    rows: list[tuple[Any, ...]] = []
    for name in names:
        one = outcome.quantity(name)
        cells = [cell_text(v, one.format) if math.isfinite(v) else "–" for v in one.values.tolist()]
        rows.append((one.label, shown_unit(one.unit), *cells))
    return Table(columns=("Quantity", "Unit", *_heads(outcome.result)), rows=rows, caption=caption)


def _requirements(result: SideBySide) -> Table:
    """Each sensor against what its own file asks."""
    keys = dict.fromkeys(one.key for sensor in result.sensors for one in sensor.verdicts)
    rows: list[tuple[Any, ...]] = []
    for key in keys:
        cells = []
        for sensor in result.sensors:
            one = next((v for v in sensor.verdicts if v.key == key), None)
            cells.append("not asked" if one is None else f"{'met' if one.met else 'MISSED'}, {one.margin_words}")
        label = result.sensors[0].scalars[key]
        rows.append((label.label, *cells))
    return Table(
        columns=("Requirement", *_heads(result)),
        rows=rows,
        caption="Each sensor against the requirements of its own file, with its margin.",
    )


def _plain(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, (tuple, list)):
        return ", ".join(_plain(one) for one in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
