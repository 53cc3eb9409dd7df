"""Scenes as files: a dictionary for ``mi.load_dict`` as XML for ``mi.load_file``, with our records in separate files.

Tensors of star fields and records behind handles go into files named after the scene file and their keys in the scene.
Numbers are written with all significant digits, so that a written scene renders to the same bytes; transforms are
written as matrices, because Mitsuba's factors lose digits.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from optics.record_files import write_record
from render.engine import Engine
from render.plugins.camera_properties import CAMERAS, MOTIONS
from render.plugins.handles import Handles
from render.plugins.register import register_plugins
from render.plugins.star_field import COLLIMATIONS, save_star_field
from render.records import StarField

HANDLES: tuple[tuple[str, str, Handles[Any]], ...] = (
    ("lens_camera", "camera", CAMERAS),
    ("lens_camera", "exposure_motion", MOTIONS),
    ("star_field", "collimation", COLLIMATIONS),
)
"""Plugin, property and handles of the properties that name records."""


def save_scene(path: str | Path, scene: Mapping[str, Any]) -> list[Path]:
    """Write a scene.

    Parameters
    ----------
    path : path
        Of the scene file (.xml); its folder has to exist.
    scene : dict
        As for ``mi.load_dict``, of properties and nested dictionaries; objects that are loaded already have no text.

    Returns
    -------
    list of Path
        All files that were written, the scene first.

    Raises
    ------
    ConfigError
        An unknown handle.
    """
    register_plugins()
    mi, path = Engine.active().mitsuba, Path(path)
    written: list[Path] = []
    state = mi.parser.parse_dict(mi.parser.ParserConfig(mi.variant()), _written(dict(scene), path, (), written))
    kinds = {
        "star_tracer": mi.ObjectType.Integrator,
        "lens_camera": mi.ObjectType.Sensor,
        "star_field": mi.ObjectType.Emitter,
        "lunar_surface": mi.ObjectType.BSDF,
    }
    for node in state.nodes:
        node.type = kinds.get(node.props.plugin_name(), node.type)
    mi.parser.write_file(state, str(path))
    tree = ElementTree.parse(path)
    _write_matrices(tree.getroot(), scene)
    ElementTree.indent(tree, "    ")
    tree.write(path, encoding="utf-8", xml_declaration=True)
    return [path, *written]


def _write_matrices(element: ElementTree.Element, value: Mapping[str, Any]) -> None:
    """Write the transforms of a dictionary and its nested dictionaries into its XML element."""
    named = {child.get("name"): child for child in element}
    for key, entry in value.items():
        if key in named and isinstance(entry, Mapping):
            _write_matrices(named[key], entry)
        elif key in named and hasattr(entry, "matrix"):
            named[key][:] = []
            numbers = np.array(entry.matrix, float).ravel().tolist()
            ElementTree.SubElement(named[key], "matrix", value=" ".join(repr(v) for v in numbers))


def _written(value: dict[str, Any], path: Path, keys: tuple[str, ...], written: list[Path]) -> dict[str, Any]:
    """The dictionary with file names in place of tensors and handles."""

    def new_file(name: str, suffix: str) -> Path:
        written.append(path.with_name(".".join((path.stem, *keys, name, suffix)).replace("..", ".")))
        return written[-1]

    result = {
        key: _written(entry, path, (*keys, key), written) if isinstance(entry, dict) else entry
        for key, entry in value.items()
    }
    kind = value.get("type")
    if kind == "star_field" and "filename" not in value:
        arrays = {name: np.array(result.pop(name), float) for name in ("direction", "wavelength_nm", "photon_rate")}
        bands = arrays["wavelength_nm"].reshape(-1, arrays["wavelength_nm"].shape[-1])
        names = str(result.pop("band", "")) or ",".join(f"band {i}" for i in range(len(bands)))
        stars = StarField(
            direction=arrays["direction"].reshape(-1, 3),
            wavelength_nm=bands,
            photon_rate=arrays["photon_rate"].reshape(-1, *bands.shape),
            band=tuple(names.split(",")),
        )
        file = new_file("", "npz")
        save_star_field(file, stars)
        result["filename"] = file.name
    for plugin, name, handles in HANDLES:
        if kind == plugin and name in value:
            file = new_file(name, "json")
            write_record(file, handles.named(str(value[name])))
            result[name] = file.name
    if kind in ("star_field", "lens_camera") and "rotation" in value and not isinstance(value["rotation"], str):
        result["rotation"] = " ".join(repr(v) for v in np.array(value["rotation"], float).ravel().tolist())
    return result
