"""Diffraction images of many stars by interpolation between few: a grid over the field for one state of a lens.

At Chebyshev points of the detector's field every wavelength has its image, summed as for a star of its own and centred
on the mean of the rays of a middle wavelength. A star's image is their interpolant at its place, weighed by its
spectrum, and put where the mean of its own rays is. The images differ little: some tens of principal components hold
them all, and a frame is one product of matrices.

Nothing is taken on trust: a grid is made finer until images at places between its points, of the reddest and of the
bluest light, differ from exact ones by less than `TOLERANCE`; where the finest fails (apertures that start to cut the
beam leave a kink in the field) there is none, and every star is summed by itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from render.camera import Camera
from render.tracing.ideal_lens import IdealLens
from render.tracing.paths import at_rest
from render.tracing.planning import PupilPlanner
from render.tracing.wave_images import Trail, WaveGroup, WaveImages, WaveStamps
from render.tracing.wave_windows import FieldSampling, PixelTable, window_light, window_samples

__all__ = ["LEAST_STARS", "TOLERANCE", "WaveGrid", "build_grid"]


TOLERANCE = 1e-4
"""Largest error of a pixel [share of the light], and of the centroid in a window of 13 x 13 px [px]."""
SIZES = (5, 7, 9)
"""Points along either side that are tried."""
LEAST_STARS = 12
"""Stars on the detector from which on a grid (9 to 25 images and 5 to compare with) costs less over a few frames."""
CENTROID_PX = 6
"""Half the side of the window whose centroid is compared."""
PROBES = 5
HOPELESS = 30.0
"""How many times the tolerance the error of a coarse grid may be for a finer one to be tried."""
COMPONENT = 5e-6
"""Principal components below this part of the largest are left out."""
BEYOND = 1.02
"""How far the grid reaches beyond the detector: stars there light its edge."""


def _chebyshev(count: int) -> FloatArray:
    """Chebyshev points of the first kind in (-1, 1)."""
    return -np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _lagrange(points: FloatArray, at: FloatArray) -> FloatArray:
    """Values (n, p) at n places of the Lagrange polynomials of p points."""
    difference = points[:, None] - points
    np.fill_diagonal(difference, 1.0)
    result = np.ones((len(at), len(points)))
    for j in range(len(points)):
        for i in range(len(points)):
            if i != j:
                result[:, j] *= (at - points[i]) / difference[j, i]
    return result


@dataclass(frozen=True, slots=True, eq=False)
class WaveGrid:
    """Images over the field of one state of a lens, at some wavelengths.

    Attributes
    ----------
    camera : Camera
        The camera.
    points : (p,)
        Points along either axis of the field, in (-1, 1).
    middle, half : (2,)
        Place of the field's middle and its half size, as tangents of angles along X and Y of cam.
    radius_px : int
        Of the stamps.
    field : FieldSampling
        Sampling of the images.
    colour_px : (f, b, k, 2)
        Mean of the rays of each wavelength from that of the middle one, at the f = p^2 points.
    through : (f, b, k)
        Share of the light that gets through the lens.
    coefficient : (b, f, k, c) float32
        Components of every image.
    component : (b, c, m, m) float32
        Principal components, light per px^2.
    error, error_px : float
        Largest error found between the points, of a pixel and of a centroid.
    """

    camera: Camera
    points: FloatArray
    middle: FloatArray
    half: FloatArray
    radius_px: int
    field: FieldSampling
    colour_px: FloatArray
    through: FloatArray
    coefficient: NDArray[np.float32]
    component: NDArray[np.float32]
    error: float = math.nan
    error_px: float = math.nan

    @property
    def rays(self) -> int:
        """Number of images of a wavelength."""
        return len(self.points) ** 2

    def holds(self, direction: FloatArray) -> NDArray[np.bool_]:
        """Directions (n, 3) in cam that lie in the grid's field."""
        place = (direction[:, :2] / direction[:, 2:] - self.middle) / self.half
        return np.asarray(np.abs(place).max(1) <= 1.0)

    def stamps(
        self,
        stars: IntArray,
        direction: FloatArray,
        share: FloatArray,
        mean_px: FloatArray,
        light: FloatArray,
        trail: Trail | None = None,
    ) -> WaveStamps:
        """Stamps of some stars.

        Parameters
        ----------
        stars : (s,)
            Their numbers.
        direction : (s, 3)
            In cam.
        share : (s, b, k)
            Share of each wavelength in their light.
        mean_px : (s, b, 2)
            Means of their rays, in the middle of an exposure.
        light : (s, b)
            Share of their light that gets through the lens.
        trail : Trail, optional
            How images move; of all stars.
        """
        place = (direction[:, :2] / direction[:, 2:] - self.middle) / self.half
        column, row = (_lagrange(self.points, place[:, i]) for i in (0, 1))
        weight = (row[:, :, None] * column[:, None, :]).reshape(len(stars), -1)
        through = share * np.einsum("sf,fbk->sbk", weight, self.through)
        colour = np.einsum("sf,fbkx->sbkx", weight, self.colour_px)
        total = through.sum(2)
        with np.errstate(invalid="ignore", divide="ignore"):
            origin = mean_px - (through[..., None] * colour).sum(2) / total[..., None]
        lit = (light > 0.0) & (total > 0.0) & np.isfinite(origin).all(2)
        size = 2 * self.radius_px + 1
        middle = np.rint(np.where(lit[..., None], mean_px, 0.0))
        corner, stamp_px = middle - 0.5 * size, size
        if trail is not None:
            offset = trail.offset_px[stars]
            first = np.floor(offset.min(2))
            stamp_px = size + int((np.ceil(offset.max(2)) - first).max(initial=0.0))
            corner = corner + first
        pixels = np.zeros((len(stars), share.shape[1], stamp_px, stamp_px))
        for b in range(share.shape[1]):
            images = self._images(weight, share[:, b], b)
            images *= (light[:, b] / np.where(lit[:, b], total[:, b], 1.0) * lit[:, b])[:, None, None]
            if trail is not None:
                images *= self._disk
            shift = (origin - corner)[:, b] - 0.5 * size  # of the image's middle from where the window's would be
            where = np.where(lit[:, b, None], shift, 0.0)
            pixels[:, b] = self._pixels(images, where, stamp_px, None if trail is None else (trail, stars, b))
        if trail is None:
            steps = np.arange(size) - 0.5 * (size - 1)
            pixels *= np.hypot(steps, steps[:, None]) <= self.radius_px
            moved = mean_px
        else:
            moved = mean_px + trail.mean_px[stars]
        np.maximum(pixels, 0.0, out=pixels)
        return WaveStamps(stars, pixels, corner, moved, np.where(lit, light, 0.0), self.rays, "grid")

    def _images(self, weight: FloatArray, share: FloatArray, band: int) -> NDArray[np.float32]:
        """Light per px^2 (s, m, m) of stars in a band, of the light that is sent into the launch disk."""
        coefficient = self.coefficient[band]
        points, colours, count = coefficient.shape
        each = (weight.astype(np.float32) @ coefficient.reshape(points, -1)).reshape(-1, colours, count)
        mixed = np.einsum("sk,skc->sc", share.astype(np.float32), each)
        component = self.component[band]
        return (mixed @ component.reshape(count, -1)).reshape(-1, *component.shape[1:])

    def _pixels(
        self,
        images: NDArray[np.float32],
        shift_px: FloatArray,
        stamp_px: int,
        moving: tuple[Trail, IntArray, int] | None,
    ) -> NDArray[np.float32]:
        """Pixels (s, n, n) of images whose middle lies beside the window's by a shift (s, 2)."""
        table, size = self._table, 2 * self.radius_px + 1
        samples = window_samples(self.field, float(size), table.pad_px)
        centres = np.arange(0.5, stamp_px)
        if moving is None:
            column, row = (table(centres, samples, shift_px[:, axis]) for axis in (0, 1))
            return np.asarray((row @ images) @ np.swapaxes(column, 1, 2))
        trail, stars, band = moving
        result = np.zeros((len(images), stamp_px, stamp_px), np.float32)
        for t in range(trail.weight.shape[2]):
            at = shift_px + trail.offset_px[stars, band, t]
            column, row = (table(centres, samples, at[:, axis]) for axis in (0, 1))
            part = (row @ images) @ np.swapaxes(column, 1, 2)
            result += trail.weight[stars, band, t].astype(np.float32)[:, None, None] * part
        return result

    @property
    def _disk(self) -> NDArray[np.bool_]:
        """Samples within the radius."""
        samples = window_samples(self.field, 2.0 * self.radius_px + 1.0, self._table.pad_px) - self.radius_px - 0.5
        return np.asarray(np.hypot(samples, samples[:, None]) <= self.radius_px + 0.5)

    @property
    def _table(self) -> PixelTable:
        return self.field.table(self.camera.charge_diffusion_px)


def build_grid(planner: PupilPlanner, wavelength_nm: FloatArray) -> WaveGrid | None:
    """The coarsest grid that is good enough; None where there is none."""
    for size in SIZES:
        for mirrored in (True, False):  # what a lens of revolution makes of it, which the probes confirm or refute
            grid = _of_size(planner, wavelength_nm, size, mirrored)
            if grid is not None and grid.error < TOLERANCE and grid.error_px < TOLERANCE:
                return grid
            if grid is not None and not mirrored and max(grid.error, grid.error_px) > HOPELESS * TOLERANCE:
                return None
    return None


def _images_at(
    planner: PupilPlanner, place: FloatArray, wavelength_nm: FloatArray, share: FloatArray
) -> tuple[WaveImages, list[WaveGroup]]:
    """Images of stars whose directions have these tangents (n, 2), and how their pupils are sampled."""
    direction = np.column_stack([place, np.ones(len(place))])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    seen = planner.seen(at_rest(direction), wavelength_nm)
    chiefs = planner.chiefs(seen.mid, wavelength_nm)
    images = WaveImages(planner.camera, seen.mid, wavelength_nm, share)
    return images, planner.wave_groups(seen, wavelength_nm, chiefs, np.arange(len(place)))


def _of_size(planner: PupilPlanner, wavelength_nm: FloatArray, size: int, mirrored: bool) -> WaveGrid | None:
    """A grid with its errors; None for a lens or field without one. Mirrored: from a quarter of the field."""
    camera, points = planner.camera, _chebyshev(size)
    focal = IdealLens.of(camera).focal_px
    edges = np.array([[-0.5, -0.5], [camera.width_px - 0.5, camera.height_px - 0.5]])
    low, high = (edges - camera.centre_px) / focal
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * BEYOND + 2.0 / focal
    if mirrored and np.abs(middle).max() * focal > 1e-6:
        return None
    first = size // 2 if mirrored else 0
    place = middle + half * np.stack(np.meshgrid(points[first:], points[first:]), axis=-1).reshape(-1, 2)
    bands, colours = wavelength_nm.shape
    every = np.full((len(place), bands, colours), 1.0 / colours)
    images, groups = _images_at(planner, place, wavelength_nm, every)
    needs = images.common_needs(groups)
    if needs is None:
        return None
    radius, field = needs
    pad = field.table(camera.charge_diffusion_px).pad_px
    window = 2.0 * radius + 1.0
    count = len(window_samples(field, window, pad))
    light = np.zeros((bands, len(place), colours, count, count), np.float32)
    colour, through = np.zeros((len(place), bands, colours, 2)), np.zeros((len(place), bands, colours))
    for star, waves in images.each(groups, radius):
        mean, passed = waves.mean[0], waves.weight.sum(-1)[0]
        if not (passed > 0.0).all():
            return None
        origin = mean[:, colours // 2]
        colour[star], through[star] = mean - origin[:, None], passed
        for b in range(bands):
            for k, one in enumerate(np.eye(colours)):
                corner = origin[b] - 0.5 * window
                light[b, star, k] = window_light(waves, (0, b), one, corner, window, field, pad_px=pad)
    if mirrored:
        light, colour, through = _unfolded(light, colour, through, size)
    parts = [_components(light[b].reshape(-1, count * count)) for b in range(bands)]
    kept = max(len(component) for _, component in parts)
    coefficient = np.zeros((bands, size**2, colours, kept), np.float32)
    component = np.zeros((bands, kept, count, count), np.float32)
    for b, (values, shapes) in enumerate(parts):
        coefficient[b, ..., : len(shapes)] = values.reshape(size**2, colours, -1)
        component[b, : len(shapes)] = shapes.reshape(-1, count, count)
    grid = WaveGrid(camera, points, middle, half, radius, field, colour, through, coefficient, component)
    return _judged(planner, wavelength_nm, grid)


def _unfolded(
    light: NDArray[np.float32], colour: FloatArray, through: FloatArray, size: int
) -> tuple[NDArray[np.float32], FloatArray, FloatArray]:
    """Images, colours and light at all points from those at points of the upper quarter."""
    middle, count = size // 2, size - size // 2
    row, column = (v.ravel() for v in np.indices((size, size)))
    source = np.abs(row - middle) * count + np.abs(column - middle)
    light, colour, through = light[:, source], colour[source], through[source]
    for axis, lower in ((0, column < middle), (1, row < middle)):
        colour[lower, ..., axis] *= -1.0
        light[:, lower] = np.flip(light[:, lower], axis=4 - axis)
    return light, colour, through


def _components(images: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Coefficients (n, c) and orthonormal components (c, m) of images (n, m)."""
    exact = images.astype(np.float64)
    square, vectors = np.linalg.eigh(exact @ exact.T)
    size = np.sqrt(np.maximum(square, 0.0))
    keep = np.flatnonzero(size > COMPONENT * size[-1])
    turned = vectors[:, keep].astype(np.float32)
    return turned * size[keep].astype(np.float32), (turned.T @ images) / size[keep].astype(np.float32)[:, None]


def _judged(planner: PupilPlanner, wavelength_nm: FloatArray, grid: WaveGrid) -> WaveGrid | None:
    """The grid with its errors at places between its points, for the bluest and the reddest light and for both."""
    bands, colours = wavelength_nm.shape
    golden = 0.6180339887498949
    steps = np.arange(1, PROBES + 1)
    place = np.stack([2.0 * ((0.5 + golden * steps) % 1.0) - 1.0, 2.0 * (steps - 0.5) / PROBES - 1.0], axis=-1)
    place = grid.middle + grid.half * place / BEYOND
    kinds = np.zeros((3, colours))
    kinds[0, 0], kinds[1, -1], kinds[2] = 1.0, 1.0, 1.0 / colours
    places, kind = np.repeat(place, 3, axis=0), np.tile(np.arange(3), PROBES)
    share = np.repeat(kinds[kind][:, None], bands, axis=1)
    images, groups = _images_at(planner, places, wavelength_nm, share)
    direction = np.column_stack([places, np.ones(len(places))])
    worst = worst_px = 0.0
    for group in groups:
        for exact in images.stamps(group, float(grid.radius_px)):
            if not np.isfinite(exact.mean_px).all():
                return None
            stars = exact.stars
            ours = grid.stamps(stars, direction[stars], share[stars], exact.mean_px, exact.light)
            error = (ours.pixels - exact.pixels) / exact.light[..., None, None]
            worst = max(worst, float(np.abs(error).max(initial=0.0)))
            offset = np.arange(error.shape[-1]) - 0.5 * (error.shape[-1] - 1)
            error *= np.maximum(np.abs(offset), np.abs(offset[:, None])) <= CENTROID_PX
            first = np.stack([(error * offset).sum((2, 3)), (error * offset[:, None]).sum((2, 3))])
            worst_px = max(worst_px, float(np.abs(first).max(initial=0.0)))
    return WaveGrid(
        grid.camera,
        grid.points,
        grid.middle,
        grid.half,
        grid.radius_px,
        grid.field,
        grid.colour_px,
        grid.through,
        grid.coefficient,
        grid.component,
        worst,
        worst_px,
    )
