"""From a star field and a camera to the noiseless image and its truth: plan, trace in passes, compose, account."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.chief import chief_ray_points
from optics.errors import ConvergenceError, DomainError
from optics.frames import field_angles_deg
from optics.lens import LensSystem
from optics.program import compile_lens
from optics.pupil import EntrancePupil, gauss_disk
from render.camera import Camera, launch_disk
from render.compose import TruthSums, add_stamps
from render.pupil_points import PupilPoints, TablePoints
from render.records import StarField, Truth
from render.sampling import TOLERANCE, PupilPlan, bounding_points, probe_fields, quadrature_plan, sobol_plan
from render.star_kernel import Geometry, StampSums, StarKernel, reach_px, strips_per_pixel

__all__ = ["TracedStars", "Tracer"]

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

PASS_BYTES = 48 << 20
"""Memory of the stamps of one pass; the number of rays does not count."""
PASS_RAYS = 1 << 27
BOUND_RAYS = 1 << 20
MARGIN_PX = 0.75
"""Room around the bounding rays of a stamp; doubled when a ray falls outside all the same."""
STAMP_LIMIT_PX = 1024
LIGHT = 1e-12
"""Share of a star's light below which none is lost (rounding of the sums)."""


@dataclass(frozen=True, slots=True)
class TracedStars:
    """Noiseless image (h, w, b) [e-], truth, and how the pupil was sampled: mode -> (stars, rays per star and band)."""

    electrons: NDArray[np.float32]
    truth: Truth
    sampling: dict[str, tuple[int, int]]


@dataclass(frozen=True, slots=True)
class _Light:
    """A star field as the tracer sees it: wavelengths (b, k), shares of nodes (n, b, k), electrons sent in (n, b)."""

    wavelength_nm: FloatArray
    share: FloatArray
    electrons: FloatArray


@dataclass(frozen=True, slots=True)
class _Bounds:
    """Lowest and highest landing point (n, b, 2) [px], and whether every bounding ray arrived (n,)."""

    low: FloatArray
    high: FloatArray
    clear: NDArray[np.bool_]

    def box(self, stars: IndexArray, margin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Boxes with a margin; a unit box at the origin where no ray arrives."""
        low, high = self.low[stars], self.high[stars]
        empty = ~np.isfinite(low)
        m = margin[:, None, None]
        return np.where(empty, 0.0, low) - m, np.where(empty, 0.0, high) + m


def _open_stop(lens: LensSystem) -> LensSystem:
    """The lens with a hair of room at its stop, for rays launched on the stop's very rim."""
    at = lens.stop_index
    stop = lens.surfaces[at]
    return lens.with_surfaces({at: replace(stop, semi_diameter_mm=stop.semi_diameter_mm * (1.0 + 1e-9))})


def _aimed(lens: LensSystem, direction: FloatArray, wavelength_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Chief rays (n, b) [mm] of a stop inside the lens; NaN for stars whose chief ray does not get through."""
    try:
        field_x, field_y = field_angles_deg(direction[:, None, :])
        with np.errstate(all="ignore"):
            return chief_ray_points(lens, field_x, field_y, wavelength_nm)
    except (ConvergenceError, DomainError):  # not converged, or gone astray
        n = len(direction)
        if n == 1:
            lost = np.full((1, len(wavelength_nm)), np.nan)
            return lost, lost
        halves = [_aimed(lens, part, wavelength_nm) for part in (direction[: n // 2], direction[n // 2 :])]
        return np.concatenate([x for x, _ in halves]), np.concatenate([y for _, y in halves])


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
        self, light: _Light, direction: FloatArray, image: NDArray[np.float32]
    ) -> tuple[TruthSums, dict[str, tuple[int, int]]]:
        """Add all stars to the image; what is known of them afterwards, and how they were sampled."""
        sums = TruthSums.empty(*light.electrons.shape)
        sampling: dict[str, tuple[int, int]] = {}
        if not len(direction):
            return sums, sampling
        kernel = self._kernel(direction)
        bounds = self._bounds(kernel, light.wavelength_nm)
        nodes = light.wavelength_nm.shape[1]
        plan, members, rest = self._quadrature(light.wavelength_nm, direction, bounds)
        if plan is not None:
            cut = self._trace_group(kernel, plan, members, light, bounds, image, sums)
            rest = np.sort(np.concatenate([rest, cut]))
            if len(members) > len(cut):
                sampling["quadrature"] = (len(members) - len(cut), plan.rays_per_node * nodes)
        if len(rest):
            plan = sobol_plan(nodes, self.sobol_seed, self.sobol_log2_rays)
            self._trace_group(kernel, plan, rest, light, bounds, image, sums)
            sampling["sobol"] = (len(rest), plan.rays_per_node * nodes)
        self._chief(kernel, light.wavelength_nm, direction, sums)
        return sums, sampling

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
        samples = gauss_disk(rings, arms)
        points = np.broadcast_to(np.column_stack([samples.x, samples.y]), (light.share.shape[2], len(samples.x), 2))
        x, y, ok = self._kernel(direction).land(TablePoints(points, samples.weight), light.wavelength_nm)
        weight = light.share[..., None] * samples.weight * ok
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
        bounds = self._bounds(kernel, light.wavelength_nm)
        plan, members, rest = self._quadrature(light.wavelength_nm, direction, bounds)
        sobol = sobol_plan(light.wavelength_nm.shape[1], self.sobol_seed, self.sobol_log2_rays)
        side = stamp_px * cells_per_px
        result = np.empty((*corner.shape[:2], side, side))
        step = max(1, PASS_BYTES // (corner.shape[1] * side**2 * 16))
        for used, stars_of in ((plan or sobol, members), (sobol, rest)):
            for part in (stars_of[i : i + step] for i in range(0, len(stars_of), step)):
                collected = self._splat(kernel, used, part, light, corner[part], stamp_px, cells_per_px)
                result[part] = collected.pixels / (1.0 - collected.moments[..., 1])[..., None, None]
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

    def _light(self, stars: StarField, direction: FloatArray, exposure_s: float) -> _Light:
        rate = stars.photon_rate * self.camera.response_at(stars.wavelength_nm)
        per_node = rate * (self.pupil.area_mm2 * exposure_s) * direction[:, 2, None, None]
        electrons = per_node.sum(2)
        share = np.where(electrons[..., None] > 0, per_node, 1.0)
        return _Light(stars.wavelength_nm, share / share.sum(2, keepdims=True), electrons)

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

    def _bounds(self, kernel: StarKernel, wavelength_nm: FloatArray) -> _Bounds:
        """Extent of every bundle [px] and whether it is clear."""
        ends = np.stack([wavelength_nm.min(1), np.median(wavelength_nm, 1), wavelength_nm.max(1)], axis=1)
        points = np.broadcast_to(bounding_points(), (3, *bounding_points().shape))
        rim: PupilPoints = TablePoints(points, np.full(points.shape[1], 1.0 / points.shape[1]))
        n, b = kernel.count, len(wavelength_nm)
        low, high = np.full((n, b, 2), np.inf), np.full((n, b, 2), -np.inf)
        clear = np.zeros(n, bool)
        step = max(1, BOUND_RAYS // (b * 3 * rim.count))
        for start in range(0, n, step):
            part = slice(start, min(n, start + step))
            x, y, ok = kernel.land(rim, ends, part)
            clear[part] = ok.all((1, 2, 3))
            for axis, value in enumerate((x, y)):
                low[part, :, axis] = np.where(ok, value, np.inf).min((2, 3))
                high[part, :, axis] = np.where(ok, value, -np.inf).max((2, 3))
        return _Bounds(low, high, clear)

    def _quadrature(
        self, wavelength_nm: FloatArray, direction: FloatArray, bounds: _Bounds
    ) -> tuple[PupilPlan | None, IndexArray, IndexArray]:
        """Quadrature plan, the stars it is for, and the others, for which Sobol points are needed.

        The plan is found by trial on a field of the stars' extent. That is rounded up, so that few different ones
        occur, and with it the plan depends on lens, wavelengths and extent only, not on which stars there are.
        """
        everyone = np.arange(len(direction))
        if not (self.pupil.exact and bounds.clear.any()):
            return None, everyone[:0], everyone
        step = math.radians(self.camera.lens.max_field_deg) / 16
        reach = math.acos(min(1.0, float(direction[bounds.clear, 2].min())))
        steps = max(1, math.ceil(reach / step - 1e-9))
        key = (wavelength_nm.tobytes(), steps)
        if key not in self._plans:
            probe = self._kernel(probe_fields(min(steps * step, 1.5)))
            self._plans[key] = quadrature_plan(probe, wavelength_nm, self.camera.charge_diffusion_px, self.tolerance)
        plan = self._plans[key]
        return (
            (None, everyone[:0], everyone) if plan is None else (plan, everyone[bounds.clear], everyone[~bounds.clear])
        )

    def _trace_group(
        self,
        kernel: StarKernel,
        plan: PupilPlan,
        members: IndexArray,
        light: _Light,
        bounds: _Bounds,
        image: NDArray[np.float32],
        sums: TruthSums,
    ) -> IndexArray:
        """Trace stars of one plan in passes, and again those whose stamp was too small.

        Returns the stars of a quadrature plan that turn out to lose light in the lens; they are not in the image yet.
        """
        reach = reach_px(self.camera.charge_diffusion_px)
        margin = np.full(len(members), MARGIN_PX)
        todo, cut = np.arange(len(members)), []
        while len(todo):
            low, high = bounds.box(members[todo], reach + margin[todo])
            redo = []
            for part, stamp_px in self._passes(high - low, len(light.wavelength_nm), plan, light):
                stars, corner = members[todo[part]], np.floor(low[part]) - 0.5
                collected = self._splat(kernel, plan, stars, light, corner, stamp_px)
                outside = np.asarray((collected.moments[..., 2] > LIGHT).any(1))
                if stamp_px == STAMP_LIMIT_PX and outside.any():
                    self._check_size(stars[outside], low[part][outside], high[part][outside])
                    outside[:] = False
                lost = np.asarray((collected.moments[..., 1] > LIGHT).any(1) & (plan.mode == "quadrature"))
                cut.append(stars[lost])
                redo.append(todo[part[outside & ~lost]])
                keep = ~(outside | lost)
                stars, corner, collected = stars[keep], corner[keep], collected.take(keep)
                on_image = add_stamps(image, collected.pixels, corner, light.electrons[stars])
                sums.store(stars, collected, corner, light.electrons[stars], on_image)
            todo = np.concatenate(redo)
            margin[todo] = 2 * margin[todo] + 2.0
        return np.concatenate(cut)

    def _splat(
        self,
        kernel: StarKernel,
        plan: PupilPlan,
        stars: IndexArray,
        light: _Light,
        corner_px: FloatArray,
        stamp_px: int,
        cells_per_px: int = 1,
    ) -> StampSums:
        return kernel.splat(
            stars=stars.astype(np.uint32),
            pupil=plan.pupil,
            wavelength_nm=light.wavelength_nm,
            node_share=np.ascontiguousarray(light.share[stars]),
            corner_px=corner_px,
            stamp_px=stamp_px,
            cells_per_px=cells_per_px,
        )

    def _passes(
        self, extent_px: FloatArray, bands: int, plan: PupilPlan, light: _Light
    ) -> list[tuple[IndexArray, int]]:
        """Stars (indices into ``extent_px``) that go into one pass each, and the size of their stamps."""
        size = np.minimum(np.ceil(extent_px).max((1, 2)).astype(int) + 1, STAMP_LIMIT_PX)
        order = np.argsort(size, kind="stable")
        per_pixel = 16 * bands
        strips = 2 * strips_per_pixel(self.camera.charge_diffusion_px)
        rays = light.wavelength_nm.size * plan.rays_per_node
        passes, start = [], 0
        while start < len(order):
            ahead = size[order[start:]]
            count = np.arange(1, len(ahead) + 1)
            fits = (count * per_pixel * ahead * (ahead + strips) <= PASS_BYTES) & (count * rays <= PASS_RAYS)
            stop = start + max(1, int(np.count_nonzero(fits & (ahead <= 1.6 * ahead[0] + 4))))
            passes.append((order[start:stop], int(size[order[stop - 1]])))
            start = stop
        return passes

    def _check_size(self, stars: IndexArray, low: FloatArray, high: FloatArray) -> None:
        """Refuse stars larger than the largest stamp, unless they are beside the image anyway."""
        edge = np.array([self.camera.width_px, self.camera.height_px]) - 0.5
        touches = np.asarray(np.any(np.all((high > -0.5) & (low < edge), axis=2), axis=1))
        if touches.any():
            worst = int(np.argmax(touches))
            raise DomainError(
                f"the image of star {stars[worst]} is {(high - low)[worst].max():.0f} px wide; at most "
                f"{STAMP_LIMIT_PX} px can be rendered; check the focus (defocus_mm = {self.camera.defocus_mm:g} mm)"
            )

    def _chief(self, kernel: StarKernel, wavelength_nm: FloatArray, direction: FloatArray, sums: TruthSums) -> None:
        """Chief rays, through the centre of the stop, at the mean of each band's nodes."""
        mean = wavelength_nm.mean(1)
        if self.pupil.exact:
            x, y, ok = kernel.land(TablePoints(np.zeros((1, 1, 2)), np.ones(1)), mean[:, None])
            sums.chief_x[...] = np.where(ok, x, np.nan)[..., 0, 0]
            sums.chief_y[...] = np.where(ok, y, np.nan)[..., 0, 0]
        else:
            x, y = _aimed(self.camera.focused_lens, direction, mean)
            sums.chief_x[...], sums.chief_y[...] = self.camera.to_pixel(x, y)
