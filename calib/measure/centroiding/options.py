"""Options of a centroider with their allowed ranges."""

from __future__ import annotations

from dataclasses import field, fields
from typing import Any

from optics.errors import DomainError


def option(
    default: Any,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    unit: str = "",
) -> Any:
    """A dataclass field whose value must lie in a range; None is always allowed where it is the field's type."""
    return field(default=default, metadata={"above": above, "at_least": at_least, "at_most": at_most, "unit": unit})


def check_options(centroider: Any) -> None:
    """Refuse options out of range; to be called from ``__post_init__``."""
    for one in fields(centroider):
        value, bounds = getattr(centroider, one.name), one.metadata
        above, low, high = bounds.get("above"), bounds.get("at_least"), bounds.get("at_most")
        if value is None or (above is None and low is None and high is None):
            continue
        tests = {
            f"above {above}": above is None or value > above,
            f"at least {low}": low is None or value >= low,
            f"at most {high}": high is None or value <= high,
        }
        if not all(tests.values()):
            wanted = " and ".join(text for text in tests if not text.endswith("None"))
            unit = f" {bounds['unit']}" if bounds["unit"] else ""
            raise DomainError(f"{one.name} = {value}{unit}; it must be {wanted}{unit}")
