"""What is refused: the kind of error, and what its message names (the thing, its value, its range)."""

from collections.abc import Callable
from typing import Any

import pytest


def refuses(kind: type[Exception], names: str, call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """Call, expect an error of a kind whose message matches; return the message."""
    with pytest.raises(kind, match=names) as error:
        call(*arguments, **options)
    return str(error.value)
