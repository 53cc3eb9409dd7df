"""From a star field and a camera to the noiseless image and its truth.

Directions during the exposure and the light of every node (`render.tracing.motion.paths`), sampling points of each beam
(`render.tracing.pupil.planning`), then the images and the truth, by rays (`render.tracing.rays.images`) or waves
(`render.tracing.waves.images`) as the camera states. A measured lens gives positions and images itself
(`render.tracing.measured.images`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import ConfigError, ConvergenceError, DomainError
from optics.frames import field_angles_deg
from optics.rays.entrance_pupil import EntrancePupil
from optics.rays.spots import spot_moments, weighted_mean
from render.camera import Camera
from render.records import StarField, Truth
from render.tracing.convergence import TOLERANCE
from render.tracing.halo import add_halos, with_scattered
from render.tracing.measured.images import MeasuredImages, MeasuredPlanner
from render.tracing.motion.exposure import ExposureMotion, IdealLens
from render.tracing.motion.paths import NodeLight, StarPaths, at_rest, pick_times, star_paths
from render.tracing.motion.rolling_shutter import rolling_paths
from render.tracing.pupil.outlines import ARC_LADDER
from render.tracing.pupil.planning import PlannedExposure, PupilPlanner
from render.tracing.pupil.points import PupilPoints
from render.tracing.pupil.quadrature_order import whole_disk
from render.tracing.rays.images import RayImages
from render.tracing.rays.kernel import Shade, StarKernel
from render.tracing.truth import Sampling, TruthSums
from render.tracing.waves.images import WaveImages

SHORTEST_PX = 1e-3
"""Path along which the lens's scale is not measured."""


@dataclass(frozen=True, slots=True)
class TracedStars:
    """Noiseless image (h, w, b) [e-], truth, and how the pupil was sampled: mode -> (stars, rays per star and band)."""

    electrons: NDArray[np.float32]
    truth: Truth
    sampling: Sampling
    halo: NDArray[np.float32] | None = None  # Scattered light of the image

    def layers(self) -> dict[str, NDArray[np.float32]]:
        """Light (h, w, b) of the ``stars`` and of their halos (``scatter``), which add up to the image."""
        return {"stars": self.electrons} if self.halo is None else {
            "stars": self.electrons - self.halo, "scatter": self.halo
        }  # fmt: skip


class ImageMaker(Protocol):
    """Makes images of the stars of one camera."""

    def add(self, light: NodeLight, exposure: PlannedExposure, image: NDArray[np.float32], sums: TruthSums) -> Sampling:
        """Add stars to the image (h, w, b) and their truth to the sums; how they were sampled.

        An image without pixels: the truth of rays alone.
        """

    def cells(self, light: NodeLight, exposure: PlannedExposure, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light per cell (n, b, m, m) of squares about the mean of all light, over what arrives."""


class Tracer:
    """Renders star fields through one camera; lens and plans are reused between fields.

    The image depends on the camera, the settings below, star field and motion alone, not on earlier calls.

    Parameters
    ----------
    camera : Camera
        The camera; its attitude may be overridden per call.
    sobol_log2_rays, sobol_seed : int
        Rays per star and band where quadrature does not serve, and their scrambling; four times as many are taken where
        no charge diffusion softens the edges of the pixels.
    tolerance : float
        Of the quadrature, see `render.tracing.pupil.quadrature_order`.
    general : bool
        Compile the lens with general poses: one set of kernels for all its perturbed copies.
    by_grid : bool
        By waves: few stars too are taken from a grid of images over the field, which pays where many fields follow.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        sobol_log2_rays: int = 16,
        sobol_seed: int = 0,
        tolerance: float = TOLERANCE,
        general: bool = False,
        by_grid: bool = False,
    ) -> None:
        self.camera = camera
        self.images: ImageMaker
        self.planner: PupilPlanner
        if camera.lens.measured is not None:
            self.planner = planner = MeasuredPlanner(camera, sobol_seed)
            self.images = MeasuredImages(planner)
            return
        self.planner = PupilPlanner(
            camera, sobol_log2_rays=sobol_log2_rays, sobol_seed=sobol_seed, tolerance=tolerance, general=general
        )
        by_rays = camera.diffraction == "rays"
        self.images = RayImages(self.planner) if by_rays else WaveImages(self.planner, by_grid=by_grid)

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
        """Trace all stars (world frame) in all bands, in the camera's attitude, another one, or during a motion.

        With a motion, truth holds the chief ray in the middle of the exposure (with a rolling shutter: of the star's
        row) and means over the exposure of everything else. Stars whose beam a shade (`render.plugins.occlusion`) meets
        are sampled by Sobol points, as its edges are anywhere in the beam.

        Raises
        ------
        DomainError
            Exposure not positive or not that of the motion, wavelength outside a glass's range, star behind the camera,
            an image of a star larger than 1024 px, an image that outruns a rolling shutter.
        """
        if not (exposure_s > 0 and math.isfinite(exposure_s)):
            raise DomainError(f"exposure {exposure_s} s; it must be positive and finite")
        if motion is None:
            paths, length_px = self._in_cam(stars, rotation_cam_from_world), 0.0
        else:
            if rotation_cam_from_world is not None:
                raise ConfigError("an attitude and a motion are given; leave one of them out")
            paths, length_px = self._moving(stars, motion, exposure_s), motion.length_px
        light, law = self.light(stars, paths, exposure_s), self.camera.scatter
        if law is not None:
            light = replace(light, electrons=light.electrons * (1.0 - law.tis))
        image = np.zeros((self.camera.height_px, self.camera.width_px, len(stars.band)), np.float32)
        sums, sampling = self._add(light, paths, image, length_px, shade)
        truth = sums.truth(light.electrons)
        if law is None:
            return TracedStars(image, truth, sampling)
        truth = with_scattered(truth, law.tis)
        return TracedStars(image, truth, sampling, add_halos(self.camera, law, truth, image))

    def _add(
        self,
        light: NodeLight,
        paths: StarPaths,
        image: NDArray[np.float32],
        length_px: float = 0.0,
        shade: Shade | None = None,
    ) -> tuple[TruthSums, Sampling]:
        """Add all stars to the image; return their truth and sampling."""
        sums = TruthSums.empty(*light.electrons.shape)
        if not len(paths.mid):
            return sums, {}
        exposure = self.planner.exposure(paths, light.wavelength_nm, length_px, shade=shade)
        sums.chief[...] = np.where(exposure.chiefs.blocked[..., None], np.nan, exposure.chiefs.position_px)
        return sums, self.images.add(light, exposure, image, sums)

    def bundle_means(self, stars: StarField, *, rings: int = 6, arms: int = 14) -> FloatArray:
        """Mean landing point (n, b, 2) [px] of every star and band, without an image; NaN where no ray arrives.

        A low quadrature order does: the mean of a bundle converges long before its image.
        """
        paths = self._in_cam(stars, None)
        light = self.light(stars, paths, 1.0)
        exposure = self.planner.exposure(paths, light.wavelength_nm)
        if isinstance(self.images, MeasuredImages):
            return self.images.means(light, exposure)
        means = np.full((len(paths.mid), len(light.weight[0]), 2), np.nan)
        if self.pupil.exact:
            every = np.arange(len(means))
            means, clear = self._means(
                exposure.mid, light, every, whole_disk((rings, arms), light.wavelength_nm.shape[1])
            )
            remaining = every[~clear]
        else:
            remaining = np.arange(len(means))
            for group in self.planner.sampled(exposure, remaining).groups:
                order = (rings, arms) if group.mode == "quadrature" else (rings, max(arms, ARC_LADDER[0][1]))
                members = group.members
                means[members], _ = self._means(exposure.mid, light, members, group.of(members, order))
                remaining = np.setdiff1d(remaining, members)
        if len(remaining):  # beams that the kernel finds no outline of
            directions, weight = paths.mid[remaining], light.weight[remaining]
            means[remaining] = self._beam_means(directions, light.wavelength_nm, weight, (rings, arms))
        return means

    @staticmethod
    def _means(
        kernel: StarKernel, light: NodeLight, stars: IntArray, pupil: PupilPoints
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Mean landing points (s, b, 2) of some stars, and whether all rays arrive (s,)."""
        x, y, ok = kernel.land(pupil, light.wavelength_nm, stars.astype(np.uint32))
        passed = kernel.transmitted(pupil, light.wavelength_nm, stars.astype(np.uint32))
        weight = light.weight[stars][..., None] * pupil.weight * (ok * passed)
        with np.errstate(invalid="ignore"):
            mean = np.stack([(weight * v).sum((2, 3)) / weight.sum((2, 3)) for v in (x, y)], axis=-1)
        return mean, np.asarray(ok.all((1, 2, 3)))

    def _beam_means(
        self, direction: FloatArray, wavelength_nm: FloatArray, weight: FloatArray, order: tuple[int, int]
    ) -> FloatArray:
        """The same (s, b, 2) on NumPy, where apertures cut the beam; NaN where no ray arrives."""
        try:
            waves = wavelength_nm.ravel()
            spots = spot_moments(self.camera.focused_lens, *field_angles_deg(direction), waves, order=order)
        except ConvergenceError:
            return np.full((*weight.shape[:2], 2), np.nan)
        x, y, area = (v.reshape(weight.shape) for v in (spots.x_mm, spots.y_mm, spots.transmitted_mm2))
        return np.stack(self.camera.to_pixel(*(weighted_mean(v, weight * area) for v in (x, y))), axis=-1)

    def centred_cells(self, stars: StarField, *, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light of every star and band on a fine grid around its bundle mean: fraction of the collected light per cell.

        (n, b, m, m), m = (2 ``half_size_px`` + 1) * ``cells_per_px``: the grid ends half a pixel beyond
        ``half_size_px``.
        """
        paths = self._in_cam(stars, None)
        light = self.light(stars, paths, 1.0)
        exposure = self.planner.exposure(paths, light.wavelength_nm)
        return self.images.cells(light, exposure, half_size_px, cells_per_px)

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
        of_motion = star_paths if motion.path is None else rolling_paths
        paths = of_motion(motion, stars.direction, self.camera)
        _check_in_front(paths.mid)
        if motion.path is not None and len(stars):  # the time of a row needs the row of the chief ray
            for _ in range(2):
                row, scale = self._traced_paths(paths, stars.wavelength_nm)
                paths = rolling_paths(motion, stars.direction, self.camera, row, scale)
        _check_in_front(paths.nodes.reshape(-1, 3), paths.nodes.shape[1])
        return replace(paths, collimation=stars.collimation)

    def _traced_paths(self, paths: StarPaths, wavelength_nm: FloatArray) -> tuple[FloatArray, NDArray[np.complex128]]:
        """Rows of chief rays in the middle of an exposure; how paths are turned and scaled against an ideal lens."""
        picked, _ = pick_times(paths)
        count, ends = len(paths.mid), [paths.mid, picked[:, 0], picked[:, -1]]
        chiefs = self.planner.chiefs(self.planner.kernel(np.concatenate(ends)), wavelength_nm)
        x, y = (v.mean(1).reshape(3, count) for v in (chiefs.x_px, chiefs.y_px))
        ideal = IdealLens.of(self.camera).px(picked[:, -1]) - IdealLens.of(self.camera).px(picked[:, 0])
        ideal_chord, chord = ideal @ np.array([1.0, 1j]), (x[2] - x[1]) + 1j * (y[2] - y[1])
        moves = np.abs(ideal_chord) > SHORTEST_PX
        return y[0], np.where(moves, chord / np.where(moves, ideal_chord, 1.0), 1.0)

    def light(self, stars: StarField, paths: StarPaths, exposure_s: float) -> NodeLight:
        """Light of stars, distributed over the nodes of an exposure."""
        rate = stars.photon_rate * self.camera.response_at(stars.wavelength_nm)
        received = (self.planner.received(paths.nodes) * paths.weight)[:, None, :, None]
        per_node = (rate * (self.pupil.area_mm2 * exposure_s))[:, :, None] * received
        per_node = per_node.reshape(*rate.shape[:2], paths.nodes.shape[1] * rate.shape[2])
        electrons = per_node.sum(2)
        weight = np.where(electrons[..., None] > 0, per_node, 1.0)
        return NodeLight(stars.wavelength_nm, weight / weight.sum(2, keepdims=True), electrons)


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
