"""What a user asks of a sensor: the table ``[requirements]`` of a sensor file."""

from __future__ import annotations

from experiments.harness.config import StrictModel

__all__ = ["RequirementsConfig"]


class RequirementsConfig(StrictModel):
    """What is asked of the sensor; every key may be left out."""
