"""The camera that images the screen of the bench: projection of screen points, in float64 and for Mitsuba.

A 1:1 lens: on the optical axis one detector pixel covers one pixel pitch of the screen (CUBE09's budget takes its 15 um
pixel as 15 um on the screen, eq. 13). The camera stands off the beam, on the side of the cube, and views the screen
obliquely; the homography between screen and pixels is exact and known, as from a calibration target.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, locked
from render.engine import Engine


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchCamera:
    """A pinhole camera."""

    width_px: int
    height_px: int
    pitch_mm: float  # Pixel pitch, and its image on the screen at the centre of the field
    distance_mm: float  # From the middle of the screen
    angle_deg: float  # Between the optical axis and the normal of the screen; the camera stands towards +X
    # (2,) Point (x, y) of the screen that the optical axis meets. The aim moves with a yielding mount
    aim_mm: FloatArray

    def __post_init__(self) -> None:
        freeze(self, "aim_mm", shape=(2,))
        for name, low, high in (("width_px", 16, 8192), ("height_px", 16, 8192), ("angle_deg", 0, 60)):
            if not low <= getattr(self, name) <= high:
                raise DomainError(f"BenchCamera.{name} = {getattr(self, name):g}; it must be {low} to {high}")
        for name in ("pitch_mm", "distance_mm"):
            if not 0.0 < getattr(self, name) < 1e5:
                raise DomainError(f"BenchCamera.{name} = {getattr(self, name):g} mm; it must be above 0 and below 1e5")

    @property
    def position_mm(self) -> FloatArray:
        """Entrance pupil in the laboratory (3,)."""
        angle = np.radians(self.angle_deg)
        return self.distance_mm * np.array([np.sin(angle), 0.0, -np.cos(angle)])

    @property
    def axes(self) -> FloatArray:
        """Rows: right (columns increase), down (rows increase), forward, in the laboratory (3, 3)."""
        forward = np.append(self.aim_mm, 0.0) - self.position_mm
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward])

    @property
    def homography(self) -> FloatArray:
        """Matrix (3, 3): (x, y, 1) on the screen [mm] -> (column, row, 1) times depth."""
        size = (self.width_px, self.height_px)
        return _homography(*size, self.pitch_mm, self.distance_mm, self.angle_deg, *self.aim_mm.tolist())

    def _matrix(self) -> FloatArray:
        focal = self.distance_mm / self.pitch_mm
        inner = np.array(
            [[focal, 0, (self.width_px - 1) / 2], [0, focal, (self.height_px - 1) / 2], [0, 0, 1]], dtype=float
        )
        on_screen = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 0]]) - np.outer(self.position_mm, [0, 0, 1.0])
        return inner @ self.axes @ on_screen

    def to_pixel(self, screen_mm: ArrayLike) -> FloatArray:
        """Pixels (n, 2) of points (n, 2) of the screen [mm]."""
        return _projected(self.homography, screen_mm)

    def to_screen(self, pixel_px: ArrayLike) -> FloatArray:
        """Points (n, 2) of the screen [mm] of pixels (n, 2)."""
        return _projected(np.linalg.inv(self.homography), pixel_px)

    def sensor(self) -> Any:
        """The same camera as Mitsuba's ``perspective``."""
        mi = Engine.active().mitsuba
        up = -self.axes[1]
        target = self.position_mm + self.axes[2] * self.distance_mm
        pose = mi.ScalarTransform4f().look_at(origin=self.position_mm, target=target, up=up)
        width = self.width_px * self.pitch_mm
        film = {"type": "hdrfilm", "width": self.width_px, "height": self.height_px, "pixel_format": "luminance"}
        film["rfilter"] = {"type": "box"}
        return mi.load_dict(
            {
                "type": "perspective",
                "to_world": pose,
                "fov": float(2 * np.degrees(np.arctan(width / 2 / self.distance_mm))),
                "fov_axis": "x",
                "near_clip": 1.0,
                "far_clip": 1e5,
                "film": film,
            }
        )


@lru_cache(maxsize=64)
def _homography(
    width_px: int, height_px: int, pitch_mm: float, distance_mm: float, angle_deg: float, x_mm: float, y_mm: float
) -> FloatArray:
    camera = BenchCamera(
        width_px=width_px,
        height_px=height_px,
        pitch_mm=pitch_mm,
        distance_mm=distance_mm,
        angle_deg=angle_deg,
        aim_mm=np.array([x_mm, y_mm]),
    )
    return locked(camera._matrix())


def _projected(matrix: NDArray[Any], points: ArrayLike) -> FloatArray:
    """Homography of points, element by element: small matrix products of many points are slow on busy machines."""
    x, y = np.asarray(points, np.float64).T
    column, row, depth = (h[0] * x + h[1] * y + h[2] for h in np.asarray(matrix, np.float64))
    return np.column_stack([column / depth, row / depth])
