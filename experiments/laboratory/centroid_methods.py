"""Centroiders as configurations name them.

Names, their checks and their labels come from the registry (`calib.measure.centroid`): a centroider that is added there
can be named in every experiment. A centroider that needs an ePSF makes two *methods* where an experiment has several
PSFs: under its own name every place and filter is measured with the PSF of that place and filter, as ``NAME_reference``
all are measured with the PSF of one place or one filter.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema

from calib.measure.centroid import centroider_class, get_centroider, list_centroiders
from optics.errors import unknown_name

if TYPE_CHECKING:
    from calib.measure.centroid import Centroider
    from render.records import EffectivePsf

__all__ = ["CentroiderName", "MethodLabels", "MethodName", "list_methods", "method_centroiders", "needs_epsf"]

_REFERENCE = "_reference"


def needs_epsf(method: str) -> bool:
    """Whether a centroider or method needs an ePSF.

    Raises
    ------
    ConfigError
        On an unknown name, with the nearest known ones.
    """
    return centroider_class(_split(method)[0]).needs_epsf


def list_methods() -> tuple[str, ...]:
    """Names of all centroiders, and of those that need an ePSF with the reference one."""
    names = list_centroiders()
    return (*names, *(f"{name}{_REFERENCE}" for name in names if centroider_class(name).needs_epsf))


def _split(method: str) -> tuple[str, bool]:
    """Name of the centroider, and whether it is given the reference ePSF."""
    if method in list_centroiders():  # needs no look at the classes
        return method, False
    if method not in list_methods():
        raise unknown_name("centroider", method, list_methods())
    return method.removesuffix(_REFERENCE), True


@dataclass(frozen=True)
class _Name:
    """Text that must be a known name when a configuration is read; its JSON schema lists those known at that time."""

    with_reference: bool

    def _checked(self, value: str) -> str:
        if self.with_reference:
            _split(value)
        elif value not in list_centroiders():
            raise unknown_name("centroider", value, list_centroiders())
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return handler(schema) | {"enum": list(list_methods() if self.with_reference else list_centroiders())}


CentroiderName = Annotated[str, _Name(with_reference=False)]
"""Type of a setting that names a centroider."""

MethodName = Annotated[str, _Name(with_reference=True)]
"""Type of a setting that names a centroider, and which ePSF it is given."""


@dataclass(frozen=True)
class MethodLabels(Mapping[str, str]):
    """What tables and figures call each method: the centroider's label, with the ePSF that it is given.

    Attributes
    ----------
    own, reference : str
        What an experiment calls the ePSF of each place, and the reference one; "" where that needs no word.
    """

    own: str = ""
    reference: str = "middle ePSF"

    def __getitem__(self, method: str) -> str:
        name, shared = _split(method)
        words = (self.reference if shared else self.own) if needs_epsf(method) else ""
        return f"{centroider_class(name).label} ({words})" if words else centroider_class(name).label

    def __iter__(self) -> Iterator[str]:
        return iter(list_methods())

    def __len__(self) -> int:
        return len(list_methods())


def method_centroiders(
    methods: Iterable[str], *, own: Sequence[EffectivePsf], reference: Sequence[EffectivePsf]
) -> dict[str, Centroider]:
    """Centroiders by method.

    Parameters
    ----------
    methods : iterable of str
        Of `list_methods`.
    own, reference : sequence of EffectivePsf
        PSF of each place, as ``Stamps.psf_index`` counts them; those that ``NAME_reference`` uses instead.

    Raises
    ------
    ConfigError
        On an unknown name.
    """
    found = {}
    for method in methods:
        name, shared = _split(method)
        options = {"epsf": list(reference if shared else own)} if needs_epsf(method) else {}
        found[method] = get_centroider(name, **options)
    return found
