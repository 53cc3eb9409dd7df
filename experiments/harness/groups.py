"""Commands that are no experiments: their exit status, and what the user can mend as one line per fault."""

from __future__ import annotations

import sys

import click

from optics.errors import StarbenchError

__all__ = ["run_group"]


def run_group(group: click.Command, argv: list[str]) -> int:
    """Run a group of commands."""
    try:
        group.main(args=argv, prog_name=f"starbench {group.name}", standalone_mode=False)
    except click.exceptions.Exit as end:
        return int(end.exit_code)
    except click.ClickException as error:
        print(f"error: {' '.join(error.format_message().split())}", file=sys.stderr)
        return 2
    except StarbenchError as error:
        for line in str(error).split("\n"):
            print(f"error: {line}", file=sys.stderr)
        return 2
    return 0
