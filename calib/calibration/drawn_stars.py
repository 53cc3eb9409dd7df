"""Stars of a random sky in the frames of a camera: noise-free positions to study a calibration with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from optics.arrays import FloatArray, IntArray
from optics.records import freeze_all

SPARE = 3.0
"""Where n stars per frame are wanted, the sky holds this many times n, plus 20; the brightest are taken."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnStars:
    """Noise-free stars in frames."""

    pixel_px: FloatArray  # (n, 2) Where they fall
    direction: FloatArray  # (n, 3) Unit vectors, icrs
    frame: IntArray  # (n,) Frame of each
    star: IntArray  # (n,) Number in the sky

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, pixel_px=("n", 2), direction=("n", 3), sizes=sizes)
        freeze_all(self, frame=("n",), star=("n",), sizes=sizes, dtype=np.int64)

    def __len__(self) -> int:
        return len(self.frame)


def draw_stars(
    camera: CameraModel, attitude: Rotation, rng: np.random.Generator, *, mean: float | None = None, exactly: int = 0
) -> DrawnStars:
    """A uniform random sky as a camera with ``focal_length_mm`` sees it in f attitudes, cam from icrs.

    The brightest stars of the sky, ``mean`` per frame on average; without it the ``exactly`` brightest of every frame.
    """
    geometry = camera.geometry
    dense = SPARE * (exactly if mean is None else mean) + 20.0
    pitch, focal = geometry.pixel_pitch_mm, camera.value("focal_length_mm")
    half = 0.5 * pitch * np.array([geometry.width_px, geometry.height_px]) / focal
    cap = np.cos(1.05 * np.arctan(np.hypot(*half)) + 0.01)
    count = rng.poisson(dense * 4.0 * np.pi / _solid_angle(*half))
    z, angle = rng.uniform(-1.0, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    ring = np.sqrt(1.0 - z * z)
    sky_direction = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
    views: list[tuple[FloatArray, IntArray]] = []  # stars are numbered in the order of their brightness
    for matrix in attitude.as_matrix():
        near = np.flatnonzero(sky_direction @ matrix[2] > cap)
        pixel = camera.project(sky_direction[near] @ matrix.T)
        inside = geometry.contains(pixel)
        chosen = slice(exactly) if mean is None else slice(None)
        views.append((pixel[inside][chosen], near[inside][chosen]))
    pixel, star = (np.concatenate([part[i] for part in views]) for i in (0, 1))
    frame = np.repeat(np.arange(len(views)), [len(part[1]) for part in views])
    if mean is not None:
        faintest = np.sort(star)[min(round(mean * len(views)), len(star) - 1)]
        bright = star < faintest
        pixel, star, frame = pixel[bright], star[bright], frame[bright]
    return DrawnStars(pixel_px=pixel, direction=sky_direction[star], frame=frame, star=star)


def _solid_angle(half_x: float, half_y: float) -> float:
    """Of a rectilinear field with these half widths in units of the focal length [sr]."""
    return float(4.0 * np.arctan(half_x * half_y / np.sqrt(1.0 + half_x**2 + half_y**2)))
