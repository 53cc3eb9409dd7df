"""An effective PSF built from frames of the point target, and its prediction without frames.

As in a laboratory before its tests: the target is at one place of the field, the platform steps the image to other
fractions of a pixel, and the frames of each position are summed. The resulting PSF is the mean over the target, with
the noise of those frames and the response pattern of those pixels, and is used over the whole field.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid_error.expected_windows import ExpectedWindows
from calib.measure.epsf.build import build_epsf
from calib.measure.reduced_windows import dark_subtracted
from calib.measure.stamps import centre_of_gravity
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench.point_bench import Bench, one_filter
from experiments.laboratory.bench.points import PointScene, frame_light
from experiments.laboratory.bench.ray_prediction import target_windows
from experiments.laboratory.bench.readout.windows import WindowReader
from experiments.laboratory.devices.hexapod import step_path, turned
from experiments.laboratory.settings.tables import HexapodConfig, StepConfig
from experiments.laboratory.temporal_error import star_target_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument
from render.tracing.psf import blurred

POSITIONS, STAMPS = 5, 20
"""Steps of a fifth of a pixel cover it along both axes; a PSF of four samples per pixel needs 16 stars at least."""


def epsf_session(bench: Bench) -> StepConfig:
    """Positions of the session: more of them where the target has few points."""
    points = bench.target.rows * bench.target.columns
    return StepConfig(positions=max(POSITIONS, -(-STAMPS // points)), step_px=1.0 / POSITIONS, direction_deg=45.0)


def measured_epsf(
    bench: Bench,
    instrument: Instrument,
    hexapod: HexapodConfig,
    *,
    psf: Sequence[EffectivePsf],
    streams: Streams,
    scene: PointScene,
    advance: Callable[[], None] = lambda: None,
) -> EffectivePsf:
    """Effective PSF from frames of the target in the middle of the first chip."""
    path = step_path(hexapod, epsf_session(bench), instrument.pixel_arcsec, streams.generator("hexapod"))
    positions = []
    for number, direction in enumerate(turned(star_target_directions(bench, instrument), path.true_rad)):
        position_streams = streams.child("position", number)
        light = scene.light(direction, position_streams, f"ePSF, position {number + 1}", psf=psf)
        reader = WindowReader(instrument, position_streams)
        light_e = frame_light(light, bench, instrument, position_streams)
        stack = reader.expose(light_e, light.corner_px, frames=bench.frames, label="lamp")
        dark_e = reader.dark(light.corner_px, bench.window_px, frames=bench.dark_frames)
        stamps, _ = dark_subtracted(stack, dark_e)
        summed_e = stamps.electrons.reshape(bench.frames, *light.light_e.shape).sum(0)
        positions.append((summed_e, ~stack.defect, light.corner_px))
        advance()
    electrons, valid, corner = (np.concatenate(windows) for windows in zip(*positions, strict=True))
    return _fitted_epsf(electrons, valid, corner, bench, instrument)


def predicted_epsfs(
    bench: Bench, instrument: Instrument, psf: Sequence[EffectivePsf], *, seed: int, sessions: int = 1
) -> tuple[EffectivePsf, ...]:
    """`measured_epsf` of several sessions without frames: traced PSFs and positions, noise and response drawn.

    The image moves by less than a pixel: the response of a pixel is the same at all positions and does not average out.
    """
    rng, pixel, frames = Streams(seed).generator("predicted ePSF"), instrument.pixel_noise(), bench.frames
    ideal = HexapodConfig(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)
    path = step_path(ideal, epsf_session(bench), instrument.pixel_arcsec, rng)
    direction = turned(star_target_directions(bench, instrument), path.commanded_rad)
    frame_to_frame_px2, _ = bench.power_px2(instrument)
    if frame_to_frame_px2:  # blurs the sum of frames
        psf = [blurred(point_psf, frame_to_frame_px2) for point_psf in psf]
    windows = target_windows(one_filter(bench), instrument, direction, psf)
    sigma_e = np.sqrt(pixel.temporal_e2(windows.light_e, frames=frames, dark_frames=bench.dark_frames))
    epsfs = []
    for _ in range(sessions):
        light_e = windows.light_e * (1.0 + pixel.prnu * _chip_deviates(windows, len(path.commanded_rad), rng))
        summed_e = frames * (light_e + sigma_e * rng.standard_normal(light_e.shape))
        epsfs.append(_fitted_epsf(summed_e, windows.valid, windows.corner_px, bench, instrument))
    return tuple(epsfs)


def _chip_deviates(windows: ExpectedWindows, positions: int, rng: np.random.Generator) -> FloatArray:
    """A normal deviate for every pixel of the chip, in the windows (n, h, w) of every position of the same points."""
    corner = windows.corner_px.reshape(positions, -1, 2)
    _, height, width = windows.light_e.shape
    first = corner.min(0)
    extent = (corner - first).max((0, 1))
    chip = rng.standard_normal((corner.shape[1], height + int(extent[1]), width + int(extent[0])))
    return np.stack(
        [chip[star, y : y + height, x : x + width] for offset in corner - first for star, (x, y) in enumerate(offset)]
    )


def _fitted_epsf(
    electrons: FloatArray,
    valid: NDArray[np.bool_],
    corner: NDArray[np.int64],
    bench: Bench,
    instrument: Instrument,
) -> EffectivePsf:
    """PSF from sums of frames (n, h, w), usable pixels and first pixels, position after position."""
    points = bench.target.rows * bench.target.columns
    electrons, positions = np.where(valid, electrons, 0.0), len(electrons) // points
    stamps = Stamps(
        electrons=electrons,
        valid=valid,
        corner_px=corner,
        background_e=np.zeros(len(electrons)),
        start_px=corner + centre_of_gravity(electrons),
        flags=np.zeros(len(electrons), np.uint32),
        psf_index=np.zeros(len(electrons), np.int64),
    )
    # of the sum of N frames less N times the mean dark frame; the sum of the photons is a Poisson variate again
    floor_e2 = instrument.pixel_noise().floor_e2 * bench.frames * (1.0 + bench.frames / bench.dark_frames)
    star, position = np.tile(np.arange(points), positions), np.repeat(np.arange(positions), points)
    noise = NoiseModel(read_noise_e=float(np.sqrt(floor_e2)))
    return build_epsf(stamps, noise, star_index=star, frame_index=position).epsf
