"""A camera model with a rotation between its axes and the camera's axes, as one model.

Some models cannot place their axis where the camera has it (`calib.cameras.polynomial`), and a fit then has a small
rotation in addition to the parameters: the model's cam from the camera's, v_model = R v_cam. Here

    project(v) = model.project(R v),   unproject(pixel) = R^T model.unproject(pixel)

so that directions and solved attitudes refer to the camera's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel, Projection, checked_vectors
from optics.arrays import FloatArray
from optics.records import freeze


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignedCamera(CameraModel):
    """A camera model with a fixed alignment; geometry and parameters are the model's."""

    model: CameraModel  # The family; its parameters play no part beside ``parameters``
    rotation_model_from_cam: FloatArray  # (3, 3)

    def __post_init__(self) -> None:
        freeze(self, "rotation_model_from_cam", shape=(3, 3))
        object.__setattr__(self, "model", self.model.with_parameters(self.parameters))
        CameraModel.__post_init__(self)

    @classmethod
    def create(cls, model: CameraModel, rotation: Rotation) -> Self:
        """The model behind a rotation, model's cam from the camera's."""
        return cls(
            geometry=model.geometry,
            parameters=model.parameters,
            model=model,
            rotation_model_from_cam=rotation.as_matrix(),
        )

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the model's parameters."""
        return self.model.parameter_names

    @property
    def pinhole_names(self) -> tuple[str, ...]:
        """Names of the model's pinhole parameters."""
        return self.model.pinhole_names

    @property
    def parameter_scales(self) -> FloatArray:
        """Scales of the model's parameters."""
        return self.model.parameter_scales

    def project(self, direction: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        return self.model.project(checked_vectors(direction, 3, "direction") @ self.rotation_model_from_cam.T, band)

    def project_jacobian(self, direction: ArrayLike, band: ArrayLike | None = None) -> Projection:
        in_model = checked_vectors(direction, 3, "direction") @ self.rotation_model_from_cam.T
        at = self.model.project_jacobian(in_model, band)
        return Projection(at.pixel_px, at.by_direction @ self.rotation_model_from_cam, at.by_parameter)

    def unproject(self, pixel_px: ArrayLike, band: ArrayLike | None = None) -> FloatArray:
        return np.asarray(self.model.unproject(pixel_px, band) @ self.rotation_model_from_cam)
