"""Tables of a sweep."""

from __future__ import annotations

from typing import Any

from experiments.camera.sweep.quantities import PLACES
from experiments.camera.sweep.study import MEASURED, STAR, SweepStudy
from experiments.camera.verdicts import AT_LEAST
from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome, shown_unit
from experiments.harness.tables import Column, Table, cell_text

__all__ = ["tables"]


SHORT = {
    "limiting_magnitude_mag": "Limit",
    "single_star_arcsec": "Star",
    "attitude_cross_arcsec": "Across",
    "attitude_roll_arcsec": "Roll",
    "stars_worst_per_frame": "Stars",
}
"""Heads of the table that fits a terminal."""


def tables(outcome: Outcome) -> dict[str, Table | Pivot]:
    """Every table by name."""
    result: SweepStudy = outcome.result
    at = PLACES[: len(result.axes)]
    measured = [f"measured_{name}" for name in MEASURED if f"measured_{name}" in outcome.data]
    made: dict[str, Table | Pivot] = {
        "sweep": Pivot(
            rows="point",
            hidden="point",
            columns=" ".join((*at, *SHORT, *(["meets"] if result.required else []))),
            heads={name: _short(outcome, name) for name in SHORT} | {"meets": Column(name="Meets", key="meets")},
            caption="Limiting magnitude, single-star accuracy, attitude across and roll (medians over the sky), stars "
            "per frame in the worst 1 % of the sky.",
            note=_why_empty(result),
        ),
        "all": _pivot((*at, *result.described, *measured, "meets", "refusal"), "Everything that is predicted."),
    }
    if measured:
        made["measured"] = _pivot((*at, *measured), "What rendered frames make of it; one standard deviation.")
    if result.required:
        made["crossings"] = _crossings(outcome)
    return made


def _why_empty(result: SweepStudy) -> str:
    """Why accuracies of the star are missing; "" where they are not."""
    if not result.saturated:
        return ""
    return (
        f"– below Star: a star of `{STAR}` = {result.config.star.magnitude_mag:g} saturates there, at "
        f"{result.saturated} of {len(result.points)} points; column saturation_mag of all.ecsv has the brightest that "
        "does not."
    )


def _short(outcome: Outcome, name: str) -> Column:
    one = outcome.quantity(name)
    return Column(name=SHORT[name], unit=shown_unit(one.unit), key=one.key, format=one.format)


def _pivot(names: tuple[str, ...], caption: str) -> Pivot:
    return Pivot(rows="point", hidden="point", columns=" ".join(names), caption=caption)


def _crossings(outcome: Outcome) -> Table:
    """Requirement by requirement, where it is met."""
    result: SweepStudy = outcome.result
    rows: list[tuple[Any, ...]] = []
    for name, required in result.required.items():
        one = result.described[name]
        sign = "≥" if name in AT_LEAST else "≤"
        met = [next((v.met for v in point.verdicts if v.key == name), False) for point in result.points]
        rows.append((one.label, name, f"{sign} {required:g}", shown_unit(one.unit), _where(result, name), sum(met)))
    columns = (
        "Requirement",
        Column(name="Key", key="key"),
        Column(name="Required", key="required"),
        Column(name="Unit", key="unit"),
        Column(name="Met", key="met"),
        Column(name="Points that meet it", key="points", format="d"),
    )
    return Table(columns=columns, rows=rows, caption=f"Where the requirements are met, of {len(result.points)} points.")


def _where(result: SweepStudy, name: str) -> str:
    """In words, e.g. "above 0.13 s"."""
    met = [next((v.met for v in point.verdicts if v.key == name), False) for point in result.points]
    if all(met):
        return "everywhere"
    if not any(met):
        return "nowhere"
    if len(result.axes) > 1:
        return "see the map"
    unit = shown_unit(result.axes[0].unit)
    words = [f"{'above' if c.above else 'below'} {cell_text(c.at, '.3g')} {unit}".strip() for c in result.crossings
             if c.name == name]  # fmt: skip
    return ", ".join(words) or "in parts"
