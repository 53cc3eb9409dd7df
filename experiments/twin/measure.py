"""The camera from its frames: one sequence for all frames, for all but one, and for rendered frames.

Camera model by Gaussian centroids, noise of the sky without stars, PSF at the camera's star positions, centroids by
that PSF, camera again, light of the stars. Every step uses only previous steps, so that frames can be left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.cameras.base import CameraModel
from calib.detector.sky_transfer import SkyBlocks, SkyNoise, sky_blocks, sky_photon_transfer
from calib.flags import UNFIT, has_flag
from calib.measure.centroid import get_centroider
from calib.measure.stamps import extract_stamps
from experiments.twin.camera import Order, attitudes_of, calibrated, chosen_order, cross_validated, predicted_residuals
from experiments.twin.night import FieldStars, Night, field_stars, star_mask, star_sample
from experiments.twin.photometry import POGSON, Photometry, fit_photometry
from experiments.twin.psf import PsfModel, colour_class, fit_psf, linear_fit
from experiments.twin.solve import matched, wahba
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError

FIRST_RADII_PX = (5.0, 2.0, 1.2)
MATCH_PX = 1.2
FLOOR_PX = 0.03
"""Error per axis of every centroid in addition to its noise: seeing, PSF, catalogue."""
PSF_MAG = 1.5
"""The PSF comes from stars brighter than the limit by this [mag], photometry from stars 0.8 mag brighter than that."""
PHOTOMETRY_MAG = 0.8
PSF_STARS = 900
PSF_WINDOW_PX = 21
"""Wide enough to separate wings and background."""
ZONES = 3
"""Places per axis at which the PSF is sampled for centroids."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Centroids:
    """Matched stars of all frames."""

    observations: Observations  # ``star``: row of the sky
    magnitude: FloatArray  # (n,)
    noise_px: FloatArray  # (n,) Standard deviation per axis by noise alone
    width_px: FloatArray  # (n,) Of a Gaussian fit; NaN where another one was made


@dataclass(frozen=True, slots=True, kw_only=True)
class Fluxes:
    """Light of isolated stars at their places."""

    frame: IntArray  # (n,)
    flux_e: FloatArray  # (n,)
    error_e: FloatArray  # (n,)
    magnitude: FloatArray  # (n,)
    colour: FloatArray  # (n,) 5040 K / T
    u2: FloatArray  # (n,) Squared distance from the middle over half of the diagonal
    chi2: FloatArray  # (n,) Of the window


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFit:
    """A camera measured from its frames."""

    camera: CameraModel
    calibration: Calibration
    order: str
    attitudes: Rotation  # Of all frames of the night, those that were left out included
    noise: SkyNoise
    psf: PsfModel
    photometry: Photometry
    fluxes: Fluxes
    gaussian: Centroids  # Measured by Gaussian fits
    fitted: Centroids  # Measured by the PSF
    used: tuple[int, ...]  # Frames it was made of
    floor_px: float  # Error per axis beyond the noise of centroids by the PSF


def first_camera(night: Night, camera: CameraModel, attitudes: Sequence[Rotation]) -> Calibration:
    """Camera with one radial term from a pinhole and rough attitudes."""
    turns = list(attitudes)
    for radius in FIRST_RADII_PX:
        stars = gaussian_centroids(night, camera, turns, radius, floor_px=0.1).observations
        order = "pinhole" if radius == FIRST_RADII_PX[0] else "radial_1"
        made = calibrated(stars, camera, order)
        if not made.converged:
            raise DomainError(f"no camera fits the identified stars: {made.solution.message}")
        camera, turns = made.model, list(attitudes_of(made))
    return made


def gaussian_centroids(
    night: Night, camera: CameraModel, attitudes: Sequence[Rotation], radius_px: float, *, floor_px: float = FLOOR_PX
) -> Centroids:
    """Detections that are catalogue stars, with the positions of their Gaussian fits."""
    parts = []
    for number, frame in enumerate(night.frames):
        rows, stars = matched(frame.seen, frame.direction, attitudes[number], camera, radius_px)
        table = frame.seen.stars
        covariance = table.covariance[rows][:, :2, :2]
        width = table.width_px[rows]
        parts.append((table.pixel_px[rows], covariance, frame.direction[stars], number, frame.rows[stars], width))
    return _joined(night, parts, floor_px)


def psf_centroids(night: Night, camera: CameraModel, attitudes: Sequence[Rotation], psf: PsfModel) -> Centroids:
    """The same stars, measured with the PSF of their place and colour."""
    width, height = night.size_px
    zones = np.stack(
        np.meshgrid(*(np.linspace(n / 6.0, n * 5.0 / 6.0, ZONES) for n in (width, height))), axis=-1
    ).reshape(-1, 2)
    bank = [psf.effective(place, colour) for place in zones for colour in range(4)]
    centroider = get_centroider("epsf", epsf=bank, fit_background=True)
    parts = []
    for number, frame in enumerate(night.frames):
        rows, stars = matched(frame.seen, frame.direction, attitudes[number], camera, MATCH_PX)
        direction, stars = frame.direction[stars], frame.rows[stars]
        place = frame.seen.stars.pixel_px[rows]
        zone = np.argmin(((place[:, None] - zones) ** 2).sum(axis=2), axis=1) if len(rows) else np.empty(0, int)
        colour = colour_class(night.sky.temperature_k[stars])
        stamps = extract_stamps(
            frame.image,
            place[:, 0],
            place[:, 1],
            background=frame.seen.background,
            size_px=9,
            psf_index=zone * 4 + colour,
        )
        table = centroider.measure(stamps, frame.image.noise)
        moved = np.linalg.norm(table.pixel_px - place, axis=1)
        good = (moved < 0.7) & np.isfinite(table.covariance).all(axis=(1, 2)) & ~has_flag(table.flags, UNFIT)
        covariance = table.covariance[good][:, :2, :2]
        unknown = np.full(int(good.sum()), np.nan)
        parts.append((table.pixel_px[good], covariance, direction[good], number, stars[good], unknown))
    return _joined(night, parts, FLOOR_PX)


def _joined(night: Night, parts: Sequence[tuple], floor_px: float) -> Centroids:
    covariance = np.concatenate([one[1] for one in parts])
    star = np.concatenate([one[4] for one in parts])
    return Centroids(
        observations=Observations(
            pixel_px=np.concatenate([one[0] for one in parts]),
            covariance_px2=covariance + floor_px**2 * np.eye(2),
            direction=np.concatenate([one[2] for one in parts]),
            frame=np.concatenate([np.full(len(one[0]), one[3]) for one in parts]),
            frames=len(night),
            star=star,
        ),
        magnitude=np.array(night.sky.magnitude[star]),
        noise_px=np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2.0),
        width_px=np.concatenate([one[5] for one in parts]),
    )


def attitude_of(stars: Observations, camera: CameraModel) -> Rotation:
    """Attitude of one frame with a given camera, outliers left out."""
    _, kept = predicted_residuals(stars, camera)
    return wahba(stars.pixel_px[kept], stars.direction[kept], camera)


def _attitudes(stars: Observations, camera: CameraModel, start: Sequence[Rotation]) -> Rotation:
    """Attitudes of all frames with a given camera, whether it was made from them or not."""
    out = []
    for number, turn in enumerate(start):
        mine = stars.select(stars.frame == number)
        out.append(attitude_of(mine, camera) if len(mine) >= 4 else turn)
    return Rotation.concatenate(out)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Common data of all cameras of one night: frames with measured noise, their sky in blocks."""

    night: Night
    camera: CameraModel  # First one
    attitudes: Rotation
    blocks: tuple[SkyBlocks, ...]
    hot: NDArray[np.bool_]  # (h, w)
    width_px: float  # Typical width of a star
    limit_mag: float  # About where half of the stars are found


def prepare(night: Night, made: Calibration, hot: NDArray[np.bool_], *, attitudes: Rotation | None = None) -> Prepared:
    """Masks and blocks of all frames; attitudes of the calibration if there are no better ones."""
    attitudes = attitudes_of(made) if attitudes is None else attitudes
    blocks, found = [], []
    good = [one.seen.stars.width_px[one.seen.sane & one.seen.stars.fit] for one in night.frames]
    width = float(np.nanmedian(np.concatenate(good)))
    for number, frame in enumerate(night.frames):
        stars = field_stars(night, number, made.model, attitudes[number])
        blocks.append(sky_blocks(frame.image.dn, star_mask(frame.image, stars, frame.seen, hot, width)))
        _, known = matched(frame.seen, frame.direction, attitudes[number], made.model, MATCH_PX)
        found.append(np.sort(night.sky.magnitude[frame.rows[known]]))
    limit = float(np.median([one[int(0.9 * len(one))] for one in found if len(one)]))
    return Prepared(
        night=night,
        camera=made.model,
        attitudes=attitudes,
        blocks=tuple(blocks),
        hot=hot,
        width_px=width,
        limit_mag=limit,
    )


def noise_of(known: Prepared, used: Sequence[int], black_level_dn: float | None) -> SkyNoise:
    """Noise of some frames."""
    blocks = [known.blocks[k] for k in used]
    lowest = min(float(np.nanmin(one.level_dn[np.isfinite(one.variance_dn2)])) for one in blocks)
    return sky_photon_transfer(blocks, lowest_dn=lowest, black_level_dn=black_level_dn)


def cross_validate(known: Prepared, orders: Sequence[str]) -> tuple[Order, list[Order]]:
    """The chosen order, and all that were tried."""
    night = known.night
    stars = gaussian_centroids(night, known.camera, list(known.attitudes), MATCH_PX).observations
    if len(night) < 2:
        return Order(name="radial_1", parameters=4, chi2=np.array([np.nan]), residual_px=float("nan")), []
    tried = [cross_validated(stars, known.camera, name) for name in orders]
    return chosen_order(tried), tried


def measure_camera(
    known: Prepared,
    *,
    order: str,
    used: Sequence[int],
    black_level_dn: float | None = None,
    near: CameraFit | None = None,
) -> CameraFit:
    """The camera from some frames of the night; the search for its PSF starts at that of ``near``."""
    night, start = known.night, list(known.attitudes)
    noise = noise_of(known, used, black_level_dn)
    gaussian = gaussian_centroids(night, known.camera, start, MATCH_PX)
    mine = np.isin(gaussian.observations.frame, used)
    made = calibrated(gaussian.observations.select(mine), known.camera, order)
    attitudes = _attitudes(gaussian.observations, made.model, start)
    psf = _psf(known, noise, made.model, attitudes, used) if near is None else near.psf
    fitted = psf_centroids(night, made.model, list(attitudes), psf)
    made, floor = _with_floor(fitted, known.camera, order, used)
    attitudes = _attitudes(fitted.observations, made.model, list(attitudes))
    psf = _psf(known, noise, made.model, attitudes, used, psf.value)
    fluxes = star_fluxes(known, noise, psf, made.model, attitudes, used)
    return CameraFit(
        camera=made.model,
        calibration=made,
        order=order,
        attitudes=attitudes,
        noise=noise,
        psf=psf,
        photometry=photometry_of(known, fluxes, made.model, attitudes, shape_error_mag=POGSON * psf.flux_error),
        fluxes=fluxes,
        gaussian=gaussian,
        fitted=fitted,
        used=tuple(used),
        floor_px=floor,
    )


def _with_floor(fitted: Centroids, camera: CameraModel, order: str, used: Sequence[int]) -> tuple[Calibration, float]:
    """Calibration with the additional error per axis for which the residuals match their expectation."""
    mine = np.isin(fitted.observations.frame, used)
    stars = fitted.observations.select(mine)
    noise = stars.covariance_px2 - FLOOR_PX**2 * np.eye(2)
    floor, made = FLOOR_PX, calibrated(stars, camera, order)
    for _ in range(3):
        left = residuals(stars, made.model, attitudes_of(made))
        size2 = (left**2).sum(axis=1) / 2.0
        own = np.trace(noise, axis1=1, axis2=2) / 2.0
        grid = np.geomspace(2e-3, 0.3, 60)
        # median of a chi-square of two degrees of freedom, halved
        typical = [np.median(size2 / (own + one**2)) / np.log(2.0) for one in grid]
        floor = float(np.interp(0.0, 1.0 - np.array(typical), grid))
        stars = replace(stars, covariance_px2=noise + floor**2 * np.eye(2))
        made = calibrated(stars, camera, order)
    return made, floor


def residuals(stars: Observations, camera: CameraModel, attitudes: Rotation) -> FloatArray:
    """Measured less predicted places (n, 2) [px]; attitudes of all frames."""
    turn = attitudes.as_matrix()[stars.frame]
    return np.asarray(stars.pixel_px - camera.project(np.einsum("nij,nj->ni", turn, stars.direction)))


def _psf(
    known: Prepared,
    noise: SkyNoise,
    camera: CameraModel,
    attitudes: Rotation,
    used: Sequence[int],
    start: FloatArray | None = None,
) -> PsfModel:
    pairs = [(known.night.frames[k], field_stars(known.night, k, camera, attitudes[k])) for k in used]
    sample = star_sample(
        pairs, brightest_mag=-5.0, faintest_mag=known.limit_mag - PSF_MAG, size_px=PSF_WINDOW_PX, hot=known.hot
    )
    if len(sample) > PSF_STARS:
        sample = sample.select(np.arange(len(sample)) % -(-len(sample) // PSF_STARS) == 0)
    constant = max(noise.intercept_dn2, 0.1) + noise.dsnu_dn**2
    slope = 1.0 / noise.gain_e_per_dn
    return fit_psf(sample, known.night.size_px, noise_dn2=(constant, slope), width_px=known.width_px, start=start)


def star_fluxes(
    known: Prepared,
    noise: SkyNoise,
    psf: PsfModel,
    camera: CameraModel,
    attitudes: Rotation,
    used: Sequence[int],
) -> Fluxes:
    """Light of isolated stars in some frames, at the places where the camera puts them."""
    pairs = [(known.night.frames[k], field_stars(known.night, k, camera, attitudes[k])) for k in used]
    sample = star_sample(
        pairs,
        brightest_mag=-5.0,
        faintest_mag=known.limit_mag - PSF_MAG + PHOTOMETRY_MAG,
        size_px=PSF_WINDOW_PX,
        hot=known.hot,
    )
    shape = psf.draw(sample.offset_px, sample.place_px, sample.colour, PSF_WINDOW_PX)
    # weights of the background alone: bright stars then do not depend on what the PSF misses in its core
    weight = np.where(sample.valid, 1.0 / noise.variance_dn2(sample.level_dn)[:, None, None], 0.0)
    flux, background, variance = linear_fit(shape, sample.dn, weight)
    gain = noise.gain_e_per_dn
    left = sample.dn - flux[:, None, None] * shape - background[:, None, None]
    # shot noise of the star itself, through the same weights
    share = (shape**3 * weight).sum((1, 2)) / np.maximum((shape**2 * weight).sum((1, 2)), 1e-12) ** 2
    share *= np.max(weight, axis=(1, 2))
    own = np.maximum(flux, 0.0) / gain * share
    pick = [pairs[k][1] for k in sample.frame]
    middle = (np.asarray(known.night.size_px) - 1.0) / 2.0
    half = 0.5 * float(np.hypot(*known.night.size_px))
    return Fluxes(
        frame=np.asarray(used, np.int64)[sample.frame],
        flux_e=flux * gain,
        error_e=np.sqrt(variance + own) * gain,
        magnitude=np.array([one.magnitude[row] for one, row in zip(pick, sample.star, strict=True)]),
        colour=np.array([one.colour[row] for one, row in zip(pick, sample.star, strict=True)]),
        u2=((sample.place_px - middle) ** 2).sum(axis=1) / half**2,
        chi2=(left**2 * weight).sum((1, 2)) / (PSF_WINDOW_PX**2 - 2),
    )


def photometry_of(
    known: Prepared,
    fluxes: Fluxes,
    camera: CameraModel,
    attitudes: Rotation,
    *,
    shape_error_mag: float = 0.0,
) -> Photometry:
    """Brightness of the stars of the night."""
    mass = np.array([field_airmass(known, k, camera, attitudes) for k in range(len(known.night))])
    return fit_photometry(
        magnitude=fluxes.magnitude,
        colour=fluxes.colour,
        u2=fluxes.u2,
        frame=fluxes.frame,
        frames=len(known.night),
        flux_e=fluxes.flux_e,
        flux_error_e=fluxes.error_e,
        airmass=mass if np.isfinite(mass).all() else None,
        shape_error_mag=shape_error_mag,
    )


def field_airmass(known: Prepared, number: int, camera: CameraModel, attitudes: Rotation) -> float:
    """Median airmass of the stars of a frame; NaN where the zenith is not known."""
    stars: FieldStars = field_stars(known.night, number, camera, attitudes[number])
    return float(np.median(stars.airmass))
