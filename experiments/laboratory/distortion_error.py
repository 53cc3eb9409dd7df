"""Distortion error (ACC18 section 1.4.2) measured: a surveyed grid target, frames, residuals, polynomial, map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.point_frames import read_points
from experiments.laboratory.bench.point_scene import PointLight, PointScene, one_filter, scene_of
from experiments.laboratory.bench.points import nominal_px
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from experiments.laboratory.devices.targets import GridTarget, grid_directions, survey
from experiments.laboratory.distortion_statistics import (
    DistortionStatistics,
    Reference,
    camera_terms,
    distortion_statistics,
    fit_camera,
    left_out,
    polynomial_terms,
    without_pointing,
)
from optics.arrays import FloatArray
from optics.records import freeze_all
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

SESSIONS = ("earlier", "test")
"""The camera model of "calibrated" comes from the earlier session."""


def camera_place(instrument: Instrument, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nominal pixels (n, 2) of directions (n, 3), and the same from the middle in units of half the diagonal."""
    camera = instrument.camera
    nominal = nominal_px(instrument, direction)
    return nominal, (nominal - camera.centre_px) / (0.5 * np.hypot(camera.width_px, camera.height_px))


def residual_px(
    instrument: Instrument,
    surveyed: FloatArray,
    earlier_px: FloatArray,
    test_px: FloatArray,
    reference: Reference,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eq. 19-20: places (n, 2), residuals (n, 2) of a session, coefficients of the camera behind the coordinates."""
    nominal, place = camera_place(instrument, surveyed)
    return place, *grid_residual_px(nominal, place, earlier_px, test_px, reference)


def grid_residual_px(
    nominal_px: FloatArray,
    place: FloatArray,
    earlier_px: FloatArray,
    test_px: FloatArray,
    reference: Reference,
) -> tuple[FloatArray, FloatArray]:
    """Eq. 19-20 from nominal coordinates (n, 2) alone: residuals (n, 2), and coefficients of the camera behind them.

    Parameters as of `residual_px`; ``place`` (n, 2) are the coordinates in units of order 1.
    """
    offset = (earlier_px if reference == "calibrated" else test_px) - nominal_px
    coefficient = fit_camera(place, offset, reference)
    return test_px - nominal_px - camera_terms(place, reference) @ coefficient, coefficient


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionMeasurement:
    """Frames of a grid target of n points, reduced."""

    instrument: Instrument  # The camera
    order: int  # Of the polynomial
    frames: int  # N of each session
    direction: FloatArray  # (n, 3) True directions of the points
    surveyed: FloatArray  # (q, n, 3) As measured beforehand, by q surveys; the first is the one that counts
    session_px: Mapping[str, FloatArray]  # (2, n, 2) Mean centroids of `SESSIONS` by method
    sigma_px: Mapping[str, FloatArray]  # (n, 2) Standard deviation of a single frame's centroid
    light: PointLight  # The target as rendered, with truth

    def __post_init__(self) -> None:
        freeze_all(self, direction=("n", 3), surveyed=("q", "n", 3))

    @property
    def arcsec_3sigma(self) -> float:
        """Factor from px, 1 sigma, to arcsec, 3 sigma."""
        return 3.0 * self.instrument.pixel_arcsec

    def _residual(self, method: str, reference: Reference, copy: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        earlier, test = self.session_px[method]
        return residual_px(self.instrument, self.surveyed[copy], earlier, test, reference)

    def statistics(self, method: str, reference: Reference, copy: int = 0) -> DistortionStatistics:
        """The document's numbers with one survey of the target."""
        place, d, _ = self._residual(method, reference, copy)
        return distortion_statistics(place, d, self.order)

    def left_out_px(self, method: str, reference: Reference) -> FloatArray:
        """RMS error (2, 2) per axis at points left out, and at rows or columns left out, of the first survey."""
        nominal, place = camera_place(self.instrument, self.surveyed[0])
        return left_out(place, self.session_px[method][1] - nominal, self.order, reference)

    def over_surveys(self, method: str, reference: Reference) -> FloatArray:
        """sigma_d, sigma_Dd and sigma_C1 (q, 3, 2) [px] of every survey: the same frames, another total station."""
        every = (self.statistics(method, reference, copy) for copy in range(len(self.surveyed)))
        return np.stack([np.stack([s.sigma_d_px, s.sigma_left_px, s.sigma_c1_px]) for s in every])

    def correction(self, method: str, reference: Reference, copy: int = 0) -> tuple[FloatArray, FloatArray]:
        """Coefficients of camera (k,) and polynomial (l, 2) that the calibration hands to the user."""
        place, d, camera = self._residual(method, reference, copy)
        return camera, distortion_statistics(place, d, self.order).coefficient_px


@dataclass(frozen=True, slots=True, kw_only=True)
class DenseMap:
    """True errors of a correction over the whole detector; m grid points, shift and roll taken out."""

    nominal_px: FloatArray  # (m, 2) Grid on the detector
    shape: tuple[int, int]  # Rows and columns of the grid
    uncorrected_px: FloatArray  # (m, 2) Distortion: traced minus the best shift, roll and scale
    corrected_px: FloatArray  # (m, 2) Traced minus camera and polynomial

    @property
    def rms_px(self) -> FloatArray:
        """RMS error (2,) per axis that is left after the correction."""
        return np.asarray(np.sqrt((self.corrected_px**2).mean(0)))

    @property
    def uncorrected_rms_px(self) -> FloatArray:
        """RMS distortion (2,)."""
        return np.asarray(np.sqrt((self.uncorrected_px**2).mean(0)))


def dense_grid(instrument: Instrument, rows: int, columns: int) -> FloatArray:
    """Unit vectors (rows * columns, 3) in cam that an ideal lens images on a grid over the whole detector."""
    camera = instrument.camera
    x, y = np.meshgrid(np.linspace(0, camera.width_px - 1, columns), np.linspace(0, camera.height_px - 1, rows))
    # ideal corners lie just beyond the field of the lens; the chief ray there is the same smooth function
    return camera.nominal_direction(x, y, instrument.focal_length_mm).reshape(-1, 3)


def dense_map(
    instrument: Instrument,
    camera: FloatArray,
    polynomial: FloatArray,
    *,
    reference: Reference,
    order: int,
    grid: tuple[int, int],
    traced_px: FloatArray,
) -> DenseMap:
    """Residuals of traced bundles (m, 2) after a correction on a dense grid (ACC18 Fig. 8: at the target points)."""
    nominal, place = camera_place(instrument, dense_grid(instrument, *grid))
    found = traced_px - nominal
    aligned = camera_terms(place, "aligned") @ fit_camera(place, found, "aligned")
    left = found - camera_terms(place, reference) @ camera - polynomial_terms(place, order) @ polynomial
    return DenseMap(
        nominal_px=nominal,
        shape=grid,
        uncorrected_px=found - aligned,
        corrected_px=without_pointing(place, left),
    )


def traced_bundles(bench: Bench, instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Photon-weighted bundle means (n, 2) [px] through the bench's reference filter, by the NumPy trace."""
    one = one_filter(bench)
    parts = [
        bundle_prediction(one, instrument, part[None])[0, :, 0]
        for part in np.array_split(direction, -(-len(direction) // 64))
    ]
    return np.concatenate(parts)


def measure_distortion(
    bench: Bench,
    instrument: Instrument,
    target: GridTarget,
    *,
    order: int = 3,
    surveys: int = 1,
    streams: Streams,
    scene: PointScene | None = None,
    advance: Callable[[], None] = lambda: None,
) -> DistortionMeasurement:
    """Frames of a static grid target in two sessions (`SESSIONS`)."""
    scene = scene_of(scene, bench, instrument)
    bench = scene.bench
    direction = grid_directions(target, instrument, streams.generator("target"))
    light = scene.light(direction, streams, "grid")
    sessions: dict[str, list[FloatArray]] = {m: [] for m in bench.methods}
    sigma: dict[str, FloatArray] = {}
    for session in SESSIONS:
        frames = read_points(light, bench, instrument, streams=streams.child(session))
        for method in bench.methods:
            sessions[method].append(frames.mean_px(method))
            sigma[method] = frames.sigma_px(method)
        advance()
    return DistortionMeasurement(
        instrument=instrument,
        order=order,
        frames=bench.frames,
        direction=direction,
        surveyed=survey(target, direction, streams.generator("survey"), copies=surveys),
        session_px={m: np.stack(v) for m, v in sessions.items()},
        sigma_px=sigma,
        light=light,
    )
