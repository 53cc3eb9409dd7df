"""``starbench completion SHELL``: what the shell has to read once."""

from __future__ import annotations

import click

from experiments.harness.completion import SHELLS, script
from experiments.harness.groups import run_group

__all__ = ["completion", "main"]

HELP = """What makes SHELL complete starbench, its experiments, their options and the keys of --set.

\b
bash: eval "$(starbench completion bash)"   in ~/.bashrc
zsh:  eval "$(starbench completion zsh)"    in ~/.zshrc, after compinit
fish: starbench completion fish > ~/.config/fish/completions/starbench.fish
"""


@click.command("completion", help=HELP, context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print the script."""
    click.echo(script(shell), nl=False)


def main(argv: list[str]) -> int:
    """Run the command."""
    return run_group(completion, argv)
