"""Common quantities of the tests with point targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from experiments.harness.quantities import Quantities
from experiments.laboratory.bench.centroid_methods import MethodLabels


def point_quantities(methods: Sequence[Any]) -> Quantities:
    """Quantities with the dimensions ``method`` (centroiders) and ``axis`` (x along a row, y along a column)."""
    q = Quantities()
    q.axis("method", list(methods), "Centroider", names=MethodLabels())
    q.axis("axis", ["x", "y"], "Axis")
    return q
