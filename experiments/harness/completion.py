"""Completion of ``starbench`` in shells, by click: names, options, files and the keys of ``--set``.

A shell calls ``starbench`` with the variable `VARIABLE`; `answer` then prints what may follow. Of the experiments only
the one is loaded whose options are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import click
from click.shell_completion import BashComplete, CompletionItem, FishComplete, ShellComplete, ZshComplete

__all__ = ["SHELLS", "VARIABLE", "Tree", "answer", "files", "folders", "script", "setting_keys"]

PROGRAM = "starbench"
VARIABLE = "_STARBENCH_COMPLETE"


class _Bash(BashComplete):
    """No space after ``key=``."""

    source_template = BashComplete.source_template.replace(
        "    return 0\n",
        "    [[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == *= ]] && compopt -o nospace\n    return 0\n",
    )


class _Zsh(ZshComplete):
    """No space after ``key=``."""

    source_template = ZshComplete.source_template.replace(
        'completions_with_descriptions+=("$key":"$descr")',
        'if [[ "$key" == *= ]]; then settings+=("$key":"$descr"); '
        'else completions_with_descriptions+=("$key":"$descr"); fi',
    ).replace(
        '    if [ -n "$completions" ]',
        '    if [ -n "$settings" ]; then _describe -V unsorted settings -U -S \'\'; fi\n\n    if [ -n "$completions" ]',
    )


_SHELLS: dict[str, type[ShellComplete]] = {"bash": _Bash, "zsh": _Zsh, "fish": FishComplete}
SHELLS = tuple(_SHELLS)


class Tree(click.Group):
    """All commands by name, each loaded when its own words are asked for."""

    def __init__(
        self, lines: Mapping[str, str], load: Callable[[str], click.Command], options: Iterable[str] = ()
    ) -> None:
        super().__init__(PROGRAM, params=[click.Option([option], is_flag=True) for option in options])
        self._lines, self._load = dict(lines), load

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Their names."""
        del ctx
        return list(self._lines)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """One of them, loaded."""
        del ctx
        return self._load(cmd_name) if cmd_name in self._lines else None

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem[Any]]:
        """Names that begin so, none of them loaded; and options."""
        names = [CompletionItem(name, help=line) for name, line in self._lines.items() if name.startswith(incomplete)]
        return [*names, *click.Command.shell_complete(self, ctx, incomplete)]


def answer(tree: Tree, instruction: str) -> int:
    """Print what a shell asks for with ``VARIABLE=bash_complete`` and its like; the exit status."""
    shell, _, what = instruction.partition("_")
    if shell not in _SHELLS or what != "complete":
        return 1
    click.echo(_SHELLS[shell](tree, {}, PROGRAM, VARIABLE).complete())
    return 0


def script(shell: str) -> str:
    """What the shell has to read to complete ``starbench``."""
    return _SHELLS[shell](click.Group(PROGRAM), {}, PROGRAM, VARIABLE).source()


def files(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem[Any]]:
    """Any file."""
    del context, parameter
    return [CompletionItem(incomplete, type="file")]


def folders(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem[Any]]:
    """Any folder."""
    del context, parameter
    return [CompletionItem(incomplete, type="dir")]


def setting_keys(keys: Callable[[], Mapping[str, Any]]) -> Callable[..., list[CompletionItem[Any]]]:
    """Keys of a configuration, each with its description; ``keys()`` gives the fields by dotted name."""

    def complete(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem[Any]]:
        del context, parameter
        return [
            CompletionItem(f"{key}=", help=" ".join((field.description or "").split()) or None)
            for key, field in keys().items()
            if key.startswith(incomplete)
        ]

    return complete
