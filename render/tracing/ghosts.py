"""Ghosts as images: the enumerated paths of two reflections (`optics.rays.ghosts`), each rendered where it lands.

Coarse rays at angles on both sides of a source's angle, traced once per camera, select its visible paths; these are
traced at the mean wavelength of each band. A path's rays, each a Gaussian as wide as the spacing of rays (and at least
as wide as charge diffusion), form its image. Over the disk of an extended source the position of every ray is linear in
the direction, its light is that of the centre. The response of the camera counts ghost light as reflection loss, so
that it is added to the image of a star.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.frames import light_direction
from optics.rays.entrance_pupil import entrance_pupil
from optics.rays.ghosts import SHARP_MM, GhostPath, entering_rays, entrance_radius_mm, front_rays, ghost_pairs
from optics.rays.pupil_sampling import gauss_disk
from optics.rays.trace import OK, Rays
from optics.records import freeze
from render.camera import Camera, PathLosses
from render.records import StarField, Truth

ANGLES, ORDER = (0.1, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 16.0), (6, 12)
"""Angles, in parts of the field, and number of rays of the search for visible ghosts."""
ROOM = 5.0
"""Largest assumed ratio of ghost brightness to that at other angles."""
FRONT, DISK = (24, 48), (4, 16)
"""Rays of a source outside the frame, and points of the disk of an extended source."""
REACH, SMOOTH = 4.0, 3.0
"""Standard deviations to which the light of a ray reaches, and steps of the grid to one."""


DETECTOR_REFLECTANCE = 0.2
"""Of silicon, 0.1 to 0.3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GhostLight:
    """Ghosts to be rendered."""

    least_e: float  # Electrons in the brightest pixel of a ghost below which it is left out
    detector_reflectance: float = DETECTOR_REFLECTANCE  # Light that the detector reflects like a mirror

    def __post_init__(self) -> None:
        if not (self.least_e > 0.0 and math.isfinite(self.least_e)):
            raise DomainError(f"GhostLight.least_e = {self.least_e:g} e-; it must be positive")
        if not 0.0 <= self.detector_reflectance <= 1.0:
            raise DomainError(
                f"GhostLight.detector_reflectance = {self.detector_reflectance:g}; it must lie in 0 ... 1"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class GhostTruth:
    """Ghosts of one image, g of them, each of one star, path and band."""

    star: IntArray  # (g,) Row in the truth; sources outside the frame follow the stars
    band: IntArray
    back: IntArray  # (g,) Surfaces that turn the light back, then forward again; the number of surfaces is the detector
    forward: IntArray
    x_px: FloatArray  # (g,) Column and row of its centroid, on the detector or outside
    y_px: FloatArray
    radius_px: FloatArray  # (g,) Of the uniform disk with the same RMS radius
    electrons: FloatArray  # (g,) All of its light, and the part on the detector
    electrons_image: FloatArray
    peak_e: FloatArray  # (g,) In the brightest pixel, taken for a uniform disk
    sharp: NDArray[np.bool_]  # (g,) Small enough to be taken for a star: a candidate for a false one

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in self.__dataclass_fields__:
            kind = np.bool_ if name == "sharp" else np.int64 if name in ("star", "band", "back", "forward") else float
            freeze(self, name, shape=("g",), dtype=kind, sizes=sizes)

    def __len__(self) -> int:
        return len(self.star)


class Ghosting:
    """Adds ghosts of the sources of one camera, its lens with the cover glass of the detector."""

    def __init__(self, camera: Camera, light: GhostLight) -> None:
        camera.lens.check_surfaces()
        self.camera, self.light, self.lens = camera, light, camera.focused_lens
        self._losses = camera.losses or PathLosses(absorption=False)
        self._paths: dict[tuple[int, int] | None, GhostPath] = {}
        self._pairs, self._seen = ghost_pairs(self.lens), dict[float, FloatArray]()
        self._angles = np.minimum(np.array(ANGLES) * camera.field_reach_rad, 1.4)

    def add(
        self, image: NDArray[np.float32], direction: FloatArray, wavelength_nm: FloatArray, truth: Truth
    ) -> GhostTruth:
        """Add ghosts of stars in directions (n, 3) in cam, whose truth is known, to an image (h, w, b)."""
        assert truth.electrons_absorbed is not None
        entering_e = truth.electrons_in - truth.electrons_vignetted - truth.electrons_hidden - truth.electrons_absorbed
        area = entrance_pupil(self.lens).area_mm2
        rows: list[tuple[Any, ...]] = []
        for band, nm in enumerate(wavelength_nm.mean(1).tolist()):
            visible = self._visible(direction, nm, entering_e[:, band] / area)
            for star in np.flatnonzero(visible.any(1)).tolist():
                electrons, pairs = float(entering_e[star, band]), self._chosen(visible[star])
                rays, entering = entering_rays(self.lens, direction[star], nm)
                direct = float(self._path(None).trace(rays, entering).weight.sum())
                if direct > 0.0:
                    beam = rays, entering * (electrons / direct)
                    rows += self._rows(image[..., band], (star, band), pairs, beam)
        return _truth(rows)

    def add_beside(
        self,
        image: NDArray[np.float32],
        stars: StarField,
        *,
        exposure_s: float,
        radius_rad: FloatArray | float = 0.0,
        first: int = 0,
    ) -> GhostTruth:
        """Add ghosts of sources anywhere in front of the lens, in cam, whose images are drawn elsewhere or nowhere.

        They are even disks of radius (n,) or points; ``first`` is the number of the first one in the truth.
        """
        facing_e, area = self._facing(stars, exposure_s), math.pi * entrance_radius_mm(self.lens) ** 2
        radius = np.broadcast_to(radius_rad, len(stars))
        rows: list[tuple[Any, ...]] = []
        for band, nm in enumerate(stars.wavelength_nm.mean(1).tolist()):
            light = np.where(stars.direction[:, 2] > 0.0, facing_e[:, band] / area, 0.0)
            visible = self._visible(stars.direction, nm, light) | ((radius > 0.0) & (light > 0.0))[:, None]
            for source in np.flatnonzero(visible.any(1)).tolist():
                towards, wide, whose = stars.direction[source], float(radius[source]), (first + source, band)
                rays, facing = front_rays(self.lens, towards, nm, FRONT)
                beam = _beside(rays, towards, wide) if wide else rays, facing * light[source]
                rows += self._rows(image[..., band], whose, self._chosen(visible[source]), beam)
        return _truth(rows)

    def bright(self, stars: StarField, exposure_s: float) -> NDArray[np.bool_]:
        """Which of n stars may make ghosts that are rendered, wherever they stand in front of the lens."""
        area = math.pi * entrance_radius_mm(self.lens) ** 2 * self.light.least_e / ROOM
        most = [float(self._areas(nm).max()) for nm in stars.wavelength_nm.mean(1).tolist()]
        return np.asarray((self._facing(stars, exposure_s) * most > area).any(1))

    def _facing(self, stars: StarField, exposure_s: float) -> FloatArray:
        """Electrons (n, b) of the light on the first surface without losses."""
        wave, area = stars.wavelength_nm, math.pi * entrance_radius_mm(self.lens) ** 2
        transmission = np.reshape(self._losses.along_axis(self.lens, wave.ravel()), wave.shape)
        rate = (stars.photon_rate * self.camera.response_at(wave) / transmission).sum(2)
        return np.asarray(rate * (exposure_s * area))

    def _chosen(self, visible: NDArray[np.bool_]) -> list[tuple[int, int]]:
        return [self._pairs[p] for p in np.flatnonzero(visible)]

    def _path(self, pair: tuple[int, int] | None) -> GhostPath:
        if pair not in self._paths:
            back, forward = pair or (None, None)
            self._paths[pair] = GhostPath(self.lens, back, forward, self._losses.coating, self._losses.absorption)
        return self._paths[pair]

    def _visible(self, towards: FloatArray, nm: float, density: FloatArray) -> NDArray[np.bool_]:
        """Whether each of p paths of sources in directions (n, 3), of electrons (n,) per mm^2, may be visible."""
        area, nodes = self._areas(nm), self._angles
        at = np.searchsorted(nodes, np.arccos(np.clip(towards[:, 2], 0.0, 1.0)))
        most = np.maximum(area[np.maximum(at - 1, 0)], area[np.minimum(at, len(nodes) - 1)])
        return np.asarray(ROOM * most * density[:, None] > self.light.least_e)

    def _areas(self, nm: float) -> FloatArray:
        """Area (a, p) [mm^2] in front of the lens whose light the brightest pixel of every path holds."""
        if nm not in self._seen:
            source = np.stack([np.sin(self._angles), 0.0 * self._angles, np.cos(self._angles)], axis=-1)
            parts = [front_rays(self.lens, direction, nm, ORDER) for direction in source]
            x, y, z, facing = (
                np.concatenate([np.broadcast_to(v, area.shape) for v, area in zip(column, areas, strict=True)])
                for areas in [[area for _, area in parts]]
                for column in (*([getattr(r, axis) for r, _ in parts] for axis in "xyz"), areas)
            )
            along = np.repeat(light_direction(source), len(x) // len(source), axis=0)
            rays = Rays.create(x_mm=x, y_mm=y, z_mm=z, direction=along, wavelength_nm=nm)
            self._seen[nm] = areas = np.zeros((len(source), len(self._pairs)))
            for p, pair in enumerate(self._pairs):
                path_rays = self._path(pair).trace(rays, facing, self.light.detector_reflectance)
                weight = path_rays.weight.reshape(len(source), -1)
                landed_px = self.camera.to_pixel(path_rays.rays.x, path_rays.rays.y)
                position_px = np.stack(landed_px).reshape(2, *weight.shape)
                for a, lit in enumerate(weight > 0.0):
                    if lit.any():
                        areas[a, p] = weight[a].sum() / _moments(position_px[:, a, lit], weight[a, lit])[3]
        return self._seen[nm]

    def _rows(
        self,
        image: NDArray[np.float32],
        whose: tuple[int, int],
        pairs: list[tuple[int, int]],
        beam: tuple[Rays, FloatArray],
    ) -> list[tuple[Any, ...]]:
        """Add ghosts of one source in one band, of a disk by triples of rays; their rows of the truth."""
        (rays, light), count, disk = beam, beam[1].size, gauss_disk(*DISK)
        extended = rays.x.size > count
        light = np.tile(light, rays.x.size // count)
        rows: list[tuple[Any, ...]] = []
        for pair in pairs:
            path_rays = self._path(pair).trace(rays, light, self.light.detector_reflectance)
            lit = np.flatnonzero(path_rays.weight[:count] > 0.0)
            if not len(lit):
                continue
            landed_px = np.stack(self.camera.to_pixel(path_rays.rays.x, path_rays.rays.y))
            weight, position_px = path_rays.weight[lit], landed_px[:, lit]
            sigma = max(self.camera.blur_px, 1.5 * _moments(position_px, weight)[2] / math.sqrt(len(lit)), 0.05)
            if extended:
                ends = lit + count * np.array([[1], [2]])
                traced = path_rays.rays.status[ends] == OK
                first, second = (
                    np.where(ok, landed_px[:, end] - position_px, 0.0) for ok, end in zip(traced, ends, strict=True)
                )
                spots = position_px[..., None] + first[..., None] * disk.x + second[..., None] * disk.y
                position_px = spots.reshape(2, -1)
                weight = np.outer(weight, disk.weight).ravel()
                spread_px = math.sqrt(float((first**2 + second**2).sum()) / (2.0 * len(lit)))
                sigma = math.hypot(sigma, 1.5 * spread_px / math.sqrt(len(disk.x)))
            x, y, radius, area = _moments(position_px, weight)
            total = float(weight.sum())
            if total / area < self.light.least_e:
                continue
            on_image = self._draw(image, position_px, weight, sigma)
            sharp = radius * self.camera.pixel_pitch_mm < math.sqrt(2.0) * SHARP_MM
            rows.append((*whose, *pair, x, y, radius, total, on_image, total / area, sharp))
        return rows

    def _draw(self, image: NDArray[np.float32], position_px: FloatArray, light: FloatArray, sigma: float) -> float:
        """Add light at places (2, m), each a Gaussian; electrons on the image.

        It is shared out over a grid of a part of the Gaussian, smoothed there, and interpolated.
        """
        step, room = max(1.0, sigma / SMOOTH), math.ceil(REACH * sigma) + 1
        span, part, hats, inside = [], [], [], np.ones(len(light), np.bool_)
        for v, size in zip(position_px, image.shape[::-1], strict=True):
            low, high = max(0, math.floor(v.min()) - room), min(size, math.ceil(v.max()) + room + 1)
            if low >= high:
                return 0.0
            node = np.arange(low - room, high + room + step, step)
            span.append(slice(low, high))
            part.append((v - node[0]) / step)
            inside &= (part[-1] >= 0.0) & (part[-1] < len(node) - 1)
            hats.append(np.maximum(1.0 - np.abs(np.arange(low, high)[:, None] - node) / step, 0.0))
        grid = np.zeros((hats[1].shape[1], hats[0].shape[1]))
        (column, part_right), (row, part_down) = ((v[inside].astype(np.int64), v[inside] % 1.0) for v in part)
        for next_row, weight_down in ((0, 1.0 - part_down), (1, part_down)):
            for next_column, weight_right in ((0, 1.0 - part_right), (1, part_right)):
                np.add.at(grid, (row + next_row, column + next_column), light[inside] * weight_down * weight_right)
        width = math.sqrt(max(sigma**2 - step**2 / 12.0, 0.0)) / step  # the sharing widens it, too
        grid = gaussian_filter(grid, width, mode="constant", truncate=REACH)
        pixels = hats[1] @ grid @ hats[0].T / step**2
        if self.camera.sensitive_columns is not None:
            pixels = pixels * self.camera.sensitive_columns[span[0]]
        image[span[1], span[0]] += pixels.astype(np.float32)
        return float(pixels.sum())


def _beside(rays: Rays, towards: FloatArray, radius_rad: float) -> Rays:
    """Rays (n,) of a source, then of two points of its rim at right angles, from the same starting points."""
    side = np.cross(towards, [1.0, 0.0, 0.0] if abs(towards[0]) < 0.7 else [0.0, 1.0, 0.0])
    side = math.tan(radius_rad) * side / np.linalg.norm(side)
    rim = np.stack([towards, towards + side, towards + np.cross(towards, side)])
    light = np.repeat(light_direction(rim / np.linalg.norm(rim, axis=1, keepdims=True)), rays.x.size, axis=0)
    x, y, z, wave = (
        np.tile(np.broadcast_to(v, rays.x.shape).ravel(), 3) for v in (rays.x, rays.y, rays.z, rays.wavelength_nm)
    )
    return Rays.create(x_mm=x, y_mm=y, z_mm=z, direction=light, wavelength_nm=wave)


def _moments(position_px: FloatArray, weight: FloatArray) -> tuple[float, float, float, float]:
    """Centroid, radius of the even disk of the same RMS radius, and its area, no less than a pixel's."""
    x, y = (float(v) for v in position_px @ weight / weight.sum())
    square = float(weight @ ((position_px[0] - x) ** 2 + (position_px[1] - y) ** 2) / weight.sum())
    return x, y, math.sqrt(2.0 * square), max(2.0 * math.pi * square, 1.0)


def _truth(rows: list[tuple[Any, ...]]) -> GhostTruth:
    names = list(GhostTruth.__dataclass_fields__)
    columns = zip(*rows, strict=True) if rows else ([] for _ in names)
    return GhostTruth(**{name: np.array(values) for name, values in zip(names, columns, strict=True)})
