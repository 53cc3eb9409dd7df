"""From a star field and a camera to the noiseless image and its truth: plan, trace in passes, compose, account."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.errors import DomainError
from optics.lens import LensSystem
from optics.program import compile_lens
from optics.pupil import EntrancePupil, entrance_pupil, gauss_disk
from render.camera import Camera
from render.compose import add_stamps
from render.records import StarField, Truth
from render.sampling import PROBES, TOLERANCE, PupilPlan, bounding_points, quadrature_plan, sobol_plan
from render.star_kernel import KERNEL_REACH, Geometry, StarKernel, oversampling

__all__ = ["TracedStars", "Tracer"]

FloatArray = NDArray[np.float64]

PASS_BYTES = 48 << 20
"""Memory of the stamps of one pass; the number of rays does not count."""
PASS_RAYS = 1 << 27
MARGIN_PX = 0.75
"""Room around the bounding rays of a stamp; doubled when a ray falls outside all the same."""
STAMP_LIMIT_PX = 1024


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


class Tracer:
    """Renders star fields through one camera; holds what can be reused between fields.

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
        self.pupil: EntrancePupil = entrance_pupil(lens)
        self.program, self.theta = compile_lens(_open_stop(lens) if self.pupil.exact else lens, general=general)
        self.fine = oversampling(camera.charge_diffusion_px)
        self._plans: dict[Any, PupilPlan] = {}

    def _kernel(self, direction: FloatArray, rotation: FloatArray) -> StarKernel:
        pupil = self.pupil
        geometry = Geometry(
            rotation=rotation,
            pitch_mm=self.camera.pixel_pitch_mm,
            centre_px=self.camera.centre_px,
            pupil_mm=(pupil.x_mm, pupil.y_mm, pupil.z_mm),
            pupil_radius_mm=pupil.radius_mm,
            diffusion_px=self.camera.charge_diffusion_px,
        )
        return StarKernel(self.mi, self.program, self.theta, geometry, direction)

    def render(
        self,
        stars: StarField,
        *,
        exposure_s: float,
        rotation_cam_from_world: FloatArray | None = None,
        clear: NDArray[np.float32] | None = None,
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
        clear : (h, w, b) float32, optional
            Image to add to, in place of zeros.

        Raises
        ------
        DomainError
            Exposure not positive, wavelength outside a glass's range, star behind the camera.
        """
        camera = self.camera
        if not (exposure_s > 0 and np.isfinite(exposure_s)):
            raise DomainError(f"exposure {exposure_s} s; it must be positive")
        rotation = camera.rotation_cam_from_world if rotation_cam_from_world is None else rotation_cam_from_world
        camera.lens.check_wavelength(stars.wavelength_nm)
        cosine = stars.direction @ rotation[2]
        if np.any(cosine <= 0):
            first = int(np.argmax(cosine <= 0))
            angle = np.degrees(np.arccos(np.clip(cosine[first], -1, 1)))
            raise DomainError(
                f"star {first} lies behind the camera ({angle:.1f} deg from its axis); leave out stars beyond 90 deg"
            )
        bands = len(stars.band)
        image = np.zeros((camera.height_px, camera.width_px, bands), np.float32) if clear is None else clear
        rate = stars.photon_rate * camera.response_at(stars.wavelength_nm)
        per_node = rate * (self.pupil.area_mm2 * exposure_s) * cosine[:, None, None]
        electrons_in = per_node.sum(2)
        share = np.where(electrons_in[..., None] > 0, per_node, 1.0)
        share = share / share.sum(2, keepdims=True)
        sums = _Sums.zeros(len(stars), bands)
        sampling: dict[str, tuple[int, int]] = {}
        if len(stars):
            kernel = self._kernel(stars.direction, rotation)
            bounds = self._bounds(kernel, stars.wavelength_nm)
            for plan, members in self._groups(stars, rotation, share, bounds):
                sampling[plan.mode] = (len(members), plan.rays_per_node * stars.wavelength_nm.shape[1])
                self._trace_group(kernel, plan, members, stars.wavelength_nm, share, electrons_in, bounds, image, sums)
            self._chief(kernel, stars.wavelength_nm, share, sums)
        return TracedStars(image, sums.truth(electrons_in), sampling)

    def bundle_means(self, stars: StarField, *, rings: int = 6, arms: int = 14) -> FloatArray:
        """Mean landing point (n, b, 2) [px] of every star and band, without an image; NaN where no ray arrives.

        A low quadrature order does: the mean of a bundle converges long before its image.
        """
        rate = stars.photon_rate * self.camera.response_at(stars.wavelength_nm)
        share = np.where(rate.sum(2, keepdims=True) > 0, rate, 1.0)
        samples = gauss_disk(rings, arms)
        points = np.broadcast_to(np.column_stack([samples.x, samples.y]), (share.shape[2], len(samples.x), 2))
        kernel = self._kernel(stars.direction, self.camera.rotation_cam_from_world)
        x, y, ok = kernel.land(points, stars.wavelength_nm)
        weight = share[..., None] * samples.weight * ok
        with np.errstate(invalid="ignore"):
            return np.stack([(weight * v).sum((2, 3)) / weight.sum((2, 3)) for v in (x, y)], axis=-1)

    def centred_cells(self, stars: StarField, *, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light of every star and band on a fine grid around its bundle mean.

        Parameters
        ----------
        stars : StarField
            Stars; each needs a clear way to the detector.
        half_size_px : int
            The grid reaches from ``-half_size_px - 0.5`` to ``half_size_px + 0.5`` px.
        cells_per_px : int
            Cells along a pixel.

        Returns
        -------
        (n, b, m, m)
            Share of the collected light per cell, ``m = (2 half_size_px + 1) * cells_per_px``.
        """
        rotation = self.camera.rotation_cam_from_world
        rate = stars.photon_rate * self.camera.response_at(stars.wavelength_nm)
        share = np.where(rate.sum(2, keepdims=True) > 0, rate, 1.0)
        share = share / share.sum(2, keepdims=True)
        kernel = self._kernel(stars.direction, rotation)
        corner = self.bundle_means(stars, rings=10, arms=22) - (half_size_px + 0.5)
        side = (2 * half_size_px + 1) * cells_per_px
        result = np.empty((*corner.shape[:2], side, side))
        for plan, members in self._groups(stars, rotation, share, self._bounds(kernel, stars.wavelength_nm)):
            step = max(1, PASS_BYTES // (corner.shape[1] * side**2 * 16))
            for part in (members[i : i + step] for i in range(0, len(members), step)):
                cells, moments = kernel.splat(
                    stars=part.astype(np.uint32),
                    pupil=plan.points,
                    pupil_weight=plan.weight,
                    wavelength_nm=stars.wavelength_nm,
                    node_share=np.ascontiguousarray(share[part]),
                    corner_px=corner[part],
                    stamp_px=2 * half_size_px + 1,
                    cells_per_px=cells_per_px,
                )
                result[part] = cells / (1.0 - moments[..., 1])[..., None, None]
        return result

    def bundles(self, stars: StarField) -> Callable[[int, int], tuple[FloatArray, FloatArray, FloatArray]]:
        """Landing points ray by ray, for a few stars.

        Returns
        -------
        callable
            ``(star, band) -> (x_px, y_px, weight)`` of the rays that arrive, each (r,); the weights are shares of the
            star's collected light.
        """
        rotation = self.camera.rotation_cam_from_world
        rate = stars.photon_rate * self.camera.response_at(stars.wavelength_nm)
        share = np.where(rate.sum(2, keepdims=True) > 0, rate, 1.0)
        share = share / share.sum(2, keepdims=True)
        kernel = self._kernel(stars.direction, rotation)
        bounds = self._bounds(kernel, stars.wavelength_nm)
        landed = {}
        for plan, members in self._groups(stars, rotation, share, bounds):
            part = self._kernel(stars.direction[members], rotation)
            x, y, ok = part.land(plan.points, stars.wavelength_nm)
            weight = share[members][..., None] * plan.weight
            for i, star in enumerate(members):
                landed[int(star)] = (x[i], y[i], weight[i], ok[i])

        def bundle(star: int, band: int) -> tuple[FloatArray, FloatArray, FloatArray]:
            x, y, weight, ok = (values[band] for values in landed[star])
            return x[ok], y[ok], weight[ok]

        return bundle

    def _bounds(self, kernel: StarKernel, wavelength_nm: FloatArray) -> _Bounds:
        """Extent of every bundle [px] and whether it is clear."""
        ends = np.stack([wavelength_nm.min(1), np.median(wavelength_nm, 1), wavelength_nm.max(1)], axis=1)
        points = np.broadcast_to(bounding_points(), (3, *bounding_points().shape))
        n, b = kernel.count, len(wavelength_nm)
        low, high = np.full((n, b, 2), np.inf), np.full((n, b, 2), -np.inf)
        clear = np.zeros(n, bool)
        step = max(1, (4 << 20) // (b * 3 * points.shape[1]))
        for start in range(0, n, step):
            part = slice(start, min(n, start + step))
            x, y, ok = kernel.land(points, ends, part)
            for axis, value in enumerate((x, y)):
                low[part, :, axis] = np.where(ok, value, np.inf).min((2, 3))
                high[part, :, axis] = np.where(ok, value, -np.inf).max((2, 3))
            clear[part] = ok.all((1, 2, 3))
        return _Bounds(low, high, clear)

    def _groups(
        self, stars: StarField, rotation: FloatArray, share: FloatArray, bounds: _Bounds
    ) -> list[tuple[PupilPlan, NDArray[np.int64]]]:
        """Stars that share a sampling plan."""
        quadrature = bounds.clear if self.pupil.exact else np.zeros(len(stars), bool)
        groups = []
        if quadrature.any():
            members = np.flatnonzero(quadrature)
            groups.append((self._quadrature(stars, rotation, share, members), members))
        if not quadrature.all():
            nodes = stars.wavelength_nm.shape[1]
            key = ("sobol", nodes)
            if key not in self._plans:
                self._plans[key] = sobol_plan(nodes, self.sobol_seed, self.sobol_log2_rays)
            groups.append((self._plans[key], np.flatnonzero(~quadrature)))
        return groups

    def _quadrature(
        self, stars: StarField, rotation: FloatArray, share: FloatArray, members: NDArray[np.int64]
    ) -> PupilPlan:
        """Plan for clear pupils, from a few probe stars: those farthest off axis and some between."""
        off_axis = np.argsort(stars.direction[members] @ rotation[2])
        pick = np.unique(np.linspace(0, len(members) - 1, PROBES).astype(int)[: len(members)])
        probes = members[off_axis[pick]]
        reach = np.arccos(np.clip((stars.direction[probes] @ rotation[2]).min(), -1, 1))
        key = (stars.wavelength_nm.tobytes(), round(float(np.degrees(reach)) * 4))
        if key not in self._plans:
            probe = self._kernel(stars.direction[probes], rotation)
            self._plans[key] = quadrature_plan(
                probe, stars.wavelength_nm, share[probes], self.camera.charge_diffusion_px, self.tolerance
            )
        return self._plans[key]

    def _trace_group(
        self,
        kernel: StarKernel,
        plan: PupilPlan,
        members: NDArray[np.int64],
        wavelength_nm: FloatArray,
        share: FloatArray,
        electrons_in: FloatArray,
        bounds: _Bounds,
        image: NDArray[np.float32],
        sums: _Sums,
    ) -> None:
        """Trace stars of one plan in passes, largest stamps last, and redo those whose stamp was too small."""
        bands, nodes = wavelength_nm.shape
        kernel_px = KERNEL_REACH * self.camera.charge_diffusion_px
        margin = np.full(len(members), MARGIN_PX)
        todo = np.arange(len(members))
        while len(todo):
            stars = members[todo]
            low, high = bounds.box(stars, kernel_px + margin[todo])
            size = np.minimum(np.ceil(high - low).max((1, 2)).astype(int) + 1, STAMP_LIMIT_PX)
            order = np.argsort(size, kind="stable")
            redo = []
            start = 0
            while start < len(order):
                stop = self._pass_end(size[order], start, bands, bands * nodes * plan.rays_per_node)
                part, stamp_px = order[start:stop], int(size[order[stop - 1]])
                corner = np.floor(low[part]) - 0.5
                cells, moments = kernel.splat(
                    stars=stars[part].astype(np.uint32),
                    pupil=plan.points,
                    pupil_weight=plan.weight,
                    wavelength_nm=wavelength_nm,
                    node_share=np.ascontiguousarray(share[stars[part]]),
                    corner_px=corner,
                    stamp_px=stamp_px,
                    cells_per_px=self.fine,
                )
                lost = (moments[..., 2] > 1e-12).any(1)
                if lost.any() and stamp_px < STAMP_LIMIT_PX:
                    redo.append(todo[part[lost]])
                    keep = ~lost
                    part, corner, cells, moments = part[keep], corner[keep], cells[keep], moments[keep]
                on_image = add_stamps(image, cells, corner, electrons_in[stars[part]], self.fine)
                sums.store(stars[part], cells, moments, corner, stamp_px, electrons_in[stars[part]], on_image)
                start = stop
            todo = np.concatenate(redo) if redo else np.empty(0, int)
            margin[todo] = 2 * margin[todo] + 2.0

    def _pass_end(self, size: NDArray[np.int64], start: int, bands: int, rays: int) -> int:
        """End of the longest run of stars (sorted by stamp size) that fits into one pass."""
        count = np.arange(1, len(size) - start + 1)
        stamp_bytes = count * bands * (size[start:] * self.fine) ** 2 * 16
        fits = (stamp_bytes <= PASS_BYTES) & (count * rays <= PASS_RAYS) & (size[start:] <= 1.6 * size[start] + 4)
        return start + max(1, int(np.count_nonzero(fits)))

    def _chief(self, kernel: StarKernel, wavelength_nm: FloatArray, share: FloatArray, sums: _Sums) -> None:
        """Chief rays at each band's mean wavelength."""
        mean = (share.mean(0) * wavelength_nm).sum(1, keepdims=True)
        x, y, ok = kernel.land(np.zeros((1, 1, 2)), mean, slice(0, kernel.count))
        sums.chief_x[...] = np.where(ok, x, np.nan)[..., 0, 0]
        sums.chief_y[...] = np.where(ok, y, np.nan)[..., 0, 0]


@dataclass(frozen=True, slots=True)
class _Bounds:
    """Lowest and highest landing point (n, b, 2) [px], and whether every bounding ray arrived."""

    low: FloatArray
    high: FloatArray
    clear: NDArray[np.bool_]

    def box(self, stars: NDArray[np.int64], margin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Boxes with a margin; a unit box at the origin where no ray arrives."""
        low, high = self.low[stars], self.high[stars]
        empty = ~np.isfinite(low)
        m = margin[:, None, None]
        return np.where(empty, 0.0, low) - m, np.where(empty, 0.0, high) + m


@dataclass(frozen=True, slots=True)
class _Sums:
    """Truth under construction, every field (n, b)."""

    chief_x: FloatArray
    chief_y: FloatArray
    bundle_x: FloatArray
    bundle_y: FloatArray
    photon_x: FloatArray
    photon_y: FloatArray
    image: FloatArray
    vignetted: FloatArray
    off_edge: FloatArray
    variance_x: FloatArray
    variance_y: FloatArray

    @classmethod
    def zeros(cls, stars: int, bands: int) -> _Sums:
        return cls(*(np.full((stars, bands), np.nan) for _ in cls.__dataclass_fields__))

    def store(
        self,
        stars: NDArray[np.int64],
        cells: FloatArray,
        moments: FloatArray,
        corner: FloatArray,
        stamp_px: int,
        electrons_in: FloatArray,
        on_image: FloatArray,
    ) -> None:
        """Moments of one pass; ``on_image`` (s, b) is the share that reached pixels of the image."""
        arrived = moments[..., 0]
        landed = cells.sum((2, 3))
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = moments[..., 3:5] / arrived[..., None]
            variance = moments[..., 5:7] / arrived[..., None] - mean**2
            along = (np.arange(cells.shape[-1]) + 0.5) * (stamp_px / cells.shape[-1])
            photon_x = cells.sum(2) @ along / landed
            photon_y = cells.sum(3) @ along / landed
        self.bundle_x[stars] = corner[..., 0] + mean[..., 0] * stamp_px
        self.bundle_y[stars] = corner[..., 1] + mean[..., 1] * stamp_px
        self.variance_x[stars] = variance[..., 0] * stamp_px**2
        self.variance_y[stars] = variance[..., 1] * stamp_px**2
        self.photon_x[stars] = corner[..., 0] + photon_x
        self.photon_y[stars] = corner[..., 1] + photon_y
        self.image[stars] = on_image * electrons_in
        self.vignetted[stars] = moments[..., 1] * electrons_in
        self.off_edge[stars] = (landed - on_image + moments[..., 2]) * electrons_in

    def truth(self, electrons_in: FloatArray) -> Truth:
        """The finished record."""
        return Truth(
            chief_x_px=self.chief_x,
            chief_y_px=self.chief_y,
            bundle_x_px=self.bundle_x,
            bundle_y_px=self.bundle_y,
            photon_x_px=self.photon_x,
            photon_y_px=self.photon_y,
            electrons_in=electrons_in,
            electrons_image=self.image,
            electrons_vignetted=self.vignetted,
            electrons_off_edge=self.off_edge,
            variance_x_px2=self.variance_x,
            variance_y_px2=self.variance_y,
        )
