"""The interface and registry of all centroiders.

A centroider is one file in `calib.measure.centroiders` and one line in `_REGISTRY` below, see
``docs/extending/add_a_centroider.md``. Reading the names imports none of them, for fast command lines.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from optics.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from calib.records import NoiseModel, Stamps, StarTable


class Centroider(Protocol):
    """Anything that turns stamps into positions and fluxes with covariance; a frozen dataclass of its options."""

    name: ClassVar[str]  # In `get_centroider` and in configurations
    label: ClassVar[str]  # In tables and figures
    needs_epsf: ClassVar[bool]  # Whether it has an option ``epsf`` (an `EffectivePsf` or several) that must be given

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """One row per stamp, in order; the stamps are not changed."""


_REGISTRY: dict[str, str | type[Centroider]] = {
    "cog": "calib.measure.centroiders.centre_of_gravity:CentreOfGravity",
    "tcog": "calib.measure.centroiders.thresholded:ThresholdedCentreOfGravity",
    "windowed": "calib.measure.centroiders.windowed:WindowedCentroid",
    "gaussian": "calib.measure.centroiders.gaussian:GaussianCentroider",
    "epsf": "calib.measure.centroiders.epsf:EpsfCentroider",
}
"""By name: ``module:class``, imported on request, or a registered class."""


def list_centroiders() -> tuple[str, ...]:
    """Names that `get_centroider` knows.

    Returns
    -------
    tuple of str
        Names, in the order of registration.
    """
    return tuple(_REGISTRY)


def centroider_class(name: str) -> type[Centroider]:
    """Class of a centroider, with its name, label and needs."""
    if name not in _REGISTRY:
        raise unknown_name("centroider", name, _REGISTRY)
    entry = _REGISTRY[name]
    if isinstance(entry, str):
        module, _, attribute = entry.partition(":")
        entry = _REGISTRY[name] = getattr(import_module(module), attribute)
    return entry


def register_centroider(new: type[Centroider]) -> type[Centroider]:
    """Register a centroider by name in this process; usable as a decorator.

    Parameters
    ----------
    new : class
        A frozen dataclass with ``name``, ``label``, ``needs_epsf`` and ``measure``.

    Returns
    -------
    class
        The same.

    Raises
    ------
    ConfigError
        If the class is no dataclass, lacks ``name``, ``label``, ``needs_epsf`` or ``measure``, needs an ePSF without a
        field ``epsf``, or if the name belongs to another class.
    """
    missing = [key for key in ("name", "label", "needs_epsf", "measure") if not hasattr(new, key)]
    if missing:
        raise ConfigError(f"centroider {new.__name__} has no {' and no '.join(missing)}")
    if not is_dataclass(new):
        raise ConfigError(f"centroider {new.__name__} must be a dataclass, whose fields are the options")
    if new.needs_epsf and "epsf" not in _options(new):
        raise ConfigError(f"centroider {new.__name__} needs an ePSF (needs_epsf = True) and has no field epsf")
    if new.name in _REGISTRY and centroider_class(new.name) is not new:
        raise ConfigError(f"the name {new.name!r} belongs to {centroider_class(new.name).__name__}; choose another")
    _REGISTRY[new.name] = new
    return new


def get_centroider(name: str, **options: Any) -> Centroider:
    """Centroider by name.

    Parameters
    ----------
    name : str
        One of `list_centroiders`.
    **options
        Attributes of the centroider; an ePSF is passed as ``epsf=``.

    Returns
    -------
    Centroider
        With those options.

    Raises
    ------
    ConfigError
        On an unknown name or option, or a missing one.
    DomainError
        On an option out of range.
    """
    centroider = centroider_class(name)
    names = _options(centroider)
    for key in options:
        if key not in names:
            raise unknown_name(f"option of centroider {name!r}:", key, names)
    if centroider.needs_epsf and "epsf" not in options:
        raise ConfigError(
            f"centroider {name!r} needs epsf=: an EffectivePsf, from render.tracing.psf.render_epsf or "
            "calib.measure.epsf.build.build_epsf"
        )
    try:
        return centroider(**options)
    except TypeError as error:
        raise ConfigError(f"centroider {name!r}: {error}; options are {', '.join(names)}") from None


def _options(centroider: type[Centroider]) -> list[str]:
    return [option.name for option in fields(centroider)]  # type: ignore[arg-type]  # registered ones are dataclasses
