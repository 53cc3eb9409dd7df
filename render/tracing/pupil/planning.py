"""Sampling plan of stars: outlines, adaptive quadrature orders, groups of stars."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.lens.system import LensSystem
from optics.light.collimation import Collimation
from optics.rays.entrance_pupil import EntrancePupil, entrance_pupil, launch_disks, stop_in_front
from optics.rays.marginal_rays import check_axial_rays
from optics.rays.program import compile_lens
from optics.rays.ray_aiming import aim_frame
from optics.rays.vignetted_pupil import inner_points
from render.camera import Camera, launch_disk
from render.tracing.convergence import HIGHEST_FREQUENCY, MOTION_TOLERANCE, TOLERANCE
from render.tracing.motion.exposure import IdealLens
from render.tracing.motion.paths import StarPaths, at_rest, pick_times, uniform_paths
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
from render.tracing.pupil.points import DiskPoints, PupilPoints, SobolPoints
from render.tracing.pupil.quadrature_order import (
    LADDER,
    OUTLINE_LADDER,
    Landed,
    Trial,
    bounding_disk,
    converged_order,
    lowest_order,
    probe_fields,
    probe_nodes,
    sobol_points,
    staggered,
)
from render.tracing.pupil.ray_aiming import Chiefs, aimed_lens, find_chiefs
from render.tracing.pupil.transmission import PupilTransmission, fit_transmission
from render.tracing.rays.kernel import Geometry, Shade, StarKernel, reach_px

Order = tuple[int, int]
"""Rings and azimuths."""
Points = Callable[[IntArray], PupilPoints]

MOTION_FIELDS = (0, 1, 6, 9, 12, 15)
"""Probe fields of trials under motion."""
MOST_TRIAL_TIMES = 72
"""Time nodes of a trial; of a longer trail a part is tried."""
LEAST_ORDER, LEAST_ARC_ORDER = (2, 3), (2, 20)
LEAST_DAMPED = 0.72
"""Charge diffusion [px] times the highest frequency below which too much of that is left."""
MOST_RAYS = 1 << 18
"""Rays per star and band beyond which no quadrature is tried; Sobol points are within 1e-4."""
UNBLURRED_MORE = 2
"""Increase of the logarithm of the number of Sobol points then: a pixel's edge counts rays, and what that misses falls
as their number to the power -3/4 (4e-4 of the light by 2^16, below 1e-4 by 2^18)."""
RIM_BEYOND = 0.25
"""How far the rim of a spot is looked for beyond the rays of the lowest order, in terms of their extent."""
MEANS_RUNG = 4
"""Order, counted from the lowest, by which means of bundles whose images are made by waves are found."""
WIDEST_TRIAL_PX = 200
"""Size of the stamps of a trial; wider spots are left to Sobol points."""
SHADE_LOG2_RAYS, SHADE_RAYS = 14, 1 << 27
"""Rays of a star that detect a body in its beam (of 3e-4 of it, nearly always); rays of all stars at a time."""
BOUND_RAYS = 1 << 20
DISTORTION = 0.05
"""Assumed deviation of an image path from that of an ideal lens, as a fraction; larger ones are rendered again."""
SHORTEST_PX = 0.25
"""Path below which the order is that of a star at rest."""


@dataclass(frozen=True, eq=False)
class PlannedExposure:
    """Stars of an exposure; made by `PupilPlanner.exposure`."""

    planner: PupilPlanner
    mid: StarKernel  # In the middle of the exposure
    nodes: StarKernel  # At its time nodes; ``mid`` for a camera at rest
    picks: NodePicks  # Nodes at which outlines are solved
    paths: StarPaths
    length_px: float  # Length of the paths
    wavelength_nm: FloatArray  # (b, k) All wavelengths
    shade: Shade | None  # Bodies between the sky and the lens
    shaded: BoolArray | None  # (n,) Stars with a body in their beam or in the disk around it
    known_chiefs: Chiefs | None = None  # In place of those at the mean of each band's wavelengths

    @cached_property
    def chiefs(self) -> Chiefs:
        """Chief rays."""
        if self.known_chiefs is not None:
            return self.known_chiefs
        return self.planner.chiefs(self.mid, self.wavelength_nm)

    @property
    def ends_nm(self) -> FloatArray:
        """Lowest, median and highest wavelength (b, 3) of the bands."""
        waves = self.wavelength_nm
        return np.stack([waves.min(1), np.median(waves, 1), waves.max(1)], axis=1)


@dataclass(frozen=True, slots=True)
class Bounds:
    """Lowest and highest landing point (n, b, 2) [px], and whether every bounding ray arrived (n,)."""

    low: FloatArray
    high: FloatArray
    clear: NDArray[np.bool_]

    @classmethod
    def empty(cls, stars: int, bands: int) -> Bounds:
        """No rays yet."""
        shape = (stars, bands, 2)
        return cls(np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(stars, bool))

    def find(self, kernel: StarKernel, stars: IntArray, wavelength_nm: FloatArray, points: Points) -> None:
        """Fill in some stars (s,) of a kernel, by bounding points of them at wavelengths (b, 3)."""
        step = max(1, BOUND_RAYS // (len(wavelength_nm) * 3 * bounding_disk().count))
        for part in (stars[i : i + step] for i in range(0, len(stars), step)):
            landed = kernel.land(points(part), wavelength_nm, part.astype(np.uint32))
            x, y, ok = (v.reshape(*v.shape[:2], -1) for v in landed)
            self.clear[part] = ok.all((1, 2))
            for axis, value in enumerate((x, y)):
                self.low[part, :, axis] = np.where(ok, value, np.inf).min(2)
                self.high[part, :, axis] = np.where(ok, value, -np.inf).max(2)

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
    """Stars whose pupils are sampled alike: by "quadrature", "arcs", "sobol" points or "cells" of the launch disk.

    ``points`` computes points of some of them for a number of rings and azimuths; None for cells, which divide the
    disks that hold the beams (`PupilPlanner.disks`). Where outlines are smooth ``turns`` are the first azimuths (k,
    rings) on the rings, in parts of their distance.
    """

    mode: str
    members: IntArray
    points: Callable[[Order, IntArray], PupilPoints] | None
    outlines: Outlines | Arcs | None = None
    turns: Callable[[int], FloatArray] | None = None
    order: Order = (0, 0)  # Of the points of rays; sums of waves find their order star by star
    error: float = math.nan  # Of the points (`converged_order`)

    @property
    def rays(self) -> int:
        """Rays of a star, band and node."""
        return math.prod(self.order)

    def of(self, stars: IntArray, order: Order | None = None) -> PupilPoints:
        """Points of some stars, of the group's order or another one."""
        assert self.points is not None
        return self.points(order or self.order, stars)


@dataclass(frozen=True, slots=True)
class Sampled:
    """Sampling of stars."""

    groups: list[Group]  # No star is in two of them
    bounds: Bounds  # Of the rays of all stars, for images by rays
    outlines: Outlines | None  # By the stop alone; None where the launch disk is the stop
    nodes: tuple[int, int, int]  # n, b, t k

    @property
    def entrance(self) -> FloatArray:
        """Light (n, b, t k) that the stop alone would let through in that of the launch disk; NaN where unknown."""
        return np.ones(self.nodes) if self.outlines is None else self.outlines.entrance()


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


class PupilPlanner:
    """Plans the sampling of the stars of one camera, and keeps results."""

    def __init__(
        self, camera: Camera, *, sobol_log2_rays: int, sobol_seed: int, tolerance: float, general: bool
    ) -> None:
        self.camera, self.tolerance = camera, tolerance
        self.sobol_log2_rays, self.sobol_seed = sobol_log2_rays, sobol_seed
        lens = camera.focused_lens
        check_axial_rays(lens)
        self.pupil = unit_disk(lens)
        if not self.pupil.exact:
            launch_disk(camera)  # refuses a lens that lets no light through
        self.program, self.theta = compile_lens(_open_stop(lens) if self.pupil.exact else lens, general=general)
        self._aim = aimed_lens(lens, self.program, self.theta)
        self._plans: dict[Any, tuple[Order, float] | None] = {}
        self._transmissions: dict[bytes, PupilTransmission | None] = {}

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
            diffusion_px=self.camera.blur_px,
        )
        return StarKernel(self.program, self.theta, geometry, direction, shear, collimation, self.transmission)

    def transmission(self, wavelength_nm: FloatArray) -> PupilTransmission | None:
        """Transmission of rays over that of the axis at wavelengths (b, k); None where it is 1."""
        key = wavelength_nm.tobytes()
        if key not in self._transmissions:
            self._transmissions[key] = fit_transmission(self.camera, self.pupil, wavelength_nm)
        return self._transmissions[key]

    def received(self, nodes: FloatArray) -> FloatArray:
        """Light (n, t) of stars in directions (n, t, 3) that the launch disk takes, relative to the axis."""
        return np.asarray(nodes[..., 2])

    @property
    def _blurred(self) -> bool:
        """Whether charge diffusion softens the edges of pixels enough for a quadrature."""
        return self.camera.blur_px * HIGHEST_FREQUENCY >= LEAST_DAMPED

    def exposure(
        self,
        paths: StarPaths,
        wavelength_nm: FloatArray,
        length_px: float = 0.0,
        *,
        shade: Shade | None = None,
        chiefs: Chiefs | None = None,
    ) -> PlannedExposure:
        """Plan of an exposure, which aims the chief rays unless they are given."""
        mid = nodes = self.kernel(paths.mid, collimation=paths.collimation)
        if paths.nodes.shape[1] == 1 and paths.shear is None:
            picks, length_px = node_picks(mid, wavelength_nm), 0.0
        else:
            picked, times = pick_times(paths)
            picks = node_picks(self.kernel(picked), wavelength_nm, times)
            nodes = self.kernel(paths.nodes, paths.shear, paths.collimation)
        exposure = PlannedExposure(self, mid, nodes, picks, paths, length_px, wavelength_nm, shade, None, chiefs)
        return exposure if shade is None else replace(exposure, shaded=self._shaded(exposure, shade))

    def still(self, exposure: PlannedExposure, wavelength_nm: FloatArray) -> PlannedExposure:
        """The same stars in the middle of the exposure, at other wavelengths (b, k)."""
        if exposure.nodes is exposure.mid and wavelength_nm is exposure.wavelength_nm:
            return exposure
        rest = replace(at_rest(exposure.paths.mid), collimation=exposure.paths.collimation)
        return replace(
            self.exposure(rest, wavelength_nm, chiefs=exposure.chiefs), shade=exposure.shade, shaded=exposure.shaded
        )

    def _shaded(self, exposure: PlannedExposure, shade: Shade) -> BoolArray:
        """Stars (n,) with an obstacle in their beam or in the disk around it."""
        shaded = np.zeros(exposure.mid.count, np.bool_)
        near = np.flatnonzero(shade.near(launch_disk(self.camera)))
        pupil, step = SobolPoints(SHADE_LOG2_RAYS, self.sobol_seed), SHADE_RAYS >> SHADE_LOG2_RAYS
        for part in (near[i : i + step] for i in range(0, len(near), step)):
            disks = DiskPoints(pupil, *self.disks(exposure, exposure.wavelength_nm[:1], part))
            shaded[part] = exposure.mid.hidden_fraction(shade, disks, part.astype(np.uint32)) > 0.0
        return shaded

    def chiefs(self, kernel: StarKernel, wavelength_nm: FloatArray) -> Chiefs:
        """Chief rays, through the centre of the stop, at the mean of each band's nodes (b, k)."""
        mean = wavelength_nm.mean(1)
        centre = np.zeros((kernel.count, len(mean), 2)) if self.pupil.exact else None
        return find_chiefs(self._aim, kernel, mean, centre)

    def _outlined(self, exposure: PlannedExposure, cut: IntArray | None = None) -> tuple[list[Group], Outlines | None]:
        """Groups of stars whose beams have outlines, and outlines by the stop alone.

        Where the launch disk is the stop itself it is the outline of all but the stars that are ``cut``.
        """
        if not exposure.mid.count or self._aim.stop not in dict(self._aim.limits):
            return [], None
        if self.pupil.exact and self._aim.holes:
            return [], None
        groups: list[Group] = []
        if self.pupil.exact:
            outlines, centre = None, exposure.chiefs.points
            remaining = np.arange(exposure.mid.count) if cut is None else cut
        else:
            outlines = find_outlines(self._aim, exposure.picks, exposure.chiefs)
            centre, remaining = outlines.chief, np.flatnonzero(~outlines.clear)
            if outlines.clear.any():
                clear = np.flatnonzero(outlines.clear)
                groups.append(Group("quadrature", clear, outlines.points, outlines, outlines.turns))
        picks = exposure.picks
        for from_inside in (False,) if self._aim.holes else (False, True):
            if from_inside:  # about another point of the beam than the chief ray's, and at every wavelength
                if not len(remaining) or exposure.nodes is not exposure.mid:
                    break
                centre, lit = self._inside(exposure, remaining)
                picks, remaining = every_node(exposure.mid, exposure.wavelength_nm), remaining[lit]
            if len(remaining):
                arcs = find_arcs(self._aim, picks, centre, remaining)
                if len(arcs.stars):
                    groups.append(Group("arcs", arcs.stars, arcs.points, arcs))
                remaining = np.setdiff1d(remaining, arcs.stars)
        return groups, outlines

    def sampled(self, exposure: PlannedExposure, stars: IntArray, *, shapes: bool = True) -> Sampled:
        """Groups of some stars whose beams have outlines; not of those in whose beam something stands."""
        bands, colours = exposure.wavelength_nm.shape
        bounds, groups, cut = Bounds.empty(exposure.mid.count, bands), [], None
        open_ = stars if exposure.shaded is None else stars[~exposure.shaded[stars]]
        if self.pupil.exact:
            self._find_bounds(bounds, exposure, stars)
            clear, cut = open_[bounds.clear[open_]], open_[~bounds.clear[open_]]

            def turns(count: int) -> FloatArray:
                return np.repeat(0.5 + node_turns(colours)[:, None], count, axis=1)

            points = partial(staggered, nodes=colours, times=exposure.nodes.times)
            groups.append(Group("quadrature", clear, lambda order, _: points(order), turns=turns))
        outlines = None
        if shapes and (cut is None or len(cut)):
            outlined, outlines = self._outlined(exposure, cut)
            groups += [replace(group, members=np.intersect1d(group.members, open_)) for group in outlined]
        return Sampled(groups, bounds, outlines, (exposure.mid.count, bands, colours * exposure.nodes.times))

    def sampled_by_rays(self, exposure: PlannedExposure) -> Sampled:
        """Sampling of all stars by rays: stars without a converged quadrature are in the last group, of Sobol
        points."""
        everyone = np.arange(exposure.mid.count)
        sampled = self.sampled(exposure, everyone, shapes=self.camera.blur_px > 0.0)
        groups, bounds, remaining = [], sampled.bounds, everyone
        holed = any(surface.holed for surface in self.camera.lens.surfaces)
        for group in sampled.groups:
            if group.outlines is None and holed:
                continue
            plan = self.plan(group.mode, exposure, group.members)
            if plan is None:
                continue
            if group.outlines is not None:
                bounds.find(exposure.mid, group.members, exposure.picks.ends()[1], group.outlines.bounding)
            groups.append(replace(group, order=plan[0], error=plan[1]))
            remaining = np.setdiff1d(remaining, group.members)
        if not self.pupil.exact:
            self._find_bounds(bounds, exposure, remaining)
        log2_rays = self.sobol_log2_rays + (0 if self._blurred else UNBLURRED_MORE)
        sobol = sobol_points(sampled.nodes[2], self.sobol_seed, log2_rays)
        if exposure.nodes is not exposure.mid:
            bounds = bounds.moved(exposure.paths.shift_px)

        def moved(_: Order, stars: IntArray) -> DiskPoints:
            return DiskPoints(sobol, *self.disks(exposure, exposure.wavelength_nm, stars))

        groups.append(Group("sobol", remaining, moved, order=(sobol.count, 1)))
        return replace(sampled, groups=groups, bounds=bounds)

    def sampled_by_waves(self, exposure: PlannedExposure, stars: IntArray) -> Sampled:
        """Sampling of stars at rest for sums of plane waves: stars without an outline by cells."""
        sampled, remaining = self.sampled(exposure, stars), stars
        for group in sampled.groups:
            remaining = np.setdiff1d(remaining, group.members)
        groups = [*sampled.groups, Group("cells", remaining, None)]
        return replace(sampled, groups=[group for group in groups if len(group.members)])

    def _find_bounds(self, bounds: Bounds, exposure: PlannedExposure, stars: IntArray) -> None:
        """Bounds of stars by points of the disks that hold their beams."""

        def points(part: IntArray) -> DiskPoints:
            return DiskPoints(bounding_disk(), *self.disks(exposure, exposure.wavelength_nm, part))

        bounds.find(exposure.mid, stars, exposure.ends_nm, points)

    def _inside(self, exposure: PlannedExposure, stars: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """A point (n, b, 2) inside the beam of some of the stars, 0 for others, and for which there is one."""
        middle = np.median(exposure.wavelength_nm, 1)
        points, lit = inner_points(self.camera.focused_lens, exposure.paths.mid[stars], middle)
        centre = np.zeros((exposure.mid.count, len(middle), 2))
        centre[stars] = (points - [self.pupil.x_mm, self.pupil.y_mm]) / self.pupil.radius_mm
        return centre, np.asarray(lit.all(1))

    def disks(
        self, exposure: PlannedExposure, wavelength_nm: FloatArray, stars: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Disks that hold the beams of some stars: centres (s, b, 2) and radii (s, b), in radii of the launch disk."""
        shape = (len(stars), len(wavelength_nm))
        if self.pupil.exact or not len(stars):
            return np.zeros((*shape, 2)), np.ones(shape)
        times = exposure.paths.nodes.shape[1]
        ends = exposure.paths.nodes[stars][:, sorted({0, times // 2, times - 1})]
        disks = launch_disks(self.camera.focused_lens, ends.reshape(-1, 3), wavelength_nm.ravel())
        x, y, radius = (v.reshape(ends.shape[:2]) for v in (disks.x_mm, disks.y_mm, disks.radius_mm))
        middle = x.mean(1), y.mean(1)
        reach = (radius + np.hypot(x - middle[0][:, None], y - middle[1][:, None])).max(1)
        centre = np.stack([middle[0] - self.pupil.x_mm, middle[1] - self.pupil.y_mm], axis=-1)[:, None, :]
        unit = self.pupil.radius_mm
        return np.broadcast_to(centre / unit, (*shape, 2)), np.broadcast_to(reach[:, None] / unit, shape)

    def plan(self, mode: str, exposure: PlannedExposure, members: IntArray) -> tuple[Order, float] | None:
        """Order and error of a quadrature for some of the stars, which have to be clear; None if none is fit.

        By trial on a field of the stars' extent, under a uniform motion of the same number of time nodes and at most
        the same length. Extent and length are rounded: few different ones occur, and the plan depends on lens,
        wavelengths, extent and motion, not on the individual stars.
        """
        direction, wavelength_nm = exposure.paths.mid[members], exposure.wavelength_nm
        if not len(direction):
            return None
        step = math.radians(self.camera.lens.max_field_deg) / 16
        reach = math.acos(min(1.0, float(direction[:, 2].min())))
        steps = max(1, math.ceil(reach / step - 1e-9))
        length = exposure.length_px
        length = 2.0 ** (0.5 * math.floor(2.0 * math.log2(length))) if length > SHORTEST_PX else 0.0
        key = (mode, wavelength_nm.tobytes(), steps, exposure.nodes.times, length)
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
        still: tuple[Order, float] | None,
    ) -> tuple[Order, float] | None:
        """Lowest order that is converged for probe stars; under motion at most that of a camera at rest."""
        if self.camera.diffraction != "rays":  # rays make no image then
            fitting = LADDER if self.pupil.exact and mode == "quadrature" else OUTLINE_LADDER
            order = (ARC_LADDER if mode == "arcs" else fitting)[MEANS_RUNG]
            return order, math.nan
        if times > 1 and still is None:
            return None
        few = np.ascontiguousarray(wavelength_nm[:, probe_nodes(wavelength_nm.shape[1])])
        fields = probe_fields(reach_rad) if times == 1 else probe_fields(reach_rad)[list(MOTION_FIELDS)]
        tried = min(times, MOST_TRIAL_TIMES)
        part_px = length_px * tried / times
        paths = uniform_paths(fields, tried, part_px / IdealLens.of(self.camera).focal_px)
        exposure = self.exposure(paths, few, part_px)
        ladder: tuple[Order, ...] = LADDER
        points = partial(staggered, nodes=few.shape[1], times=tried)
        group = Group(mode, np.arange(len(paths.mid)), lambda order, _: points(order))
        if mode == "arcs" or not self.pupil.exact:
            outlined = [group for group in self._outlined(exposure)[0] if group.mode == mode]
            if not outlined:
                return still
            group, ladder = outlined[0], OUTLINE_LADDER if mode == "quadrature" else ARC_LADDER
        probes = group.members
        node_weight = None if times == 1 else np.repeat(paths.weight[0] / few.shape[1], few.shape[1])

        def land(order: Order) -> Landed:
            pupil = group.of(probes, order)
            return Landed(*exposure.nodes.land(pupil, few, probes.astype(np.uint32)), pupil.weight, node_weight)

        if still is not None:
            least = LEAST_ARC_ORDER if mode == "arcs" else LEAST_ORDER
            tolerance = self.tolerance * (MOTION_TOLERANCE / TOLERANCE)
            return lowest_order(land, self.camera.blur_px, tolerance, still[0], least)
        fewer = tuple(order for order in ladder if math.prod(order) * wavelength_nm.shape[1] <= MOST_RAYS)
        return self._converged(exposure, group, fewer)

    def _converged(
        self, exposure: PlannedExposure, group: Group, ladder: tuple[Order, ...]
    ) -> tuple[Order, float] | None:
        """Lowest order that is converged for probe stars at rest, on stamps that hold their light."""
        if not (ladder and self._blurred):
            return None
        probes, wavelength_nm = group.members, exposure.wavelength_nm
        stars = probes.astype(np.uint32)
        x, y, ok = (
            v.reshape(*v.shape[:2], -1) for v in exposure.nodes.land(group.of(probes, ladder[0]), wavelength_nm, stars)
        )
        if not ok.any():
            return None
        low, high = (
            np.stack([f(np.where(ok, v, end), axis=2) for v in (x, y)], axis=-1)
            for f, end in ((np.min, np.inf), (np.max, -np.inf))
        )
        empty = ~np.isfinite(low)
        room = reach_px(self.camera.blur_px) + 1.0 + RIM_BEYOND * np.where(empty, 0.0, high - low)
        corner = np.where(empty, 0.0, np.floor(low - room)) - 0.5
        size = math.ceil(float(np.where(empty, 0.0, high - low + 2.0 * room).max())) + 1
        if size > WIDEST_TRIAL_PX:
            return None
        node_weight = np.full((len(probes), *wavelength_nm.shape), 1.0 / wavelength_nm.shape[1])

        def trial(order: Order) -> Trial:
            stamps = exposure.nodes.splat(
                stars=stars,
                pupil=group.of(probes, order),
                wavelength_nm=wavelength_nm,
                node_weight=node_weight,
                corner_px=corner,
                stamp_px=size,
                cells_per_px=2,
            )
            return Trial.of(stamps, size)

        return converged_order(trial, self.tolerance, ladder)
