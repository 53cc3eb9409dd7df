"""Dr.Jit array types by backend name, for the parts that need no Mitsuba."""

from __future__ import annotations

import importlib
from typing import Any

from render.engine.variant import choose_backend

__all__ = ["array_types"]


def array_types(backend: str = "llvm") -> Any:
    """Module of array types without derivatives.

    Parameters
    ----------
    backend : {"auto", "llvm", "cuda"}
        ``llvm`` runs on the processor, ``cuda`` on an NVIDIA GPU, ``auto`` takes the GPU if there is one.

    Returns
    -------
    module
        ``drjit.llvm`` or ``drjit.cuda``.

    Raises
    ------
    BackendError
        The backend does not exist or the machine lacks it.
    """
    return importlib.import_module(f"drjit.{choose_backend(backend)}")
