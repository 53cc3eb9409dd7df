"""The one place that chooses where Dr.Jit runs: `use_backend` checks the machine, then sets Mitsuba's variant.

Dr.Jit looks for LLVM once, when it is first imported, and says what went wrong on the standard error stream of the
process, below Python. The first import therefore happens here, with that stream caught, so that a caller sees one
sentence that says what to do.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import re
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from glob import glob
from pathlib import Path
from typing import Any

from optics.errors import BackendError

__all__ = ["BACKENDS", "active_backend", "check_llvm", "choose_backend", "find_llvm", "llvm_version", "use_backend"]

BACKENDS = ("auto", "llvm", "cuda")

_LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
_INSTALL = "install it with: apt-get install libllvm15"
_OLDEST_LLVM = 15
# Measured: drjit 1.5.0 (mitsuba 3.9.1) emits fmaximum/fminimum, which LLVM 15 and 16 cannot select for x86-64; LLVM
# then ends the process ("LLVM ERROR: Cannot select"), which no caller can catch. LLVM 19 has it.
_ABORTING_DRJIT = (1, 5)
_OLDEST_LLVM_FOR_ABORTING_DRJIT = 17
# Where Dr.Jit 1.4 looks by itself, and where else distributions, conda and Homebrew put the library.
_SEARCHED_BY_DRJIT = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib/wsl/lib")
_SEARCHED_HERE = (
    *_SEARCHED_BY_DRJIT,
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
)
_NUMBERED = re.compile(r"libLLVM(?:-|\.so\.|\.)(\d+)")


def use_backend(backend: str = "auto", *, suffix: str = "ad_mono") -> str:
    """Make Mitsuba and Dr.Jit ready on a backend; does nothing when it is active already.

    Parameters
    ----------
    backend : {"auto", "llvm", "cuda"}
        ``llvm`` runs on the processor, ``cuda`` on an NVIDIA GPU; ``auto`` keeps what is active already, otherwise it
        takes the GPU if there is one.
    suffix : str
        Rest of the variant's name, e.g. ``"ad_mono"``, ``"ad_spectral"``, ``"ad_rgb"``.

    Returns
    -------
    str
        Name of the active variant, e.g. ``"llvm_ad_mono"``.

    Raises
    ------
    BackendError
        LLVM or CUDA is missing, LLVM is too old or known to abort with the installed Dr.Jit, or there is no such
        backend or variant.

    Notes
    -----
    Plugins are registered per variant: register them after this call, and again when the returned name changes.
    """
    active = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
    if backend == "auto" and active in (f"llvm_{suffix}", f"cuda_{suffix}"):
        return str(active)
    chosen = choose_backend(backend)
    mi = _import_mitsuba()
    variant = f"{chosen}_{suffix}"
    if variant not in mi.variants():
        known = ", ".join(sorted(name for name in mi.variants() if name.startswith(chosen)))
        raise BackendError(f"Mitsuba has no variant {variant!r}; it has {known}")
    if mi.variant() != variant:
        mi.set_variant(variant)
    return variant


def active_backend() -> str:
    """Backend, "llvm" or "cuda", of the variant that `use_backend` has set."""
    import mitsuba as mi

    return str(mi.variant()).split("_", maxsplit=1)[0]


def choose_backend(backend: str = "auto") -> str:
    """Which of the two engines to use, after a check that it works here; sets nothing.

    Parameters
    ----------
    backend : {"auto", "llvm", "cuda"}
        ``auto`` takes the GPU if there is one.

    Returns
    -------
    str
        ``"llvm"`` or ``"cuda"``; ``drjit.llvm`` or ``drjit.cuda`` can be imported then.

    Raises
    ------
    BackendError
        As `use_backend`.
    """
    if backend not in BACKENDS:
        raise BackendError(f"backend = {backend!r} does not exist; choose one of {', '.join(BACKENDS)}")
    dr, said = _import_drjit()
    has_gpu = bool(dr.has_backend(dr.JitBackend.CUDA))
    if backend == "cuda" and not has_gpu:
        raise BackendError("backend 'cuda' is not available: no NVIDIA GPU or driver was found; use backend 'llvm'")
    if backend == "cuda" or (backend == "auto" and has_gpu):
        return "cuda"
    check_llvm(dr.detail.llvm_version(), dr.__version__, said=said)
    return "llvm"


def llvm_version() -> str | None:
    """Version of the LLVM library in use, e.g. ``"15.0.6"``; None when Dr.Jit is not loaded or runs without it."""
    dr = sys.modules.get("drjit")
    if dr is None:
        return None
    version = tuple(dr.detail.llvm_version())
    return None if version[0] < 0 else ".".join(str(part) for part in version)


def check_llvm(version: Iterable[int], drjit_version: str, *, said: str = "") -> None:
    """Refuse an LLVM that is missing, too old, or known to end the process with this Dr.Jit.

    Parameters
    ----------
    version : iterable of int
        ``drjit.detail.llvm_version()``: (major, minor, patch), -1 where there is no usable library.
    drjit_version : str
        ``drjit.__version__``.
    said : str
        What Dr.Jit printed while loading; it names the version of a library that it refused.

    Raises
    ------
    BackendError
        With the command that installs a library that works.
    """
    major = next(iter(version))
    refused = re.search(r"LLVM version \((\d+)\)", said)
    if major < 0 and refused:
        major = int(refused.group(1))
    if major < 0:
        raise BackendError(f"backend 'llvm' needs the LLVM library, which {_where_missing()}; {_INSTALL}")
    if major < _OLDEST_LLVM:
        raise BackendError(f"LLVM {major} is too old: version {_OLDEST_LLVM} or newer is needed; {_INSTALL}")
    release = tuple(int(part) for part in re.findall(r"\d+", drjit_version)[:2])
    if release >= _ABORTING_DRJIT and major < _OLDEST_LLVM_FOR_ABORTING_DRJIT:
        raise BackendError(
            f"drjit {drjit_version} ends the process on LLVM {major} ('Cannot select: fmaximum'); "
            "install the pinned pair with: pip install 'mitsuba==3.9.0' 'drjit==1.4.0', or LLVM 19 with: "
            "apt-get install libllvm19"
        )


def find_llvm(folders: Iterable[str | Path]) -> Path | None:
    """Newest LLVM library of a usable version in the given folders, by its file name.

    Parameters
    ----------
    folders : iterable of path
        Folders to look into; wildcards are expanded.

    Returns
    -------
    pathlib.Path or None
        E.g. ``libLLVM-15.so``, ``libLLVM-15.so.1``, ``libLLVM.so.19.1``; None if there is none.
    """
    best: tuple[int, Path] | None = None
    for folder in filter(None, map(str, folders)):
        for name in sorted(glob(f"{folder}/libLLVM*")):
            match = _NUMBERED.match(Path(name).name)
            if match is None or ".so" not in name or not Path(name).is_file():
                continue
            major = int(match.group(1))
            if major >= _OLDEST_LLVM and (best is None or major > best[0]):
                best = (major, Path(name))
    return None if best is None else best[1]


def _where_missing() -> str:
    asked = os.environ.get(_LIBRARY_VARIABLE)
    if asked is None:
        return "was not found"
    state = "could not be loaded" if Path(asked).is_file() else "does not exist"
    return f"{state} at {_LIBRARY_VARIABLE}={asked}"


def _import_drjit() -> tuple[Any, str]:
    """(drjit, what it printed while loading); points it to a library that its own search would miss."""
    if "drjit" in sys.modules:
        return sys.modules["drjit"], ""
    if _LIBRARY_VARIABLE not in os.environ and not _found_by_drjit():
        library = find_llvm([*os.environ.get("LD_LIBRARY_PATH", "").split(":"), f"{sys.prefix}/lib", *_SEARCHED_HERE])
        if library is not None:
            os.environ[_LIBRARY_VARIABLE] = str(library)
    try:
        with _caught_stderr() as said:
            dr = importlib.import_module("drjit")
    except ImportError as error:
        raise BackendError(f"Dr.Jit cannot be loaded ({_first_line(error)}); pip install 'drjit==1.4.0'") from None
    return dr, "".join(said)


def _import_mitsuba() -> Any:
    try:
        return importlib.import_module("mitsuba")
    except ImportError as error:
        raise BackendError(f"Mitsuba cannot be loaded ({_first_line(error)}); pip install 'mitsuba==3.9.0'") from None


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or ["no reason given"])[0]


def _found_by_drjit() -> bool:
    try:
        ctypes.CDLL("libLLVM.so")
    except OSError:
        return any(glob(f"{folder}/libLLVM*.so.*") for folder in _SEARCHED_BY_DRJIT)
    return True


@contextmanager
def _caught_stderr() -> Iterator[list[str]]:
    """Catch what compiled code writes to file descriptor 2 meanwhile; the list is filled on leaving."""
    said: list[str] = []
    if sys.stderr is not None:
        sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as caught:
        os.dup2(caught.fileno(), 2)
        try:
            yield said
        finally:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
            caught.seek(0)
            said.append(caught.read().decode(errors="replace"))
