"""Effective PSFs by diffraction from traced wavefronts, by NumPy alone: no renderer takes part (see `ray_psf`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.waves.even_pupil import even_pupil
from optics.waves.pupil_field import PupilField, trace_pupil
from render.records import EffectivePsf

__all__ = ["WaveImages", "wave_images"]


ORDER = (12, 48)
"""Rings and azimuths of rays that phase and amplitude of a clear pupil are fitted to."""
PIXEL_SHARE = 1e-4
"""Light is sampled so finely that frequencies folded onto others are let through by the pixel to this part."""
HIGHEST_PER_PX = 6.0
"""Frequencies that a pixel without diffusion is followed to."""
SIGMAS = 6.0
"""Of charge diffusion, beyond which a pixel sees nothing."""
ROOM = 1.8
"""Repeat distance of the images that an even pupil makes, in widths of the window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveImages:
    """Diffraction images of f fields at w wavelengths on a fine grid, each about the mean of its light."""

    offset_px: FloatArray  # (n,) Rows and columns of the grid
    light: NDArray[np.float32]  # (f, w, n, n) Share of the light of the wavelength per px^2
    mean_px: FloatArray  # (f, w, 2) Mean of all light on the pixels, column and row
    area_mm2: FloatArray  # (f, w) Cross-section of the beam
    diffusion_px: float  # Standard deviation of the Gaussian charge diffusion
    # oversampling, half_size_px: Of the PSFs: samples per pixel, half-width
    oversampling: int
    half_size_px: int

    def psfs(self, share: FloatArray) -> tuple[EffectivePsf, ...]:
        """PSFs (f) of light of which each wavelength (w,) has a share, centred on the mean of all of it."""
        reach = self.half_size_px * self.oversampling
        place = np.arange(-reach, reach + 1) / self.oversampling
        found = []
        for light, mean, area in zip(self.light, self.mean_px, self.area_mm2, strict=True):
            part = share * area / (share @ area)
            values = np.zeros((len(place), len(place)))
            for one, weight, offset in zip(light, part, mean - part @ mean, strict=True):
                columns, rows = (self._pixel(place - along) for along in offset)
                values += weight * (rows @ one @ columns.T)
            found.append(EffectivePsf(values=values, oversampling=self.oversampling))
        return tuple(found)

    def _pixel(self, place_px: FloatArray) -> NDArray[np.float32]:
        """Weights (p, n) of the samples in the light of pixels at places."""
        distance = np.abs(place_px[:, None] - self.offset_px)
        step = float(self.offset_px[1] - self.offset_px[0])
        if self.diffusion_px <= 0.0:  # parts of the samples' own cells
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
) -> WaveImages:
    """Diffraction images of stars along the x axis of the field, turned about the axis of the lens.

    Parameters
    ----------
    lens : LensSystem
        The lens, focused.
    field_x_deg : (f,)
        Field angles.
    wavelength_nm : (w,)
        Vacuum wavelengths.
    pitch_mm : float
        Of the pixels.
    diffusion_px : float
        Standard deviation of the Gaussian charge diffusion.
    azimuth_deg : float
        Where the fields lie on the detector, from columns towards rows.
    oversampling, half_size_px : int
        Samples per pixel, even, and half-width of the PSFs.

    Raises
    ------
    DomainError
        An odd oversampling; no light of a field; what `optics.waves.pupil_field.trace_pupil` raises.
    """
    if oversampling < 2 or oversampling % 2:
        raise DomainError(f"wave_images: oversampling = {oversampling}; an even number of at least 2 is needed")
    nothing = np.zeros_like(field_x_deg)
    rays = _turned(trace_pupil(lens, field_x_deg, nothing, wavelength_nm, order=ORDER), math.radians(azimuth_deg))
    mean_px = np.stack(rays.mean_mm, axis=-1) / pitch_mm
    if np.isnan(mean_px).any():
        raise DomainError(f"field {field_x_deg[np.argwhere(np.isnan(mean_px))[0][0]]:g} deg: no light arrives")
    apart = float(np.abs(mean_px - mean_px.mean(1, keepdims=True)).max()) * 2.0
    half_px = half_size_px + 0.5 + 5.5 * diffusion_px + apart
    highest = 2.0 * float((np.hypot(rays.l, rays.m) * (rays.index / rays.wavelength_nm)[:, None, None]).max()) * 1e6
    highest *= pitch_mm
    seen = HIGHEST_PER_PX
    if diffusion_px > 0.0:
        seen = min(seen, math.sqrt(-math.log(PIXEL_SHARE) / 2.0) / (math.pi * diffusion_px))
    per_px = math.ceil(highest + min(highest, seen))
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
            image = even_pupil(rays, at, size=size).intensity(offset * pitch_mm, offset * pitch_mm)
        else:
            x, y = (m + offset * pitch_mm for m in np.stack(rays.mean_mm, axis=-1)[at])
            image = rays.intensity(x, y, at=at, dtype=np.complex64)
        light[at] = image * pitch_mm**2
    return WaveImages(
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
