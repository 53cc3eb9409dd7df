"""Measurement of a camera from its frames, the same for all frames, for all but one, and for rendered frames.

Camera model by Gaussian centroids, noise of the sky without stars, PSF at the camera's star positions, centroids by
that PSF, camera once more, flux of the stars. No step uses a later one, so that frames can be left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.calibration.camera_order import (
    OrderValidation,
    calibrate_order,
    calibrate_with_floor,
    cross_validate,
    simplest_adequate,
)
from calib.calibration.frame_attitudes import frame_attitudes
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras.base import CameraModel
from calib.detector.sky_photon_transfer import SkyBlocks, SkyNoise, sky_blocks, sky_photon_transfer
from calib.flags import UNFIT, has_flag
from calib.measure.centroiding.registry import get_centroider
from calib.measure.stamps import extract_stamps
from calib.photometry.zero_point import POGSON, PhotometricSolution, fit_photometry
from calib.psf.gaussian_mixture import MixturePsf, StarWindows, colour_class, fit_psf, psf_fluxes
from calib.psf.star_windows import star_windows
from calib.records import StarTable
from experiments.twin.night import FieldStars, IdentifiedFrame, SolvedNight, field_stars, masked_pixels
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError

START_RADII_PX, START_FLOOR_PX = (5.0, 2.0, 1.2), 0.1
MATCH_PX = 1.2
FLOOR_PX = 0.03
"""Error per axis of every centroid in addition to its noise: seeing, PSF, catalogue."""
PSF_MAG, PHOTOMETRY_MAG = 1.5, 0.8
"""Stars of the PSF are brighter than the limiting magnitude by 1.5 mag; photometry reaches 0.8 mag fainter."""
PSF_STARS = 900
PSF_WINDOW_PX, CENTROID_WINDOW_PX = 21, 9
"""PSF windows hold wings and background, centroid windows the core."""
ZONES = 3
"""Positions per axis at which the PSF is sampled for centroids."""
FARTHEST_PX = 0.7
"""Distance between PSF and Gaussian fit beyond which a star is rejected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Centroids:
    """Matched stars of all frames."""

    observations: Observations  # ``star``: row of the sky
    magnitude: FloatArray  # (n,)
    noise_px: FloatArray  # (n,) Standard deviation per axis by noise alone
    width_px: FloatArray  # (n,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFit:
    """A camera measured from its frames."""

    camera: CameraModel
    calibration: Calibration
    order: str
    attitudes: Rotation  # Attitudes of all frames of the night, unused frames included
    noise: SkyNoise
    psf: MixturePsf
    photometry: PhotometricSolution
    gaussian: Centroids  # Measured by Gaussian fits
    fitted: Centroids  # Measured by the PSF
    used: tuple[int, ...]  # Frames of the measurement
    floor_px: float  # Error per axis beyond the noise of centroids by the PSF


def attitudes_of(calibration: Calibration) -> Rotation:
    """Attitudes of a calibration; `DomainError` where it did not converge."""
    if calibration.attitude is None:
        raise DomainError(f"no camera model fits the frames: {calibration.solution.message}")
    return calibration.attitude


def first_camera(night: SolvedNight, camera: CameraModel, attitudes: Rotation) -> Calibration:
    """Camera with one radial distortion term, from a pinhole and the blind attitudes."""
    for radius in START_RADII_PX:
        stars = gaussian_centroids(night, camera, attitudes, radius, floor_px=START_FLOOR_PX).observations
        calibration = calibrate_order(stars, camera, "pinhole" if radius == START_RADII_PX[0] else "radial_1")
        if not calibration.converged:
            raise DomainError(f"no camera fits the identified stars: {calibration.solution.message}")
        camera, attitudes = calibration.model, attitudes_of(calibration)
    return calibration


def gaussian_centroids(
    night: SolvedNight, camera: CameraModel, attitudes: Rotation, radius_px: float, *, floor_px: float = FLOOR_PX
) -> Centroids:
    """Detections that are catalogue stars, with the positions of their Gaussian fits."""
    parts = []
    for frame, attitude in zip(night.frames, attitudes, strict=True):
        rows, stars = frame.matched(attitude, camera, radius_px)
        parts.append((frame.detected.stars.select(rows), stars))
    return _joined(night, parts, floor_px)


def psf_centroids(night: SolvedNight, camera: CameraModel, attitudes: Rotation, psf: MixturePsf) -> Centroids:
    """Centroids as `gaussian_centroids`, measured with the PSF at the position and colour of the star."""
    axes = [np.linspace(n / 6.0, n * 5.0 / 6.0, ZONES) for n in night.size_px]
    zones = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    bank = [psf.effective(zone, colour) for zone in zones for colour in range(4)]
    centroider = get_centroider("epsf", epsf=bank, fit_background=True)
    parts = []
    for frame, attitude in zip(night.frames, attitudes, strict=True):
        rows, stars = frame.matched(attitude, camera, MATCH_PX)
        start = frame.detected.stars.pixel_px[rows]
        zone = np.argmin(((start[:, None] - zones) ** 2).sum(axis=2), axis=1) if len(rows) else np.empty(0, int)
        stamps = extract_stamps(
            frame.image,
            *start.T,
            background=frame.detected.background,
            size_px=CENTROID_WINDOW_PX,
            psf_index=zone * 4 + colour_class(night.sky.temperature_k[frame.rows[stars]]),
        )
        table = centroider.measure(stamps, frame.image.noise)
        shift_px = np.hypot(*(table.pixel_px - start).T)
        good = (shift_px < FARTHEST_PX) & np.isfinite(table.covariance).all(axis=(1, 2)) & ~has_flag(table.flags, UNFIT)
        parts.append((table.select(good), stars[good]))
    return _joined(night, parts, FLOOR_PX)


def _joined(night: SolvedNight, parts: Sequence[tuple[StarTable, IntArray]], floor_px: float) -> Centroids:
    """Matched stars of all frames; ``parts``: centroids of a frame and their rows in its ``direction``."""
    covariance = np.concatenate([table.covariance[:, :2, :2] for table, _ in parts])
    frames = list(zip(night.frames, parts, strict=True))
    star = np.concatenate([frame.rows[stars] for frame, (_, stars) in frames])
    return Centroids(
        observations=Observations(
            pixel_px=np.concatenate([table.pixel_px for table, _ in parts]),
            covariance_px2=covariance + floor_px**2 * np.eye(2),
            direction=np.concatenate([frame.direction[stars] for frame, (_, stars) in frames]),
            frame=np.repeat(np.arange(len(night)), [len(stars) for _, stars in parts]),
            frames=len(night),
            star=star,
        ),
        magnitude=np.array(night.sky.magnitude[star]),
        noise_px=np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2.0),
        width_px=np.concatenate([table.width_px for table, _ in parts]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedNight:
    """Data of a night that every measurement starts from: frames with measured noise, sky in blocks, first camera."""

    night: SolvedNight
    camera: CameraModel  # Camera model of `first_camera`
    attitudes: Rotation
    blocks: tuple[SkyBlocks, ...]
    hot: NDArray[np.bool_]  # (h, w)
    width_px: float  # Median width of a star
    limit_mag: float  # Magnitude at which about half of the stars are detected

    def stars(self, number: int, camera: CameraModel, attitudes: Rotation) -> FieldStars:
        """Catalogue stars on the detector of a frame."""
        return field_stars(self.night.frames[number], self.night.sky, camera, attitudes[number])

    def windows(
        self, frames: Sequence[IdentifiedFrame], stars: Sequence[FieldStars], fainter_mag: float = 0.0
    ) -> StarWindows:
        """Windows about the isolated stars of frames, down to the PSF's limit or fainter."""
        return star_windows(
            [frame.image for frame in frames],
            [frame.detected.background for frame in frames],
            [field.position_px for field in stars],
            [field.magnitude for field in stars],
            [field.colour_class for field in stars],
            faintest_mag=self.limit_mag - PSF_MAG + fainter_mag,
            size_px=PSF_WINDOW_PX,
            defective=self.hot,
        )


def prepare(
    night: SolvedNight, calibration: Calibration, hot: NDArray[np.bool_], *, attitudes: Rotation | None = None
) -> PreparedNight:
    """Masks and blocks of all frames; attitudes of the calibration by default."""
    attitudes = attitudes_of(calibration) if attitudes is None else attitudes
    tables = [frame.detected.stars.select(frame.detected.usable) for frame in night.frames]
    width = float(np.nanmedian(np.concatenate([table.width_px[table.fit] for table in tables])))
    blocks, limits = [], []
    for frame, attitude in zip(night.frames, attitudes, strict=True):
        stars = field_stars(frame, night.sky, calibration.model, attitude)
        blocks.append(sky_blocks(frame.image.dn, masked_pixels(frame.image, stars, frame.detected, hot, width)))
        _, star_rows = frame.matched(attitude, calibration.model, MATCH_PX)
        magnitude = np.sort(night.sky.magnitude[frame.rows[star_rows]])
        limits += [magnitude[int(0.9 * len(magnitude))]] if len(magnitude) else []
    return PreparedNight(
        night=night,
        camera=calibration.model,
        attitudes=attitudes,
        blocks=tuple(blocks),
        hot=hot,
        width_px=width,
        limit_mag=float(np.median(limits)),
    )


def noise_of(prepared: PreparedNight, used: Sequence[int], black_level_dn: float | None) -> SkyNoise:
    """Photon transfer of the sky in some frames."""
    blocks = [prepared.blocks[k] for k in used]
    levels = np.concatenate([block.level_dn[np.isfinite(block.variance_dn2)] for block in blocks])
    return sky_photon_transfer(blocks, lowest_dn=np.min(levels, initial=np.inf), black_level_dn=black_level_dn)


def choose_order(prepared: PreparedNight, orders: Sequence[str]) -> tuple[str, list[OrderValidation]]:
    """Order of the camera model and the cross-validation of all candidates; of a single frame "radial_1", untested."""
    if len(prepared.night) < 2:
        return "radial_1", []
    stars = gaussian_centroids(prepared.night, prepared.camera, prepared.attitudes, MATCH_PX).observations
    validations = [cross_validate(stars, prepared.camera, name) for name in orders]
    return simplest_adequate(validations).order, validations


def measure_camera(
    prepared: PreparedNight,
    *,
    order: str,
    used: Sequence[int],
    black_level_dn: float | None = None,
    start: CameraFit | None = None,
) -> CameraFit:
    """The camera from some frames of the night; the search for its PSF starts at that of ``start``."""
    night = prepared.night
    noise = noise_of(prepared, used, black_level_dn)
    gaussian = gaussian_centroids(night, prepared.camera, prepared.attitudes, MATCH_PX)
    stars = gaussian.observations
    calibration = calibrate_order(stars.select(np.isin(stars.frame, used)), prepared.camera, order)
    attitudes = frame_attitudes(stars, calibration.model, list(prepared.attitudes))
    psf = _psf(prepared, noise, calibration.model, attitudes, used) if start is None else start.psf
    fitted = psf_centroids(night, calibration.model, attitudes, psf)
    stars = fitted.observations.select(np.isin(fitted.observations.frame, used))
    stars = replace(stars, covariance_px2=stars.covariance_px2 - FLOOR_PX**2 * np.eye(2))
    calibration, floor = calibrate_with_floor(stars, prepared.camera, order, start_px=FLOOR_PX)
    attitudes = frame_attitudes(fitted.observations, calibration.model, list(attitudes))
    psf = _psf(prepared, noise, calibration.model, attitudes, used, psf.value)
    fields = [prepared.stars(k, calibration.model, attitudes) for k in range(len(night))]
    fluxes = star_fluxes(prepared, [night.frames[k] for k in used], [fields[k] for k in used], noise, psf)
    frame_airmass = np.array([np.median(field.airmass) for field in fields])
    return CameraFit(
        camera=calibration.model,
        calibration=calibration,
        order=order,
        attitudes=attitudes,
        noise=noise,
        psf=psf,
        photometry=fit_photometry(
            **(fluxes | {"frame": np.asarray(used, np.int64)[fluxes["frame"]]}),
            frames=len(night),
            airmass=frame_airmass if np.isfinite(frame_airmass).all() else None,
            shape_error_mag=POGSON * psf.flux_error,
        ),
        gaussian=gaussian,
        fitted=fitted,
        used=tuple(used),
        floor_px=floor,
    )


def _psf(
    prepared: PreparedNight,
    noise: SkyNoise,
    camera: CameraModel,
    attitudes: Rotation,
    used: Sequence[int],
    start: FloatArray | None = None,
) -> MixturePsf:
    windows = prepared.windows(
        [prepared.night.frames[k] for k in used], [prepared.stars(k, camera, attitudes) for k in used]
    )
    if len(windows) > PSF_STARS:
        windows = windows.select(np.arange(len(windows)) % -(-len(windows) // PSF_STARS) == 0)
    constant, slope = max(noise.intercept_dn2, 0.1) + noise.dsnu_dn**2, 1.0 / noise.gain_e_per_dn
    return fit_psf(
        windows, prepared.night.size_px, noise_dn2=(constant, slope), width_px=prepared.width_px, start=start
    )


def star_fluxes(
    prepared: PreparedNight,
    frames: Sequence[IdentifiedFrame],
    stars: Sequence[FieldStars],
    noise: SkyNoise,
    psf: MixturePsf,
) -> dict[str, Any]:
    """Fluxes of isolated stars at their calibrated positions: columns (n,) of `fit_photometry`."""
    windows = prepared.windows(frames, stars, PHOTOMETRY_MAG)
    gain = noise.gain_e_per_dn
    flux_dn, error_dn = psf_fluxes(psf, windows, noise.variance_dn2(windows.level_dn), gain)
    columns = {"frame": windows.frame, "flux_e": flux_dn * gain, "flux_error_e": error_dn * gain}
    for name in ("magnitude", "colour", "u2"):
        values = [getattr(field, name) for field in stars]
        columns[name] = np.array([values[k][row] for k, row in zip(windows.frame, windows.star, strict=True)])
    return columns
