"""Meshes of baffles: files of the user (PLY, OBJ, binary glTF), checked to be closed."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze
from render.engine import Engine


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """Triangles; mm, in the frame of the baffle."""

    vertex_mm: FloatArray  # (n, 3)
    face: IntArray  # (m, 3)
    name: str = "mesh"

    def __post_init__(self) -> None:
        freeze(self, "vertex_mm", shape=("n", 3))
        faces = freeze(self, "face", shape=("m", 3), dtype=np.int64)
        if not len(faces) or faces.min() < 0 or faces.max() >= len(self.vertex_mm):
            raise DomainError(f"{self.name}: a mesh needs triangles of its own vertices")


def read_mesh(path: str | Path) -> Mesh:
    """A closed mesh of the user's: PLY or OBJ by Mitsuba, binary glTF."""
    file = Path(path)
    if not file.is_file():
        raise ConfigError(f"{file}: no such file")
    if file.suffix.lower() == ".glb":
        mesh = read_glb(file)
    elif file.suffix.lower() in (".ply", ".obj"):
        mi = Engine.active().mitsuba
        try:
            shape = mi.load_dict({"type": file.suffix.lower()[1:], "filename": str(file)})
        except RuntimeError as error:
            reason = (str(error).strip().splitlines() or ["no reason given"])[-1].strip()
            raise ConfigError(f"{file}: cannot be read as a mesh ({reason})") from None
        parameters = mi.traverse(shape)
        mesh = Mesh(
            vertex_mm=np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3),
            face=np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3),
            name=str(file),
        )
    else:
        raise ConfigError(f"{file}: a mesh file must be .ply, .obj or .glb")
    check_closed(mesh)
    return mesh


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
    """Triangles of a binary glTF file (``.glb``) in the frame of its scene; units unchanged, to be mm."""
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
    pending = [(number, np.eye(4)) for number in scene["nodes"]]
    nodes: list[tuple[dict[str, Any], FloatArray]] = []
    while pending:
        number, parent = pending.pop()
        node, local = content["nodes"][number], np.eye(4)
        if "matrix" in node:
            local = np.reshape(node["matrix"], (4, 4)).T
        else:
            rotation = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
            local[:3, :3] = rotation * np.array(node.get("scale", [1, 1, 1]))
            local[:3, 3] = node.get("translation", [0, 0, 0])
        nodes.append((node, parent @ local))
        pending += [(child, parent @ local) for child in node.get("children", ())]
    return nodes


def _accessor(content: dict[str, Any], data: bytes, number: int) -> NDArray[Any]:
    accessor = content["accessors"][number]
    view = content["bufferViews"][accessor["bufferView"]]
    kind = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}[accessor["componentType"]]
    item = np.dtype(kind).itemsize * {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    offset, step = view.get("byteOffset", 0) + accessor.get("byteOffset", 0), view.get("byteStride", item)
    rows = np.frombuffer(data, np.uint8, (accessor["count"] - 1) * step + item, offset)
    rows = np.lib.stride_tricks.as_strided(rows, (accessor["count"], item), (step, 1))
    return np.ascontiguousarray(rows).view(kind)
