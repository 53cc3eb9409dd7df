"""Configuration of an experiment: a checked pydantic model, read in layers (defaults, quick, file, ``--set``, seed)."""

from __future__ import annotations

import re
import tomllib
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, Field, TypeAdapter, ValidationError

from optics.errors import ConfigError
from optics.settings import StrictModel, alternatives, is_model, read_settings
from optics.validate import MOST_LEVELS, parse_model, refuse_values

Model = TypeVar("Model", bound=BaseModel)


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError("an odd number is needed")
    return value


OddPx = Annotated[int, AfterValidator(_odd)]
"""Type of the side of a window with a pixel in its middle."""


AngleDeg = Annotated[float, Field(ge=-360, le=360)]
"""Type of an angle in a list of them."""
PlacePx = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Type of a coordinate on a detector in a list of them."""
Sorted = AfterValidator(lambda values: tuple(sorted(set(values))))
"""Marks a list whose values count once each, in rising order."""


class ExperimentConfig(StrictModel):
    """Base of an experiment's `Config`; its defaults are the published run.

    Every field needs a default and should carry a ``Field(description=...)``: the descriptions appear in error messages
    and in the JSON schema.
    """

    seed: int = Field(default=1, ge=0, le=2**63 - 1, description="seed of all random streams")

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """Settings of this experiment that a sensor file decides."""
        raise ConfigError(f"--sensor {file}: this experiment takes no sensor file")

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Settings that others decide where no layer says anything, such as a lens file its pass band; none here."""
        return {}

    def remarks(self) -> tuple[str, ...]:
        """Remarks on these settings for the report, in Markdown; none here."""
        return ()

    def notes(self) -> tuple[str, ...]:
        """Remarks on these settings in the terminal before the run; none here."""
        return ()

    def as_sensor(self, file: Path | None) -> StrictModel | None:
        """The sensor file that describes what this configuration runs with; None where it has no such sensor."""
        return None


def load_config(
    model_class: type[Model],
    *,
    quick: Mapping[str, Any] | None = None,
    sensor: str | Path | None = None,
    file: str | Path | None = None,
    settings: Sequence[str] = (),
    options: Mapping[str, str] | None = None,
    seed: int | None = None,
) -> Model:
    """Configuration from its layers; a later layer wins, and only the keys that it names.

    Values that the layers imply (`ExperimentConfig.implied`) yield to all that the user sets.
    """
    base = model_class().model_dump()
    for key, value in (quick or {}).items():
        base = _with_value(model_class, base, key, value, f"quick setting {key!r}")
    tables: dict[str, Mapping[str, Any]] = {}
    if sensor is not None:
        tables[str(sensor)] = _as_experiment(model_class).of_sensor(Path(sensor))
    if file is not None:
        tables[str(file)] = read_settings(model_class, file)
    given = [*(("--set", one) for one in settings), *((f"--{name}", one) for name, one in (options or {}).items())]
    if seed is not None:
        given.append(("--seed", f"seed={seed}"))

    def overlaid(below: dict[str, Any]) -> dict[str, Any]:
        for table in tables.values():
            below = _laid(model_class, below, table)
        if file is not None:
            refuse_values(model_class, below, tables[str(file)], str(file))
        for name, setting in given:
            below = with_settings(model_class, below, [setting], name)
        return below

    values = overlaid(base)
    if issubclass(model_class, ExperimentConfig) and (implied := model_class.implied(values)):
        values = overlaid(_laid(model_class, base, implied))

    def source(location: Sequence[int | str]) -> str:
        """The last layer that holds a value, or part of a table."""
        path = [str(step) for step in location]
        for option, setting in reversed(given):
            key = setting.partition("=")[0].strip().split(".")
            if all(one == other for one, other in zip(key, path, strict=False)):
                return f"--set {setting}" if option == "--set" else option
        return next((name for name in reversed(tables) if _holds(tables[name], path)), "configuration")

    # One look at the whole: two settings may be valid only together.
    return parse_model(model_class, values, source)


def _holds(table: Any, path: Sequence[str]) -> bool:
    """Whether nested tables and lists have an entry at a path."""
    for step in path:
        if isinstance(table, Mapping) and step in table:
            table = table[step]
        elif isinstance(table, list | tuple) and step.isdigit() and int(step) < len(table):
            table = table[int(step)]
        else:
            return False
    return True


def _as_experiment(model_class: type[BaseModel]) -> type[ExperimentConfig]:
    if not issubclass(model_class, ExperimentConfig):
        raise TypeError(f"{model_class.__name__} is no ExperimentConfig")
    return model_class


def with_settings(
    model_class: type[BaseModel], values: Mapping[str, Any], settings: Iterable[str], option: str = "--set"
) -> dict[str, Any]:
    """Apply ``key=value`` settings to a configuration mapping, without validating it."""
    result = dict(values)
    for setting in settings:
        key, equals, text = setting.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ConfigError(f"--set {setting}: key=value is needed, e.g. --set seed=7")
        if key.count(".") > MOST_LEVELS:
            raise ConfigError(f"--set {key[:60]}...: no key has more than {MOST_LEVELS} dots")
        value = _typed(_annotation_at(model_class, key.split(".")), text.strip())
        result = _with_value(model_class, result, key, value, f"--set {setting}" if option == "--set" else option)
    return result


def _with_value(
    model_class: type[BaseModel], values: Mapping[str, Any], key: str, value: Any, where: str
) -> dict[str, Any]:
    """Copy of a configuration with the value at a dotted key; items of a list are keys by number."""
    keys, above = key.split("."), value
    for word in reversed(keys):
        above = {word: above}
    result: dict[str, Any] = _laid(model_class, values, above, where=where, levels=len(keys))
    return result


def _laid(
    model_class: type[BaseModel],
    below: Any,
    above: Any,
    at: tuple[str, ...] = (),
    *,
    where: str = "",
    levels: int = MOST_LEVELS,
) -> Any:
    """Tables laid over one another, key by key, except where another ``kind`` of table takes the place.

    With ``where`` it is a single value that is laid, over items of lists too, and what it cannot lie on is an error.
    """
    if not levels or not isinstance(above, Mapping):
        return above

    def entry(old: Any, key: str) -> Any:
        return _laid(model_class, old, above[key], (*at, key), where=where, levels=levels - 1)

    if where and isinstance(below, (list, tuple)):
        (key,) = above
        if not re.fullmatch(r"\d+", key) or int(key) >= len(below):
            raise ConfigError(f"{where}: {'.'.join(at)} has items 0 to {len(below) - 1}, not {key!r}")
        return [entry(old, key) if place == int(key) else old for place, old in enumerate(below)]
    if not isinstance(below, Mapping):
        if where and below is not None:
            raise ConfigError(f"{where}: {'.'.join(at)} = {below!r} is no table; it has no key {next(iter(above))!r}")
        return dict(above)
    if above.get("kind", below.get("kind")) != below.get("kind") and _several_kinds(model_class, at):
        return dict(above)  # the keys of the other kind mean nothing to this one
    return {**below, **{key: entry(below.get(key), key) for key in above}}


def _several_kinds(model_class: type[BaseModel], keys: Sequence[str]) -> bool:
    """Whether the table at a key may be one of several models, distinguished by their field ``kind``."""
    models = [part for part in alternatives(_annotation_at(model_class, keys)) if is_model(part)]
    return len(models) > 1 and all("kind" in model.model_fields for model in models)


def _annotation_at(model_class: type[BaseModel], keys: Sequence[str]) -> Any:
    """Type of the field at a dotted key, or None where the model does not know it."""
    annotations: list[Any] = [model_class]
    for key in keys:
        found: list[Any] = []
        for annotation in annotations:
            for part in alternatives(annotation):
                if is_model(part):
                    if key in part.model_fields:
                        found.append(part.model_fields[key].annotation)
                elif key.isdigit() and typing.get_origin(part) in (list, tuple):
                    found.extend(argument for argument in typing.get_args(part) if argument is not Ellipsis)
        annotations = found
    if not annotations:
        return None
    return typing.Union[tuple(annotations)]  # noqa: UP007  # the members are known at run time only


def _typed(annotation: Any, text: str) -> Any:
    """The text as a TOML value where the field takes that; otherwise the bare text."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, KeyError, RecursionError):  # no TOML, a number of thousands of digits, a thousand brackets
        return text
    if annotation is None or _takes(annotation, value) or not _takes(annotation, text):
        return value
    return value if isinstance(value, str) else text


def _takes(annotation: Any, value: Any) -> bool:
    try:
        TypeAdapter(annotation).validate_python(value)
    except ValidationError:
        return False
    return True
