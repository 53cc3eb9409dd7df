"""Fit of a camera model to a noise-free map of directions to pixels, such as a traced lens.

The residual is the part of the map that the model cannot represent: the mismatch of the distortion model. The model may
be turned against the map by a small rotation exp(w), w in cam, because a model with a fixed gauge (the polynomial)
places its axis elsewhere than the lens, and because lines of sight are compared after the best rotation:

    minimise  sum |project(exp(w) d_i) - pixel_i|^2

over the model's parameters and w. With v = exp(w) d and V the left Jacobian of SO(3) at w (the right one at -w),
d pixel / d w = -A [v] V, A = d pixel / d v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.cameras.aligned import AlignedCamera
from calib.cameras.base import CameraModel, SensorGeometry, checked_vectors
from calib.cameras.brown_conrady import BrownConrady
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from calib.cameras.polynomial import Polynomial
from calib.fitting.least_squares import DenseProblem, solve
from calib.fitting.rotation_vectors import right_jacobian
from calib.fitting.solution import Solution
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import PixelMap

TURN_NAMES = ("turn_x_rad", "turn_y_rad", "turn_z_rad")
GOOD_PX = 2e-3
"""A model that follows the lens this closely is good enough: a tenth of what a bright star's centroid is known to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFit:
    """A camera model fitted to a map."""

    model: CameraModel  # The model with fitted parameters
    rotation: Rotation  # The model's cam from the cam of the map; the identity if the model was not allowed to turn
    residual_px: FloatArray  # (n, 2) Model minus map
    line_of_sight: LineOfSightMap  # The same as angles on the sky, at the map's pixels
    # Status and statistics of the fit, for residuals in px; sigmas mean nothing, since there is no noise
    solution: Solution

    @property
    def camera(self) -> CameraModel:
        """The model in the cam of the map: what turns pixels into the directions that the map knows."""
        return AlignedCamera.create(self.model, self.rotation)

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residual, both axes together."""
        return float(np.sqrt(np.mean(np.sum(self.residual_px**2, axis=1))))

    @property
    def max_px(self) -> float:
        """Largest length of the residual."""
        return float(np.max(np.hypot(self.residual_px[:, 0], self.residual_px[:, 1])))


def fit_to_map(
    model: CameraModel,
    direction: ArrayLike,
    pixel_px: ArrayLike,
    *,
    band: ArrayLike | None = None,
    free: Sequence[str] | None = None,
    turn: bool = True,
) -> MapFit:
    """Fit a camera model to a noiseless map of directions to pixels.

    Parameters
    ----------
    model : CameraModel
        The family and the start.
    direction : (n, 3)
        Directions in cam of the map.
    pixel_px : (n, 2)
        Their pixels; equal weights, so spread them evenly over the detector.
    band : int or (n,) int, optional
        Bands.
    free : sequence of str, optional
        Parameters that may move; all if left out.
    turn : bool
        Whether the model may be turned against the map. The principal point of a Brown-Conrady camera is nearly
        degenerate with it; the fit is unharmed, the single values mean little.

    Returns
    -------
    MapFit
        The model, what is left, and the status of the fit.

    Raises
    ------
    DomainError
        On wrong shapes, values that are not finite, or fewer measurements than unknowns.
    ConfigError
        On an unknown name in ``free``.
    """
    vector = checked_vectors(direction, 3, "direction")
    pixel = checked_vectors(pixel_px, 2, "pixel_px")
    size = len(model.parameters)
    names = (*model.parameter_names, *TURN_NAMES)
    chosen = (*(model.parameter_names if free is None else free), *(TURN_NAMES if turn else ()))
    if len(vector) != len(pixel) or 2 * len(pixel) < len(chosen):
        raise DomainError(f"{len(vector)} directions and {len(pixel)} pixels for {len(chosen)} unknowns")

    def residuals(state: FloatArray) -> FloatArray:
        in_model = vector @ Rotation.from_rotvec(state[size:]).as_matrix().T
        return np.asarray(model.with_parameters(state[:size]).project(in_model, band) - pixel).ravel()

    def jacobian(state: FloatArray) -> FloatArray:
        in_model = vector @ Rotation.from_rotvec(state[size:]).as_matrix().T
        at = model.with_parameters(state[:size]).project_jacobian(in_model, band)
        by_turn = np.cross(in_model[:, None, :], at.by_direction) @ right_jacobian(-state[size:])
        return np.concatenate([at.by_parameter, by_turn], axis=2).reshape(2 * len(vector), size + 3)

    start = np.concatenate([model.parameters, np.zeros(3)])
    problem = DenseProblem(residuals, jacobian, names, start, free=chosen)
    fit = solve(problem, start, tolerance=1e-8, max_iterations=200)
    fitted = model.with_parameters(fit.state[:size])
    rotation = Rotation.from_rotvec(fit.state[size:])
    at = fitted.project(vector @ rotation.as_matrix().T, band)
    return MapFit(
        model=fitted,
        rotation=rotation,
        residual_px=at - pixel,
        line_of_sight=line_of_sight_map(
            fitted, vector / np.linalg.norm(vector, axis=1, keepdims=True), pixel, band=band
        ),
        solution=replace(fit.solution, independent=0),  # no noise was stated
    )


class Mapped(Protocol):
    """A camera that knows where it puts stars, such as `render.sensor.StarSensor`."""

    def pixel_map(self) -> PixelMap:
        """Directions and pixels."""


def camera_model(camera: Mapped | PixelMap) -> CameraModel:
    """Camera model of a camera, equal to a calibration without noise (`fit_camera`).

    Parameters
    ----------
    camera : StarSensor or PixelMap
        The camera, or where it puts stars.

    Returns
    -------
    CameraModel
        Pixels to directions and back.
    """
    return fit_camera(camera).camera


def fit_camera(camera: Mapped | PixelMap, *, good_px: float = GOOD_PX) -> MapFit:
    """Simplest distortion model that fits a lens: Brown-Conrady, polynomials of degree 5 and 7.

    Parameters
    ----------
    camera : StarSensor or PixelMap
        The camera, or where it puts stars.
    good_px : float
        A model that is nowhere farther off than this is good enough.

    Returns
    -------
    MapFit
        The best of the models if none is good enough. ``fit_camera(...).camera`` is the camera model for star
        identification and attitudes.
    """
    pixel_map = camera if isinstance(camera, PixelMap) else camera.pixel_map()
    geometry = SensorGeometry(
        width_px=pixel_map.width_px, height_px=pixel_map.height_px, pixel_pitch_mm=pixel_map.pixel_pitch_mm
    )
    models: list[CameraModel] = [
        BrownConrady.create(geometry, focal_length_mm=pixel_map.focal_length_mm),
        *(Polynomial.create(geometry, focal_length_mm=pixel_map.focal_length_mm, degree=degree) for degree in (5, 7)),
    ]
    fits: list[MapFit] = []
    for model in models:
        fits.append(fit_to_map(model, pixel_map.direction, pixel_map.pixel_px))
        if fits[-1].max_px < good_px:
            break
    return min(fits, key=lambda fit: fit.max_px)


def as_brown_conrady(camera: CameraModel) -> BrownConrady:
    """Brown-Conrady camera with the map of another model on a grid, of the same attitude."""
    if isinstance(camera, BrownConrady):
        return camera
    pixel = camera.geometry.grid_px(15)
    ray = camera.unproject(pixel)
    ideal = ray[:, :2] / ray[:, 2:]
    focal_px = float(np.linalg.norm(pixel[-1] - pixel[0]) / np.linalg.norm(ideal[-1] - ideal[0]))
    start = BrownConrady.create(camera.geometry, focal_length_mm=focal_px * camera.geometry.pixel_pitch_mm)
    fitted = fit_to_map(start, ray, pixel, turn=False).model
    assert isinstance(fitted, BrownConrady)
    return fitted
