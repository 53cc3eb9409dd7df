"""Effective PSFs of one colour over the detector, and centroids with the PSF of each star's place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid import get_centroider
from calib.records import NoiseModel, Stamps, StarTable
from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from optics.arrays import FloatArray
from render.records import EffectivePsf
from render.tracing.psf import TOLERANCE, render_epsf
from render.tracing.tracer import Tracer

__all__ = ["BankRenderer", "PsfBank"]


NODES = 3
"""PSFs along each axis between which a star's own is interpolated."""
OVERSAMPLING = 4
"""Of the PSFs; against twice as many samples it moves a fit by some 1e-3 px where spots are sharpest."""


@dataclass(frozen=True, slots=True)
class PsfBank:
    """Effective PSFs of one colour on a grid that spans the detector."""

    psfs: tuple[EffectivePsf, ...]  # Row by row, the outermost on the edges of the detector
    columns: int  # Of the grid
    rows: int  # Of the grid
    size_px: tuple[int, int]  # Columns and rows of the detector

    def neighbours(self, x_px: FloatArray, y_px: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """The PSFs around each place (n, k), the one of largest weight first, and their weights (n, k).

        Three nodes along each axis, or as many as there are, with the weights of Lagrange's interpolation.
        """
        cell, part = [], []
        for place, count, size in zip((x_px, y_px), (self.columns, self.rows), self.size_px, strict=True):
            order = min(NODES, count)
            at = np.clip((place + 0.5) / size * (count - 1), 0.0, count - 1)
            first = np.clip(np.rint(at).astype(np.int64) - order // 2, 0, count - order)
            nodes = first[:, None] + np.arange(order)
            cell.append(nodes)
            part.append(_lagrange(at, nodes))
        index = (cell[1][:, :, None] * self.columns + cell[0][:, None, :]).reshape(len(x_px), -1)
        weight = (part[1][:, :, None] * part[0][:, None, :]).reshape(len(x_px), -1)
        ranks = np.argsort(-weight, axis=1, kind="stable")
        return np.take_along_axis(index, ranks, 1), np.take_along_axis(weight, ranks, 1)

    def measure(self, stamps: Stamps, noise: NoiseModel, centroider: str = "epsf") -> StarTable:
        """Centroids with the PSF of each star's place, by a centroider that needs one.

        A small change of the PSF moves the fit in proportion to it, so that the positions found with the PSFs around a
        star, weighted as one would weight the PSFs themselves, give the position that the interpolated PSF would give.
        The fits share their noise: the weights, some of them negative, do not raise it.
        """
        fit = get_centroider(centroider, epsf=self.psfs)
        index, weight = self.neighbours(stamps.start_px[:, 0], stamps.start_px[:, 1])
        first = fit.measure(replace(stamps, psf_index=index[:, 0]), noise)
        start = np.column_stack([first.x_px, first.y_px])
        start = np.where(np.isfinite(start), start, stamps.start_px)
        x, y, flux = (weight[:, 0] * value for value in (first.x_px, first.y_px, first.flux_e))
        flags = first.flags
        for rank in range(1, index.shape[1]):
            table = fit.measure(replace(stamps, psf_index=index[:, rank], start_px=start), noise)
            share = weight[:, rank]
            x, y, flux = x + share * table.x_px, y + share * table.y_px, flux + share * table.flux_e
            flags = flags | table.flags
        return replace(first, x_px=x, y_px=y, flux_e=flux, flags=flags)


def _lagrange(at: FloatArray, nodes: NDArray[np.int64]) -> FloatArray:
    """Weights (n, k) of values at whole-numbered nodes (n, k) for the places ``at`` (n,)."""
    weight = np.ones(nodes.shape)
    for i in range(nodes.shape[1]):
        for j in range(nodes.shape[1]):
            if i != j:
                weight[:, i] *= (at - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return weight


class BankRenderer:
    """Renders PSF banks of one camera; the tracer is prepared once."""

    def __init__(self, scene: Scene, config: Config) -> None:
        camera = scene.instrument.camera
        self._scene, self._half_px = scene, config.window_px // 2 + 1
        self._columns, self._rows = (
            1 + max(1, round(n / scene.config.psf_spacing_px)) for n in (camera.width_px, camera.height_px)
        )
        x, y = (
            np.linspace(-0.5, size - 0.5, count)
            for size, count in ((camera.width_px, self._columns), (camera.height_px, self._rows))
        )
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        self._place = camera.nominal_direction(grid[:, 0], grid[:, 1], scene.instrument.focal_length_mm)
        self._tracer = Tracer(camera, tolerance=TOLERANCE, sobol_log2_rays=scene.config.sobol_log2_rays)

    def render(self, temperature_k: float) -> PsfBank:
        """PSFs of one colour, each centred on the mean of the rays of that colour."""
        camera = self._scene.instrument.camera
        stars = self._scene.of_one_colour(self._place, temperature_k)
        rendered = render_epsf(self._tracer, stars, half_size_px=self._half_px, oversampling=OVERSAMPLING)
        size = (camera.width_px, camera.height_px)
        return PsfBank(tuple(row[0] for row in rendered), self._columns, self._rows, size)
