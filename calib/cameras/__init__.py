"""Camera models: directions in cam to pixels and back, one file per model with its mathematics."""

from __future__ import annotations

from calib.cameras.base import CameraModel, Projection, SensorGeometry, Unprojection, unproject_jacobian
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.per_band import PerBand
from calib.cameras.polynomial import Polynomial

__all__ = [
    "BrownConrady",
    "CameraModel",
    "PerBand",
    "Polynomial",
    "Projection",
    "SensorGeometry",
    "Unprojection",
    "unproject_jacobian",
]
