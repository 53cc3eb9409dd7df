"""Effective PSFs: the pixel-integrated image of a star at every sub-pixel phase.

`render_epsf` renders them by rays or waves as its camera states. `ray_epsf` and `wave_images` compute them from traced
rays and traced wavefronts in NumPy, without the renderer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.special import erf, j1

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.waves.pupil_field import PupilField, trace_pupil
from optics.waves.pupil_grid import pupil_grid
from render.camera import Camera
from render.records import EffectivePsf, StarField
from render.tracing.measured.images import pixel_shares
from render.tracing.tracer import Tracer

TOLERANCE = 2e-4
"""Of the pupil quadrature: an error of this size at half a cycle per pixel and beyond moves a fit by some 1e-5 px."""


def epsf_tracer(camera: Camera, *, by_grid: bool = False, sobol_log2_rays: int = 16) -> Tracer:
    """Tracer for `render_epsf`; one serves all PSFs of a camera, so that it is prepared once."""
    return Tracer(camera, tolerance=TOLERANCE, by_grid=by_grid, sobol_log2_rays=sobol_log2_rays)


def render_epsf(
    tracer: Tracer, stars: StarField, *, oversampling: int = 8, half_size_px: int = 7
) -> list[list[EffectivePsf]]:
    """Effective PSF of every star and band, centred on the bundle mean.

    The light of the traced bundle, convolved with the diffusion kernel, is integrated over cells of 1/``oversampling``
    pixel whose edges lie symmetrically about the mean; a pixel at any whole number of cells from the mean is then a sum
    of whole cells, without interpolation.

    Parameters
    ----------
    tracer : Tracer
        Of the camera (`epsf_tracer`).
    stars : StarField
        Where in the field, with which spectra.
    oversampling : int
        Samples per pixel, even.
    half_size_px : int
        Half-width of the grid.

    Returns
    -------
    list of list of EffectivePsf
        ``[star][band]``.

    Raises
    ------
    DomainError
        On an odd oversampling, or as the tracer.
    """
    _check_even("render_epsf", oversampling)
    cells = tracer.centred_cells(stars, half_size_px=half_size_px, cells_per_px=oversampling)
    pixels = pixel_shares(cells, oversampling)
    return [[EffectivePsf(values=psf, oversampling=oversampling) for psf in row] for row in pixels]


def _check_even(what: str, oversampling: int) -> None:
    if oversampling < 2 or oversampling % 2:
        raise DomainError(f"{what}: oversampling = {oversampling}; an even number of at least 2 is needed")


def ray_epsf(
    x_px: FloatArray,
    y_px: FloatArray,
    weight: FloatArray,
    *,
    diffusion_px: float,
    oversampling: int = 8,
    half_size_px: int = 7,
) -> EffectivePsf:
    """Effective PSF of one bundle of rays, centred on its mean.

    Rays are counted in cells of 1/``oversampling`` pixel, the cells convolved with the diffusion kernel and added up to
    pixels. Counting is exact for pixels at whole cells from the mean; rays have to lie closer than the kernel is wide.
    The kernel is shifted by the difference of the means of rays and cells, up to half a cell.
    """
    # x_px, y_px (n,), weight (n,)
    _check_even("ray_epsf", oversampling)
    total = float(weight.sum())
    if not total > 0.0:
        raise DomainError("ray_epsf: no light; the star is outside the field of the lens")
    half = (2 * half_size_px + 1) * oversampling // 2
    lit = weight > 0.0
    fraction = weight[lit] / total
    x, y = x_px[lit], y_px[lit]
    column = np.floor((x - fraction @ x) * oversampling).astype(np.int64) + half
    row = np.floor((y - fraction @ y) * oversampling).astype(np.int64) + half
    size = 2 * half
    inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    counted = np.bincount(row[inside] * size + column[inside], fraction[inside], size * size)
    cells: FloatArray = np.asarray(counted, np.float64).reshape(size, size)
    sigma = diffusion_px * oversampling
    for axis, cell in enumerate((row, column) if sigma > 0.0 else ()):
        off = float(fraction @ (cell - half + 0.5))
        steps = np.arange(-math.ceil(5.0 * sigma) - 1, math.ceil(5.0 * sigma) + 2)
        kernel = np.exp(-0.5 * ((steps + off) / sigma) ** 2)
        cells = convolve1d(cells, kernel / kernel.sum(), axis=axis, mode="constant")
    return EffectivePsf(values=pixel_shares(cells, oversampling), oversampling=oversampling)


def trailed(psf: EffectivePsf, trail_px: FloatArray) -> EffectivePsf:
    """Effective PSF of a star that moves evenly during the exposure, centred on the middle of its trail.

    The transform of a straight trail is a sinc; the grid grows by the trail.
    """
    # trail_px (2,)
    more = math.ceil(0.5 * float(np.abs(trail_px).max())) * psf.oversampling
    values = np.pad(psf.values, more)
    size = len(values)
    padded = size + 2 * more + 1  # room for light that would wrap around
    frequency = np.fft.fftfreq(padded, 1.0 / psf.oversampling)  # cycles per pixel
    along = frequency[None, : padded // 2 + 1] * trail_px[0] + frequency[:, None] * trail_px[1]
    values = np.fft.irfft2(np.fft.rfft2(values, (padded, padded)) * np.sinc(along), (padded, padded))
    return EffectivePsf(values=values[:size, :size], oversampling=psf.oversampling)


def convolved(
    psf: EffectivePsf, transfer: Callable[[NDArray[np.float64]], NDArray[np.float64]], reach_px: float
) -> EffectivePsf:
    """Effective PSF convolved with a round kernel.

    Parameters
    ----------
    psf : EffectivePsf
        A PSF; its grid stays.
    transfer : callable
        Transfer function of the kernel at spatial frequencies [cycles per px], any shape.
    reach_px : float
        Radius of the kernel.
    """
    size, edge = len(psf.values), math.ceil(reach_px * psf.oversampling) + 1
    padded = np.pad(psf.values, edge)
    down, across = np.fft.fftfreq(len(padded)), np.fft.rfftfreq(len(padded))
    values = np.fft.rfft2(padded) * transfer(np.hypot(down[:, None], across) * psf.oversampling)
    return replace(psf, values=np.fft.irfft2(values, padded.shape)[edge : edge + size, edge : edge + size])


def blurred(psf: EffectivePsf, variance_px2: float) -> EffectivePsf:
    """Effective PSF convolved with a Gaussian of a variance per axis."""
    return convolved(psf, lambda q: np.exp(-2.0 * np.pi**2 * variance_px2 * q**2), 4.0 * variance_px2**0.5)


def of_disk(psf: EffectivePsf, radius_px: float) -> EffectivePsf:
    """Effective PSF of a uniform disk, such as a pinhole, from that of a point: transfer function 2 J1(x) / x."""

    def transfer(frequency: NDArray[np.float64]) -> NDArray[np.float64]:
        x = 2.0 * np.pi * radius_px * frequency
        return np.where(x > 0.0, 2.0 * j1(x) / np.where(x > 0.0, x, 1.0), 1.0)

    return convolved(psf, transfer, radius_px)


ORDER = (12, 48)
"""Rings and azimuths of rays that phase and amplitude of a clear pupil are fitted to."""
FOLDED = 1e-4
"""Transmission by the pixel of frequencies that are folded onto others by sampling."""
HIGHEST_PER_PX = 6.0
"""Frequencies that a pixel without diffusion is followed to."""
SIGMAS = 6.0
"""Reach of charge diffusion in standard deviations."""
ROOM = 1.2
"""Repeat distance of the images that an even pupil makes, in widths of the window: 3e-5 of a pixel's light from 1.8."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MonochromaticImages:
    """Diffraction images of f fields at w wavelengths on a fine grid, each about the mean of its light."""

    offset_px: FloatArray  # (n,) Rows and columns of the grid
    light: NDArray[np.float32]  # (f, w, n, n) Light per px^2 over that of the wavelength
    mean_px: FloatArray  # (f, w, 2) Mean of all light on the pixels, column and row
    area_mm2: FloatArray  # (f, w) Cross-section of the beam
    diffusion_px: float  # Standard deviation of the Gaussian charge diffusion
    oversampling: int  # Samples of the PSFs per pixel
    half_size_px: int  # Half-width of the PSFs

    def psfs(self, spectrum: FloatArray) -> tuple[EffectivePsf, ...]:
        """PSFs (f) of light of a spectrum (w,), centred on the mean of all of it."""
        reach = self.half_size_px * self.oversampling
        position_px = np.arange(-reach, reach + 1) / self.oversampling
        psfs = []
        for light, mean, area in zip(self.light, self.mean_px, self.area_mm2, strict=True):
            part = spectrum * area / (spectrum @ area)
            values = np.zeros((len(position_px), len(position_px)))
            for image, weight, offset in zip(light, part, mean - part @ mean, strict=True):
                columns, rows = (self._pixel(position_px - along) for along in offset)
                values += weight * (rows @ image @ columns.T)
            psfs.append(EffectivePsf(values=values, oversampling=self.oversampling))
        return tuple(psfs)

    def _pixel(self, place_px: FloatArray) -> NDArray[np.float32]:
        """Weights (p, n) of the samples in the light of pixels at places."""
        distance = np.abs(place_px[:, None] - self.offset_px)
        step = float(self.offset_px[1] - self.offset_px[0])
        if self.diffusion_px <= 0.0:  # parts of the samples' cells
            return np.clip(0.5 * (1.0 + step) - distance, 0.0, step).astype(np.float32)
        weights, scale = np.zeros(distance.shape, np.float32), 1.0 / (math.sqrt(2.0) * self.diffusion_px)
        near = distance < 0.5 + SIGMAS * self.diffusion_px
        weights[near] = 0.5 * step * (erf((distance[near] + 0.5) * scale) - erf((distance[near] - 0.5) * scale))
        return weights


def wave_images(
    lens: LensSystem,
    field_x_deg: FloatArray,
    wavelength_nm: FloatArray,
    *,
    pitch_mm: float,
    diffusion_px: float,
    azimuth_deg: float = 0.0,
    oversampling: int = 8,
    half_size_px: int = 7,
) -> MonochromaticImages:
    """Diffraction images of stars along the x axis of the field, turned about the axis of the lens."""
    # field_x_deg (f,), wavelength_nm (w,)
    _check_even("wave_images", oversampling)
    nothing = np.zeros_like(field_x_deg)
    rays = _turned(trace_pupil(lens, field_x_deg, nothing, wavelength_nm, order=ORDER), math.radians(azimuth_deg))
    mean_px = np.stack(rays.mean_mm, axis=-1) / pitch_mm
    if np.isnan(mean_px).any():
        raise DomainError(f"field {field_x_deg[np.argwhere(np.isnan(mean_px))[0][0]]:g} deg: no light arrives")
    separation_px = float(np.abs(mean_px - mean_px.mean(1, keepdims=True)).max()) * 2.0
    half_px = half_size_px + 0.5 + 5.5 * diffusion_px + separation_px
    highest = 2.0 * float((np.hypot(rays.l, rays.m) * (rays.index / rays.wavelength_nm)[:, None, None]).max()) * 1e6
    highest *= pitch_mm
    resolved = HIGHEST_PER_PX
    if diffusion_px > 0.0:
        resolved = min(resolved, math.sqrt(-math.log(FOLDED) / 2.0) / (math.pi * diffusion_px))
    per_px = math.ceil(highest + min(highest, resolved))
    count = math.ceil(2.0 * half_px * per_px)
    offset = (np.arange(count) - 0.5 * (count - 1)) / per_px
    clear = bool(np.all(rays.area_mm2 > 0.0))
    if not clear:
        rays = _turned(
            trace_pupil(lens, field_x_deg, nothing, wavelength_nm, half_width_mm=half_px * pitch_mm),
            math.radians(azimuth_deg),
        )
    size = max(160, math.ceil(ROOM * 2.0 * half_px * highest))
    light = np.empty((*mean_px.shape[:2], count, count), np.float32)
    for at in np.ndindex(*mean_px.shape[:2]):
        if clear:
            image = pupil_grid(rays, at, size=size).intensity(offset * pitch_mm, offset * pitch_mm)
        else:
            x, y = (m + offset * pitch_mm for m in np.stack(rays.mean_mm, axis=-1)[at])
            image = rays.intensity(x, y, at=at, dtype=np.complex64)
        light[at] = image * pitch_mm**2
    return MonochromaticImages(
        offset_px=offset,
        light=light,
        mean_px=mean_px,
        area_mm2=rays.area_mm2.sum((2, 3)),
        diffusion_px=diffusion_px,
        oversampling=oversampling,
        half_size_px=half_size_px,
    )


def _turned(field: PupilField, angle: float) -> PupilField:
    """The same light with columns and rows of the detector as its axes, turned from the first towards the second."""
    cos, sin = math.cos(angle), math.sin(angle)
    return replace(
        field,
        x_mm=cos * field.x_mm + sin * field.y_mm,
        y_mm=sin * field.x_mm - cos * field.y_mm,
        l=cos * field.l + sin * field.m,
        m=sin * field.l - cos * field.m,
    )
