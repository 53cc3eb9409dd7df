"""Star vectors in the table's frame at zero angles (FISHER23, step S300).

A single star is fixed in the laboratory while a table turns the camera. Each image is converted to a direction in the
camera by the calibrated model, then transformed to the table's frame at zero angles by the installation and the table's
attitude. All vectors should be equal; their scatter is the accuracy of the star vectors (S400).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from calib.directional.fisher import mean_and_chords, sample_fisher
from calib.directional.pixel_method import residual_sigma_px
from optics.arrays import FloatArray
from optics.errors import DomainError

BORESIGHT = np.array([0.0, 0.0, 1.0])


def initial_frame_vectors(
    model: CameraModel,
    pixel_px: ArrayLike,
    *,
    installation: Rotation,
    table_rotation: Rotation,
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

    Shapes: ``pixel_px`` (n, 2).
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
    vectors = np.array(model.unproject(pixel))
    finite = np.isfinite(vectors).all(axis=1)
    table = table_rotation if table_rotation.single else table_rotation[finite]
    vectors[finite] = (table * installation.inv()).apply(vectors[finite])
    return vectors


def sampled_method_ratios(
    model: CameraModel, count: int, sigma_rad: float, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Ratios of the two methods for the accuracy of star vectors, from drawn noise at even places of a detector.

    The bench is perfect: camera, table and star are known; ``sigma_rad`` is the noise per axis at the boresight.
    Returns pixel method over Fisher for noise isotropic on the sphere (expected over a square field:
    `calib.directional.pixel_method.spherical_noise_ratio`), Fisher over the truth for the same noise, and Fisher over
    the pixel method for noise isotropic in pixels (expected: `pixel_noise_ratio`).
    """
    size = [model.geometry.width_px, model.geometry.height_px]
    pixel_rad = model.geometry.pixel_pitch_mm / model.value("focal_length_mm")
    position_px = rng.uniform(-0.5, np.subtract(size, 0.5), (count, 2))
    to_star = _turns(model.unproject(position_px))
    vectors = sample_fisher(BORESIGHT, sigma_rad**-2, count, rng)
    residual = model.project(np.einsum("nji,nj->ni", to_star, vectors)) - position_px
    noise = sigma_rad / pixel_rad * rng.standard_normal(position_px.shape)
    noisy = np.einsum("nij,nj->ni", to_star, model.unproject(position_px + noise))
    fisher = _sigma(vectors)
    return (
        residual_sigma_px(residual) * pixel_rad / fisher,
        fisher / sigma_rad,
        _sigma(noisy) / (residual_sigma_px(noise) * pixel_rad),
    )


def _turns(direction: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) that bring each direction to the star: what installation and table do on a perfect bench."""
    across = np.cross([0.0, 1.0, 0.0], direction)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([across, np.cross(direction, across), direction], axis=1)


def _sigma(vectors: FloatArray) -> float:
    """Standard deviation per axis, steps S400 and S500 without the checks of a single sample."""
    chord2 = mean_and_chords(vectors[None])[1]
    return float(np.sqrt(chord2.sum() / (2 * (len(vectors) - 1))))
