"""What baffles and benches refuse: rows like those of `test_refusals`, whose file is full."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optics.errors import ConfigError, DomainError
from render.baffle.black_coating import BlackCoating, black_coating
from render.baffle.light import BaffleScene
from render.baffle.mesh import Mesh, check_closed, read_glb, read_mesh
from render.baffle.vaned_baffle import VanedBaffle, vaned_baffle
from render.bench.camera import BenchCamera
from render.bench.scene import BenchGeometry
from render.bench.sensor import MaskSensor, mask_scene, trace_mask

Call = Callable[[Path], Any]


def baffle(**change: Any) -> VanedBaffle:
    return vaned_baffle(**({"entrance_mm": 9.0, "field_deg": 12.0} | change))


def cut_field() -> BaffleScene:
    coating = BlackCoating(name="test", diffuse=0.05)
    return BaffleScene(baffle(shade_deg=30.0, clearance_mm=-1.0), coating, entrance_mm=9.0, field_deg=12.0)


def tetrahedron(faces: str, first: int = 0) -> Mesh:
    corners = np.vstack([np.zeros(3), np.eye(3)])
    return Mesh(vertex_mm=corners, face=np.array([[int(k) + first for k in face] for face in faces.split()]))


def mesh_file(name: str, text: str, read: Any = read_mesh) -> Call:
    return lambda folder: ((folder / name).write_text(text), read(folder / name))


def wide_vane() -> VanedBaffle:
    vane = {"vane_z_mm": np.array([50.0]), "vane_mm": np.array([30.0])}
    return VanedBaffle(entrance_mm=9.0, length_mm=50.0, tube_mm=20.0, edge_mm=0.0, **vane)


def black(**change: float) -> Call:
    return lambda _: BlackCoating(**{"name": "test", "diffuse": 0.1} | change)  # type: ignore[arg-type]


BAFFLE = [
    ("shade or length", lambda _: baffle(), ConfigError, "either shade_deg", "length_mm"),
    ("shade in the field", lambda _: baffle(shade_deg=11.0), DomainError, "shade_deg = 11 deg", "field, 12 deg"),
    ("depth", lambda _: baffle(shade_deg=30.0, depth_mm=-1.0), DomainError, "-1 mm deep", "positive"),
    ("61 vanes", lambda _: baffle(field_deg=0.01, shade_deg=14.0, depth_mm=0.1), DomainError, "61 vanes", "1 to 60"),
    ("vane beyond the tube", lambda _: wide_vane(), DomainError, "inner radii [30.0] mm", "20 mm"),
    ("field is cut", lambda _: cut_field(), DomainError, "cuts the beam of the field", "9 mm"),
    ("reflectance -0.1", black(diffuse=-0.1), DomainError, "diffuse = -0.1", "0 ... 1"),
    ("reflectance 1.2", black(diffuse=1.2), DomainError, "diffuse = 1.2", "0 ... 1"),
    ("grazing", black(diffuse=0.5, specular=0.03), DomainError, "diffuse = 0.5", "specular = 0.03", "grazing"),
    ("roughness", black(roughness=0.0), DomainError, "roughness = 0", "0.01 ... 1"),
    ("coating", lambda _: black_coating("z307"), ConfigError, "z307", "z306"),
    ("open mesh", lambda _: check_closed(tetrahedron("021 013 032")), DomainError, "3 of 6 edges", "closed"),
    ("vertices", lambda _: tetrahedron("021 013 032 123", 1), DomainError, "own vertices"),
    ("open file", mesh_file("open.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 3 2\n"), DomainError, "3 of 3 edges"),
    ("no mesh file", lambda folder: read_mesh(folder / "none.ply"), ConfigError, "none.ply", "no such file"),
    ("kind of mesh", mesh_file("a.stl", "solid"), ConfigError, "a.stl", ".ply, .obj or .glb"),
    ("glTF", mesh_file("a.glb", "nothing at all, no glTF", read_glb), ConfigError, "a.glb", "binary glTF"),
]


def bench(**change: float) -> Call:
    return lambda _: BenchGeometry(cube_offset_mm=np.zeros(3), **change)  # type: ignore[arg-type]


def bench_camera(**change: float) -> Call:
    numbers = {"width_px": 160, "height_px": 160, "pitch_mm": 0.03, "distance_mm": 250.0, "angle_deg": 18.0}
    return lambda _: BenchCamera(aim_mm=np.zeros(2), **(numbers | change))  # type: ignore[arg-type]


def mask(gap_mm: float = 3.0) -> MaskSensor:
    sizes = {"width_px": 64, "height_px": 64, "pitch_mm": 0.007, "hole_mm": 0.2}
    return MaskSensor(gap_mm=gap_mm, offset_px=np.zeros(2), **sizes)  # type: ignore[arg-type]


def sun_beside_the_mask() -> Any:
    settings = {"half_angle_rad": 1e-3, "log2_particles": 8, "seed": 1}
    return trace_mask(mask_scene(mask()), mask(), [[1.0, 0.0, 0.0]], [[0, 0]], 48, **settings)  # type: ignore[arg-type]


BENCH = [
    ("distance", bench(distance_mm=-1.0), DomainError, "distance_mm = -1 mm", "1e5 mm"),
    ("aperture", bench(aperture_mm=70.0), DomainError, "70 mm", "smaller than the beam"),
    ("chamfer", bench(chamfer_mm=11.0), DomainError, "chamfer_mm = 11 mm", "10 mm"),
    ("source", bench(source_arcmin=200.0), DomainError, "source_arcmin = 200", "0 to 120"),
    ("camera", bench_camera(angle_deg=80.0), DomainError, "angle_deg = 80", "0 to 60"),
    ("sun behind the mask", lambda _: sun_beside_the_mask(), DomainError, "not in front of the mask", "0.02"),
    ("gap", lambda _: mask(0.0), DomainError, "gap_mm = 0 mm", "100 mm"),
]


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [
        pytest.param(call, kind, words, id=f"{section}: {name}")
        for section, rows in (("baffle", BAFFLE), ("bench", BENCH))
        for name, call, kind, *words in rows
    ],
)
def test_refusals(call: Call, kind: type[Exception], words: list[str], tmp_path: Path) -> None:
    with pytest.raises(kind) as error:
        call(tmp_path)
    message = str(error.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []
