"""Images by rays: stamps sized by their bounds, traced, added to the image, repeated where a stamp was too small."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from render.camera import Camera
from render.tracing.motion.paths import NodeLight
from render.tracing.pupil.planning import Bounds, Group, PlannedExposure, PupilPlanner, Sampled
from render.tracing.pupil.points import PupilPoints, TablePoints
from render.tracing.rays.kernel import (
    ARRIVED,
    CLEAR,
    LOST,
    OUTSIDE,
    Shade,
    StampSums,
    StarKernel,
    reach_px,
    strips_per_pixel,
)
from render.tracing.truth import Sampling, TruthSums, add_stamps, check_lit

PASS_BYTES = 48 << 20
"""Memory of the stamps of one pass; the number of rays does not count."""
PASS_RAYS = 1 << 27
MARGIN_PX = 0.75
"""Room around the bounding rays of a stamp; doubled when a ray falls outside all the same."""
STAMP_LIMIT_PX = 1024
TABLE_POINTS = 1 << 21
"""Azimuths of all nodes of all stars of one pass of outlines."""
LIGHT = 1e-12
"""Share of a star's light below which none is lost (rounding of the sums)."""


class RayImages:
    """Makes images of the stars of one camera by rays (`render.tracing.tracer.ImageMaker`)."""

    def __init__(self, planner: PupilPlanner) -> None:
        self.planner, self.camera = planner, planner.camera

    def add(self, light: NodeLight, exposure: PlannedExposure, image: NDArray[np.float32], sums: TruthSums) -> Sampling:
        """Add stars to the image and their truth to the sums; how they were sampled."""
        return self.traced(light, exposure, image, sums)[1]

    def traced(
        self, light: NodeLight, exposure: PlannedExposure, image: NDArray[np.float32], sums: TruthSums
    ) -> tuple[Sampled, Sampling]:
        """The same, with the planner's results for the stars."""
        sampled, sampling = self.planner.sampled_by_rays(exposure), Sampling()
        entering = (light.weight * sampled.entrance).sum(2)
        passes = _Passes(self.camera, exposure.nodes, light, sampled.bounds, image, sums, entering, exposure.shade)
        lost = np.empty(0, np.int64)  # only points of the last group suit stars of others
        for group in sampled.groups:
            members = group.members
            if group is sampled.groups[-1]:
                members, lost = np.sort(np.concatenate([members, lost])), lost[:0]
            cut = passes.trace(replace(group, members=members)) if len(members) else members
            lost = np.concatenate([lost, cut])
            if len(members) > len(cut):
                sampling[group.mode] = (len(members) - len(cut), group.rays * light.weight.shape[2])
        return sampled, sampling

    def cells(self, light: NodeLight, exposure: PlannedExposure, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light per cell (n, b, m, m) of squares about the bundle means, over what arrives."""
        nothing, sums = np.zeros((0, 0, light.electrons.shape[1]), np.float32), TruthSums.empty(*light.electrons.shape)
        sampled, _ = self.traced(light, exposure, nothing, sums)
        stamp_px = 2 * half_size_px + 1
        corner = sums.bundle - 0.5 * stamp_px
        check_lit(corner)
        passes = _Passes(self.camera, exposure.nodes, light, sampled.bounds, nothing, sums, sums.entrance)
        side = stamp_px * cells_per_px
        result = np.empty((*corner.shape[:2], side, side))
        step = max(1, PASS_BYTES // (corner.shape[1] * side**2 * 16))
        for group in sampled.groups:
            for part in (group.members[i : i + step] for i in range(0, len(group.members), step)):
                collected = passes.splat(group.of(part), part, corner[part], stamp_px, cells_per_px)
                light_in = collected.moments[..., [ARRIVED, OUTSIDE]].sum(-1)
                result[part] = collected.pixels / light_in[..., None, None]
        return result


@dataclass(frozen=True, slots=True)
class _Passes:
    """Data shared by all groups of stars of a frame."""

    camera: Camera
    kernel: StarKernel
    light: NodeLight
    bounds: Bounds
    image: NDArray[np.float32]  # (h, w, b)
    sums: TruthSums  # The truth
    # (n, b) Light that the stop alone would let through in that of the launch disk; NaN where unknown
    entrance: FloatArray
    shade: Shade | None = None  # Bodies between the sky and the lens, tested for every ray of Sobol points

    def trace(self, group: Group) -> IntArray:
        """Trace stars in passes, and again those whose stamp was too small.

        Returns the stars of a quadrature that turn out to lose light in the lens; they are not in the image yet.
        """
        members, light = group.members, self.light
        reach = reach_px(self.camera.blur_px)
        margin = np.full(len(members), MARGIN_PX)
        todo, cut = np.arange(len(members)), []
        while len(todo):
            low, high = self.bounds.box(members[todo], reach + margin[todo])
            redo = []
            for part, stamp_px in self._passes(high - low, group):
                stars, corner = members[todo[part]], np.floor(low[part]) - 0.5
                pupil = group.of(stars)
                shade = self.shade if group.mode == "sobol" else None
                collected = self.splat(pupil, stars, corner, stamp_px, shade=shade)
                outside = np.asarray((collected.moments[..., OUTSIDE] > LIGHT).any(1))
                if stamp_px == STAMP_LIMIT_PX and outside.any():
                    self._check_size(stars[outside], low[part][outside], high[part][outside])
                    outside[:] = False
                lost = np.asarray((collected.moments[..., LOST] > LIGHT).any(1) & (group.mode != "sobol"))
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
        """Light (s, b) that enters by the stop alone; the part that does not arrive is stored as lost."""
        moments, entrance = collected.moments, self.entrance[stars]
        if isinstance(pupil, TablePoints):
            return entrance
        clear = moments[..., CLEAR]
        entrance = np.fmax(np.where(np.isnan(entrance), 1.0, entrance), clear)
        moments[..., LOST] = entrance - clear
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
            node_weight=np.ascontiguousarray(self.light.weight[stars]),
            corner_px=corner_px,
            stamp_px=stamp_px,
            cells_per_px=cells_per_px,
            shade=shade,
        )

    def _passes(self, extent_px: FloatArray, group: Group) -> list[tuple[IntArray, int]]:
        """Stars (indices into ``extent_px``) that go into one pass each, and the size of their stamps."""
        size = np.minimum(np.ceil(extent_px).max((1, 2)).astype(int) + 1, STAMP_LIMIT_PX)
        order = np.argsort(size, kind="stable")
        per_pixel = 16 * len(self.light.wavelength_nm)
        strips = 2 * strips_per_pixel(self.camera.blur_px)
        rays = self.light.weight[0].size * group.rays
        azimuths = 2 * self.light.weight[0].size * group.order[1]
        passes, start = [], 0
        while start < len(order):
            ahead = size[order[start:]]
            count = np.arange(1, len(ahead) + 1)
            fits = (count * per_pixel * ahead * (ahead + strips) <= PASS_BYTES) & (count * rays <= PASS_RAYS)
            fits &= (count * azimuths <= TABLE_POINTS) | (group.outlines is None)
            stop = start + max(1, int(np.count_nonzero(fits & (ahead <= 1.6 * ahead[0] + 4))))
            passes.append((order[start:stop], int(size[order[stop - 1]])))
            start = stop
        return passes

    def _check_size(self, stars: IntArray, low: FloatArray, high: FloatArray) -> None:
        """Refuse stars larger than the largest stamp, unless they are outside the image."""
        edge = np.array([self.camera.width_px, self.camera.height_px]) - 0.5
        touches = np.asarray(np.any(np.all((high > -0.5) & (low < edge), axis=2), axis=1))
        if touches.any():
            worst = int(np.argmax(touches))
            raise DomainError(
                f"the image of star {stars[worst]} is {(high - low)[worst].max():.0f} px wide; at most "
                f"{STAMP_LIMIT_PX} px can be rendered; check the focus (defocus_mm = {self.camera.defocus_mm:g} mm) "
                "and the motion during the exposure"
            )
