"""The kinds of surface that lens files may name; a new kind is one more entry (docs/extending/add_a_surface.md)."""

from __future__ import annotations

from optics.lens.shapes.base import Shape
from optics.lens.shapes.conic import Conic
from optics.lens.shapes.even_asphere import EvenAsphere
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.sphere import Sphere

__all__ = ["SHAPES", "UNNAMED"]

SHAPES: tuple[type[Shape], ...] = (Plane, Sphere, Conic, EvenAsphere)

UNNAMED: type[Shape] = EvenAsphere
"""What a surface without ``kind`` is read as; the simplest of plane, sphere, conic and even asphere comes out."""
