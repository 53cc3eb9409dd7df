"""``python -m experiments`` and the console command ``starbench``: list and run experiments and commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import click
from click.shell_completion import get_completion_class

from experiments.harness.interrupts import invoke
from experiments.harness.registry import Commands, experiment_names, version_option

COMMANDS = {
    "all": ("experiments.harness.together:run_all", "run every experiment and write a page that links the reports"),
    "completion": (f"{__name__}:completion", "shell completion for bash, zsh or fish: completion bash"),
    "doctor": (
        "experiments.doctor:doctor",
        "check LLVM, versions, GPU and star catalogue; state a remedy for each fault",
    ),
    "frame": (
        "experiments.frame:frame",
        "zoomable HTML page of a FITS image with its stars: frame show FILE.fits --out page.html",
    ),
    "lens": (
        "experiments.lens.command:lens",
        "show or convert lens files (.toml, .zmx, .seq); ghosts, temperature: lens show FILE",
    ),
    "reduce": (
        "experiments.reduce.command:reduce",
        "reduce and check a laboratory's own frames: reduce --frames FOLDER --method temporal",
    ),
    "statement": (
        "experiments.statement.command:statement",
        "printable performance statement by the clauses of ECSS-E-ST-60-20C: statement --sensor my.toml",
    ),
}
"""Commands that are no experiments."""
HELP = """Run an experiment: starbench NAME [--quick] [--out DIR], or python -m experiments.NAME. Options: NAME --help.

Run all: starbench --all [--quick] [--out DIR]
"""


@click.pass_context
def _list(context: click.Context, names: bool, **options: bool) -> None:
    del options
    if names:
        click.echo("\n".join(experiment_names()))
    elif context.invoked_subcommand is None:
        click.echo(context.get_help())


@click.command(
    help="""Print a completion script for SHELL: experiments, options and the keys of --set.

\b
bash: eval "$(starbench completion bash)"   in ~/.bashrc
zsh:  eval "$(starbench completion zsh)"    in ~/.zshrc, after compinit
fish: starbench completion fish > ~/.config/fish/completions/starbench.fish
"""
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """The script that click has for the shell."""
    source = get_completion_class(shell)
    assert source is not None
    click.echo(source(starbench, {}, "starbench", "_STARBENCH_COMPLETE").source())


starbench = Commands(
    COMMANDS,
    name="starbench",
    help=HELP,
    callback=_list,
    invoke_without_command=True,
    params=[
        click.Option(["--all"], is_flag=True, help="Run every experiment: the command all."),
        click.Option(["--names"], is_flag=True, help="Names of the experiments."),
        version_option(),
    ],
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 160},
)


def main(argv: Sequence[str], *, own_process: bool = False) -> int:
    """Exit status of a command line; ``--all`` stands for the command ``all``."""
    words = ["all", *(word for word in argv if word != "--all")] if "--all" in argv else list(argv)
    return invoke(starbench, words, prog="starbench", own_process=own_process)


def console() -> int:
    """The console command ``starbench``."""
    return main(sys.argv[1:], own_process=True)


if __name__ == "__main__":
    sys.exit(console())
