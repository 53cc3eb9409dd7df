"""The numbers of the comparison: every scalar, sensor by sensor."""

from __future__ import annotations

import numpy as np

from experiments.camera.comparison.study import SideBySide
from experiments.harness.quantities import Quantities

__all__ = ["describe"]


def describe(result: SideBySide) -> Quantities:
    """Quantities of a comparison."""
    q = Quantities()
    q.axis("sensor", np.array(result.names, dtype=object), "Sensor")
    for name, one in result.sensors[0].scalars.items():
        values = [sensor.scalars[name].value for sensor in result.sensors]
        stars = {sensor.prediction.config.star.magnitude_mag for sensor in result.sensors}
        label = one.label if len(stars) == 1 else one.label.partition(" of a star of")[0]
        q.add(name, values, label, unit=one.unit, dims="sensor", format=one.format, json=f"sensors[sensor].{name}")
    missed = [sum(not one.met for one in sensor.verdicts) for sensor in result.sensors]
    asked = [len(sensor.verdicts) for sensor in result.sensors]
    q.add("requirements", asked, "Requirements", dims="sensor", json="sensors[sensor].requirements")
    q.add("requirements_missed", missed, "Requirements that are missed", dims="sensor",
          json="sensors[sensor].requirements_missed")  # fmt: skip
    return q
