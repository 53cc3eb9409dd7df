"""Diffraction images of single stars: required rays, stamps, and light outside the stamps.

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
from render.tracing.pupil.planning import Exposure, Group, PupilPlanner
from render.tracing.pupil.points import DiskPoints, covered_points
from render.tracing.truth import RayMoments, WaveStamps
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
from render.tracing.waves.windows import FieldSampling, image_s, window_light, window_samples, window_terms

WING = 2e-5
"""Share of a star's light in a pixel below which a stamp ends."""
NEAREST_PX = 4.0
"""Least distance of a stamp's edge from the rays."""
MARGIN_PX = 1.7
"""How far beyond it light has to be right for pixels at the edge, and for the corners of usual PSFs."""
MOST_KEPT = 256
"""Images whose light is kept."""
PROBE_ORDER = (12, 40)
MOST_RAYS = 1 << 17
"""Rays of one star, band and wavelength."""
LARGEST_RADIUS_PX = 100
BATCH_LANES = 1 << 22
COVERED_ORDER = (96, 384)
CELL_LATTICE = (34, 21)
"""Points of a cell that give its transmitted part, and their generator."""
LIGHT = 1e-12
"""Share of a star's light below which none is lost inside an outline."""
ROUNDING = 0.05
"""Steps of the highest frequency [cycles/px], so that few tables are needed."""


@dataclass(frozen=True, slots=True)
class Probe:
    """Few rays of some stars of a group, from which the needed number follows."""

    group: Group
    stars: IntArray
    waves: PlaneWaves


@dataclass(frozen=True, slots=True)
class Summands:
    """Waves of some stars that are summed alike: traced ones, or series from which as many follow as are needed."""

    stars: IntArray  # (s,) Which
    waves: PlaneWaves  # Traced; the stars' mean, light and variance are theirs
    radius_px: float  # Of the stamps
    fields: tuple[FieldSampling, ...]  # How light is sampled, in every band
    order: IntArray  # (s, b, k, 2) Rings and azimuths of the sum
    mode: str  # How the pupils were sampled
    series: WaveSeries | None  # Of the same waves

    def light(
        self, at: tuple[int, int], shares: FloatArray, corner_px: FloatArray, window_px: float, pad_px: float
    ) -> NDArray[np.float32]:
        """Light of one star and band on samples of a window (`render.tracing.waves.windows.window_light`)."""
        return window_light(partial(self._rays, at), shares, corner_px, window_px, self.fields[at[1]], pad_px=pad_px)

    def _rays(self, at: tuple[int, int], colour: int) -> RayArrays:
        """Rays of one star, band and wavelength."""
        if self.series is None:
            return self.waves.rays(at, colour)
        count, arms = self.order[*at, colour].tolist()
        return self.series.rays(at, (count, arms), colour)


@dataclass(frozen=True, slots=True, eq=False)
class StarLight:
    """Light of one star in a band about the mean of all of it."""

    values: NDArray[np.float32]  # (i, i) Light per px^2, rows first
    place_px: FloatArray  # (i,) Columns and rows from the mean
    field: FieldSampling  # How it is sampled
    reach_px: float  # As far from the mean it is what the pupil makes


KeptLight = dict[tuple[bytes, bytes, int], StarLight]
"""By direction, shares of wavelengths and band."""


@dataclass(frozen=True, slots=True)
class Trail:
    """Motion of n stars' images during an exposure."""

    offset_px: FloatArray  # (n, b, t, 2) From where they are in the middle of it; the whole image moves alike
    weight: FloatArray  # (n, b, t) Share of the light at each time, sum 1

    @property
    def mean_px(self) -> FloatArray:
        """Mean offset (n, b, 2)."""
        return np.asarray((self.weight[..., None] * self.offset_px).sum(2))

    @property
    def variance_px2(self) -> FloatArray:
        """Variance of the offset (n, b, 2)."""
        return np.asarray((self.weight[..., None] * self.offset_px**2).sum(2) - self.mean_px**2)

    def along(self, rays: RayMoments, stars: IntArray) -> RayMoments:
        """Moments of the rays of some stars over an exposure, from those in the middle of it."""
        mean, variance = self.mean_px[stars], self.variance_px2[stars]
        return RayMoments(rays.mean_px + mean, rays.variance_px2 + variance, rays.entrance)

    def room(self, stars: IntArray) -> tuple[FloatArray, int]:
        """Whole pixels (s, b, 2) from the windows of some stars to their stamps, and how much larger these are."""
        offset = self.offset_px[stars]
        first = np.floor(offset.min(2))
        return first, int((np.ceil(offset.max(2)) - first).max(initial=0.0))


class SummedImages:
    """Images of the stars of an exposure, at rest, by sums of plane waves.

    ``share`` (n, b, k) of each wavelength in a star's light has sum 1. ``kept`` is light of stars that is known, to
    which `stamps` add and from which `cells` take.
    """

    def __init__(self, planner: PupilPlanner, still: Exposure, share: FloatArray, trail: Trail | None = None) -> None:
        self.planner, self.still, self.share, self.trail = planner, still, share, trail
        self.camera, self.kernel, self.wavelength_nm = planner.camera, still.mid, still.wavelength_nm
        self.kept: KeptLight = {}
        self.index = np.asarray(self.camera.focused_lens.indices(self.wavelength_nm)[-1])

    def stamps(self, group: Group, radius_px: float | None = None) -> Iterator[WaveStamps]:
        """Stamps of the stars of a group, in batches; stars whose rays are lost inside an outline go by cells.

        Each has a radius of its own if none is given.
        """
        for probe in self.probes(group):
            for summands in self.summands(probe, radius_px):
                yield self._stamps(summands)

    def room_px(self, stars: IntArray) -> int:
        """Width of stamps of some stars beyond their disks [px], for the motion of the images."""
        return 0 if self.trail is None else self.trail.room(stars)[1]

    def cells(
        self, group: Group, half_size_px: int, cells_per_px: int
    ) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
        """Stars, their light per cell (s, b, m, m) of a square about the centroid, in shares of what gets through."""
        window = 2.0 * half_size_px + 1.0
        count = (2 * half_size_px + 1) * cells_per_px
        edges = (np.arange(count) + 0.5) / cells_per_px - 0.5 * window
        for probe in self.probes(group):
            for summands in self.summands(probe, math.sqrt(0.5) * window):
                mean, light = self.means(summands.stars, summands.waves)
                result = np.empty((*mean.shape[:2], count, count))
                for at in np.ndindex(*mean.shape[:2]):
                    star = int(summands.stars[at[0]])
                    image = self.kept.get(self._key(star, at[1]))
                    if image is None or image.reach_px < math.sqrt(0.5) * window:
                        image = self._window_light(summands, at, mean[at], window, 1.0 / cells_per_px)
                    kernel = image.field.pixel(1.0 / cells_per_px, self.camera.blur_px)
                    matrix = kernel(edges[:, None] - image.place_px) * image.field.light_step
                    with np.errstate(invalid="ignore"):
                        result[at] = (matrix @ image.values @ matrix.T) / light[at]
                yield summands.stars, result, mean

    def probes(self, group: Group) -> Iterator[Probe]:
        """Few rays of the stars of a group, in batches; last the stars whose outlines contain obscurations.

        Such as that of a hole or a spider; they go by cells.
        """
        pierced = []
        for stars, waves in self.traced(group, PROBE_ORDER):
            clear = np.ones(len(stars), np.bool_) if group.points is None else waves.lost.max((1, 2)) <= LIGHT
            if clear.any():
                yield Probe(group, stars[clear], waves if clear.all() else waves.take(clear))
            pierced.append(stars[~clear])
        left = np.concatenate(pierced) if pierced else group.members[:0]
        if len(left):
            yield from self.probes(Group("cells", left, None))

    def traced(self, group: Group, order: tuple[int, int]) -> Iterator[tuple[IntArray, PlaneWaves]]:
        """Stars of a group, in batches, and their rays on a number of rings and azimuths."""
        return ((stars, self._traced(group, order, stars)) for stars in self._batches(group.members, order))

    def summands(self, probe: Probe, radius_px: float | None = None) -> Iterator[Summands]:
        """Waves of the stars of a probe as sums need them, those together that are alike."""
        group, waves = probe.group, probe.waves
        radius, field, order = self.needs(probe, radius_px)
        series = None if group.turns is None else WaveSeries.of(waves, PROBE_ORDER, group.turns(PROBE_ORDER[0]))
        resolved = np.zeros(len(radius), np.bool_) if series is None else series.resolved
        keys = list(zip(radius.tolist(), map(tuple, field.tolist()), resolved.tolist(), strict=True))
        for key in sorted(set(keys)):
            alike = np.array([one == key for one in keys])
            fields, few = tuple(self.sampling(one) for one in key[1]), order[alike]
            if key[2]:
                assert series is not None
                yield Summands(
                    probe.stars[alike], waves.take(alike), key[0], fields, few, group.mode, series.take(alike)
                )
                continue
            for most in np.unique(few.max((1, 2)), axis=0):
                stars = probe.stars[alike][(few.max((1, 2)) == most).all(1)]
                count, arms = most.tolist()
                for part in self._batches(stars, (count, arms)):
                    traced = self._traced(group, (count, arms), part)
                    every = np.broadcast_to(most, (len(part), *few.shape[1:]))
                    yield Summands(part, traced, key[0], fields, every, group.mode, None)

    def image_s(self, probe: Probe) -> float:
        """Processor time of an image of one star, band and wavelength by itself, on a usual machine: a mean."""
        radius, highest, order = self.needs(probe)
        field, window = self.sampling(float(highest.max())), 2.0 * float(radius.max()) + 1.0
        pad = field.pixel(1.0, self.camera.blur_px).reach_px
        return image_s(float(order.prod(-1).mean()), window_terms(field, window, pad))

    def common_needs(self, probes: list[Probe]) -> tuple[int, FieldSampling]:
        """Radius [px] and sampling that serve all stars of probes."""
        needs = [self.needs(probe) for probe in probes]
        radius, highest = (max(float(one[i].max()) for one in needs) for i in (0, 1))
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
        cells, fine = (DiskPoints(covered_points(order, nodes, one), *disks) for one in ((1, 1), CELL_LATTICE))
        arrived = self.kernel.land(fine, self.wavelength_nm, which)[2]
        if self.still.shade is not None:
            seen = DiskPoints(fine.points, disks[0][:, :1], disks[1][:, :1])  # the same disk in all bands
            arrived = arrived & ~hidden_points(self.kernel, self.still.shade, seen, which)[:, None, None]
        coverage = arrived.reshape(*arrived.shape[:3], cells.count, -1).mean(-1)
        return trace_waves(self.kernel, cells, self.wavelength_nm, self.index, which, coverage)

    def means(self, stars: IntArray, waves: PlaneWaves) -> tuple[FloatArray, FloatArray]:
        """Centroid (s, b, 2) of all light, and the share that gets through (s, b)."""
        through = self.share[stars] * waves.weight.sum(-1)
        light = through.sum(2)
        with np.errstate(invalid="ignore"):
            mean = (through[..., None] * np.nan_to_num(waves.mean)).sum(2) / light[..., None]
        return mean, light

    def _variance(self, stars: IntArray, waves: PlaneWaves, mean: FloatArray) -> FloatArray:
        """Variance (s, b, 2) of the landing points of all wavelengths about their mean."""
        weight = self.share[stars][..., None] * waves.weight
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
            if len(self.kept) < MOST_KEPT:
                self.kept[self._key(int(stars[s]), b)] = image
            shift = mean[s, b] - window[s, b] - 0.5 * size
            if self.trail is None:
                pixels[s, b] = self._still(image, shift, size)
            else:
                way = self.trail.offset_px[stars[s], b], self.trail.weight[stars[s], b]
                pixels[s, b] = self._moving(image, shift, size, *way, stamp_px)
        rays = RayMoments(mean, self._variance(stars, waves, mean))
        rays = rays if self.trail is None else self.trail.along(rays, stars)
        kept = None if mode == "cells" else rays
        count = int(summands.order.prod(-1).max())
        clear = (self.share[stars] * waves.clear).sum(2)
        return WaveStamps(stars, np.maximum(pixels, 0.0), corner, rays.mean_px, light, count, mode, kept, clear)

    def _window_light(
        self, summands: Summands, at: tuple[int, int], mean_px: FloatArray, window_px: float, box_px: float
    ) -> StarLight:
        """Light of a window about the mean of all of it, with a margin for boxes anywhere in it."""
        field = summands.fields[at[1]]
        pad = field.pixel(box_px, self.camera.blur_px).reach_px
        share = self.share[summands.stars[at[0]], at[1]]
        image = summands.light(at, share, mean_px - 0.5 * window_px, window_px, pad)
        place = window_samples(field, window_px, pad) - 0.5 * window_px
        return StarLight(image, place, field, summands.radius_px + MARGIN_PX)

    def _key(self, star: int, band: int) -> tuple[bytes, bytes, int]:
        """What tells a star's light in a band from that of others, but for rounding."""
        return self.kernel.direction[star].round(13).tobytes(), self.share[star, band].round(10).tobytes(), band

    def _still(self, light: StarLight, shift_px: FloatArray, size: int) -> FloatArray:
        """Pixels of a disk in a window whose middle is off the mean of the light."""
        kernel = light.field.pixel(1.0, self.camera.blur_px)
        centres = np.arange(0.5, size) - 0.5 * size
        column, row = (
            (kernel((centres - d)[:, None] - light.place_px) * light.field.light_step).astype(light.values.dtype)
            for d in shift_px
        )
        disk = np.hypot(centres, centres[:, None]) <= 0.5 * (size - 1)
        return np.asarray((row @ light.values @ column.T) * disk, np.float64)

    def _moving(
        self, light: StarLight, shift_px: FloatArray, size: int, moves_px: FloatArray, weight: FloatArray, stamp_px: int
    ) -> FloatArray:
        """Pixels of the same disk along a trail."""
        kernel = light.field.pixel(1.0, self.camera.blur_px)
        column_px, row_px = (light.place_px + d for d in shift_px)
        image = light.values * (np.hypot(column_px, row_px[:, None]) <= 0.5 * size)
        centres = np.arange(0.5, stamp_px) - 0.5 * size + np.floor(moves_px.min(0))[:, None]
        column, row = (
            kernel(centres[axis][:, None] - place - moves_px[:, axis, None, None]) * light.field.light_step
            for axis, place in enumerate((column_px, row_px))
        )
        column, row = column.astype(image.dtype), (row * weight[:, None, None]).astype(image.dtype)
        return np.asarray(((row @ image) @ np.swapaxes(column, 1, 2)).sum(0), np.float64)

    def _check_aperture(self, waves: PlaneWaves) -> None:
        """Refuse light so fast that the scalar theory fails."""
        pitch_nm = self.camera.pixel_pitch_mm * 1e6
        sine = float((0.5 * waves._spans() * (self.wavelength_nm / pitch_nm)).max(initial=0.0))
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
