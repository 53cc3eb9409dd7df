"""Black coatings of baffles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from optics.errors import DomainError, unknown_name

NORMAL_LOBE = 0.04
"""Reflectance of the lobe's Fresnel law, index 1.5, at normal incidence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlackCoating:
    """A black surface: Lambertian, and a specular lobe (GGX) that grows towards grazing incidence as Fresnel's law."""

    name: str
    diffuse: float  # Lambertian reflectance
    specular: float = 0.0  # Of the lobe at normal incidence, at most 0.04: a surface of index 1.5
    roughness: float = 0.3  # Of the lobe, GGX alpha
    source: str = ""  # Of the numbers

    def __post_init__(self) -> None:
        for name in ("diffuse", "specular"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise DomainError(f"black coating {self.name!r}: {name} = {value:g}; a reflectance lies in 0 ... 1")
        if not 0.01 <= self.roughness <= 1.0:
            raise DomainError(f"black coating {self.name!r}: roughness = {self.roughness:g}; it lies in 0.01 ... 1")
        if self.diffuse + self.grazing > 1.0:
            raise DomainError(
                f"black coating {self.name!r}: diffuse = {self.diffuse:g} with specular = {self.specular:g} reflects "
                f"{self.diffuse + self.grazing:.3g} of grazing light; specular is at most {NORMAL_LOBE:g} x "
                "(1 - diffuse)"
            )

    @property
    def grazing(self) -> float:
        """Reflectance of the lobe at grazing incidence, before shadowing."""
        return self.specular / NORMAL_LOBE

    def bsdf(self) -> dict[str, Any]:
        """Description of both sides of a surface for Mitsuba's ``load_dict``."""
        total = self.diffuse + self.grazing
        matt: dict[str, Any] = {"type": "diffuse", "reflectance": total if self.specular > 0.0 else self.diffuse}
        if self.specular > 0.0:
            lobe = {"type": "roughconductor", "eta": 1.5, "k": 0.0, "alpha": self.roughness, "distribution": "ggx"}
            lobe["specular_reflectance"] = total
            matt = {"type": "blendbsdf", "weight": self.grazing / total, "matt": matt, "lobe": lobe}
        return {"type": "twosided", "bsdf": matt}


_MARSHALL = "rounded from J. L. Marshall et al., Proc. SPIE 9147, 91474F (2014); lobe assumed"
COATINGS = {
    "z306": BlackCoating(name="z306", diffuse=0.04, specular=0.004, source=f"Aeroglaze Z306, {_MARSHALL}"),
    "black_anodised": BlackCoating(
        name="black_anodised", diffuse=0.06, specular=0.004, roughness=0.4, source=f"anodised aluminium, {_MARSHALL}"
    ),
    "magic_black": BlackCoating(
        name="magic_black",
        diffuse=0.01,
        specular=0.0005,
        roughness=0.5,
        source="Acktar Magic Black, 1 % in the visible after its maker; lobe assumed",
    ),
}
"""Coatings by name: typical figures, for a first design; measured ones differ between batches."""


def black_coating(name: str) -> BlackCoating:
    """A coating of `COATINGS`."""
    if name not in COATINGS:
        raise unknown_name("black coating", name, COATINGS)
    return COATINGS[name]
