r"""Directions of the sky seen by points of the detector through points of the pupil, as polynomials per tile.

For a grid of directions that covers a tile the beams through the lens are traced (`optics.rays.spots.trace_spots`). The
n-th ray of every beam passes the same part of the lens, so that its landing point and its share of the pupil area vary
smoothly over the tile. The inverse, X/Z and Y/Z of the direction against column and row, is fitted for every wavelength
and ray, and with it the etendue per pixel,

.. math:: dE = A \cos\theta\, d\Omega = A \cos^4\theta\,
          \left|\frac{\partial(X/Z, Y/Z)}{\partial(x, y)}\right|\, dx\, dy .

A tile whose fit error exceeds `FIT_PX` is divided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.frames import field_angles_deg
from optics.rays.paraxial import axial_paraxial
from optics.rays.spots import trace_spots
from render.camera import Camera

DEGREE, GRID = 5, 7
"""Total degree of the polynomials; directions along each side of a tile."""
TILE_PX, SMALLEST_PX = 256, 64
FIT_PX = 5e-3
"""Error of a fit [px], root mean square over the light; the smallest tile is accepted with any error."""
MARGIN = 0.06
"""Room around a tile, in its size, for what diffuses out of it."""
COARSE = (2, 16)
LEAST_ORDER, MOST_ORDER = (4, 16), (8, 48)
"""Rings and azimuths; more for wide spots, but where outlines have kinks there are many azimuths anyway."""


@dataclass(frozen=True, slots=True)
class Tile:
    """Pixels first_column <= column < end_column and likewise for rows."""

    first_column: int
    first_row: int
    end_column: int
    end_row: int

    @property
    def half_px(self) -> FloatArray:
        """Half of its size (2,), margin included."""
        size = np.array([self.end_column - self.first_column, self.end_row - self.first_row], float)
        return np.asarray(size * (0.5 + MARGIN) + 2.0)

    @property
    def centre_px(self) -> FloatArray:
        """Centre of the tile (2,)."""
        return 0.5 * np.array([self.first_column + self.end_column - 1, self.first_row + self.end_row - 1], float)

    def meets(self, columns: slice, rows: slice) -> bool:
        """Whether it has pixels in a window."""
        across = self.first_column < columns.stop and self.end_column > columns.start
        return across and self.first_row < rows.stop and self.end_row > rows.start

    def quarters(self) -> tuple[Tile, ...]:
        """The four quarters of the tile."""
        c, r = (self.first_column + self.end_column) // 2, (self.first_row + self.end_row) // 2
        columns = ((self.first_column, c), (c, self.end_column))
        rows = ((self.first_row, r), (r, self.end_row))
        return tuple(Tile(a, b, c, d) for a, c in columns for b, d in rows if a < c and b < d)


@dataclass(frozen=True, slots=True)
class TileMap:
    """Polynomials of a tile."""

    tile: Tile  # Where they hold
    # (w, n, 3, m) Of the monomials (`monomials`) of column and row, counted from the tile's centre in its
    # ``half_px``: X/Z, Y/Z, and the etendue per pixel [mm^2 sr] of each of n rays at w wavelengths
    coefficient: FloatArray


def powers() -> list[tuple[int, int]]:
    """Exponents of the monomials, in their order."""
    return [(i, total - i) for total in range(DEGREE + 1) for i in range(total + 1)]


def _design(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.stack([x**i * y**j for i, j in powers()], axis=-1)


def _slopes(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    by_x = [i * x ** max(i - 1, 0) * y**j for i, j in powers()]
    by_y = [j * x**i * y ** max(j - 1, 0) for i, j in powers()]
    return np.stack(by_x, axis=-1), np.stack(by_y, axis=-1)


class RayMaps:
    """Maps of one camera at given wavelengths; computed tile by tile on request, and kept."""

    def __init__(self, camera: Camera, wavelength_nm: FloatArray) -> None:
        self.camera, self.wavelength_nm = camera, np.asarray(wavelength_nm, float)
        self._lens = camera.focused_lens
        self._focal_px = abs(axial_paraxial(self._lens, self._lens.design_wavelength_nm).efl_mm) / camera.pixel_pitch_mm
        self._found: dict[Tile, tuple[TileMap | None, float]] = {}

    def tiles(self, columns: slice, rows: slice) -> list[TileMap]:
        """Maps that cover a window."""
        width, height = self.camera.width_px, self.camera.height_px
        return [
            tile_map
            for row in range(TILE_PX * (rows.start // TILE_PX), rows.stop, TILE_PX)
            for column in range(TILE_PX * (columns.start // TILE_PX), columns.stop, TILE_PX)
            for tile_map in self._maps(
                Tile(column, row, min(column + TILE_PX, width), min(row + TILE_PX, height)), columns, rows
            )
        ]

    def _maps(self, tile: Tile, columns: slice, rows: slice) -> list[TileMap]:
        """Map of a tile, or those of its parts, as far as they reach into the window."""
        if not tile.meets(columns, rows):
            return []
        if tile not in self._found:
            self._found[tile] = self._fit(tile)
        tile_map, error = self._found[tile]
        small = min(tile.end_column - tile.first_column, tile.end_row - tile.first_row) <= SMALLEST_PX
        if tile_map is None or small or error < FIT_PX:
            return [] if tile_map is None else [tile_map]
        return [m for part in tile.quarters() for m in self._maps(part, columns, rows)]

    def _fit(self, tile: Tile) -> tuple[TileMap | None, float]:
        """Map of a tile, None where no light falls, and its error [px]."""
        half = tile.half_px
        tangent, order = self._directions(tile)
        if tangent is None:
            return None, 0.0
        landed = self._landed(tangent, order)
        x, y = ((landed.position[..., axis] - tile.centre_px[axis]) / half[axis] for axis in range(2))
        lit = landed.area_mm2 > 0.0  # (f, w, n)
        if not lit.any():
            return None, 0.0
        x, y = (np.moveaxis(v, 0, -1) for v in (x, y))  # (w, n, f)
        lit = np.moveaxis(lit, 0, -1)
        x, y = np.where(lit, x, 0.0), np.where(lit, y, 0.0)
        inside = lit * np.exp(-0.5 * np.maximum(np.maximum(abs(x), abs(y)) - 1.0, 0.0) ** 2 / 0.2**2)
        inside = np.maximum(inside, 1e-9)
        design = _design(x, y)  # (w, n, f, m)
        weighted = design * inside[..., None]
        inverse = np.linalg.pinv(weighted, rcond=1e-12) * inside[..., None, :]
        towards = np.einsum("wnmf,fa->wnam", inverse, tangent)
        by_x, by_y = (np.einsum("wnfm,wnam->wnfa", slope, towards) for slope in _slopes(x, y))
        scale = abs(by_x[..., 0] * by_y[..., 1] - by_x[..., 1] * by_y[..., 0]) / (half[0] * half[1])
        cosine = 1.0 / np.sqrt(1.0 + (tangent**2).sum(1))
        etendue = np.moveaxis(landed.area_mm2, 0, -1) * cosine**4 * scale
        light = np.einsum("wnmf,wnf->wnm", inverse, etendue)
        coefficient = np.concatenate([towards, light[:, :, None]], axis=2)
        fitted = np.einsum("wnfm,wnam->wnfa", design, towards)
        light = np.where(lit & (np.maximum(abs(x), abs(y)) <= 1.0), np.moveaxis(landed.area_mm2, 0, -1), 0.0)
        square = (light * ((fitted - tangent) ** 2).sum(-1)).sum() / max(light.sum(), 1e-300)
        return TileMap(tile, coefficient), float(np.sqrt(square)) * self._focal_px

    def _directions(self, tile: Tile) -> tuple[FloatArray | None, tuple[int, int]]:
        """X/Z and Y/Z (f, 2) of directions whose beams cover a tile, and the rays that their spots need."""
        side = np.cos(np.pi * (np.arange(4) + 0.5) / 4)
        corners = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        target_px = tile.centre_px + corners * tile.half_px
        tangent = (target_px - self.camera.centre_px) / self._focal_px
        spread = 0.0
        for _ in range(3):  # distortion: a straight line from where rays land to where they come from
            landed = self._landed(tangent, COARSE)
            lit = landed.area_mm2 > 0.0
            lit_beams = lit.any((1, 2))
            if lit_beams.sum() < 4:
                return None, LEAST_ORDER
            weights = lit / np.maximum(lit.sum((1, 2), keepdims=True), 1)
            mean = (weights[..., None] * np.where(lit[..., None], landed.position, 0.0)).sum((1, 2))
            distance_px = np.linalg.norm(landed.position - mean[:, None, None], axis=-1)
            spread = float(np.where(lit, distance_px, 0.0).max())
            design = np.column_stack([np.ones(lit_beams.sum()), mean[lit_beams]])
            inverse_map = np.linalg.lstsq(design, tangent[lit_beams], rcond=None)[0]
            reach = tile.half_px + spread
            tangent = np.column_stack([np.ones(len(corners)), tile.centre_px + corners * reach]) @ inverse_map
        side = np.cos(np.pi * (np.arange(GRID) + 0.5) / GRID) / math.cos(0.5 * np.pi / GRID)
        grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        full = np.column_stack([np.ones(len(grid)), tile.centre_px + grid * (tile.half_px + spread)]) @ inverse_map
        kinks = landed.area_mm2.shape[2] > COARSE[0] * LEAST_ORDER[1]
        finer = (int(spread), 0 if kinks else 4 * int(spread))
        order = tuple(min(most, least + more) for least, most, more in zip(LEAST_ORDER, MOST_ORDER, finer, strict=True))
        return full, (order[0], order[1])

    def _landed(self, tangent: FloatArray, order: tuple[int, int]) -> _Landed:
        v = np.column_stack([tangent, np.ones(len(tangent))])
        angles = field_angles_deg(v / np.linalg.norm(v, axis=1, keepdims=True))
        try:
            spots = trace_spots(self._lens, *angles, self.wavelength_nm, order=order)
        except ConvergenceError:
            nothing = np.zeros((len(tangent), len(self.wavelength_nm), 1))
            return _Landed(np.zeros((*nothing.shape, 2)), nothing)
        x, y = self.camera.to_pixel(spots.rays.x, spots.rays.y)
        return _Landed(np.stack([x, y], axis=-1), spots.area_mm2)


@dataclass(frozen=True, slots=True)
class _Landed:
    """Where rays land (f, w, n, 2) [px], and the area that each stands for (f, w, n) [mm^2]; 0 for lost ones."""

    position: FloatArray
    area_mm2: FloatArray
