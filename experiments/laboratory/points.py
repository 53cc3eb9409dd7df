"""Point targets measured as the laboratory does it: render, read out, detect, centroid, average over frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from calib.measure.background import estimate_background
from calib.measure.centroid import get_centroider
from calib.measure.detection import detect
from calib.measure.image import sensor_image
from calib.measure.stamps import stamps_from_windows
from calib.records import NoiseModel, Stamps, StarTable
from experiments.laboratory.bench import Bench
from experiments.laboratory.instrument import Instrument
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.detector.readout import expose_windows
from render.engine.random import Streams
from render.records import EffectivePsf, ExpectedImage, StarField, WindowStack
from render.tracing.psf import render_epsf
from render.tracing.tracer import Tracer

__all__ = [
    "SEARCH_MARGIN_PX",
    "PointMeasurement",
    "PointReadout",
    "common_shift",
    "dark_subtracted",
    "nominal_px",
    "pattern_effect",
]


MATCH_PX = 4.0
"""A detection this close to a target point's nominal place is that point."""
SEARCH_MARGIN_PX = 80
"""How far the whole target may be displaced."""
PATTERNS = 48
"""Independent fixed patterns from which their effect on the centroids is predicted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointMeasurement:
    """The target at one place; j points, b filters.

    Attributes
    ----------
    direction : (j, 3)
        Unit vectors in cam.
    nominal_px : (j, 2)
        Where an ideal lens would image the points.
    chief_px, bundle_px, photon_px : (j, b, 2)
        Truth.
    mean_px : dict of str to (j, b, 2)
        Mean centroid over the frames, by method.
    sigma_px : dict of str to (j, b, 2)
        Standard deviation of a single frame's centroid.
    pattern_px : (q, j, b, 2)
        Predicted effect of q fixed patterns on the first method's centroids, common to the filters.
    frames_used : (j, b)
        Frames that converged, first method.
    spot_um : (j, b)
        RMS spot radius of the traced bundles.
    windows : tuple of WindowStack
        Readout, per filter.
    """

    direction: FloatArray
    nominal_px: FloatArray
    chief_px: FloatArray
    bundle_px: FloatArray
    photon_px: FloatArray
    mean_px: Mapping[str, FloatArray]
    sigma_px: Mapping[str, FloatArray]
    pattern_px: FloatArray
    frames_used: NDArray[np.int64]
    spot_um: FloatArray
    windows: tuple[WindowStack, ...]


@dataclass(frozen=True, slots=True)
class PointReadout:
    """Readout and reduction of a point target at one place of the field.

    Attributes
    ----------
    tracer : Tracer
        Traces the PSFs (`render.tracing.psf.epsf_tracer`).
    bench, instrument
        The laboratory.
    streams : Streams
        Noise of this place.
    place : str
        What error messages call the place, e.g. "upper left".
    """

    tracer: Tracer
    bench: Bench
    instrument: Instrument
    streams: Streams
    place: str

    def measure(self, stars: StarField, expected: ExpectedImage) -> PointMeasurement:
        """Read out and reduce all filters.

        Parameters
        ----------
        stars : StarField
            The points' light (`experiments.laboratory.bench.point_field`).
        expected : ExpectedImage
            Its noiseless image, with truth.

        Raises
        ------
        DomainError
            If points are not detected, run into each other, are saturated, or leave the detector.
        """
        bench, camera, truth = self.bench, self.instrument.camera, expected.truth
        assert truth is not None
        nominal = nominal_px(self.instrument, stars.direction)
        found = self.find(expected, nominal)
        corner = self.corners(found)
        index = np.arange(bench.window_px)
        rows, columns = corner[:, 1, None, None] + index[:, None], corner[:, 0, None, None] + index
        light = np.moveaxis(expected.electrons[rows, columns], -1, 0)
        dark = self.expose(np.zeros_like(light[0]), corner, bench.dark_frames, "dark")
        dark_e = dark.dn.mean(0) / dark.gain_dn_per_e
        epsf = render_epsf(self.tracer, stars, half_size_px=bench.window_px // 2 + 1)
        stacks = tuple(self.expose(light[band], corner, bench.frames, name) for band, name in enumerate(stars.band))
        results = []
        for band, stack in enumerate(stacks):
            stamps, noise = dark_subtracted(stack, dark_e, found)
            self._refuse_saturated(stamps, stars.band[band])
            psfs = {"epsf": [row[band] for row in epsf], "epsf_reference": [row[bench.reference] for row in epsf]}
            results.append(self._centroids(stamps, noise, light[band].astype(float), psfs))
        return PointMeasurement(
            direction=stars.direction,
            nominal_px=nominal,
            chief_px=np.stack([truth.chief_x_px, truth.chief_y_px], axis=-1),
            bundle_px=np.stack([truth.bundle_x_px, truth.bundle_y_px], axis=-1),
            photon_px=np.stack([truth.photon_x_px, truth.photon_y_px], axis=-1),
            mean_px={m: np.stack([one[0][m] for one in results], axis=1) for m in bench.methods},
            sigma_px={m: np.stack([one[1][m] for one in results], axis=1) for m in bench.methods},
            frames_used=np.stack([one[2] for one in results], axis=1),
            pattern_px=np.stack([one[3] for one in results], axis=2),
            spot_um=np.sqrt(truth.variance_x_px2 + truth.variance_y_px2) * camera.pixel_pitch_mm * 1e3,
            windows=stacks,
        )

    def expose(self, stamps_e: NDArray[Any], corner: NDArray[np.int64], frames: int, band: str) -> WindowStack:
        """Windowed readout, conditions as the instrument is set; ``band`` labels the streams."""
        return expose_windows(
            stamps_e,
            corner,
            self.instrument.detector,
            streams=self.streams,
            frames=frames,
            exposure_s=self.instrument.config.exposure_s,
            temperature_c=self.instrument.config.chip_temperature_c,
            band=band,
        )

    def corners(self, found: FloatArray) -> NDArray[np.int64]:
        """First pixels (j, 2) of the windows around the points."""
        camera, size = self.instrument.camera, self.bench.window_px
        corner = np.rint(found).astype(np.int64) - size // 2
        if corner.min() < 0 or np.any(corner.max(0) + size > (camera.width_px, camera.height_px)):
            raise DomainError(
                f"a window of {size} px at the {self.place} position leaves the detector; raise target.edge_px"
            )
        return corner

    def _refuse_saturated(self, stamps: Stamps, band: str) -> None:
        if has_flag(stamps.flags, StarFlag.SATURATED).any():
            raise DomainError(
                f"target points are saturated behind filter {band} at the {self.place} position; lower signal_e "
                f"({self.bench.signal_e:g} e-)"
            )

    def _centroids(
        self, stamps: Stamps, noise: NoiseModel, light_e: FloatArray, psfs: Mapping[str, Sequence[EffectivePsf]]
    ) -> tuple[dict[str, FloatArray], dict[str, FloatArray], NDArray[np.int64], FloatArray]:
        """Mean and scatter by method; usable frames and effect of fixed patterns for the first method."""
        bench = self.bench
        centroiders = {
            m: get_centroider("epsf", epsf=psfs[m]) if m in psfs else get_centroider(m) for m in bench.methods
        }
        averages = {m: _average(c.measure(stamps, noise), bench.frames) for m, c in centroiders.items()}
        fewest = int(averages[bench.methods[0]][2].min())
        if fewest < 2:
            raise DomainError(
                f"centroider {bench.methods[0]!r} gives {fewest} usable frames of {bench.frames} for a target point at "
                f"the {self.place} position; at least 2 are needed: raise signal_e or frames, or take another centroid"
            )
        pixel = self.instrument.pixel_noise()
        pattern = pattern_effect(
            centroiders[bench.methods[0]],
            stamps,
            noise,
            light_e,
            prnu=pixel.prnu,
            dark_e=float(np.sqrt(pixel.floor_e2 / bench.dark_frames)),
            rng=self.streams.generator("predicted pattern"),  # the same patterns for every filter
        )
        mean, sigma = {m: a[0] for m, a in averages.items()}, {m: a[1] for m, a in averages.items()}
        return mean, sigma, averages[bench.methods[0]][2], pattern

    def find(self, expected: ExpectedImage, nominal: FloatArray) -> FloatArray:
        """Detected places (j, 2) of the points in one readout of the target's surroundings, reference filter."""
        reference, place = self.bench.reference, self.place
        height, width, _ = expected.electrons.shape
        low = np.maximum(np.floor(nominal.min(0)).astype(np.int64) - SEARCH_MARGIN_PX, 0)
        high = np.minimum(np.ceil(nominal.max(0)).astype(np.int64) + SEARCH_MARGIN_PX + 1, [width, height])
        region = expected.electrons[low[1] : high[1], low[0] : high[0], reference]
        search = replace(self, streams=self.streams.child("search"))
        stack = search.expose(region[None], low[None], 1, expected.band[reference])
        image = sensor_image(
            stack.dn[0, 0],
            gain_dn_per_e=stack.gain_dn_per_e,
            offset_dn=stack.offset_dn,
            read_noise_e=stack.read_noise_e,
            defect=stack.defect[0],
            source=f"target {place}",
        )
        table = detect(image, estimate_background(image))
        if not len(table):
            raise self._unseen("no target point was detected")
        position = np.column_stack([table.x_px, table.y_px]) + low
        # the lens may displace the whole image (a moved element): estimate that first, then look close by
        offset = position[:, None] - nominal[None]
        common = common_shift(offset.reshape(-1, 2))
        distance = np.linalg.norm(offset - common, axis=2)
        nearest = distance.argmin(0)
        missing = distance[nearest, np.arange(len(nominal))] > MATCH_PX
        if missing.any():
            raise self._unseen(f"target points not detected: {int(missing.sum())} of {len(nominal)}")
        if len(np.unique(nearest)) < len(nearest):
            raise DomainError(
                f"target points at the {place} position run into each other: two of them are one detection; raise "
                f"target.pitch_px ({self.bench.target.pitch_px:g} px)"
            )
        return position[nearest]

    def _unseen(self, what: str) -> DomainError:
        set_up = self.instrument.config
        return DomainError(
            f"{what} at the {self.place} position; raise signal_e ({self.bench.signal_e:g} e-), come nearer to focus "
            f"(instrument.defocus_mm = {set_up.defocus_mm:g} mm), or lower the dark current "
            f"({set_up.exposure_s:g} s at {set_up.chip_temperature_c:g} C)"
        )


def common_shift(offset: FloatArray) -> FloatArray:
    """The displacement (2,) that most (detection, point) pairs agree on."""
    near = offset[np.linalg.norm(offset, axis=1) < SEARCH_MARGIN_PX + MATCH_PX]
    if not len(near):
        return np.zeros(2)
    votes = (np.linalg.norm(near[:, None] - near[None], axis=2) < MATCH_PX).sum(1)
    centre = near[votes.argmax()]
    return np.asarray(np.median(near[np.linalg.norm(near - centre, axis=1) < MATCH_PX], axis=0))


def nominal_px(instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Ideal image (j, 2) of unit vectors."""
    camera = instrument.camera
    scale = instrument.focal_length_mm / camera.pixel_pitch_mm
    return camera.centre_px + scale * direction[:, :2] / direction[:, 2:]


def dark_subtracted(stack: WindowStack, dark_e: FloatArray, start_px: FloatArray) -> tuple[Stamps, NoiseModel]:
    """Stamps of a readout minus the mean dark frame; with the lamp off there is no light, so no background is left.

    Centroiders start at the centre of gravity of the mean frame: the tail of a spot draws it away from the detection.
    """
    stamps, noise = stamps_from_windows(stack, background_e=0.0, start_px=start_px)
    pedestal = dark_e - noise.offset_dn / noise.gain_dn_per_e
    frames, points, height, width = stack.dn.shape
    electrons = np.where(stamps.valid, stamps.electrons - np.tile(pedestal, (frames, 1, 1)), 0.0)
    light = np.maximum(electrons.reshape(frames, points, height, width).mean(0), 0.0)
    light /= np.maximum(light.sum((1, 2), keepdims=True), 1e-300)
    gravity = np.column_stack([light.sum(1) @ np.arange(width), light.sum(2) @ np.arange(height)])
    return replace(
        stamps,
        electrons=electrons,
        start_px=np.tile(stack.corner_px + gravity, (frames, 1)),
        psf_index=np.tile(np.arange(points), frames),
    ), noise


def _average(table: StarTable, frames: int) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Mean (j, 2), single-frame standard deviation (j, 2) and number of good frames (j,) of each point.

    Mean and standard deviation are NaN where fewer than two frames are good.
    """
    position = np.stack([table.x_px, table.y_px], axis=-1).reshape(frames, -1, 2)
    bad = has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA).reshape(frames, -1)
    position = np.where(bad[..., None], np.nan, position)
    count = (~bad).sum(0)
    enough = (count >= 2)[:, None]
    filled = np.where(enough, position, 0.0)
    mean, sigma = np.nanmean(filled, axis=0), np.nanstd(filled, axis=0, ddof=1)
    return np.where(enough, mean, np.nan), np.where(enough, sigma, np.nan), count


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
