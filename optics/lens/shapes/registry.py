"""Types of surface in lens files; a new type is one more entry (docs/extending/add_a_surface.md)."""

from __future__ import annotations

from optics.lens.shapes.base import Shape
from optics.lens.shapes.biconic import Biconic
from optics.lens.shapes.conic import Conic
from optics.lens.shapes.cylinder import Cylinder
from optics.lens.shapes.even_asphere import EvenAsphere
from optics.lens.shapes.forbes_asphere import Qbfs, Qcon
from optics.lens.shapes.odd_asphere import OddAsphere
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.sphere import Sphere
from optics.lens.shapes.thin_lens import ThinLens
from optics.lens.shapes.toroid import Toroid
from optics.lens.shapes.xy_polynomial import XYPolynomial
from optics.lens.shapes.zernike import Zernike

ROTATIONAL: tuple[type[Shape], ...] = (Plane, Sphere, Conic, EvenAsphere, OddAsphere, Qbfs, Qcon, ThinLens)
SHAPES: tuple[type[Shape], ...] = (*ROTATIONAL, Cylinder, Toroid, Biconic, Zernike, XYPolynomial)

UNNAMED: type[Shape] = EvenAsphere
"""Kind of a surface without ``kind``; the result is the simplest of plane, sphere, conic and even asphere."""
