"""Diffraction images of single stars by sums of plane waves: required rays, stamps, light outside the stamps.

Every star has a stamp of its own size, a disk of pixels about the centroid. Beyond it a pixel would hold less than
`WING` of the light, by the mean decay of the rings of a round pupil, lambda N / (pi^3 r^3) per pixel. The number of
rays follows from the phase differences of neighbouring rays at the rim of that disk (rule in
`optics.waves.pupil_field`). Light beyond the disk is accounted for and not rendered.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.waves.pupil_field import LARGEST_APERTURE
from render.tracing.pupil.planning import Group, PlannedExposure, PupilPlanner
from render.tracing.pupil.points import DiskPoints, covered_points
from render.tracing.truth import RayMoments, WaveStamps
from render.tracing.waves.frequency_grid import image_products, window_light
from render.tracing.waves.pixel_kernel import FieldSampling, window_samples
from render.tracing.waves.plane_waves import (
    PlaneWaves,
    RayArrays,
    WaveSeries,
    azimuths,
    hidden_points,
    nodes_along,
    phase_changes,
    trace_waves,
)

WING = 2e-5
"""Fraction of a star's light in a pixel below which a stamp ends."""
NEAREST_PX = 4.0
"""Least distance of a stamp's edge from the rays."""
MARGIN_PX = 1.7
"""Distance beyond the edge up to which light is accurate, for pixels at the edge and for the corners of usual PSFs."""
MOST_CACHED = 256
"""Images whose light is cached."""
PROBE_ORDER = (12, 40)
MOST_RAYS = 1 << 17
"""Rays of one star, band and wavelength."""
LARGEST_RADIUS_PX = 100
BATCH_LANES = 1 << 22
COVERED_ORDER = (96, 384)
CELL_LATTICE = (34, 21)
"""Points of a cell that determine its transmitted fraction, and their generator."""
LOST_LIGHT = 1e-12
"""Fraction of a star's light below which none is lost inside an outline."""
ROUNDING = 0.05
"""Steps of the highest frequency [cycles/px], so that few tables are needed."""


@dataclass(frozen=True, slots=True)
class Probe:
    """Few rays of some stars of a group, from which the required number follows."""

    group: Group
    stars: IntArray
    waves: PlaneWaves


@dataclass(frozen=True, slots=True)
class Summands:
    """Waves of s stars with one kind of sum: traced ones, or series from which any number of waves follows."""

    stars: IntArray  # (s,)
    waves: PlaneWaves  # Traced; the stars' mean, light and variance are theirs
    radius_px: float  # Of the stamps
    fields: tuple[FieldSampling, ...]  # Sampling of the light in every band
    order: IntArray  # (s, b, k, 2) Rings and azimuths of the sum
    mode: str  # How the pupils were sampled
    series: WaveSeries | None  # Of the same waves

    def light(
        self, at: tuple[int, int], spectrum: FloatArray, corner_px: FloatArray, window_px: float, pad_px: float
    ) -> NDArray[np.float32]:
        """Light of one star and band on samples of a window (`render.tracing.waves.frequency_grid.window_light`)."""
        return window_light(partial(self._rays, at), spectrum, corner_px, window_px, self.fields[at[1]], pad_px=pad_px)

    def _rays(self, at: tuple[int, int], colour: int) -> RayArrays:
        """Rays of one star, band and wavelength."""
        if self.series is None:
            return self.waves.rays(at, colour)
        count, arms = self.order[*at, colour].tolist()
        return self.series.rays(at, (count, arms), colour)


@dataclass(frozen=True, slots=True, eq=False)
class LightSamples:
    """Light of one star in a band, sampled about the mean of all of it."""

    values: NDArray[np.float32]  # (i, i) Light per px^2, rows first
    offset_px: FloatArray  # (i,) Columns and rows from the mean
    field: FieldSampling
    reach_px: float  # Distance from the mean up to which it is accurate


LightCache = dict[tuple[bytes, bytes, int], LightSamples]
"""By direction, weights of wavelengths and band."""


@dataclass(frozen=True, slots=True)
class Trail:
    """Motion of n stars' images during an exposure; a whole image moves with its chief ray."""

    offset_px: FloatArray  # (n, b, t, 2) From the position in the middle of the exposure
    weight: FloatArray  # (n, b, t) Fraction of the light at each time, sum 1

    @property
    def mean_px(self) -> FloatArray:
        """Mean offset (n, b, 2)."""
        return np.asarray((self.weight[..., None] * self.offset_px).sum(2))

    def along(self, rays: RayMoments, stars: IntArray) -> RayMoments:
        """Moments of the rays of some stars over an exposure, from those in the middle of it."""
        offset, weight = self.offset_px[stars], self.weight[stars][..., None]
        mean = (weight * offset).sum(2)
        variance = (weight * offset**2).sum(2) - mean**2
        return RayMoments(rays.mean_px + mean, rays.variance_px2 + variance, rays.entrance)

    def room(self, stars: IntArray) -> tuple[FloatArray, int]:
        """Whole pixels (s, b, 2) from the windows of some stars to their stamps, and how much larger these are."""
        offset = self.offset_px[stars]
        first = np.floor(offset.min(2))
        return first, int((np.ceil(offset.max(2)) - first).max(initial=0.0))


class DirectSums:
    """Images of the stars of an exposure, at rest, by sums of plane waves.

    ``spectrum`` (n, b, k) is the weight of each wavelength in a star's light, sum 1. `stamps` add to the ``cache`` of
    light, from which `cells` take.
    """

    def __init__(
        self, planner: PupilPlanner, still: PlannedExposure, spectrum: FloatArray, trail: Trail | None = None
    ) -> None:
        self.planner, self.still, self.spectrum, self.trail = planner, still, spectrum, trail
        self.camera, self.kernel, self.wavelength_nm = planner.camera, still.mid, still.wavelength_nm
        self.cache: LightCache = {}
        self.index = np.asarray(self.camera.focused_lens.indices(self.wavelength_nm)[-1])

    def stamps(self, group: Group, radius_px: float | None = None) -> Iterator[WaveStamps]:
        """Stamps of the stars of a group, in batches; stars with rays lost inside an outline are sampled by cells.

        Each has a radius of its own if none is given.
        """
        for probe in self.probes(group):
            for summands in self.summands(probe, radius_px):
                yield self._stamps(summands)

    def room_px(self, stars: IntArray) -> int:
        """Width of stamps of some stars beyond their disks [px], for the motion of the images."""
        return 0 if self.trail is None else self.trail.room(stars)[1]

    def cells(self, group: Group, half_size_px: int, cells_per_px: int) -> Iterator[tuple[IntArray, FloatArray]]:
        """Stars, and their light per cell (s, b, m, m) of a square about the centroid over what gets through."""
        window = 2.0 * half_size_px + 1.0
        count = (2 * half_size_px + 1) * cells_per_px
        centres = (np.arange(count) + 0.5) / cells_per_px - 0.5 * window
        for probe in self.probes(group):
            for summands in self.summands(probe, math.sqrt(0.5) * window):
                mean, light = self.means(summands.stars, summands.waves)
                cells = np.empty((*mean.shape[:2], count, count))
                for at in np.ndindex(*mean.shape[:2]):
                    image = self.cache.get(self._key(int(summands.stars[at[0]]), at[1]))
                    if image is None or image.reach_px < math.sqrt(0.5) * window:
                        image = self._window_light(summands, at, mean[at], window, 1.0 / cells_per_px)
                    kernel = image.field.pixel(1.0 / cells_per_px, self.camera.blur_px)
                    matrix = kernel(centres[:, None] - image.offset_px) * image.field.light_step
                    with np.errstate(invalid="ignore"):
                        cells[at] = (matrix @ image.values @ matrix.T) / light[at]
                yield summands.stars, cells

    def probes(self, group: Group) -> Iterator[Probe]:
        """Few rays of the stars of a group, in batches; last the stars whose outlines contain obscurations.

        Such as that of a hole or a spider; they are sampled by cells.
        """
        obscured = [group.members[:0]]
        for stars in self._batches(group.members, PROBE_ORDER):
            waves = self._traced(group, PROBE_ORDER, stars)
            clear = np.ones(len(stars), np.bool_) if group.points is None else waves.lost.max((1, 2)) <= LOST_LIGHT
            if clear.any():
                yield Probe(group, stars[clear], waves if clear.all() else waves.take(clear))
            obscured.append(stars[~clear])
        by_cells = np.concatenate(obscured)
        if len(by_cells):
            yield from self.probes(Group("cells", by_cells, None))

    def summands(self, probe: Probe, radius_px: float | None = None) -> Iterator[Summands]:
        """Waves of the stars of a probe for their sums, stars with equal stamps and sampling together."""
        group, waves = probe.group, probe.waves
        radius, highest, order = self.needs(probe, radius_px)
        series = None if group.turns is None else WaveSeries.of(waves, PROBE_ORDER, group.turns(PROBE_ORDER[0]))
        resolved = np.zeros(len(radius), np.bool_) if series is None else series.resolved
        keys = list(zip(radius.tolist(), map(tuple, highest.tolist()), resolved.tolist(), strict=True))
        for key in sorted(set(keys)):
            equal = np.array([other == key for other in keys])
            stars, fields, orders = probe.stars[equal], tuple(map(self.sampling, key[1])), order[equal]
            if series is not None and key[2]:
                yield Summands(stars, waves.take(equal), key[0], fields, orders, group.mode, series.take(equal))
                continue
            for most in np.unique(orders.max((1, 2)), axis=0):
                count, arms = most.tolist()
                for part in self._batches(stars[(orders.max((1, 2)) == most).all(1)], (count, arms)):
                    traced = self._traced(group, (count, arms), part)
                    common = np.broadcast_to(most, (len(part), *orders.shape[1:]))
                    yield Summands(part, traced, key[0], fields, common, group.mode, None)

    def image_products(self, probe: Probe) -> float:
        """Mean cost of an image of one star, band and wavelength (`render.tracing.waves.frequency_grid`)."""
        radius, highest, order = self.needs(probe)
        field, window = self.sampling(float(highest.max())), 2.0 * float(radius.max()) + 1.0
        pad = field.pixel(1.0, self.camera.blur_px).reach_px
        return image_products(float(order.prod(-1).mean()), field, window, pad)

    def common_needs(self, probes: list[Probe]) -> tuple[int, FieldSampling]:
        """Radius [px] and sampling that serve all stars of probes."""
        needs = [self.needs(probe) for probe in probes]
        radius, highest = (max(float(need[i].max()) for need in needs) for i in (0, 1))
        return int(radius), self.sampling(highest)

    def sampling(self, highest: float) -> FieldSampling:
        """Sampling of light with this highest frequency [cycles/px]."""
        return FieldSampling.of(highest, self.camera.blur_px)

    def _batches(self, stars: IntArray, order: tuple[int, int]) -> Iterator[IntArray]:
        """Stars, as many at a time as may be traced together."""
        step = max(1, BATCH_LANES // (3 * math.prod(order) * self.wavelength_nm.size))
        return (stars[i : i + step] for i in range(0, len(stars), step))

    def needs(self, probe: Probe, radius_px: float | None = None) -> tuple[FloatArray, FloatArray, IntArray]:
        """Radius of the stamp (s,) [px], highest frequency (s, b) [cycles/px], order of the quadrature (s, b, k, 2)."""
        waves, stars = probe.waves, probe.stars
        self._check_aperture(waves)
        spot = waves.spot_px
        rings = (1.0 / (waves.lowest_cutoff * math.pi**3 * WING)) ** (1.0 / 3.0)
        radius = np.ceil(np.maximum(rings, spot + NEAREST_PX)) if radius_px is None else np.full(len(stars), radius_px)
        self._check_size(stars, spot, radius)
        radial, around = phase_changes(waves, PROBE_ORDER, radius + MARGIN_PX)
        order = np.stack([nodes_along(radial), azimuths(around)], axis=-1)
        rounded: IntArray = 4 * np.ceil(order / 4.0).astype(np.int64)
        if probe.group.points is None:
            rounded = np.maximum(rounded, COVERED_ORDER)
        self._check_order(stars, rounded.max((1, 2)), spot)
        return radius.astype(np.float64), ROUNDING * np.ceil(1.03 * waves.highest / ROUNDING), rounded

    def _traced(self, group: Group, order: tuple[int, int], stars: IntArray) -> PlaneWaves:
        which = stars.astype(np.uint32)
        if group.points is not None:
            return trace_waves(self.kernel, group.points(order, stars), self.wavelength_nm, self.index, which)
        nodes, disks = self.wavelength_nm.shape[1], self.planner.disks(self.still, self.wavelength_nm, stars)
        cells, fine = (DiskPoints(covered_points(order, nodes, v), *disks) for v in ((1, 1), CELL_LATTICE))
        arrived = self.kernel.land(fine, self.wavelength_nm, which)[2]
        if self.still.shade is not None:
            visible = DiskPoints(fine.points, disks[0][:, :1], disks[1][:, :1])  # the same disk in all bands
            arrived = arrived & ~hidden_points(self.kernel, self.still.shade, visible, which)[:, None, None]
        coverage = arrived.reshape(*arrived.shape[:3], cells.count, -1).mean(-1)
        return trace_waves(self.kernel, cells, self.wavelength_nm, self.index, which, coverage)

    def means(self, stars: IntArray, waves: PlaneWaves) -> tuple[FloatArray, FloatArray]:
        """Centroid (s, b, 2) of all light, and the fraction that gets through (s, b)."""
        through = self.spectrum[stars] * waves.weight.sum(-1)
        light = through.sum(2)
        with np.errstate(invalid="ignore"):
            mean = (through[..., None] * np.nan_to_num(waves.mean)).sum(2) / light[..., None]
        return mean, light

    def _variance(self, stars: IntArray, waves: PlaneWaves, mean: FloatArray) -> FloatArray:
        """Variance (s, b, 2) of the landing points of all wavelengths about their mean."""
        weight = self.spectrum[stars][..., None] * waves.weight
        with np.errstate(invalid="ignore"):
            sums = [
                (weight * (v - mean[:, :, None, None, i]) ** 2).sum((2, 3)) for i, v in enumerate((waves.x, waves.y))
            ]
            return np.asarray(np.stack(sums, axis=-1) / weight.sum((2, 3))[..., None])

    def _stamps(self, summands: Summands) -> WaveStamps:
        stars, waves, mode = summands.stars, summands.waves, summands.mode
        (mean, light), size = self.means(stars, waves), 2 * int(summands.radius_px) + 1
        window = np.rint(np.nan_to_num(mean)) - 0.5 * size
        first, more = (0.0, 0) if self.trail is None else self.trail.room(stars)
        corner, stamp_px = window + first, size + more
        pixels = np.zeros((*light.shape, stamp_px, stamp_px))
        for s, b in np.argwhere(light > 0.0).tolist():
            image = self._window_light(summands, (s, b), mean[s, b], float(size), 1.0)
            if len(self.cache) < MOST_CACHED:
                self.cache[self._key(int(stars[s]), b)] = image
            shift = mean[s, b] - window[s, b] - 0.5 * size
            if self.trail is None:
                pixels[s, b] = self._still(image, shift, size)
            else:
                trail = self.trail.offset_px[stars[s], b], self.trail.weight[stars[s], b]
                pixels[s, b] = self._moving(image, shift, size, *trail, stamp_px)
        rays = RayMoments(mean, self._variance(stars, waves, mean))
        rays = rays if self.trail is None else self.trail.along(rays, stars)
        moments = None if mode == "cells" else rays
        count = int(summands.order.prod(-1).max())
        clear = (self.spectrum[stars] * waves.clear).sum(2)
        return WaveStamps(stars, np.maximum(pixels, 0.0), corner, rays.mean_px, light, count, mode, moments, clear)

    def _window_light(
        self, summands: Summands, at: tuple[int, int], mean_px: FloatArray, window_px: float, box_px: float
    ) -> LightSamples:
        """Light of a window about the mean of all of it, with a margin for boxes anywhere in it."""
        field = summands.fields[at[1]]
        pad = field.pixel(box_px, self.camera.blur_px).reach_px
        spectrum = self.spectrum[summands.stars[at[0]], at[1]]
        image = summands.light(at, spectrum, mean_px - 0.5 * window_px, window_px, pad)
        offset = window_samples(field, window_px, pad) - 0.5 * window_px
        return LightSamples(image, offset, field, summands.radius_px + MARGIN_PX)

    def _key(self, star: int, band: int) -> tuple[bytes, bytes, int]:
        """Key of a star's light in a band, rounded."""
        return self.kernel.direction[star].round(13).tobytes(), self.spectrum[star, band].round(10).tobytes(), band

    def _still(self, light: LightSamples, shift_px: FloatArray, size: int) -> FloatArray:
        """Pixels of a disk in a window whose middle is off the mean of the light."""
        kernel = light.field.pixel(1.0, self.camera.blur_px)
        centres = np.arange(0.5, size) - 0.5 * size
        column, row = (
            (kernel((centres - d)[:, None] - light.offset_px) * light.field.light_step).astype(light.values.dtype)
            for d in shift_px
        )
        disk = np.hypot(centres, centres[:, None]) <= 0.5 * (size - 1)
        return np.asarray((row @ light.values @ column.T) * disk, np.float64)

    def _moving(
        self,
        light: LightSamples,
        shift_px: FloatArray,
        size: int,
        offset_px: FloatArray,
        weight: FloatArray,
        stamp_px: int,
    ) -> FloatArray:
        """Pixels of the same disk along a trail."""
        kernel = light.field.pixel(1.0, self.camera.blur_px)
        column_px, row_px = (light.offset_px + d for d in shift_px)
        image = light.values * (np.hypot(column_px, row_px[:, None]) <= 0.5 * size)
        centres = np.arange(0.5, stamp_px) - 0.5 * size + np.floor(offset_px.min(0))[:, None]
        column, row = (
            kernel(centres[axis][:, None] - samples - offset_px[:, axis, None, None]) * light.field.light_step
            for axis, samples in enumerate((column_px, row_px))
        )
        column, row = column.astype(image.dtype), (row * weight[:, None, None]).astype(image.dtype)
        return np.asarray(((row @ image) @ np.swapaxes(column, 1, 2)).sum(0), np.float64)

    def _check_aperture(self, waves: PlaneWaves) -> None:
        """Refuse light so fast that the scalar theory fails."""
        pitch_nm = self.camera.pixel_pitch_mm * 1e6
        sine = float((0.5 * waves.spans() * (self.wavelength_nm / pitch_nm)).max(initial=0.0))
        if sine > LARGEST_APERTURE:
            raise DomainError(
                f"light converges at F/{0.5 / sine:.2f}; the scalar theory of diffraction is used up to F/"
                f"{0.5 / LARGEST_APERTURE:.2f}; set diffraction = 'rays' for this lens"
            )

    def _check_size(self, stars: IntArray, spot_px: FloatArray, radius_px: FloatArray) -> None:
        worst = int(np.argmax(radius_px))
        if radius_px[worst] > LARGEST_RADIUS_PX:
            raise DomainError(
                f"the rays of star {stars[worst]} land up to {spot_px[worst]:.0f} px from their mean; diffraction is "
                f"rendered in stamps of at most {LARGEST_RADIUS_PX} px radius; check the focus (defocus_mm = "
                f"{self.camera.defocus_mm:g} mm), or set diffraction = 'rays', which suffices for such images"
            )

    def _check_order(self, stars: IntArray, order: IntArray, spot_px: FloatArray) -> None:
        worst = int(np.argmax(order.prod(1)))
        if order[worst].prod() > MOST_RAYS:
            raise DomainError(
                f"the wavefront of star {stars[worst]} needs {order[worst, 0]} rings x {order[worst, 1]} azimuths of "
                f"the pupil ({spot_px[worst]:.0f} px of blur); at most {MOST_RAYS} rays are traced; check the focus "
                f"(defocus_mm = {self.camera.defocus_mm:g} mm), or set diffraction = 'rays', which is right for such "
                "images"
            )
