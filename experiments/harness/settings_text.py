"""A configuration as a commented TOML file with exact round trip, and its comments for documentation pages."""

from __future__ import annotations

import textwrap
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from optics.settings import absolute, alternatives, is_model, unit_of
from optics.textfile import toml_value
from optics.validate import allowed_range

_WIDTH = 110


def toml_text(config: BaseModel, heading: str = "") -> str:
    """A configuration as TOML with every key; its meaning, unit and allowed range are a comment.

    Keys without a value (TOML has none for that) are written as comments. Paths become absolute, so that the text means
    the same wherever it is saved.
    """
    lines = [f"# {line}".rstrip() for line in textwrap.wrap(heading, _WIDTH)]
    lines += [*([""] if lines else []), *_table(config, ())]
    return "\n".join(lines).strip() + "\n"


def about(name: str, field: FieldInfo) -> str:
    """Meaning of a key, with unit and allowed values by its name, type and constraints."""
    text, unit = field.description or "", ""
    if text.endswith("]"):
        text, _, unit = text[:-1].rpartition(" [")
    choices = " or ".join(map(toml_value, _choices(field.annotation)))
    facts = ", ".join(fact for fact in (unit or unit_of(name), choices, allowed_range(field)) if fact)
    return f"{text}{f' [{facts}]' if facts else ''}".strip()


def _choices(annotation: Any) -> list[Any]:
    """The values of a Literal, true or false."""
    if annotation is bool:
        return [True, False]
    if typing.get_origin(annotation) is typing.Literal:
        return list(typing.get_args(annotation))
    return [choice for part in typing.get_args(annotation) for choice in _choices(part)]


def _table(config: BaseModel, at: tuple[str, ...]) -> Iterator[str]:
    """Keys with plain values first: in TOML they would belong to the table above otherwise."""
    tables: list[tuple[str, FieldInfo, str, BaseModel]] = []
    for name, field in type(config).model_fields.items():
        value, key = getattr(config, name), ".".join((*at, name))
        if isinstance(value, BaseModel):
            tables.append((name, field, f"[{key}]", value))
        elif isinstance(value, tuple) and value and all(isinstance(item, BaseModel) for item in value):
            tables.extend((name, field, f"[[{key}]]", item) for item in value)
        else:
            yield from _comment(about(name, field))
            yield f"# {name} =" if value is None else f"{name} = {toml_value(absolute(field, value))}"
    for name, field, head, table in tables:
        yield from ["", head, *_comment(_about_table(field, table))]
        yield from _table(table, (*at, name))


def _about_table(field: FieldInfo, table: BaseModel) -> str:
    words = field.description or (type(table).__doc__ or "").strip().partition("\n\n")[0]
    models = [part for part in alternatives(field.annotation) if is_model(part)]
    kinds = [model.model_fields["kind"].default for model in models if "kind" in model.model_fields]
    return words + (f" (kinds, each with its own keys: {', '.join(kinds)})" if len(kinds) > 1 else "")


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(" ".join(text.split()), _WIDTH)]
