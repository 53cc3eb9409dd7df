"""Python and the packages that starbench is declared to need, against what is installed; standard library only."""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path

from experiments.doctor.finding import Finding

__all__ = ["check_packages", "check_python", "declared"]

PROGRAM = "starbench"
OLDEST_PYTHON = (3, 11)
OPTIONAL = ("solve", "online", "export", "loaders")
"""Extras that add abilities; the others serve tests and development."""
_EXTRA = re.compile(r"""extra\s*==\s*['"]([\w-]+)['"]""")
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")


def declared() -> dict[str, list[str]]:
    """Requirements by extra, ``""`` for what is always needed: of the source tree if there is one, else as installed."""
    source = Path(__file__).parents[2] / "pyproject.toml"
    if source.is_file():
        import tomllib

        project = tomllib.loads(source.read_text(encoding="utf-8"))["project"]
        return {"": project["dependencies"], **project["optional-dependencies"]}
    found: dict[str, list[str]] = {}
    for line in metadata.requires(PROGRAM) or ():
        text, _, marker = line.partition(";")
        extra = _EXTRA.search(marker)
        found.setdefault(extra[1] if extra else "", []).append(text.strip() if extra else line)
    return found


def check_python() -> Iterator[Finding]:
    """Version of the interpreter."""
    version, oldest = platform.python_version(), ".".join(map(str, OLDEST_PYTHON))
    old = sys.version_info < OLDEST_PYTHON
    yield Finding(
        name="Python",
        text=f"{version} ({platform.python_implementation()}, {platform.system()} {platform.machine()})",
        state="fault" if old else "ok",
        advice=f"make the environment with Python {oldest} or newer" if old else "",
        facts={"version": version, "system": platform.system(), "architecture": platform.machine()},
    )


def check_packages() -> Iterator[Finding]:
    """Packages that are needed, and those of the extras that add abilities."""
    wanted = declared()
    wrong, versions = _wrong(wanted.get("", ()))
    pins = {one: versions[one] for one in ("mitsuba", "drjit", "numpy") if versions.get(one)}
    good = f"{len(versions)} as declared; " + ", ".join(f"{name} {version}" for name, version in pins.items())
    yield Finding(
        name="packages",
        text="; ".join(wrong.values()) if wrong else good,
        state="fault" if wrong else "ok",
        advice="pip install " + " ".join(f"'{requirement}'" for requirement in wrong) if wrong else "",
        facts={"versions": versions, "wrong": list(wrong.values())},
    )
    for extra in OPTIONAL:
        lacking, versions = _wrong(wanted.get(extra, ()))
        if lacking:
            yield Finding(
                name=f"extra {extra!r}",
                text="; ".join(lacking.values()),
                state="note",
                advice=f"pip install '{PROGRAM}[{extra}]' if it is wanted",
                facts={"versions": versions, "wrong": list(lacking.values())},
            )


def _wrong(requirements: Iterable[str]) -> tuple[dict[str, str], dict[str, str | None]]:
    """Requirement -> what is wrong with it; and name -> version, None where it is missing."""
    wrong: dict[str, str] = {}
    versions: dict[str, str | None] = {}
    for requirement in requirements:
        text, _, marker = (part.strip() for part in requirement.partition(";"))
        if marker and not _applies(marker):
            continue
        match = _NAME.match(text)
        name = match[0] if match else text
        try:
            versions[name] = found = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
            wrong[text] = f"{name} is missing"
            continue
        if not _meets(found, text[len(name) :]):
            wrong[text] = f"{name} {found} where {text[len(name) :]} is needed"
    return wrong, versions


def _applies(marker: str) -> bool:
    try:
        from packaging.markers import Marker
    except ImportError:
        return True
    return bool(Marker(marker).evaluate())


def _meets(version: str, wanted: str) -> bool:
    """Whether a version is within what a requirement asks for; taken for granted without the package packaging."""
    try:
        from packaging.specifiers import SpecifierSet
    except ImportError:
        return True
    return SpecifierSet(wanted).contains(version, prereleases=True)
