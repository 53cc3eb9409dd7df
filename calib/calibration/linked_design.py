"""Expected errors of a calibration with frames linked by a gyro, from the design alone, without stars or adjustments.

Linear model of star j in frame k, all perturbations small and to the left (cam from reference):

    d pixel = B_j dp + A_j d_k,        d_k = S_k u + T_k e_k

with the camera parameters p, the frame's attitude error d_k [rad], u = (first attitude, installation) and the gyro's
accumulated error e_k in the first body frame. From eq. 6 of ACF17, with M_k = C G_k C^T the camera's rotation since the
first frame, S_k = [M_k, I - M_k] and T_k = -M_k C. Stars have noise sigma per axis; e has the covariance of a bias (a
size per axis, sign unknown) and an angle random walk:

    E[e_k e_l^T] = bias^2 P_k P_l^T + walk^2 min(t_k, t_l) I,       P_k = integral of G^T dt from the first frame to k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from calib.fitting.rotation_vectors import skew
from optics.arrays import FloatArray, IntArray
from optics.records import freeze, freeze_all


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkedDesign:
    """Derivatives at the truth."""

    by_model: FloatArray  # (n, 2, p) Of a star's pixel position by the camera's parameters
    by_attitude: FloatArray  # (n, 2, 3) By the attitude of its frame, a rotation vector in cam [px/rad]
    frame: IntArray  # (n,) Frame of each star
    link: FloatArray  # (f, 3, 6) S_k: attitude of a frame by that of the first and by the installation
    drift: FloatArray  # (f, 3, 3) T_k: attitude of a frame by the gyro's accumulated error

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, by_model=("n", 2, "p"), by_attitude=("n", 2, 3), sizes=sizes)
        freeze(self, "frame", shape=("n",), dtype=np.int64, sizes=sizes)
        freeze_all(self, link=("f", 3, 6), drift=("f", 3, 3), sizes=sizes)

    @classmethod
    def at(
        cls, model: CameraModel, attitude: Rotation, installation: Rotation, direction: FloatArray, frame: IntArray
    ) -> LinkedDesign:
        """Design of stars seen by a camera."""
        matrix = attitude.as_matrix()
        direction_cam = np.einsum("nij,nj->ni", matrix[frame], direction)
        jacobian = model.project_jacobian(direction_cam)
        turn = -skew(direction_cam)  # v + d x v
        moved = matrix @ matrix[0].T
        return cls(
            by_model=jacobian.by_parameter,
            by_attitude=jacobian.by_direction @ turn,
            frame=frame,
            link=np.concatenate([moved, np.eye(3) - moved], axis=2),
            drift=-moved @ installation.as_matrix(),
        )

    def select(self, mask: NDArray[np.bool_]) -> LinkedDesign:
        """The same with some of the stars."""
        return replace(self, by_model=self.by_model[mask], by_attitude=self.by_attitude[mask], frame=self.frame[mask])

    @property
    def frames(self) -> int:
        """Number of frames, with or without stars."""
        return len(self.link)

    def by_unknown(self) -> FloatArray:
        """(2 n, p + 6): by camera parameters, first attitude, installation."""
        by_link = self.by_attitude @ self.link[self.frame]
        return np.concatenate([self.by_model, by_link], axis=2).reshape(-1, self.by_model.shape[2] + 6)

    def least_information(self) -> float:
        """Smallest over largest eigenvalue of the scaled normal matrix; 0 for fewer measurements than unknowns."""
        columns = self.by_unknown()
        if len(columns) < columns.shape[1]:
            return 0.0
        scaled = columns / np.maximum(np.sqrt((columns**2).sum(0)), 1e-300)
        size = np.linalg.svd(scaled, compute_uv=False) ** 2
        return float(size[-1] / size[0])

    def by_drift(self) -> FloatArray:
        """(2 n, 3): by the gyro's accumulated error of the star's frame."""
        return (self.by_attitude @ self.drift[self.frame]).reshape(-1, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroDrift:
    """Accumulated error of a gyro at the frames: e = steady s + walk w [rad]."""

    steady: FloatArray  # (3 f, 3) By the signs s (each +1 or -1) of the three axes' bias
    walk: FloatArray  # (3 f, m) By independent unit normal increments w of the angle random walk

    def __post_init__(self) -> None:
        freeze_all(self, steady=("n", 3), walk=("n", "m"))

    @classmethod
    def of(
        cls, time_s: FloatArray, swept: FloatArray, *, bias_rad_per_s: float, walk_rad_per_sqrt_s: float
    ) -> GyroDrift:
        """Error at frames."""
        step = np.sqrt(np.diff(time_s))
        reached = np.tril(np.ones((len(time_s), len(step))), -1) * step
        return cls(
            steady=bias_rad_per_s * swept.reshape(-1, 3),
            walk=np.asarray(walk_rad_per_sqrt_s * np.kron(reached, np.eye(3)), float),
        )

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3 f, 3 f) [rad^2]."""
        return np.asarray(self.steady @ self.steady.T + self.walk @ self.walk.T)


def correlated_covariance(design: LinkedDesign, sigma_px: float, gyro: GyroDrift | None = None) -> FloatArray:
    """Covariance (p + 6, p + 6) of ACC (eq. 11), which takes the gyro as perfect."""
    normal, scale = _scaled_normal(design)
    inverse = np.linalg.inv(normal)
    covariance = sigma_px**2 * inverse
    if gyro is not None:
        gain = inverse @ (_per_frame_drift(design) / scale[:, None])
        covariance = covariance + gain @ gyro.covariance @ gain.T
    return np.asarray(covariance / np.outer(scale, scale))


def linked_bound(design: LinkedDesign, sigma_px: float, gyro: GyroDrift) -> FloatArray:
    """Cramer-Rao bound (p + 6, p + 6) with a gyro of that covariance, weighted by its noise.

    Between `correlated_covariance` (perfect gyro) and `free_bound` (useless gyro).
    """
    normal, scale = _scaled_normal(design)
    drift = _per_frame_drift(design) / scale[:, None]
    drift_rows = _drift(design)
    inner = (drift_rows.T @ drift_rows).toarray()
    # sum over the gyro's errors as a prior, without inverting its singular covariance (the first frame has no error)
    prior = gyro.covariance
    carried = prior @ np.linalg.solve(sigma_px**2 * np.eye(len(prior)) + inner @ prior, drift.T)
    reduced = normal - drift @ carried
    return np.asarray(sigma_px**2 * np.linalg.inv(reduced) / np.outer(scale, scale))


def free_bound(design: LinkedDesign, sigma_px: float) -> FloatArray:
    """Cramer-Rao bound (p, p) of the camera parameters when every frame has an attitude of its own."""
    count = design.by_model.shape[2]
    flat = design.by_model.reshape(-1, count)
    scale = np.sqrt((flat**2).sum(0))
    normal = (flat / scale).T @ (flat / scale)
    for rows in _frame_rows(design):
        camera = design.by_model[rows].reshape(-1, count) / scale
        attitude = design.by_attitude[rows].reshape(-1, 3)
        # a frame of one star leaves one direction of its attitude open: the pseudo-inverse takes what there is
        basis, size, _ = np.linalg.svd(attitude, full_matrices=False)
        basis = basis[:, size > 1e-9 * size[0]]
        by_attitude = basis.T @ camera
        normal -= by_attitude.T @ by_attitude
    return np.asarray(sigma_px**2 * np.linalg.inv(normal) / np.outer(scale, scale))


@dataclass(frozen=True, slots=True, kw_only=True)
class Reprojection:
    """Expected error of noise-free stars reprojected with a calibration."""

    axis_px: FloatArray  # (2,) Root of the mean square, x and y
    total_px: float  # The same of the length
    # Expected value of one run's RMS length, which is what the document averages: the root's curvature is in it, to
    # second order in the scatter of the mean square
    mean_px: float
    scatter_px: float  # Standard deviation of one run's RMS length

    def __post_init__(self) -> None:
        freeze(self, "axis_px", shape=(2,))


def reprojection(
    used: LinkedDesign, judged: LinkedDesign, sigma_px: float, gyro: GyroDrift | None = None
) -> Reprojection:
    """Reprojection error of ACC on other frames, where the gyro's error counts a second time.

    For a perfect gyro and frames alike this is sigma sqrt(14 / n): the 14 unknowns share the information of n stars.
    """
    return reprojections(used, judged, [sigma_px], gyro)[0]


def reprojections(
    used: LinkedDesign, judged: LinkedDesign, sigmas_px: Sequence[float], gyro: GyroDrift | None = None
) -> list[Reprojection]:
    """As `reprojection`, for several noises of the same stars."""
    normal, scale = _scaled_normal(used)
    ahead = judged.by_unknown() / scale
    parts = [ahead @ np.linalg.cholesky(np.linalg.inv(normal))]
    if gyro is not None:
        drift = _drift(judged).toarray() - ahead @ np.linalg.solve(normal, _per_frame_drift(used) / scale[:, None])
        parts += [drift @ gyro.walk, drift @ gyro.steady]
    sources = np.concatenate(parts, axis=1)
    stars, unknowns, signs = len(judged.frame), len(scale), 0 if gyro is None else 3
    by_axis = np.stack([(sources[axis::2] ** 2).sum(0) for axis in range(2)]) / stars
    gram = sources.T @ sources / stars
    results = []
    for sigma in sigmas_px:
        size = np.where(np.arange(len(gram)) < unknowns, sigma, 1.0)
        axis_px2 = by_axis @ size**2
        # of a square form: 2 tr(M^2) for normal sources; a sign always has the square 1, its diagonal does not scatter
        fixed = float((np.diag(gram)[len(gram) - signs :] ** 2).sum())
        variance = 2.0 * (float(((gram * np.outer(size, size)) ** 2).sum()) - fixed)
        mean_square = float(axis_px2.sum())
        total = float(np.sqrt(mean_square))
        results.append(
            Reprojection(
                axis_px=np.sqrt(axis_px2),
                total_px=total,
                mean_px=total * (1.0 - variance / (8.0 * mean_square**2)),
                scatter_px=float(np.sqrt(variance)) / (2.0 * total),
            )
        )
    return results


def stars_of_reprojection(
    used: LinkedDesign, judged: LinkedDesign, sigma_px: float, gyro: GyroDrift, mean_square_px2: float
) -> tuple[float, float]:
    """Number of stars at which the reprojection error has a given mean square, over that of the designs.

    The stars' part of the mean square is proportional to 1 / n, the gyro's does not depend on n: infinite where the
    gyro alone gives more. Also the mean square by the gyro alone [px^2].
    """
    stars_px2 = reprojection(used, judged, sigma_px).total_px ** 2
    gyro_px2 = reprojection(used, judged, sigma_px, gyro).total_px ** 2 - stars_px2
    room_px2 = mean_square_px2 - gyro_px2
    return stars_px2 / room_px2 if room_px2 > 0 else float("inf"), max(gyro_px2, 0.0)


def _scaled_normal(design: LinkedDesign) -> tuple[FloatArray, FloatArray]:
    """Normal matrix of all unknowns with columns of length one, and the lengths."""
    columns = design.by_unknown()
    scale = np.sqrt((columns**2).sum(0))
    columns = columns / scale
    return columns.T @ columns, scale


def _frame_rows(design: LinkedDesign) -> list[IntArray]:
    """Stars of each frame that has any."""
    order = np.argsort(design.frame, kind="stable")
    edges = np.flatnonzero(np.diff(design.frame[order])) + 1
    return np.split(order, edges)


def _drift(design: LinkedDesign) -> Any:
    """(2 n, 3 f), sparse: shifts of the stars by the gyro's errors, each by that of its frame."""
    rows = design.by_drift()
    column = 3 * np.repeat(design.frame, 2)[:, None] + np.arange(3)
    row = np.broadcast_to(np.arange(len(rows))[:, None], column.shape)
    return csr_array((rows.ravel(), (row.ravel(), column.ravel())), shape=(len(rows), 3 * design.frames))


def _per_frame_drift(design: LinkedDesign) -> FloatArray:
    """(p + 6, 3 f): unknowns against the gyro's errors, summed over stars."""
    return np.asarray((_drift(design).T @ design.by_unknown()).T)
