"""Check of the focus of a lens; imports nothing slow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from optics.errors import StarbenchError


def in_focus(lens: Any) -> bool:
    """Whether a lens is in focus by definition: an ideal or a measured lens."""
    if isinstance(lens, Mapping) or hasattr(lens, "focal_length_mm"):
        return True
    if not (isinstance(lens, str) and lens.lower().endswith(".toml")):
        return False
    from optics.validate import read_toml

    try:
        return read_toml(lens).get("kind") == "measured"
    except StarbenchError:
        return False
