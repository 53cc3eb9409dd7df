"""Cramer-Rao bound of centroids: the best that a star's light on its pixels allows, against which errors are held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates

from calib.measure.crlb import fisher_information
from calib.measure.epsf import draw_epsf
from calib.records import NoiseModel
from experiments.laboratory.readout.noise_model import true_noise
from optics.arrays import FloatArray
from optics.records import freeze
from render.records import EffectivePsf

if TYPE_CHECKING:
    from experiments.dataset.frames.scene import Scene
    from experiments.laboratory.readout.psf_grid import PsfGrid

__all__ = ["CentroidBound", "centroid_bound", "dataset_bound"]


BOUND_RADII = (0.0, 0.5, 0.9)
"""Where PSFs for the bound are taken: parts of the largest distance of a PSF from the middle."""
PHASES = 8
STEP_PX = 1e-4
FLUX_KNOTS = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidBound:
    """Cramer-Rao bound of a centroid against electrons, at some distances from the middle, at every sub-pixel phase."""

    radius_px: FloatArray  # (r,) Increasing distances of the PSFs
    electrons: FloatArray  # (k,) Increasing
    sigma_px: FloatArray  # (r, k, p, p, 2) Of x and y, for phases (-1/2 + (i + 1/2) / p) of row and column

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "radius_px", shape=("r",), sizes=sizes)
        freeze(self, "electrons", shape=("k",), sizes=sizes)
        freeze(self, "sigma_px", shape=("r", "k", "p", "p", 2), sizes=sizes)

    def at(self, electrons: FloatArray, position_px: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Bounds (n, 2) of stars at positions (n, 2): nearest PSF, interpolated in phase and in the log of the flux."""
        nearest = np.abs(np.asarray(radius_px)[:, None] - self.radius_px).argmin(axis=1)
        log_e = np.log(self.electrons)
        flux = np.clip(np.interp(np.log(np.asarray(electrons)), log_e, np.arange(len(log_e))), 0, len(log_e) - 1)
        phases = self.sigma_px.shape[2]
        phase = (np.asarray(position_px) + 0.5) % 1.0 * phases - 0.5
        padded = np.pad(np.log(self.sigma_px), ((0, 0), (0, 0), (1, 1), (1, 1), (0, 0)), mode="wrap")
        place = np.stack([nearest, flux, phase[:, 1] + 1.0, phase[:, 0] + 1.0])
        return np.stack([np.exp(map_coordinates(padded[..., axis], place, order=1)) for axis in (0, 1)], axis=-1)


def centroid_bound(
    psfs: list[EffectivePsf],
    radius_px: FloatArray,
    *,
    noise: NoiseModel,
    background_e: float,
    window_px: int,
    electrons: tuple[float, float],
) -> CentroidBound:
    """Bound for stars of unknown position and flux on a known background, in the window that is used."""
    flux, middle = np.geomspace(*electrons, FLUX_KNOTS), (window_px - 1) / 2.0
    phase = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    y, x = (value.ravel() + middle for value in np.meshgrid(phase, phase, indexing="ij"))

    def images(psf: EffectivePsf, dx: float, dy: float) -> FloatArray:
        return np.asarray(draw_epsf(psf, x + dx, y + dy, (window_px, window_px))).reshape(PHASES**2, -1)

    sigma = np.empty((len(psfs), FLUX_KNOTS, PHASES, PHASES, 2))
    for row, psf in enumerate(psfs):
        unit = images(psf, 0.0, 0.0)
        along_x, along_y = (
            (images(psf, *step) - images(psf, *(-np.array(step)))) / (2.0 * STEP_PX)
            for step in ((STEP_PX, 0.0), (0.0, STEP_PX))
        )
        for column, value in enumerate(flux):
            jacobian = np.stack([value * along_x, value * along_y, unit], axis=1)
            information = fisher_information(jacobian, value * unit + background_e, noise)
            variance = np.diagonal(np.linalg.inv(information), axis1=1, axis2=2)[:, :2]
            sigma[row, column] = np.sqrt(variance).reshape(PHASES, PHASES, 2)
    return CentroidBound(radius_px=np.asarray(radius_px, float), electrons=flux, sigma_px=sigma)


def dataset_bound(scene: Scene, psfs: PsfGrid, sky_e: float) -> CentroidBound:
    """Bound with the PSFs of the lens on an even sky; dark charge and the noise of the mean dark count."""
    distance = np.hypot(*(psfs.place_px - scene.instrument.camera.centre_px).T)
    chosen = [int(np.abs(distance - part * distance.max()).argmin()) for part in BOUND_RADII]
    return centroid_bound(
        [psfs.psfs[k] for k in chosen],
        distance[chosen],
        noise=true_noise(scene.instrument, dark_frames=scene.config.verify.dark_frames),
        background_e=sky_e,
        window_px=scene.config.window_px,
        electrons=(30.0, 10.0 * scene.instrument.detector.full_well_e),
    )
