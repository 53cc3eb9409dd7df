"""Start the renderer and tell what happens, a line of JSON per step: a process of its own, as LLVM may end the process.

``python -m experiments.doctor.probe`` is what `experiments.doctor.engine` runs and reads.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

__all__ = ["driver", "loaded_library", "main"]

_CUDA = {"win32": "nvcuda.dll"}  # elsewhere libcuda.so.1


def main() -> int:
    """Each step says what it has found; the process ends with the first that fails."""
    try:
        for step in (_dr_jit, _gpu, _compiled, _mitsuba):
            _say(step())
    except Exception as error:
        _say({"error": " ".join(str(error).split()) or type(error).__name__})
        return 1
    return 0


def _say(found: dict[str, Any]) -> None:
    print(json.dumps(found), flush=True)


def _dr_jit() -> dict[str, Any]:
    from optics.errors import BackendError
    from render.engine.jit import SAID, dr
    from render.engine.llvm import check_llvm, llvm_version

    found = {"drjit": version("drjit"), "llvm": llvm_version(), "library": loaded_library(), "llvm_error": None}
    try:
        check_llvm(dr.detail.llvm_version(), version("drjit"), said=SAID)
    except BackendError as error:
        found["llvm_error"] = str(error)
    return {**found, "cuda": bool(dr.has_backend(dr.JitBackend.CUDA)), "threads": dr.thread_count()}


def _gpu() -> dict[str, Any]:
    return {"driver": driver()}


def _compiled() -> dict[str, Any]:
    from render.engine import Engine

    engine, start = Engine.start("auto"), time.perf_counter()
    values = engine.types.Float64([1.0, 2.0, 3.0])
    square = float((values * values)[2])
    return {"variant": engine.variant, "computed": square == 9.0, "compiled_s": time.perf_counter() - start}


def _mitsuba() -> dict[str, Any]:
    from render.engine import Engine

    return {"mitsuba": version("mitsuba"), "variants": Engine.active().mitsuba.variants()}


def loaded_library() -> str | None:
    """Path of the LLVM library that this process has loaded, as far as the system tells."""
    maps = Path("/proc/self/maps")
    if maps.exists():
        for line in maps.read_text(encoding="utf-8", errors="replace").splitlines():
            if "LLVM" in (path := line.split(maxsplit=5)[-1]):
                return path
    return os.environ.get("DRJIT_LIBLLVM_PATH")


def driver(name: str | None = None) -> dict[str, Any] | None:
    """CUDA version that NVIDIA's driver offers and names of the GPUs (CUDA driver API); None without a driver."""
    try:
        cuda = ctypes.CDLL(name or _CUDA.get(sys.platform, "libcuda.so.1"))
        cuda.cuInit, cuda.cuDriverGetVersion, cuda.cuDeviceGetCount, cuda.cuDeviceGetName  # noqa: B018
    except (OSError, AttributeError):
        return None
    status = cuda.cuInit(0)
    number, count = ctypes.c_int(), ctypes.c_int()
    cuda.cuDriverGetVersion(ctypes.byref(number))
    cuda.cuDeviceGetCount(ctypes.byref(count))
    names = []
    for device in range(count.value):
        text = ctypes.create_string_buffer(256)
        cuda.cuDeviceGetName(text, 256, device)
        names.append(text.value.decode(errors="replace"))
    return {"status": status, "cuda": f"{number.value // 1000}.{number.value % 1000 // 10}", "devices": names}


if __name__ == "__main__":
    sys.exit(main())
