"""``starbench doctor``: what is there, what is wrong, what to do; the standard library is enough to run it."""

from __future__ import annotations

import argparse
import json
import os
import textwrap
from collections.abc import Sequence
from importlib import metadata

from experiments.doctor.engine import Probe
from experiments.doctor.finding import Finding, examined
from experiments.doctor.machine import check_caches, check_catalogue, check_disk, check_terminal
from experiments.doctor.packages import PROGRAM, check_packages, check_python

__all__ = ["OPTIONS", "findings", "main"]

OPTIONS = ("--json", "--help")
"""For the completion of shells."""


def findings() -> list[Finding]:
    """All findings, in the order in which they are told; none raises."""
    probe = Probe()  # works meanwhile, so its findings are fetched last
    first = examined({"Python": check_python, "packages": check_packages})
    last = examined({"stars": check_catalogue, "caches": check_caches, "disk": check_disk, "terminal": check_terminal})
    return [*first, *examined({"backend": probe.check}), *last]


def main(argv: Sequence[str]) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog=f"{PROGRAM} doctor", description="What is there, what is wrong, what to do.", allow_abbrev=False
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    try:
        options = parser.parse_args(list(argv))
    except SystemExit as end:
        return int(end.code or 0)
    found = findings()
    faults = [one.name for one in found if one.state == "fault"]
    if options.json:
        listed = [
            {"name": one.name, "state": one.state, "text": one.text, "advice": one.advice, "facts": one.facts}
            for one in found
        ]
        content = {"program": PROGRAM, "version": _version(), "healthy": not faults, "findings": listed}
        text = json.dumps(content, indent=2)
    else:
        last = f"{len(faults)} to mend: {', '.join(faults)}" if faults else "Everything that is needed is there."
        text = "\n".join([f"{PROGRAM} {_version() or '(source tree, not installed)'}", *map(_line, found), last])
    try:
        print(text, flush=True)
    except BrokenPipeError:  # whoever read has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return 1 if faults else 0


def _version() -> str | None:
    try:
        return metadata.version(PROGRAM)
    except metadata.PackageNotFoundError:
        return None


def _line(one: Finding) -> str:
    head = f"{one.state.upper() if one.state == 'fault' else one.state:<5}  {one.name:<15}  "
    text = textwrap.fill(
        one.text,
        width=110,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )
    return f"{text}\n{' ' * len(head)}-> {one.advice}" if one.advice else text
