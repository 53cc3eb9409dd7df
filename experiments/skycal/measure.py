"""From the sky to centroids: every frame rendered through the lens, read out, dark-subtracted, detected, measured."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.measure.background import estimate_background
from calib.measure.centroid import get_centroider
from calib.measure.find import find_stamps
from calib.records import NoiseModel, Stamps, StarTable
from experiments.harness.system import prompt_pool
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.readout.frames import dark_subtracted_frame, mean_dark_frame
from experiments.laboratory.readout.noise_model import true_noise
from experiments.skycal.psf_bank import BankRenderer
from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from optics.arrays import FloatArray
from optics.records import concatenated, freeze
from render.detector.readout import expose
from render.engine.random import Streams
from render.forward import StarRenderer
from render.records import Frame, Truth

__all__ = ["FrameStars", "Recording", "record"]


BACKGROUND_BOX_PX = 256
BACKGROUND_STEP_PX = 4
"""The sky is flat over hundreds of pixels; every 16th pixel gives its level to 0.3 e-."""
AHEAD = 2
"""Frames that may wait for their reduction while the next ones are rendered."""
FWHM_PX = 1.8


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameStars:
    """One frame: what was found, and what was there."""

    found: StarTable  # Detections with centroids, in pixels of the window
    first_row: int  # Row of the first of them in the stamps of the recording
    star: NDArray[np.int64]  # (n,) Rows of the sky that were rendered
    direction: FloatArray  # (n, 3) Their directions in cam
    photon_px: FloatArray  # (n, 2) Centroid of the noiseless light of each
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
    """What was rendered into a frame."""

    star: NDArray[np.int64]
    direction: FloatArray
    truth: Truth

    def beside(self, found: StarTable, first_row: int) -> FrameStars:
        """Truth and measurement together."""
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
