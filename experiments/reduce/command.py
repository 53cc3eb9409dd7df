"""``starbench reduce --frames FOLDER --method NAME``: one command for a laboratory's own frames."""

from __future__ import annotations

import click

from experiments.harness.groups import run_group
from experiments.harness.registry import load

__all__ = ["METHODS", "main", "reduce"]

METHODS = {
    "temporal": "scatter of a point at rest; a series is a brightness level",
    "hsfe": "error with the place on the pixels; a series is a position",
    "chromatic": "shift between filters; a series is a filter at a place",
    "distortion": "places against the coordinates of a target; a series is a session",
    "turntable": "joint calibration with a star; a series is a pose of the table",
    "fisher": "accuracy of star vectors; a series is a pose of the table",
}
"""Experiments that reduce own frames -> what of."""


@click.command(context_settings={"ignore_unknown_options": True, "help_option_names": ["-h", "--help"]})
@click.option("--frames", "folder", required=True, metavar="FOLDER", help="Folder with frames.toml and FITS frames.")
@click.option("--method", required=True, type=click.Choice(list(METHODS)), help="What is measured.")
@click.argument("others", nargs=-1, type=click.UNPROCESSED, metavar="[OPTIONS OF THE METHOD]")
@click.pass_context
def reduce(context: click.Context, folder: str, method: str, others: tuple[str, ...]) -> None:
    """Reduce a laboratory's own frames and judge them; as python -m experiments.METHOD --own-frames FOLDER.

    What the method takes besides (--set, --config, --out, --force) is passed on to it.
    """
    context.exit(load(method)(["--own-frames", folder, *others]))


reduce.epilog = "\b\n" + "\n".join(f"{name:<11} {does}" for name, does in METHODS.items())


def main(argv: list[str]) -> int:
    """Run the command; its exit status."""
    return run_group(reduce, argv)
