"""Diffraction images of many stars, interpolated between images at points of the field.

The grid (`render.tracing.waves.field_grid_build`) holds images of some wavelengths at Chebyshev points of the
detector's field, or of a radius of it, centred on the mean of the rays of a middle wavelength. A star's image is their
interpolant in its direction, weighted by its spectrum, positioned by its chief ray and the interpolated offset from the
chief ray to that mean. The images differ little: some tens of principal components represent them, and a frame is one
product of matrices. Mean, variance and losses of a star's rays are interpolated too, so that only the chief ray is
traced.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from render.camera import Camera
from render.tracing.truth import RayMoments, WaveStamps
from render.tracing.waves.direct_sums import Trail
from render.tracing.waves.pixel_kernel import FieldSampling, PixelTable, pixel_table, window_samples
from render.tracing.waves.principal_components import Components, projected
from render.tracing.waves.wavelength_interpolation import lagrange


def radial_weights(points: FloatArray, cuts: tuple[float, ...], radius: FloatArray) -> FloatArray:
    """Weights (n, p) of points along a radius for radii (n,): polynomials between cuts."""
    weight = np.zeros((len(radius), len(points)))
    for low, high in pairwise((-math.inf, *cuts, math.inf)):
        targets, sources = ((low <= v) & (v < high) for v in (radius, points))
        weight[np.ix_(targets, sources)] = lagrange(points[sources], radius[targets])
    return weight


@dataclass(frozen=True, slots=True, eq=False)
class WaveGrid:
    """Images over the field of one state of a lens, at q wavelengths of each of b bands."""

    camera: Camera
    points: FloatArray  # (p,) Points along either axis of the field, in (-1, 1)
    middle: FloatArray  # (2,) Middle of the field, tangents of angles along X and Y of cam
    half: FloatArray  # (2,) Half size of the field, likewise
    radius_px: int  # Of the stamps
    field: FieldSampling  # Sampling of the images
    spectral: FloatArray  # (b, k, q) Weights of the q wavelengths for the k of stars
    origin_px: FloatArray  # (f, b, 2) Centre of the images from the chief ray, at the f = p^2 points
    # (f, b, q, 7) Light that gets through the lens, and that enters it; the former times the mean (column, row) of its
    # rays from the chief ray and times their mean squares; light that apertures let through
    moment: FloatArray
    components: tuple[Components, ...]  # Of every band, coefficients (f, q, c)
    # Of a lens of revolution: azimuthal orders (c,) of the components of every band, each with a cosine and a sine
    # (`render.tracing.waves.azimuthal_modes`). The f = p points then lie along a radius, in fractions of that of the
    # farthest corner; images, means and moments are those of stars on the column axis
    order: tuple[IntArray, ...] | None = None
    cuts: tuple[float, ...] = ()  # Fractions of that radius where apertures begin to cut the beam, ascending
    error: float = math.nan  # Largest error of a pixel between the points [fraction of the light]
    error_px: float = math.nan  # Largest error of a centroid there

    def holds(self, direction: FloatArray) -> NDArray[np.bool_]:
        """Whether directions (n, 3) in cam lie in the grid's field."""
        with np.errstate(divide="ignore", invalid="ignore"):
            field_point = (direction[:, :2] / direction[:, 2:] - self.middle) / self.half
        return np.asarray((np.abs(field_point).max(1) <= 1.0) & (direction[:, 2] > 0.0))

    def stamps(
        self, stars: IntArray, direction: FloatArray, spectrum: FloatArray, chief_px: FloatArray, trail: Trail | None
    ) -> WaveStamps:
        """Stamps of some stars; weights of the wavelengths of their light."""
        # stars (s,), direction (s, 3), spectrum (s, b, k), chief_px (s, b, 2)
        weight, mixture, turn = self._weights(direction, spectrum)
        light, moments, origin, clear = self._rays(weight, mixture, turn, chief_px)
        size = 2 * self.radius_px + 1
        first, more = (0.0, 0) if trail is None else trail.room(stars)
        corner, stamp_px = np.rint(moments.mean_px) - 0.5 * size + first, size + more
        pixels = np.zeros((len(stars), spectrum.shape[1], stamp_px, stamp_px), np.float32)
        for b in range(spectrum.shape[1]):
            images = self._images(weight, mixture[:, b], turn, b)
            shift = (origin - corner)[:, b] - 0.5 * size  # from the middle of the window to that of the image
            if trail is None:
                pixels[:, b] = self._pixels(images, shift, stamp_px)
                continue
            images = [image * self._disk for image in images]
            for t in range(trail.weight.shape[2]):
                part = self._pixels(images, shift + trail.offset_px[stars, b, t], stamp_px)
                pixels[:, b] += trail.weight[stars, b, t].astype(np.float32)[:, None, None] * part
        if trail is None:
            steps = np.arange(size) - 0.5 * (size - 1)
            pixels *= np.hypot(steps, steps[:, None]) <= self.radius_px
        else:
            moments = trail.along(moments, stars)
        np.maximum(pixels, 0.0, out=pixels)
        return WaveStamps(stars, pixels, corner, moments.mean_px, light, len(self.points) ** 2, "grid", moments, clear)

    def cells(
        self, direction: FloatArray, spectrum: FloatArray, chief_px: FloatArray, half_size_px: int, cells_per_px: int
    ) -> FloatArray:
        """Light per cell (s, b, m, m) of a square about the centroid, over what gets through the lens.

        Parameters as `stamps`; light beyond the radius of the grid is left out.
        """
        weight, mixture, turn = self._weights(direction, spectrum)
        light, moments, origin, _ = self._rays(weight, mixture, turn, chief_px)
        count = (2 * half_size_px + 1) * cells_per_px
        centres = (np.arange(count) + 0.5) / cells_per_px - 0.5 * count / cells_per_px
        kernel = self.field.pixel(1.0 / cells_per_px, self.camera.blur_px)
        cells = np.empty((*light.shape, count, count))
        for b in range(light.shape[1]):
            images = self._images(weight, mixture[:, b], turn, b)
            for s, shift in enumerate(moments.mean_px[:, b] - origin[:, b]):
                column, row = (kernel((centres + d)[:, None] - self._samples) * self.field.light_step for d in shift)
                cells[s, b] = projected(row, [image[s] for image in images], column) / light[s, b]
        return cells

    def _weights(
        self, direction: FloatArray, spectrum: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.complex128]]:
        """Weights of the points for stars (s, f), of the wavelengths that have images (s, b, q), and turns (s,)."""
        tangent = direction[:, :2] / direction[:, 2:]
        turn = np.ones(len(tangent), np.complex128)
        if self.order is None:
            field_point = (tangent - self.middle) / self.half
            column, row = (lagrange(self.points, field_point[:, i]) for i in (0, 1))
            weight = (row[:, :, None] * column[:, None, :]).reshape(len(field_point), -1)
        else:
            radius = np.hypot(*tangent.T)
            weight = radial_weights(self.points, self.cuts, radius / self.reach)
            off = radius > 0.0
            turn[off] = (tangent[off] @ np.array([1.0, 1j])) / radius[off]
        return weight, np.einsum("sbk,bkq->sbq", spectrum, self.spectral), turn

    def _rays(
        self, weight: FloatArray, mixture: FloatArray, turn: NDArray[np.complex128], chief_px: FloatArray
    ) -> tuple[FloatArray, RayMoments, FloatArray, FloatArray]:
        """Light that gets through (s, b), moments of rays, centres of images (s, b, 2), light past the apertures."""
        sums = np.einsum("sf,fbqm,sbq->sbm", weight, self.moment, mixture, optimize=True)
        light, entrance, clear = sums[..., 0], sums[..., 1], sums[..., 6]
        mean, square = sums[..., 2:4] / light[..., None], sums[..., 4:6] / light[..., None]
        origin, variance = np.einsum("sf,fbx->sbx", weight, self.origin_px), square - mean**2
        if self.order is not None:
            cos, sin = turn.real[:, None], turn.imag[:, None]
            mean, origin = (np.stack([v[..., 0] * cos, v[..., 0] * sin], axis=-1) for v in (mean, origin))
            radial, tangential = variance[..., 0], variance[..., 1]
            turned = radial * cos**2 + tangential * sin**2, radial * sin**2 + tangential * cos**2
            variance = np.stack(turned, axis=-1)
        moments = RayMoments(chief_px + mean, variance, np.maximum(entrance, clear))
        return light, moments, chief_px + origin, clear

    def _images(
        self, weight: FloatArray, mixture: FloatArray, turn: NDArray[np.complex128], band: int
    ) -> list[NDArray[np.float32]]:
        """Light per px^2 of stars in a band over the light sent into the launch disk: quarters (s, h, h) by parity."""
        components = self.components[band]
        points, colours, count = components.coefficient.shape
        at_star = weight.astype(np.float32) @ components.coefficient.reshape(points, -1)
        mixed = np.einsum("sk,skc->sc", mixture.astype(np.float32), at_star.reshape(-1, colours, count))
        if self.order is not None:
            turned = turn[:, None] ** self.order[band]
            mixed = np.concatenate([mixed * turned.real, mixed * turned.imag], axis=1).astype(np.float32)
        quarter, side = components.quarter, components.quarter.shape[-1]
        quarters = []
        for parity in range(4):
            which = np.flatnonzero(components.parity == parity)
            part = slice(int(which[0]), int(which[-1]) + 1) if len(which) else slice(0)
            quarters.append((mixed[:, part] @ quarter[part].reshape(-1, side**2)).reshape(-1, side, side))
        return quarters

    def _pixels(self, images: list[NDArray[np.float32]], shift_px: FloatArray, stamp_px: int) -> NDArray[np.float32]:
        """Pixels (s, n, n) of images whose middle is off the window's by a shift (s, 2)."""
        samples = len(self._samples)
        first = 0.5 - 0.5 * self._window + 0.5 * (samples - 1) * self.field.light_step  # pixel 0 from sample 0
        column, row = (self._table.rows(first - shift_px[:, axis], stamp_px, samples) for axis in (0, 1))
        return np.asarray(projected(row, images, column), np.float32)

    @property
    def reach(self) -> float:
        """Tangent of the angle of the farthest corner from the axis."""
        return float(np.hypot(*(np.abs(self.middle) + self.half)))

    @property
    def _window(self) -> float:
        return 2.0 * self.radius_px + 1.0

    @property
    def _samples(self) -> FloatArray:
        """Samples along an axis, from the middle of the window [px]."""
        return window_samples(self.field, self._window, self._table.pad_px) - 0.5 * self._window

    @property
    def _disk(self) -> NDArray[np.bool_]:
        """Samples of a quarter within the radius."""
        samples = self._samples[: -(-len(self._samples) // 2)]
        return np.asarray(np.hypot(samples, samples[:, None]) <= self.radius_px + 0.5)

    @property
    def _table(self) -> PixelTable:
        return pixel_table(self.field, self.camera.blur_px)
