"""Dr.Jit array types by backend name, for the parts that need no Mitsuba."""

from __future__ import annotations

import importlib
from typing import Any

from optics.errors import BackendError
from render.variant import BACKENDS, check_llvm

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
    if backend not in BACKENDS:
        raise BackendError(f"backend = {backend!r} does not exist; choose one of {', '.join(BACKENDS)}")
    dr: Any = importlib.import_module(
        "drjit"
    )  # not at import time: `render.variant` may still have to say where LLVM is

    has_gpu = bool(dr.has_backend(dr.JitBackend.CUDA))
    if backend == "cuda" and not has_gpu:
        raise BackendError("backend 'cuda' is not available: no NVIDIA GPU or driver was found; use backend 'llvm'")
    if backend == "cuda" or (backend == "auto" and has_gpu):
        return importlib.import_module("drjit.cuda")
    check_llvm(dr.detail.llvm_version(), dr.__version__)
    return importlib.import_module("drjit.llvm")
