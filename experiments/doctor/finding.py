"""What a check found, and checks that cannot take the others down with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

__all__ = ["Check", "Finding", "examined"]

State = Literal["ok", "note", "fault"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One line of the examination."""

    name: str  # What was looked at
    text: str  # What was found
    # ``note``: works, but something is missing or could be better; ``fault``: something will not work
    state: State = "ok"
    advice: str = ""  # What to do; empty where nothing has to be done
    facts: dict[str, Any] = field(default_factory=dict)  # The same for programs: JSON types


Check = Callable[[], Iterable[Finding]]


def examined(checks: dict[str, Check]) -> list[Finding]:
    """Findings of all checks; one that fails is a finding itself."""
    found: list[Finding] = []
    for name, check in checks.items():
        try:
            found.extend(check())
        except Exception as error:
            said = f"{type(error).__name__}: {' '.join(str(error).split())}"
            found.append(Finding(name=name, state="fault", text=f"could not be looked at ({said})"))
    return found
