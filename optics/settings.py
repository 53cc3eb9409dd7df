"""Tables of settings as pydantic models: strict types, units in key names, paths relative to their file."""

from __future__ import annotations

import os
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

from optics.errors import ConfigError
from optics.validate import StrictTable, full_key, read_toml


@dataclass(frozen=True)
class _IsFile:
    """Marks text that may be, or always is, the path of a file."""

    always: bool = False


WavelengthNm = Annotated[float, Field(ge=0, le=1e5)]
"""Type of a wavelength in a list of them."""
StarK = Annotated[float, Field(ge=1000, le=1e5)]
"""Type of a star's temperature in a list of them."""
FileName = Annotated[str, _IsFile()]
"""Type of a setting that is a path, or the name of something built in; in a file, a path is relative to that file."""
FolderName = Annotated[str, _IsFile(always=True)]
"""Type of a setting that is always a path, in a file relative to that file."""

# Last word of a field's name: its unit, or a word for a pure number.
_LENGTHS_AND_TIMES = ("nm", "um", "mm", "m", "km", "s", "ms", "us", "min", "h", "px", "px2")
_ANGLES = ("deg", "arcsec", "arcsec2", "arcmin", "rad")
_OTHERS = ("e", "dn", "c", "k", "hpa", "mag", "hz", "percent", "photon", "photons", "ppm", "mb", "bit", "bits")
_UNITS = frozenset((*_LENGTHS_AND_TIMES, *_ANGLES, *_OTHERS))
_WRITTEN = {"e": "e-", "dn": "DN", "c": "C", "k": "K", "hpa": "hPa", "hz": "Hz", "mb": "MB", "percent": "%"}
_PURE_NUMBERS = frozenset(
    ("fraction", "ratio", "factor", "snr", "sigma", "probability", "confidence", "tolerance", "scale", "exponent")
)


def _holds_reals(annotation: Any) -> bool:
    if annotation is float:
        return True
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return False
    return any(_holds_reals(argument) for argument in typing.get_args(annotation))


def _has_unit(name: str) -> bool:
    words = name.lower().split("_")
    return words[-1] in _UNITS | _PURE_NUMBERS or "per" in words[1:]


def unit_of(name: str) -> str:
    """Unit at the end of the name of a key, "" if it has none: ``read_noise_e`` e-, ``rate_deg_per_s`` deg/s."""
    words = name.split("_")
    if "per" in words[1:]:
        at = words.index("per", 1)
        above = words[at - 1] if words[at - 1] in _UNITS else "1"
        return f"{_WRITTEN.get(above, above)}/{' '.join(_WRITTEN.get(word, word) for word in words[at + 1 :])}"
    return _WRITTEN.get(words[-1], words[-1]) if words[-1] in _UNITS else ""


class StrictModel(StrictTable):
    """Base of every configuration table: frozen, unknown keys are errors, no NaN, units in the key names.

    Values are of the type of their field: neither true nor "1.5" is a number.

    A field that holds real numbers must end in its unit (``defocus_um``, ``rate_e_per_s``) or in a word that says it
    has none (``_fraction``, ``_ratio``, ``_snr``, ...); other pure numbers are named in `dimensionless`.
    """

    model_config = ConfigDict(allow_inf_nan=False, validate_default=True)

    dimensionless: ClassVar[frozenset[str]] = frozenset()

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Check the names of a new table's fields."""
        super().__pydantic_init_subclass__(**kwargs)
        for name, field in cls.model_fields.items():
            if _holds_reals(field.annotation) and not _has_unit(name) and name not in cls.dimensionless:
                raise TypeError(
                    f"{cls.__name__}.{name} holds real numbers, but its name does not end in a unit; "
                    f"rename it (known units: {' '.join(sorted(_UNITS))}) or list it in {cls.__name__}.dimensionless"
                )


def read_settings(
    model_class: type[BaseModel], file: str | Path, spellings: Mapping[str, str] = MappingProxyType({})
) -> dict[str, Any]:
    """Settings of a TOML file, not yet validated; relative paths in it are taken from its folder.

    Keys outside the tables of the model stand for the keys that `optics.validate.full_key` finds.
    """
    table = read_toml(file)
    settings = {key: value for key, value in table.items() if key in model_class.model_fields}
    for name, value in flat({key: value for key, value in table.items() if key not in settings}).items():
        try:
            key = full_key(model_class, name, spellings)
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from None
        *steps, last = key.split(".")
        inner: Any = settings
        for step in steps:
            inner = inner.setdefault(step, {}) if isinstance(inner, dict) else None
        if not isinstance(inner, dict) or last in inner:
            raise ConfigError(f"{file}: {key} is stated twice, once as {name!r}")
        inner[last] = value
    located: dict[str, Any] = _located([model_class], settings, Path(file).parent)
    return located


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of nested tables by their dotted keys; an empty table is a value."""
    values: dict[str, Any] = {}
    for key, value in table.items():
        values |= flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) and value else {prefix + key: value}
    return values


def _located(annotations: Sequence[Any], value: Any, folder: Path) -> Any:
    """The value with its relative paths below a folder."""
    if isinstance(value, Mapping):
        models = [model for annotation in annotations for model in alternatives(annotation) if is_model(model)]
        inside = {key: [model.model_fields[key] for model in models if key in model.model_fields] for key in value}
        return {key: _located(list(map(annotated, inside[key])), entry, folder) for key, entry in value.items()}
    if isinstance(value, list):
        items = [item for each in annotations for kind in alternatives(each) for item in typing.get_args(kind)]
        return [_located(items, entry, folder) for entry in value]
    if isinstance(value, str) and any(
        _is_path(value, mark) for annotation in annotations for mark in _marks(annotation)
    ):
        return str(folder / Path(value).expanduser())
    return value


def _is_path(text: str, mark: _IsFile) -> bool:
    """A built-in name has neither a suffix nor a folder."""
    path = Path(text)
    return bool(text) and (mark.always or bool(path.suffix) or len(path.parts) > 1)


def absolute(field: FieldInfo, value: Any) -> Any:
    """The value of a field with its paths made absolute."""
    if isinstance(value, (tuple, list)):
        return [absolute(field, item) for item in value]
    if isinstance(value, str) and any(_is_path(value, mark) for mark in _marks(annotated(field))):
        return os.path.abspath(Path(value).expanduser())
    return value


def annotated(field: FieldInfo) -> Any:
    """Type of a field with its constraints and marks."""
    return Annotated[field.annotation, "", *field.metadata]


def is_model(annotation: Any) -> bool:
    """Whether an annotation is a table."""
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _marks(annotation: Any) -> Iterator[_IsFile]:
    for argument in typing.get_args(annotation):
        if isinstance(argument, _IsFile):
            yield argument
        yield from _marks(argument)


def alternatives(annotation: Any) -> Iterator[Any]:
    """Members of a union, of ``Annotated`` and so on; anything else unchanged."""
    if isinstance(annotation, type) or typing.get_origin(annotation) in (list, tuple, dict):
        yield annotation
    else:
        for argument in typing.get_args(annotation):
            yield from alternatives(argument)
