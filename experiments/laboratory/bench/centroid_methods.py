"""Centroiders of configurations.

Names, checks and labels come from the registry (`calib.measure.centroiding.registry`): a centroider added there is
available in every experiment. A centroider that needs an ePSF makes two *methods* if an experiment has several PSFs:
as ``NAME`` every place and filter is measured with the PSF there (matched); as ``NAME_reference`` all are measured with
the PSF of a single place or filter; as ``NAME_measured`` all are measured with a PSF built from frames
(`experiments.laboratory.bench.epsf_session`), where an experiment takes such frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema

from calib.measure.centroiding.registry import centroider_class, get_centroider, list_centroiders
from optics.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from calib.measure.centroiding.registry import Centroider
    from render.records import EffectivePsf

_REFERENCE, _MEASURED = "_reference", "_measured"


def needs_epsf(method: str) -> bool:
    """Whether a centroider or method needs an ePSF."""
    return centroider_class(_split(method)[0]).needs_epsf


def has_matched_epsf(method: str) -> bool:
    """Whether every place is measured with the PSF of that place: its errors are then noise and patterns alone."""
    return needs_epsf(method) and not _split(method)[1]


def needs_measured_epsf(method: str) -> bool:
    """Whether a method needs an ePSF that was built from frames."""
    return _split(method)[1] == _MEASURED


def list_methods(*, measured: bool = False) -> tuple[str, ...]:
    """Names of all methods: centroiders, and for centroiders with an ePSF the reference and measured variants."""
    names, endings = list_centroiders(), (_REFERENCE, _MEASURED) if measured else (_REFERENCE,)
    return (*names, *(f"{name}{end}" for name in names if centroider_class(name).needs_epsf for end in endings))


def _split(method: str) -> tuple[str, str]:
    """Name of the centroider, and the ending for its ePSF: "" for the matched one."""
    if method in list_centroiders():  # no import of the classes
        return method, ""
    if method not in list_methods(measured=True):
        raise unknown_name("centroider", method, list_methods(measured=True))
    ending = _MEASURED if method.endswith(_MEASURED) else _REFERENCE
    return method.removesuffix(ending), ending


@dataclass(frozen=True)
class _Name:
    """Text that must be a registered name when a configuration is read; its JSON schema lists these names."""

    names: Callable[[], tuple[str, ...]]

    def _checked(self, value: str) -> str:
        if value not in list_centroiders() and value not in self.names():
            raise unknown_name("centroider", value, self.names())
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return handler(schema) | {"enum": list(self.names())}


CentroiderName = Annotated[str, _Name(list_centroiders)]
"""Type of a setting that names a centroider."""

MethodName = Annotated[str, _Name(list_methods)]
"""Type of a setting that names a centroider with its ePSF."""

ProcessingName = Annotated[str, _Name(lambda: list_methods(measured=True))]
"""Type of such a setting where frames are taken from which an ePSF can be built."""


@dataclass(frozen=True)
class MethodLabels(Mapping[str, str]):
    """Labels of the methods in tables and figures: the centroider's label with its ePSF."""

    # Words for the ePSF of each place, the reference one and the one built from frames; "" adds none
    matched: str = ""
    reference: str = "middle ePSF"
    measured: str = "measured ePSF"

    def __getitem__(self, method: str) -> str:
        name, ending = _split(method)
        psf_label = {"": self.matched, _REFERENCE: self.reference, _MEASURED: self.measured}[ending]
        label = centroider_class(name).label
        return f"{label} ({psf_label})" if psf_label and needs_epsf(method) else label

    def __iter__(self) -> Iterator[str]:
        return iter(list_methods())

    def __len__(self) -> int:
        return len(list_methods())


def method_centroiders(
    methods: Iterable[str],
    *,
    matched: Sequence[EffectivePsf],
    reference: Sequence[EffectivePsf],
    measured: EffectivePsf | None = None,
) -> dict[str, Centroider]:
    """Centroiders by method."""
    psfs = {"": matched, _REFERENCE: reference, _MEASURED: [measured] * len(matched)}
    centroiders = {}
    for method in methods:
        name, ending = _split(method)
        if ending == _MEASURED and measured is None:
            raise ConfigError(f"centroider {method!r} needs an ePSF built from frames; none was built")
        options = {"epsf": list(psfs[ending])} if needs_epsf(method) else {}
        centroiders[method] = get_centroider(name, **options)
    return centroiders
