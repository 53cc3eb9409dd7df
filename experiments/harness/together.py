"""``starbench --all``: every experiment in turn, each in its own process; one page links the reports."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from experiments.harness.interrupts import EXIT_BROKEN, EXIT_FAILED, EXIT_GOOD, EXIT_INTERRUPTED, interrupts
from experiments.harness.registry import experiment_names
from optics.errors import ConfigError, unknown_name
from optics.textfile import write_text

INDEX = "index.html"
MARK = '<meta name="generator" content="starbench">'


@click.command(
    "all",
    help="Run the experiments NAMES, or all, and write a page that links their reports.",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--out", default="out", metavar="DIR", type=click.Path(), show_default=True, help="Folder of the page.")
@click.option(
    "--sensor", metavar="FILE", type=click.Path(), help="Passed to every experiment, as are the options below."
)
@click.option("--force", is_flag=True)
@click.option("--quick", is_flag=True)
@click.option("--seed", type=click.IntRange(min=0))
@click.option("--backend", type=click.Choice(["auto", "llvm", "cuda"]), default="auto")
@click.argument("names", nargs=-1)
def run_all(out: str, names: tuple[str, ...], **options: str | int | bool | None) -> int:
    """Run experiments one after the other."""
    answers, interrupts.at_once = experiment_names(), False
    for name in names:
        if name not in answers:
            raise unknown_name("experiment", name, answers)
    words = []
    for option, value in options.items():
        if value is not None and value is not False:
            words += [f"--{option}"] if value is True else [f"--{option}", str(value)]
    folder, entries = _folder(out), list[dict[str, Any]]()
    for name in [name for name in answers if not names or name in names]:
        click.echo(f"\n== {name}")
        command = [sys.executable, "-m", "experiments", name, "--out", str(folder / name), *words]
        try:
            status = subprocess.run(command, check=False).returncode
        except KeyboardInterrupt:  # the child received it too and wrote nothing
            status = EXIT_INTERRUPTED
        entries.append(read_entry(folder / name, status) | {"name": name, "about": answers[name]})
        write_index(entries, folder)
        if status == EXIT_INTERRUPTED:
            return EXIT_INTERRUPTED
    click.echo(f"\nall reports: {folder / INDEX}")
    statuses = {entry["status"] for entry in entries}
    return max(statuses, default=EXIT_GOOD) if statuses <= {EXIT_GOOD, EXIT_FAILED} else EXIT_BROKEN


def _folder(out: str) -> Path:
    """The folder of the page, which is created."""
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


def read_entry(folder: Path, status: int) -> dict[str, Any]:
    """Line of the page for a run that ended with ``status``, from its folder."""
    if status not in (EXIT_GOOD, EXIT_FAILED):
        return {"status": status, "verdict": f"no result (exit code {status})"}
    criteria = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["criteria"]
    origin = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    met, missed, open_ = ([c["name"] for c in criteria if c["passed"] is state] for state in (True, False, None))
    verdict = f"{len(met)} of {len(met) + len(missed)} criteria hold"
    verdict += f"; not: {'; '.join(missed)}" if missed else ""
    verdict += f"; {len(open_)} not judged" if open_ else ""
    return {"status": status, "verdict": verdict, "runtime_s": origin["runtime_s"], "quick": origin["quick"]}


def write_index(entries: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Write the page; an older one is replaced in one step."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("experiments.harness"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    text = environment.get_template("index.html").render(entries=entries, good=EXIT_GOOD, failed=EXIT_FAILED)
    write_text(folder / INDEX, text)
