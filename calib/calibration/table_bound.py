"""Cramer-Rao bound of the joint calibration on a turntable from first principles, for any estimator.

Independent of the estimator in `calib.calibration.turntable`: the readings' noise is propagated to the images and the
information summed there, with separate derivatives of the table and of the star (`calib.calibration.star_bench`). Only
the camera's derivatives are shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.star_bench import StarBench, design_matrix, reading_covariance_px2, unknown_names
from calib.cameras.base import CameraModel
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from optics.arrays import FloatArray
from optics.errors import DomainError

WORST_CONDITION = 1e14


@dataclass(frozen=True, slots=True, kw_only=True)
class TableBound:
    """The bound at one truth."""

    # Unknowns as `calib.calibration.turntable` names them: camera parameters, star, installation, leans
    names: tuple[str, ...]
    covariance: FloatArray  # (q, q) Of the unknowns; rows of camera parameters that are held are zero
    known_sigma: FloatArray  # (q,) Standard deviations if all other unknowns were known
    condition: float  # Of the information matrix scaled to a unit diagonal
    map_sigma_arcsec: float  # RMS length of the line-of-sight error over the map, after the best rotation
    line_of_sight: LineOfSightMap  # At the truth

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (q,)."""
        return np.sqrt(np.diagonal(self.covariance))

    def of(self, name: str) -> float:
        """Standard deviation of one unknown."""
        return float(self.sigma[self.names.index(name)])

    def inflation(self, name: str) -> float:
        """Inflation of an unknown's standard deviation by the other unknowns."""
        return self.of(name) / float(self.known_sigma[self.names.index(name)])


def table_bound(
    model: CameraModel,
    bench: StarBench,
    angle_rad: FloatArray,
    covariance_px2: FloatArray,
    map_direction: FloatArray,
    *,
    leans: bool,
    star: bool = True,
    free: Sequence[str] | None = None,
) -> TableBound:
    """Smallest covariance of all unknowns together, at the true camera and bench.

    Shapes: ``angle_rad`` (n, k) of the table; ``covariance_px2`` (n, 2, 2) of the images, readings of the table
    included (`reading_covariance_px2`); ``map_direction`` (m, 3), where in cam the line of sight is judged. ``leans``,
    ``star``: whether the non-orthogonality of the axes and the direction of the star are unknown; ``free``: unknown
    parameters of the camera, by default all. `DomainError` on positions that do not determine the unknowns.
    """
    columns = design_matrix(model, bench, angle_rad, leans=leans)
    names = unknown_names(model, bench, leans=leans)
    fixed = set() if free is None else set(model.parameter_names) - set(free)
    use = np.array([i for i, name in enumerate(names) if name not in fixed and (star or not name.startswith("star"))])
    if 2 * len(columns) < len(use):
        raise DomainError(
            f"{len(columns)} places give {2 * len(columns)} measurements for {len(use)} unknowns; more are needed"
        )
    rows = columns[:, :, use]
    information = np.einsum("nia,nij,njb->ab", rows, np.linalg.inv(covariance_px2), rows)
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    condition = float(np.linalg.cond(scaled))
    if not condition < WORST_CONDITION:
        raise DomainError(
            f"the positions do not determine the unknowns (condition number {condition:.1e}); cover more of the "
            f"detector, or fix parameters"
        )
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_(use, use)] = np.linalg.inv(scaled) * np.outer(scale, scale)
    known_sigma = np.zeros(len(names))
    known_sigma[use] = scale
    count = len(model.parameter_names)
    line_of_sight = line_of_sight_map(
        model, map_direction, model.project(map_direction), covariance=covariance[:count, :count]
    )
    return TableBound(
        names=names,
        covariance=covariance,
        known_sigma=known_sigma,
        condition=condition,
        map_sigma_arcsec=line_of_sight.predicted_rms_arcsec,
        line_of_sight=line_of_sight,
    )


def map_error_by_noise(
    model: CameraModel,
    bench: StarBench,
    angle_rad: FloatArray,
    centroid_px2: FloatArray,
    map_direction: FloatArray,
) -> dict[str, float]:
    """Contribution of each cause of noise to the map error, leans unknown [arcsec, RMS length]; squares add up.

    The best estimator weighs all noise together, theta = (J^T W J)^-1 J^T W y; each cause is carried through it.
    """
    errors = {}
    parts = {"centroids": centroid_px2}
    for i, name in enumerate(bench.table.axis_names):
        only = np.where(np.arange(len(bench.table.axis)) == i, bench.table.reading_noise_arcsec, 0.0)
        quiet = replace(bench, table=replace(bench.table, reading_noise_arcsec=only))
        parts[f"readings, {name} axis"] = reading_covariance_px2(model, quiet, angle_rad)
    total = sum(parts.values(), np.zeros_like(centroid_px2))
    rows = design_matrix(model, bench, angle_rad, leans=True)
    weighted = np.linalg.inv(total) @ rows
    information = np.einsum("nia,nib->ab", rows, weighted)
    scale = 1.0 / np.sqrt(np.diagonal(information))
    inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    count = len(model.parameter_names)
    pixel = model.project(map_direction)
    for name, part in parts.items():
        covariance = inverse @ np.einsum("nia,nij,njb->ab", weighted, part, weighted) @ inverse
        line = line_of_sight_map(model, map_direction, pixel, covariance=covariance[:count, :count])
        errors[name] = float(line.predicted_rms_arcsec)
    return errors
