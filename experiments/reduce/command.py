"""``starbench reduce --frames FOLDER --method NAME``: one command for a laboratory's own frames."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import click

from experiments.harness.interrupts import invoke
from experiments.harness.registry import load

METHODS = {
    "temporal": "scatter of points at rest; a series is a brightness level",
    "hsfe": "centroid error against pixel phase; a series is a position",
    "chromatic": "shift between filters; a series is a filter at a field position",
    "distortion": "positions against the coordinates of a target; a series is a session",
    "turntable": "joint calibration with a single star; a series is a pose of the table",
    "fisher": "accuracy of star vectors; a series is a pose of the table",
}
"""Experiments that reduce own frames -> what is measured."""


@click.command(
    epilog="\b\nMethods:\n" + "\n".join(f"  {name:<11} {does}" for name, does in METHODS.items()),
    context_settings={"ignore_unknown_options": True, "help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option("--frames", required=True, metavar="FOLDER", help="Folder with FITS frames and frames.toml.")
@click.option("--method", required=True, type=click.Choice(list(METHODS)), help="Method, listed below.")
@click.argument("others", nargs=-1, type=click.UNPROCESSED, metavar="[OPTIONS OF THE METHOD]")
def reduce(frames: str, method: str, others: tuple[str, ...]) -> int:
    """Reduce a laboratory's own frames, and check that they agree with the description in their folder.

    Same as python -m experiments.METHOD --own-frames FOLDER; its other options (--set, --config, --out, --force)
    are accepted too.
    """
    words = ["--own-frames", frames, *others]
    return int(load(method).main(words, prog_name=f"starbench {method}", standalone_mode=False) or 0)


def main(argv: Sequence[str] | None = None) -> int:
    """Exit status of the command."""
    return invoke(reduce, sys.argv[1:] if argv is None else argv, prog="starbench reduce", own_process=argv is None)
