"""``python -m experiments --all``: every experiment in turn, each a process of its own; one page links the reports."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from experiments.harness.interrupts import EXIT_BAD_INPUT, EXIT_BROKEN, EXIT_FAILED, EXIT_GOOD, EXIT_INTERRUPTED
from optics.errors import ConfigError, unknown_name
from optics.textfile import write_text

__all__ = ["Entry", "read_entry", "run_all", "write_index"]

INDEX = "index.html"
MARK = '<meta name="generator" content="starbench">'


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One line of the page."""

    name: str  # Experiment and the first line of its description
    about: str  # Experiment and the first line of its description
    status: int  # Exit code of the run; see `experiments.harness.cli.command`
    held: int = 0  # Criteria that hold, and all of them; 0 where there is no result
    criteria: int = 0  # Criteria that hold, and all of them; 0 where there is no result
    failed: tuple[str, ...] = ()  # Names of those that do not hold
    runtime_s: float | None = None  # From the run's provenance
    quick: bool = False  # Whether it was a quick run

    @property
    def verdict(self) -> str:
        """In a few words."""
        if self.status == EXIT_INTERRUPTED:
            return "interrupted"
        if self.status not in (EXIT_GOOD, EXIT_FAILED):
            return f"no result (exit code {self.status})"
        return f"{self.held} of {self.criteria} criteria hold"


def run_all(arguments: Sequence[str], known: Mapping[str, str]) -> int:
    """Run experiments one after the other."""

    @click.command(context_settings={"help_option_names": ["-h", "--help"]})
    @click.option("--out", default="out", metavar="DIR")
    @click.option("--sensor", metavar="FILE")
    @click.option("--force", is_flag=True)
    @click.option("--quick", is_flag=True)
    @click.option("--seed", type=click.IntRange(min=0))
    @click.option("--backend", type=click.Choice(["auto", "llvm", "cuda"]), default="auto")
    @click.argument("names", nargs=-1)
    def parse(
        out: str,
        sensor: str | None,
        force: bool,
        quick: bool,
        seed: int | None,
        backend: str,
        names: tuple[str, ...],
    ) -> int:
        for name in names:
            if name not in known:
                raise unknown_name("experiment", name, known)
        folder = _folder(out)
        options = ["--backend", backend, *(["--quick"] if quick else []), *(["--seed", str(seed)] if seed else [])]
        options += [*(["--sensor", sensor] if sensor else []), *(["--force"] if force else [])]
        return _run(folder, [name for name in known if not names or name in names], known, options)

    try:
        return int(parse.main(list(arguments), prog_name="python -m experiments --all", standalone_mode=False) or 0)
    except (click.ClickException, ConfigError) as error:
        said = error.format_message() if isinstance(error, click.ClickException) else str(error)
        print(f"error: {said}", file=sys.stderr)
        return EXIT_BAD_INPUT


def _folder(out: str) -> Path:
    """The folder of the page, made if need be."""
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from None
    page = folder / INDEX
    if page.exists() and MARK not in page.read_text(encoding="utf-8", errors="replace"):
        raise ConfigError(f"--out {out}: its {INDEX} was not written by this program; choose another folder")
    return folder


def _run(folder: Path, names: Iterable[str], known: Mapping[str, str], options: Sequence[str]) -> int:
    entries: list[Entry] = []
    for name in names:
        print(f"\n== {name}", flush=True)
        command = [sys.executable, "-m", f"experiments.{name}", "--out", str(folder / name), *options]
        try:
            status = subprocess.run(command, check=False).returncode
        except KeyboardInterrupt:  # the child had it too, and wrote nothing
            status = EXIT_INTERRUPTED
        status = status if status >= 0 else 128 - status
        entries.append(read_entry(folder / name, name=name, about=known[name], status=status))
        write_index(entries, folder)
        if status == EXIT_INTERRUPTED:
            break
    print(f"\nall reports: {folder / INDEX}")
    found = {entry.status for entry in entries}
    if EXIT_INTERRUPTED in found:
        return EXIT_INTERRUPTED
    if found <= {EXIT_GOOD, EXIT_FAILED}:
        return max(found, default=EXIT_GOOD)
    return EXIT_BROKEN


def read_entry(folder: Path, *, name: str, about: str, status: int) -> Entry:
    """What a finished run left in its folder."""
    if status not in (EXIT_GOOD, EXIT_FAILED):
        return Entry(name=name, about=about, status=status)
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    origin: dict[str, Any] = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    criteria = summary["criteria"]
    return Entry(
        name=name,
        about=about,
        status=status,
        held=sum(bool(one["passed"]) for one in criteria),
        criteria=len(criteria),
        failed=tuple(one["name"] for one in criteria if not one["passed"]),
        runtime_s=origin.get("runtime_s"),
        quick=bool(origin.get("quick")),
    )


def write_index(entries: Sequence[Entry], folder: Path) -> None:
    """Write the page; an older one is replaced in one step."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("experiments.harness"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    text = environment.get_template("index.html").render(entries=entries, good=EXIT_GOOD, failed=EXIT_FAILED)
    write_text(folder / INDEX, text)
