"""The numbers of a sweep: every scalar of the prediction at every point."""

from __future__ import annotations

import re

import numpy as np

from experiments.camera.sweep.study import MEASURED, SweepStudy
from experiments.harness.quantities import Quantities

__all__ = ["PLACES", "describe"]


PLACES = ("first", "second")


def describe(result: SweepStudy) -> Quantities:
    """Quantities of a sweep."""
    q = Quantities()
    for place, axis in zip(PLACES, result.axes, strict=False):
        name = axis.label[0].upper() + axis.label[1:]
        q.add(f"key_{place}", axis.key, "Key", json=f"keys.{place}")
        values = [point.at[result.axes.index(axis)] for point in result.points]
        q.add(place, values, name, unit=axis.unit, dims="point", format=".5g", key=axis.key.replace(".", "_"),
              json=f"points[point].{place}")  # fmt: skip
    for name, one in result.described.items():
        label = re.sub(r" of a star of .* mag$", "", one.label) if _star_is_swept(result) else one.label
        q.add(name, result.series(name), label, unit=one.unit, dims="point", format=one.format,
              json=f"points[point].{name}")  # fmt: skip
    q.add("meets", result.met, "Meets all that is required", dims="point", json="points[point].meets")
    refused = np.array([point.refusal for point in result.points], dtype=object)
    q.add("refusal", refused, "Refused", dims="point", json="points[point].refusal")
    if any(point.compared for point in result.points):
        for name in MEASURED:
            found = [point.measured(name) for point in result.points]
            one = result.described[name]
            q.add(f"measured_{name}", [value for value, _ in found], f"{q.dataset[name].attrs['long_name']}, in frames",
                  unit=one.unit, dims="point", error=[error for _, error in found], format=one.format,
                  json=f"points[point].measured_{name}")  # fmt: skip
    q.axis("crossing", np.array([one.name for one in result.crossings], dtype=object), "Requirement")
    q.add("crossed_at", np.array([one.at for one in result.crossings]), "Crossed at", unit=result.axes[0].unit,
          dims="crossing", format=".4g", json="")  # fmt: skip
    return q


def _star_is_swept(result: SweepStudy) -> bool:
    return any(axis.key == "star.magnitude_mag" for axis in result.axes)
