"""``starbench lens``: show a lens file as one page, or turn it into one of another format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from optics.errors import ConfigError
from optics.textfile import write_text

__all__ = ["lens"]

HELP = """Lens files of Zemax (.zmx), CODE V (.seq) and our own (.toml); zoom.zmx#2 is the second configuration."""


def _reading(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options of every reading."""
    for option in reversed(
        (
            click.option("--strict", is_flag=True, help="refuse whatever is not exactly as in the file"),
            click.option("--glass", multiple=True, metavar="OLD=NEW", help="take glass NEW where the file names OLD"),
            click.option("--catalogue", multiple=True, metavar="AGF", help="glass catalogue to look in"),
        )
    ):
        function = option(function)
    return function


def _replacements(given: tuple[str, ...]) -> dict[str, str]:
    pairs = {}
    for one in given:
        old, equals, new = one.partition("=")
        if not (old.strip() and equals and new.strip()):
            raise ConfigError(f"--glass {one}: OLD=NEW is needed, e.g. --glass BK7=N-BK7")
        pairs[old.strip()] = new.strip()
    return pairs


def _read(path: str, strict: bool, glass: tuple[str, ...], catalogue: tuple[str, ...]) -> Any:
    from optics.lens_file import read_lens_file

    return read_lens_file(path, catalogues=catalogue, glasses=_replacements(glass), strict=strict)


def _tell(file: Any) -> None:
    """Counts, inexact lines and first-order data on the terminal."""
    report = file.report
    if report is None:
        return
    click.echo(str(report))
    for line in report.inexact:
        click.echo(f"  {line}")
    for one in report.comparisons:
        computed, stated = ("–" if v is None else f"{v:.6g}" for v in (one.computed, one.stated))
        click.echo(f"  {one.name}: {computed} {one.unit}" + (f" (file: {stated}, {one.source})" if one.source else ""))


@click.group("lens", help=HELP, context_settings={"help_option_names": ["-h", "--help"]})
def lens() -> None:
    """The command with its subcommands."""


@lens.command(help="One HTML page: prescription, first-order data, drawing, spots, distortion, colour, MTF, report.")
@click.argument("file", type=click.Path(readable=False))
@click.option("--out", default=None, metavar="HTML", help="the page; the file's name with .html if left out")
@_reading
def show(file: str, out: str | None, strict: bool, glass: tuple[str, ...], catalogue: tuple[str, ...]) -> None:
    read = _read(file, strict, glass, catalogue)
    page = Path(out) if out else Path(Path(file.partition("#")[0]).stem + ".html")
    if not page.parent.is_dir():
        raise ConfigError(f"{page}: the folder {page.parent} does not exist")
    _tell(read)
    from experiments.lens.page import page_of

    write_text(page, page_of(read, Path(file).name))
    click.echo(f"page: {page}")


@lens.command(help="Write a lens file as another one: .toml, .zmx or .seq.")
@click.argument("file", type=click.Path(readable=False))
@click.argument("new")
@click.option("--force", is_flag=True, help="replace a file that is there")
@_reading
def convert(file: str, new: str, force: bool, strict: bool, glass: tuple[str, ...], catalogue: tuple[str, ...]) -> None:
    from optics.export.write import write_lens

    if Path(new).exists() and not force:
        raise ConfigError(f"{new} is there already; --force replaces it")
    read = _read(file, strict, glass, catalogue)
    _tell(read)
    for path in write_lens(read, new):
        click.echo(f"written: {path}")
