"""Errors of the caller. Effects on data (lost rays, saturated stars) are recorded as data, not raised.

Every message is one line: the fault, the value with its unit, the allowed range, the remedy.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class StarbenchError(ValueError):
    """Base of all errors raised on purpose; the command line turns it into one line and exit code 2."""


class ConfigError(StarbenchError):
    """A file, key, name or option is missing, misspelt or of the wrong kind."""


class DomainError(StarbenchError):
    """A value lies outside the range in which the model holds."""


class ConvergenceError(StarbenchError):
    """An iteration ended without reaching its tolerance."""


class BackendError(StarbenchError):
    """The compute backend (LLVM, CUDA) is missing or of a version known to fail."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ConfigError:
    """Error for a name that is not in a registry, with the nearest known names."""
    names = sorted(known)
    folded = {candidate.casefold(): candidate for candidate in names}
    near = [folded[match] for match in difflib.get_close_matches(str(name).casefold(), folded, n=3, cutoff=0.5)]
    hint = (
        f"did you mean {' or '.join(near)}?"
        if near
        else f"known: {', '.join(names[:12])}{' and more' if len(names) > 12 else ''}"
    )
    shown = repr(name) if len(repr(name)) <= 80 else repr(name)[:77] + "..."
    return ConfigError(f"unknown {kind} {shown}; {hint}")
