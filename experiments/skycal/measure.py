"""From the sky to centroids: every frame rendered through the lens, read out, dark-subtracted, detected, measured."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.measure.background import estimate_background
from calib.measure.centroiding.registry import get_centroider
from calib.measure.epsf.field_interpolation import PsfBank
from calib.measure.find import find_stamps
from calib.measure.images.sensor_image import subtract_dark
from calib.records import NoiseModel, Stamps, StarTable
from experiments.harness.system import prompt_pool
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import mean_dark_frame, true_noise
from experiments.skycal.scene import TEMPERATURE_RANGE_K, CameraScene
from experiments.skycal.settings import SkycalConfig
from optics.arrays import FloatArray
from optics.records import concatenated, freeze
from render.engine.random import Streams
from render.observation import SkyLight
from render.psf_lattice import edge_axes, psf_tracer, render_psf_grid
from render.records import Frame

BACKGROUND_BOX_PX, BACKGROUND_STEP_PX = 256, 4
"""The sky is flat over hundreds of pixels; every 16th pixel gives its level to 0.3 e-."""
BANK_ERROR_PX, MAX_HALVINGS = 0.005, 2
"""Largest shift of a fit by interpolation of the PSFs of a sensor file, and limit of the halvings of their spacing."""
AHEAD = 2
"""Frames that may wait for their reduction while the next ones are rendered."""
FWHM_PX = 1.8
"""Width of the matched filter of the detection."""
NO_PIXELS = np.zeros((0, 0), np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameStars:
    """A frame: detections and truth."""

    detections: StarTable  # Detected stars with centroids
    first_row: int  # Row of the first detection in the stamps of the recording
    star: NDArray[np.int64]  # (n,) Rows of the rendered stars in the sky
    direction: FloatArray  # (n, 3) Unit vectors in cam
    photon_px: FloatArray  # (n, 2) Mean of all light of the star
    electrons: FloatArray  # (n,) Electrons of the star on the detector

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "star", shape=("n",), dtype=np.int64, sizes=sizes)
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        freeze(self, "photon_px", shape=("n", 2), finite=False, sizes=sizes)
        freeze(self, "electrons", shape=("n",), sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """All frames of a camera."""

    frames: tuple[FrameStars, ...]
    example: Frame  # Raw readout of the frame in the middle of the sequence
    stamps: Stamps  # Windows of all detections, frame after frame
    noise: NoiseModel  # Noise of a pixel


def record(scene: CameraScene, config: SkycalConfig, streams: Streams, *, advance: Callable[[], None]) -> Recording:
    """Render and reduce all frames.

    The renderer needs all cores for a moment, the reduction a single core for longer: it runs in other threads, up to
    `AHEAD` frames behind.
    """
    instrument = scene.instrument
    noise = true_noise(instrument, dark_frames=config.dark_frames)
    dark_dn = mean_dark_frame(instrument, config.dark_frames, streams=streams.child("dark"))
    example = None
    rendered: list[SkyLight] = []
    pending: list[Future[Stamps]] = []
    with prompt_pool(AHEAD) as pool:
        for number in range(scene.frames):
            light = scene.simulator.expected(scene.attitude[number])
            frame = scene.simulator.read(light, frame=number, streams=streams)
            rendered.append(
                replace(light, electrons=NO_PIXELS, layers={})
            )  # Images are large: only field and truth are kept
            if number == scene.frames // 2:
                example = frame
            pending.append(pool.submit(_detect, config, frame, dark_dn, noise))
            del light, frame
            if number >= AHEAD:
                pending[number - AHEAD].result()
            advance()
        stamps = [future.result() for future in pending]
    assert example is not None
    all_stamps = concatenated(stamps)
    table = _centroids(scene, config, all_stamps, noise)
    row_ends = np.cumsum([len(frame_stamps) for frame_stamps in stamps])
    return Recording(
        frames=tuple(
            _frame_stars(light, table.select(slice(end - len(frame_stamps), end)), int(end - len(frame_stamps)))
            for light, frame_stamps, end in zip(rendered, stamps, row_ends, strict=True)
        ),
        example=example,
        stamps=all_stamps,
        noise=noise,
    )


def _frame_stars(light: SkyLight, detections: StarTable, first_row: int) -> FrameStars:
    """Detections of a frame, and truth of its rendered stars."""
    field, truth = light.field, light.truth
    assert field is not None
    return FrameStars(
        detections=detections,
        first_row=first_row,
        star=field.row,
        direction=field.direction @ field.rotation_cam_from_icrs.T,
        photon_px=np.column_stack([truth.photon_x_px, truth.photon_y_px]),
        electrons=truth.electrons_image[:, 0],
    )


def _centroids(scene: CameraScene, config: SkycalConfig, stamps: Stamps, noise: NoiseModel) -> StarTable:
    """Centroids of all frames together: the PSFs are prepared once."""
    if not len(stamps):
        return StarTable.empty()
    if needs_epsf(config.centroid):
        return BankRenderer(scene, config).render(config.sky.reference_k).measure(stamps, noise, config.centroid)
    return get_centroider(config.centroid).measure(stamps, noise)


def _detect(config: SkycalConfig, frame: Frame, dark_dn: NDArray[np.float32], noise: NoiseModel) -> Stamps:
    """Windows of the detected stars of a frame, brightest first."""
    image = subtract_dark(frame, dark_dn, noise=noise)
    return find_stamps(
        image,
        background=estimate_background(image, box_px=BACKGROUND_BOX_PX, step_px=BACKGROUND_STEP_PX),
        threshold_sigma=config.threshold_sigma,
        fwhm_px=FWHM_PX,
        size_px=config.window_px,
    )


class BankRenderer:
    """Renders PSF banks of a camera; the tracer is prepared once."""

    def __init__(self, scene: CameraScene, config: SkycalConfig) -> None:
        self._scene, self._window_px = scene, config.window_px
        self._spacing_px = scene.config.psf_spacing_px
        self._tracer = psf_tracer(scene.instrument, sobol_log2_rays=scene.config.sobol_log2_rays)
        for _ in range(MAX_HALVINGS if scene.name == "own" else 0):
            if self.render(config.sky.reference_k).error_px() <= BANK_ERROR_PX:
                break
            self._spacing_px /= 2.0

    def render(self, temperature_k: float) -> PsfBank:
        """PSFs of one colour, whose origin is the mean of the rays of that colour."""
        sensor = self._scene.instrument
        columns, rows = axes = edge_axes(sensor.camera, self._spacing_px)
        grid = render_psf_grid(
            sensor,
            self._scene.simulator.light,
            temperature_k=float(np.clip(temperature_k, *TEMPERATURE_RANGE_K)),
            window_px=self._window_px,
            axes=axes,
            margin_px=1,
            tracer=self._tracer,
        )
        return PsfBank(grid.psfs, len(columns), len(rows), (sensor.camera.width_px, sensor.camera.height_px))
