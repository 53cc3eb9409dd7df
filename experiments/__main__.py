"""``python -m experiments``: what can be run. Nothing is imported but this; experiments are found by their source."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

__all__ = ["experiments", "main"]


def experiments(folder: Path | None = None) -> dict[str, str]:
    """Experiments of a folder: packages whose ``experiment.py`` holds ``main = command(...)`` or another kind of it.

    Parameters
    ----------
    folder : pathlib.Path, optional
        Where to look; this package if left out.

    Returns
    -------
    dict
        Name -> first line of that module's docstring, in alphabetical order.
    """
    found = {}
    for path in sorted((folder or Path(__file__).parent).glob("*/experiment.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(_is_main(statement) for statement in tree.body):
            found[path.parent.name] = (ast.get_docstring(tree) or "").partition("\n")[0]
    return found


def _is_main(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Assign)
        and [target.id for target in statement.targets if isinstance(target, ast.Name)] == ["main"]
        and isinstance(statement.value, ast.Call)
        and getattr(statement.value.func, "attr", getattr(statement.value.func, "id", "")).endswith("command")
    )


def main(argv: list[str]) -> int:
    """List the experiments; with ``--names`` the bare names, one per line; with ``--all`` run them all."""
    found = experiments()
    if "--all" in argv:
        from experiments.harness.together import run_all

        return run_all([word for word in argv if word != "--all"], found)
    if argv == ["--names"]:
        sys.stdout.writelines(f"{name}\n" for name in found)
        return 0
    if argv and argv[0] not in ("-h", "--help"):
        hint = f"run python -m experiments.{argv[0]}" if argv[0] in found else "run python -m experiments.NAME"
        print(f"error: {argv[0]!r} is not understood here; {hint}", file=sys.stderr)
        return 2
    print("Run one with:  python -m experiments.NAME [--quick] [--out DIR]   (--help tells the rest)")
    print("or all with:   python -m experiments --all [--quick] [--out DIR]\n")
    width = max(map(len, found), default=0)
    for name, line in found.items():
        print(f"  {name:<{width}}  {line}")
    if not found:
        print("  no experiments yet")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
