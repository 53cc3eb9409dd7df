"""Camera models: directions in cam to pixels and back, each one file with its mathematics."""

from __future__ import annotations

from calib.cameras.base import CameraModel, Projection, SensorGeometry, Unprojection, unproject_jacobian
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.per_band import PerBand
from calib.cameras.polynomial import Polynomial
from optics.errors import unknown_name

__all__ = [
    "CAMERA_MODELS",
    "BrownConrady",
    "CameraModel",
    "PerBand",
    "Polynomial",
    "Projection",
    "SensorGeometry",
    "Unprojection",
    "get_camera_model",
    "unproject_jacobian",
]

CAMERA_MODELS: dict[str, type[CameraModel]] = {
    "brown_conrady": BrownConrady,
    "per_band": PerBand,
    "polynomial": Polynomial,
}


def get_camera_model(name: str) -> type[CameraModel]:
    """Class of a camera model by its name.

    Raises
    ------
    ConfigError
        On an unknown name; the message lists the nearest ones.
    """
    if name not in CAMERA_MODELS:
        raise unknown_name("camera model", name, CAMERA_MODELS)
    return CAMERA_MODELS[name]
