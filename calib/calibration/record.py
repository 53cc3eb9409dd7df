"""Result of a calibration: camera, covariance, and the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from calib.fitting.solution import Solution
from optics.arrays import FloatArray
from optics.records import freeze


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A calibrated camera.

    Attributes
    ----------
    method : str
        Which estimator made it.
    model : CameraModel
        The camera.
    covariance : (p, p)
        Covariance of ``model.parameters``; zero rows and columns for parameters that were held.
    solution : Solution
        All common unknowns of the fit, and its status. Only a converged one may be used.
    attitude : Rotation or None
        Attitude of every frame, cam from reference (f rotations); None where the estimator knows none.
    installation : Rotation or None
        Installation of the camera (cam from body, or from the table), if the estimator knows one.
    used : (n,) bool
        Observations that took part.
    """

    method: str
    model: CameraModel
    covariance: FloatArray
    solution: Solution
    attitude: Rotation | None
    installation: Rotation | None
    used: NDArray[np.bool_]

    def __post_init__(self) -> None:
        sizes = {"p": len(self.model.parameters)}
        freeze(self, "covariance", shape=("p", "p"), finite=False, sizes=sizes)
        freeze(self, "used", shape=("n",), dtype=np.bool_, sizes=sizes)

    @property
    def converged(self) -> bool:
        """Whether the calibration may be used."""
        return self.solution.converged
