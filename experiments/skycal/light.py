"""What the lens makes of one colour of light: where a star of that colour falls, and what it looks like there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid import get_centroider
from calib.records import NoiseModel, Stamps, StarTable
from experiments.laboratory.centroid_methods import needs_epsf
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from render.records import EffectivePsf
from render.tracing.psf import TOLERANCE, render_epsf
from render.tracing.tracer import Tracer

if TYPE_CHECKING:
    from experiments.skycal.match import Matched
    from experiments.skycal.measure import Recording
    from experiments.skycal.scene import Scene
    from experiments.skycal.settings import Config

__all__ = ["BankRenderer", "Chart", "PsfBank", "colour_classes", "own_colour_centroids", "trace_chart", "trace_colour"]


TRACE_AT_ONCE = 2000
EDGE_FRACTION = 0.012
"""The chart ends this part of the longer side inside the detector, so that its traced points stay on it."""
CHART_LOG2_RAYS = 3
"""The truth gets eight times the rays of a star: errors of some 1e-3 px average out over stars, but not in it."""
COLOURS = 5
"""Classes of temperature for which PSFs are rendered when every star gets one of its own colour."""
NODES = 3
"""PSFs along each axis between which a star's own is interpolated."""
OVERSAMPLING = 4
"""Of the PSFs; against twice as many samples it moves a fit by some 1e-3 px where spots are sharpest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """The truth: where light of the reference colour falls, traced.

    Attributes
    ----------
    direction : (n, 3)
        Unit vectors in cam.
    pixel_px : (n, 2)
        Mean of the rays.
    rows, columns : int
        Grid, row by row; rows times columns is n.
    """

    direction: FloatArray
    pixel_px: FloatArray
    rows: int
    columns: int

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        freeze(self, "pixel_px", shape=("n", 2), sizes=sizes)


def trace_colour(scene: Scene, direction: FloatArray, temperature_k: float, *, more_log2_rays: int = 0) -> FloatArray:
    """Where the mean of the rays of a star of one colour falls: (n, 2) [px], no image, no noise.

    Parameters
    ----------
    scene : Scene
        Camera.
    direction : (n, 3)
        Unit vectors in cam.
    temperature_k : float
        Colour.
    more_log2_rays : int
        Logarithm of how many times more rays than stars of a frame get, where the pupil is not clear.

    Returns
    -------
    (n, 2)
        Bundle means; NaN where no ray arrives.
    """
    camera = scene.instrument.camera
    # one pixel of an image is enough where only rays count
    tiny = replace(camera, width_px=1, height_px=1, centre_px=camera.centre_px)
    tracer = Tracer(tiny, sobol_log2_rays=scene.config.sobol_log2_rays + more_log2_rays)
    parts = []
    for start in range(0, len(direction), TRACE_AT_ONCE):
        stars = scene.of_one_colour(direction[start : start + TRACE_AT_ONCE], temperature_k)
        if tracer.pupil.exact:  # a mean needs few rays where nothing cuts the bundle
            parts.append(tracer.bundle_means(stars, rings=8, arms=20)[:, 0])
        else:
            truth = tracer.render(stars, exposure_s=1.0).truth
            parts.append(np.column_stack([truth.bundle_x_px, truth.bundle_y_px]))
    if not parts:
        raise DomainError(f"{scene.name}: no star to trace")
    return np.concatenate(parts)


def trace_chart(scene: Scene, config: Config) -> Chart:
    """Trace the truth on a regular grid of nominal pixels.

    Raises
    ------
    DomainError
        Where no ray reaches a part of the detector.
    """
    camera = scene.instrument.camera
    longer = max(camera.width_px, camera.height_px)
    columns, rows = (max(3, round(config.map_points * n / longer)) for n in (camera.width_px, camera.height_px))
    edge = EDGE_FRACTION * longer
    x, y = np.meshgrid(
        np.linspace(edge, camera.width_px - 1 - edge, columns), np.linspace(edge, camera.height_px - 1 - edge, rows)
    )
    direction = camera.nominal_direction(x.ravel(), y.ravel(), scene.instrument.focal_length_mm)
    pixel = trace_colour(scene, direction, config.sky.reference_k, more_log2_rays=CHART_LOG2_RAYS)
    if not np.isfinite(pixel).all():
        dark = int((~np.isfinite(pixel).all(axis=1)).sum())
        raise DomainError(
            f"{scene.name}: no light reaches {dark} of {len(pixel)} places of the detector through lens "
            f"{camera.lens.name!r}; set {scene.name}.window_px smaller"
        )
    return Chart(direction=direction, pixel_px=pixel, rows=rows, columns=columns)


@dataclass(frozen=True, slots=True)
class PsfBank:
    """Effective PSFs of one colour on a grid that spans the detector.

    Attributes
    ----------
    psfs : tuple of EffectivePsf
        Row by row, the outermost on the edges of the detector.
    columns, rows : int
        Of the grid.
    size_px : tuple of int
        Columns and rows of the detector.
    """

    psfs: tuple[EffectivePsf, ...]
    columns: int
    rows: int
    size_px: tuple[int, int]

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
    """Renders PSF banks of one camera; the tracer is prepared once.

    Parameters
    ----------
    scene, config
        The camera, and the spacing of the PSFs.
    """

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


def colour_classes(temperature_k: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Temperatures [K] of `COLOURS` classes of equal numbers of stars, and the class of every star (n,)."""
    edges = np.quantile(temperature_k, np.linspace(0.0, 1.0, COLOURS + 1)[1:-1])
    member = np.searchsorted(edges, temperature_k, side="right")
    present, member = np.unique(member, return_inverse=True)
    # photons shift in proportion to 1/T rather than to T
    typical = [1.0 / np.mean(1.0 / temperature_k[member == k]) for k in range(len(present))]
    return np.array(typical), member


def own_colour_centroids(scene: Scene, recording: Recording, matched: Matched, config: Config) -> FloatArray:
    """Centroids (n, 2) [px] with PSFs of the stars' own colours, which the catalogue tells once they have names.

    The origin of a PSF is the mean of the rays of its own colour, so that these positions estimate where the star's own
    light fell. NaN where the fit does not converge.
    """
    from calib.flags import StarFlag, has_flag

    renderer = BankRenderer(scene, config)
    centroider = config.centroid if needs_epsf(config.centroid) else "epsf"
    colour, member = colour_classes(scene.sky.temperature_k[matched.star])
    position = np.full((len(matched), 2), np.nan)
    for number, temperature in enumerate(colour):
        bank = renderer.render(float(temperature))
        mine = np.flatnonzero(member == number)
        stamps = recording.stamps.select(matched.row[mine])
        table = bank.measure(replace(stamps, start_px=matched.pixel_px[mine]), recording.noise, centroider)
        bad = has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA)
        position[mine] = np.where(bad[:, None], np.nan, np.column_stack([table.x_px, table.y_px]))
    return position
