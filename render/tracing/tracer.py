"""From a star field and a camera to the noiseless image and its truth: plan, trace in passes, compose, account."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.errors import ConfigError, ConvergenceError, DomainError
from optics.frames import field_angles_deg
from optics.rays.pupil import EntrancePupil
from optics.rays.spots import spot_moments
from render.camera import Camera, launch_disk
from render.records import StarField, Truth
from render.tracing.convergence import TOLERANCE
from render.tracing.motion.exposure import ExposureMotion, IdealLens
from render.tracing.motion.paths import StarPaths, at_rest, pick_times, star_paths
from render.tracing.pupil.aim import Chiefs
from render.tracing.pupil.outlines import ARC_LADDER
from render.tracing.pupil.planning import PupilPlanner, Seen
from render.tracing.pupil.points import DiskPoints, PupilPoints, SobolPoints
from render.tracing.pupil.sampling import whole_disk
from render.tracing.rays.images import PASS_BYTES, PASS_RAYS, Light, Passes
from render.tracing.rays.kernel import ARRIVED, OUTSIDE, Shade, StarKernel
from render.tracing.truth import TruthSums
from render.tracing.waves.stars import WaveStars, check_lit

__all__ = ["TracedStars", "Tracer"]


SHADE_LOG2_RAYS = 14
"""Rays by which it is found out whether something stands in a beam: what hides 3e-4 of it is hardly missed."""
SHORTEST_PX = 1e-3
"""Path along which the lens's scale is not measured."""


@dataclass(frozen=True, slots=True)
class TracedStars:
    """Noiseless image (h, w, b) [e-], truth, and how the pupil was sampled: mode -> (stars, rays per star and band)."""

    electrons: NDArray[np.float32]
    truth: Truth
    sampling: dict[str, tuple[int, int]]


class Tracer:
    """Renders star fields through one camera; holds what can be reused between fields.

    What it renders depends on the camera, the settings below, star field and motion alone, not on earlier calls.

    Parameters
    ----------
    camera : Camera
        The camera; its attitude may be overridden per call.
    sobol_log2_rays : int
        Logarithm of the rays per star and band where quadrature does not serve; four times as many are taken where no
        charge diffusion softens the edges of the pixels.
    sobol_seed : int
        Seed of the scrambling.
    tolerance : float
        Of the quadrature, see `render.tracing.pupil.sampling`.
    general : bool
        Compile the lens with general poses, so that all perturbed copies of it share their kernels.

    Raises
    ------
    ConvergenceError
        If no ray of any field gets through the lens, or nothing limits a beam.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        sobol_log2_rays: int = 16,
        sobol_seed: int = 0,
        tolerance: float = TOLERANCE,
        general: bool = False,
    ) -> None:
        self.camera = camera
        self.planner = PupilPlanner(
            camera,
            sobol_log2_rays=sobol_log2_rays,
            sobol_seed=sobol_seed,
            tolerance=tolerance,
            general=general,
        )
        self._waves = WaveStars(self.planner)

    @property
    def pupil(self) -> EntrancePupil:
        """Disk that light is counted in: the stop in front of the lens, or else its paraxial entrance pupil."""
        return self.planner.pupil

    def render(
        self,
        stars: StarField,
        *,
        exposure_s: float,
        rotation_cam_from_world: FloatArray | None = None,
        motion: ExposureMotion | None = None,
        shade: Shade | None = None,
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
        motion : ExposureMotion, optional
            Attitudes during the exposure, in place of one. Truth then holds the chief ray in the middle of the exposure
            (with a rolling shutter: of the star's row) and means over the exposure of everything else.
        shade : Shade, optional
            What stands between the sky and the lens (`render.plugins.occlusion`). Stars whose beam it meets are sampled
            by Sobol points, as its edges are anywhere in the beam.

        Raises
        ------
        DomainError
            Exposure not positive or not that of the motion, wavelength outside a glass's range, star behind the camera,
            an image of a star larger than 1024 px, an image that outruns a rolling shutter.
        ConfigError
            Both an attitude and a motion.
        """
        if not (exposure_s > 0 and math.isfinite(exposure_s)):
            raise DomainError(f"exposure {exposure_s} s; it must be positive and finite")
        if motion is None:
            paths, length_px = self._in_cam(stars, rotation_cam_from_world), 0.0
        else:
            if rotation_cam_from_world is not None:
                raise ConfigError("an attitude and a motion are given; leave one of them out")
            paths, length_px = self._moving(stars, motion, exposure_s), motion.length_px
        light = self.light(stars, paths, exposure_s)
        image = np.zeros((self.camera.height_px, self.camera.width_px, len(stars.band)), np.float32)
        sums, sampling = self._trace(light, paths, image, length_px, shade)
        return TracedStars(image, sums.truth(light.electrons), sampling)

    def _trace(
        self,
        light: Light,
        paths: StarPaths,
        image: NDArray[np.float32],
        length_px: float = 0.0,
        shade: Shade | None = None,
    ) -> tuple[TruthSums, dict[str, tuple[int, int]]]:
        """Add all stars to the image; what is known of them afterwards, and how they were sampled."""
        sums = TruthSums.empty(*light.electrons.shape)
        sampling: dict[str, tuple[int, int]] = {}
        if not len(paths.mid):
            return sums, sampling
        seen = self.planner.seen(paths, light.wavelength_nm, length_px)
        chiefs = self.planner.chiefs(seen.mid, light.wavelength_nm)
        sums.chief_x[...], sums.chief_y[...] = (np.where(chiefs.blocked, np.nan, v) for v in (chiefs.x_px, chiefs.y_px))
        by_grid = np.empty(0, np.int64)
        if shade is None and image.size > 0:
            by_grid = self._waves.add_by_grid(light, seen, chiefs, image, sums, sampling)
        if not len(by_grid):
            return sums, self._trace_each(light, seen, chiefs, image, sums, shade)
        left = np.setdiff1d(np.arange(len(paths.mid)), by_grid)
        if len(left):
            some, others = light.take(left), TruthSums.empty(len(left), light.electrons.shape[1])
            seen = self.planner.seen(paths.take(left), light.wavelength_nm, length_px)
            sampling |= self._trace_each(some, seen, chiefs.take(left), image, others, shade)
            others.chief_x[...], others.chief_y[...] = sums.chief_x[left], sums.chief_y[left]
            sums.put(left, others)
        return sums, sampling

    def _trace_each(
        self,
        light: Light,
        seen: Seen,
        chiefs: Chiefs,
        image: NDArray[np.float32],
        sums: TruthSums,
        shade: Shade | None,
    ) -> dict[str, tuple[int, int]]:
        """The same for stars whose rays are traced; how they were sampled."""
        sampling: dict[str, tuple[int, int]] = {}
        shaded = None if shade is None else self._shaded(seen, light.wavelength_nm, shade)
        groups, bounds, entrance = self.planner.groups(seen, light.wavelength_nm, chiefs, shaded)
        by_waves = self.camera.diffraction != "rays" and image.size > 0
        rays_to = np.zeros((0, 0, image.shape[2]), np.float32) if by_waves else image
        entering = (light.share * entrance).sum(2)
        passes = Passes(self.camera, seen.nodes, light, bounds, rays_to, sums, entering, shade)
        lost = np.empty(0, np.int64)  # only the last group knows the pupils of stars that are not its own
        for group in groups:
            plan, members = group.plan, group.members
            if group is groups[-1]:
                members, lost = np.sort(np.concatenate([members, lost])), lost[:0]
            left = passes.trace(replace(group, members=members)) if len(members) else members
            lost = np.concatenate([lost, left])
            if len(members) > len(left):
                sampling[plan.mode] = (len(members) - len(left), plan.rays_per_node * light.share.shape[2])
        if by_waves:
            sampling = self._waves.add(light, seen, chiefs, bounds, image, sums, (shade, shaded))
        return sampling

    def _shaded(self, seen: Seen, wavelength_nm: FloatArray, shade: Shade) -> BoolArray:
        """Stars (n,) whose beam, or the disk beside it, something stands in."""
        kernel = seen.mid
        shaded = np.zeros(kernel.count, np.bool_)
        near = np.flatnonzero(shade.near(launch_disk(self.camera)))
        pupil, step = SobolPoints(SHADE_LOG2_RAYS, self.planner.sobol_seed), PASS_RAYS >> SHADE_LOG2_RAYS
        for part in (near[i : i + step] for i in range(0, len(near), step)):
            disks = DiskPoints(pupil, *self.planner.disks(seen, wavelength_nm[:1], part))
            shaded[part] = kernel.hidden_share(shade, disks, part.astype(np.uint32)) > 0.0
        return shaded

    def bundle_means(self, stars: StarField, *, rings: int = 6, arms: int = 14) -> FloatArray:
        """Mean landing point (n, b, 2) [px] of every star and band, without an image; NaN where no ray arrives.

        A low quadrature order does: the mean of a bundle converges long before its image.

        Raises
        ------
        DomainError
            Wavelength outside a glass's range, star behind the camera.
        """
        paths = self._in_cam(stars, None)
        light = self.light(stars, paths, 1.0)
        seen = self.planner.seen(paths, light.wavelength_nm)
        means = np.full((len(paths.mid), len(light.share[0]), 2), np.nan)
        if self.pupil.exact:
            every = np.arange(len(means))
            means, clear = self._means(seen.mid, light, every, whole_disk((rings, arms), light.wavelength_nm.shape[1]))
            left = every[~clear]
        else:
            left = np.arange(len(means))
            chiefs = self.planner.chiefs(seen.mid, light.wavelength_nm)
            for mode, members, shapes in self.planner.shapes(seen, chiefs).parts:
                order = (rings, arms) if mode == "quadrature" else (rings, max(arms, ARC_LADDER[0][1]))
                means[members], _ = self._means(seen.mid, light, members, shapes.points(order, members))
                left = np.setdiff1d(left, members)
        if len(left):  # beams that the kernel finds no outline of
            means[left] = self._beam_means(paths.mid[left], light.wavelength_nm, light.share[left], (rings, arms))
        return means

    @staticmethod
    def _means(
        kernel: StarKernel, light: Light, stars: IntArray, pupil: PupilPoints
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Mean landing points (s, b, 2) of some stars, and whether all rays arrive (s,)."""
        x, y, ok = kernel.land(pupil, light.wavelength_nm, stars.astype(np.uint32))
        weight = light.share[stars][..., None] * pupil.weight * ok
        with np.errstate(invalid="ignore"):
            mean = np.stack([(weight * v).sum((2, 3)) / weight.sum((2, 3)) for v in (x, y)], axis=-1)
        return mean, np.asarray(ok.all((1, 2, 3)))

    def _beam_means(
        self, direction: FloatArray, wavelength_nm: FloatArray, share: FloatArray, order: tuple[int, int]
    ) -> FloatArray:
        """The same (s, b, 2) on NumPy, where apertures cut the beam; NaN where no ray arrives."""
        try:
            waves = wavelength_nm.ravel()
            spots = spot_moments(self.camera.focused_lens, *field_angles_deg(direction), waves, order=order)
        except ConvergenceError:
            return np.full((*share.shape[:2], 2), np.nan)
        x, y, area = (v.reshape(share.shape) for v in (spots.x_mm, spots.y_mm, spots.transmitted_mm2))
        with np.errstate(invalid="ignore"):
            light = share * area / (share * area).sum(2, keepdims=True)
            mean = [(np.where(light > 0.0, v, 0.0) * light).sum(2) for v in (x, y)]
        return np.stack(self.camera.to_pixel(*mean), axis=-1)

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
        paths = self._in_cam(stars, None)
        light = self.light(stars, paths, 1.0)
        seen = self.planner.seen(paths, light.wavelength_nm)
        chiefs = self.planner.chiefs(seen.mid, light.wavelength_nm)
        if self.camera.diffraction != "rays":
            return self._waves.cells(light, seen, chiefs, half_size_px, cells_per_px)
        nothing = np.zeros((0, 0, len(stars.band)), np.float32)
        sums, _ = self._trace(light, paths, nothing)
        stamp_px = 2 * half_size_px + 1
        corner = np.stack([sums.bundle_x, sums.bundle_y], axis=-1) - 0.5 * stamp_px
        check_lit(corner)
        groups, bounds, _ = self.planner.groups(seen, light.wavelength_nm, chiefs)
        passes = Passes(self.camera, seen.nodes, light, bounds, nothing, sums, sums.entrance)
        side = stamp_px * cells_per_px
        result = np.empty((*corner.shape[:2], side, side))
        step = max(1, PASS_BYTES // (corner.shape[1] * side**2 * 16))
        for group in groups:
            for part in (group.members[i : i + step] for i in range(0, len(group.members), step)):
                pupil = group.points(part)
                collected = passes.splat(pupil, part, corner[part], stamp_px, cells_per_px)
                light_in = collected.moments[..., [ARRIVED, OUTSIDE]].sum(-1)
                result[part] = collected.pixels / light_in[..., None, None]
        return result

    def _in_cam(self, stars: StarField, rotation: FloatArray | None) -> StarPaths:
        """Directions in cam of stars at rest, after a check that the lens can take the light."""
        self.camera.lens.check_wavelength(stars.wavelength_nm)
        turned = stars.direction @ (self.camera.rotation_cam_from_world if rotation is None else rotation).T
        _check_in_front(turned)
        return replace(at_rest(np.asarray(turned)), collimation=stars.collimation)

    def _moving(self, stars: StarField, motion: ExposureMotion, exposure_s: float) -> StarPaths:
        """Directions in cam during an exposure, after a check that the lens can take the light."""
        self.camera.lens.check_wavelength(stars.wavelength_nm)
        if not math.isclose(exposure_s, motion.exposure_s, rel_tol=1e-9):
            raise DomainError(f"exposure of {exposure_s:g} s with a motion of {motion.exposure_s:g} s; give the same")
        paths = star_paths(motion, stars.direction, self.camera)
        _check_in_front(paths.mid)
        if motion.path is not None and len(stars):  # the time of a row needs the row of the chief ray
            for _ in range(2):
                row, scale = self._traced_paths(paths, stars.wavelength_nm)
                paths = star_paths(motion, stars.direction, self.camera, row, scale)
        _check_in_front(paths.nodes.reshape(-1, 3), paths.nodes.shape[1])
        return replace(paths, collimation=stars.collimation)

    def _traced_paths(self, paths: StarPaths, wavelength_nm: FloatArray) -> tuple[FloatArray, NDArray[np.complex128]]:
        """Rows of chief rays in the middle of an exposure; how paths are turned and scaled against an ideal lens."""
        picked, _ = pick_times(paths)
        count, ends = len(paths.mid), [paths.mid, picked[:, 0], picked[:, -1]]
        chiefs = self.planner.chiefs(self.planner.kernel(np.concatenate(ends)), wavelength_nm)
        x, y = (v.mean(1).reshape(3, count) for v in (chiefs.x_px, chiefs.y_px))
        ideal = IdealLens.of(self.camera).px(picked[:, -1]) - IdealLens.of(self.camera).px(picked[:, 0])
        ideal_way, way = ideal @ np.array([1.0, 1j]), (x[2] - x[1]) + 1j * (y[2] - y[1])
        moves = np.abs(ideal_way) > SHORTEST_PX
        return y[0], np.where(moves, way / np.where(moves, ideal_way, 1.0), 1.0)

    def light(self, stars: StarField, paths: StarPaths, exposure_s: float) -> Light:
        """Light of stars as it is shared out over the nodes of an exposure."""
        rate = stars.photon_rate * self.camera.response_at(stars.wavelength_nm)
        received = (paths.nodes[..., 2] * paths.weight)[:, None, :, None]
        per_node = (rate * (self.pupil.area_mm2 * exposure_s))[:, :, None] * received
        per_node = per_node.reshape(*rate.shape[:2], paths.nodes.shape[1] * rate.shape[2])
        electrons = per_node.sum(2)
        share = np.where(electrons[..., None] > 0, per_node, 1.0)
        return Light(stars.wavelength_nm, share / share.sum(2, keepdims=True), electrons)


def _check_in_front(direction: FloatArray, times: int = 1) -> None:
    """Refuse directions (n times, 3) in cam of stars behind the camera."""
    behind = direction[:, 2] <= 0
    if behind.any():
        first = int(np.argmax(behind))
        angle = np.degrees(np.arccos(np.clip(direction[first, 2], -1, 1)))
        raise DomainError(
            f"star {first // times} lies behind the camera ({angle:.1f} deg from its axis); leave out stars beyond "
            "90 deg"
        )
