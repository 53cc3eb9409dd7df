"""Diffraction images of stars: which rays they need, their stamps, and what of their light these hold.

Every star has a stamp of its own size, a disk of pixels about the centroid: so far out that a pixel beyond would hold
less than `WING` of the light, by the mean fall of the rings of a round pupil, lambda N / (pi^3 r^3) per pixel. The
number of rays follows from the phases between neighbouring ones at the rim of that disk (`optics.waves.pupil_field`
has the rule); light beyond the disk is accounted for and not rendered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.waves.pupil_field import LARGEST_APERTURE
from render.camera import Camera
from render.tracing.kernel import Shade, StarKernel
from render.tracing.plane_waves import PlaneWaves, hidden_points, phase_changes, trace_waves
from render.tracing.pupil_points import DiskPoints, PupilPoints, TablePoints
from render.tracing.wave_windows import FieldSampling, window_light, window_samples

__all__ = ["WING", "RayMoments", "Trail", "WaveGroup", "WaveImages", "WaveStamps", "covered_points"]


WING = 2e-5
"""Share of a star's light in a pixel below which a stamp ends."""
NEAREST_PX = 4.0
"""Least distance of a stamp's edge from the rays."""
PROBE_ORDER = (12, 40)
MOST_RAYS = 1 << 17
"""Rays of one star, band and wavelength."""
LARGEST_RADIUS_PX = 100
BATCH_LANES = 1 << 22
COVERED_ORDER = (96, 384)
SUBDIVISION = 4
"""Parts of a cell along either axis that tell how much of it gets through."""
LIGHT = 1e-12
"""Share of a star's light below which none is lost inside an outline."""
ROUNDING = 0.05
"""Steps of the highest frequency [cycles/px], so that few tables are needed."""

Points = Callable[[tuple[int, int], IntArray], PupilPoints]


@dataclass(frozen=True, slots=True)
class WaveGroup:
    """Stars whose pupils are sampled alike: quadrature points of an order, or None where cells are covered in part.

    Those cells divide the disks that hold the beams of stars (`render.tracing.planning.PupilPlanner.disks`).
    """

    mode: str
    members: IntArray
    points: Points | None
    disks: Callable[[IntArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class Trail:
    """Motion of n stars' images during an exposure.

    Attributes
    ----------
    offset_px : (n, b, t, 2)
        From where they are in the middle of it; the whole image moves alike.
    weight : (n, b, t)
        Share of the light at each time, sum 1.
    """

    offset_px: FloatArray
    weight: FloatArray

    @property
    def mean_px(self) -> FloatArray:
        """Mean offset (n, b, 2)."""
        return np.asarray((self.weight[..., None] * self.offset_px).sum(2))

    @property
    def variance_px2(self) -> FloatArray:
        """Variance of the offset (n, b, 2)."""
        return np.asarray((self.weight[..., None] * self.offset_px**2).sum(2) - self.mean_px**2)


@dataclass(frozen=True, slots=True)
class RayMoments:
    """What is known of the rays of s stars in b bands.

    Attributes
    ----------
    mean_px, variance_px2 : (s, b, 2)
        Mean and variance of the landing points along columns and rows.
    entrance : (s, b) or None
        Light that the stop alone would let through in that of the launch disk; None where others know it.
    """

    mean_px: FloatArray
    variance_px2: FloatArray
    entrance: FloatArray | None = None

    def along(self, trail: Trail, stars: IntArray) -> RayMoments:
        """The same over an exposure."""
        return RayMoments(
            self.mean_px + trail.mean_px[stars], self.variance_px2 + trail.variance_px2[stars], self.entrance
        )


@dataclass(frozen=True, slots=True)
class WaveStamps:
    """Stamps of s stars, all of one size.

    Attributes
    ----------
    stars : (s,)
        Which.
    pixels : (s, b, m, m)
        Share of the light sent into the launch disk per pixel.
    corner_px : (s, b, 2)
        Outer corner (column, row).
    mean_px : (s, b, 2)
        Centroid of all light of the image, on the stamp or beyond, NaN without light.
    light : (s, b)
        Share of the light that gets through the lens.
    rays : int
        Of a star, band and wavelength.
    mode : str
        How the pupils were sampled.
    moments : RayMoments or None
        Of the stars' rays, where no others tell more: those of cells, of which some are covered in part, do not.
    """

    stars: IntArray
    pixels: FloatArray | NDArray[np.float32]
    corner_px: FloatArray
    mean_px: FloatArray
    light: FloatArray
    rays: int
    mode: str
    moments: RayMoments | None = None


class WaveImages:
    """Images of the stars of one kernel by sums of plane waves.

    Parameters
    ----------
    camera : Camera
        The camera.
    kernel : StarKernel
        Holds the stars, each in one direction.
    wavelength_nm : (b, k)
        Wavelengths.
    share : (n, b, k)
        Share of each in a star's light, sum 1.
    trail : Trail, optional
        How the images move during the exposure.
    shade : Shade, optional
        What stands between the sky and the lens.
    """

    def __init__(
        self,
        camera: Camera,
        kernel: StarKernel,
        wavelength_nm: FloatArray,
        share: FloatArray,
        trail: Trail | None = None,
        shade: Shade | None = None,
    ) -> None:
        self.camera, self.kernel, self.trail, self.shade = camera, kernel, trail, shade
        self.wavelength_nm, self.share = wavelength_nm, share
        self.index = np.asarray(camera.focused_lens.indices(wavelength_nm)[-1])

    def stamps(self, group: WaveGroup, radius_px: float | None = None) -> Iterator[WaveStamps]:
        """Stamps of the stars of a group, in batches; stars whose rays are lost inside an outline go by cells.

        Each has a radius of its own if none is given.
        """
        group, pierced = self._sorted(group)
        if pierced is not None:
            yield from self.stamps(pierced, radius_px)
        radius, field, order = self._needs(group, radius_px)
        for key in sorted(set(zip(radius.tolist(), field.tolist(), map(tuple, order.tolist()), strict=True))):
            alike = (radius == key[0]) & (field == key[1]) & (order == key[2]).all(1)
            members = group.members[alike]
            step = max(1, BATCH_LANES // (3 * math.prod(key[2]) * self.wavelength_nm.size))
            for part in (members[i : i + step] for i in range(0, len(members), step)):
                waves = self._traced(group, key[2], part)
                yield self._stamps(part, waves, key[0], FieldSampling(key[1]), group.mode)

    def cells(
        self, group: WaveGroup, half_size_px: int, cells_per_px: int
    ) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
        """Stars, their light per cell (s, b, m, m) of a square about the centroid, in shares of what gets through."""
        group, pierced = self._sorted(group)
        if pierced is not None:
            yield from self.cells(pierced, half_size_px, cells_per_px)
        window = 2.0 * half_size_px + 1.0
        _, field, order = self._needs(group, math.sqrt(0.5) * window)
        count = (2 * half_size_px + 1) * cells_per_px
        edges = (np.arange(count) + 0.5) / cells_per_px
        for key in sorted(set(zip(field.tolist(), map(tuple, order.tolist()), strict=True))):
            for star in group.members[(field == key[0]) & (order == key[1]).all(1)]:
                part, sampling = np.array([star]), FieldSampling(key[0])
                waves = self._traced(group, key[1], part)
                mean, light = self._means(part, waves)
                matrix, pad = self._matrix(sampling, window, edges, 1.0 / cells_per_px)
                result = np.empty((1, *mean.shape[1:2], count, count))
                for b in range(mean.shape[1]):
                    corner = mean[0, b] - 0.5 * window
                    image = window_light(waves, (0, b), self.share[star, b], corner, window, sampling, pad_px=pad)
                    with np.errstate(invalid="ignore"):
                        result[0, b] = (matrix @ image @ matrix.T) / light[0, b]
                yield part, result, mean

    def common_needs(self, groups: list[WaveGroup]) -> tuple[int, FieldSampling] | None:
        """Radius [px] and sampling that serve all stars of groups; None if some have no smooth outline."""
        radius = highest = 0.0
        for group in groups:
            if group.points is None or self._sorted(group)[1] is not None:
                return None
            radii, fields, _ = self._needs(group)
            radius, highest = max(radius, float(radii.max())), max(highest, float(fields.max()))
        return int(radius), FieldSampling(highest)

    def each(self, groups: list[WaveGroup], radius_px: float) -> Iterator[tuple[int, PlaneWaves]]:
        """Every star and its waves, for windows of a radius."""
        for group in groups:
            _, _, order = self._needs(group, radius_px)
            for star, own in zip(group.members.tolist(), order.tolist(), strict=True):
                yield star, self._traced(group, (own[0], own[1]), np.array([star]))

    def _sorted(self, group: WaveGroup) -> tuple[WaveGroup, WaveGroup | None]:
        """Stars whose outlines hold nothing but light, and the others, such as those behind a hole or a spider."""
        if group.points is None:
            return group, None
        lost = self._traced(group, PROBE_ORDER, group.members).lost.max((1, 2)) > LIGHT
        clear = replace(group, members=group.members[~lost])
        return clear, WaveGroup("cells", group.members[lost], None, group.disks) if lost.any() else None

    def _needs(self, group: WaveGroup, radius_px: float | None = None) -> tuple[FloatArray, FloatArray, IntArray]:
        """Radius of the stamp [px], highest frequency [cycles/px] and order of the quadrature of every star."""
        found: list[tuple[FloatArray, FloatArray, IntArray]] = []
        step = max(1, BATCH_LANES // (3 * math.prod(PROBE_ORDER) * self.wavelength_nm.size))
        for part in (group.members[i : i + step] for i in range(0, len(group.members), step)):
            probe = self._traced(group, PROBE_ORDER, part)
            self._check_aperture(probe)
            spot, highest = probe.spot_px, probe.highest
            rings = (1.0 / (probe.lowest_cutoff * math.pi**3 * WING)) ** (1.0 / 3.0)
            radius = (
                np.ceil(np.maximum(rings, spot + NEAREST_PX)) if radius_px is None else np.full(len(part), radius_px)
            )
            self._check_size(part, spot, radius)
            radial, around = phase_changes(probe, PROBE_ORDER, radius + 1.5)
            order = np.stack([radial / 4.0 + 5.0, around + 2.5 * np.cbrt(around) + 3.0], axis=1)
            rounded: IntArray = 4 * np.ceil(order / 4.0).astype(np.int64)
            if group.points is None:
                rounded = np.maximum(rounded, COVERED_ORDER)
            self._check_order(part, rounded, spot)
            found.append((radius.astype(np.float64), ROUNDING * np.ceil(1.03 * highest / ROUNDING), rounded))
        if not found:
            return np.empty(0), np.empty(0), np.empty((0, 2), np.int64)
        radii, fields, orders = zip(*found, strict=True)
        return np.concatenate(radii), np.concatenate(fields), np.concatenate(orders)

    def _traced(self, group: WaveGroup, order: tuple[int, int], stars: IntArray) -> PlaneWaves:
        which = stars.astype(np.uint32)
        if group.points is not None:
            return trace_waves(self.kernel, group.points(order, stars), self.wavelength_nm, self.index, which)
        nodes, disks = self.wavelength_nm.shape[1], group.disks(stars)
        cells, fine = (DiskPoints(covered_points(order, nodes, parts), *disks) for parts in (1, SUBDIVISION))
        arrived = self.kernel.land(fine, self.wavelength_nm, which)[2]
        if self.shade is not None:
            seen = DiskPoints(fine.points, disks[0][:, :1], disks[1][:, :1])  # the same disk in all bands
            arrived = arrived & ~hidden_points(self.kernel, self.shade, seen, which)[:, None, None]
        coverage = arrived.reshape(*arrived.shape[:3], cells.count, -1).mean(-1)
        return trace_waves(self.kernel, cells, self.wavelength_nm, self.index, which, coverage)

    def _means(self, stars: IntArray, waves: PlaneWaves) -> tuple[FloatArray, FloatArray]:
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

    def _matrix(
        self, field: FieldSampling, window_px: float, centres: FloatArray, box_px: float
    ) -> tuple[FloatArray, float]:
        """What makes pixels or cells about some centres of samples along one axis, and the margin that this needs."""
        kernel = field.pixel(box_px, self.camera.charge_diffusion_px)
        pad = kernel.reach_px - 0.5 * box_px
        samples = window_samples(field, window_px, pad)
        return kernel(centres[:, None] - samples) * field.light_step, pad

    def _stamps(
        self, stars: IntArray, waves: PlaneWaves, radius_px: float, field: FieldSampling, mode: str
    ) -> WaveStamps:
        mean, light = self._means(stars, waves)
        size = 2 * int(radius_px) + 1
        window = np.rint(np.nan_to_num(mean)) - 0.5 * size
        if self.trail is None:
            corner, stamp_px = window, size
        else:
            offset = self.trail.offset_px[stars]
            first = np.floor(offset.min(2))
            corner = window + first
            stamp_px = size + int((np.ceil(offset.max(2)) - first).max(initial=0.0))
        pixels = np.zeros((*light.shape, stamp_px, stamp_px))
        for s, star in enumerate(stars):
            for b in np.flatnonzero(light[s] > 0.0):
                at = waves, (s, int(b)), self.share[star, b], window[s, b], float(size), field
                pixels[s, b] = self._still(*at) if self.trail is None else self._moving(*at, int(star), stamp_px)
        rays = RayMoments(mean, self._variance(stars, waves, mean))
        if self.trail is not None:
            rays = rays.along(self.trail, stars)
        kept = None if mode == "cells" else rays
        return WaveStamps(stars, np.maximum(pixels, 0.0), corner, rays.mean_px, light, waves.x.shape[-1], mode, kept)

    def _still(
        self,
        waves: PlaneWaves,
        at: tuple[int, int],
        share: FloatArray,
        corner_px: FloatArray,
        window_px: float,
        field: FieldSampling,
    ) -> FloatArray:
        """Pixels of a disk in a window."""
        count = int(window_px)
        matrix, pad = self._matrix(field, window_px, np.arange(0.5, count), 1.0)
        image = window_light(waves, at, share, corner_px, window_px, field, pad_px=pad)
        offset = np.arange(0.5, count) - 0.5 * count
        disk = np.hypot(offset, offset[:, None]) <= 0.5 * (count - 1)
        return np.asarray((matrix.astype(np.float32) @ image @ matrix.T.astype(np.float32)) * disk, np.float64)

    def _moving(
        self,
        waves: PlaneWaves,
        at: tuple[int, int],
        share: FloatArray,
        corner_px: FloatArray,
        window_px: float,
        field: FieldSampling,
        star: int,
        stamp_px: int,
    ) -> FloatArray:
        """Pixels of the same disk along a trail."""
        assert self.trail is not None
        kernel = field.pixel(1.0, self.camera.charge_diffusion_px)
        pad = kernel.reach_px - 0.5
        image = window_light(waves, at, share, corner_px, window_px, field, pad_px=pad)
        samples = window_samples(field, window_px, pad)
        offset = samples - 0.5 * window_px
        image *= np.hypot(offset, offset[:, None]) <= 0.5 * window_px
        moves, weight = self.trail.offset_px[star, at[1]], self.trail.weight[star, at[1]]
        centres = np.arange(stamp_px) + 0.5 + np.floor(moves.min(0))[:, None]
        column, row = (
            (kernel(centres[axis][:, None] - samples - moves[:, axis, None, None]) * field.light_step)
            for axis in (0, 1)
        )
        column, row = column.astype(np.float32), (row * weight[:, None, None]).astype(np.float32)
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
                f"{self.camera.defocus_mm:g} mm), or set diffraction = 'rays', which is right for such images"
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


def covered_points(order: tuple[int, int], nodes: int, parts: int) -> TablePoints:
    """Middles of polar cells of equal area, rings x azimuths, or of parts x parts of each, the parts last."""
    rings, arms = order
    part = (np.arange(parts) + 0.5) / parts
    r2 = (np.arange(rings)[:, None, None, None] + part[:, None]) / rings
    angle = 2.0 * np.pi * (np.arange(arms)[:, None, None] + part) / arms
    r, angle = np.broadcast_arrays(np.sqrt(r2), angle)
    points = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)
    return TablePoints(np.broadcast_to(points, (nodes, *points.shape)), np.full(len(points), 1.0 / len(points)))
