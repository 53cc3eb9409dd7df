"""The sensor beside what is asked of it: requirement by requirement, met or missed, and by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from experiments.camera.records import Scalar
from experiments.laboratory.requirements import RequirementsConfig

__all__ = ["Verdict", "judge", "verdict_words"]


AT_LEAST = frozenset(
    {
        "field_deg",
        "field_diagonal_deg",
        "limiting_magnitude_mag",
        "stars_mean_per_frame",
        "stars_worst_per_frame",
        "update_rate_hz",
    }
)
"""Requirements that more is better of; of the others less is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One requirement."""

    key: str  # Of the requirement
    label: str  # Of the requirement
    unit: str  # Of the requirement
    format: str  # Of the requirement
    required: float  # Values; NaN where nothing could be predicted
    predicted: float  # Values; NaN where nothing could be predicted
    at_least: bool  # Whether the prediction has to be at least, or at most, what is required

    @property
    def met(self) -> bool:
        """Whether the sensor does what is asked; what could not be predicted does not."""
        return self.predicted >= self.required if self.at_least else self.predicted <= self.required

    @property
    def margin(self) -> float:
        """How much better than asked: relative, for magnitudes the difference; negative where it misses."""
        apart = self.predicted - self.required if self.at_least else self.required - self.predicted
        if self.unit == "mag" or self.required == 0.0:
            return apart
        return apart / abs(self.required)

    @property
    def margin_words(self) -> str:
        """The margin as readers see it."""
        if not math.isfinite(self.margin):
            return "–"
        sign = "+" if self.margin >= 0 else "\N{MINUS SIGN}"
        if self.unit == "mag":
            return f"{sign}{abs(self.margin):.2f} mag"
        return f"{sign}{100.0 * abs(self.margin):.0f} %"


def judge(asked: RequirementsConfig, scalars: Mapping[str, Scalar]) -> tuple[Verdict, ...]:
    """Verdicts on all requirements that are given, in the order of the table."""
    given = {key: value for key, value in asked.model_dump().items() if value is not None}
    return tuple(
        Verdict(
            key=key,
            label=scalars[key].label,
            unit=scalars[key].unit,
            format=scalars[key].format,
            required=float(value),
            predicted=scalars[key].value,
            at_least=key in AT_LEAST,
        )
        for key, value in given.items()
    )


def verdict_words(verdicts: tuple[Verdict, ...]) -> str:
    """The answer in a sentence."""
    if not verdicts:
        return "Nothing was asked of the sensor: its file has no table [requirements]."
    missed = [one for one in verdicts if not one.met]
    if not missed:
        return (
            f"The sensor meets all {len(verdicts)} requirements."
            if len(verdicts) > 1
            else "The sensor meets its requirement."
        )
    names = ", ".join(_inside(one.label) for one in missed)
    return f"The sensor misses {len(missed)} of {len(verdicts)} requirements: {names}."


def _inside(label: str) -> str:
    """A label inside a sentence: "field, shorter side", but "NEA"."""
    return label if label[1:2].isupper() else f"{label[0].lower()}{label[1:]}"
