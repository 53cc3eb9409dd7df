"""Mitsuba emitter ``star_field``: point sources at infinity, with float64 directions and light per wavelength node.

Properties
----------
direction : TensorXf64 (n, 3)
    Unit vectors towards the stars, in the scene's world frame.
wavelength_nm : TensorXf64 (b, k)
    Wavelength nodes of each band.
photon_rate : TensorXf64 (n, b, k)
    Photons per second and mm^2 per node, filter included (`render.records.StarField`).
band : str, optional
    Names of the bands, separated by commas.
rotation : TensorXf64 (3, 3), optional
    ``v_cam = rotation @ v_world`` for the stars, in place of the attitude of the sensor they are seen by.
motion : str, optional
    Handle of the camera's motion during the exposure (`share_motion`), in place of an attitude.
collimation : str, optional
    Handle of the error of a collimator (`share_collimation`).

Each tensor may have a leading axis of size one: Mitsuba's property parser takes a tensor whose first axis has three
entries for a colour, and nanobind says so on the error stream before it falls back to the tensor.

Stock integrators see a black emitter: a point at infinity has no radiance a path could find.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from optics.errors import ConfigError
from optics.light.collimation import Collimation
from render.engine.jit import dr
from render.plugins.handles import Handles
from render.records import StarField
from render.tracing.motion import ExposureMotion

__all__ = ["define", "share_collimation", "share_motion"]

_motions: Handles[ExposureMotion] = Handles("motion")
_collimations: Handles[Collimation] = Handles("collimation")


def share_motion(motion: ExposureMotion) -> str:
    """Handle by which ``load_dict`` takes a motion, see `render.plugins.handles`."""
    return _motions.share(motion)


def share_collimation(collimation: Collimation) -> str:
    """Handle by which ``load_dict`` takes the error of a collimator."""
    return _collimations.share(collimation)


def define(mi: Any) -> type:
    """The plugin class for Mitsuba's active variant."""

    class StarFieldEmitter(mi.Emitter):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            arrays = {}
            for name, axes in (("direction", 2), ("wavelength_nm", 2), ("photon_rate", 3)):
                if name not in props:
                    raise ConfigError(f"star_field: property {name!r} is missing (a TensorXf64)")
                array = np.array(props[name], dtype=float)
                arrays[name] = array[0] if array.ndim == axes + 1 and array.shape[0] == 1 else array
            bands = arrays["wavelength_nm"].shape[0]
            names = (
                str(props.get("band", "")).split(",") if props.get("band", "") else [f"band {i}" for i in range(bands)]
            )
            handle = str(props.get("collimation", ""))
            collimation = _collimations.find(handle) if handle else None
            self.stars = StarField(band=tuple(names), collimation=collimation, **arrays)
            self.rotation = np.array(props["rotation"], float).reshape(3, 3) if "rotation" in props else None
            self.motion = _motions.find(str(props["motion"])) if "motion" in props else None
            self.m_flags = mi.EmitterFlags.DeltaDirection | mi.EmitterFlags.Infinite

        def eval(self, si: Any, active: Any = True) -> Any:
            return mi.Spectrum(0)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Spectrum(0)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def to_string(self) -> str:
            return f"StarField[stars={len(self.stars)}, bands={', '.join(self.stars.band)}]"

    return StarFieldEmitter
