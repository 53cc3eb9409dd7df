"""``python -m experiments`` and the console command ``starbench``: what can be run, and running it."""

from __future__ import annotations

import os
import sys
from importlib import import_module

from experiments.harness.system import print_anything

__all__ = ["COMMANDS", "console", "main"]

COMMANDS = {
    "completion": "what makes bash, zsh or fish complete all this: completion bash",
    "doctor": "what is there (LLVM, versions, GPU, stars), what is missing, what to do",
    "frame": "any FITS image as a page to zoom into, with its stars: frame show FILE.fits --out page.html",
    "lens": "lens files: lens show FILE, lens convert FILE NEW   (.toml, .zmx, .seq)",
}
"""What is no experiment; ``experiments.NAME.command`` runs it."""


def main(argv: list[str], *, own_process: bool = False) -> int:
    """List the experiments, or run one of them."""
    if argv and argv[0] in COMMANDS:  # without the rest, which a broken installation may lack
        return int(import_module(f"experiments.{argv[0]}.command").main(argv[1:]))
    from experiments.harness.registry import found, load
    from optics.errors import ConfigError

    experiments = found()
    if "--all" in argv:
        from experiments.harness.together import run_all

        return run_all([word for word in argv if word != "--all"], experiments)
    if argv == ["--names"]:
        sys.stdout.writelines(f"{name}\n" for name in experiments)
    elif argv == ["--version"]:
        from experiments.harness.provenance import program_version

        print(program_version())
    elif argv and argv[0] not in ("-h", "--help"):
        try:
            command = load(argv[0], beside=COMMANDS)
        except ConfigError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        return command(argv[1:], own_process=own_process)
    else:
        _tell(experiments)
    return 0


def _tell(experiments: dict[str, str]) -> None:
    print("Run one with:  python -m experiments.NAME [--quick] [--out DIR]   (--help tells the rest)")
    print("          or:  starbench NAME [--quick] [--out DIR]")
    print("or all with:   python -m experiments --all [--quick] [--out DIR]")
    width = max(map(len, [*experiments, *COMMANDS]))
    for listed in (experiments, COMMANDS):
        print()
        for name, line in listed.items():
            print(f"  {name:<{width}}  {line}")


def _complete(instruction: str) -> int:
    """What a shell may put after what was typed."""
    import click

    from experiments.harness.completion import Tree, answer
    from experiments.harness.registry import found, load

    def command(name: str) -> click.Command:
        if name not in COMMANDS:
            loaded: click.Command = load(name).parser  # type: ignore[attr-defined]
            return loaded
        module = import_module(f"experiments.{name}.command")
        known: click.Command | None = getattr(module, name, None)
        return known or click.Command(name, params=[click.Option([one], is_flag=True) for one in module.OPTIONS])

    return answer(Tree({**found(), **COMMANDS}, command, ("--all", "--names", "--version", "--help")), instruction)


def console() -> int:
    """The console command ``starbench``."""
    print_anything()
    if "_STARBENCH_COMPLETE" in os.environ:
        return _complete(os.environ["_STARBENCH_COMPLETE"])
    return main(sys.argv[1:], own_process=True)


if __name__ == "__main__":
    sys.exit(console())
