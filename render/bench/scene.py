"""The cube-mirror bench as Mitsuba shapes: sun simulator, screen with its aperture, cube mirror, camera (CUBE09).

Laboratory frame, mm: origin in the centre of the aperture, +Z towards the sun simulator, so that its light travels
along -Z; +Y up. The two axes of the turntable cross on the Z axis at ``(0, 0, -(distance + cube/2))``: any face of a
cube centred there, turned to the light, has the same ``distance`` from the aperture.

The aperture is a hole in a mesh, a polygon of `HOLE_SIDES` sides. All reflecting parts are analytic rectangles, whose
normals come from their transformations and not from differences of float32 vertices. The origin in the aperture gives
float32 its finest resolution where it matters: spots are accurate to 1e-4 mm (tests).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all
from render.engine import Engine
from render.engine.triangle_mesh import equal_area_scale, mitsuba_mesh, strip_faces

FACES: dict[str, tuple[int, int]] = {f"{sign}{'XYZ'[k]}": (k, int(f"{sign}1")) for k in range(3) for sign in "+-"}
"""Faces of the cube: name -> (axis, sign) of the outward normal."""

HOLE_SIDES = 180
COVER_GAP_MM = 5e-4  # the image of the cover is displaced by gap tan(angle of the camera)


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchGeometry:
    """Sizes and positions of the parts of the bench."""

    distance_mm: float = 650.0  # Aperture to cube face (CUBE09: about 650 mm)
    aperture_mm: float = 2.5  # Diameter of the aperture (CUBE09: 2.5 mm)
    screen_mm: float = 200.0  # Side of the square screen
    simulator_mm: float = 60.0  # Diameter of the simulator's beam
    simulator_gap_mm: float = 20.0  # Simulator to screen (CUBE09: about 20 mm)
    # Angular diameter of the simulated sun, uniformly bright; 0 for perfectly collimated light
    source_arcmin: float = 3.0
    cube_mm: float = 20.0  # Side of the cube mirror
    chamfer_mm: float = 0.5  # Width by which the polished faces end before the edges of the cube
    cube_offset_mm: FloatArray  # (3,) Centre of the cube in the table frame; the axes of the table cross at the origin
    # Diffuse reflectance of the screen and transmittance of the sheet that covers the aperture
    screen_reflectance: float = 0.8
    metal: str = "Al"  # Metal of the faces, a name that Mitsuba's ``conductor`` knows

    def __post_init__(self) -> None:
        freeze(self, "cube_offset_mm", shape=(3,))
        for name in ("distance_mm", "aperture_mm", "screen_mm", "simulator_mm", "simulator_gap_mm", "cube_mm"):
            value = getattr(self, name)
            if not 0.0 < value < 1e5:
                raise DomainError(f"BenchGeometry.{name} = {value:g} mm; it must be above 0 and below 1e5 mm")
        if not 0.0 <= self.source_arcmin <= 120.0:
            raise DomainError(f"BenchGeometry.source_arcmin = {self.source_arcmin:g} arcmin; it must be 0 to 120")
        widest = min(self.simulator_mm - 2 * self.blur_mm(self.simulator_gap_mm), self.screen_mm)
        if self.aperture_mm >= widest:
            raise DomainError(
                f"aperture of {self.aperture_mm:g} mm; it must be smaller than the beam and the screen, below "
                f"{widest:.3g} mm here"
            )
        if not 0.0 <= self.chamfer_mm < self.cube_mm / 2:
            raise DomainError(
                f"BenchGeometry.chamfer_mm = {self.chamfer_mm:g} mm; it must be 0 to below half the cube, "
                f"{self.cube_mm / 2:g} mm"
            )

    @property
    def half_angle_rad(self) -> float:
        """Angular radius of the simulated sun [rad]."""
        return float(np.radians(self.source_arcmin / 120.0))

    @property
    def path_mm(self) -> float:
        """Path from the aperture to the face and back."""
        return 2.0 * self.distance_mm

    @property
    def crossing_mm(self) -> FloatArray:
        """Intersection of the axes of the table (3,)."""
        return np.array([0.0, 0.0, -(self.distance_mm + self.cube_mm / 2)])

    @property
    def face_mm(self) -> float:
        """Side of a polished face."""
        return self.cube_mm - 2 * self.chamfer_mm

    def blur_mm(self, path_mm: float) -> float:
        """Radius of the simulated sun's image after a path from a point."""
        return float(path_mm * np.tan(self.half_angle_rad))


@dataclass(frozen=True, slots=True, kw_only=True)
class CubePose:
    """Pose of a cube in the laboratory."""

    rotation: FloatArray  # (3, 3) Laboratory from the cube's frame
    centre_mm: FloatArray  # (3,) Centre of the cube in the laboratory
    # (6, 3) Outward normals of the faces in the cube's frame, in the order of `FACES`: unit vectors, near the axes
    normal: FloatArray

    def __post_init__(self) -> None:
        freeze_all(self, rotation=(3, 3), centre_mm=(3,), normal=(6, 3))

    @classmethod
    def of_table(
        cls, geometry: BenchGeometry, lab_from_table: ArrayLike, table_from_cube: ArrayLike, normal: ArrayLike
    ) -> CubePose:
        """Pose of a cube on a table that stands at ``lab_from_table`` (3, 3)."""
        table = np.asarray(lab_from_table, float)
        return cls(
            rotation=table @ np.asarray(table_from_cube, float),
            centre_mm=geometry.crossing_mm + table @ geometry.cube_offset_mm,
            normal=np.asarray(normal, float),
        )

    def face(self, name: str, geometry: BenchGeometry) -> tuple[FloatArray, FloatArray]:
        """Centre [mm] and outward normal of a face in the laboratory."""
        axis, sign = FACES[name]
        outward = sign * np.eye(3)[axis]
        centre = self.centre_mm + self.rotation @ outward * geometry.cube_mm / 2
        return centre, self.rotation @ self.normal[list(FACES).index(name)]


def frame_around(normal: FloatArray, along: FloatArray) -> FloatArray:
    """Rotation matrix with columns (u, v, normal); u is the direction of ``along`` normal to the last."""
    u = along - (along @ normal) * normal
    u = u / np.linalg.norm(u)
    return np.column_stack([u, np.cross(normal, u), normal])


def rectangle_at(centre: FloatArray, frame: FloatArray, half_width: float, half_height: float) -> FloatArray:
    """Matrix (4, 4) that places Mitsuba's unit ``rectangle`` (or ``disk``)."""
    matrix = np.eye(4)
    matrix[:3, :3] = frame * np.array([half_width, half_height, 1.0])
    matrix[:3, 3] = centre
    return matrix


def face_matrices(geometry: BenchGeometry, pose: CubePose) -> dict[str, FloatArray]:
    """Matrices of the rectangles of the six faces: name -> (4, 4)."""
    half = geometry.face_mm / 2
    matrices = {}
    for name, (axis, _) in FACES.items():
        centre, normal = pose.face(name, geometry)
        along = pose.rotation[:, (axis + 1) % 3]
        matrices[name] = rectangle_at(centre, frame_around(normal / np.linalg.norm(normal), along), half, half)
    return matrices


def plate_mesh(hole_mm: float, half_mm: float, *, material: dict[str, Any]) -> Any:
    """A square plate in the plane z = 0 with a round hole in its middle, both in mm."""
    sides = HOLE_SIDES
    angle = np.arange(sides) * 2 * np.pi / sides
    unit = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sides)])
    radii = [hole_mm / 2 * equal_area_scale(sides)]
    while radii[-1] * 2.5 < half_mm:
        radii.append(radii[-1] * 2.5)
    square = half_mm / np.abs(unit[:, :2]).max(1)
    rings = [*(r * unit for r in radii), square[:, None] * unit]
    faces = [strip_faces(sides * ring, sides) for ring in range(len(rings) - 1)]
    return mitsuba_mesh("plate", np.concatenate(rings), np.concatenate(faces), material)


def screen_and_mirrors(geometry: BenchGeometry, pose: CubePose) -> dict[str, Any]:
    """The white screen with its aperture and the polished faces of the cube, by name, for ``load_dict``."""
    white = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": geometry.screen_reflectance}}
    shapes: dict[str, Any] = {"screen": plate_mesh(geometry.aperture_mm, geometry.screen_mm / 2, material=white)}
    for name, matrix in face_matrices(geometry, pose).items():
        shapes[f"face{name}"] = {
            "type": "rectangle",
            "to_world": Engine.active().mitsuba.ScalarTransform4f(matrix),
            "bsdf": {"type": "conductor", "material": geometry.metal},
        }
    return shapes


def bench_scene(geometry: BenchGeometry, pose: CubePose, *, covered: bool) -> Any:
    """The scene lit by the simulator."""
    mi = Engine.active().mitsuba
    content = {"type": "scene", **screen_and_mirrors(geometry, pose)}
    if covered:
        sheet = rectangle_at(np.array([0, 0, -COVER_GAP_MM]), np.diag([1.0, -1.0, -1.0]), 5.0, 5.0)
        sheet[:3, :2] *= geometry.aperture_mm / 5.0
        paper = {  # scatters light diffusely to both sides
            "type": "principledthin", "base_color": geometry.screen_reflectance, "diff_trans": 1.0, "roughness": 1.0,
            "eta": 1.0001,
        }  # fmt: skip
        content["cover"] = {"type": "disk", "to_world": mi.ScalarTransform4f(sheet), "bsdf": paper}
    return mi.load_dict(content, optimize=False)  # merging turns the rectangles into a mesh of float32 vertices


def place_cube(scene: Any, geometry: BenchGeometry, pose: CubePose) -> None:
    """Move the cube of a scene from `bench_scene`; the scene is changed."""
    mi = Engine.active().mitsuba
    parameters = mi.traverse(scene)
    for name, matrix in face_matrices(geometry, pose).items():
        parameters[f"face{name}.to_world"] = mi.Transform4f(matrix)
    parameters.update()
