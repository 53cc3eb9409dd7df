"""Which stars are sampled how: outlines, quadrature orders found by trial, and groups for `render.tracing.passes`."""

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
from optics.rays.program import compile_lens
from optics.rays.pupil import EntrancePupil
from render.camera import Camera, launch_disk
from render.tracing.aimed_pupil import AimedLens, Chiefs, aimed_lens, find_chiefs
from render.tracing.convergence import MOTION_TOLERANCE, TOLERANCE
from render.tracing.ideal_lens import IdealLens
from render.tracing.kernel import Geometry, StarKernel
from render.tracing.outlines import NodePicks, Outlines, find_outlines, node_picks
from render.tracing.passes import Bounds, Group, find_bounds
from render.tracing.paths import StarPaths, pick_times, uniform_paths
from render.tracing.pupil_arcs import ARC_LADDER, Arcs, find_arcs
from render.tracing.pupil_points import PupilPoints, TablePoints
from render.tracing.sampling import (
    LADDER,
    OUTLINE_LADDER,
    Landed,
    PupilPlan,
    converged_order,
    lowest_order,
    probe_fields,
    probe_nodes,
    sobol_plan,
    staggered,
)
from render.tracing.wave_images import WaveGroup

__all__ = ["PupilPlanner", "Seen"]

Ladder = tuple[tuple[int, int], ...]

MOTION_FIELDS = (0, 1, 6, 9, 12, 15)
"""Probe fields that judge under motion."""
MOST_TRIAL_TIMES = 72
"""Time nodes of a trial; a longer trail is judged by a part of it."""
LEAST_ORDER, LEAST_ARC_ORDER = (2, 3), (2, 20)
SHORTEST_PX = 0.25
"""Path below which the order is that of a star at rest."""


@dataclass(frozen=True, slots=True)
class Seen:
    """Stars as an exposure sees them.

    Attributes
    ----------
    mid, nodes : StarKernel
        In the middle of the exposure, and at its time nodes; the same for a camera at rest.
    picks : NodePicks
        Where outlines are found.
    paths : StarPaths
        Directions.
    length_px : float
        Length of the paths.
    """

    mid: StarKernel
    nodes: StarKernel
    picks: NodePicks
    paths: StarPaths
    length_px: float


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
    """Decides how the stars of one camera are sampled, and keeps what it has found.

    Parameters
    ----------
    camera, sobol_log2_rays, sobol_seed, tolerance, general
        As `render.tracing.tracer.Tracer`.
    """

    def __init__(
        self, camera: Camera, *, sobol_log2_rays: int, sobol_seed: int, tolerance: float, general: bool
    ) -> None:
        self.camera, self.tolerance = camera, tolerance
        self.sobol_log2_rays, self.sobol_seed = sobol_log2_rays, sobol_seed
        lens = camera.focused_lens
        self.pupil: EntrancePupil = launch_disk(camera)
        self.program, self.theta = compile_lens(_open_stop(lens) if self.pupil.exact else lens, general=general)
        self._aim: AimedLens | None = None
        if not self.pupil.exact:
            self._aim = aimed_lens(lens, (self.program, self.theta), general=general)
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

    def seen(self, paths: StarPaths, wavelength_nm: FloatArray, length_px: float = 0.0) -> Seen:
        """What is needed of an exposure."""
        mid = self.kernel(paths.mid, collimation=paths.collimation)
        if paths.nodes.shape[1] == 1 and paths.shear is None:
            return Seen(mid, mid, node_picks(mid, wavelength_nm), paths, 0.0)
        picked, times = pick_times(paths)
        picks = node_picks(self.kernel(picked), wavelength_nm, times)
        return Seen(mid, self.kernel(paths.nodes, paths.shear, paths.collimation), picks, paths, length_px)

    def chiefs(self, kernel: StarKernel, wavelength_nm: FloatArray) -> Chiefs:
        """Chief rays, through the centre of the stop, at the mean of each band's nodes (b, k)."""
        mean = wavelength_nm.mean(1)
        if self._aim is not None:
            return find_chiefs(self._aim, kernel, mean)
        x, y, ok = kernel.land(TablePoints(np.zeros((1, 1, 2)), np.ones(1)), mean[:, None])
        points = np.zeros((kernel.count, len(mean), 2))
        return Chiefs(points, *(np.where(ok, v, np.nan)[..., 0, 0] for v in (x, y)))

    def shapes(self, seen: Seen, chiefs: Chiefs) -> list[tuple[str, IntArray, Outlines | Arcs]]:
        """Modes, their stars, and the outlines of these; none for a lens whose apertures have holes or no edge."""
        shapes: list[tuple[str, IntArray, Outlines | Arcs]] = []
        if self._aim is None or not self._aim.limits or not seen.mid.count:
            return shapes
        outlines = find_outlines(self._aim, seen.picks, chiefs)
        if outlines.clear.any():
            shapes.append(("quadrature", np.flatnonzero(outlines.clear), outlines))
        if outlines.cut.any():
            arcs = find_arcs(self._aim, seen.picks, outlines.chief, np.flatnonzero(outlines.cut))
            if len(arcs.stars):
                shapes.append(("arcs", arcs.stars, arcs))
        return shapes

    def groups(
        self, seen: Seen, wavelength_nm: FloatArray, chiefs: Chiefs, shaded: BoolArray | None = None
    ) -> tuple[list[Group], Bounds]:
        """Groups of stars that are sampled alike, the last of them able to take any star, and bounds of all stars.

        Stars (n,) that are ``shaded``, whose beams something may cut that the lens knows nothing of, go to the last.
        """
        everyone = np.arange(seen.mid.count)
        bounds = Bounds.empty(seen.mid.count, len(wavelength_nm))
        ends = np.stack([wavelength_nm.min(1), np.median(wavelength_nm, 1), wavelength_nm.max(1)], axis=1)
        groups, left = [], everyone
        if self.pupil.exact:
            find_bounds(seen.mid, bounds, everyone, ends)
            clear = bounds.clear if shaded is None else bounds.clear & ~shaded
            holed = any(surface.holed for surface in self.camera.lens.surfaces)
            plan = None if holed else self.plan("quadrature", wavelength_nm, seen, clear)
            if plan is not None:
                groups.append(_fixed_group(plan, everyone[clear]))
        elif self.camera.charge_diffusion_px > 0.0:
            for mode, every, shapes in self.shapes(seen, chiefs):
                members = every if shaded is None else every[~shaded[every]]
                plan = self.plan(mode, wavelength_nm, seen, members)
                if plan is not None:
                    find_bounds(seen.mid, bounds, members, seen.picks.ends()[1], shapes.bounding)
                    groups.append(Group(plan, members, partial(shapes.points, plan.order)))
        for group in groups:
            left = np.setdiff1d(left, group.members)
        if not self.pupil.exact:
            find_bounds(seen.mid, bounds, left, ends)
        sobol = sobol_plan(wavelength_nm.shape[1] * seen.nodes.times, self.sobol_seed, self.sobol_log2_rays)
        if seen.nodes is not seen.mid:
            bounds = bounds.moved(seen.paths.shift_px)
        return [*groups, _fixed_group(sobol, left)], bounds

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
        if self.pupil.exact:
            bounds = Bounds.empty(seen.mid.count, len(wavelength_nm))
            ends = np.stack([wavelength_nm.min(1), np.median(wavelength_nm, 1), wavelength_nm.max(1)], axis=1)
            find_bounds(seen.mid, bounds, stars, ends)
            clear = stars[bounds.clear[stars]]
            groups.append(WaveGroup("quadrature", clear, lambda order, _: staggered(order, nodes)))
        else:
            for mode, members, shapes in self.shapes(seen, chiefs):
                groups.append(WaveGroup(mode, np.intersect1d(members, stars), shapes.points))
        left = everyone
        for group in groups:
            left = np.setdiff1d(left, group.members)
        return [group for group in (*groups, WaveGroup("cells", left, None)) if len(group.members)]

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
        if not self.pupil.exact:
            shapes = [s for s in self.shapes(seen, self.chiefs(seen.mid, few)) if s[0] == mode]
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
            found = converged_order(land, self.camera.charge_diffusion_px, self.tolerance, ladder)
        if found is None:
            return None
        order, error = found
        pupil = staggered(order, wavelength_nm.shape[1], times) if self.pupil.exact else None
        return PupilPlan(mode, order[0] * order[1], error, pupil, order)
