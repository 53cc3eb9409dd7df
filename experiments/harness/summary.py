"""``summary.json``: configuration, results and criteria, as valid JSON without NaN."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import operator
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel

from optics.errors import DomainError

Relation = Literal["<=", "<", ">=", ">"]
_RELATIONS = {"<=": operator.le, "<": operator.lt, ">=": operator.ge, ">": operator.gt}
_NOISE = ("false_alarm", "chance", "notices")
_SIGNS = {"<=": "≤", "<": "<", ">=": "≥", ">": ">"}

NOTICED_PART = 0.25
"""Largest relative error at which a criterion may fail in only half of all runs."""

CRITERIA_NOTE = (
    "False alarm: probability that noise alone makes the criterion fail. Notices: relative error at which the "
    f"criterion fails in half of all runs. Above {100 * NOTICED_PART:.0f} % the sample is too small: a "
    "value within the limit is shown, not judged; a value beyond the limit fails."
)
"""Small print of the table of criteria."""


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A number that has to stay on one side of a limit, or near to a value."""

    name: str  # What is judged, in words a reader of the report understands
    value: float  # Same unit
    limit: float  # Same unit
    unit: str = ""  # Unit of both; "" for a pure number
    relation: Relation = "<="  # ``value relation limit`` must be true
    about: float | None = None  # Where the value should be; given one, ``abs(value - about) <= limit`` must be true
    advice: str = ""  # What is likely wrong where it does not hold
    false_alarm: float | None = None  # Probability that it fails by noise alone, if that is known
    chance: float | None = None  # Probability that noise alone takes the value as far, if that is known
    notices: float | None = None  # Relative error at which it fails in half of all runs, if known

    def __post_init__(self) -> None:
        if self.relation not in _RELATIONS:
            raise DomainError(f"Criterion {self.name!r}: relation {self.relation!r} is none of {' '.join(_RELATIONS)}")
        if math.isnan(self.limit):
            raise DomainError(f"Criterion {self.name!r}: the limit is NaN")
        if self.about is not None and (math.isnan(self.about) or self.relation != "<="):
            raise DomainError(f"Criterion {self.name!r}: about {self.about} {self.relation} {self.limit} says nothing")

    @property
    def passed(self) -> bool | None:
        """Whether it holds; NaN does not. None: within a limit that would not reveal an error of 25 %."""
        distance = self.value if self.about is None else abs(self.value - self.about)
        if not _RELATIONS[self.relation](distance, self.limit):
            return False
        return None if self.notices is not None and self.notices > NOTICED_PART else True

    @property
    def failed(self) -> bool:
        """Whether it does not hold."""
        return self.passed is False

    @property
    def demand(self) -> str:
        """Limit of the value, e.g. "≤ 3" or "1 ± 0.24"."""
        if self.about is not None:
            return f"{self.about:.6g} ± {self.limit:.4g}"
        return f"{_SIGNS[self.relation]} {self.limit:.4g}"


def percent(part: float | None) -> str:
    """A probability or a relative error for the table of criteria, "" for None."""
    if part is not None and part > 10.0:
        return "> 1000 %"
    return "" if part is None else f"{100 * part:.2g} %" if part < 1 else f"{100 * part:.0f} %"


def farthest_from_one(ratios: Any) -> float:
    """The ratio farthest from 1, the value of a criterion about 1; NaN if any ratio is NaN."""
    flat = np.ravel(ratios)
    return float(flat[np.argmax(np.abs(flat - 1.0))])


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A number with its unit, its uncertainty and the number of samples behind it."""

    value: float  # The number
    unit: str = ""  # Its unit; "" for a pure number
    uncertainty: float | None = None  # One standard deviation, same unit
    n: int | None = None  # Samples behind it


def measured(values: Any, uncertainty: Any, n: int | None = None, unit: str = "") -> Any:
    """Array of `Measured`, shaped as ``values``; a single one of a number."""
    every = [
        Measured(value=float(value), unit=unit, uncertainty=float(error), n=n)
        for value, error in np.nditer([np.asarray(values, float), np.asarray(uncertainty, float)])
    ]
    array = np.empty(len(every), dtype=object)
    array[:] = every
    shaped = array.reshape(np.broadcast_shapes(np.shape(values), np.shape(uncertainty)))
    return shaped if shaped.ndim else shaped.item()


def verdict_line(criteria: Sequence[Criterion], judged: str = "simulation") -> str:
    """Whether the simulation, or a reduction of frames, is consistent, and how many criteria hold.

    It says nothing about whether a sensor is good enough: that is what requirements are for (`experiments.camera`).
    """
    if not criteria:
        return "No criteria were set."
    failed, too_small = (sum(criterion.passed is state for criterion in criteria) for state in (False, None))
    count = len(criteria) - too_small
    small = f"the sample is too small to reveal an error of {100 * NOTICED_PART:.0f} %"
    if count == 0:
        return f"The {judged} is not judged: {small}."
    unjudged = f"; {too_small} not judged: {small}" if too_small else ""
    if count == 1:
        holds = "does not hold" if failed else "holds"
        return f"The {judged} is {'not ' if failed else ''}consistent: the criterion {holds}{unjudged}."
    if failed == 0:
        return f"The {judged} is consistent: all {count} criteria hold{unjudged}."
    not_so = f"{failed} of {count} criteria {'does' if failed == 1 else 'do'} not hold"
    return f"The {judged} is not consistent: {not_so}{unjudged}."


def criteria_lines(criteria: Sequence[Criterion], width: int = 80) -> list[str]:
    """Criteria for a terminal, two lines each or more: whether it holds and what; value, limit, power."""
    if not criteria:
        return []
    holds = {True: "yes", False: "NO", None: "–"}
    lines = ["Criteria"]
    for criterion in criteria:
        lines += textwrap.wrap(
            criterion.name, width, initial_indent=f"{holds[criterion.passed]:<5}", subsequent_indent=5 * " "
        )
        number = f"{criterion.value:.4g} ({criterion.demand}){f' {criterion.unit}' if criterion.unit else ''}"
        rates = {"false alarm": percent(criterion.false_alarm), "notices": percent(criterion.notices)}
        power = ", ".join(f"{name} {text}" for name, text in rates.items() if text)
        numbers = f"     {number:<38} {power}".rstrip()
        lines += [numbers] if len(numbers) <= width else [f"     {number}", f"     {power}"]
    note = CRITERIA_NOTE if any(criterion.false_alarm is not None for criterion in criteria) else ""
    return lines + textwrap.wrap(note, width)


def summary(
    experiment: str,
    config: BaseModel,
    results: Mapping[str, Any],
    coordinates: Mapping[str, Any],
    criteria: Sequence[Criterion],
) -> dict[str, Any]:
    """The content of ``summary.json``."""
    settings = config.model_dump(mode="json")
    return {
        "experiment": experiment,
        "seed": settings.get("seed"),
        "config": to_json(settings),
        "results": to_json(results),
        "coordinates": to_json(coordinates),
        "criteria": [
            {
                "name": criterion.name,
                "value": to_json(criterion.value),
                "limit": to_json(criterion.limit),
                "unit": criterion.unit,
                "passed": criterion.passed,
            }
            | ({} if criterion.about is None else {"about": to_json(criterion.about)})
            | {key: to_json(number) for key in _NOISE if (number := getattr(criterion, key)) is not None}
            | ({"advice": criterion.advice} if criterion.failed and criterion.advice else {})
            for criterion in criteria
        ],
    }


def to_json(value: Any) -> Any:  # noqa: PLR0911  # one return per type
    """Plain JSON types for a value: NumPy to lists, records to tables, NaN and infinity to null."""
    match value:
        case None | bool() | str():
            return value if not isinstance(value, enum.Enum) else value.value
        case enum.Enum():
            return to_json(value.value)
        case np.ndarray() | np.generic():
            if np.iscomplexobj(value):
                raise TypeError("complex numbers have no place in JSON; give two real numbers")
            return to_json(value.tolist())
        case int():
            return int(value)
        case float():
            return float(value) if math.isfinite(value) else None
        case BaseModel():
            return to_json(value.model_dump())
        case Mapping():
            return {str(to_json(key)): to_json(item) for key, item in value.items()}
        case PurePath():
            return value.name
        case set() | frozenset():
            return [to_json(item) for item in sorted(value)]
        case Sequence() if not isinstance(value, bytes):
            return [to_json(item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_json(getattr(value, field.name)) for field in dataclasses.fields(value)}
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def dumps(value: Any) -> str:
    """JSON text of any value that `to_json` takes; short lists stay on one line."""
    return _pretty(to_json(value), 0) + "\n"


def _pretty(value: Any, indent: int, width: int = 100) -> str:
    flat = json.dumps(value, allow_nan=False, ensure_ascii=False)
    if not isinstance(value, (list, dict)) or not value or (indent and len(flat) + indent <= width):
        return flat
    pad = " " * (indent + 2)
    if isinstance(value, list):
        lines = [pad + _pretty(item, indent + 2, width) for item in value]
        return "[\n" + ",\n".join(lines) + "\n" + " " * indent + "]"
    lines = [
        f"{pad}{json.dumps(key, ensure_ascii=False)}: {_pretty(item, indent + 2, width)}" for key, item in value.items()
    ]
    return "{\n" + ",\n".join(lines) + "\n" + " " * indent + "}"
