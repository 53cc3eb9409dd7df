"""From a star field and a camera to the noiseless image and its truth: plan, trace in passes, compose, account."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.errors import DomainError
from optics.lens import LensSystem
from optics.program import compile_lens
from optics.pupil import EntrancePupil, gauss_disk
from render.aimed_pupil import Chiefs, aimed_lens, find_chiefs
from render.arrays import DrJitArrays
from render.camera import Camera, launch_disk
from render.compose import TruthSums
from render.outlines import Outlines, find_outlines
from render.passes import PASS_BYTES, Bounds, Group, Light, Passes, end_nodes, find_bounds
from render.pupil_arcs import ARC_LADDER, Arcs, find_arcs
from render.pupil_points import PupilPoints, TablePoints
from render.records import StarField, Truth
from render.sampling import (
    LADDER,
    OUTLINE_LADDER,
    TOLERANCE,
    Landed,
    PupilPlan,
    converged_order,
    probe_fields,
    probe_nodes,
    sobol_plan,
    staggered,
)
from render.star_kernel import Geometry, StarKernel

__all__ = ["TracedStars", "Tracer"]

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TracedStars:
    """Noiseless image (h, w, b) [e-], truth, and how the pupil was sampled: mode -> (stars, rays per star and band)."""

    electrons: NDArray[np.float32]
    truth: Truth
    sampling: dict[str, tuple[int, int]]


def _open_stop(lens: LensSystem) -> LensSystem:
    """The lens with a hair of room at its stop, for rays launched on the stop's very rim."""
    at = lens.stop_index
    stop = lens.surfaces[at]
    return lens.with_surfaces({at: replace(stop, semi_diameter_mm=stop.semi_diameter_mm * (1.0 + 1e-9))})


def _fixed_group(plan: PupilPlan, members: IndexArray) -> Group:
    """Stars that share the points of their plan."""
    pupil = plan.pupil
    assert pupil is not None
    return Group(plan, members, lambda stars: pupil)


def _unturned(order: tuple[int, int], nodes: int) -> TablePoints:
    """Gauss x trapezoid points of the whole disk, the same for every node."""
    samples = gauss_disk(*order)
    points = np.broadcast_to(np.column_stack([samples.x, samples.y]), (nodes, len(samples.x), 2))
    return TablePoints(points, np.asarray(samples.weight))


class Tracer:
    """Renders star fields through one camera; holds what can be reused between fields.

    What it renders depends on the camera, the settings below and the star field alone, not on earlier calls.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant.
    camera : Camera
        The camera; its attitude may be overridden per call.
    sobol_log2_rays : int
        Logarithm of the rays per star and band where the pupil is not round and clear.
    sobol_seed : int
        Seed of the scrambling.
    tolerance : float
        Of the quadrature, see `render.sampling`.
    general : bool
        Compile the lens with general poses, so that all perturbed copies of it share their kernels.

    Raises
    ------
    ConvergenceError
        If no ray of any field gets through the lens.
    """

    def __init__(
        self,
        mi: Any,
        camera: Camera,
        *,
        sobol_log2_rays: int = 16,
        sobol_seed: int = 0,
        tolerance: float = TOLERANCE,
        general: bool = False,
    ) -> None:
        self.mi, self.camera, self.tolerance = mi, camera, tolerance
        self.sobol_log2_rays, self.sobol_seed = sobol_log2_rays, sobol_seed
        lens = camera.focused_lens
        self.pupil: EntrancePupil = launch_disk(camera)
        self.program, self.theta = compile_lens(_open_stop(lens) if self.pupil.exact else lens, general=general)
        self._aim = None if self.pupil.exact else aimed_lens(lens, (self.program, self.theta), DrJitArrays(mi.Float64))
        self._plans: dict[Any, PupilPlan | None] = {}

    def render(
        self, stars: StarField, *, exposure_s: float, rotation_cam_from_world: FloatArray | None = None
    ) -> TracedStars:
        """Trace all stars in all bands.

        Parameters
        ----------
        stars : StarField
            Stars in the world frame.
        exposure_s : float
            Exposure time.
        rotation_cam_from_world : (3, 3), optional
            Attitude; the camera's own if left out.

        Raises
        ------
        DomainError
            Exposure not positive, wavelength outside a glass's range, star behind the camera, an image of a star larger
            than `STAMP_LIMIT_PX`.
        """
        if not (exposure_s > 0 and math.isfinite(exposure_s)):
            raise DomainError(f"exposure {exposure_s} s; it must be positive and finite")
        direction = self._in_cam(stars, rotation_cam_from_world)
        light = self._light(stars, direction, exposure_s)
        image = np.zeros((self.camera.height_px, self.camera.width_px, len(stars.band)), np.float32)
        sums, sampling = self._trace(light, direction, image)
        return TracedStars(image, sums.truth(light.electrons), sampling)

    def _trace(
        self, light: Light, direction: FloatArray, image: NDArray[np.float32]
    ) -> tuple[TruthSums, dict[str, tuple[int, int]]]:
        """Add all stars to the image; what is known of them afterwards, and how they were sampled."""
        sums = TruthSums.empty(*light.electrons.shape)
        sampling: dict[str, tuple[int, int]] = {}
        if not len(direction):
            return sums, sampling
        kernel = self._kernel(direction)
        groups, bounds = self._groups(kernel, light.wavelength_nm, sums)
        passes = Passes(self.camera, kernel, light, bounds, image, sums)
        left = np.empty(0, np.int64)
        for group in groups:
            plan, members = group.plan, np.sort(np.concatenate([group.members, left]))
            left = passes.trace(replace(group, members=members)) if len(members) else members
            if len(members) > len(left):
                sampling[plan.mode] = (len(members) - len(left), plan.rays_per_node * light.share.shape[2])
        return sums, sampling

    def _groups(self, kernel: StarKernel, wavelength_nm: FloatArray, sums: TruthSums) -> tuple[list[Group], Bounds]:
        """Groups of stars that are sampled alike, the last of them able to take any star, and bounds of all stars."""
        everyone = np.arange(kernel.count)
        bounds = Bounds.empty(kernel.count, len(wavelength_nm))
        ends = np.stack([wavelength_nm.min(1), np.median(wavelength_nm, 1), wavelength_nm.max(1)], axis=1)
        if self.pupil.exact:
            find_bounds(kernel, bounds, everyone, ends)
            self._chief(kernel, wavelength_nm, sums)
            groups = self._disk_groups(kernel, wavelength_nm, bounds)
        else:
            groups = self._outline_groups(kernel, wavelength_nm, bounds, sums)
        taken = np.concatenate([everyone[:0], *(group.members for group in groups)])
        left = np.setdiff1d(everyone, taken)
        if not self.pupil.exact:
            find_bounds(kernel, bounds, left, ends)
        sobol = sobol_plan(wavelength_nm.shape[1], self.sobol_seed, self.sobol_log2_rays)
        return [*groups, _fixed_group(sobol, left)], bounds

    def _disk_groups(self, kernel: StarKernel, wavelength_nm: FloatArray, bounds: Bounds) -> list[Group]:
        """Stars that fill a round pupil."""
        plan = self._plan("quadrature", wavelength_nm, kernel.direction[bounds.clear])
        return [] if plan is None else [_fixed_group(plan, np.flatnonzero(bounds.clear))]

    def _outline_groups(
        self, kernel: StarKernel, wavelength_nm: FloatArray, bounds: Bounds, sums: TruthSums
    ) -> list[Group]:
        """Stars whose beams have a known outline; their bounds, and the chief rays of all stars."""
        assert self._aim is not None
        chiefs = find_chiefs(self._aim, kernel, wavelength_nm.mean(1))
        sums.chief_x[...], sums.chief_y[...] = chiefs.x_px, chiefs.y_px
        outlines = self._outlines(kernel, wavelength_nm, chiefs) if self.camera.charge_diffusion_px > 0.0 else None
        if outlines is None:
            return []
        nodes = end_nodes(wavelength_nm.shape[1])
        picked = np.ascontiguousarray(wavelength_nm[:, nodes])
        groups = []
        for mode, members, shapes in self._shapes(outlines):
            plan = self._plan(mode, wavelength_nm, kernel.direction[members])
            if plan is not None:
                find_bounds(kernel, bounds, members, picked, partial(shapes.bounding, nodes))
                groups.append(Group(plan, members, partial(shapes.points, plan.order)))
        return groups

    @staticmethod
    def _shapes(outlines: Outlines) -> list[tuple[str, IndexArray, Outlines | Arcs]]:
        """Modes, their stars, and the outlines of these."""
        shapes: list[tuple[str, IndexArray, Outlines | Arcs]] = []
        if outlines.clear.any():
            shapes.append(("quadrature", np.flatnonzero(outlines.clear), outlines))
        if outlines.cut.any():
            stars = np.flatnonzero(outlines.cut)
            arcs = find_arcs(outlines.lens, outlines.kernel, outlines.chief, outlines.wavelength_nm, stars)
            if len(arcs.stars):
                shapes.append(("arcs", arcs.stars, arcs))
        return shapes

    def bundle_means(self, stars: StarField, *, rings: int = 6, arms: int = 14) -> FloatArray:
        """Mean landing point (n, b, 2) [px] of every star and band, without an image; NaN where no ray arrives.

        A low quadrature order does: the mean of a bundle converges long before its image.

        Raises
        ------
        DomainError
            Wavelength outside a glass's range, star behind the camera.
        """
        direction = self._in_cam(stars, None)
        light = self._light(stars, direction, 1.0)
        kernel = self._kernel(direction)
        wavelength_nm = light.wavelength_nm
        pupil: PupilPoints = _unturned((rings, arms), wavelength_nm.shape[1])
        means = self._means(kernel, light, np.arange(len(direction)), pupil)
        outlines = None if self.pupil.exact or not len(direction) else self._outlines(kernel, wavelength_nm)
        if outlines is not None:
            for members, points in ((np.flatnonzero(outlines.clear), outlines.points),):
                if len(members):
                    means[members] = self._means(kernel, light, members, points((rings, arms), members))
        return means

    @staticmethod
    def _means(kernel: StarKernel, light: Light, stars: IndexArray, pupil: PupilPoints) -> FloatArray:
        """Mean landing points (s, b, 2) of some stars."""
        x, y, ok = kernel.land(pupil, light.wavelength_nm, stars.astype(np.uint32))
        weight = light.share[stars][..., None] * pupil.weight * ok
        with np.errstate(invalid="ignore"):
            return np.stack([(weight * v).sum((2, 3)) / weight.sum((2, 3)) for v in (x, y)], axis=-1)

    def centred_cells(self, stars: StarField, *, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light of every star and band on a fine grid around its bundle mean.

        Parameters
        ----------
        stars : StarField
            Stars.
        half_size_px : int
            The grid reaches from ``-half_size_px - 0.5`` to ``half_size_px + 0.5`` px.
        cells_per_px : int
            Cells along a pixel.

        Returns
        -------
        (n, b, m, m)
            Share of the collected light per cell, ``m = (2 half_size_px + 1) * cells_per_px``.

        Raises
        ------
        DomainError
            Wavelength outside a glass's range, star behind the camera or without a way to the detector.
        """
        direction = self._in_cam(stars, None)
        light = self._light(stars, direction, 1.0)
        sums, _ = self._trace(light, direction, np.zeros((0, 0, len(stars.band)), np.float32))
        stamp_px = 2 * half_size_px + 1
        corner = np.stack([sums.bundle_x, sums.bundle_y], axis=-1) - 0.5 * stamp_px
        if np.isnan(corner).any():
            raise DomainError(f"star {np.argwhere(np.isnan(corner))[0][0]}: none of its light reaches the detector")
        kernel = self._kernel(direction)
        groups, bounds = self._groups(kernel, light.wavelength_nm, sums)
        passes = Passes(self.camera, kernel, light, bounds, np.zeros((0, 0, len(stars.band)), np.float32), sums)
        side = stamp_px * cells_per_px
        result = np.empty((*corner.shape[:2], side, side))
        step = max(1, PASS_BYTES // (corner.shape[1] * side**2 * 16))
        for group in groups:
            for part in (group.members[i : i + step] for i in range(0, len(group.members), step)):
                pupil = group.points(part)
                collected = passes.splat(pupil, part, corner[part], stamp_px, cells_per_px)
                light_in = 1.0 - collected.moments[..., 1] - passes.beside(pupil, part)
                result[part] = collected.pixels / light_in[..., None, None]
        return result

    def _in_cam(self, stars: StarField, rotation: FloatArray | None) -> FloatArray:
        """Directions (n, 3) in cam, after a check that the lens can take the light."""
        self.camera.lens.check_wavelength(stars.wavelength_nm)
        turned = stars.direction @ (self.camera.rotation_cam_from_world if rotation is None else rotation).T
        behind = turned[:, 2] <= 0
        if behind.any():
            first = int(np.argmax(behind))
            angle = np.degrees(np.arccos(np.clip(turned[first, 2], -1, 1)))
            raise DomainError(
                f"star {first} lies behind the camera ({angle:.1f} deg from its axis); leave out stars beyond 90 deg"
            )
        return np.asarray(turned)

    def _light(self, stars: StarField, direction: FloatArray, exposure_s: float) -> Light:
        rate = stars.photon_rate * self.camera.response_at(stars.wavelength_nm)
        per_node = rate * (self.pupil.area_mm2 * exposure_s) * direction[:, 2, None, None]
        electrons = per_node.sum(2)
        share = np.where(electrons[..., None] > 0, per_node, 1.0)
        return Light(stars.wavelength_nm, share / share.sum(2, keepdims=True), electrons)

    def _kernel(self, direction: FloatArray) -> StarKernel:
        """Kernel of stars whose directions are given in cam."""
        pupil = self.pupil
        geometry = Geometry(
            pitch_mm=self.camera.pixel_pitch_mm,
            centre_px=self.camera.centre_px,
            pupil_mm=(pupil.x_mm, pupil.y_mm, pupil.z_mm),
            pupil_radius_mm=pupil.radius_mm,
            diffusion_px=self.camera.charge_diffusion_px,
        )
        return StarKernel(self.mi, self.program, self.theta, geometry, direction)

    def _plan(self, mode: str, wavelength_nm: FloatArray, direction: FloatArray) -> PupilPlan | None:
        """Quadrature for stars in these directions (n, 3), which have to be clear; None if none is fit.

        It is found by trial on a field of the stars' extent. That is rounded up, so that few different ones occur, and
        with it the plan depends on lens, wavelengths and extent only, not on which stars there are.
        """
        if not len(direction):
            return None
        step = math.radians(self.camera.lens.max_field_deg) / 16
        reach = math.acos(min(1.0, float(direction[:, 2].min())))
        steps = max(1, math.ceil(reach / step - 1e-9))
        key = (mode, wavelength_nm.tobytes(), steps)
        if key not in self._plans:
            self._plans[key] = self._try_plan(mode, wavelength_nm, min(steps * step, 1.5))
        return self._plans[key]

    def _try_plan(self, mode: str, wavelength_nm: FloatArray, reach_rad: float) -> PupilPlan | None:
        """Lowest order that is converged for probe stars."""
        few = np.ascontiguousarray(wavelength_nm[:, probe_nodes(wavelength_nm.shape[1])])
        kernel = self._kernel(probe_fields(reach_rad))
        probes = np.arange(kernel.count)
        points: Callable[[tuple[int, int]], PupilPoints] = partial(staggered, nodes=few.shape[1])
        ladder: tuple[tuple[int, int], ...] = LADDER
        if not self.pupil.exact:
            outlines = self._outlines(kernel, few)
            assert outlines is not None
            found = [(members, shapes) for name, members, shapes in self._shapes(outlines) if name == mode]
            if not found:
                return None
            probes, points = found[0][0], partial(found[0][1].points, stars=found[0][0])
            ladder = OUTLINE_LADDER if mode == "quadrature" else ARC_LADDER

        def land(order: tuple[int, int]) -> Landed:
            pupil = points(order)
            return Landed(*kernel.land(pupil, few, probes.astype(np.uint32)), pupil.weight)

        converged = converged_order(land, self.camera.charge_diffusion_px, self.tolerance, ladder)
        if converged is None:
            return None
        order, error = converged
        pupil = staggered(order, wavelength_nm.shape[1]) if self.pupil.exact else None
        return PupilPlan(mode, order[0] * order[1], error, pupil, order)

    def _outlines(self, kernel: StarKernel, wavelength_nm: FloatArray, chiefs: Chiefs | None = None) -> Outlines | None:
        """Outlines of the beams of a kernel's stars; None for a lens whose apertures have holes or no edge."""
        if self._aim is None or not self._aim.limits:
            return None
        known = chiefs or find_chiefs(self._aim, kernel, wavelength_nm.mean(1))
        return find_outlines(self._aim, kernel, known, wavelength_nm)

    def _chief(self, kernel: StarKernel, wavelength_nm: FloatArray, sums: TruthSums) -> None:
        """Chief rays of an exact pupil, through its centre, at the mean of each band's nodes."""
        x, y, ok = kernel.land(TablePoints(np.zeros((1, 1, 2)), np.ones(1)), wavelength_nm.mean(1)[:, None])
        sums.chief_x[...] = np.where(ok, x, np.nan)[..., 0, 0]
        sums.chief_y[...] = np.where(ok, y, np.nan)[..., 0, 0]
