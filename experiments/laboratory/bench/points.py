"""Point targets behind b filters: rendered without noise, detected, cut into windows, read out, centroided."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroiding.registry import Centroider
from calib.measure.epsf.bspline import draw_epsf
from calib.measure.reduced_windows import dark_subtracted, refuse_saturated, ring_subtracted
from calib.measure.statistics.frame_positions import frame_statistics, measured_positions
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench.centroid_methods import method_centroiders
from experiments.laboratory.bench.point_bench import Bench, one_filter, point_field, refuse_few_frames
from experiments.laboratory.bench.readout.search import find_points
from experiments.laboratory.bench.readout.windows import WindowReader, cut_windows, window_corners
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD
from render.camera import Camera
from render.detector.spec import Detector
from render.engine.random import Streams
from render.forward import StarRenderer
from render.records import EffectivePsf, ExpectedImage, StarField, WindowStack
from render.sensor_file.instrument import Instrument
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.tracer import Tracer

Subtraction = Literal["dark", "raw"]
"""``dark``: minus the mean of frames with the lamp off. ``raw``: minus the nominal offset and a background value per
window, from the outermost ring of its mean frame; fixed patterns remain."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointLight:
    """A target at a position: j windows of noiseless light through a filter."""

    band: str  # Name of the filter
    direction: FloatArray  # (j, 3) Unit vectors in cam
    nominal_px: FloatArray  # (j, 2) Images by an ideal lens
    bundle_px: FloatArray  # (j, 2) Truth: mean of the traced rays
    photon_px: FloatArray  # (j, 2) Truth: centroid of the noiseless image
    spot_um: FloatArray  # (j,) RMS spot radius of the traced bundles
    detected_px: FloatArray  # (j, 2) Detected positions behind the reference filter
    corner_px: NDArray[np.int64]  # (j, 2) First pixel of each window
    light_e: FloatArray  # (j, h, w) Expected electrons at the signal of the bench
    psf: tuple[EffectivePsf, ...]  # PSF of each point behind this filter
    reference_psf: tuple[EffectivePsf, ...]  # PSF of each point for methods ``NAME_reference``

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"j": len(self.psf)}
        freeze(self, "direction", shape=("j", 3), sizes=sizes)
        for name in ("nominal_px", "bundle_px", "photon_px", "detected_px"):
            freeze(self, name, shape=("j", 2), sizes=sizes)
        freeze(self, "corner_px", shape=("j", 2), dtype=np.int64, sizes=sizes)
        freeze(self, "light_e", shape=("j", "h", "w"), sizes=sizes)

    def __len__(self) -> int:
        return len(self.psf)

    def centroiders(self, bench: Bench) -> dict[str, Centroider]:
        """Centroiders of a bench for these points, by method."""
        return method_centroiders(bench.methods, matched=self.psf, reference=self.reference_psf, measured=bench.epsf)


@dataclass(frozen=True, slots=True)
class PointScene:
    """Renders point targets through a camera; made by `filter_scene` or `point_scene`."""

    bench: Bench
    instrument: Instrument
    renderer: StarRenderer  # For images
    tracer: Tracer  # For PSFs

    def image(self, direction: FloatArray) -> ExpectedImage:
        """Noiseless image of points (j, 3) behind every filter, with truth."""
        collimator, exposure_s = self.bench.collimator, self.instrument.exposure_s
        motion = None if collimator is None else collimator.motion(exposure_s, self._pixel_rad)
        return self.renderer.render(point_field(self.bench, self.instrument, direction), motion=motion)

    def filter_psfs(self, direction: FloatArray, half_size_px: int) -> list[list[EffectivePsf]]:
        """PSF of each of the points (j, 3) behind each filter."""
        collimator, by_rays = self.bench.collimator, self.instrument.camera.diffraction == "rays"
        tracer = (not by_rays and self.renderer.tracer) or self.tracer
        stars = point_field(self.bench, self.instrument, direction)
        psfs = render_epsf(tracer, stars, half_size_px=half_size_px)
        if collimator is None:
            return psfs
        return [[collimator.pinhole_psf(psf, self._pixel_rad) for psf in row] for row in psfs]

    def psfs(self, direction: FloatArray) -> tuple[EffectivePsf, ...]:
        """PSF of each of the points (j, 3) behind the reference filter."""
        rows = self.filter_psfs(direction, self.bench.window_px // 2 + 2)
        return tuple(row[self.bench.reference] for row in rows)

    @property
    def _pixel_rad(self) -> float:
        return self.instrument.pixel_arcsec * ARCSEC_RAD

    def light(
        self, direction: FloatArray, streams: Streams, position: str, *, psf: Sequence[EffectivePsf] | None = None
    ) -> PointLight:
        """Light of a target behind the only filter; ``psf`` replaces rendered PSFs of the points."""
        psfs = self.psfs(direction) if psf is None else tuple(psf)
        middle = (psfs[len(psfs) // 2],) * len(psfs)
        return self._lights(self.image(direction), direction, streams, position, [psfs], middle)[0]

    def lights(
        self, direction: FloatArray, streams: Streams, position: str
    ) -> tuple[tuple[PointLight, ...], ExpectedImage]:
        """Light of a target behind every filter, and the noiseless image."""
        expected, rows = self.image(direction), self.filter_psfs(direction, self.bench.window_px // 2 + 1)
        by_band = list(zip(*rows, strict=True))
        reference = by_band[self.bench.reference]
        return self._lights(expected, direction, streams, position, by_band, reference), expected

    def _lights(
        self,
        expected: ExpectedImage,
        direction: FloatArray,
        streams: Streams,
        position: str,
        psfs: Sequence[tuple[EffectivePsf, ...]],
        reference: tuple[EffectivePsf, ...],
    ) -> tuple[PointLight, ...]:
        """Detect the points of a rendered target in a readout, cut windows around them."""
        truth = expected.truth
        assert truth is not None
        detected, corner = self._corners(expected, direction, streams, position)
        light = cut_windows(expected.electrons, corner, self.bench.window_px)
        spot_um = np.sqrt(truth.variance_x_px2 + truth.variance_y_px2) * self.instrument.camera.pixel_pitch_mm * 1e3
        return tuple(
            PointLight(
                band=name,
                direction=direction,
                nominal_px=nominal_px(self.instrument, direction),
                bundle_px=np.column_stack([truth.bundle_x_px[:, band], truth.bundle_y_px[:, band]]),
                photon_px=np.column_stack([truth.photon_x_px[:, band], truth.photon_y_px[:, band]]),
                spot_um=spot_um[:, band],
                detected_px=detected,
                corner_px=corner,
                light_e=light[..., band].astype(np.float64),
                psf=psfs[band],
                reference_psf=reference,
            )
            for band, name in enumerate(expected.band)
        )

    def _corners(
        self, expected: ExpectedImage, direction: FloatArray, streams: Streams, position: str
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """Detected positions (j, 2) of the points behind the reference filter, first pixels of windows around them."""
        bench, camera, config = self.bench, self.instrument.camera, self.instrument.config
        where = f"{position} position"
        detected = find_points(
            WindowReader(self.instrument, streams.child("search")),
            expected.electrons[:, :, bench.reference],
            camera.chief_px(*(direction[:, :2] / direction[:, 2:]).T),
            label=expected.band[bench.reference],
            where=where,
            unseen=f"raise signal_e ({bench.signal_e:g} e-), come nearer to focus (instrument.defocus_mm = "
            f"{config.defocus_mm:g} mm), or lower the dark current ({config.exposure_s:g} s at "
            f"{config.chip_temperature_c:g} C)",
            merged=f"raise target.pitch_px ({bench.target.pitch_px:g} px)",
        )
        size = camera.width_px, camera.height_px
        return detected, window_corners(detected, bench.window_px, size, where=where, advice="raise target.edge_px")


def bundle_means(camera: Camera, stars: StarField) -> FloatArray:
    """Mean landing points (n, b, 2) [px] by the renderer's kernel, without an image; rays count by the transmission of
    their paths where the camera has losses."""
    return Tracer(camera, general=True).bundle_means(stars, rings=4, arms=12)


def filter_scene(bench: Bench, instrument: Instrument, *, by_grid: bool = True) -> PointScene:
    """Scene of a bench; ``by_grid`` (`Tracer`) pays where few points are rendered at many positions.

    Vibration within an exposure is a Gaussian blur in addition to charge diffusion.
    """
    camera, (_, within_frame_px2) = instrument.camera, bench.power_px2(instrument)
    camera = replace(camera, charge_diffusion_px=float(np.hypot(camera.charge_diffusion_px, within_frame_px2**0.5)))
    renderer = StarRenderer(camera, exposure_s=instrument.exposure_s, by_grid=by_grid)
    return PointScene(bench, instrument, renderer, epsf_tracer(camera, by_grid=by_grid))


def point_scene(bench: Bench, instrument: Instrument) -> PointScene:
    """Scene of a bench behind its reference filter alone."""
    return filter_scene(one_filter(bench), instrument)


def scene_of(scene: PointScene | None, bench: Bench, instrument: Instrument) -> PointScene:
    """A new scene, or the given one with another bench: other frames, methods and signal on the same target."""
    return point_scene(bench, instrument) if scene is None else replace(scene, bench=one_filter(bench))


def frame_light(light: PointLight, bench: Bench, instrument: Instrument, streams: Streams) -> FloatArray:
    """Light of windows (n, h, w); frame by frame (f, n, h, w) where the line of sight moves.

    The motion adds the difference of the PSF drawn at both positions to the rendered light.
    """
    if bench.collimator is None:
        return light.light_e
    offset = bench.collimator.offsets_px(streams, bench.frames, instrument.exposure_s, instrument.pixel_arcsec)
    if offset is None:
        return light.light_e
    moved_e = np.empty((len(offset), *light.light_e.shape))
    points = zip(light.light_e, light.corner_px, light.bundle_px, light.psf, strict=True)
    for point, (light_e, corner, bundle, psf) in enumerate(points):
        x, y = (bundle - corner + np.concatenate([np.zeros((1, 2)), offset])).T
        rest, *moved = draw_epsf(psf, x, y, light_e.shape)
        moved_e[:, point] = light_e + (np.array(moved) - rest) * (light_e.sum() / rest.sum())
    return np.maximum(moved_e, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PointFrames:
    """Centroids of j points in f frames."""

    position_px: Mapping[str, FloatArray]  # (f, j, 2) By method; NaN where a fit did not converge
    windows: WindowStack  # The readout
    stamps: Stamps  # Windows of the first frame, as centroided
    noise: NoiseModel  # Of the centroiders

    def __post_init__(self) -> None:
        for value in self.position_px.values():
            if value.ndim != 3 or value.shape[2] != 2:
                raise DomainError(f"PointFrames.position_px: shape {value.shape} where (frames, points, 2) is needed")

    def mean_px(self, method: str) -> FloatArray:
        """Mean over the frames (j, 2)."""
        return frame_statistics(self.position_px[method])[0]

    def sigma_px(self, method: str) -> FloatArray:
        """Standard deviation of a single frame (j, 2)."""
        return frame_statistics(self.position_px[method])[1]

    def used(self, method: str) -> NDArray[np.int64]:
        """Frames with a position (j,)."""
        return frame_statistics(self.position_px[method])[2]


def read_points(
    light: PointLight,
    bench: Bench,
    instrument: Instrument,
    *,
    streams: Streams,
    dark_streams: Streams | None = None,
    motion_streams: Streams | None = None,
    label: str = "lamp",
    where: str = "",
    signal_ratio: float = 1.0,
    detector: Detector | None = None,
    subtraction: Subtraction = "dark",
    mask_defects: bool = True,
) -> PointFrames:
    """Read out frames of a target and centroid its points; ``label`` names the random streams of the lamp's frames."""
    reader = WindowReader(instrument if detector is None else replace(instrument, detector=detector), streams)
    light_e = frame_light(light, bench, instrument, streams if motion_streams is None else motion_streams)
    lit = reader.expose(light_e * signal_ratio, light.corner_px, frames=bench.frames, label=label)
    stack = lit if mask_defects else replace(lit, defect=np.zeros_like(lit.defect))
    if subtraction == "dark":
        dark_reader = reader if dark_streams is None else replace(reader, streams=dark_streams)
        dark_e = dark_reader.dark(light.corner_px, bench.window_px, frames=bench.dark_frames)
        stamps, noise = dark_subtracted(stack, dark_e)
    else:
        stamps, noise = ring_subtracted(stack, light.detected_px)
    where = where or f"target points at {bench.signal_e * signal_ratio:g} e- per frame"
    refuse_saturated(stamps, len(light), where=where, advice="lower signal_e or the highest level")
    position = {
        name: measured_positions(centroider, stamps, noise, bench.frames)
        for name, centroider in light.centroiders(bench).items()
    }
    refuse_few_frames(position[bench.methods[0]], bench.methods[0], where=where)
    return PointFrames(position_px=position, windows=stack, stamps=stamps.select(slice(0, len(light))), noise=noise)


def nominal_px(instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Ideal image (j, 2) of unit vectors."""
    camera = instrument.camera
    scale = instrument.focal_length_mm / camera.pixel_pitch_mm
    return camera.centre_px + scale * direction[:, :2] / direction[:, 2:]
