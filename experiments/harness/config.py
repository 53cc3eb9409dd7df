"""Configuration of an experiment: a checked pydantic model, read in layers (defaults, quick, file, ``--set``, seed)."""

from __future__ import annotations

import re
import tomllib
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar, cast

from pydantic import AfterValidator, BaseModel, Field, TypeAdapter, ValidationError

from optics.errors import ConfigError
from optics.settings import StrictModel, alternatives, flat, is_model, read_settings
from optics.validate import MOST_LEVELS, full_key, parse_model, refuse_values

Model = TypeVar("Model", bound=BaseModel)


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError("an odd number is needed")
    return value


OddPx = Annotated[int, AfterValidator(_odd)]
"""Type of the side of a window with a pixel in its middle."""


AngleDeg = Annotated[float, Field(ge=-360, le=360)]
"""Type of an angle in a list of them."""

PositionPx = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Type of a coordinate on a detector in a list of them."""
Sorted = AfterValidator(lambda values: tuple(sorted(set(values))))
"""Marks a list whose values count once each, in rising order."""


class ExperimentConfig(StrictModel):
    """Base of an experiment's `Config`; its defaults are the published run.

    Every field needs a default, and a ``Field(description=...)`` for error messages and the JSON schema.
    """

    SENSOR_KEYS: ClassVar[Mapping[str, str]] = {}
    """Tables and keys of a sensor file that stand elsewhere in this configuration -> where. With a sensor file, every
    layer of settings takes both spellings."""

    seed: int = Field(default=1, ge=0, le=2**63 - 1, description="seed of all random streams")

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """Settings of this experiment that a sensor file decides."""
        raise ConfigError(f"--sensor {file}: this experiment takes no sensor file")

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Defaults that follow from other settings, such as a pass band from a lens file; none here."""
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

    Every layer takes the keys that `optics.validate.full_key` takes. Values that the layers imply
    (`ExperimentConfig.implied`) yield to all that the user sets.

    Raises
    ------
    ConfigError
        One line: source of the wrong value, key, value and allowed range.
    """
    spellings = getattr(model_class, "SENSOR_KEYS", {}) if sensor is not None else {}
    base = model_class().model_dump()
    for key, value in (quick or {}).items():
        base = _with_value(model_class, base, key, value, "--quick")
    tables: dict[str, Mapping[str, Any]] = {}
    if sensor is not None:
        tables[str(sensor)] = cast(type[ExperimentConfig], model_class).of_sensor(Path(sensor))
    if file is not None:
        tables[str(file)] = read_settings(model_class, file, spellings)
    texts = [(f"--set {text}", text) for text in settings]
    texts += [(f"--{name}", text) for name, text in (options or {}).items()]
    texts += [("--seed", f"seed={seed}")] if seed is not None else []
    assignments = [(source, *_assignment(model_class, source, text, spellings)) for source, text in texts]

    def overlaid(values: dict[str, Any]) -> dict[str, Any]:
        for table in tables.values():
            values = _merged(model_class, values, table)
        if file is not None:
            refuse_values(model_class, values, tables[str(file)], str(file))
        for source, key, value in assignments:
            values = _with_value(model_class, values, key, value, source)
        return values

    values = overlaid(base)
    if issubclass(model_class, ExperimentConfig) and (implied := model_class.implied(values)):
        values = overlaid(_merged(model_class, base, implied))
    sources = dict.fromkeys(quick or (), "--quick")
    sources |= {key: name for name, table in tables.items() for key in flat(table)}
    for source, key, _ in assignments:
        sources = {name: stated for name, stated in sources.items() if not name.startswith(f"{key}.")} | {key: source}

    def line(location: Sequence[int | str], sentence: str) -> str:
        source = _source(sources, ".".join(map(str, location)), sentence)
        if source == str(sensor):
            for spelling, key in spellings.items():
                sentence = sentence.replace(key, spelling)
        return sentence if sentence.startswith(source) else f"{source}: {sentence}"

    # Settings may be valid only together, so that all are validated at once
    return parse_model(model_class, values, line)


def _assignment(model_class: type[BaseModel], source: str, text: str, spellings: Mapping[str, str]) -> tuple[str, Any]:
    """Key and value of ``key=value``."""
    name, equals, written = text.partition("=")
    name = name.strip()
    if not equals or not name:
        raise ConfigError(f"{source}: key=value is needed, e.g. --set seed=7")
    if name.count(".") > MOST_LEVELS:
        raise ConfigError(f"--set {name[:60]}...: no key has more than {MOST_LEVELS} dots")
    try:
        key = full_key(model_class, name, spellings)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None
    return key, _typed(_annotation_at(model_class, key.split(".")), written.strip())


def _source(sources: Mapping[str, str], path: str, sentence: str) -> str:
    """Source of the value at a path; of a fault of several values, the sources of those that the sentence names."""
    if above := [key for key in sources if f"{path}.".startswith(f"{key}.")]:
        return sources[max(above, key=len)]
    while path and not any(key.startswith(f"{path}.") for key in sources):  # a missing key has the source of its table
        path = path.rpartition(".")[0]
    inside = {key: source for key, source in sources.items() if not path or key.startswith(f"{path}.")}
    named = {source for key, source in inside.items() if _names(sentence, key)}
    stated = [source for source in dict.fromkeys(inside.values()) if not named or source in named]
    return ", ".join(stated) if named or path or len(stated) == 1 else "settings" if stated else "default settings"


def _names(sentence: str, key: str) -> bool:
    """Whether a sentence names a key by its last word, which is no word of prose."""
    word = re.escape(key.rpartition(".")[2])
    return re.search(rf"\b{word}\b" if "_" in word else rf"--{word}\b|\b{word} = ", sentence) is not None


def _with_value(
    model_class: type[BaseModel], values: Mapping[str, Any], key: str, value: Any, where: str
) -> dict[str, Any]:
    """Copy of a configuration with the value at a dotted key; items of a list are keys by number."""
    keys, above = key.split("."), value
    for word in reversed(keys):
        above = {word: above}
    result: dict[str, Any] = _merged(model_class, values, above, where=where, levels=len(keys))
    return result


def _merged(
    model_class: type[BaseModel],
    below: Any,
    above: Any,
    at: tuple[str, ...] = (),
    *,
    where: str = "",
    levels: int = MOST_LEVELS,
) -> Any:
    """The table ``above`` merged into ``below``, key by key; a table of another ``kind`` replaces it.

    With ``where``, the source of a single value, items of lists are replaced too, and a value without a table that
    could hold it is an error.
    """
    if not levels or not isinstance(above, Mapping):
        return above

    def entry(value: Any, key: str) -> Any:
        return _merged(model_class, value, above[key], (*at, key), where=where, levels=levels - 1)

    if where and isinstance(below, (list, tuple)):
        (key,) = above
        if not re.fullmatch(r"\d+", key) or int(key) >= len(below):
            raise ConfigError(f"{where}: {'.'.join(at)} has items 0 to {len(below) - 1}, not {key!r}")
        return [entry(item, key) if number == int(key) else item for number, item in enumerate(below)]
    if not isinstance(below, Mapping):
        if where and below is not None:
            raise ConfigError(f"{where}: {'.'.join(at)} = {below!r} is no table; it has no key {next(iter(above))!r}")
        return dict(above)
    if above.get("kind", below.get("kind")) != below.get("kind") and _several_kinds(model_class, at):
        return dict(above)  # the other kind has other keys
    return {**below, **{key: entry(below.get(key), key) for key in above}}


def _several_kinds(model_class: type[BaseModel], keys: Sequence[str]) -> bool:
    """Whether the table at a key may be of several models, told apart by their field ``kind``."""
    models = [part for part in alternatives(_annotation_at(model_class, keys)) if is_model(part)]
    return len(models) > 1 and all("kind" in model.model_fields for model in models)


def _annotation_at(model_class: type[BaseModel], keys: Sequence[str]) -> Any:
    """Type of the field at a dotted key, or None where the model does not know it."""
    annotations: list[Any] = [model_class]
    for key in keys:
        parts = [part for annotation in annotations for part in alternatives(annotation)]
        annotations = [
            part.model_fields[key].annotation for part in parts if is_model(part) and key in part.model_fields
        ]
        if key.isdigit():
            items = (typing.get_args(part) for part in parts if typing.get_origin(part) in (list, tuple))
            annotations += [item for arguments in items for item in arguments if item is not Ellipsis]
    return typing.Union[tuple(annotations)] if annotations else None  # noqa: UP007  # members known at run time only


def _typed(annotation: Any, text: str) -> Any:
    """The text as a TOML value if the field takes that; otherwise the bare text."""
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
