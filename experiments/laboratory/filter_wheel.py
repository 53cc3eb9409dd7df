"""Filter wheel in front of the target."""

from __future__ import annotations

from dataclasses import dataclass

from experiments.laboratory.settings import FilterConfig
from optics.errors import DomainError, unknown_name
from optics.light.band import TopHat

__all__ = ["FilterWheel", "interference_filters", "open_wheel"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterWheel:
    """Filters by the names of their bands.

    Attributes
    ----------
    filters : tuple of TopHat
        What sits in the wheel; an open place is the pass band of the camera itself.

    Raises
    ------
    DomainError
        If it is empty, or two filters have one name.
    """

    filters: tuple[TopHat, ...]

    def __post_init__(self) -> None:
        names = [one.name for one in self.filters]
        if not names or len(set(names)) != len(names):
            raise DomainError(f"FilterWheel.filters = {names}; at least one filter, each with a name of its own")

    def select(self, name: str) -> TopHat:
        """The filter of that name.

        Raises
        ------
        ConfigError
            If there is none.
        """
        for one in self.filters:
            if one.name == name:
                return one
        raise unknown_name("filter", name, [one.name for one in self.filters])


def interference_filters(config: FilterConfig) -> tuple[TopHat, ...]:
    """The filters of a configuration, named by their centres."""
    return tuple(
        TopHat(centre_nm=centre, width_nm=config.width_nm, edge_nm=config.edge_nm, name=f"{centre:g} nm")
        for centre in config.centres_nm
    )


def open_wheel(low_nm: float, high_nm: float, edge_nm: float) -> FilterWheel:
    """A wheel with one open place: light from ``low_nm`` to ``high_nm`` passes."""
    return FilterWheel(
        filters=(TopHat(centre_nm=(low_nm + high_nm) / 2, width_nm=high_nm - low_nm, edge_nm=edge_nm, name="open"),)
    )
