"""Range and step of the analogue-to-digital converter, from the readings of many pixels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import poisson

TOP_READINGS = 5
"""The highest reading, and the readings below it from which its count by chance is estimated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConverterRange:
    """Step and ends of a converter."""

    step_dn: int  # Largest number that divides all differences
    top_dn: int  # Highest reading
    top_count: int  # Number of highest readings
    top_limit: int  # Quantile of a Poisson variate with the mean count of the four readings below it
    zero_fraction: float  # Fraction of readings of 0


def converter_range(readings: Iterable[ArrayLike], *, false_alarm: float) -> ConverterRange:
    """Step, highest reading and fraction of zeros of groups of readings (any shape) [DN, whole numbers].

    ``top_count`` above ``top_limit``, of the stated false alarm probability: saturation below the end of the type.
    """
    counted = [np.unique(np.asarray(group), return_counts=True) for group in readings]
    values = [codes.astype(np.int64) for codes, _ in counted]
    top = max(int(codes[-1]) for codes in values)
    differences = np.concatenate([np.diff(codes) for codes in values])
    step = int(differences.min()) if differences.size else 1
    counts = np.zeros(TOP_READINGS, np.int64)
    for codes, (_, number) in zip(values, counted, strict=True):
        below = (top - codes) // step
        near = below < TOP_READINGS
        np.add.at(counts, below[near], number[near])
    expected = max(float(counts[1:].mean()), 1.0)
    zero = sum(int(number[codes == 0].sum()) for codes, number in counted)
    return ConverterRange(
        step_dn=int(np.gcd.reduce(differences)) if differences.size else 1,
        top_dn=top,
        top_count=int(counts[0]),
        top_limit=int(poisson.isf(false_alarm, expected)),
        zero_fraction=zero / sum(int(number.sum()) for _, number in counted),
    )
