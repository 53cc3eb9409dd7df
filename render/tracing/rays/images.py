"""Stars in passes: stamps sized by their bounds, traced, added to the image, done again where they were too small."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from render.camera import Camera
from render.tracing.pupil.points import PupilPoints, TablePoints
from render.tracing.pupil.sampling import PupilPlan, bounding_disk
from render.tracing.rays.kernel import (
    ARRIVED,
    HIDDEN,
    LOST,
    OUTSIDE,
    Shade,
    StampSums,
    StarKernel,
    reach_px,
    strips_per_pixel,
)
from render.tracing.truth import TruthSums, add_stamps

__all__ = [
    "MARGIN_PX",
    "PASS_BYTES",
    "STAMP_LIMIT_PX",
    "Bounds",
    "Group",
    "Light",
    "Passes",
    "find_bounds",
]

Points = Callable[[IntArray], PupilPoints]

PASS_BYTES = 48 << 20
"""Memory of the stamps of one pass; the number of rays does not count."""
PASS_RAYS = 1 << 27
BOUND_RAYS = 1 << 20
MARGIN_PX = 0.75
"""Room around the bounding rays of a stamp; doubled when a ray falls outside all the same."""
STAMP_LIMIT_PX = 1024
DISTORTION = 0.05
"""Part of the way of an image by which a lens may lead it beside where an ideal one does; more is found by redoing."""
TABLE_POINTS = 1 << 21
"""Azimuths of all nodes of all stars of one pass of outlines."""
LIGHT = 1e-12
"""Share of a star's light below which none is lost (rounding of the sums)."""


@dataclass(frozen=True, slots=True)
class Light:
    """A star field as the tracer sees it: wavelengths (b, k), shares of nodes (n, b, t k), electrons sent in (n, b)."""

    wavelength_nm: FloatArray
    share: FloatArray
    electrons: FloatArray

    def take(self, stars: IntArray) -> Light:
        """Some of the stars."""
        return Light(self.wavelength_nm, self.share[stars], self.electrons[stars])


@dataclass(frozen=True, slots=True)
class Bounds:
    """Lowest and highest landing point (n, b, 2) [px], and whether every bounding ray arrived (n,)."""

    low: FloatArray
    high: FloatArray
    clear: NDArray[np.bool_]

    @classmethod
    def empty(cls, stars: int, bands: int) -> Bounds:
        """Nothing known yet."""
        shape = (stars, bands, 2)
        return cls(np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(stars, bool))

    def moved(self, shift_px: FloatArray) -> Bounds:
        """With room for offsets (n, 2, 2), the lowest and the highest, that an ideal lens makes of a motion."""
        room = DISTORTION * np.abs(shift_px).max(1, initial=0.0)
        return Bounds(
            self.low + (shift_px[:, 0] - room)[:, None], self.high + (shift_px[:, 1] + room)[:, None], self.clear
        )

    def box(self, stars: IntArray, margin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Boxes with a margin; a unit box at the origin where no ray arrives."""
        low, high = self.low[stars], self.high[stars]
        empty = ~np.isfinite(low)
        m = margin[:, None, None]
        return np.where(empty, 0.0, low) - m, np.where(empty, 0.0, high) + m


@dataclass(frozen=True, slots=True)
class Group:
    """Stars that are sampled alike, and the pupil points of any of them."""

    plan: PupilPlan
    members: IntArray
    points: Points


def find_bounds(kernel: StarKernel, bounds: Bounds, stars: IntArray, wavelength_nm: FloatArray, points: Points) -> None:
    """Extent of the bundles of some stars [px] and whether they are clear, at the given wavelengths (b, 3)."""
    # stars (s,), wavelength_nm (b, 3)
    step = max(1, BOUND_RAYS // (len(wavelength_nm) * 3 * bounding_disk().count))
    for part in (stars[i : i + step] for i in range(0, len(stars), step)):
        landed = kernel.land(points(part), wavelength_nm, part.astype(np.uint32))
        x, y, ok = (v.reshape(*v.shape[:2], -1) for v in landed)
        bounds.clear[part] = ok.all((1, 2))
        for axis, value in enumerate((x, y)):
            bounds.low[part, :, axis] = np.where(ok, value, np.inf).min(2)
            bounds.high[part, :, axis] = np.where(ok, value, -np.inf).max(2)


@dataclass(frozen=True, slots=True)
class Passes:
    """What all groups of stars of a frame share."""

    # camera, kernel, light, bounds: What is traced
    camera: Camera
    kernel: StarKernel
    light: Light
    bounds: Bounds
    image: NDArray[np.float32]  # (h, w, b) What light is added to
    sums: TruthSums  # Where the truth is kept
    # (n, b) Light that the stop alone would let through in that of the launch disk; NaN where unknown
    entrance: FloatArray
    # What stands between the sky and the lens; asked for every ray of stars that Sobol points sample
    shade: Shade | None = None

    def trace(self, group: Group) -> IntArray:
        """Trace stars in passes, and again those whose stamp was too small.

        Returns the stars of a quadrature that turn out to lose light in the lens; they are not in the image yet.
        """
        members, light = group.members, self.light
        reach = reach_px(self.camera.charge_diffusion_px)
        margin = np.full(len(members), MARGIN_PX)
        todo, cut = np.arange(len(members)), []
        while len(todo):
            low, high = self.bounds.box(members[todo], reach + margin[todo])
            redo = []
            for part, stamp_px in self._passes(high - low, group.plan):
                stars, corner = members[todo[part]], np.floor(low[part]) - 0.5
                pupil = group.points(stars)
                shade = self.shade if group.plan.mode == "sobol" else None
                collected = self.splat(pupil, stars, corner, stamp_px, shade=shade)
                outside = np.asarray((collected.moments[..., OUTSIDE] > LIGHT).any(1))
                if stamp_px == STAMP_LIMIT_PX and outside.any():
                    self._check_size(stars[outside], low[part][outside], high[part][outside])
                    outside[:] = False
                lost = np.asarray((collected.moments[..., LOST] > LIGHT).any(1) & (group.plan.mode != "sobol"))
                cut.append(stars[lost])
                redo.append(todo[part[outside & ~lost]])
                entrance = self._balanced(collected, pupil, stars)
                keep = ~(outside | lost)
                if not keep.all():
                    stars, corner, collected, entrance = stars[keep], corner[keep], collected.take(keep), entrance[keep]
                on_image = add_stamps(
                    self.image, collected.pixels, corner, light.electrons[stars], self.camera.sensitive_columns
                )
                self.sums.store(stars, collected, corner, light.electrons[stars], on_image, entrance)
            todo = np.concatenate(redo)
            margin[todo] = 2 * margin[todo] + 2.0
        return np.concatenate(cut)

    def _balanced(self, collected: StampSums, pupil: PupilPoints, stars: IntArray) -> FloatArray:
        """Light (s, b) that enters by the stop alone; what of it does not arrive becomes what is lost in the lens."""
        moments, entrance = collected.moments, self.entrance[stars]
        if isinstance(pupil, TablePoints):
            return entrance
        arrived = moments[..., ARRIVED] + moments[..., OUTSIDE] + moments[..., HIDDEN]
        entrance = np.fmax(np.where(np.isnan(entrance), 1.0, entrance), arrived)
        moments[..., LOST] = entrance - arrived
        return entrance

    def splat(
        self,
        pupil: PupilPoints,
        stars: IntArray,
        corner_px: FloatArray,
        stamp_px: int,
        cells_per_px: int = 1,
        shade: Shade | None = None,
    ) -> StampSums:
        """Stamps of some stars."""
        return self.kernel.splat(
            stars=stars.astype(np.uint32),
            pupil=pupil,
            wavelength_nm=self.light.wavelength_nm,
            node_share=np.ascontiguousarray(self.light.share[stars]),
            corner_px=corner_px,
            stamp_px=stamp_px,
            cells_per_px=cells_per_px,
            shade=shade,
        )

    def _passes(self, extent_px: FloatArray, plan: PupilPlan) -> list[tuple[IntArray, int]]:
        """Stars (indices into ``extent_px``) that go into one pass each, and the size of their stamps."""
        size = np.minimum(np.ceil(extent_px).max((1, 2)).astype(int) + 1, STAMP_LIMIT_PX)
        order = np.argsort(size, kind="stable")
        per_pixel = 16 * len(self.light.wavelength_nm)
        strips = 2 * strips_per_pixel(self.camera.charge_diffusion_px)
        rays = self.light.share[0].size * plan.rays_per_node
        azimuths = 2 * self.light.share[0].size * plan.order[1]
        passes, start = [], 0
        while start < len(order):
            ahead = size[order[start:]]
            count = np.arange(1, len(ahead) + 1)
            fits = (count * per_pixel * ahead * (ahead + strips) <= PASS_BYTES) & (count * rays <= PASS_RAYS)
            fits &= (count * azimuths <= TABLE_POINTS) | (plan.pupil is not None)
            stop = start + max(1, int(np.count_nonzero(fits & (ahead <= 1.6 * ahead[0] + 4))))
            passes.append((order[start:stop], int(size[order[stop - 1]])))
            start = stop
        return passes

    def _check_size(self, stars: IntArray, low: FloatArray, high: FloatArray) -> None:
        """Refuse stars larger than the largest stamp, unless they are beside the image anyway."""
        edge = np.array([self.camera.width_px, self.camera.height_px]) - 0.5
        touches = np.asarray(np.any(np.all((high > -0.5) & (low < edge), axis=2), axis=1))
        if touches.any():
            worst = int(np.argmax(touches))
            raise DomainError(
                f"the image of star {stars[worst]} is {(high - low)[worst].max():.0f} px wide; at most "
                f"{STAMP_LIMIT_PX} px can be rendered; check the focus (defocus_mm = {self.camera.defocus_mm:g} mm) "
                "and the motion during the exposure"
            )
