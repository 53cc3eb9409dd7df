"""Calibration of a camera from stars of many frames: one function for every family of attitudes.

    found = calibrate(observations, model, FreeAttitudes())

The unknowns are the free parameters of the camera and the unknowns of the family (`calib.calibration.attitude_family`);
the fit is weighted least squares on the measured positions (or angles), with the loss rho of
`calib.fitting.robust_loss`,

    minimise  sum over stars of rho(|W (project(camera, R r) - measured)|^2) + prior residuals of the family,

by `calib.fitting.least_squares`. Checks before: `selection`; stages: `stages`; judgement after: `verdict`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.attitude_family import AttitudeFamily, FamilyFit
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.selection import Selection, select_stars
from calib.calibration.stages import free_mask, free_names
from calib.cameras.base import CameraModel
from calib.fitting.robust_loss import Loss, get_loss
from calib.fitting.solution import Solution
from optics.arrays import BoolArray, FloatArray

LEAST_COVERAGE = 8  # of the 16 parts of the detector that hold stars, below which the message says so
FOLD_GRID = 9  # pixels along each side of the detector at which a fitted camera is inverted


def calibrate(
    observations: Observations,
    model: CameraModel,
    attitude_family: AttitudeFamily,
    *,
    two_step: bool = True,
    loss: str | Loss = "linear",
    free: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate a camera from identified stars.

    Parameters
    ----------
    observations : Observations
        Measured stars.
    model : CameraModel
        Start of the camera; parameters that are held keep their value.
    attitude_family : AttitudeFamily
        What is assumed of the attitudes: `FreeAttitudes`, `AttitudeCorrelated`, `GyroLinked`, `NoAttitude` or
        `TurntableAttitudes`.
    two_step : bool
        Fit without distortion first, then all (ACF17, sec. 2.2).
    loss : str or Loss
        Robust loss; "tukey" rejects wrong matches.
    free : sequence of str, optional
        Camera parameters to fit; all by default. The unknowns of the family are always fitted.

    Returns
    -------
    Calibration
        ``solution`` holds the free camera parameters and the common unknowns of the family; its covariance is marginal
        over the unknowns of the frames.

    Raises
    ------
    DomainError
        If the star list is in another pixel convention, or the family's data do not match the frames.
    ConfigError
        On an unknown parameter or loss.

    Examples
    --------
    Five pixels seen from two attitudes determine the focal length:

    >>> from scipy.spatial.transform import Rotation
    >>> from calib.calibration.free_attitudes import FreeAttitudes
    >>> from calib.cameras import BrownConrady, SensorGeometry
    >>> sensor = SensorGeometry(width_px=101, height_px=101, pixel_pitch_mm=0.01)
    >>> camera = BrownConrady.create(sensor, focal_length_mm=5.0)
    >>> pixel = np.tile([[10, 10], [90, 10], [10, 90], [90, 90], [50, 20]], (2, 1))
    >>> frame = np.repeat([0, 1], 5)
    >>> attitude = Rotation.from_rotvec([[0, 0, 0.0], [0, 0.1, 0]])[frame]
    >>> direction = attitude.inv().apply(camera.unproject(pixel))
    >>> stars = Observations.isotropic(pixel_px=pixel, direction=direction, frame=frame, sigma_px=0.1)
    >>> start = BrownConrady.create(sensor, focal_length_mm=4.0)
    >>> found = calibrate(stars, start, FreeAttitudes(), free=("focal_length_mm",))
    >>> found.solution.status, round(found.model.value("focal_length_mm"), 6)
    ('converged', 5.0)
    """
    chosen, mask = get_loss(loss), free_mask(model, free)
    attitude_family.check(observations)
    selection = select_stars(observations, model, attitude_family.least_stars)
    stars = selection.stars
    # frames with too few stars are no part of the fit, but get the attitude of the start
    shown = observations if attitude_family.least_stars > 1 else stars
    start = attitude_family.start(shown, model, robust=chosen.name != "linear")
    names = free_names(model, mask) + attitude_family.names(stars)
    independent = attitude_family.independent(stars)
    if independent > len(names):
        obstacle = attitude_family.obstacle(stars, model)
    else:
        obstacle = f"{len(stars)} star positions give {independent} independent measurements for {len(names)} unknowns"
    if obstacle:
        outcome = _not_begun(start, names, obstacle, len(stars), independent - len(names))
    else:
        outcome = attitude_family.fit(stars, model, mask, start, two_step=two_step, loss=chosen)
    return _calibration(attitude_family, outcome, selection, model, mask)


def _not_begun(start: Any, names: tuple[str, ...], message: str, stars: int, degrees_of_freedom: int) -> FamilyFit:
    """Outcome of a fit that was not begun: no values, infinite variances."""
    solution = Solution(
        value=np.full(len(names), np.nan),
        names=names,
        covariance=np.diag(np.full(len(names), np.inf)),
        status="refused",
        message=message,
        iterations=0,
        chi2=float("inf"),
        degrees_of_freedom=degrees_of_freedom,
        condition=float("inf"),
        residual_pulls=np.full(2 * stars, np.nan),
        robust_weight=np.ones(stars),
    )
    return FamilyFit(state=start, solution=solution, kept=np.ones(stars, dtype=np.bool_))


def _calibration(
    family: AttitudeFamily, outcome: FamilyFit, selection: Selection, model: CameraModel, mask: BoolArray
) -> Calibration:
    """Record of an outcome."""
    solution, count = outcome.solution, int(mask.sum())
    stars = selection.stars if outcome.kept.all() else selection.stars.select(outcome.kept)
    status, notes = solution.status, [solution.message, selection.note]
    camera = model
    if np.isfinite(solution.value).all():
        parameters = np.array(model.parameters)
        parameters[mask] = solution.value[:count]
        camera = model.with_parameters(parameters)
        notes.append(_coverage(stars, model))
    if not _upright(camera):
        status = "refused"
        notes.insert(0, "the fitted camera is mirrored: one axis of the star positions is flipped")
    elif _folded(camera, stars):
        status = "refused"
        notes.insert(
            0, "the fitted camera folds its image among the stars: a false minimum; start nearer to the camera"
        )
    covariance = np.zeros((len(mask), len(mask)))
    covariance[np.ix_(mask, mask)] = solution.covariance[:count, :count]
    used = selection.used.copy()
    used[used] = outcome.kept
    attitude, installation = family.attitudes(outcome.state, stars, camera)
    return Calibration(
        method=family.method,
        model=camera,
        covariance=covariance,
        solution=replace(solution, status=status, message="; ".join(note for note in notes if note)),
        attitude=Rotation.from_matrix(attitude),
        installation=installation,
        used=used,
    )


def _upright(camera: CameraModel) -> bool:
    """Whether +X and +Y of cam lead to larger columns and rows without a reflection, at the boresight."""
    by_direction: FloatArray = camera.project_jacobian(np.array([[0.0, 0.0, 1.0]])).by_direction[0]
    return bool(np.linalg.det(by_direction[:, :2]) > 0)


def _folded(camera: CameraModel, stars: Observations) -> bool:
    """Whether pixels between the stars have no direction: the image turns back on itself there."""
    pixel = camera.geometry.grid_px(FOLD_GRID)
    low, high = stars.pixel_px.min(axis=0, initial=np.inf), stars.pixel_px.max(axis=0, initial=-np.inf)
    return not np.isfinite(camera.unproject(pixel[np.all((pixel >= low) & (pixel <= high), axis=1)])).all()


def _coverage(stars: Observations, model: CameraModel) -> str:
    """A warning where the stars leave most of the detector empty."""
    size = np.array([model.geometry.width_px, model.geometry.height_px])
    cell = np.clip(np.floor((stars.pixel_px + 0.5) / size * 4.0), 0, 3).astype(np.int64)
    occupied = len(np.unique(cell[:, 0] * 4 + cell[:, 1]))
    if occupied >= LEAST_COVERAGE:
        return ""
    return f"stars reach only {occupied} of 16 parts of the detector, the calibration is extrapolated over the rest"
