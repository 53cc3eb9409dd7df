"""Catalogue stars on the detector in many attitudes at once, without rendering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.records import freeze_all
from render.catalogue.index import SkyIndex
from render.sky.field import FieldOfView


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkySample:
    """m sightings of stars in f attitudes, attitude after attitude."""

    frames: int  # f
    frame: NDArray[np.int64]  # (m,) Which attitude
    row: NDArray[np.int64]  # (m,) Which star of the catalogue
    direction: FloatArray  # (m, 3) Unit vectors in cam
    pixel_px: FloatArray  # (m, 2) Column and row of the chief ray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, frame=("m",), row=("m",), dtype=np.int64, sizes=sizes)
        freeze_all(self, direction=("m", 3), pixel_px=("m", 2), sizes=sizes)

    def summed(self, values: FloatArray) -> FloatArray:
        """Sum of values (m,) over the stars of each attitude, (f,)."""
        return np.asarray(np.bincount(self.frame, values, self.frames), np.float64)


def sample_sky(index: SkyIndex, view: FieldOfView, attitudes: Rotation) -> SkySample:
    """Stars on the detector (without its margin) in each attitude, at the epoch of the catalogue."""
    if attitudes.single:
        raise ConfigError(
            "sample_sky: one Rotation of several attitudes is needed, such as Rotation.from_matrix([...])"
        )
    matrix = attitudes.as_matrix()
    boresight = matrix[:, 2] / np.linalg.norm(matrix[:, 2], axis=1, keepdims=True)
    chord = 2.0 * np.sin(min(view.radius_rad, np.pi) / 2.0)
    neighbours = index.tree.query_ball_point(boresight, chord, return_sorted=True)
    count = np.array([len(rows) for rows in neighbours], np.int64)
    row = np.concatenate([np.asarray(rows, np.int64) for rows in neighbours]) if count.sum() else np.empty(0, np.int64)
    frame = np.repeat(np.arange(len(matrix)), count)
    direction = np.empty((len(row), 3))
    sky = index.catalog.direction[row]
    for axis in range(3):  # three columns at a time: no (m, 3, 3) array
        direction[:, axis] = (matrix[frame, axis] * sky).sum(1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    pixel = view.pixel_of(direction)
    size = np.array([view.width_px, view.height_px])
    on_detector = ((pixel > -0.5) & (pixel < size - 0.5)).all(axis=1)  # NaN fails
    return SkySample(
        frames=len(matrix),
        frame=frame[on_detector],
        row=row[on_detector],
        direction=direction[on_detector],
        pixel_px=pixel[on_detector],
    )
