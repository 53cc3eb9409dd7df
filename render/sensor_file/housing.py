"""Lens housings in sensor files: materials, and contacts with the elements."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field, field_validator

from optics.errors import unknown_name
from optics.settings import StrictModel

EXPANSION_PPM_PER_K = {
    "aluminium_6061": 23.6,
    "aluminium_7075": 23.6,
    "magnesium_az31b": 26.0,
    "titanium_ti6al4v": 8.6,
    "stainless_steel_304": 17.3,
    "stainless_steel_416": 9.9,
    "beryllium_i70a": 11.3,
    "invar_36": 1.3,
    "super_invar": 0.3,
    "carbon_fibre": 0.0,
}
"""Near 20 C [1e-6/K]. Metals: Yoder and Vukobratovich, Opto-Mechanical Systems Design, 4th ed. (2015), vol. 1, table of
mechanical structure materials, and the suppliers' data sheets of the alloys (ASM). Carbon fibre stands for a laminate
laid up for no expansion along the axis; laminates as built lie within some 1e-6/K of it."""

DEFAULT_HOUSING = "aluminium_6061"
LARGEST_PPM_PER_K = 200.0
"""Polymers reach some 100."""


def expansion_per_k(housing: str | float) -> float:
    """Linear expansion [1/K] of a material by name, or of a number in 1e-6/K."""
    if isinstance(housing, str):
        if housing not in EXPANSION_PPM_PER_K:
            raise unknown_name("material of a housing", housing, EXPANSION_PPM_PER_K)
        return EXPANSION_PPM_PER_K[housing] * 1e-6
    if not -LARGEST_PPM_PER_K <= housing <= LARGEST_PPM_PER_K:
        raise ValueError(f"at least {-LARGEST_PPM_PER_K:g} and at most {LARGEST_PPM_PER_K:g} (1e-6/K)")
    return housing * 1e-6


class HousingConfig(StrictModel):
    """Barrel and spacers of the lens; ``housing = "invar_36"`` states only the barrel's material.

    A spacer is named by what stands behind it: an element, ``detector`` or ``stop``. A spacer that is not named has the
    barrel's material and reaches from vertex to vertex.
    """

    dimensionless: ClassVar[frozenset[str]] = frozenset({"material", "spacers", "poisson_ratio"})

    material: str | float = Field(
        default=DEFAULT_HOUSING,
        description="material of the barrel, or its linear expansion in 1e-6/K: " + ", ".join(EXPANSION_PPM_PER_K),
    )
    diameter_mm: float = Field(
        default=0.0,
        ge=0,
        le=1e4,
        description="distance across which transverse gradients are stated; 0: the widest clear aperture",
    )
    mounted_z_mm: float | None = Field(
        default=None,
        ge=-1e5,
        le=1e5,
        description="z of the mounting plane, fixed when the housing bends; 0: first surface; default: image plane",
    )
    spacers: dict[str, str | float] = Field(default={}, description="materials of named spacers")
    rims_mm: dict[str, tuple[float, float]] = Field(
        default={}, description="per element: contact radii of the spacers on its front and back face; 0: the vertex"
    )
    poisson_ratio: float = Field(default=0.25, ge=0, le=0.5, description="Poisson's ratio of the glasses")

    def __hash__(self) -> int:
        """Hash of its text: tables are not hashable."""
        return hash(self.model_dump_json())

    @field_validator("material", "spacers")
    @classmethod
    def _known(cls, value: str | float | dict[str, str | float]) -> str | float | dict[str, str | float]:
        for material in value.values() if isinstance(value, dict) else (value,):
            expansion_per_k(material)
        return value

    @field_validator("spacers", "rims_mm")
    @classmethod
    def _names(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name in value:
            if not name or set(name) & set(" .=:"):
                raise ValueError(f"{name!r}: an element's name has no blanks and none of . = :")
        return value

    @field_validator("rims_mm")
    @classmethod
    def _radii(cls, value: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        for name, radii in value.items():
            if min(radii) < 0.0:
                raise ValueError(f"{name}: radii {radii[0]:g} and {radii[1]:g} mm; they must not be negative")
        return value
