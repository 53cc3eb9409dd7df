"""The camera model: its order by leave-one-frame-out cross-validation, the zenith, and refraction towards it.

Every frame is predicted from the others: the camera is calibrated without it, only its attitude is then fitted, and the
squared residuals over their variances measure the accuracy of the camera. The simplest model within one standard error
of the best (paired by frames) is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import erfa
import numpy as np
from astropy.time import Time
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.attitude.solve import solve_wahba
from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras import BrownConrady, Polynomial
from calib.cameras.base import CameraModel
from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD, RAD_DEG

PINHOLE = ("x0_px", "y0_px", "focal_length_mm")
ORDERS: dict[str, tuple[str, ...] | int | None] = {
    "pinhole": PINHOLE,
    "radial_1": (*PINHOLE, "q1_per_mm2"),
    "radial_2": (*PINHOLE, "q1_per_mm2", "q2_per_mm4"),
    "brown_conrady": None,
    "polynomial_3": 3,
}
"""Models by name, the simplest first: free parameters of Brown-Conrady (None: all), or the degree of a polynomial."""
LOWEST_COSINE = 0.17
"""Below 10 deg of altitude refraction is no longer proportional to tan z."""
CLIP_SIGMA = 4.5
FEWEST_POINTINGS = 4


def calibrated(stars: Observations, camera: CameraModel, order: str) -> Calibration:
    """Camera of an order from all stars, attitudes free, wrong matches down-weighted."""
    start, free = _start(camera, order)
    return calibrate(stars, start, FreeAttitudes(), loss="tukey", free=free)


def _start(camera: CameraModel, order: str) -> tuple[CameraModel, tuple[str, ...] | None]:
    kind = ORDERS[order]
    focal = camera.value("focal_length_mm") if "focal_length_mm" in camera.parameter_names else float("nan")
    if isinstance(kind, int):
        return Polynomial.create(camera.geometry, degree=kind, focal_length_mm=focal), None
    return BrownConrady.create(camera.geometry, focal_length_mm=focal), kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """One model, each frame predicted from the others."""

    name: str
    parameters: int
    chi2: FloatArray  # (frames,) Squared residual over variance, per degree of freedom
    residual_px: float  # RMS per axis of the predicted frames, outliers left out

    @property
    def mean(self) -> float:
        """Mean chi-square over the frames."""
        return float(np.nanmean(self.chi2))


def cross_validated(stars: Observations, camera: CameraModel, order: str) -> Order:
    """Leave-one-frame-out cross-validation of one model."""
    chi2 = np.full(stars.frames, np.nan)
    squares, count, free = 0.0, 0, 0
    for frame in np.unique(stars.frame):
        mine = stars.frame == frame
        made = calibrated(stars.select(~mine), camera, order)
        free = int((np.diag(made.covariance) > 0).sum())
        if not made.converged:
            continue
        residual, kept = predicted_residuals(stars.select(mine), made.model)
        variance = stars.covariance_px2[mine][:, [0, 1], [0, 1]]
        chi2[frame] = float((residual[kept] ** 2 / variance[kept]).sum() / max(2 * kept.sum() - 3, 1))
        squares, count = squares + float((residual[kept] ** 2).sum()), count + 2 * int(kept.sum())
    return Order(name=order, parameters=free, chi2=chi2, residual_px=float(np.sqrt(squares / max(count, 1))))


def predicted_residuals(stars: Observations, camera: CameraModel) -> tuple[FloatArray, BoolArray]:
    """Residuals (n, 2) [px] of one frame with a given camera and its own attitude, and which are no outliers (n,)."""
    kept = np.ones(len(stars), bool)
    v_cam = camera.unproject(stars.pixel_px)
    sigma = np.sqrt(np.trace(stars.covariance_px2, axis1=1, axis2=2) / 2.0)
    direction = np.array(stars.direction)
    residual = np.zeros((len(stars), 2))
    for _ in range(6):
        turn = solve_wahba(v_cam[kept], direction[kept], sigma_rad=sigma[kept] * 1e-4).rotation
        residual = stars.pixel_px - camera.project(turn.apply(direction))
        pull = np.linalg.norm(residual, axis=1) / sigma
        good = pull < CLIP_SIGMA * max(1.0, float(np.median(pull[kept])) / 1.1774)
        if np.array_equal(good, kept) or good.sum() < 4:
            break
        kept = good
    return residual, kept


def chosen_order(orders: Sequence[Order]) -> Order:
    """The simplest model whose predictions are within one standard error of the best ones (paired by frames)."""
    known = [one for one in orders if np.isfinite(one.chi2).sum() >= 2]
    if not known:
        raise DomainError("no camera model converges; frames of one camera with one focus are needed")
    best = min(known, key=lambda one: one.mean)
    for one in known:
        worse = one.chi2 - best.chi2
        worse = worse[np.isfinite(worse)]
        error = worse.std(ddof=1) / np.sqrt(len(worse)) if len(worse) > 1 else 0.0
        if worse.mean() <= error:
            return one
    return best


@dataclass(frozen=True, slots=True, kw_only=True)
class Zenith:
    """The zenith, by a stated site or by the altitudes stated in the frames."""

    direction: FloatArray  # (frames, 3) In icrs
    latitude_deg: float
    longitude_deg: float
    error_deg: float  # Standard deviation of each; 0 where stated
    offset_deg: float = 0.0  # True altitude less the stated one
    scatter_deg: float = 0.0  # About it


def earth_rotation(taken: datetime) -> FloatArray:
    """Terrestrial from celestial axes (3, 3), UTC taken for UT1 (0.9 s, 14 arcsec)."""
    when = Time(taken.replace(tzinfo=None), scale="utc")
    return np.asarray(erfa.c2t06a(when.tt.jd1, when.tt.jd2, when.utc.jd1, when.utc.jd2, 0.0, 0.0))


def zenith_of(latitude_deg: float, longitude_deg: float, taken: Sequence[datetime]) -> FloatArray:
    """Directions (n, 3) of the zenith in icrs at some times."""
    latitude, longitude = np.radians([latitude_deg, longitude_deg])
    local = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    return np.stack([earth_rotation(one).T @ local for one in taken])


def fit_zenith(boresight: FloatArray, altitude_deg: FloatArray, taken: Sequence[datetime]) -> Zenith | None:
    """Site whose altitudes of the boresights (n, 3) are the stated ones, a common offset apart; None if too few.

    The offset stands for an axis that is not the boresight and for refraction.
    """
    if len(boresight) < FEWEST_POINTINGS:
        return None
    terrestrial = np.stack([earth_rotation(when) @ one for when, one in zip(taken, boresight, strict=True)])

    def misfit(p: FloatArray) -> FloatArray:
        up = np.array([np.cos(p[0]) * np.cos(p[1]), np.cos(p[0]) * np.sin(p[1]), np.sin(p[0])])
        return np.asarray(np.arcsin(np.clip(terrestrial @ up, -1, 1)) * RAD_DEG - altitude_deg - p[2])

    middle = terrestrial.mean(0) / np.linalg.norm(terrestrial.mean(0))
    start = [np.arcsin(middle[2]), np.arctan2(middle[1], middle[0]), 0.0]
    found = least_squares(misfit, start, x_scale=[0.01, 0.01, 1.0])
    freedom = len(boresight) - 3
    scatter = float(np.sqrt(2.0 * found.cost / freedom))
    try:
        covariance = np.linalg.inv(found.jac.T @ found.jac) * scatter**2
    except np.linalg.LinAlgError:
        return None
    if scatter > 1.0 or not covariance[0, 0] < 0.05**2:  # altitudes of another mount, or all pointings along one line
        return None
    latitude, longitude = np.degrees(found.x[:2])
    longitude = (longitude + 180.0) % 360.0 - 180.0
    return Zenith(
        direction=zenith_of(latitude, longitude, taken),
        latitude_deg=float(latitude),
        longitude_deg=float(longitude),
        error_deg=float(np.degrees(np.sqrt(covariance[0, 0]))),
        offset_deg=float(found.x[2]),
        scatter_deg=scatter,
    )


def refracted(direction: FloatArray, zenith: FloatArray, arcsec: float) -> FloatArray:
    """Directions (n, 3) lifted towards the zenith (3,) by ``arcsec`` times tan z; below 10 deg of altitude as there."""
    cosine = direction @ zenith
    low = np.maximum(cosine, LOWEST_COSINE)
    lift = arcsec * ARCSEC_RAD * np.sqrt(1.0 - np.minimum(low, 1.0) ** 2) / low
    up = zenith - cosine[:, None] * direction
    up /= np.maximum(np.linalg.norm(up, axis=1), 1e-12)[:, None]
    lifted = direction + lift[:, None] * up
    return np.asarray(lifted / np.linalg.norm(lifted, axis=1)[:, None])


def airmass(direction: FloatArray, zenith: FloatArray) -> FloatArray:
    """Air mass of directions (n, 3): Kasten and Young, Applied Optics 28, 4735 (1989)."""
    altitude = np.degrees(np.arcsin(np.clip(direction @ zenith, 0.0, 1.0)))
    return np.asarray(1.0 / (np.sin(np.radians(altitude)) + 0.50572 * (altitude + 6.07995) ** -1.6364))


def fit_refraction(at: Sequence[float], chi2: Sequence[float], freedom: int) -> tuple[float, float]:
    """Amplitude [arcsec] of the least chi-square through three amplitudes, and its standard deviation.

    The variance is scaled by what is left, so that chi-square per degree of freedom is 1 at the minimum.
    """
    a, b, c = np.polyfit(np.asarray(at, float), np.asarray(chi2, float), 2)
    if a <= 0:
        return float("nan"), float("nan")
    least = c - b * b / (4.0 * a)
    return float(-b / (2.0 * a)), float(np.sqrt(max(least, 0.0) / freedom / a))


def attitudes_of(made: Calibration) -> Rotation:
    """Attitudes of a calibration that has them."""
    if made.attitude is None:
        raise DomainError(f"no camera model fits the frames: {made.solution.message}")
    return made.attitude
