"""Stars on the detector.

`field_of_view` determines the field of a camera once, `field_of` selects the stars of an attitude with their apparent
directions along icrs; `render.sky.sky.Sky.star_field` adds their light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import constants
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.rays.paraxial import axial_paraxial
from optics.records import freeze, freeze_all
from optics.stellar_aberration import aberrated
from render.camera import Camera
from render.catalogue.index import SkyIndex
from render.catalogue.motion import Observer, directions_at
from render.catalogue.record import StarCatalog

_DEGREE = 9
_GRID = 14
_CHECKS = 11
_WIDENINGS = 4
_LIGHT_KM_PER_S = constants.c / 1e3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FieldOfView:
    """Field of a camera, without its attitude; made by `field_of_view`, once per camera."""

    # width_px, height_px: Size of the detector
    width_px: int
    height_px: int
    margin_px: float  # Strip around it in which stars still count
    half_width: FloatArray  # (2,) Largest |X/Z| and |Y/Z| in cam of what it sees, margin included
    # (d, d, 2) Of powers of X/Z and Y/Z over ``half_width``: column and row of the chief ray at the design wavelength
    coefficient: FloatArray
    # Largest distance of the polynomial from chief rays of a grid other than the one it was made from
    residual_px: float

    def __post_init__(self) -> None:
        freeze_all(self, half_width=(2,), coefficient=("d", "d", 2))

    @property
    def radius_rad(self) -> float:
        """Half angle of the cone about +Z of cam that holds all of it."""
        return math.atan(math.hypot(*self.half_width))

    def inside(self, v_cam: FloatArray, slack_rad: float = 0.0) -> NDArray[np.bool_]:
        """Whether directions (n, 3) in cam, slack added on all sides, can fall on the detector or its margin."""
        v = np.asarray(v_cam, np.float64)
        wide = np.tan(np.minimum(np.arctan(self.half_width) + slack_rad, 1.57)) * (1.0 + 1e-12)
        z = v[:, 2]
        return np.asarray((z > 0.0) & (np.abs(v[:, 0]) <= wide[0] * z) & (np.abs(v[:, 1]) <= wide[1] * z))

    def pixel_of(self, v_cam: FloatArray) -> FloatArray:
        """Column and row (n, 2) of directions (n, 3) in cam; NaN where not `inside`: no extrapolation."""
        v = np.asarray(v_cam, np.float64)
        inside = self.inside(v)
        pixel = np.full((len(v), 2), np.nan)
        x, y, z = v[inside].T
        pixel[inside] = _polynomial(x / z / self.half_width[0], y / z / self.half_width[1], self.coefficient)
        return pixel

    def on_detector(self, pixel_px: FloatArray, margin_px: float | None = None) -> NDArray[np.bool_]:
        """Whether pixels (n, 2) lie on the detector or a margin around it, by default the view's own."""
        x, y = pixel_px.T
        low = -0.5 - (self.margin_px if margin_px is None else margin_px)
        return (x >= low) & (y >= low) & (x <= self.width_px - 1 - low) & (y <= self.height_px - 1 - low)


def _polynomial(x: FloatArray, y: FloatArray, coefficient: FloatArray) -> FloatArray:
    """Values (n, 2) of a polynomial in two variables of total degree d - 1, by Horner's rule.

    Not a matrix product: on a machine that is busy, the threads of BLAS take longer to meet than this takes.
    """
    top = len(coefficient) - 1
    out = np.empty((len(x), 2))
    for axis in range(2):
        total = np.zeros_like(x)
        for i in range(top, -1, -1):
            row = np.full_like(y, coefficient[i, top - i, axis])
            for j in range(top - i - 1, -1, -1):
                row *= y
                row += coefficient[i, j, axis]
            total *= x
            total += row
        out[:, axis] = total
    return out


def _fitted(pixel: FloatArray) -> FloatArray:
    """Coefficients (d, d, 2) of the polynomial of total degree `_DEGREE` through pixels (n, n, 2) at Chebyshev's nodes.

    Least squares there is a sum over the nodes, as Chebyshev's polynomials are orthogonal on them.
    """
    grid, count = len(pixel), _DEGREE + 1
    basis = np.polynomial.chebyshev.chebvander(_nodes(), _DEGREE)
    weight = np.where(np.arange(count) > 0, 2.0, 1.0) / grid
    chebyshev = np.einsum("ki,lj,klp,i,j->ijp", basis, basis, pixel, weight, weight)
    chebyshev[np.add.outer(np.arange(count), np.arange(count)) > _DEGREE] = 0.0
    power = np.zeros((count, count))
    for i in range(count):
        power[i, : i + 1] = np.polynomial.chebyshev.cheb2poly([0.0] * i + [1.0])
    return np.asarray(np.einsum("ia,jb,ijp->abp", power, power, chebyshev))


def _nodes() -> FloatArray:
    return np.asarray(np.cos(np.pi * (np.arange(_GRID) + 0.5) / _GRID))


def field_of_view(camera: Camera, *, margin_px: float = 16.0) -> FieldOfView:
    """Field of a camera (whose attitude plays no part) from chief rays through its lens, distortion and all.

    A polynomial of degree 9 stands for the chief ray at the design wavelength. Stars in a strip of ``margin_px``, the
    size of the spots, around the detector count too, so that light of stars outside it is included. `ConvergenceError`
    where its corner lies outside what the lens can image.
    """
    if not (margin_px >= 0.0 and math.isfinite(margin_px)):
        raise DomainError(f"margin_px = {margin_px}; it must be finite and not negative")
    lens = camera.focused_lens
    focal = abs(axial_paraxial(lens, lens.design_wavelength_nm).efl_mm)
    size = np.array([camera.width_px, camera.height_px])
    wanted = np.maximum(np.abs(-0.5 - margin_px - camera.centre_px), np.abs(size - 0.5 + margin_px - camera.centre_px))
    half = wanted * camera.pixel_pitch_mm / focal
    for _ in range(_WIDENINGS):  # until the edge of the grid images to the edge of the margin or beyond
        x, y = np.array([half[0], 0.0, half[0]]), np.array([0.0, half[1], half[1]])
        edge = np.abs(camera.chief_px(x, y) - camera.centre_px)
        short = wanted / [edge[[0, 2], 0].min(), edge[[1, 2], 1].min()]
        if short.max() <= 1.0:
            break
        half = half * np.maximum(short * 1.001, 1.0)
    coefficient = _fitted(_grid_px(camera, half, _nodes()))
    check = np.linspace(-1.0, 1.0, _CHECKS)
    at_x, at_y = (axis.ravel() for axis in np.meshgrid(check, check, indexing="ij"))
    residual = _polynomial(at_x, at_y, coefficient) - _grid_px(camera, half, check).reshape(-1, 2)
    return FieldOfView(
        width_px=camera.width_px,
        height_px=camera.height_px,
        margin_px=float(margin_px),
        half_width=half,
        coefficient=coefficient,
        residual_px=float(np.hypot(*residual.T).max()),
    )


def _grid_px(camera: Camera, half: FloatArray, nodes: FloatArray) -> FloatArray:
    """Pixels (n, n, 2) of chief rays on a grid of X/Z and Y/Z, in units of ``half``."""
    x, y = np.meshgrid(half[0] * nodes, half[1] * nodes, indexing="ij")
    return camera.chief_px(x.ravel(), y.ravel()).reshape(len(nodes), len(nodes), 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkyField:
    """The catalogue stars of one exposure."""

    stars: StarCatalog  # Their rows, at the epoch of the catalogue
    row: NDArray[np.int64]  # (m,) Where they stand in the whole catalogue
    # (m, 3) Where they are seen, unit vectors along icrs: moved to the epoch of the exposure, parallax and aberration
    # included if an observer was given
    direction: FloatArray
    # (m, 2) Column and row of the chief ray at the design wavelength, by the polynomial of the field of view
    pixel_px: FloatArray
    rotation_cam_from_icrs: FloatArray  # (3, 3) Attitude

    def __post_init__(self) -> None:
        sizes = {"m": len(self.stars)}
        freeze(self, "row", shape=("m",), dtype=np.int64, sizes=sizes)
        freeze_all(self, direction=("m", 3), pixel_px=("m", 2), rotation_cam_from_icrs=(3, 3), sizes=sizes)

    def __len__(self) -> int:
        return len(self.row)


def field_of(
    index: SkyIndex,
    view: FieldOfView,
    attitude: Rotation,
    *,
    magnitude_limit: float | None = None,
    epoch_year: float | None = None,
    observer: Observer | None = None,
    velocity_km_per_s: ArrayLike | None = None,
) -> SkyField:
    """Stars that fall on the detector or the margin around it; the attitude is cam from icrs.

    Stars without a magnitude are left out below a limit. The epoch is a Julian year, that of the catalogue if left out;
    an observer adds parallax and aberration (`render.catalogue.motion.earth_observer`). A velocity (3,) along icrs
    takes the place of the observer's; without an observer it adds aberration alone.
    """
    if not isinstance(attitude, Rotation) or not attitude.single:
        raise ConfigError("attitude must be one scipy Rotation, cam from icrs")
    matrix = attitude.as_matrix()
    epoch = index.catalog.epoch_year if epoch_year is None else float(epoch_year)
    velocity = np.zeros(3) if observer is None else observer.velocity_km_per_s
    if velocity_km_per_s is not None:
        velocity = np.asarray(velocity_km_per_s, np.float64)
        observer = None if observer is None else replace(observer, velocity_km_per_s=velocity)
    speed = float(np.linalg.norm(velocity))
    distance_au = 0.0 if observer is None else float(np.linalg.norm(observer.position_au))
    # what may move in from outside; twice, for second orders
    slack = 2.0 * (
        abs(epoch - index.catalog.epoch_year) * index.fastest_rad_per_year
        + speed / _LIGHT_KM_PER_S
        + distance_au * index.nearest_rad
    )
    boresight = matrix[2] / math.sqrt(float(matrix[2] @ matrix[2]))
    rows = index.within(boresight, min(view.radius_rad + slack, math.pi), magnitude_limit=magnitude_limit)
    rows = rows[view.inside(_turned(index.catalog.direction[rows], matrix), slack)]
    stars = index.catalog.select(rows)
    direction = directions_at(stars, epoch, observer)
    if observer is None and speed:
        direction = aberrated(direction, velocity)
    pixel = view.pixel_of(_turned(direction, matrix))
    on_detector = view.on_detector(pixel)
    return SkyField(
        stars=stars if on_detector.all() else stars.select(on_detector),
        row=rows[on_detector],
        direction=direction[on_detector],
        pixel_px=pixel[on_detector],
        rotation_cam_from_icrs=matrix,
    )


def _turned(direction: FloatArray, matrix: FloatArray) -> FloatArray:
    """``matrix @ v`` of directions (n, 3)."""
    return np.asarray(np.einsum("ij,kj->ik", direction, matrix))
