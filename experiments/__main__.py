"""``python -m experiments`` and the console command ``starbench``: what can be run, and running it."""

from __future__ import annotations

import sys

from experiments.harness.registry import found, load
from experiments.harness.system import print_anything
from optics.errors import ConfigError

__all__ = ["console", "main"]


def main(argv: list[str], *, own_process: bool = False) -> int:
    """List the experiments, or run one of them.

    Parameters
    ----------
    argv : list of str
        ``NAME [options]`` runs an experiment; ``--all`` runs all; ``--names`` prints bare names, one per line;
        ``lens`` shows and converts lens files; ``--version`` the version; nothing or ``--help`` what there is.
    own_process : bool
        Whether the process is ours to end, as on a command line.

    Returns
    -------
    int
        Exit code.
    """
    experiments = found()
    if "--all" in argv:
        from experiments.harness.together import run_all

        return run_all([word for word in argv if word != "--all"], experiments)
    if argv == ["--names"]:
        sys.stdout.writelines(f"{name}\n" for name in experiments)
        return 0
    if argv == ["--version"]:
        from experiments.harness.provenance import program_version

        print(program_version())
        return 0
    if argv and argv[0] not in ("-h", "--help"):
        try:
            command = _lens if argv[0] == "lens" else load(argv[0])
        except ConfigError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        return command(argv[1:], own_process=own_process)
    print("Run one with:  python -m experiments.NAME [--quick] [--out DIR]   (--help tells the rest)")
    print("          or:  starbench NAME [--quick] [--out DIR]")
    print("or all with:   python -m experiments --all [--quick] [--out DIR]")
    print("Lens files:    starbench lens show FILE, starbench lens convert FILE NEW   (.toml, .zmx, .seq)\n")
    width = max(map(len, experiments), default=0)
    for name, line in experiments.items():
        print(f"  {name:<{width}}  {line}")
    return 0


def _lens(argv: list[str], *, own_process: bool = False) -> int:
    """Lens files: no experiment, but a command of its own."""
    from experiments.lens.command import main as lens

    return lens(argv)


def console() -> int:
    """The console command ``starbench``."""
    print_anything()
    return main(sys.argv[1:], own_process=True)


if __name__ == "__main__":
    sys.exit(console())
