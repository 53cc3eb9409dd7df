"""Options of a centroider with their allowed ranges."""

from __future__ import annotations

import operator
from dataclasses import field, fields
from typing import Any

from optics.errors import DomainError


def option(default: Any, *, unit: str = "", **bounds: float) -> Any:
    """A dataclass field with bounds ``above``, ``at_least``, ``at_most``; None is always allowed as a value."""
    return field(default=default, metadata={"unit": unit, **bounds})


def check_options(centroider: Any) -> None:
    """Refuse options out of range; to be called from ``__post_init__``."""
    compare = {"above": operator.gt, "at_least": operator.ge, "at_most": operator.le}
    for field_ in fields(centroider):
        value, metadata = getattr(centroider, field_.name), field_.metadata
        bounds = {name: metadata[name] for name in compare if metadata.get(name) is not None}
        if value is not None and not all(compare[name](value, bound) for name, bound in bounds.items()):
            allowed = " and ".join(f"{name.replace('_', ' ')} {bound}" for name, bound in bounds.items())
            unit = f" {metadata['unit']}" if metadata["unit"] else ""
            raise DomainError(f"{field_.name} = {value}{unit}; it must be {allowed}{unit}")
