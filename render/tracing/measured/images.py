r"""Images of stars through a measured lens (`optics.lens.measured`): Gaussians, integrated over pixels.

At every time and wavelength node of a star its position follows from the camera model and its image is a mixture of
Gaussians, :math:`\Sigma` each. The part of their covariance that makes ellipses oblique is a line,

.. math:: \Sigma = \mathrm{diag}(\sigma_x^2 (1-|\rho|), \sigma_y^2 (1-|\rho|)) + v v^T,
          \quad v = \sqrt{|\rho|}\,(\sigma_x, \pm\sigma_y),

represented by Gauss-Hermite nodes: an oblique Gaussian is a sum of upright ones, whose integrals over pixels
are products of error functions. Light, mean and covariance are exact, values to `LINE_ERROR` of the peak. Light beyond
`REACH` standard deviations of the widest Gaussian is not on the stamp (1e-10 of its light) and is accounted for. Charge
diffusion adds to every covariance. Under a rolling shutter Gaussians are sheared as spots are
(`render.tracing.motion.rolling_shutter`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.lens.measured import MeasuredLens
from render.camera import Camera
from render.records import EffectivePsf
from render.tracing.motion.paths import NodeLight
from render.tracing.motion.rolling_shutter import recorded_gaussians
from render.tracing.pupil.planning import SHADE_LOG2_RAYS, PlannedExposure, PupilPlanner
from render.tracing.pupil.points import DiskPoints, SobolPoints
from render.tracing.pupil.ray_aiming import Chiefs
from render.tracing.rays.kernel import StarKernel
from render.tracing.truth import Sampling, TruthSums, add_stamps, check_lit

REACH = 6.5
"""Standard deviations of a Gaussian along each axis that a stamp holds."""
LINE_ERROR = 1e-6
"""Error of a sum of upright Gaussians for an oblique one, over its peak."""
STRAIGHT = 1e-12
CORRELATIONS, MOST_CORRELATED = 20, 0.975
"""Steps of the correlation, each with its number of nodes; beyond the last one the error grows."""
LINE_NODES, MOST_LINE_NODES = 4, 400
"""Nodes of a line that are common, and the most."""
STAMP_LIMIT_PX = 1024
PASS_NUMBERS = 1 << 22
"""Numbers of an array that are held at a time."""
SIZES = 1.4
"""Stamps that are made together differ by this factor at most."""


class MeasuredPlanner(PupilPlanner):
    """Star positions of a measured lens and its entering light; obstacles use its aperture as an ideal lens's."""

    def __init__(self, camera: Camera, sobol_seed: int) -> None:
        assert camera.lens.measured is not None
        self.lens: MeasuredLens = camera.lens.measured
        self.measured_camera = camera
        ideal = replace(camera, lens=replace(camera.lens, measured=None), defocus_mm=0.0)
        super().__init__(ideal, sobol_log2_rays=SHADE_LOG2_RAYS, sobol_seed=sobol_seed, tolerance=1.0, general=False)

    def position_px(self, direction: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
        """Columns and rows (..., 2) of stars, broadcast; NaN where they have none."""
        position = self.lens.position_mm(direction, wavelength_nm)
        return np.asarray(self.measured_camera.centre_px + position / self.measured_camera.pixel_pitch_mm)

    def chiefs(self, kernel: StarKernel, wavelength_nm: FloatArray) -> Chiefs:
        """Positions of the stars of a kernel at the mean of each band's nodes (b, k)."""
        direction = kernel.direction[:, :1]
        position = self.position_px(direction, wavelength_nm.mean(1))
        x, y = position[..., 0], position[..., 1]
        return Chiefs(np.zeros(position.shape), x, y, np.isnan(x))

    def received(self, nodes: FloatArray) -> FloatArray:
        """Light (n, t) of stars in directions (n, t, 3), relative to the axis."""
        return self.lens.relative(self.lens.position_mm(nodes))


class MeasuredImages:
    """Makes images of the stars of one camera (`render.tracing.tracer.ImageMaker`)."""

    def __init__(self, planner: MeasuredPlanner) -> None:
        self.planner, self.camera = planner, planner.measured_camera
        variance_mm2 = float(planner.lens.psf.covariance_mm2[..., :2].max())
        self._widest_px = float(np.hypot(np.sqrt(variance_mm2) / self.camera.pixel_pitch_mm, self.camera.blur_px))

    def add(self, light: NodeLight, exposure: PlannedExposure, image: NDArray[np.float32], sums: TruthSums) -> Sampling:
        """Add stars to the image and their truth to the sums; how they were sampled."""
        hidden, electrons = self._hidden(exposure), light.electrons
        paths, size = exposure.paths, np.array([self.camera.width_px, self.camera.height_px])
        received = (self.planner.received(paths.nodes) * paths.weight).sum(1)[:, None]
        entrance = np.divide(1.0, received, out=np.ones_like(received), where=received > 0.0).clip(min=1.0)
        sums.entrance[...], sums.vignetted[...] = entrance, (entrance - 1.0) * electrons
        sums.hidden[...], sums.off_edge[...], sums.image[...] = hidden * electrons, (1.0 - hidden) * electrons, 0.0
        lit, gaussians = self._lit(exposure), 0
        for stars in self._passes(light, exposure, lit):
            nodes = self._nodes(light, exposure, stars)
            sums.bundle[stars], sums.variance[stars] = nodes.mean_px(), nodes.variance_px2()
            sums.photon[stars] = sums.bundle[stars]
            low, high = nodes.box_px()
            near = np.any(np.all((high > -0.5) & (low < size - 0.5), axis=-1), axis=1)
            if not (near.any() and image.size):
                continue
            near_stars, corner, width = stars[near], *self._stamp(low[near], high[near], stars[near])
            visible = 1.0 - hidden[near_stars]
            pixels = nodes.take(near).on_pixels(corner, width) * visible[..., None, None]
            on_image = add_stamps(image, pixels, corner, electrons[near_stars], self.camera.sensitive_columns)
            landed = pixels.sum((2, 3))
            sums.image[near_stars] = on_image * electrons[near_stars]
            sums.off_edge[near_stars] = (landed - on_image) * electrons[near_stars]
            sums.beyond[near_stars] = (visible - landed) * electrons[near_stars]
            gaussians = max(gaussians, nodes.weight.shape[2])
        return {"measured": (len(lit), gaussians)} if len(lit) else {}

    def means(self, light: NodeLight, exposure: PlannedExposure) -> FloatArray:
        """Centroids (n, b, 2) [px]; NaN where no light arrives."""
        means = np.full((*light.electrons.shape, 2), np.nan)
        for stars in self._passes(light, exposure, self._lit(exposure)):
            means[stars] = self._nodes(light, exposure, stars).mean_px()
        return means

    def cells(self, light: NodeLight, exposure: PlannedExposure, half_size_px: int, cells_per_px: int) -> FloatArray:
        """Light per cell (n, b, m, m) of squares about the centroids, over what arrives."""
        stamp_px = 2 * half_size_px + 1
        centre = self.means(light, exposure)
        check_lit(centre)
        corner, side = centre - 0.5 * stamp_px, stamp_px * cells_per_px
        cells = np.empty((*light.electrons.shape, side, side))
        for stars in self._passes(light, exposure, np.arange(len(cells)), side):
            cells[stars] = self._nodes(light, exposure, stars).on_pixels(corner[stars], side, cells_per_px)
        return cells

    def _lit(self, exposure: PlannedExposure) -> IntArray:
        """Stars with a position at all times."""
        return np.flatnonzero((self.planner.received(exposure.paths.nodes) > 0.0).all(1))

    def _hidden(self, exposure: PlannedExposure) -> FloatArray:
        """Share (n, b) of the light that bodies in front of the lens keep away."""
        count, bands = exposure.mid.count, len(exposure.wavelength_nm)
        hidden = np.zeros((count, bands))
        if exposure.shade is None or exposure.shaded is None:
            return hidden
        points = SobolPoints(SHADE_LOG2_RAYS, self.planner.sobol_seed)
        for star in np.flatnonzero(exposure.shaded):
            single = np.array([star])
            disk = DiskPoints(points, *self.planner.disks(exposure, exposure.wavelength_nm[:1], single))
            hidden[star] = exposure.mid.hidden_fraction(exposure.shade, disk, single.astype(np.uint32))
        return hidden

    def _passes(
        self, light: NodeLight, exposure: PlannedExposure, stars: IntArray, side: int = 0
    ) -> Iterator[IntArray]:
        """Batches of stars whose stamps are of similar size, limited by `PASS_NUMBERS`."""
        paths, psf = exposure.paths, self.planner.lens.psf
        moved = np.diff(paths.shift_px[stars], axis=1).max((1, 2)) if len(stars) else np.empty(0)
        size = np.maximum(moved + 2.0 * REACH * self._widest_px + 2.0, side)
        each = light.weight[0].size * psf.share.shape[-1] * LINE_NODES if len(stars) else 1
        order, start = np.argsort(size, kind="stable"), 0
        while start < len(order):
            ahead = size[order[start:]]
            fits = (np.arange(1, len(ahead) + 1) * each * ahead <= PASS_NUMBERS) & (ahead <= SIZES * ahead[0])
            stop = start + max(1, int(np.count_nonzero(fits)))
            yield stars[np.sort(order[start:stop])]
            start = stop

    def _stamp(self, low: FloatArray, high: FloatArray, stars: IntArray) -> tuple[FloatArray, int]:
        """Corners (s, b, 2) and the size of stamps that hold boxes (s, b, 2)."""
        corner = np.floor(low + 0.5) - 0.5
        width = np.ceil((high - corner).max((1, 2))).astype(int)
        if width.max() > STAMP_LIMIT_PX:
            raise DomainError(
                f"the image of star {stars[width.argmax()]} is {width.max()} px wide; at most {STAMP_LIMIT_PX} px can "
                "be rendered; check the PSF and the motion during the exposure"
            )
        return corner, int(width.max())

    def _nodes(self, light: NodeLight, exposure: PlannedExposure, stars: IntArray) -> _Gaussians:
        """Gaussians of some stars."""
        paths, waves = exposure.paths, exposure.wavelength_nm
        if paths.collimation is not None:  # changes the focus, of which nothing was measured
            self.camera.lens.check_surfaces()
        position = self.planner.position_px(paths.nodes[stars][:, None, :, None], waves[:, None])  # (s, b, t, k, 2)
        shear = None if paths.shear is None else paths.shear[stars][:, None, :, None, None]
        weight = light.weight[stars].reshape(position.shape[:-1])
        return _gaussians(self.camera, self.planner.lens, position, waves[:, None], weight, shear)


def _gaussians(
    camera: Camera,
    lens: MeasuredLens,
    position_px: FloatArray,
    wavelength_nm: FloatArray,
    weight: FloatArray,
    shear: FloatArray | None = None,
) -> _Gaussians:
    """Gaussians of light at positions (s, b, t, k, 2) with weights (s, b, t, k)."""
    at_mm = (position_px - camera.centre_px) * camera.pixel_pitch_mm
    part, offset, covariance = lens.psf.at(at_mm[..., 0], at_mm[..., 1], wavelength_nm)
    mean = position_px[..., None, :] + offset / camera.pixel_pitch_mm
    covariance = covariance / camera.pixel_pitch_mm**2
    if shear is not None:
        mean, covariance = recorded_gaussians(mean, covariance, shear)
    covariance = covariance + camera.blur_px**2 * np.array([1.0, 1.0, 0.0])
    flat = (*weight.shape[:2], -1)
    return _Gaussians((weight[..., None] * part).reshape(flat), mean.reshape(*flat, 2), covariance.reshape(*flat, 3))


def pixel_shares(cells: FloatArray, cells_per_px: int) -> FloatArray:
    """Light of pixels at every whole number of cells, (..., n + 1 - cells_per_px, the same), from cells (..., n, n)."""
    running = np.pad(cells.cumsum(-2).cumsum(-1), [(0, 0)] * (cells.ndim - 2) + [(1, 0), (1, 0)])
    low, high = running[..., :-cells_per_px], running[..., cells_per_px:]
    return np.asarray(
        (high[..., cells_per_px:, :] - high[..., :-cells_per_px, :])
        - (low[..., cells_per_px:, :] - low[..., :-cells_per_px, :])
    )


def measured_psfs(
    camera: Camera,
    direction: FloatArray,
    wavelength_nm: FloatArray,
    weight: FloatArray,
    *,
    oversampling: int = 8,
    half_size_px: int = 7,
) -> tuple[EffectivePsf, ...]:
    """Effective PSFs of stars in directions (f, 3), about their centroids; wavelengths (w,) with weights."""
    lens = camera.lens.measured
    assert lens is not None
    position = camera.centre_px + lens.position_mm(direction[:, None], wavelength_nm) / camera.pixel_pitch_mm
    weights = np.broadcast_to(weight, position.shape[:2])[:, None, None]
    gaussians = _gaussians(camera, lens, position[:, None, None], wavelength_nm, weights)
    side = 2 * half_size_px + 1
    cells = gaussians.on_pixels(gaussians.mean_px() - 0.5 * side, side * oversampling, oversampling)
    return tuple(EffectivePsf(values=psf, oversampling=oversampling) for psf in pixel_shares(cells[:, 0], oversampling))


@dataclass(frozen=True, slots=True)
class _Gaussians:
    """Light of s stars in b bands as g Gaussians each."""

    weight: FloatArray  # (s, b, g)
    centre_px: FloatArray  # (s, b, g, 2)
    covariance_px2: FloatArray  # (s, b, g, 3) Along columns, along rows, and between them

    def take(self, stars: NDArray[np.bool_]) -> _Gaussians:
        """Some of the stars."""
        return _Gaussians(self.weight[stars], self.centre_px[stars], self.covariance_px2[stars])

    def mean_px(self) -> FloatArray:
        """Centroids (s, b, 2)."""
        return np.asarray((self.weight[..., None] * self.centre_px).sum(2))

    def variance_px2(self) -> FloatArray:
        """Variances along columns and rows (s, b, 2)."""
        away = self.centre_px - self.mean_px()[:, :, None]
        return np.asarray((self.weight[..., None] * (self.covariance_px2[..., :2] + away**2)).sum(2))

    def box_px(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest places (s, b, 2) that light reaches."""
        reach = REACH * np.sqrt(self.covariance_px2[..., :2])
        return (self.centre_px - reach).min(2), (self.centre_px + reach).max(2)

    def on_pixels(self, corner_px: FloatArray, side: int, cells_per_px: int = 1) -> FloatArray:
        """Light (s, b, side, side) of the cells of squares from their outer corners (s, b, 2) on."""
        weight, centre, sigma = self._upright()
        edges = np.arange(side + 1) / cells_per_px
        scale = 1.0 / (np.sqrt(2.0) * sigma)[..., None]
        up_to = erf((edges + (corner_px[:, :, None] - centre)[..., None]) * scale)
        x, y = np.moveaxis(0.5 * np.diff(up_to, axis=-1), -2, 0)
        return np.asarray(np.swapaxes(y * weight[..., None], -1, -2) @ x)

    def _upright(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weights (s, b, g), centres and standard deviations (s, b, g, 2) of upright Gaussians in their place."""
        variance, between = self.covariance_px2[..., :2], self.covariance_px2[..., 2]
        correlation = between / np.sqrt(variance.prod(-1))
        steepest = np.abs(correlation).max((0, 1), initial=0.0)
        steps = np.where(steepest < STRAIGHT, 0, np.ceil(CORRELATIONS * steepest)).astype(int)
        parts = []
        for step in np.unique(steps):  # Gaussians by their number of nodes
            some = np.flatnonzero(steps == step)
            node, node_weight = line_nodes(int(step))
            rho = correlation[:, :, some, None]
            along = np.sqrt(np.abs(rho) * variance[:, :, some])
            along[..., 1] *= np.sign(rho[..., 0])
            centre = self.centre_px[:, :, some, None] + node[:, None] * along[..., None, :]
            sigma = np.sqrt(variance[:, :, some] * (1.0 - np.abs(rho)))[..., None, :]
            parts.append((self.weight[:, :, some, None] * node_weight, centre, np.broadcast_to(sigma, centre.shape)))
        flat = (*self.weight.shape[:2], -1)
        weight, centre, sigma = (
            np.concatenate([part.reshape(*flat, *part.shape[4:]) for part in kind], axis=2)
            for kind in zip(*parts, strict=True)
        )
        return weight, centre, sigma


@cache
def line_nodes(correlation: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Hermite nodes and weights of the line in Gaussians of a correlation, in units of 1 / `CORRELATIONS`.

    In coordinates in which the remainder without the line is a round Gaussian of unit width, the line has the variance
    2 |rho| / (1 - |rho|) at 45 deg. Their number is the lowest that makes the sum a Gaussian to `LINE_ERROR`.
    """
    if correlation == 0:
        return np.zeros(1), np.ones(1)
    rho = min(correlation / CORRELATIONS, MOST_CORRELATED)
    variance = 2.0 * rho / (1.0 - rho)
    at = np.linspace(0.0, 5.0 * math.sqrt(1.0 + variance), 801)
    gaussian = np.exp(-0.5 * at**2 / (1.0 + variance)) / math.sqrt(1.0 + variance)
    count = 1
    while count < MOST_LINE_NODES:
        count = math.ceil(1.1 * count + 0.5)
        node, weight = np.polynomial.hermite_e.hermegauss(count)
        weight = weight / weight.sum()
        sum_of_nodes = np.exp(-0.5 * (at[:, None] - math.sqrt(variance) * node) ** 2) @ weight
        if np.abs(sum_of_nodes - gaussian).max() < LINE_ERROR * gaussian[0]:
            break
    return node, weight
