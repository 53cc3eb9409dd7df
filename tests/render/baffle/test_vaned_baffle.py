"""Baffles: the construction does what it is for, closed meshes, coatings, files."""

import json
import struct

import numpy as np
import pytest

from render.baffle.mesh import Mesh, check_closed, read_glb
from render.baffle.vaned_baffle import VanedBaffle, vaned_baffle, vaned_mesh


def cube() -> tuple[np.ndarray, np.ndarray]:
    vertex = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    face = "013 032 467 475 045 051 237 276 026 064 157 173"
    return vertex, np.array([[int(k) for k in one] for one in face.split()])


def passes(baffle: VanedBaffle, a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether a straight line in a plane through the axis, from (height, z) to another, clears all vanes between."""
    low, high = sorted((a, b), key=lambda p: p[1])
    for z, radius in zip(baffle.vane_z_mm, baffle.vane_mm, strict=True):
        if low[1] + 1e-9 < z < high[1] - 1e-9:
            at = low[0] + (high[0] - low[0]) * (z - low[1]) / (high[1] - low[1])
            if abs(at) > radius + 1e-9:
                return False
    return True


@pytest.mark.parametrize(
    "wanted",
    [
        {"shade_deg": 35.0, "field_deg": 15.8},
        {"shade_deg": 25.0, "field_deg": 5.0},
        {"length_mm": 200.0, "field_deg": 8.0},
    ],
)
def test_no_wall_is_lit_and_seen(wanted) -> None:
    """In the meridional plane, by lines: points of the wall that see the sky do not see the entrance."""
    baffle = vaned_baffle(entrance_mm=9.0, depth_mm=7.0, **wanted)
    opening = float(baffle.vane_mm[0])
    assert len(baffle.vane_z_mm) > 2
    both = 0
    last = float(baffle.vane_z_mm[-1])
    for z in np.linspace(last + 1e-3, baffle.length_mm - 1e-3, 600):
        wall = (baffle.tube_mm, z)
        # beyond the front: sky through every point of the opening
        lit = any(passes(baffle, wall, (h, baffle.length_mm)) for h in np.linspace(-opening, opening, 81))
        seen = any(passes(baffle, wall, (h, 0.0)) for h in np.linspace(-9.0, 9.0, 41))
        both += lit and seen
    assert both <= 2  # points at the very ends, where both begin
    bare = vaned_baffle(entrance_mm=9.0, vanes=0, **wanted)
    assert passes(bare, (bare.tube_mm, 0.5 * bare.length_mm), (0.0, 0.0))


def test_the_shade_begins_where_it_should() -> None:
    baffle = vaned_baffle(entrance_mm=9.0, field_deg=12.0, shade_deg=30.0)
    assert baffle.shade_deg == pytest.approx(30.0, abs=1e-9)
    # the line from one edge of the entrance to the other edge of the opening
    slope = np.degrees(np.arctan((baffle.vane_mm[0] + 9.0) / baffle.vane_z_mm[0]))
    assert slope == pytest.approx(30.0, abs=1e-9)
    # vanes keep off the cone of the field
    clear = baffle.vane_mm - 9.0 - baffle.vane_z_mm * np.tan(np.radians(12.0))
    np.testing.assert_allclose(clear, 0.5, atol=1e-9)


@pytest.mark.parametrize("vanes", [3, 6, 9])
def test_a_number_of_vanes_sets_their_depth(vanes: int) -> None:
    baffle = vaned_baffle(entrance_mm=9.0, field_deg=8.0, shade_deg=25.0, vanes=vanes)
    assert len(baffle.vane_z_mm) == vanes
    fewer = vaned_baffle(entrance_mm=9.0, field_deg=8.0, shade_deg=25.0, vanes=vanes - 1)
    assert baffle.tube_mm < fewer.tube_mm


def test_areas_of_the_mesh_are_those_of_the_circles() -> None:
    baffle = vaned_baffle(entrance_mm=9.0, field_deg=12.0, shade_deg=30.0)
    mesh = vaned_mesh(baffle)
    corner = mesh.vertex_mm[mesh.face]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    flat = np.ptp(corner[..., 2], axis=1) < 1e-9
    rings = np.pi * (baffle.tube_mm**2 - np.append(baffle.vane_mm, 9.0) ** 2).sum()
    assert area[flat].sum() == pytest.approx(rings, rel=1e-12)
    assert area[~flat].sum() == pytest.approx(2.0 * np.pi * baffle.tube_mm * baffle.length_mm, rel=2e-4)


def test_closed_meshes() -> None:
    """With shared vertices, and with separate ones for every triangle."""
    vertex, face = cube()
    check_closed(Mesh(vertex_mm=vertex, face=face))
    check_closed(Mesh(vertex_mm=vertex[face].reshape(-1, 3), face=np.arange(36).reshape(-1, 3)))


def test_a_binary_gltf_comes_with_its_nodes_placed(tmp_path) -> None:
    vertex, face = cube()
    points, indices = vertex.astype("<f4").tobytes(), face.astype("<u2").tobytes()
    content = {
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"children": [1], "translation": [1, 2, 3]},
            {"mesh": 0, "scale": [2, 2, 2], "rotation": [0, 0, 1, 0]},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [{"byteLength": len(points)}, {"byteOffset": len(points), "byteLength": len(indices)}],
    }  # fmt: skip
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    data = points + indices
    file = tmp_path / "cube.glb"
    size = 12 + 8 + len(text) + 8 + len(data)
    file.write_bytes(
        struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON") + text
        + struct.pack("<I4s", len(data), b"BIN\0") + data
    )  # fmt: skip
    mesh = read_glb(file)
    check_closed(mesh)
    np.testing.assert_allclose(mesh.vertex_mm.min(0), [-1, 0, 3])  # half a turn about z, twice the size, moved
    np.testing.assert_allclose(mesh.vertex_mm.max(0), [1, 2, 5])
