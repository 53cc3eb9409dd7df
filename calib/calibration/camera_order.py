"""Order of a camera model by leave-one-frame-out cross-validation, and the error beyond the noise of centroids.

Every frame is predicted from the others: the camera is calibrated without it, only its attitude is then fitted, and the
squared residuals over their variances measure the accuracy of the camera. The simplest model within one standard error
of the best (paired by frames) is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.frame_attitudes import camera_residuals, predicted_residuals
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras import BrownConrady, Polynomial
from calib.cameras.base import CameraModel
from optics.arrays import FloatArray
from optics.errors import DomainError

PINHOLE = ("x0_px", "y0_px", "focal_length_mm")
ORDERS: dict[str, tuple[str, ...] | int | None] = {
    "pinhole": PINHOLE,
    "radial_1": (*PINHOLE, "q1_per_mm2"),
    "radial_2": (*PINHOLE, "q1_per_mm2", "q2_per_mm4"),
    "brown_conrady": None,
    "polynomial_3": 3,
}
"""Models by name, the simplest first: free parameters of Brown-Conrady (None: all), or the degree of a polynomial."""
FLOORS_PX, FLOOR_ROUNDS = np.geomspace(2e-3, 0.3, 60), 3


def calibrate_order(stars: Observations, camera: CameraModel, order: str) -> Calibration:
    """Camera of an order (a name in `ORDERS`) from all stars: attitudes free, wrong matches down-weighted."""
    kind = ORDERS[order]
    focal = camera.value("focal_length_mm") if "focal_length_mm" in camera.parameter_names else float("nan")
    start: CameraModel = BrownConrady.create(camera.geometry, focal_length_mm=focal)
    if isinstance(kind, int):
        start, kind = Polynomial.create(camera.geometry, degree=kind, focal_length_mm=focal), None
    return calibrate(stars, start, FreeAttitudes(), loss="tukey", free=kind)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderValidation:
    """A camera model whose predictions of each frame from the others were tested."""

    order: str
    parameters: int
    chi2: FloatArray  # (frames,) Squared residual over variance, per degree of freedom; NaN where nothing converged
    residual_px: float  # RMS per axis of the predicted frames, outliers left out

    @property
    def mean_chi2(self) -> float:
        """Mean over the frames."""
        return float(np.nanmean(self.chi2))


def cross_validate(stars: Observations, camera: CameraModel, order: str) -> OrderValidation:
    """Leave-one-frame-out cross-validation of a model."""
    chi2 = np.full(stars.frames, np.nan)
    squares, count, free = 0.0, 0, 0
    for frame in np.unique(stars.frame):
        predicted = stars.frame == frame
        calibration = calibrate_order(stars.select(~predicted), camera, order)
        free = int((np.diag(calibration.covariance) > 0).sum())
        if not calibration.converged:
            continue
        residual, used = predicted_residuals(stars.select(predicted), calibration.model)
        variance = stars.covariance_px2[predicted][:, [0, 1], [0, 1]]
        chi2[frame] = float((residual[used] ** 2 / variance[used]).sum() / max(2 * used.sum() - 3, 1))
        squares, count = squares + float((residual[used] ** 2).sum()), count + 2 * int(used.sum())
    residual_px = float(np.sqrt(squares / max(count, 1)))
    return OrderValidation(order=order, parameters=free, chi2=chi2, residual_px=residual_px)


def simplest_adequate(models: Sequence[OrderValidation]) -> OrderValidation:
    """The first model whose predictions are within one standard error of the best ones (paired by frames).

    `DomainError` if no model converges in two frames.
    """
    converged = [model for model in models if np.isfinite(model.chi2).sum() >= 2]
    if not converged:
        raise DomainError("no camera model converges; frames of one camera with one focus are needed")
    best = min(converged, key=lambda model: model.mean_chi2)
    for model in converged:
        worse = model.chi2 - best.chi2
        worse = worse[np.isfinite(worse)]
        error = worse.std(ddof=1) / np.sqrt(len(worse)) if len(worse) > 1 else 0.0
        if worse.mean() <= error:
            return model
    return best


def calibrate_with_floor(
    stars: Observations, camera: CameraModel, order: str, *, start_px: float
) -> tuple[Calibration, float]:
    """Calibration with the error per axis, in addition to the centroids' covariances, that the residuals show [px].

    With it the median of the squared residuals is that of a chi-square of two degrees of freedom, ``2 ln 2``.
    """
    centroid_variance = np.trace(stars.covariance_px2, axis1=1, axis2=2) / 2.0

    def calibrated(floor_px: float) -> Calibration:
        covariance = stars.covariance_px2 + floor_px**2 * np.eye(2)
        return calibrate_order(replace(stars, covariance_px2=covariance), camera, order)

    floor, calibration = start_px, calibrated(start_px)
    for _ in range(FLOOR_ROUNDS):
        if calibration.attitude is None:
            raise DomainError(f"no camera model fits the frames: {calibration.solution.message}")
        size2 = (camera_residuals(stars, calibration.model, calibration.attitude) ** 2).sum(axis=1) / 2.0
        typical = [np.median(size2 / (centroid_variance + sigma**2)) / np.log(2.0) for sigma in FLOORS_PX]
        floor = float(np.interp(0.0, 1.0 - np.array(typical), FLOORS_PX))
        calibration = calibrated(floor)
    return calibration, floor


def as_calibrated(camera: CameraModel, order: str, *, focal_length_mm: float) -> CameraModel:
    """Camera model of an order that noiseless stars on a grid behind a known camera would give."""
    pixel = camera.geometry.grid_px(15)
    stars = Observations.isotropic(
        pixel_px=pixel,
        direction=camera.unproject(pixel),
        frame=np.zeros(len(pixel), np.int64),
        sigma_px=0.01,
        star=np.arange(len(pixel)),
    )
    start = BrownConrady.create(camera.geometry, focal_length_mm=focal_length_mm)
    return calibrate_order(stars, start, order).model
