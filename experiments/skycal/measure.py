"""From the sky to centroids: every frame rendered through the lens, read out, dark-subtracted, detected, measured."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.measure.background import estimate_background
from calib.measure.centroid import get_centroider
from calib.measure.find import find_stamps
from calib.records import NoiseModel, Stamps, StarTable
from experiments.harness.system import prompt_pool
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import dark_subtracted_frame, mean_dark_frame
from experiments.laboratory.bench.readout.noise_model import true_noise
from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from optics.arrays import FloatArray
from optics.records import concatenated, freeze
from render.detector.readout import expose
from render.engine.random import Streams
from render.forward import StarRenderer
from render.records import EffectivePsf, Frame, Truth
from render.tracing.psf import TOLERANCE, render_epsf
from render.tracing.tracer import Tracer

BACKGROUND_BOX_PX = 256
BACKGROUND_STEP_PX = 4
"""The sky is flat over hundreds of pixels; every 16th pixel gives its level to 0.3 e-."""
BANK_ERROR_PX, FINER = 0.005, 2
"""Largest shift of a fit by interpolation of the PSFs of a sensor file; their spacing is halved at most twice."""
AHEAD = 2
"""Frames that may wait for their reduction while the next ones are rendered."""
FWHM_PX = 1.8
NODES = 3
"""PSFs along each axis between which a star's own is interpolated."""
OVERSAMPLING = 4
"""Of the PSFs; against twice as many samples it moves a fit by some 1e-3 px where spots are sharpest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameStars:
    """One frame: detections and truth."""

    found: StarTable  # Detections with centroids, in pixels of the window
    first_row: int  # Row of the first of them in the stamps of the recording
    star: NDArray[np.int64]  # (n,) Rows of the sky that were rendered
    direction: FloatArray  # (n, 3) Their directions in cam
    photon_px: FloatArray  # (n, 2) Mean of all light of each
    electrons: FloatArray  # (n,) Electrons of each on the detector

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "star", shape=("n",), dtype=np.int64, sizes=sizes)
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        freeze(self, "photon_px", shape=("n", 2), finite=False, sizes=sizes)
        freeze(self, "electrons", shape=("n",), sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """All frames of a camera."""

    frames: tuple[FrameStars, ...]  # In order
    example: Frame  # Raw readout of one frame in the middle of the sequence
    example_index: int  # Its number
    stamps: Stamps  # Windows of all detections, frame after frame
    noise: NoiseModel  # Noise of a pixel


def record(scene: Scene, config: Config, streams: Streams, *, advance: Callable[[], None]) -> Recording:
    """Render and reduce all frames.

    The renderer needs all cores for a moment and the reduction one for longer; the latter runs behind in threads of
    its own.
    """
    instrument, exposure_s = scene.instrument, scene.instrument.config.exposure_s
    renderer = StarRenderer(instrument.camera, exposure_s=exposure_s, sobol_log2_rays=scene.config.sobol_log2_rays)
    noise = true_noise(instrument, dark_frames=config.dark_frames)
    dark_dn = mean_dark_frame(instrument, config.dark_frames, streams=streams.child("dark"))
    middle, example = scene.frames // 2, None
    truths: list[_Rendered] = []
    cut: list[Future[Stamps]] = []
    with prompt_pool(AHEAD) as pool:
        for number in range(scene.frames):
            rows, direction = scene.in_cam(number)
            expected = renderer.render(scene.stars(rows, direction))
            assert expected.truth is not None
            frame = expose(
                expected,
                instrument.detector,
                streams=streams,
                frame=number,
                exposure_s=exposure_s,
                temperature_c=instrument.config.chip_temperature_c,
                background_e_per_s=scene.config.background_e_per_s,
            )
            truths.append(_Rendered(rows, direction, expected.truth))
            if number == middle:
                example = frame
            cut.append(pool.submit(_detect, config, frame, dark_dn, noise))
            del expected, frame
            if number >= AHEAD:
                cut[number - AHEAD].result()
            advance()
        stamps = [one.result() for one in cut]
    assert example is not None
    every = concatenated(stamps)
    table = _centroids(scene, config, every, noise)
    ends = np.cumsum([len(one) for one in stamps])
    return Recording(
        frames=tuple(
            truth.beside(table.select(slice(end - len(one), end)), int(end - len(one)))
            for truth, one, end in zip(truths, stamps, ends, strict=True)
        ),
        example=example,
        example_index=middle,
        stamps=every,
        noise=noise,
    )


@dataclass(frozen=True, slots=True)
class _Rendered:
    """True stars of a rendered frame."""

    star: NDArray[np.int64]
    direction: FloatArray
    truth: Truth

    def beside(self, found: StarTable, first_row: int) -> FrameStars:
        """Truth and measurement, star by star."""
        return FrameStars(
            found=found,
            first_row=first_row,
            star=self.star,
            direction=self.direction,
            photon_px=np.column_stack([self.truth.photon_x_px, self.truth.photon_y_px]),
            electrons=self.truth.electrons_image[:, 0],
        )


def _centroids(scene: Scene, config: Config, stamps: Stamps, noise: NoiseModel) -> StarTable:
    """Centroids of all frames at once, so that PSFs are prepared once."""
    if not len(stamps):
        return StarTable.empty()
    if needs_epsf(config.centroid):
        return BankRenderer(scene, config).render(config.sky.reference_k).measure(stamps, noise, config.centroid)
    return get_centroider(config.centroid).measure(stamps, noise)


def _detect(config: Config, frame: Frame, dark_dn: NDArray[np.float32], noise: NoiseModel) -> Stamps:
    """Find the stars of a frame, brightest first, and cut them out."""
    image = dark_subtracted_frame(frame, dark_dn, noise)
    return find_stamps(
        image,
        background=estimate_background(image, box_px=BACKGROUND_BOX_PX, step_px=BACKGROUND_STEP_PX),
        threshold_sigma=config.threshold_sigma,
        fwhm_px=FWHM_PX,
        size_px=config.window_px,
    )


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

    def error_px(self) -> float:
        """Shift, RMS per axis, of fits by PSFs interpolated along rows: an eighth of that between every other node.

        Lagrange's interpolation with three nodes is of third order. Infinite with less than five columns.
        """
        if self.columns < 5:
            return np.inf
        psf = np.stack([one.values for one in self.psfs]).reshape(self.rows, self.columns, *self.psfs[0].values.shape)
        at = np.arange(1.0, self.columns - 1.0, 2.0) / 2.0
        nodes = np.clip(np.rint(at).astype(int) - 1, 0, (self.columns - 1) // 2 - 2)[:, None] + np.arange(NODES)
        guess = np.einsum("kn,rknyx->rkyx", _lagrange(at, nodes), psf[:, 2 * nodes])
        true = psf[:, 1 : self.columns - 1 : 2]
        slope = np.array(np.gradient(true, 1.0 / OVERSAMPLING, axis=(2, 3)))
        shift = (slope * (true - guess)).sum((3, 4)) / (slope**2).sum((3, 4))
        return float(np.sqrt((shift**2).mean())) / 8.0


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
        self._scene, self._half_px = scene, config.window_px // 2 + 1
        self._tracer = Tracer(
            scene.instrument.camera, tolerance=TOLERANCE, sobol_log2_rays=scene.config.sobol_log2_rays
        )
        spacing_px = scene.config.psf_spacing_px
        self._lay_out(spacing_px)
        for _ in range(FINER if scene.name == "own" else 0):
            if self.render(config.sky.reference_k).error_px() <= BANK_ERROR_PX:
                break
            spacing_px /= 2.0
            self._lay_out(spacing_px)

    def _lay_out(self, spacing_px: float) -> None:
        camera = self._scene.instrument.camera
        size = (camera.width_px, camera.height_px)
        self._columns, self._rows = (1 + max(1, round(n / spacing_px)) for n in size)
        axes = (np.linspace(-0.5, n - 0.5, count) for n, count in zip(size, (self._columns, self._rows), strict=True))
        x, y = (v.ravel() for v in np.meshgrid(*axes))
        self._place = self._scene.instrument.direction_at(x, y)

    def render(self, temperature_k: float) -> PsfBank:
        """PSFs of one colour, each centred on the mean of the rays of that colour."""
        camera = self._scene.instrument.camera
        stars = self._scene.of_one_colour(self._place, temperature_k)
        rendered = render_epsf(self._tracer, stars, half_size_px=self._half_px, oversampling=OVERSAMPLING)
        size = (camera.width_px, camera.height_px)
        return PsfBank(tuple(row[0] for row in rendered), self._columns, self._rows, size)
