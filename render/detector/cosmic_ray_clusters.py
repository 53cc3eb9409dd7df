"""Groups of neighbouring pixels that hold the charge of cosmic rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from render.detector.cosmic_rays import CosmicRayHits

LEAST_E = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChargeCluster:
    """Pixels that touch, by a side or a corner."""

    x_px: float  # Centroid of the charge (column, row)
    y_px: float
    box_px: tuple[int, int, int, int]  # First column, first row, columns, rows
    pixels: NDArray[np.int64]  # (2, n) Rows and columns
    charge_e: float


def charge_clusters(hits: CosmicRayHits, least_e: float = LEAST_E) -> list[ChargeCluster]:
    """Clusters of pixels with at least ``least_e`` electrons, in the order of reading."""
    charge = np.zeros(hits.shape)
    charge[hits.row, hits.column] = hits.charge_e
    group, count = ndimage.label(charge >= least_e, structure=np.ones((3, 3)))
    numbers = np.arange(1, count + 1)
    total = np.atleast_1d(ndimage.sum_labels(charge, group, numbers))
    centroids = ndimage.center_of_mass(charge, group, numbers)
    boxes = ndimage.find_objects(group)
    clusters = []
    for number, (rows, columns), (y, x), electrons in zip(numbers, boxes, centroids, total, strict=True):
        inside = np.stack(np.nonzero(group[rows, columns] == number))
        clusters.append(
            ChargeCluster(
                x_px=float(x),
                y_px=float(y),
                box_px=(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start),
                pixels=inside + np.array([[rows.start], [columns.start]]),
                charge_e=float(electrons),
            )
        )
    return clusters
