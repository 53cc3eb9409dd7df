"""A lens without distortion, of the focal length of a camera's: where motion is only needed nearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.rays.paraxial import axial_paraxial
from render.camera import Camera

__all__ = ["IdealLens"]


@dataclass(frozen=True, slots=True)
class IdealLens:
    """An ideal lens of the focal length of a camera's."""

    centre_px: FloatArray
    focal_px: float

    @classmethod
    def of(cls, camera: Camera) -> IdealLens:
        """The one of a camera."""
        focal_mm = abs(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
        return cls(camera.centre_px, focal_mm / camera.pixel_pitch_mm)

    def px(self, direction: FloatArray) -> FloatArray:
        """Columns and rows (..., 2) of directions in cam."""
        return np.asarray(self.centre_px + self.focal_px * direction[..., :2] / np.maximum(direction[..., 2:], 1e-3))
