"""Centroids with a PSF that varies over the field: fits with the PSFs of the nodes around a star, interpolated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroiding.registry import get_centroider
from calib.records import NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray
from render.records import EffectivePsf

NODES = 3
"""PSFs along each axis that are interpolated."""


@dataclass(frozen=True, slots=True)
class PsfBank:
    """Effective PSFs of a colour on a grid that spans the detector."""

    psfs: tuple[EffectivePsf, ...]  # Row by row, the outermost on the edges of the detector
    columns: int  # Of the grid
    rows: int  # Of the grid
    size_px: tuple[int, int]  # Columns and rows of the detector

    def neighbours(self, x_px: FloatArray, y_px: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """PSFs (n, k) around each position, by falling weight, and their weights (n, k) in Lagrange's interpolation."""
        axes = []
        for position, count, size in zip((x_px, y_px), (self.columns, self.rows), self.size_px, strict=True):
            order = min(NODES, count)
            at = np.clip((position + 0.5) / size * (count - 1), 0.0, count - 1)
            first = np.clip(np.rint(at).astype(np.int64) - order // 2, 0, count - order)
            nodes = first[:, None] + np.arange(order)
            axes.append((nodes, lagrange_weights(at, nodes)))
        (column, column_weight), (row, row_weight) = axes
        index = (row[:, :, None] * self.columns + column[:, None, :]).reshape(len(x_px), -1)
        weight = (row_weight[:, :, None] * column_weight[:, None, :]).reshape(len(x_px), -1)
        ranks = np.argsort(-weight, axis=1, kind="stable")
        return np.take_along_axis(index, ranks, 1), np.take_along_axis(weight, ranks, 1)

    def measure(self, stamps: Stamps, noise: NoiseModel, centroider: str = "epsf") -> StarTable:
        """Centroids with the PSF at each star's position, by a centroider that needs a PSF.

        A small change of the PSF moves the fit in proportion, so that the positions fitted with the PSFs around a star,
        with the weights of the interpolation, give the position of the interpolated PSF. The fits have their noise in
        common: negative weights do not raise it.
        """
        fit = get_centroider(centroider, epsf=self.psfs)
        index, weight = self.neighbours(stamps.start_px[:, 0], stamps.start_px[:, 1])
        first = fit.measure(replace(stamps, psf_index=index[:, 0]), noise)
        stamps = replace(stamps, start_px=np.where(np.isfinite(first.pixel_px), first.pixel_px, stamps.start_px))
        others = [fit.measure(replace(stamps, psf_index=psf), noise) for psf in index.T[1:]]
        columns: dict[str, Any] = {
            name: sum(w * getattr(table, name) for w, table in zip(weight.T, (first, *others), strict=True))
            for name in ("x_px", "y_px", "flux_e")
        }
        return replace(first, flags=np.bitwise_or.reduce([table.flags for table in (first, *others)]), **columns)

    def error_px(self) -> float:
        """Shift, RMS per axis, of fits by PSFs interpolated along rows: an eighth of that between every other node.

        Lagrange's interpolation with three nodes is of third order. Infinite for fewer than five columns.
        """
        if self.columns < 5:
            return np.inf
        psf = np.stack([psf.values for psf in self.psfs]).reshape(self.rows, self.columns, *self.psfs[0].values.shape)
        at = np.arange(1.0, self.columns - 1.0, 2.0) / 2.0
        nodes = np.clip(np.rint(at).astype(int) - 1, 0, (self.columns - 1) // 2 - 2)[:, None] + np.arange(NODES)
        interpolated = np.einsum("kn,rknyx->rkyx", lagrange_weights(at, nodes), psf[:, 2 * nodes])
        true = psf[:, 1 : self.columns - 1 : 2]
        slope = np.array(np.gradient(true, 1.0 / self.psfs[0].oversampling, axis=(2, 3)))
        shift = (slope * (true - interpolated)).sum((3, 4)) / (slope**2).sum((3, 4))
        return float(np.sqrt((shift**2).mean())) / 8.0


def lagrange_weights(at: FloatArray, nodes: NDArray[np.int64]) -> FloatArray:
    """Weights (n, k) of values at whole-numbered nodes (n, k) for the positions ``at`` (n,)."""
    weight = np.ones(nodes.shape)
    for i in range(nodes.shape[1]):
        for j in range(nodes.shape[1]):
            if i != j:
                weight[:, i] *= (at - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return weight
