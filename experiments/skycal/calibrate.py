"""Calibrations of one camera from one set of stars, compared with the traced lens; contributions to the error.

The same stars, frames and weights are calibrated repeatedly, with one more error switched on each time
(`experiments.skycal.positions`): ``reference`` has only the misfit of the camera model, ``light`` adds the star
colours, ``star_psf`` noise and pixels, ``measured`` the PSF of one colour. Each part is the difference of successive
maps, so that they add up as vectors; their squares add up only if they are independent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib.calibration.attitude_correlated import AttitudeCorrelated
from calib.calibration.attitude_family import AttitudeFamily
from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.gyro_linked import GyroLinked, GyroNoise
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras import BrownConrady, Polynomial
from calib.cameras.base import CameraModel
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from calib.fitting.excess_error import excess_sigma
from experiments.skycal.match import Matched
from experiments.skycal.measure import Recording
from experiments.skycal.positions import STEPS, Chart, star_positions, trace_chart
from experiments.skycal.scene import CameraScene
from experiments.skycal.settings import SkycalConfig, parse_model_name
from optics.arrays import FloatArray
from optics.errors import DomainError

METHODS = ("free", "acc", "linked", "acc_true")
"""Attitudes: independent per frame; from a noisy gyro taken as error-free; weighted by the gyro's noise; from the true
rotation of the gyro."""
LOSS = "tukey"
"""Loss of the robust fits: a real sky has blends without a flag."""
ROBUST = frozenset({"light", "star_psf", "measured", "corrected"})
"""Kinds of positions fitted with the robust loss: the colour shift of a very red star is an outlier in each of them."""
PARTS = ("mismatch", "chromatic", "noise", "psf")
"""Error that each of the `STEPS` adds: misfit of the model, star colours, noise and pixels, PSF of one colour."""
MIN_SURPLUS_STARS = 40
"""Stars beyond two per frame that a calibration needs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedMap:
    """A calibration compared with the traced lens."""

    data: str  # Kind of positions that was calibrated
    calibration: Calibration  # Camera, covariance, status
    map: LineOfSightMap  # Over the chart: errors, best rotation removed, and their prediction

    @property
    def error_arcsec(self) -> FloatArray:
        """Line-of-sight error (n, 2); NaN where the camera has no direction."""
        return self.map.error_arcsec

    @property
    def rms_arcsec(self) -> float:
        """RMS length of the error over the chart."""
        return rms(self.error_arcsec)


def rms(error: FloatArray) -> float:
    """Root mean square length of vectors (n, 2); rows of NaN are left out."""
    return float(np.sqrt(np.nanmean((error**2).sum(axis=1))))


def start_camera(scene: CameraScene, config: SkycalConfig, name: str) -> tuple[CameraModel, tuple[str, ...] | None]:
    """Start of a camera model (a wrong focal length, no distortion), and its free parameters (None: all)."""
    family, degree = parse_model_name(name)
    focal_length_mm = scene.instrument.focal_length_mm * config.start.focal_ratio
    geometry = scene.geometry
    if family == "polynomial":
        return Polynomial.create(geometry, degree=degree, focal_length_mm=focal_length_mm), None
    model = BrownConrady.create(geometry, focal_length_mm=focal_length_mm)
    return model, ("x0_px", "y0_px", "focal_length_mm") if family == "pinhole" else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrator:
    """Common data of all calibrations of a camera."""

    scene: CameraScene
    matched: Matched
    config: SkycalConfig
    chart: Chart
    used: NDArray[np.bool_]  # (n,) Matched stars that take part
    position_px: Mapping[str, FloatArray]  # (n, 2) Positions of the matched stars, by kind
    floor_px: float = 0.0  # Error per axis added in quadrature to the noise of every star

    def observations(self, data: str) -> Observations:
        """The stars with positions of a kind; the weights are those of the measured centroids for every kind."""
        matched, used = self.matched, self.used
        return Observations(
            pixel_px=self.position_px[data][used],
            covariance_px2=matched.covariance_px2[used] + self.floor_px**2 * np.eye(2),
            direction=matched.direction[used],
            frame=matched.frame[used],
            frames=self.scene.frames,
            star=matched.star[used],
        )

    def calibrate(self, data: str, *, model: str, method: str = "free") -> CalibratedMap:
        """Calibration from `start_camera`."""
        start, free = start_camera(self.scene, self.config, model)
        stars = self.observations(data)
        loss = LOSS if data in ROBUST else "linear"
        scene = self.scene
        gyro = self.config.gyro
        family: AttitudeFamily = FreeAttitudes()
        if method == "linked":
            noise = GyroNoise.from_data_sheet(
                angle_random_walk_deg_per_sqrt_h=gyro.angle_random_walk_deg_per_sqrt_h,
                bias_deg_per_h=gyro.bias_deg_per_h,
            )
            family = GyroLinked(gyro_rotation=scene.gyro_rotation, time_s=scene.time_s, noise=noise)
        elif method != "free":
            rotation = scene.true_gyro_rotation if method == "acc_true" else scene.gyro_rotation
            family = AttitudeCorrelated(gyro_rotation=rotation)
        return self.compare(calibrate(stars, start, family, loss=loss, free=free), data)

    def compare(self, calibration: Calibration, data: str) -> CalibratedMap:
        """Map error of a calibration, with its prediction."""
        # scipy's rotations need writable arrays
        direction, pixel_px = np.array(self.chart.direction), self.chart.pixel_px
        line_of_sight = line_of_sight_map(calibration.model, direction, pixel_px, covariance=calibration.covariance)
        return CalibratedMap(data=data, calibration=calibration, map=line_of_sight)

    def direct(self, model: str) -> CalibratedMap:
        """Best fit of the camera model: fitted to the chart itself."""
        start, free = start_camera(self.scene, self.config, model)
        grid = Observations.isotropic(
            pixel_px=self.chart.pixel_px,
            direction=self.chart.direction,
            frame=np.zeros(len(self.chart.pixel_px), np.int64),
            sigma_px=1.0,
        )
        return self.compare(calibrate(grid, start, FreeAttitudes(), free=free), "chart")

    def residuals(self, fitted: CalibratedMap) -> FloatArray:
        """Measured minus predicted position (k, 2) [px] of the used stars."""
        stars, calibration = self.observations(fitted.data), fitted.calibration
        assert calibration.attitude is not None
        # scipy's rotations need writable arrays
        in_cam = calibration.attitude[stars.frame].apply(np.array(stars.direction))
        return np.asarray(stars.pixel_px - calibration.model.project(in_cam))

    def find_floor_px(self, data: str, model: str) -> float:
        """Error per axis beyond the stated noise of the centroids, from the residuals of a fit without it."""
        fitted = self.calibrate(data, model=model)
        residual = self.residuals(fitted)
        variance = np.trace(self.observations(data).covariance_px2, axis1=1, axis2=2) / 2.0
        expected = fitted.calibration.solution.degrees_of_freedom / residual.size
        return excess_sigma(residual, variance, expected=expected)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedCamera:
    """All calibrations of a camera, and their input."""

    scene: CameraScene
    recording: Recording
    matched: Matched
    chart: Chart
    position_px: dict[str, FloatArray]  # (n, 2) Positions of all matched stars by kind
    used: NDArray[np.bool_]  # (n,) Matched stars that calibrate
    # Error per axis added in quadrature to the noise of every centroid: "measured" for all `STEPS`, and "corrected"
    floor_px: dict[str, float]
    # Keys: method, model, kind of positions; all `STEPS` for the configured model, with the weights of "measured"
    maps: dict[tuple[str, str, str], CalibratedMap]
    corrected_model_error: CalibratedMap  # Misfit of the model: ``reference`` with the weights of ``corrected``
    direct: dict[str, CalibratedMap]  # Each model fitted to the chart itself: no stars, no noise
    residual_px: FloatArray  # (k, 2) Residuals of the used stars, measured centroids, free attitudes

    def of(self, data: str, *, method: str = "free", model: str | None = None) -> CalibratedMap:
        """A calibration, by default of the configured model."""
        return self.maps[method, model or self.scene.config.model, data]

    @property
    def part_arcsec(self) -> dict[str, FloatArray]:
        """Each part of the error (n, 2): differences of the maps of successive `STEPS`."""
        errors = [self.of(data).error_arcsec for data in STEPS]
        return dict(zip(PARTS, [errors[0], *(later - earlier for earlier, later in pairwise(errors))], strict=True))


def calibrate_camera(
    scene: CameraScene, recording: Recording, matched: Matched, config: SkycalConfig, *, advance: Callable[[], None]
) -> CalibratedCamera:
    """Calibrate the same stars with one more error in each of the `STEPS`, with every model and attitude method."""
    _check_count(scene, config, matched, np.asarray(np.isfinite(matched.in_cam).all(axis=1)))
    chart = trace_chart(scene, config)
    position = star_positions(scene, recording, matched, config)
    used = np.all([np.isfinite(position_px).all(axis=1) for position_px in position.values()], axis=0)
    _check_count(scene, config, matched, used)
    advance()
    calibrator = Calibrator(scene=scene, matched=matched, config=config, chart=chart, used=used, position_px=position)
    name = scene.config.model
    measured, corrected = (
        replace(calibrator, floor_px=calibrator.find_floor_px(data, name)) for data in ("measured", "corrected")
    )
    maps: dict[tuple[str, str, str], CalibratedMap] = {}
    direct = {}
    for model in scene.config.models:
        for data in STEPS if model == name else ("reference", "measured"):
            maps["free", model, data] = measured.calibrate(data, model=model)
        maps["free", model, "corrected"] = corrected.calibrate("corrected", model=model)
        direct[model] = calibrator.direct(model)
        advance()
    for method in METHODS[1:]:
        maps[method, name, "measured"] = measured.calibrate("measured", model=name, method=method)
        maps[method, name, "corrected"] = corrected.calibrate("corrected", model=name, method=method)
    advance()
    return CalibratedCamera(
        scene=scene,
        recording=recording,
        matched=matched,
        chart=chart,
        position_px=position,
        used=used,
        floor_px={"measured": measured.floor_px, "corrected": corrected.floor_px},
        maps=maps,
        corrected_model_error=corrected.calibrate("reference", model=name),
        direct=direct,
        residual_px=measured.residuals(maps["free", name, "measured"]),
    )


def _check_count(scene: CameraScene, config: SkycalConfig, matched: Matched, used: NDArray[np.bool_]) -> None:
    """Refuse to calibrate with fewer than two stars per frame and `MIN_SURPLUS_STARS`."""
    stars, frames = int(used.sum()), len(np.unique(matched.frame[used]))
    needed = 2 * frames + MIN_SURPLUS_STARS
    if stars < needed:
        raise DomainError(
            f"{scene.name}: {stars} good stars matched in {frames} frames; at least {needed} are needed: raise "
            f"{scene.name}.instrument.exposure_s ({scene.instrument.config.exposure_s:g} s) or "
            f"{scene.name}.faintest_mag ({scene.config.faintest_mag:g}), or lower least_snr ({config.least_snr:g})"
        )
