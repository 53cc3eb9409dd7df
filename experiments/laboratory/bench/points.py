"""Point targets behind several filters, measured as in the laboratory: read out, detect, centroid, average."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid import Centroider
from calib.measure.frame_positions import frame_statistics, measured_positions
from calib.measure.linear_response import centroid_variance, linear_response, tight
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench.centroid_methods import method_centroiders
from experiments.laboratory.bench.point_bench import Bench, refuse_few_frames
from experiments.laboratory.bench.readout.search import find_points
from experiments.laboratory.bench.readout.stamps import dark_subtracted, refuse_saturated
from experiments.laboratory.bench.readout.windows import WindowReader, cut_windows, window_corners
from experiments.laboratory.bench.target_light import TargetLight, frame_light
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import ExpectedImage, WindowStack
from render.sensor_file.instrument import Instrument

PATTERNS = 48
"""Independent fixed patterns from which their effect on the centroids is predicted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointMeasurement:
    """The target at one place; j points, b filters."""

    direction: FloatArray  # (j, 3) Unit vectors in cam
    nominal_px: FloatArray  # (j, 2) Where an ideal lens would image the points
    photon_px: FloatArray  # (j, b, 2) Truth: mean of all light, in the window or beyond
    pixels_px: FloatArray  # (j, b, 2) First moment of the noiseless pixels of the window, as rendered
    mean_px: Mapping[str, FloatArray]  # (j, b, 2) Mean centroid over the frames, by method
    sigma_px: Mapping[str, FloatArray]  # (j, b, 2) Standard deviation of a single frame's centroid
    # (j, b, 2) The same as predicted by linear response, first method; without what moves all points alike
    noise_px: FloatArray
    # (q, j, b, 2) Predicted effect of q fixed patterns on the centroids, common to the filters, by method
    pattern_px: Mapping[str, FloatArray]
    frames_used: NDArray[np.int64]  # (j, b) Frames that converged, first method
    spot_um: FloatArray  # (j, b) RMS spot radius of the traced bundles
    windows: tuple[WindowStack, ...]  # Readout, per filter


@dataclass(frozen=True, slots=True)
class PointReadout:
    """Readout and reduction of a point target at one place of the field."""

    bench: Bench  # The laboratory
    instrument: Instrument
    streams: Streams  # Noise of this place
    place: str  # What error messages call the place, e.g. "upper left"
    # Methods for which the effect of fixed patterns is predicted; none given: the first of the bench
    patterns: Sequence[str] = ()

    def corners(self, expected: ExpectedImage, direction: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Detected places (j, 2) of the points behind the reference filter, and first pixels of windows around them."""
        bench, camera, set_up = self.bench, self.instrument.camera, self.instrument.config
        found = find_points(
            WindowReader(self.instrument, self.streams.child("search")),
            expected.electrons[:, :, bench.reference],
            camera.chief_px(*(direction[:, :2] / direction[:, 2:]).T),
            label=expected.band[bench.reference],
            where=f"{self.place} position",
            unseen=f"raise signal_e ({bench.signal_e:g} e-), come nearer to focus (instrument.defocus_mm = "
            f"{set_up.defocus_mm:g} mm), or lower the dark current ({set_up.exposure_s:g} s at "
            f"{set_up.chip_temperature_c:g} C)",
            merged=f"raise target.pitch_px ({bench.target.pitch_px:g} px)",
        )
        size = camera.width_px, camera.height_px
        where = f"{self.place} position"
        return found, window_corners(found, bench.window_px, size, where=where, advice="raise target.edge_px")

    def measure(self, target: TargetLight, direction: FloatArray) -> tuple[PointMeasurement, ExpectedImage]:
        """Render, read out and reduce all filters; the noiseless image too."""
        bench, camera, expected = self.bench, self.instrument.camera, target.image(direction)
        truth = expected.truth
        assert truth is not None
        nominal = nominal_px(self.instrument, direction)
        _, corner = self.corners(expected, direction)
        light = np.moveaxis(cut_windows(expected.electrons, corner, bench.window_px), -1, 0)
        reader = WindowReader(self.instrument, self.streams)
        dark_e = reader.dark(corner, bench.window_px, frames=bench.dark_frames)
        epsf = target.psfs(direction, bench.window_px // 2 + 1)
        bundle = np.stack([truth.bundle_x_px, truth.bundle_y_px], axis=-1)
        stacks, results = [], []
        for band, name in enumerate(expected.band):
            own, reference = ([row[k] for row in epsf] for k in (band, bench.reference))
            lit = frame_light(
                light[band], corner, bundle[:, band], own, bench, self.instrument, self.streams.child(name)
            )
            stack = reader.expose(lit, corner, frames=bench.frames, label=name)
            stamps, noise = dark_subtracted(stack, dark_e)
            advice = f"lower signal_e ({bench.signal_e:g} e-)"
            refuse_saturated(stamps, len(corner), where=f"{self.place} position, filter {name}", advice=advice)
            chosen = method_centroiders(bench.methods, own=own, reference=reference, measured=bench.epsf)
            results.append(self._centroids(stamps, noise, light[band].astype(float), chosen))
            stacks.append(stack)
        found = PointMeasurement(
            direction=direction,
            nominal_px=nominal,
            photon_px=np.stack([truth.photon_x_px, truth.photon_y_px], axis=-1),
            pixels_px=first_moment_px(light, corner),
            mean_px={m: np.stack([one[0][m] for one in results], axis=1) for m in bench.methods},
            sigma_px={m: np.stack([one[1][m] for one in results], axis=1) for m in bench.methods},
            frames_used=np.stack([one[2] for one in results], axis=1),
            pattern_px={m: np.stack([one[3][m] for one in results], axis=2) for m in results[0][3]},
            noise_px=np.stack([one[4] for one in results], axis=1),
            spot_um=np.sqrt(truth.variance_x_px2 + truth.variance_y_px2) * camera.pixel_pitch_mm * 1e3,
            windows=tuple(stacks),
        )
        return found, expected

    def _centroids(
        self, stamps: Stamps, noise: NoiseModel, light_e: FloatArray, centroiders: Mapping[str, Centroider]
    ) -> tuple[dict[str, FloatArray], dict[str, FloatArray], NDArray[np.int64], dict[str, FloatArray], FloatArray]:
        """Mean and scatter by method; usable frames of the first; effect of patterns by method; noise of the first."""
        bench, first = self.bench, self.bench.methods[0]
        position = {m: measured_positions(c, stamps, noise, bench.frames) for m, c in centroiders.items()}
        refuse_few_frames(position[first], first, where=f"{self.place} position")
        statistics = {m: frame_statistics(p) for m, p in position.items()}
        pixel = self.instrument.pixel_noise()
        dark_e = float(np.sqrt(pixel.floor_e2 / bench.dark_frames))
        pattern = {
            m: pattern_effect(
                centroiders[m],
                stamps,
                noise,
                light_e,
                prnu=pixel.prnu,
                dark_e=dark_e,
                rng=self.streams.generator("predicted pattern"),  # the same patterns for every filter
            )
            for m in self.patterns or (first,)
        }
        mean, sigma = {m: one[0] for m, one in statistics.items()}, {m: one[1] for m, one in statistics.items()}
        gain = linear_response(tight(centroiders[first]), stamps.select(slice(0, len(light_e))), noise, light_e)
        spread = np.sqrt(centroid_variance(gain, pixel.temporal_e2(light_e)))
        return mean, sigma, statistics[first][2], pattern, spread


def first_moment_px(light_e: FloatArray, corner_px: NDArray[np.int64]) -> FloatArray:
    """First moment (j, b, 2) of windows (b, j, s, s) whose first pixels are known (j, 2)."""
    light, pixel = np.asarray(light_e, float), np.arange(light_e.shape[-1])
    sums = np.stack([light.sum(2) @ pixel, light.sum(3) @ pixel], axis=-1) / light.sum((2, 3))[..., None]
    return np.asarray(np.swapaxes(sums, 0, 1) + corner_px[:, None])


def nominal_px(instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Ideal image (j, 2) of unit vectors."""
    camera = instrument.camera
    scale = instrument.focal_length_mm / camera.pixel_pitch_mm
    return camera.centre_px + scale * direction[:, :2] / direction[:, 2:]


def pattern_effect(
    centroider: Any,
    stamps: Stamps,
    noise: NoiseModel,
    expected_e: FloatArray,
    *,
    prnu: float,
    dark_e: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Centroid shifts (q, j, 2) by response patterns and dark-frame noise of the stated size, on noiseless windows."""
    count = len(expected_e)
    response = 1.0 + prnu * rng.standard_normal((PATTERNS, *expected_e.shape))
    offset = dark_e * rng.standard_normal(response.shape)
    disturbed = np.concatenate([expected_e[None], expected_e * response + offset]).reshape(-1, *expected_e.shape[1:])
    rows = np.tile(np.arange(count), PATTERNS + 1)
    one = stamps.select(rows)
    table = centroider.measure(replace(one, electrons=disturbed, valid=np.ones(disturbed.shape, bool)), noise)
    place = np.stack([table.x_px, table.y_px], axis=-1).reshape(PATTERNS + 1, count, 2)
    return place[1:] - place[0]
