"""One effective PSF built from frames of the point target, and its prediction without frames.

As in a laboratory before its tests: the target is at one place of the field, the platform steps the image to other
fractions of a pixel, and the frames of each position are averaged. The resulting PSF is the mean over the target, with
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
from experiments.laboratory.temporal_error import target_place
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
    parts = []
    for number, direction in enumerate(turned(target_place(bench, instrument), path.true_rad)):
        here = streams.child("position", number)
        light = scene.light(direction, here, f"ePSF, position {number + 1}", psf=psf)
        reader = WindowReader(instrument, here)
        light_e = frame_light(light, bench, instrument, here)
        stack = reader.expose(light_e, light.corner_px, frames=bench.frames, label="lamp")
        dark_e = reader.dark(light.corner_px, bench.window_px, frames=bench.dark_frames)
        stamps, _ = dark_subtracted(stack, dark_e)
        added = stamps.electrons.reshape(bench.frames, *light.light_e.shape).sum(0)
        parts.append((added, ~stack.defect, light.corner_px))
        advance()
    electrons, valid, corner = (np.concatenate(one) for one in zip(*parts, strict=True))
    return _built(electrons, valid, corner, bench, instrument)


def predicted_epsfs(
    bench: Bench, instrument: Instrument, psf: Sequence[EffectivePsf], *, seed: int, sessions: int = 1
) -> tuple[EffectivePsf, ...]:
    """The same without frames, for several sessions: PSFs and traced places, noise and response drawn with NumPy.

    The image moves by less than a pixel: the response of a pixel is the same at all positions and does not average out.
    """
    rng, noise, frames = Streams(seed).generator("predicted ePSF"), instrument.pixel_noise(), bench.frames
    ideal = HexapodConfig(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)
    path = step_path(ideal, epsf_session(bench), instrument.pixel_arcsec, rng)
    direction = turned(target_place(bench, instrument), path.commanded_rad)
    between = bench.power_px2(instrument)[0]
    if between:  # the sum of frames is blurred by what moves from frame to frame too
        psf = [blurred(one, between) for one in psf]
    windows = target_windows(one_filter(bench), instrument, direction, psf)
    spread = np.sqrt(noise.temporal_e2(windows.light_e, frames=frames, dark_frames=bench.dark_frames))
    found = []
    for _ in range(sessions):
        light = windows.light_e * (1.0 + noise.prnu * _pixels(windows, len(path.commanded_rad), rng))
        added = frames * (light + spread * rng.standard_normal(light.shape))
        found.append(_built(added, windows.valid, windows.corner_px, bench, instrument))
    return tuple(found)


def _pixels(windows: ExpectedWindows, positions: int, rng: np.random.Generator) -> FloatArray:
    """A normal deviate for every pixel of the chip, in the windows (n, h, w) of every position of the same points."""
    corner = windows.corner_px.reshape(positions, -1, 2)
    _, height, width = windows.light_e.shape
    first = corner.min(0)
    extent = (corner - first).max((0, 1))
    chip = rng.standard_normal((corner.shape[1], height + int(extent[1]), width + int(extent[0])))
    parts = [chip[star, y : y + height, x : x + width] for place in corner - first for star, (x, y) in enumerate(place)]
    return np.stack(parts)


def _built(
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
    # the sum of N frames and N mean dark frames; its photons are a Poisson variate as those of one frame are
    floor_e2 = instrument.pixel_noise().floor_e2 * bench.frames * (1.0 + bench.frames / bench.dark_frames)
    star, position = np.tile(np.arange(points), positions), np.repeat(np.arange(positions), points)
    noise = NoiseModel(read_noise_e=float(np.sqrt(floor_e2)))
    return build_epsf(stamps, noise, star_index=star, frame_index=position).epsf
