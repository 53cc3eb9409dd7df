r"""Vaned baffle: a tube with vanes by the standard construction.

Frame: cam with its origin at the vertex of the first surface: +z towards the sky, x along columns, y along rows, mm.

**Construction** (e.g. R. P. Breault, "Control of stray light", Handbook of Optics, vol. I, ch. 38): vane tips lie on
the cone of the field's beams. From the front towards the lens, each vane stands where the wall visible from the lens
past its tip begins at the end of the wall lit from outside past the tip of the previous vane. No part of the wall is
both lit by the sky and visible from the lens. The front opening a and the entrance r shade the lens from sources beyond
:math:`\tan\epsilon = (a + r) / L`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze_alike
from render.baffle.mesh import Mesh
from render.engine.triangle_mesh import equal_area_scale, strip_faces

MOST_VANES = 60
SIDES = 192
"""Of the polygons that stand for circles; they have the circles' areas."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VanedBaffle:
    """A tube of length L in front of the entrance, with vanes; the first one closes the front but for its opening."""

    entrance_mm: float  # Radius of the entrance of the lens, in the plane z = 0, around which the tube is closed
    length_mm: float
    tube_mm: float  # Inner radius of the tube
    vane_z_mm: FloatArray  # (v,) Positions and inner radii of the vanes, from the front on; at least the front one
    vane_mm: FloatArray
    edge_mm: float  # Radius of their edges

    def __post_init__(self) -> None:
        freeze_alike(self, "vane_z_mm", "vane_mm", shape=("v",))
        z, radius = self.vane_z_mm, self.vane_mm
        if not (0.0 < self.entrance_mm < self.tube_mm and 0.0 < self.length_mm < math.inf):
            raise DomainError(
                f"baffle of {self.length_mm:g} mm, radius {self.tube_mm:g} mm before an entrance of radius "
                f"{self.entrance_mm:g} mm; lengths must be positive, and the tube wider than the entrance"
            )
        if not len(z) or (np.diff(z) >= 0.0).any() or z[0] != self.length_mm or z[-1] <= 0.0:
            raise DomainError(
                f"vanes at {z.tolist()} mm; they must lie between the front, {self.length_mm:g} mm, and the lens"
            )
        if (radius <= 0.0).any() or (radius > self.tube_mm).any():
            raise DomainError(
                f"vanes of inner radii {radius.tolist()} mm; they must lie between 0 and the tube's "
                f"radius, {self.tube_mm:g} mm"
            )
        if not 0.0 <= self.edge_mm < 0.5 * self.tube_mm:
            raise DomainError(f"vane edges of radius {self.edge_mm:g} mm; it must not be negative")

    @property
    def shade_deg(self) -> float:
        """Smallest angle of a source without direct light on the entrance."""
        opening = float(self.vane_mm[0])
        return math.degrees(math.atan((opening + self.entrance_mm) / self.length_mm))


def vaned_baffle(
    *,
    entrance_mm: float,
    field_deg: float,
    shade_deg: float | None = None,
    length_mm: float | None = None,
    depth_mm: float = 10.0,
    vanes: int | None = None,
    clearance_mm: float = 0.5,
    edge_mm: float = 0.02,
) -> VanedBaffle:
    """A baffle by the standard construction.

    Parameters
    ----------
    entrance_mm, field_deg : float
        Radius of the entrance, and the half angle of the field to its corner.
    shade_deg, length_mm : float
        Angle from which on the entrance is in the shade; the length in its place. One of the two.
    depth_mm : float
        Depth of the front vane in the tube; more depth, fewer vanes.
    vanes : int, optional
        Their number, the front one included, to which the depth is fitted; 0: the opening of a plain tube.
    clearance_mm : float
        Between the beams of the field and the vanes; negative: vanes cut them.
    edge_mm : float
        Radius of the vanes' edges.

    Raises
    ------
    ConfigError
        Both or none of shade and length.
    DomainError
        A shade that begins inside the field, a depth that needs more than 60 vanes, a number that no depth gives.
    """
    if (shade_deg is None) == (length_mm is None):
        raise ConfigError("a baffle needs either shade_deg, the smallest Sun angle in full shade, or length_mm")
    tangent = math.tan(math.radians(field_deg))
    base = entrance_mm + clearance_mm  # radius of the cone of vane tips in the plane of the entrance
    if shade_deg is not None:
        slope = math.tan(math.radians(shade_deg)) - tangent
        if slope <= 0.0 or shade_deg >= 90.0:
            raise DomainError(
                f"shade_deg = {shade_deg:g} deg; it must lie outside the field, {field_deg:.3g} deg, and below 90 deg"
            )
        length_mm = (base + entrance_mm) / slope
    assert length_mm is not None
    if not (depth_mm > 0.0 and length_mm > 0.0):
        raise DomainError(f"baffle of {length_mm:g} mm with vanes {depth_mm:g} mm deep; both must be positive")
    front = base + length_mm * tangent

    def positions(depth: float) -> list[float]:
        return _vane_positions(entrance_mm, base, tangent, length_mm, front, front + depth)

    depth = depth_mm
    if vanes == 0:
        depth, z = 0.0, [length_mm]
    elif vanes == 1:
        z = [length_mm]
    elif vanes is None:
        z = positions(depth)
    else:
        low, high = 1e-3 * front, 20.0 * front
        for _ in range(80):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if len(positions(middle)) > vanes else (low, middle)
        depth, z = high, positions(high)
    if len(z) > MOST_VANES or (vanes and len(z) != vanes):
        setting = f"vanes = {vanes}" if vanes else f"vane depth of {depth_mm:g} mm"
        raise DomainError(
            f"baffle of {length_mm:.3g} mm: {setting} gives {len(z)} vanes; 1 to {MOST_VANES} are possible"
        )
    tube = front + depth if depth else max(front, 1.02 * entrance_mm)
    return VanedBaffle(
        entrance_mm=entrance_mm,
        length_mm=length_mm,
        tube_mm=tube,
        vane_z_mm=np.array(z),
        vane_mm=np.minimum(base + np.array(z) * tangent, tube),
        edge_mm=edge_mm,
    )


def _vane_positions(
    entrance: float, base: float, tangent: float, length: float, front: float, tube: float
) -> list[float]:
    """Vanes from the front on; at most one more than allowed."""
    positions, lit = [length], length  # the wall behind the front vane is lit from its tip on
    while len(positions) <= MOST_VANES:
        # line from the far edge of the entrance past the tip of the next vane to the end of the lit wall
        slope = (tube + entrance) / lit
        if slope <= tangent:
            break
        z = (base + entrance) / (slope - tangent)
        if z >= positions[-1] * (1.0 - 1e-9) or z < 0.02 * length:
            break
        positions.append(z)
        # light from the far edge of the opening past this tip
        lit = length - (length - z) * (tube + front) / (base + z * tangent + front)
        if lit <= 0.0:
            break
    return positions


def vaned_mesh(baffle: VanedBaffle, sides: int = SIDES) -> Mesh:
    """Wall, vanes and the ring around the entrance, thin and visible from both sides."""
    angle, scale = 2.0 * np.pi * np.arange(sides) / sides, equal_area_scale(sides)
    tube = baffle.tube_mm
    rings = [(baffle.entrance_mm, 0.0), (tube, 0.0), (tube, 0.0), (tube, baffle.length_mm)]
    for z, radius in zip(baffle.vane_z_mm.tolist(), baffle.vane_mm.tolist(), strict=True):
        rings += [(radius, z), (tube, z)] if radius < tube else []
    vertex = [np.stack([scale * r * np.cos(angle), scale * r * np.sin(angle), np.full(sides, z)], 1) for r, z in rings]
    face = [strip_faces(sides * ring, sides) for ring in range(0, len(rings), 2)]
    return Mesh(vertex_mm=np.concatenate(vertex), face=np.concatenate(face), name="vaned baffle")
