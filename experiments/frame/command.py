"""``starbench frame``: a FITS image as one HTML page, with the stars in it and what is known of them."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.harness.completion import files
from experiments.harness.groups import run_group
from optics.errors import ConfigError

__all__ = ["frame", "main"]

HELP = """Frames as pages to zoom into: pixel values, stars, truth, catalogue. Any FITS image; no server, no network."""


@click.group("frame", help=HELP, context_settings={"help_option_names": ["-h", "--help"]})
def frame() -> None:
    """The command with its subcommands."""


@frame.command()
@click.argument("file", shell_complete=files)
@click.option("--out", metavar="HTML", shell_complete=files, help="the page; the file's name with .html if left out")
@click.option("--hdu", metavar="N", help="extension, by number or name; the first image if left out")
@click.option("--plane", type=int, metavar="N", help="which image of a cube")
@click.option("--stars/--no-stars", "find", default=True, help="find and measure stars")
@click.option("--sigma", default=5.0, show_default=True, help="threshold of their detection")
@click.option(
    "--truth", metavar="TABLE", help="places with columns x_px, y_px (ECSV, CSV, Parquet); datasets have theirs"
)
@click.option(
    "--catalogue", type=float, metavar="MAG", help="mark Gaia's stars to this magnitude, where the file has coordinates"
)
def show(
    file: str,
    out: str | None,
    hdu: str | None,
    plane: int | None,
    find: bool,
    sigma: float,
    truth: str | None,
    catalogue: float | None,
) -> None:
    """One HTML page of the image FILE."""
    from experiments.frame.page import Asked, write_page

    asked = Asked(
        file=Path(file),
        hdu=int(hdu) if hdu is not None and hdu.isdecimal() else hdu,
        plane=plane,
        sigma=sigma if find else None,
        truth=None if truth is None else Path(truth),
        faintest_mag=catalogue,
    )
    page = Path(out) if out else Path(Path(file).name.partition(".")[0] + ".html")
    if not page.parent.is_dir():
        raise ConfigError(f"{page}: the folder {page.parent} does not exist")
    for line in write_page(asked, page):
        click.echo(line)
    click.echo(f"page: {page}")


def main(argv: list[str]) -> int:
    """Run the command."""
    return run_group(frame, argv)
