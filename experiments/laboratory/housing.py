"""Linear expansion of the materials that lens housings are made of."""

from __future__ import annotations

from optics.errors import unknown_name

__all__ = ["DEFAULT_HOUSING", "EXPANSION_PPM_PER_K", "LARGEST_PPM_PER_K", "expansion_per_k"]

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
