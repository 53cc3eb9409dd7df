r"""Baffles and their black coatings: a tube with vanes by the standard construction, or a mesh of the user.

Frame: cam with its origin at the vertex of the first surface: +z towards the sky, x along columns, y along rows, mm.

**Construction** (e.g. R. P. Breault, "Control of stray light", Handbook of Optics, vol. I, ch. 38): vane tips lie on
the cone of the field's beams. From the front towards the lens, each vane stands where the wall seen from the lens past
its tip begins at the end of the wall lit from outside past the tip of the previous vane. No part of the wall is both
lit by the sky and seen by the lens. The front opening a and the entrance r shade the lens from sources beyond
:math:`\tan\epsilon = (a + r) / L`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import ConfigError, DomainError, unknown_name
from optics.records import freeze

NORMAL_LOBE = 0.04
"""Reflectance of the lobe's Fresnel law, index 1.5, at normal incidence."""
MOST_VANES = 60
SIDES = 192
"""Of the polygons that stand for circles; they have the circles' areas."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlackCoating:
    """A black surface: Lambertian, and a specular lobe (GGX) that grows towards grazing incidence as Fresnel's law."""

    name: str
    diffuse: float  # Lambertian reflectance
    specular: float = 0.0  # Of the lobe at normal incidence, at most 0.04: a surface of index 1.5
    roughness: float = 0.3  # Of the lobe, GGX alpha
    source: str = ""  # Where the numbers come from

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
        """The same for Mitsuba's ``load_dict``; of both sides of a surface."""
        matt: dict[str, Any] = {"type": "diffuse", "reflectance": self.diffuse}
        if self.specular > 0.0:
            whole = self.diffuse + self.grazing
            lobe = {"type": "roughconductor", "eta": 1.5, "k": 0.0, "alpha": self.roughness, "distribution": "ggx"}
            lobe["specular_reflectance"] = whole
            matt = {
                "type": "blendbsdf",
                "weight": self.grazing / whole,
                "matt": {"type": "diffuse", "reflectance": whole},
                "lobe": lobe,
            }
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VanedBaffle:
    """A tube of length L in front of the entrance, with vanes; the first one closes the front but for its opening."""

    entrance_mm: float  # Radius of the lens's entrance, in the plane z = 0, around which the tube is closed
    length_mm: float
    tube_mm: float  # Inner radius of the tube
    vane_z_mm: FloatArray  # (v,) Places and inner radii of the vanes, from the front on; at least the front one
    vane_mm: FloatArray
    edge_mm: float  # Radius of their edges

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        z = freeze(self, "vane_z_mm", shape=("v",), sizes=sizes)
        radius = freeze(self, "vane_mm", shape=("v",), sizes=sizes)
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
        How far the front vane reaches into the tube; more depth, fewer vanes.
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
    wide = entrance_mm + clearance_mm
    if shade_deg is not None:
        slope = math.tan(math.radians(shade_deg)) - tangent
        if slope <= 0.0 or shade_deg >= 90.0:
            raise DomainError(
                f"shade_deg = {shade_deg:g} deg; it must lie outside the field, {field_deg:.3g} deg, and below 90 deg"
            )
        length_mm = (wide + entrance_mm) / slope
    assert length_mm is not None
    if not (depth_mm > 0.0 and length_mm > 0.0):
        raise DomainError(f"baffle of {length_mm:g} mm with vanes {depth_mm:g} mm deep; both must be positive")
    front = wide + length_mm * tangent

    def built(depth: float) -> list[float]:
        return _places(entrance_mm, wide, tangent, length_mm, front, front + depth)

    depth = depth_mm
    if vanes == 0:
        depth, places = 0.0, [length_mm]
    elif vanes == 1:
        places = [length_mm]
    elif vanes is None:
        places = built(depth)
    else:
        low, high = 1e-3 * front, 20.0 * front
        for _ in range(80):
            depth = math.sqrt(low * high)
            low, high = (depth, high) if len(built(depth)) > vanes else (low, depth)
        depth, places = high, built(high)
    if len(places) > MOST_VANES or (vanes and len(places) != vanes):
        asked = f"vanes = {vanes}" if vanes else f"vane depth of {depth_mm:g} mm"
        raise DomainError(
            f"baffle of {length_mm:.3g} mm: {asked} gives {len(places)} vanes; 1 to {MOST_VANES} are possible"
        )
    z = np.array(places)
    tube = front + depth if depth else max(front, 1.02 * entrance_mm)
    radius = np.minimum(wide + z * tangent, tube)
    return VanedBaffle(
        entrance_mm=entrance_mm, length_mm=length_mm, tube_mm=tube, vane_z_mm=z, vane_mm=radius, edge_mm=edge_mm
    )


def _places(entrance: float, wide: float, tangent: float, length: float, front: float, tube: float) -> list[float]:
    """Vanes from the front on; at most one more than there may be."""
    places, lit = [length], length  # the wall behind the front vane is lit from its tip on
    while len(places) <= MOST_VANES:
        # line of sight from the far edge of the entrance past the tip of the next vane to where lit wall ends
        sight = (tube + entrance) / lit
        if sight <= tangent:
            break
        z = (wide + entrance) / (sight - tangent)
        if z >= places[-1] * (1.0 - 1e-9) or z < 0.02 * length:
            break
        places.append(z)
        tip = wide + z * tangent
        # light from the far edge of the opening past this tip
        lit = length - (length - z) * (tube + front) / (tip + front)
        if lit <= 0.0:
            break
    return places


# --- Meshes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """Triangles; mm, in the frame of the baffle."""

    vertex_mm: FloatArray  # (n, 3)
    face: IntArray  # (m, 3)
    name: str = "mesh"

    def __post_init__(self) -> None:
        freeze(self, "vertex_mm", shape=("n", 3), sizes={})
        faces = freeze(self, "face", shape=("m", 3), sizes={}, dtype=np.int64)
        if not len(faces) or faces.min() < 0 or faces.max() >= len(self.vertex_mm):
            raise DomainError(f"{self.name}: a mesh needs triangles of its own vertices")


def vaned_mesh(baffle: VanedBaffle, sides: int = SIDES) -> Mesh:
    """Wall, vanes and the ring around the entrance, thin and seen from both sides."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    grow = math.sqrt(2.0 * math.pi / sides / math.sin(2.0 * math.pi / sides))
    strips = [
        ((baffle.entrance_mm, 0.0), (baffle.tube_mm, 0.0)),
        ((baffle.tube_mm, 0.0), (baffle.tube_mm, baffle.length_mm)),
    ]
    strips += [
        ((radius, z), (baffle.tube_mm, z))
        for z, radius in zip(baffle.vane_z_mm.tolist(), baffle.vane_mm.tolist(), strict=True)
        if radius < baffle.tube_mm
    ]
    vertex, face = [], []
    here = np.arange(sides)
    beside = (here + 1) % sides
    for number, ends in enumerate(strips):
        first = 2 * sides * number
        for radius, z in ends:
            vertex.append(
                np.stack([grow * radius * np.cos(angle), grow * radius * np.sin(angle), np.full(sides, z)], 1)
            )
        a, b, c, d = first + here, first + beside, first + sides + here, first + sides + beside
        face += [np.stack([a, b, c], 1), np.stack([b, d, c], 1)]
    return Mesh(vertex_mm=np.concatenate(vertex), face=np.concatenate(face), name="vaned baffle")


def check_closed(mesh: Mesh) -> None:
    """Refuse a user mesh that is not a closed surface: every edge belongs to two triangles."""
    size = float(np.ptp(mesh.vertex_mm, axis=0).max()) or 1.0
    _, same = np.unique(np.round(mesh.vertex_mm / (1e-6 * size)), axis=0, return_inverse=True)
    corner: NDArray[Any] = np.ravel(same)[mesh.face]
    corner = corner[(corner != np.roll(corner, 1, axis=1)).all(axis=1)]
    edges = np.sort(np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if (count % 2).any():
        raise DomainError(
            f"{mesh.name}: open mesh, {int((count % 2).sum())} of {len(count)} edges belong to an odd number of "
            "triangles; a baffle mesh must be closed, with walls of finite thickness"
        )


def read_glb(path: str | Path) -> Mesh:
    """Triangles of a binary glTF file (``.glb``), its nodes placed; units unchanged, to be mm."""
    import json
    import struct

    try:
        raw = Path(path).read_bytes()
        magic, _, _ = struct.unpack_from("<4sII", raw)
        length, _ = struct.unpack_from("<II", raw, 12)
        content = json.loads(raw[20 : 20 + length])
        data = raw[28 + length :]
        if magic != b"glTF":
            raise ValueError("it does not begin with glTF")
        vertex, face, count = [], [], 0
        for node, matrix in _nodes(content):
            for part in content["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
                if part.get("mode", 4) != 4:
                    raise ValueError("it contains primitives other than triangles")
                points = _accessor(content, data, part["attributes"]["POSITION"]).astype(np.float64)
                at = np.arange(len(points)) if "indices" not in part else _accessor(content, data, part["indices"])
                vertex.append(points @ matrix[:3, :3].T + matrix[:3, 3])
                face.append(np.reshape(at, (-1, 3)).astype(np.int64) + count)
                count += len(points)
    except (OSError, ValueError, KeyError, IndexError, struct.error) as error:
        raise ConfigError(f"{path}: cannot be read as a binary glTF mesh ({error})") from None
    if not vertex:
        raise ConfigError(f"{path}: it contains no mesh")
    return Mesh(vertex_mm=np.concatenate(vertex), face=np.concatenate(face), name=str(path))


def _nodes(content: dict[str, Any]) -> list[tuple[dict[str, Any], FloatArray]]:
    """Nodes of the scene with their matrices."""
    from scipy.spatial.transform import Rotation

    scene = content["scenes"][content.get("scene", 0)]
    waiting = [(number, np.eye(4)) for number in scene["nodes"]]
    out: list[tuple[dict[str, Any], FloatArray]] = []
    while waiting:
        number, above = waiting.pop()
        node, own = content["nodes"][number], np.eye(4)
        if "matrix" in node:
            own = np.reshape(node["matrix"], (4, 4)).T
        else:
            turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
            own[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]))
            own[:3, 3] = node.get("translation", [0, 0, 0])
        out.append((node, above @ own))
        waiting += [(child, above @ own) for child in node.get("children", ())]
    return out


def _accessor(content: dict[str, Any], data: bytes, number: int) -> NDArray[Any]:
    one = content["accessors"][number]
    view = content["bufferViews"][one["bufferView"]]
    kind = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}[one["componentType"]]
    width = {"SCALAR": 1, "VEC3": 3}[one["type"]]
    at, item = view.get("byteOffset", 0) + one.get("byteOffset", 0), np.dtype(kind).itemsize * width
    step = view.get("byteStride", item)
    rows = np.frombuffer(data, np.uint8, (one["count"] - 1) * step + item, at)
    rows = np.lib.stride_tricks.as_strided(rows, (one["count"], item), (step, 1))
    return np.ascontiguousarray(rows).view(kind)
