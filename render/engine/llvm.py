"""Search and check of the LLVM library that Dr.Jit needs on a processor; one-line errors."""

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

_LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
_OLDEST_LLVM = 15
# Measured: drjit 1.5.0 (mitsuba 3.9.1) emits fmaximum/fminimum, which LLVM 15 and 16 cannot select for x86-64; LLVM
# then ends the process ("LLVM ERROR: Cannot select"), which no caller can catch. LLVM 19 has it.
_ABORTING_DRJIT = (1, 5)
_OLDEST_LLVM_FOR_ABORTING_DRJIT = 17
# Where Dr.Jit looks by itself (drjit-core, llvm_api.cpp), and where else distributions, conda, Homebrew and the LLVM
# project's own installers put the library.
_FILE = {"win32": "LLVM-C.dll", "darwin": "libLLVM.dylib"}  # elsewhere libLLVM.so
_SEARCHED_BY_DRJIT = {
    "linux": tuple(
        f"/usr/lib/{folder}/libLLVM*.so.*" for folder in ("x86_64-linux-gnu", "aarch64-linux-gnu", "wsl/lib")
    ),
    "darwin": tuple(f"{root}/Cellar/llvm/*/lib/libLLVM.dylib" for root in ("/opt/homebrew", "/usr/local")),
}
_SEARCHED_HERE = {
    "linux": (
        *("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib/wsl/lib"),
        *("/usr/lib/llvm-*/lib", "/usr/lib64", "/usr/lib", "/usr/local/lib"),
    ),
    "darwin": (
        "/opt/homebrew/opt/llvm@*/lib",
        "/usr/local/opt/llvm@*/lib",
        "/opt/homebrew/opt/llvm/lib",
        "/usr/local/opt/llvm/lib",
        "/opt/local/libexec/llvm-*/lib",
    ),
    "win32": ("C:/Program Files/LLVM/bin", "C:/Program Files (x86)/LLVM/bin"),
}
_SEARCH_PATH = {"win32": "PATH", "darwin": "DYLD_LIBRARY_PATH"}  # elsewhere LD_LIBRARY_PATH
_CONDA = {"win32": "Library/bin"}  # below sys.prefix; elsewhere lib
_NUMBERED = re.compile(r"libLLVM(?:-|\.so\.|\.)(\d+)")
_NUMBERED_FOLDER = re.compile(r"llvm(?:[@-]|/)(\d+)")


def point_to_llvm() -> None:
    """Name the library in the environment where Dr.Jit's own search would miss it."""
    if _LIBRARY_VARIABLE in os.environ or _found_by_drjit():
        return
    library = find_llvm(searched_folders())
    if library is not None:
        os.environ[_LIBRARY_VARIABLE] = str(library)


def searched_folders() -> list[str]:
    """Folders in which `point_to_llvm` looks on this system, first the user's search path and the environment."""
    path = os.environ.get(_SEARCH_PATH.get(sys.platform, "LD_LIBRARY_PATH"), "").split(os.pathsep)
    return [*path, f"{sys.prefix}/{_CONDA.get(sys.platform, 'lib')}", *_SEARCHED_HERE.get(sys.platform, ())]


def llvm_version() -> str | None:
    """Version of the LLVM library in use, e.g. ``"15.0.6"``; None when Dr.Jit is not loaded or runs without it."""
    dr = sys.modules.get("drjit")
    if dr is None:
        return None
    version = tuple(dr.detail.llvm_version())
    return None if version[0] < 0 else ".".join(str(part) for part in version)


def check_llvm(version: Iterable[int], drjit_version: str, *, printed: str = "") -> None:
    """Refuse an LLVM that is missing, too old, or known to end the process with this Dr.Jit."""
    major = next(iter(version))
    refused = re.search(r"LLVM version \((\d+)\)", printed)
    if major < 0 and refused:
        major = int(refused.group(1))
    if major < 0:
        raise BackendError(f"backend 'llvm' needs the LLVM library, which {_where_missing()}; {install_advice()}")
    if major < _OLDEST_LLVM:
        raise BackendError(f"LLVM {major} is too old: version {_OLDEST_LLVM} or newer is needed; {install_advice()}")
    release = tuple(int(part) for part in re.findall(r"\d+", drjit_version)[:2])
    if release >= _ABORTING_DRJIT and major < _OLDEST_LLVM_FOR_ABORTING_DRJIT:
        raise BackendError(
            f"drjit {drjit_version} ends the process on LLVM {major} ('Cannot select: fmaximum'); "
            "install the pinned pair with: pip install 'mitsuba==3.9.0' 'drjit==1.4.0', or LLVM 19"
        )


def find_llvm(folders: Iterable[str | Path]) -> Path | None:
    """Newest LLVM library of a usable version in the given folders, by its file name."""
    best: tuple[int, Path] | None = None
    for folder in filter(None, map(str, folders)):
        for name in map(Path, sorted(glob(f"{folder}/*LLVM*"))):
            major = _major(name)
            if major is not None and major >= _OLDEST_LLVM and (best is None or major > best[0]) and name.is_file():
                best = (major, name)
    return None if best is None else best[1]


def _major(path: Path) -> int | None:
    """Version of a library by its name, or on macOS and Windows by its folder; None for another file."""
    plain = _FILE.get(sys.platform, "libLLVM.so")
    if Path(plain).suffix not in path.suffixes:
        return None
    numbered = _NUMBERED.match(path.name)
    if numbered is None and path.name == plain and sys.platform in _FILE:
        numbered = _NUMBERED_FOLDER.search(path.as_posix())
        return int(numbered[1]) if numbered else _OLDEST_LLVM  # Dr.Jit checks it
    return int(numbered[1]) if numbered else None


def packaged(names: Iterable[str]) -> str | None:
    """Newest package of a library that works among names such as ``libllvm15``, ``libllvm17t64``; None if none is."""
    usable = [match for match in map(re.compile(r"libllvm(1[5-9])(t64)?").fullmatch, names) if match]
    return max(usable, key=lambda match: int(match[1]))[0] if usable else None


def install_advice() -> str:
    """How to install the library on this system: Debian and Ubuntu name it differently in every release."""
    if sys.platform == "darwin":
        return "install it with: brew install llvm@19"
    if sys.platform == "win32":
        return (
            "install it with: winget install --id LLVM.LLVM --version 19.1.7, and if it is not found then, set "
            f"{_LIBRARY_VARIABLE} to LLVM-C.dll"
        )
    try:
        listed = subprocess.run(
            ["apt-cache", "pkgnames", "libllvm1"], capture_output=True, text=True, check=False, timeout=20
        )
        package = packaged(listed.stdout.split())
    except (OSError, subprocess.SubprocessError):
        return "install LLVM 15 to 19 (Fedora: dnf install llvm-libs; Arch: pacman -S llvm-libs)"
    sudo = "" if os.geteuid() == 0 else "sudo "
    if package is None:
        return f"install it with: {sudo}apt-get update, then a package from libllvm15 to libllvm19"
    return f"install it with: {sudo}apt-get install -y {package}"


def _where_missing() -> str:
    path = os.environ.get(_LIBRARY_VARIABLE)
    if path is None:
        return "was not found"
    state = "could not be loaded" if Path(path).is_file() else "does not exist"
    return f"{state} at {_LIBRARY_VARIABLE}={path}"


def _found_by_drjit() -> bool:
    name = _FILE.get(sys.platform, "libLLVM.so")
    try:
        ctypes.CDLL(name)
    except OSError:
        return any(map(glob, _SEARCHED_BY_DRJIT.get(sys.platform, ())))
    return True
