"""Validated configuration: a mapping (from TOML or a command line) becomes a pydantic model; one line per fault."""

from __future__ import annotations

import difflib
import re
import tomllib
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from optics.errors import ConfigError, unknown_name
from optics.textfile import read_text

Model = TypeVar("Model", bound=BaseModel)
Location = tuple[int | str, ...]

MOST_LEVELS = 16
"""Nesting of tables and lists in a file."""
MOST_DOTS = 100
_LONG_KEY = re.compile(rf"(?:[\w\"'-]++\s*+\.\s*+){{{MOST_DOTS},}}")
_UNQUOTED = re.compile(
    r"^[ \t]*([\w.-]+)[ \t]*=[ \t]*(?!(?:true|false|inf|nan)[ \t]*(?:#|$))([a-z_~./\\][^\"'#=\[\]{}\n]*?)[ \t]*(?:#|$)",
    re.IGNORECASE | re.MULTILINE,
)
"""A key whose value is text without quotation marks."""
MOST_MISSING = 3
"""More missing keys than these are listed by name alone."""
_NEEDED = {
    "finite_number": "a finite number is needed",
    "float_type": "a number is needed",
    "float_parsing": "a number is needed",
    "int_type": "a whole number is needed",
    "int_parsing": "a whole number is needed",
    "int_from_float": "a whole number is needed",
    "bool_type": "true or false is needed",
    "bool_parsing": "true or false is needed",
    "string_type": "text is needed, in quotation marks",
}
"""Sentences in place of pydantic's."""
_OUT_OF_BOUNDS = frozenset(("greater_than", "greater_than_equal", "less_than", "less_than_equal"))
_BOUNDS = (("gt", "above {}"), ("ge", "at least {}"), ("lt", "below {}"), ("le", "at most {}"))


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class StrictTable(BaseModel):
    """Base of tables: frozen, unknown keys and values of another type are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _of_their_types(cls, table: Any) -> Any:
        return without_lax(table, cls)


def parse_model(
    model_class: type[Model], mapping: Mapping[str, Any], where: str | Callable[[list[int | str], str], str]
) -> Model:
    """Validate a mapping; ``where``: its source, or the line of a message, given the location of a fault and a sentence
    on it."""
    if not isinstance(mapping, Mapping):
        raise ConfigError(f"{where}: a table of keys is needed, got {_shown(mapping)}")
    try:
        return model_class.model_validate(dict(mapping))
    except ValidationError as error:
        faults = _faults(model_class, error)
    raise _refusal(model_class, faults, where)


def refuse_values(
    model_class: type[BaseModel], mapping: Mapping[str, Any], given: Mapping[str, Any], where: str
) -> None:
    """Refuse invalid values of one layer of settings, also if a later layer replaces them.

    Faults of tables as wholes, and of values that the layer does not hold, are left to `parse_model` of all layers.
    """
    try:
        model_class.model_validate(dict(mapping))
    except ValidationError as error:
        faults = [f for f in _faults(model_class, error) if _is_value(given, _without_tags(model_class, f["loc"]))]
        if faults:
            raise _refusal(model_class, faults, where) from None


def _is_value(given: Any, location: list[int | str]) -> bool:
    """Whether there is a value at a location, and no table."""
    for step in location:
        try:
            given = given[step]
        except (LookupError, TypeError):
            return False
    return not isinstance(given, Mapping)


def _faults(model_class: type[BaseModel], error: ValidationError) -> list[dict[str, Any]]:
    """Faults of a value; of several allowed types, the fault by the nearest one."""
    faults: list[dict[str, Any]] = [dict(fault) for fault in error.errors(include_url=False)]
    of_types: dict[Location, dict[Any, list[dict[str, Any]]]] = {}
    for fault in faults:
        at = _type_at(model_class, fault["loc"])
        if at is not None:
            of_types.setdefault(fault["loc"][:at], {}).setdefault(fault["loc"][at], []).append(fault)
    for types in of_types.values():
        nearest = min(reversed(types.values()), key=len)  # with equal numbers of faults the type named last
        for others in types.values():
            faults = [fault for fault in faults if others is nearest or fault not in others]
    return [fault for fault in faults if not _follows(fault, faults) and not _misspelt(model_class, fault, faults)]


def _type_at(model_class: type[BaseModel], location: Location) -> int | None:
    """Position in a location of the name of one of several types, below a key that holds no table."""
    for at, step in enumerate(location):
        if at and isinstance(step, str) and not _owners(model_class, location[:at]):
            return at
    return None


def _refusal(
    model_class: type[BaseModel], faults: list[dict[str, Any]], where: str | Callable[[list[int | str], str], str]
) -> ConfigError:
    if not isinstance(where, str):
        lines = [where(_without_tags(model_class, fault["loc"]), _sentence(model_class, fault)) for fault in faults]
        return ConfigError("\n".join(dict.fromkeys(lines)))
    sentences = [_sentence(model_class, fault) for fault in faults]
    missing = [fault for fault in faults if fault["type"] == "missing"]
    if len(missing) > MOST_MISSING:
        keys = [".".join(map(str, _without_tags(model_class, fault["loc"]))) for fault in missing]
        others = [_sentence(model_class, fault) for fault in faults if fault not in missing]
        sentences = [*others, f"{len(keys)} keys are missing: {', '.join(keys)}"]
    return ConfigError("\n".join((f"{where}: {sentences[0]}", *dict.fromkeys(sentences[1:]))))


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file."""
    text = "\n".join(read_text(path, "a TOML file").lines)
    if _LONG_KEY.search(text):  # tomllib takes memory with the square of the dots
        raise ConfigError(f"{path}: a key has more than {MOST_DOTS} dots; {MOST_LEVELS} levels are allowed")
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, a thousand brackets
        unquoted = _UNQUOTED.search(text)
        advice = f'; text needs quotation marks, quote it: {unquoted[1]} = "{unquoted[2]}"' if unquoted else ""
        raise ConfigError(f"{path}: not valid TOML ({' '.join(str(error).split())[:200]}){advice}") from None
    if _deeper(table, MOST_LEVELS):
        raise ConfigError(f"{path}: tables and lists are nested too deeply; {MOST_LEVELS} levels are allowed")
    return table


def _deeper(table: Any, levels: int) -> bool:
    """Whether tables and lists exceed a number of levels; without recursion, whose depth is limited."""
    inside = [table]
    for _ in range(levels):
        values = (value for part in inside for value in (part.values() if isinstance(part, dict) else part))
        inside = [value for value in values if isinstance(value, dict | list)]
    return bool(inside)


class _Lax:
    """A value that pydantic would convert unintentionally; no field takes it, messages show the value."""

    def __init__(self, value: Any, needed: str) -> None:
        self.value, self.needed = value, needed

    def __repr__(self) -> str:
        return repr(self.value)


def without_lax(values: Any, model_class: type[BaseModel]) -> Any:
    """Values of a model without those that pydantic would convert: true or "1.5" for a number, "yes" for true."""
    if not isinstance(values, Mapping):
        return values
    fields = model_class.model_fields
    return {
        key: _strict(value, _leaves(fields[key].annotation)) if key in fields else value
        for key, value in values.items()
    }


def _strict(value: Any, leaves: set[Any]) -> Any:
    if isinstance(value, list | tuple):
        return [_strict(item, leaves) for item in value]
    if isinstance(value, bool | str) and {float, int} & leaves and type(value) not in leaves:
        return _Lax(value, "a number is needed, without quotation marks")
    if isinstance(value, str | int | float) and leaves == {bool} and not isinstance(value, bool):
        return _Lax(value, "true or false is needed, without quotation marks")
    return value


def _leaves(annotation: Any) -> set[Any]:
    """Plain types that an annotation is made of; str for a literal one."""
    if typing.get_origin(annotation) is typing.Annotated:
        return _leaves(typing.get_args(annotation)[0])
    if typing.get_origin(annotation) is typing.Literal:
        return {type(value) for value in typing.get_args(annotation)}
    inner = typing.get_args(annotation)
    return set().union(*map(_leaves, inner)) if inner else {annotation}


def _follows(fault: dict[str, Any], faults: list[dict[str, Any]]) -> bool:
    """Whether a list is only too short because of faults of its items, which have their own messages."""
    at = fault["loc"]
    return fault["type"] == "too_short" and any(other["loc"][: len(at)] == at for other in faults if other != fault)


def _misspelt(model_class: type[BaseModel], fault: dict[str, Any], faults: list[dict[str, Any]]) -> bool:
    """Whether a key is missing because an unknown key of the same table is meant for it, which has its own message."""
    if fault["type"] != "missing":
        return False
    *table, name = fault["loc"]
    here = [other for other in faults if [*other["loc"][:-1]] == table]
    unknown = [other["loc"] for other in here if other["type"] == "extra_forbidden"]
    if sum(other["type"] == "missing" for other in here) > len(unknown):
        return False  # a file of another kind
    return any(_nearest(str(loc[-1]), _known(model_class, loc[:-1]), {}) == name for loc in unknown)


def _known(model_class: type[BaseModel], table: Location) -> list[str]:
    """Keys of a table, sorted."""
    return sorted({name for owner in _owners(model_class, table) for name in owner.model_fields})


def _sentence(model_class: type[BaseModel], fault: dict[str, Any]) -> str:
    location: Location = fault["loc"]
    key = ".".join(str(step) for step in _without_tags(model_class, location)) or "(whole table)"
    kind = fault["type"]
    if kind == "extra_forbidden":
        table = location[:-1]
        keys = _known(model_class, table)
        if table and _is_tag(_owners(model_class, table[:-1]), table[-1]):
            for other in _owners(model_class, table[:-1]):
                if location[-1] in other.model_fields:
                    chosen = key.removesuffix(f".{location[-1]}")
                    return f"key {key!r} goes with {chosen}.kind = {_kind(other)!r}; set that too"
        near = _nearest(str(location[-1]), keys, dotted_fields(model_class))
        hint = f"did you mean {near!r}?" if near else f"known keys: {', '.join(keys)}"
        return f"unknown key {key!r}; {hint}"
    if kind == "union_tag_invalid":
        kinds = [_kind(owner) for owner in _owners(model_class, location)]
        return str(unknown_name(f"{key}.kind", str(fault["ctx"]["tag"]), kinds))
    if kind == "missing":
        return f"key {key!r} is missing{_allowed(model_class, location)}"
    reason = _reason(fault)
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        keys = _known(model_class, location)
        reason = "a table is needed" + (f" with the keys {', '.join(keys)}" if keys else "")
    if kind in ("tuple_type", "list_type"):
        tables = bool(_owners(model_class, location))
        reason = f"a list of tables is needed, [[{key}]] before each" if tables else "a list is needed, such as [1, 2]"
    if isinstance(fault.get("input"), _Lax):
        reason = fault["input"].needed
    if not location:  # a check of the whole model
        return reason
    given = fault.get("input")
    is_table = isinstance(given, Mapping) and bool(_owners(model_class, location))
    shown, allowed = key if is_table else f"{key} = {_shown(given)}", _allowed(model_class, location)
    if kind in _OUT_OF_BOUNDS and "allowed:" in allowed:
        reason = "out of range"
    return f"{shown}: {reason}{allowed}"


def _reason(fault: Mapping[str, Any]) -> str:
    """Fault of a value, in words for its author."""
    if fault["type"] in _NEEDED:
        return _NEEDED[fault["type"]]
    limits = fault.get("ctx", {})
    for kind, least, words in (("too_short", "min_length", "at least"), ("too_long", "max_length", "at most")):
        if fault["type"] == kind and "actual_length" in limits:
            return f"{words} {limits[least]} values are needed, not {limits['actual_length']}"
    message = str(fault["msg"]).removeprefix("Value error, ").replace("\n", " ")
    return message.replace("Input should be ", "it must be ")


def dotted_fields(model_class: type[BaseModel], prefix: str = "", levels: int = MOST_LEVELS) -> dict[str, FieldInfo]:
    """Fields of a model and of its tables by their dotted keys; tables in lists are left out."""
    fields: dict[str, FieldInfo] = {}
    for name, field in model_class.model_fields.items():
        fields[prefix + name] = field
        listed = typing.get_origin(field.annotation) in (list, tuple, dict)
        for table in () if listed or levels == 0 else _models_in(field.annotation):
            fields |= dotted_fields(table, f"{prefix}{name}.", levels - 1)
    return fields


def full_key(model_class: type[BaseModel], name: str, spellings: Mapping[str, str] = MappingProxyType({})) -> str:
    """Dotted key of a model that a name stands for: the key itself, or its last words.

    Of several keys with these last words the outermost table's is meant. A name that no key ends with is returned as it
    is. ``spellings``: tables or keys that stand elsewhere in the model -> where, preferred among several keys.

    Raises
    ------
    ConfigError
        Several keys of the outermost tables end with the name.
    """
    words = name.split(".")
    if words[0] in model_class.model_fields:
        return name
    for table, key in spellings.items():
        if f"{name}.".startswith(f"{table}."):
            return key + name.removeprefix(table)
    fields = dotted_fields(model_class)
    for count in range(len(words), 0, -1):  # numbers of items, keys of an open table may follow
        ending, rest = "." + ".".join(words[:count]), words[count:]
        keys = [key for key in fields if key.endswith(ending)]
        keys = [key for key in keys if f"{key}.".startswith(tuple(f"{at}." for at in spellings.values()))] or keys
        keys = [key for key in keys if key.count(".") == min(key.count(".") for key in keys)]
        if len(keys) > 1:
            raise ConfigError(f"key {name!r} is ambiguous: {' or '.join(keys)}; write one of them")
        if keys:
            return ".".join((*keys, *rest))
    return name


def _nearest(name: str, siblings: Iterable[str], all_keys: Iterable[str]) -> str:
    """The intended key: of the same table, or a nearer one of another table with its path; "" for none."""

    def likeness(key: str) -> float:
        last = key.rpartition(".")[2]
        return max(
            difflib.SequenceMatcher(None, name, last).ratio(),
            0.98 * difflib.SequenceMatcher(None, name, last.rpartition("_")[0]).ratio(),  # without its unit
        )

    sibling = max(siblings, key=likeness, default="")
    other = max(all_keys, key=likeness, default="")
    best = other if other and likeness(other) > max(likeness(sibling) + 0.05, 0.75) else sibling
    return best if best and likeness(best) >= 0.5 else ""


def _shown(value: Any) -> str:
    text = repr(value).replace("\n", " ")
    return text if len(text) <= 60 else text[:57] + "..."


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from _models_in(argument)


def _owners(model_class: type[BaseModel], location: Location) -> list[type[BaseModel]]:
    """Models that the table at ``location`` may be; the tag of a union chooses one, list indices are skipped."""
    owners = [model_class]
    for step in location:
        if _is_tag(owners, step):
            owners = [owner for owner in owners if _kind(owner) == step]
        elif fields := [owner.model_fields[step] for owner in owners if step in owner.model_fields]:
            owners = [model for field in fields for model in _models_in(field.annotation)]
    return owners


def _kind(model_class: type[BaseModel]) -> Any:
    return model_class.model_fields["kind"].default if "kind" in model_class.model_fields else None


def _is_tag(owners: list[type[BaseModel]], step: int | str) -> bool:
    """Whether a step of a location is the ``kind`` of a model among other types; a key of a single model may be
    named as a kind."""
    kinds = [_kind(owner) for owner in owners if "kind" in owner.model_fields]
    is_key = len(owners) == 1 and step in owners[0].model_fields
    return step in kinds and not is_key


def _without_tags(model_class: type[BaseModel], location: Location) -> list[int | str]:
    """The location as a user writes it: without tags, and without the name of one of several types."""
    at = _type_at(model_class, location)
    if at is not None:
        location = (*location[:at], *location[at + 1 :])
    return [step for at, step in enumerate(location) if not _is_tag(_owners(model_class, location[:at]), step)]


def _field(model_class: type[BaseModel], location: Location) -> FieldInfo | None:
    names = [depth for depth, step in enumerate(location) if isinstance(step, str)]
    for depth in reversed(names):
        for owner in _owners(model_class, location[:depth]):
            if location[depth] in owner.model_fields:
                return owner.model_fields[str(location[depth])]
    return None


def _allowed(model_class: type[BaseModel], location: Location) -> str:
    """Allowed range of the field and what it is, as far as the model says so."""
    field = _field(model_class, location)
    if field is None:
        return ""
    bounds = allowed_range(field)
    return (f" (allowed: {bounds})" if bounds else "") + (f" [{field.description}]" if field.description else "")


def allowed_range(field: FieldInfo) -> str:
    """Bounds of a field in words, such as ``above 0 and at most 1000``; "" if it has none."""
    bounds = [
        text.format(_number(getattr(constraint, name)))
        for name, text in _BOUNDS
        for constraint in _constraints(field)
        if getattr(constraint, name, None) is not None
    ]
    return " and ".join(dict.fromkeys(bounds))  # items of a list repeat them


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _constraints(field: FieldInfo) -> Iterator[Any]:
    """Constraints of the field itself, or of the single type that it may hold other than None."""
    yield from field.metadata
    for part in typing.get_args(field.annotation):
        if typing.get_origin(part) is typing.Annotated:
            for extra in typing.get_args(part)[1:]:
                yield from extra.metadata if isinstance(extra, FieldInfo) else (extra,)
