"""The LLVM library that Dr.Jit needs on a processor: found, checked, and its absence said in one line."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from glob import glob
from pathlib import Path

from optics.errors import BackendError

__all__ = ["check_llvm", "find_llvm", "llvm_version", "packaged", "point_to_llvm"]

_LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
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


def point_to_llvm() -> None:
    """Name the library in the environment where Dr.Jit's own search would miss it."""
    if _LIBRARY_VARIABLE in os.environ or _found_by_drjit():
        return
    library = find_llvm([*os.environ.get("LD_LIBRARY_PATH", "").split(":"), f"{sys.prefix}/lib", *_SEARCHED_HERE])
    if library is not None:
        os.environ[_LIBRARY_VARIABLE] = str(library)


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
        raise BackendError(f"backend 'llvm' needs the LLVM library, which {_where_missing()}; {_advice()}")
    if major < _OLDEST_LLVM:
        raise BackendError(f"LLVM {major} is too old: version {_OLDEST_LLVM} or newer is needed; {_advice()}")
    release = tuple(int(part) for part in re.findall(r"\d+", drjit_version)[:2])
    if release >= _ABORTING_DRJIT and major < _OLDEST_LLVM_FOR_ABORTING_DRJIT:
        raise BackendError(
            f"drjit {drjit_version} ends the process on LLVM {major} ('Cannot select: fmaximum'); "
            "install the pinned pair with: pip install 'mitsuba==3.9.0' 'drjit==1.4.0', or LLVM 19"
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


def packaged(names: Iterable[str]) -> str | None:
    """Newest package of a library that works among names such as ``libllvm15``, ``libllvm17t64``; None if none is."""
    known = [match for match in map(re.compile(r"libllvm(1[5-9])(t64)?").fullmatch, names) if match]
    return max(known, key=lambda match: int(match[1]))[0] if known else None


def _advice() -> str:
    """How to install the library here: Debian and Ubuntu name it differently in every release."""
    try:
        listed = subprocess.run(
            ["apt-cache", "pkgnames", "libllvm1"], capture_output=True, text=True, check=False, timeout=20
        )
        package = packaged(listed.stdout.split())
    except (OSError, subprocess.SubprocessError):
        return "install LLVM 15 to 19 (Fedora: dnf install llvm-libs; macOS: brew install llvm)"
    sudo = "" if os.geteuid() == 0 else "sudo "
    if package is None:
        return f"install it with: {sudo}apt-get update, then a package from libllvm15 to libllvm19"
    return f"install it with: {sudo}apt-get install -y {package}"


def _where_missing() -> str:
    asked = os.environ.get(_LIBRARY_VARIABLE)
    if asked is None:
        return "was not found"
    state = "could not be loaded" if Path(asked).is_file() else "does not exist"
    return f"{state} at {_LIBRARY_VARIABLE}={asked}"


def _found_by_drjit() -> bool:
    try:
        ctypes.CDLL("libLLVM.so")
    except OSError:
        return any(glob(f"{folder}/libLLVM*.so.*") for folder in _SEARCHED_BY_DRJIT)
    return True
