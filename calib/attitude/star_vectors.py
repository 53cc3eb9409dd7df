"""Star vectors in the table's frame at zero angles (FISHER23, step S300).

A single star is fixed in the laboratory while a table turns the camera. Each image is converted to a direction in the
camera by the calibrated model, then transformed to the table's frame at zero angles by the installation and the table's
attitude. All vectors should be equal; their scatter is the accuracy of the star vectors (S400).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from optics.arrays import FloatArray
from optics.errors import DomainError


def initial_frame_vectors(
    model: CameraModel,
    pixel_px: ArrayLike,
    *,
    installation: Rotation,
    table_rotation: Rotation,
    band: NDArray[np.int64] | None = None,
) -> FloatArray:
    """Star vectors of all images in the frame of the table at zero angles.

    .. math:: w_i = R_i M^T u(x_i, y_i)

    with the unprojection u (FISHER23 eq. 4-6), the installation M (eq. 2) and the table's attitude R_i (eq. 3, 7).

    Examples
    --------
    A camera that looks along the table's z axis sees a star on that axis in the middle, at any roll:

    >>> from calib.cameras import BrownConrady, SensorGeometry
    >>> sensor = SensorGeometry(width_px=101, height_px=101, pixel_pitch_mm=0.01)
    >>> model = BrownConrady.create(sensor, focal_length_mm=50.0)
    >>> turn = Rotation.from_rotvec([[0, 0, 0.0], [0, 0, 1.0]])
    >>> initial_frame_vectors(model, [[50, 50], [50, 50]], installation=Rotation.identity(), table_rotation=turn)
    array([[0., 0., 1.],
           [0., 0., 1.]])

    Shapes: ``pixel_px`` (n, 2), ``band`` (n,).
    """
    pixel = np.asarray(pixel_px, dtype=np.float64)
    if pixel.ndim != 2 or pixel.shape[1] != 2:
        raise DomainError(f"pixel_px of shape {pixel.shape}; (n, 2) is needed")
    if not installation.single:
        raise DomainError(f"installation: {len(installation)} rotations; a single rotation is needed")
    if not table_rotation.single and len(table_rotation) != len(pixel):
        raise DomainError(
            f"{len(table_rotation)} table attitudes for {len(pixel)} images; each image needs an attitude"
        )
    direction = np.array(model.unproject(pixel, band))
    found = np.isfinite(direction).all(axis=1)
    vectors = np.full(direction.shape, np.nan)
    turn = table_rotation if table_rotation.single else table_rotation[found]
    vectors[found] = (turn * installation.inv()).apply(direction[found])
    return vectors
