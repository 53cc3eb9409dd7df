"""``starbench statement``: the performance of a sensor file as one document."""

from __future__ import annotations

from pathlib import Path

import click

from optics.errors import ConfigError
from optics.textfile import write_text


@click.command("statement", context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--sensor", default=None, metavar="TOML", help="sensor file; default: the built-in tracker")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="setting of the experiment camera")
@click.option("--flight", default=None, metavar="DIR", help="output folder of the experiment flight")
@click.option("--out", default="statement.html", show_default=True, metavar="HTML", help="path of the page")
@click.option("--force", is_flag=True, help="overwrite an existing file")
def statement(sensor: str | None, settings: tuple[str, ...], flight: str | None, out: str, force: bool) -> None:
    """Write the performance of a sensor by the clauses of ECSS-E-ST-60-20C: an HTML page, printable to PDF.

    The numbers are predicted by the experiment camera; --flight adds the results of a rendered flight.
    """
    page = Path(out)
    if page.exists() and not force:
        raise ConfigError(f"{out} exists; --force overwrites it")
    if not page.parent.is_dir():
        raise ConfigError(f"{page}: the folder {page.parent} does not exist")
    from experiments.statement.page import page_of
    from experiments.statement.study import predict_statement

    result = predict_statement(() if sensor is None else (sensor,), settings, flight)
    write_text(page, page_of(result, "built-in tracker" if sensor is None else Path(sensor).name))
    missed = [requirement.label for requirement in result.requirements if not requirement.met]
    click.echo(f"{result.name}: attitude {result.ame_arcsec[0]:.3g} / {result.ame_arcsec[1]:.3g} arcsec (AME, 95 %)")
    if result.requirements:
        click.echo(f"required values met: {len(result.requirements) - len(missed)} of {len(result.requirements)}")
        click.echo("".join(f"  not met: {label}\n" for label in missed), nl=False)
    click.echo(f"page: {page}")
