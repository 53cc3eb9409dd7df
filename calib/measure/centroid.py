"""The one interface of all centroiders, and their names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from calib.measure.epsf import EpsfCentroider
from calib.measure.gaussian import GaussianCentroider
from calib.measure.moments import CentreOfGravity, ThresholdedCentreOfGravity, WindowedCentroid
from calib.records import NoiseModel, Stamps, StarTable
from optics.errors import ConfigError, unknown_name

__all__ = ["Centroider", "get_centroider", "list_centroiders"]


class Centroider(Protocol):
    """Anything that turns stamps into positions and fluxes with covariance."""

    @property
    def name(self) -> str:
        """The name it goes by."""
        ...

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """One row per stamp, in order; the stamps are not changed."""
        ...


_CENTROIDERS: dict[str, Callable[..., Centroider]] = {
    "cog": CentreOfGravity,
    "tcog": ThresholdedCentreOfGravity,
    "windowed": WindowedCentroid,
    "gaussian": GaussianCentroider,
    "epsf": EpsfCentroider,
}


def list_centroiders() -> tuple[str, ...]:
    """Names that `get_centroider` knows."""
    return tuple(_CENTROIDERS)


def get_centroider(name: str, **options: Any) -> Centroider:
    """Centroider by name.

    Parameters
    ----------
    name : str
        "cog", "tcog", "windowed", "gaussian" or "epsf".
    **options
        Attributes of the centroider; "epsf" needs ``epsf``.

    Raises
    ------
    ConfigError
        On an unknown name or option, or a missing one.
    DomainError
        On an option out of range.
    """
    if name not in _CENTROIDERS:
        raise unknown_name("centroider", name, _CENTROIDERS)
    maker = _CENTROIDERS[name]
    fields = maker.__dataclass_fields__  # type: ignore[attr-defined]
    known = [key for key in fields if key != "name"]
    for key in options:
        if key not in known:
            raise unknown_name(f"option of centroider {name!r}:", key, known)
    if name == "epsf" and "epsf" not in options:
        raise ConfigError(
            "centroider 'epsf' needs epsf=: an EffectivePsf, from render.tracing.psf.render_epsf or "
            "calib.measure.epsf_build.build_epsf"
        )
    try:
        return maker(**options)
    except TypeError as error:
        raise ConfigError(f"centroider {name!r}: {error}; options are {', '.join(known)}") from None
