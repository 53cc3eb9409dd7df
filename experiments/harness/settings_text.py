"""A configuration as text: a commented TOML file that reads back the same, and the same comments for pages."""

from __future__ import annotations

import json
import textwrap
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from experiments.harness.config import absolute, alternatives, unit_of
from optics.validate import allowed_range

__all__ = ["about", "toml_text", "toml_value"]

_WIDTH = 110


def toml_text(config: BaseModel, heading: str = "") -> str:
    """A configuration as TOML with every key, what it means, its unit and its allowed range as a comment.

    Keys without a value (TOML has none for that) are written as comments. Paths become absolute, so that the text means
    the same wherever it is saved.
    """
    lines = [f"# {line}".rstrip() for line in textwrap.wrap(heading, _WIDTH)]
    lines += [*([""] if lines else []), *_table(config, ())]
    return "\n".join(lines).strip() + "\n"


def toml_value(value: Any) -> str:
    """A number, text, truth value or list of them as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(toml_value, value))}]"
    return repr(value)


def about(name: str, field: FieldInfo) -> str:
    """What a key means, with unit and allowed values as far as its name, type and constraints tell."""
    facts = [unit_of(name), _choices(field.annotation), allowed_range(field)]
    told = ", ".join(fact for fact in facts if fact)
    return f"{field.description or ''}{f' [{told}]' if told else ''}".strip()


def _choices(annotation: Any) -> str:
    """The values of a Literal, ``true or false``."""
    found = list(_literals(annotation))
    return " or ".join(toml_value(value) for value in found)


def _literals(annotation: Any) -> Iterator[Any]:
    if typing.get_origin(annotation) is typing.Literal:
        yield from typing.get_args(annotation)
    elif annotation is bool:
        yield from (True, False)
    else:
        for part in typing.get_args(annotation):
            yield from _literals(part)


def _table(config: BaseModel, at: tuple[str, ...]) -> Iterator[str]:
    """Keys with plain values first: in TOML they would belong to the table above otherwise."""
    fields = type(config).model_fields
    tables = {name: getattr(config, name) for name in fields if _is_table(getattr(config, name))}
    for name, field in fields.items():
        if name not in tables:
            yield from _key(name, field, getattr(config, name))
    for name, value in tables.items():
        here = (*at, name)
        for one in (value,) if isinstance(value, BaseModel) else value:
            yield from ["", f"[{'.'.join(here)}]" if isinstance(value, BaseModel) else f"[[{'.'.join(here)}]]"]
            yield from _comment(_about_table(fields[name], one))
            yield from _table(one, here)


def _is_table(value: Any) -> bool:
    several = isinstance(value, tuple) and bool(value) and all(isinstance(one, BaseModel) for one in value)
    return isinstance(value, BaseModel) or several


def _about_table(field: FieldInfo, config: BaseModel) -> str:
    words = field.description or (type(config).__doc__ or "").strip().partition("\n\n")[0]
    kinds = [
        part.model_fields["kind"].default
        for part in alternatives(field.annotation)
        if isinstance(part, type) and issubclass(part, BaseModel) and "kind" in part.model_fields
    ]
    return words + (f" (kinds, each with its own keys: {', '.join(kinds)})" if len(kinds) > 1 else "")


def _key(name: str, field: FieldInfo, value: Any) -> Iterator[str]:
    yield from _comment(about(name, field))
    if value is None:
        yield f"# {name} ="
    else:
        yield f"{name} = {toml_value(absolute(field, value))}"


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(" ".join(text.split()), _WIDTH)]
