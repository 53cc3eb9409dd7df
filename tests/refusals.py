"""What is refused: the kind of error, and what its message names (the thing, its value, its range)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def refuses(kind: type[Exception], names: str, call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """Call, expect an error of a kind whose message matches; return the message."""
    with pytest.raises(kind, match=names) as error:
        call(*arguments, **options)
    return str(error.value)


Row = tuple[str, Callable[[Path], Any], type[Exception], list[str]]
"""Name of a refusal, what is called with a folder, kind of error, words that its message holds."""


def rows(kind: type[Exception], call: Callable[..., Any], *cases: tuple[Any, ...]) -> list[Row]:
    """Rows of one function: cases are positional arguments, a mapping of keywords, and the words of the message."""
    table = []
    for *arguments, options, words in cases:
        label = f"{getattr(call, 'func', call).__name__} {words[0]}"
        table.append((label, lambda _, a=arguments, o=options: call(*a, **o), kind, words))
    return table
