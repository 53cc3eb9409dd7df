r"""Paraxial rays through the rows of a lens file: stop size, fields, and a comparison with the values stated in the
file.

Heights and :math:`\nu = n u` as in `optics.rays.paraxial`, which starts from the finished lens. Indices are those of
the catalogues, relative to air; mirrors reverse the sign of the index; coordinate breaks are skipped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.files.parsed_file import SurfaceRow
from optics.forbes import bfs_from_q, bfs_sum
from optics.glass.absolute_index import CATALOGUE_AIR, Environment
from optics.glass.catalogue import Glass


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """Focal length, back focus (from the last surface along the light), and the image of the stop.

    ``stop_height`` is the height in the stop of a parallel ray of height 1; ``pupil_mm`` the distance of the entrance
    pupil from the first surface; ``image_mm`` the distance of the image plane from the last surface along the light.
    """

    efl_mm: float
    bfl_mm: float
    stop_height: float
    pupil_mm: float
    image_mm: float


def _power(row: SurfaceRow, before: float, after: float) -> float:
    shape = row.shape
    if shape["kind"] == "paraxial":
        return 1.0 / float(shape["focal_length_mm"])
    radius = float(shape.get("radius_mm", shape.get("radius_y_mm", math.inf)))
    curvature = 1.0 / radius
    if shape["kind"] == "odd_asphere" and len(shape["terms"]) > 1:
        curvature += 2.0 * shape["terms"][1]
    elif shape["kind"] == "toroid" and shape["terms"]:
        curvature += 2.0 * shape["terms"][0]
    elif shape["kind"] == "qbfs":
        curvature += 2.0 * float(bfs_sum(bfs_from_q(shape["q_mm"]), 0.0)[0]) / shape["norm_radius_mm"] ** 2
    return (after - before) * curvature


def _index(glass: Glass, wavelength_nm: float, environment: Environment) -> float:
    """Index relative to the air around the lens; that of the catalogue for a glass without thermal data."""
    elsewhere = environment.temperature_c != glass.reference_temperature_c
    if environment == CATALOGUE_AIR or (elsewhere and glass.dndt is None):
        return float(glass.dispersion.index(wavelength_nm))
    celsius, pressure_hpa = environment.temperature_c, environment.pressure_hpa
    return float(glass.relative_index(wavelength_nm, temperature_c=celsius, pressure_hpa=pressure_hpa))


@np.errstate(all="ignore")
def first_order(
    rows: Sequence[SurfaceRow],
    glasses: Sequence[Glass | None],
    wavelength_nm: float,
    environment: Environment = CATALOGUE_AIR,
) -> FirstOrder:
    """First-order data of the rows of a file."""
    matrix: FloatArray = np.eye(2)
    n, side, stop_at = 1.0, 1.0, np.eye(2)
    distance = 0.0
    for row, glass in zip(rows, glasses, strict=True):
        if not row.is_break:
            index = side * (1.0 if glass is None else _index(glass, wavelength_nm, environment))
            if row.mirror:
                side, index = -side, -n
            refraction = np.array([[1.0, 0.0], [-_power(row, n, index), 1.0]])
            if row.stop:
                stop_at = matrix
            matrix, n = refraction @ matrix, index
            distance = 0.0
        # towards the last surface only: the gap to the image comes after the focus is known
        transfer = np.array([[1.0, row.thickness_mm / n], [0.0, 1.0]])
        distance += row.thickness_mm
        matrix = transfer @ matrix
    last = np.array([[1.0, -distance / n], [0.0, 1.0]]) @ matrix
    (a, _), (c, _) = last
    efl, bfl = (float(np.divide(x, c)) for x in (-1.0, -a))
    pupil = float(np.divide(stop_at[0, 1], stop_at[0, 0]))
    return FirstOrder(efl, bfl * abs(n), float(stop_at[0, 0]), pupil, distance * side)
