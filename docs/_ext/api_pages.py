"""Pages of the API, made from what the packages say is public, so that no name can be missing.

Public is what ``__init__.pyi`` of a package names; beside it stands every function or class that a page names with its
module (``optics.rays.trace.trace``). What numpydoc finds lacking in their docstrings is a warning of the build.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from importlib import import_module
from pathlib import Path

from numpydoc.docscrape import NumpyDocString
from numpydoc.validate import validate
from sphinx.application import Sphinx
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)
DOCS = Path(__file__).resolve().parents[1]
PACKAGES = ("optics", "render", "calib", "experiments")
NAMED = re.compile(rf"`((?:{'|'.join(PACKAGES)})(?:\.[A-Za-z_]\w*)+)(?:\(.*?\))?`")
TITLES = {
    "optics": "Lens and light",
    "render": "Sky, star sensor, frames",
    "calib": "Stars, cameras, attitudes, calibration",
    "experiments": "Experiments as functions",
}
# parameters missing, unknown, in another order, without type or text; Returns missing, empty; no summary, no docstring
REQUIRED = {"PR01", "PR02", "PR03", "PR04", "PR07", "RT01", "RT03", "GL08", "GL07", "SS01"}


@cache
def public_names() -> tuple[str, ...]:
    """Names like ``optics.load_lens``, package by package in the order of the stubs."""
    names = []
    for package in PACKAGES:
        stub = (DOCS.parent / package / "__init__.pyi").read_text(encoding="utf-8")
        listed = re.findall(r"^from \S+ import \w+ as (\w+)$", stub, re.M)
        if set(listed) != set(import_module(package).__all__):
            raise RuntimeError(f"{package}.__all__ is not what its stub says")
        names += [f"{package}.{name}" for name in listed]
    return tuple(names)


@cache
def resolve(name: str) -> object | None:
    """What a dotted name means, or None."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            value = import_module(".".join(parts[:cut]))
        except ImportError:
            continue
        try:
            for part in parts[cut:]:
                value = getattr(value, part)
        except AttributeError:
            return None
        return value
    return None


@cache
def further_names() -> tuple[str, ...]:
    """Functions and classes that pages name with their module and that no package makes public."""
    found = set()
    for page in sorted(DOCS.rglob("*.md")):
        found |= set(NAMED.findall(page.read_text("utf-8")))
    public = {id(resolve(name)) for name in public_names()}
    kept = []
    for name in sorted(found):
        value = resolve(name)
        if (inspect.isfunction(value) or inspect.isclass(value)) and name.count(".") >= 2 and id(value) not in public:
            kept.append(name)
    return tuple(kept)


def _room(name: str) -> str:
    """Room of a package where a public name lives, for the headings."""
    value = resolve(name)
    module = getattr(value, "__module__", "")
    package = name.partition(".")[0]
    if not module.startswith(f"{package}."):
        return package
    parts = module.split(".")
    return ".".join(parts[:2])


def _table(names: list[str]) -> str:
    lines = ["", ".. autosummary::", "   :toctree: names", "   :nosignatures:", ""]
    return "\n".join([*lines, *(f"   {name.split('.', 1)[1]}" for name in names), "", ""])


def _package_page(package: str) -> str:
    rooms: dict[str, list[str]] = {}
    for name in public_names():
        if name.startswith(f"{package}."):
            rooms.setdefault(_room(name), []).append(name)
    title = f"{package}: {TITLES[package].lower()}"
    text = [title, "=" * len(title), "", inspect.getdoc(import_module(package)) or "", ""]
    for room in sorted(rooms):
        text += [room, "-" * len(room), "", f".. currentmodule:: {package}", _table(rooms[room])]
    return "\n".join(text)


def _further_page() -> str:
    title = "Inside the packages"
    text = [title, "=" * len(title), "", "What these pages name by its module: the functions that hold the equations."]
    modules: dict[str, list[str]] = {}
    for name in further_names():
        modules.setdefault(name.rsplit(".", 1)[0], []).append(name)
    for module, names in modules.items():
        text += ["", module, "-" * len(module), "", ".. autosummary::", "   :toctree: names", "   :nosignatures:", ""]
        text += [f"   {name}" for name in names]
    return "\n".join([*text, ""])


def _index_page() -> str:
    rows = ["API", "===", "", "Names that are public, by package, and what these pages name by its module.", ""]
    rows += [".. toctree::", "   :maxdepth: 2", ""]
    return "\n".join([*rows, *(f"   {package}" for package in PACKAGES), "   further", ""])


def write_pages() -> None:
    """Write the pages that have changed."""
    folder = DOCS / "api"
    (folder / "names").mkdir(parents=True, exist_ok=True)
    pages = {"index": _index_page(), "further": _further_page()}
    pages |= {package: _package_page(package) for package in PACKAGES}
    for name, text in pages.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    wanted = {*public_names(), *further_names()}
    for path in (folder / "names").glob("*.rst"):
        if path.stem not in wanted:
            path.unlink()


def _fields_missing(value: type) -> list[str]:
    """Fields of a record that its docstring does not mention; Attributes may stand for Parameters."""
    doc = NumpyDocString(inspect.getdoc(value) or "")
    rows = [*doc["Parameters"], *doc["Attributes"]]
    told = {name.strip("* ") for row in rows for name in row.name.split(",")}
    return [field.name for field in fields(value) if field.init and field.name not in told]


def faults(name: str) -> list[str]:
    """What the docstring of a public name lacks."""
    value = resolve(name)
    if not callable(value) or (inspect.isclass(value) and issubclass(value, Enum | Exception)):
        return [] if not callable(value) or inspect.getdoc(value) else ["no docstring"]
    home = f"{value.__module__}.{value.__qualname__}"
    found = [f"{code} {text}" for code, text in validate(home)["errors"] if code in REQUIRED]
    if inspect.isclass(value):
        found = [text for text in found if not text.startswith("PR01")] if is_dataclass(value) else found
        if is_dataclass(value) and (missing := _fields_missing(value)):
            found.append(f"fields without a word: {', '.join(missing)}")
    return found


def check_docstrings(app: Sphinx) -> None:
    """Warn of every public docstring that lacks something."""
    for name in public_names():
        for fault in faults(name):
            LOGGER.warning("%s: %s", name, fault)


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before anything is read."""
    write_pages()
    app.connect("builder-inited", check_docstrings)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
