"""Diffraction images of many stars by interpolation between few: a grid over the field for one state of a lens.

At Chebyshev points of the detector's field, or of a radius of it, some wavelengths have their images, summed as for
stars of their own (`render.tracing.wave_grid_build`) and centred on the mean of the rays of a middle wavelength. A
star's image is their interpolant at its place, weighed by its spectrum, and put where its chief ray and the
interpolated way from there to that mean tell. The images differ little: some tens of principal components hold them
all, and a frame is one product of matrices. Mean, spread and losses of a star's rays are interpolated alike, so that
none is traced but the chief ray.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from render.camera import Camera
from render.tracing.wave_images import RayMoments, Trail, WaveStamps
from render.tracing.wave_spectrum import lagrange
from render.tracing.wave_windows import FieldSampling, PixelTable, window_samples

__all__ = ["MOMENTS", "WaveGrid", "chebyshev"]


MOMENTS = 6
"""Light of a wavelength that gets through the lens, and that enters it; the former times the mean (column, row) of its
rays from the chief ray and times their mean squares."""


def chebyshev(count: int) -> FloatArray:
    """Chebyshev points of the first kind in (-1, 1)."""
    return -np.cos(np.pi * (np.arange(count) + 0.5) / count)


@dataclass(frozen=True, slots=True, eq=False)
class WaveGrid:
    """Images over the field of one state of a lens, at some wavelengths."""

    camera: Camera
    points: FloatArray  # (p,) Points along either axis of the field, in (-1, 1)
    # middle, half: (2,) Place of the field's middle and its half size, as tangents of angles along X and Y of cam
    middle: FloatArray
    half: FloatArray
    radius_px: int  # Of the stamps
    field: FieldSampling  # Sampling of the images
    spectral: FloatArray  # (b, k, q) What makes of the q wavelengths that have images the k of stars
    # (f, b, 2) Mean of the rays of a middle wavelength from the chief ray, at the f = p^2 points: where images are
    # centred
    origin_px: FloatArray
    moment: FloatArray  # (f, b, q, 6) `MOMENTS`
    coefficient: NDArray[np.float32]  # (b, f, q, c) Components of every image
    component: NDArray[np.float32]  # (b, c, m, m) Principal components, light per px^2
    # (b, c) Of a lens of revolution: azimuthal orders of the components, of which there are twice as many
    # (`render.tracing.wave_polar`). The f = p points then lie along a radius, in parts of that of the farthest
    # corner; images, means and moments are those of stars on the column axis
    order: IntArray | None = None
    kink: float = 1.0  # Part of that radius from which apertures cut the beam; no polynomial reaches across it
    # error, error_px: Largest error found between the points, of a pixel and of a centroid
    error: float = math.nan
    error_px: float = math.nan

    def holds(self, direction: FloatArray) -> NDArray[np.bool_]:
        """Directions (n, 3) in cam that lie in the grid's field."""
        with np.errstate(divide="ignore", invalid="ignore"):
            place = (direction[:, :2] / direction[:, 2:] - self.middle) / self.half
        return np.asarray((np.abs(place).max(1) <= 1.0) & (direction[:, 2] > 0.0))

    def stamps(
        self,
        stars: IntArray,
        direction: FloatArray,
        share: FloatArray,
        chief_px: FloatArray,
        trail: Trail | None = None,
    ) -> WaveStamps:
        """Stamps of some stars."""
        # stars (s,), direction (s, 3), share (s, b, k), chief_px (s, b, 2)
        weight, shares, turn = self._weights(direction, share)
        light, moments, origin = self._rays(weight, shares, turn, chief_px)
        size = 2 * self.radius_px + 1
        corner, stamp_px = np.rint(moments.mean_px) - 0.5 * size, size
        if trail is not None:
            offset = trail.offset_px[stars]
            first = np.floor(offset.min(2))
            stamp_px = size + int((np.ceil(offset.max(2)) - first).max(initial=0.0))
            corner = corner + first
        pixels = np.zeros((len(stars), share.shape[1], stamp_px, stamp_px), np.float32)
        for b in range(share.shape[1]):
            images = self._images(weight, shares[:, b], turn, b)
            shift = (origin - corner)[:, b] - 0.5 * size  # of the image's middle from where the window's would be
            if trail is None:
                pixels[:, b] = self._pixels(images, shift, stamp_px)
                continue
            images *= self._disk
            for t in range(trail.weight.shape[2]):
                part = self._pixels(images, shift + trail.offset_px[stars, b, t], stamp_px)
                pixels[:, b] += trail.weight[stars, b, t].astype(np.float32)[:, None, None] * part
        if trail is None:
            steps = np.arange(size) - 0.5 * (size - 1)
            pixels *= np.hypot(steps, steps[:, None]) <= self.radius_px
        else:
            moments = moments.along(trail, stars)
        np.maximum(pixels, 0.0, out=pixels)
        return WaveStamps(stars, pixels, corner, moments.mean_px, light, len(self.points) ** 2, "grid", moments)

    def cells(
        self, direction: FloatArray, share: FloatArray, chief_px: FloatArray, half_size_px: int, cells_per_px: int
    ) -> FloatArray:
        """Light per cell (s, b, m, m) of a square about the centroid, in shares of what gets through the lens.

        Parameters as `stamps`; light that lies beyond the radius of the grid is left out.
        """
        weight, shares, turn = self._weights(direction, share)
        light, moments, origin = self._rays(weight, shares, turn, chief_px)
        count = (2 * half_size_px + 1) * cells_per_px
        centres = (np.arange(count) + 0.5) / cells_per_px - 0.5 * count / cells_per_px
        kernel = self.field.pixel(1.0 / cells_per_px, self.camera.charge_diffusion_px)
        samples = window_samples(self.field, self._window, self._table.pad_px) - 0.5 * self._window
        result = np.empty((*light.shape, count, count))
        for b in range(light.shape[1]):
            images = self._images(weight, shares[:, b], turn, b)
            for s, image in enumerate(images):
                shift = moments.mean_px[s, b] - origin[s, b]
                column, row = (kernel((centres + d)[:, None] - samples) * self.field.light_step for d in shift)
                result[s, b] = (row @ image @ column.T) / light[s, b]
        return result

    def _weights(
        self, direction: FloatArray, share: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.complex128]]:
        """Weights of the points for stars (s, f), of the wavelengths that have images (s, b, q), and turns (s,)."""
        tangent = direction[:, :2] / direction[:, 2:]
        turn = np.ones(len(tangent), np.complex128)
        if self.order is None:
            place = (tangent - self.middle) / self.half
            column, row = (lagrange(self.points, place[:, i]) for i in (0, 1))
            weight = (row[:, :, None] * column[:, None, :]).reshape(len(place), -1)
        else:
            radius = np.hypot(*tangent.T)
            part, inner = radius / self.reach, self.points < self.kink
            weight = np.zeros((len(part), len(self.points)))
            for stars, points in ((part < self.kink, inner), (part >= self.kink, ~inner)):
                weight[np.ix_(stars, points)] = lagrange(self.points[points], part[stars])
            off = radius > 0.0
            turn[off] = (tangent[off] @ np.array([1.0, 1j])) / radius[off]
        return weight, np.einsum("sbk,bkq->sbq", share, self.spectral), turn

    def _rays(
        self, weight: FloatArray, shares: FloatArray, turn: NDArray[np.complex128], chief_px: FloatArray
    ) -> tuple[FloatArray, RayMoments, FloatArray]:
        """Share of the light that gets through (s, b), moments of the rays, and where images are centred (s, b, 2)."""
        sums = np.einsum("sf,fbqm,sbq->sbm", weight, self.moment, shares, optimize=True)
        light, entrance = sums[..., 0], sums[..., 1]
        mean, square = sums[..., 2:4] / light[..., None], sums[..., 4:6] / light[..., None]
        origin, variance = np.einsum("sf,fbx->sbx", weight, self.origin_px), square - mean**2
        if self.order is not None:
            cos, sin = turn.real[:, None], turn.imag[:, None]
            mean, origin = (np.stack([v[..., 0] * cos, v[..., 0] * sin], axis=-1) for v in (mean, origin))
            along, across = variance[..., 0], variance[..., 1]
            turned = along * cos**2 + across * sin**2, along * sin**2 + across * cos**2
            variance = np.stack(turned, axis=-1)
        moments = RayMoments(chief_px + mean, variance, np.maximum(entrance, light))
        return light, moments, chief_px + origin

    def _images(
        self, weight: FloatArray, shares: FloatArray, turn: NDArray[np.complex128], band: int
    ) -> NDArray[np.float32]:
        """Light per px^2 (s, m, m) of stars in a band, of the light that is sent into the launch disk."""
        coefficient = self.coefficient[band]
        points, colours, count = coefficient.shape
        each = (weight.astype(np.float32) @ coefficient.reshape(points, -1)).reshape(-1, colours, count)
        mixed = np.einsum("sk,skc->sc", shares.astype(np.float32), each)
        if self.order is not None:
            turned = turn[:, None] ** self.order[band]
            mixed = np.concatenate([mixed * turned.real, mixed * turned.imag], axis=1).astype(np.float32)
        component = self.component[band]
        return (mixed @ component.reshape(len(component), -1)).reshape(-1, *component.shape[1:])

    def _pixels(self, images: NDArray[np.float32], shift_px: FloatArray, stamp_px: int) -> NDArray[np.float32]:
        """Pixels (s, n, n) of images whose middle lies beside the window's by a shift (s, 2)."""
        samples = images.shape[-1]
        first = 0.5 - 0.5 * self._window + 0.5 * (samples - 1) * self.field.light_step  # pixel 0 from sample 0
        column, row = (self._table.rows(first - shift_px[:, axis], stamp_px, samples) for axis in (0, 1))
        return np.asarray((row @ images) @ np.swapaxes(column, 1, 2))

    @property
    def reach(self) -> float:
        """Tangent of the angle of the farthest corner from the axis."""
        return float(np.hypot(*(np.abs(self.middle) + self.half)))

    @property
    def _window(self) -> float:
        return 2.0 * self.radius_px + 1.0

    @property
    def _disk(self) -> NDArray[np.bool_]:
        """Samples within the radius."""
        samples = window_samples(self.field, self._window, self._table.pad_px) - 0.5 * self._window
        return np.asarray(np.hypot(samples, samples[:, None]) <= self.radius_px + 0.5)

    @property
    def _table(self) -> PixelTable:
        return self.field.table(self.camera.charge_diffusion_px)
