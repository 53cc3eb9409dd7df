"""Joint calibration of poses: from images and readings to the camera, the star, the installation and the table's axes.

Inputs are the data of a laboratory: images with their covariance, readings with their noise, the assumed axes of the
table, poor start values (FISHER23, S100). The estimator is `calib.calibration.turntable`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.calibrate import calibrate
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.star_bench import StarBench, design_star_last, star_last, star_vector_by_pixel
from calib.calibration.table_axes import TableAxes
from calib.calibration.turntable import TableErrors, TurntableAttitudes, star_direction
from calib.cameras.base import CameraModel
from calib.directional.vector_scatter import VectorScatter, scatter_of_other_data
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD, RAD_ARCSEC

READING_FLOOR_ARCSEC = 1e-4
"""Readings better than this count as exact."""
AHEAD = np.array([0.0, 0.0, 1.0])
LARGEST_REDUCED_CHI2 = 25.0
"""Residuals of five times their noise on average: no confident answer."""
POSE_UNKNOWNS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseData:
    """Images of the star and readings of the table at n poses."""

    pixel_px: FloatArray  # (n, 2) Mean images
    covariance_px2: FloatArray  # (n, 2, 2) Of the centroids alone
    reading_rad: FloatArray  # (n, k) Readings of the table

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "pixel_px", shape=("n", 2), sizes=sizes, finite=False)
        freeze(self, "covariance_px2", shape=("n", 2, 2), sizes=sizes, finite=False)
        freeze(self, "reading_rad", shape=("n", "k"), sizes=sizes)

    def scattered(self, normal: FloatArray) -> PoseData:
        """The same with noise of the covariance on the images, from independent standard normal deviates (n, 2)."""
        root = np.linalg.cholesky(self.covariance_px2)
        return replace(self, pixel_px=self.pixel_px + np.einsum("nij,nj->ni", root, normal))


def calibrate_on_table(
    data: PoseData,
    table: TableAxes,
    start: CameraModel,
    *,
    leans: bool,
    start_star: FloatArray | None = None,
) -> Calibration:
    """Joint calibration (S100 of FISHER23).

    ``leans``: whether the non-orthogonality of the axes is unknown; ``start_star`` (3,): start of the direction of the
    star in the laboratory, by default +Z.
    """
    count = len(data.pixel_px)
    observations = Observations(
        pixel_px=data.pixel_px,
        covariance_px2=data.covariance_px2,
        direction=np.tile(AHEAD if start_star is None else start_star, (count, 1)),
        frame=np.arange(count),
        frames=count,
    )
    sigma = table.reading_noise_arcsec * ARCSEC_RAD
    noisy = table.reading_noise_arcsec > READING_FLOOR_ARCSEC
    errors = TableErrors(reading_rate=table.angle_rates(data.reading_rad)[:, noisy], reading_sigma_rad=sigma[noisy])
    if leans:
        names = tuple(f"lean{i + 1}_rad" for i in range(len(table.axis) - 1))
        errors = replace(errors, axis_rate=table.lean_rates(data.reading_rad), axis_names=names, axis_sigma_rad=None)
    family = TurntableAttitudes(table_rotation=table.rotation(data.reading_rad), errors=errors)
    return calibrate(observations, start, family)


def calibrated_bench(calibration: Calibration, table: TableAxes) -> StarBench:
    """The bench as a calibration knows it."""
    solution = calibration.solution
    leans = [float(v) for n, v in zip(solution.names, solution.value, strict=True) if n.startswith("lean")]
    if leans:
        lean = table.non_orthogonality_arcsec + np.array(leans) * RAD_ARCSEC
        table = replace(table, non_orthogonality_arcsec=lean)
    assert calibration.installation is not None
    return StarBench(table=table, star=star_direction(calibration), installation=calibration.installation)


def predicted_scatter(
    calibration: Calibration, bench: StarBench, angle_rad: FloatArray, noise_px2: FloatArray
) -> VectorScatter:
    """Expected scatter of the star vectors of other poses, evaluated with a calibration with unknown leans.

    ``bench`` is the calibration as a bench (`calibrated_bench`). Shapes: ``angle_rad`` (n, k), ``noise_px2`` (n, 2, 2)
    covariance of the images, with what readings of the table add.
    """
    model, solution = calibration.model, calibration.solution
    order = star_last(solution.names)
    return scatter_of_other_data(
        star_vector_by_pixel(model, bench, angle_rad),
        noise_px2,
        design_star_last(model, bench, angle_rad),
        solution.covariance[np.ix_(order, order)],
    )


def check_count(places: int, table: TableAxes, *, advice: str = "raise grid.columns or grid.rows") -> None:
    """Refuse fewer measurements than unknowns, before anything is rendered; ``advice`` says what to do."""
    unknowns = 8 + POSE_UNKNOWNS + len(table.axis) - 1
    if 2 * places <= unknowns:
        raise DomainError(
            f"{places} places give {2 * places} measurements for {unknowns} unknowns (8 of the camera, 2 of the star, "
            f"3 of the installation, {len(table.axis) - 1} of the axes); {advice}"
        )


def check_parity(
    data: PoseData, table: TableAxes, start: CameraModel, start_star: FloatArray, *, key: str = "reduction.axes"
) -> None:
    """Refuse axes that turn opposite to the assumption; ``key`` is its setting.

    The affine map from where the believed table puts the star to where it was seen keeps its orientation, with any
    camera at any roll, as long as the axes are right: a camera cannot mirror.
    """
    on_table = table.rotation(data.reading_rad).inv().apply(start_star)
    middle = on_table.mean(0) / np.linalg.norm(on_table.mean(0))
    across = np.linalg.svd(middle[None])[2][1:]
    across[1] *= np.sign(np.linalg.det(np.vstack([across, middle])))
    forward = on_table @ middle
    if np.any(forward <= 0):
        raise DomainError(
            f"with the assumed axes ({key}) the star would be behind the camera at some readings; check order and "
            f"signs of the axes"
        )
    design = np.column_stack([on_table @ across.T / forward[:, None], np.ones(len(on_table))])
    affine = np.linalg.lstsq(design, data.pixel_px, rcond=None)[0][:2]
    scale = start.value("focal_length_mm") / start.geometry.pixel_pitch_mm
    if np.linalg.det(affine) / scale**2 < 0:
        raise DomainError(
            "the images are mirrored against the readings: a single axis of the table has the wrong sign, or two "
            f"axes are exchanged; put a minus before a letter of {key}, or exchange its letters"
        )


def check_fit(calibration: Calibration, what: str, advice: str) -> None:
    """Refuse a calibration that did not converge or whose residuals are far above their noise."""
    solution = calibration.solution
    if not (solution.status in ("converged", "refuted") and solution.reduced_chi2 <= LARGEST_REDUCED_CHI2):
        raise DomainError(
            f"{what}: the calibration ended as {solution.status!r} with residuals of "
            f"{np.sqrt(solution.reduced_chi2):.3g} times their noise; {advice}"
        )
