"""Dr.Jit for all of render: ``from render.engine.jit import dr``.

Dr.Jit looks for LLVM once, at its first import, and reports faults on the process's standard error stream below Python.
The first import therefore happens here with that stream captured, so that `render.engine.Engine.start` can raise a
one-line error.
"""

from __future__ import annotations

import importlib
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from optics.errors import BackendError
from render.engine.cache import home_with_cache
from render.engine.llvm import point_to_llvm


def _loaded() -> tuple[Any, str]:
    """Dr.Jit, and what it printed while loading."""
    if "drjit" in sys.modules:
        return sys.modules["drjit"], ""
    point_to_llvm()
    try:
        with home_with_cache(), _caught_stderr() as stderr:
            module = importlib.import_module("drjit")
    except (ImportError, NameError) as error:  # NameError: drjit 1.4.0 fails over its own message
        raise BackendError(_why_not(error)) from None
    return module, "".join(stderr)


def _why_not(error: Exception) -> str:
    """Why Dr.Jit cannot be loaded, and what to do."""
    cause = error.__cause__ or error.__context__ or error
    reason = (str(cause).splitlines() or ["no reason given"])[0]
    missing = re.match(r"(lib[\w+-]+)\.so\.(\d+): cannot open", reason)
    advice = f"apt-get install {missing[1]}{missing[2]}" if missing else "pip install 'drjit==1.4.0'"
    return f"Dr.Jit cannot be loaded ({reason}); {advice}"


@contextmanager
def _caught_stderr() -> Iterator[list[str]]:
    """Catch what compiled code writes to file descriptor 2 meanwhile; the list is filled on leaving."""
    stderr: list[str] = []
    if sys.stderr is not None:
        sys.stderr.flush()
    saved = os.dup(2)
    with tempfile.TemporaryFile() as caught:
        os.dup2(caught.fileno(), 2)
        try:
            yield stderr
        finally:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(saved, 2)
            os.close(saved)
            caught.seek(0)
            stderr.append(caught.read().decode(errors="replace"))


if TYPE_CHECKING:
    import drjit as dr

    STDERR: str
else:
    dr, STDERR = _loaded()
