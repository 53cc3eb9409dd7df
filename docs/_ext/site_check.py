"""The finished pages: links within the site lead to files and anchors that are there, pictures have a text instead.

Links to elsewhere are judged by their form alone, as a build needs no network: https, a host, no blanks. Pictures of
the gallery's index are named after the script that they lead to.
"""

from __future__ import annotations

from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

if TYPE_CHECKING:  # the pages can be judged without Sphinx
    from docutils import nodes
    from sphinx.application import Sphinx

SKIPPED = ("_static", "_modules")


class Page(HTMLParser):
    """What a page offers and what it asks for.

    Parameters
    ----------
    text : str
        HTML.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.unnamed: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note anchors, links and pictures without a text."""
        given = dict(attrs)
        self.anchors |= {given[key] or "" for key in ("id", "name") if key in given}
        self.links |= {given[key] or "" for key in ("href", "src") if key in given}
        if tag == "img" and not (given.get("alt") or "").strip():
            self.unnamed.append(given.get("src") or "")


def faults(root: Path, gone: Callable[[str], bool] = lambda name: False) -> list[str]:
    """What is wrong with the pages below a folder, a line each; files of pages that are ``gone`` are left alone."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(root.rglob("*.html"))}
    pages = {path: page for path, page in pages.items() if path.relative_to(root).parts[0] != "_static"}
    found = []
    for path, page in pages.items():
        name = path.relative_to(root).as_posix()
        if name.startswith(SKIPPED) or gone(name.removesuffix(".html")):
            continue
        found += [f"{name}: no text instead of the picture {source}" for source in page.unnamed]
        found += [f"{name}: {link} {fault}" for link in sorted(page.links) if (fault := _fault(path, link, pages))]
    return found


def _fault(path: Path, link: str, pages: dict[Path, Page]) -> str:
    url = urlsplit(link)
    if url.scheme in ("data", "mailto"):
        return ""
    if url.scheme or url.netloc:
        good = url.scheme == "https" and "." in url.netloc and not any(sign.isspace() for sign in link)
        return "" if good else "is no https address"
    there = (path.parent / unquote(url.path)).resolve() if url.path else path
    if not there.exists():
        return "leads to no file"
    if url.fragment and there in pages and unquote(url.fragment) not in pages[there].anchors:
        return "leads to no place in that page"
    return ""


def name_thumbnails(app: Sphinx, doctree: nodes.document) -> None:
    """Say of a picture of the gallery's index what it is a picture of: the title of its script."""
    from docutils import nodes

    for picture in doctree.findall(nodes.image):
        if not picture.get("alt") and "_thumb" in picture["uri"]:
            words = " ".join(Path(picture["uri"]).stem.removeprefix("sphx_glr_plot_").split("_")[1:-1])
            picture["alt"] = f"Picture of the gallery: {words}"


def check(app: Sphinx, exception: Exception | None) -> None:
    """Warn of every fault of the finished pages."""
    from sphinx.util import logging

    if exception is None and app.builder.format == "html":
        for fault in faults(Path(app.outdir).resolve(), lambda name: name not in app.env.found_docs):
            logging.getLogger(__name__).warning("%s", fault)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register both steps."""
    app.connect("doctree-read", name_thumbnails)
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
