"""Which stars are sampled how: outlines, quadrature orders found by trial, and groups of stars."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.lens.system import LensSystem
from optics.light.collimation import Collimation
from optics.rays.aim import aim_frame
from optics.rays.axial_beam import check_axial_beam
from optics.rays.beam import inner_points
from optics.rays.program import compile_lens
from optics.rays.pupil import EntrancePupil, entrance_pupil, launch_disks, stop_in_front
from render.camera import Camera, launch_disk
from render.tracing.convergence import HIGHEST_FREQUENCY, MOTION_TOLERANCE, TOLERANCE
from render.tracing.motion.exposure import IdealLens
from render.tracing.motion.paths import StarPaths, pick_times, uniform_paths
from render.tracing.pupil.aim import Chiefs, aimed_lens, find_chiefs
from render.tracing.pupil.outlines import (
    ARC_LADDER,
    Arcs,
    NodePicks,
    Outlines,
    every_node,
    find_arcs,
    find_outlines,
    node_picks,
    node_turns,
)
from render.tracing.pupil.points import DiskPoints, PupilPoints
from render.tracing.pupil.sampling import (
    LADDER,
    OUTLINE_LADDER,
    Landed,
    PupilPlan,
    Trial,
    bounding_disk,
    converged_order,
    lowest_order,
    probe_fields,
    probe_nodes,
    sobol_plan,
    staggered,
)
from render.tracing.rays.images import Bounds, Group, find_bounds
from render.tracing.rays.kernel import Geometry, StarKernel, reach_px
from render.tracing.waves.images import WaveGroup

__all__ = ["PupilPlanner", "Seen", "Shapes"]

Ladder = tuple[tuple[int, int], ...]

MOTION_FIELDS = (0, 1, 6, 9, 12, 15)
"""Probe fields that judge under motion."""
MOST_TRIAL_TIMES = 72
"""Time nodes of a trial; a longer trail is judged by a part of it."""
LEAST_ORDER, LEAST_ARC_ORDER = (2, 3), (2, 20)
LEAST_DAMPED = 0.72
"""Charge diffusion [px] times the highest frequency below which too much of that is left."""
MOST_RAYS = 1 << 18
"""Rays per star and band beyond which no quadrature is tried; fewer Sobol points come as near as 1e-4."""
UNBLURRED_MORE = 2
"""By how much more the logarithm of the number of Sobol points is then: a pixel's edge counts rays, and what that
misses falls as their number to the power -3/4 (4e-4 of the light by 2^16, below 1e-4 by 2^18)."""
RIM_BEYOND = 0.25
"""How far the rim of a spot is looked for beyond the rays of the lowest order, in terms of their extent."""
MEANS_RUNG = 4
"""Order, counted from the lowest, by which means of bundles whose images are made by waves are found."""
WIDEST_TRIAL_PX = 200
"""Size of the stamps of a trial; wider spots are left to Sobol points."""
SHORTEST_PX = 0.25
"""Path below which the order is that of a star at rest."""


@dataclass(frozen=True, slots=True)
class Seen:
    """Stars as an exposure sees them."""

    # mid, nodes: In the middle of the exposure, and at its time nodes; the same for a camera at rest
    mid: StarKernel
    nodes: StarKernel
    picks: NodePicks  # Where outlines are found
    paths: StarPaths
    length_px: float  # Length of the paths
    wavelength_nm: FloatArray  # (b, k) All wavelengths


Shape = tuple[str, IntArray, Outlines | Arcs]
"""A mode, its stars, and their outlines."""


@dataclass(frozen=True, slots=True)
class Shapes:
    """Outlines of the beams of stars, in parts of one mode each."""

    parts: list[Shape]  # No star is in two of them
    outlines: Outlines | None  # Those by the stop alone; None where the launch disk is the stop

    def entrance(self, nodes: tuple[int, int, int]) -> FloatArray:
        """Light (n, b, k) that the stop alone would let through in that of the launch disk; NaN where unknown."""
        return np.ones(nodes) if self.outlines is None else self.outlines.entrance()


def unit_disk(lens: LensSystem) -> EntrancePupil:
    """Disk that light and launch points are counted in: the stop if it stands in front, or the paraxial pupil."""
    if stop_in_front(lens):
        return entrance_pupil(lens)
    frame = aim_frame(lens)
    return EntrancePupil(z_mm=frame.z_mm, radius_mm=frame.scale_mm, exact=False)


def _open_stop(lens: LensSystem) -> LensSystem:
    """The lens with a hair of room at its stop, for rays launched on the stop's very rim."""
    at = lens.stop_index
    stop = lens.surfaces[at]
    return lens.with_surfaces({at: replace(stop, semi_diameter_mm=stop.semi_diameter_mm * (1.0 + 1e-9))})


def _fixed_group(plan: PupilPlan, members: IntArray) -> Group:
    """Stars that share the points of their plan."""
    pupil = plan.pupil
    assert pupil is not None
    return Group(plan, members, lambda stars: pupil)


class PupilPlanner:
    """Decides how the stars of one camera are sampled, and keeps what it has found."""

    def __init__(
        self, camera: Camera, *, sobol_log2_rays: int, sobol_seed: int, tolerance: float, general: bool
    ) -> None:
        self.camera, self.tolerance = camera, tolerance
        self.sobol_log2_rays, self.sobol_seed = sobol_log2_rays, sobol_seed
        lens = camera.focused_lens
        check_axial_beam(lens)
        self.pupil = unit_disk(lens)
        if not self.pupil.exact:
            launch_disk(camera)  # refuses a lens that lets no light through
        self.program, self.theta = compile_lens(_open_stop(lens) if self.pupil.exact else lens, general=general)
        self._aim = aimed_lens(lens, self.program, self.theta)
        self._plans: dict[Any, PupilPlan | None] = {}

    def kernel(
        self, direction: FloatArray, shear: FloatArray | None = None, collimation: Collimation | None = None
    ) -> StarKernel:
        """Kernel of stars whose directions are given in cam."""
        pupil = self.pupil
        geometry = Geometry(
            pitch_mm=self.camera.pixel_pitch_mm,
            centre_px=self.camera.centre_px,
            pupil_mm=(pupil.x_mm, pupil.y_mm, pupil.z_mm),
            pupil_radius_mm=pupil.radius_mm,
            diffusion_px=self.camera.charge_diffusion_px,
        )
        return StarKernel(self.program, self.theta, geometry, direction, shear, collimation)

    @property
    def _blurred(self) -> bool:
        """Whether charge diffusion softens the edges of pixels enough for a quadrature."""
        return self.camera.charge_diffusion_px * HIGHEST_FREQUENCY >= LEAST_DAMPED

    def seen(self, paths: StarPaths, wavelength_nm: FloatArray, length_px: float = 0.0) -> Seen:
        """What is needed of an exposure."""
        mid = self.kernel(paths.mid, collimation=paths.collimation)
        if paths.nodes.shape[1] == 1 and paths.shear is None:
            return Seen(mid, mid, node_picks(mid, wavelength_nm), paths, 0.0, wavelength_nm)
        picked, times = pick_times(paths)
        picks = node_picks(self.kernel(picked), wavelength_nm, times)
        return Seen(
            mid, self.kernel(paths.nodes, paths.shear, paths.collimation), picks, paths, length_px, wavelength_nm
        )

    def chiefs(self, kernel: StarKernel, wavelength_nm: FloatArray) -> Chiefs:
        """Chief rays, through the centre of the stop, at the mean of each band's nodes (b, k)."""
        mean = wavelength_nm.mean(1)
        centre = np.zeros((kernel.count, len(mean), 2)) if self.pupil.exact else None
        return find_chiefs(self._aim, kernel, mean, centre)

    def shapes(self, seen: Seen, chiefs: Chiefs, cut: IntArray | None = None) -> Shapes:
        """Outlines of the beams of stars."""
        # cut (c,): which stars other apertures cut where the launch disk is the stop and the outline of the others
        if not seen.mid.count or self._aim.stop not in dict(self._aim.limits):
            return Shapes([], None)
        if self.pupil.exact and self._aim.holes:
            return Shapes([], None)
        parts: list[Shape] = []
        if self.pupil.exact:
            outlines, centre = None, chiefs.points
            left = np.arange(seen.mid.count) if cut is None else cut
        else:
            outlines = find_outlines(self._aim, seen.picks, chiefs)
            centre, left = outlines.chief, np.flatnonzero(~outlines.clear)
            if outlines.clear.any():
                parts.append(("quadrature", np.flatnonzero(outlines.clear), outlines))
        picks = seen.picks
        for again in (False,) if self._aim.holes else (False, True):
            if again:  # about a point inside the beam where that is not the chief ray's, and at every wavelength
                if not len(left) or seen.nodes is not seen.mid:
                    break
                centre, lit = self._inside(seen, left)
                picks, left = every_node(seen.mid, seen.wavelength_nm), left[lit]
            if len(left):
                arcs = find_arcs(self._aim, picks, centre, left)
                if len(arcs.stars):
                    parts.append(("arcs", arcs.stars, arcs))
                left = np.setdiff1d(left, arcs.stars)
        return Shapes(parts, outlines)

    def _inside(self, seen: Seen, stars: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """A point (n, b, 2) inside the beam of some of the stars, 0 for others, and for which there is one."""
        middle = np.median(seen.wavelength_nm, 1)
        found, lit = inner_points(self.camera.focused_lens, seen.paths.mid[stars], middle)
        centre = np.zeros((seen.mid.count, len(middle), 2))
        centre[stars] = (found - [self.pupil.x_mm, self.pupil.y_mm]) / self.pupil.radius_mm
        return centre, np.asarray(lit.all(1))

    def disks(self, seen: Seen, wavelength_nm: FloatArray, stars: IntArray) -> tuple[FloatArray, FloatArray]:
        """Disks that hold the beams of some stars: centres (s, b, 2) and radii (s, b), in radii of the launch disk."""
        shape = (len(stars), len(wavelength_nm))
        if self.pupil.exact or not len(stars):
            return np.zeros((*shape, 2)), np.ones(shape)
        times = seen.paths.nodes.shape[1]
        ends = seen.paths.nodes[stars][:, sorted({0, times // 2, times - 1})]
        disks = launch_disks(self.camera.focused_lens, ends.reshape(-1, 3), wavelength_nm.ravel())
        x, y, radius = (v.reshape(ends.shape[:2]) for v in (disks.x_mm, disks.y_mm, disks.radius_mm))
        middle = x.mean(1), y.mean(1)
        reach = (radius + np.hypot(x - middle[0][:, None], y - middle[1][:, None])).max(1)
        centre = np.stack([middle[0] - self.pupil.x_mm, middle[1] - self.pupil.y_mm], axis=-1)[:, None, :]
        unit = self.pupil.radius_mm
        return np.broadcast_to(centre / unit, (*shape, 2)), np.broadcast_to(reach[:, None] / unit, shape)

    def groups(
        self, seen: Seen, wavelength_nm: FloatArray, chiefs: Chiefs, shaded: BoolArray | None = None
    ) -> tuple[list[Group], Bounds, FloatArray]:
        """How stars are sampled: groups, the last of them able to take any star, bounds of all, and entrances.

        Shaded stars (n,), whose beams something may cut that the lens knows nothing of, go to the last group. An
        entrance (n, b, k) is the light that the stop alone would let through in that of the launch disk, at every node;
        NaN where unknown.
        """
        count = seen.mid.count
        everyone = np.arange(count)
        bounds = Bounds.empty(count, len(wavelength_nm))
        ends = np.stack([wavelength_nm.min(1), np.median(wavelength_nm, 1), wavelength_nm.max(1)], axis=1)
        nodes = (count, len(wavelength_nm), wavelength_nm.shape[1] * seen.nodes.times)
        groups, left, entrance = [], everyone, np.ones(nodes)
        open_ = np.ones(count, np.bool_) if shaded is None else ~shaded
        holed = any(surface.holed for surface in self.camera.lens.surfaces)

        def disks(stars: IntArray) -> DiskPoints:
            return DiskPoints(bounding_disk(), *self.disks(seen, wavelength_nm, stars))

        cut = None
        if self.pupil.exact:
            find_bounds(seen.mid, bounds, everyone, ends, disks)
            clear = bounds.clear & open_
            plan = None if holed else self.plan("quadrature", wavelength_nm, seen, clear)
            if plan is not None:
                groups.append(_fixed_group(plan, everyone[clear]))
            cut = everyone[~bounds.clear]
        if self.camera.charge_diffusion_px > 0.0 and (cut is None or len(cut)):
            shapes = self.shapes(seen, chiefs, cut)
            entrance = shapes.entrance(nodes)
            for mode, every, outlines in shapes.parts:
                members = every[open_[every]]
                plan = self.plan(mode, wavelength_nm, seen, members)
                if plan is not None:
                    find_bounds(seen.mid, bounds, members, seen.picks.ends()[1], outlines.bounding)
                    groups.append(Group(plan, members, partial(outlines.points, plan.order)))
        for group in groups:
            left = np.setdiff1d(left, group.members)
        if not self.pupil.exact:
            find_bounds(seen.mid, bounds, left, ends, disks)
        log2_rays = self.sobol_log2_rays + (0 if self._blurred else UNBLURRED_MORE)
        sobol = sobol_plan(wavelength_nm.shape[1] * seen.nodes.times, self.sobol_seed, log2_rays)
        if seen.nodes is not seen.mid:
            bounds = bounds.moved(seen.paths.shift_px)

        def moved(stars: IntArray) -> DiskPoints:
            assert sobol.pupil is not None
            return DiskPoints(sobol.pupil, *self.disks(seen, wavelength_nm, stars))

        return [*groups, Group(sobol, left, moved)], bounds, entrance

    def wave_groups(
        self,
        seen: Seen,
        wavelength_nm: FloatArray,
        chiefs: Chiefs,
        stars: IntArray,
        shaded: BoolArray | None = None,
    ) -> list[WaveGroup]:
        """Groups of some stars at rest whose pupils are sampled alike for sums of plane waves; shaded ones by cells."""
        groups: list[WaveGroup] = []
        dark = np.empty(0, np.int64) if shaded is None else stars[shaded[stars]]
        everyone, stars = stars, np.setdiff1d(stars, dark)
        nodes = wavelength_nm.shape[1]
        disks, cut = partial(self.disks, seen, wavelength_nm), None
        if self.pupil.exact:

            def turns(count: int) -> FloatArray:
                return np.repeat(0.5 + node_turns(nodes)[:, None], count, axis=1)

            bounds = Bounds.empty(seen.mid.count, len(wavelength_nm))
            ends = np.stack([wavelength_nm.min(1), np.median(wavelength_nm, 1), wavelength_nm.max(1)], axis=1)
            find_bounds(seen.mid, bounds, stars, ends, lambda part: DiskPoints(bounding_disk(), *disks(part)))
            clear, cut = stars[bounds.clear[stars]], stars[~bounds.clear[stars]]
            groups.append(WaveGroup("quadrature", clear, lambda order, _: staggered(order, nodes), disks, turns))
        for mode, members, shapes in self.shapes(seen, chiefs, cut).parts if cut is None or len(cut) else ():
            smooth = shapes.turns if isinstance(shapes, Outlines) else None
            groups.append(WaveGroup(mode, np.intersect1d(members, stars), shapes.points, disks, smooth))
        left = everyone
        for group in groups:
            left = np.setdiff1d(left, group.members)
        return [group for group in (*groups, WaveGroup("cells", left, None, disks)) if len(group.members)]

    def plan(self, mode: str, wavelength_nm: FloatArray, seen: Seen, members: NDArray[Any]) -> PupilPlan | None:
        """Quadrature for some of the stars, which have to be clear; None if none is fit.

        It is found by trial on a field of the stars' extent, under a uniform motion of as many time nodes and at most
        the same length. Extent and length are rounded, so that few different ones occur, and with it the plan depends
        on lens, wavelengths, extent and motion only, not on which stars there are.
        """
        direction = seen.paths.mid[members]
        if not len(direction):
            return None
        step = math.radians(self.camera.lens.max_field_deg) / 16
        reach = math.acos(min(1.0, float(direction[:, 2].min())))
        steps = max(1, math.ceil(reach / step - 1e-9))
        length = seen.length_px
        length = 2.0 ** (0.5 * math.floor(2.0 * math.log2(length))) if length > SHORTEST_PX else 0.0
        key = (mode, wavelength_nm.tobytes(), steps, seen.nodes.times, length)
        if key not in self._plans:
            reach = min(steps * step, 1.5)
            still = (mode, wavelength_nm.tobytes(), steps, 1, 0.0)
            if still not in self._plans:
                self._plans[still] = self._try(mode, wavelength_nm, reach, 1, 0.0, None)
            if key != still:
                self._plans[key] = self._try(mode, wavelength_nm, reach, *key[3:], self._plans[still])
        return self._plans[key]

    def _try(
        self,
        mode: str,
        wavelength_nm: FloatArray,
        reach_rad: float,
        times: int,
        length_px: float,
        still: PupilPlan | None,
    ) -> PupilPlan | None:
        """Lowest order that is converged for probe stars; under motion at most that of a camera at rest."""
        if self.camera.diffraction != "rays":  # rays make no image then
            fitting = LADDER if self.pupil.exact and mode == "quadrature" else OUTLINE_LADDER
            order = (ARC_LADDER if mode == "arcs" else fitting)[MEANS_RUNG]
            return self._planned(mode, order, math.nan, wavelength_nm.shape[1], times)
        if times > 1 and still is None:
            return None
        few = np.ascontiguousarray(wavelength_nm[:, probe_nodes(wavelength_nm.shape[1])])
        fields = probe_fields(reach_rad) if times == 1 else probe_fields(reach_rad)[list(MOTION_FIELDS)]
        tried = min(times, MOST_TRIAL_TIMES)
        part_px = length_px * tried / times
        paths = uniform_paths(fields, tried, part_px / IdealLens.of(self.camera).focal_px)
        seen = self.seen(paths, few, part_px)
        probes = np.arange(len(paths.mid))
        ladder: Ladder = LADDER
        points: Callable[[tuple[int, int]], PupilPoints] = partial(staggered, nodes=few.shape[1], times=tried)
        if mode == "arcs" or not self.pupil.exact:
            shapes = [s for s in self.shapes(seen, self.chiefs(seen.mid, few)).parts if s[0] == mode]
            if not shapes:
                return still
            probes, points = shapes[0][1], partial(shapes[0][2].points, stars=shapes[0][1])
            ladder = OUTLINE_LADDER if mode == "quadrature" else ARC_LADDER
        node_weight = None if times == 1 else np.repeat(paths.weight[0] / few.shape[1], few.shape[1])

        def land(order: tuple[int, int]) -> Landed:
            pupil = points(order)
            return Landed(*seen.nodes.land(pupil, few, probes.astype(np.uint32)), pupil.weight, node_weight)

        found: tuple[tuple[int, int], float] | None
        if still is not None:
            least = LEAST_ARC_ORDER if mode == "arcs" else LEAST_ORDER
            tolerance = self.tolerance * (MOTION_TOLERANCE / TOLERANCE)
            found = lowest_order(land, self.camera.charge_diffusion_px, tolerance, still.order, least)
        else:
            fewer = tuple(one for one in ladder if math.prod(one) * wavelength_nm.shape[1] <= MOST_RAYS)
            found = self._converged(seen, few, points, probes, fewer)
        if found is None:
            return None
        return self._planned(mode, *found, wavelength_nm.shape[1], times)

    def _planned(self, mode: str, order: tuple[int, int], error: float, nodes: int, times: int) -> PupilPlan:
        """A plan of an order."""
        fixed = self.pupil.exact and mode == "quadrature"
        pupil = staggered(order, nodes, times) if fixed else None
        return PupilPlan(mode, order[0] * order[1], error, pupil, order)

    def _converged(
        self,
        seen: Seen,
        wavelength_nm: FloatArray,
        points: Callable[[tuple[int, int]], PupilPoints],
        probes: IntArray,
        ladder: Ladder,
    ) -> tuple[tuple[int, int], float] | None:
        """Lowest order that is converged for probe stars at rest, on stamps that hold their light."""
        if not (ladder and self._blurred):
            return None
        stars = probes.astype(np.uint32)
        x, y, ok = (v.reshape(*v.shape[:2], -1) for v in seen.nodes.land(points(ladder[0]), wavelength_nm, stars))
        if not ok.any():
            return None
        low, high = (
            np.stack([f(np.where(ok, v, end), axis=2) for v in (x, y)], axis=-1)
            for f, end in ((np.min, np.inf), (np.max, -np.inf))
        )
        empty = ~np.isfinite(low)
        room = reach_px(self.camera.charge_diffusion_px) + 1.0 + RIM_BEYOND * np.where(empty, 0.0, high - low)
        corner = np.where(empty, 0.0, np.floor(low - room)) - 0.5
        size = math.ceil(float(np.where(empty, 0.0, high - low + 2.0 * room).max())) + 1
        if size > WIDEST_TRIAL_PX:
            return None
        share = np.full((len(probes), *wavelength_nm.shape), 1.0 / wavelength_nm.shape[1])

        def trial(order: tuple[int, int]) -> Trial:
            stamps = seen.nodes.splat(
                stars=stars,
                pupil=points(order),
                wavelength_nm=wavelength_nm,
                node_share=share,
                corner_px=corner,
                stamp_px=size,
                cells_per_px=2,
            )
            return Trial.of(stamps, size)

        return converged_order(trial, self.tolerance, ladder)
