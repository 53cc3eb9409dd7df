"""Centroids with a PSF that changes over the field: fits with the PSFs of the nodes around a star, interpolated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroiding.registry import get_centroider
from calib.records import NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray
from render.records import EffectivePsf

NODES = 3
"""PSFs along each axis between which a star's own is interpolated."""


@dataclass(frozen=True, slots=True)
class PsfBank:
    """Effective PSFs of one colour on a grid that spans the detector."""

    psfs: tuple[EffectivePsf, ...]  # Row by row, the outermost on the edges of the detector
    columns: int  # Of the grid
    rows: int  # Of the grid
    size_px: tuple[int, int]  # Columns and rows of the detector

    def neighbours(self, x_px: FloatArray, y_px: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """The PSFs around each position (n, k), the one of largest weight first, and their weights (n, k).

        Three nodes along each axis, or as many as there are, with the weights of Lagrange's interpolation.
        """
        cell, part = [], []
        for position, count, size in zip((x_px, y_px), (self.columns, self.rows), self.size_px, strict=True):
            order = min(NODES, count)
            at = np.clip((position + 0.5) / size * (count - 1), 0.0, count - 1)
            first = np.clip(np.rint(at).astype(np.int64) - order // 2, 0, count - order)
            nodes = first[:, None] + np.arange(order)
            cell.append(nodes)
            part.append(lagrange_weights(at, nodes))
        index = (cell[1][:, :, None] * self.columns + cell[0][:, None, :]).reshape(len(x_px), -1)
        weight = (part[1][:, :, None] * part[0][:, None, :]).reshape(len(x_px), -1)
        ranks = np.argsort(-weight, axis=1, kind="stable")
        return np.take_along_axis(index, ranks, 1), np.take_along_axis(weight, ranks, 1)

    def measure(self, stamps: Stamps, noise: NoiseModel, centroider: str = "epsf") -> StarTable:
        """Centroids with the PSF of each star's position, by a centroider that needs one.

        A small change of the PSF moves the fit in proportion to it, so that the positions fitted with the PSFs around a
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
            part = weight[:, rank]
            x, y, flux = x + part * table.x_px, y + part * table.y_px, flux + part * table.flux_e
            flags = flags | table.flags
        return replace(first, x_px=x, y_px=y, flux_e=flux, flags=flags)

    def error_px(self) -> float:
        """Shift, RMS per axis, of fits by PSFs interpolated along rows: an eighth of that between every other node.

        Lagrange's interpolation with three nodes is of third order. Infinite with less than five columns.
        """
        if self.columns < 5:
            return np.inf
        psf = np.stack([one.values for one in self.psfs]).reshape(self.rows, self.columns, *self.psfs[0].values.shape)
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
