"""Attitudes of written frames by a path of its own: the file, its record, plain NumPy and astropy.

From the record of a frame comes the quaternion, from its truth where the stars stand on the sky; a pinhole of the
camera's focal length puts them on the detector. In the pixels of the file the light around each place is centred (first
moments about the median of the window, twice), and a shift, a turn, a scale and two terms of radial distortion are
fitted to what the places are off by. Shift and turn are the error of the written attitude: nothing if it is right in
size, sense and handedness. No detection, centroider, camera model or attitude of this project takes part.

Beside it the boresight and the roll of the record against its quaternion, by astropy's position angles; and what the
blind solution makes of the same stars turned about the middle of the detector by a known angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from experiments.laboratory.plain_formulae import ARCSEC, matrix_of_quaternion
from optics.arrays import FloatArray
from optics.records import freeze

if TYPE_CHECKING:
    from pathlib import Path

    from experiments.dataset.evaluation.solve import SolvedFrame
    from experiments.dataset.truth.frame_record import FrameRecord

__all__ = [
    "LEAST_KEPT",
    "TURN_DEG",
    "PlainAttitude",
    "plain_attitude",
    "pointing_off_arcsec",
    "read_pixels",
    "turn_missed_sigma",
    "turned_px",
]


HALF_PX = 4
LEAST_SNR = 10.0
FEWEST, LEAST_KEPT = 15, 10
"""Undisturbed stars that a frame needs to be judged, and those that must be found."""
FOUND_PX = 3.0
"""The pinhole leaves distortion in: this far from its place, before the fit, a star may be."""
PEAK_SIGMA, FIT_PX = 5.0, 0.7
"""A star's brightest pixel over the scatter of its window; its distance from the fit. Empty windows show neither."""
FLOOR_PX = 0.02
"""What moments of undersampled stars, and a lens that is not centred, may be off by alike for all stars."""
TURN_DEG = 1.0
"""By which the stars of a frame are turned for the blind solution."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainAttitude:
    """The written attitude of one frame against its pixels."""

    error_arcsec: FloatArray  # (3,) About cam x, y and z (roll): pixels minus record, and standard deviation
    sigma_arcsec: FloatArray  # (3,) About cam x, y and z (roll): pixels minus record, and standard deviation
    found: float  # Part of the stars that stand where the record puts them

    def __post_init__(self) -> None:
        freeze(self, "error_arcsec", shape=(3,), finite=False)
        freeze(self, "sigma_arcsec", shape=(3,), finite=False)


def plain_attitude(
    image: FloatArray,
    record: FrameRecord,
    truth: dict[str, Any],
    *,
    focal_px: float,
    centre_px: FloatArray,
) -> PlainAttitude | None:
    """The written attitude of a frame against the light in its pixels; None with too few undisturbed stars."""
    good = np.flatnonzero((np.asarray(truth["flags"]) == 0) & (np.asarray(truth["snr"]) >= LEAST_SNR))
    if len(good) < FEWEST:
        return None
    nothing = PlainAttitude(error_arcsec=np.full(3, np.nan), sigma_arcsec=np.full(3, np.nan), found=0.0)
    place = _places(record, truth, focal_px, centre_px)[good]
    inside = np.all((place > HALF_PX + 2) & (place < np.array(image.shape[::-1]) - HALF_PX - 3), axis=1)
    if inside.sum() < LEAST_KEPT:
        return nothing
    place = place[inside]
    seen, bright = _centred(image, _centred(image, place)[0])
    near = bright & (np.hypot(*(seen - place).T) < FOUND_PX)
    if near.sum() < LEAST_KEPT:
        return nothing
    value, sigma, kept = _fitted(place[near] - centre_px, (seen - place)[near])
    # the image moves by +x where the camera turns about +y, by +y where it turns about -x
    turn = np.array([-value[1], value[0], value[2] * focal_px]) / focal_px / ARCSEC
    spread = np.array([sigma[1], sigma[0], sigma[2] * focal_px]) / focal_px / ARCSEC
    return PlainAttitude(error_arcsec=turn, sigma_arcsec=spread, found=float(kept.sum() / len(place)))


def read_pixels(path: str | Path) -> FloatArray:
    """Pixels (h, w) of the image in a FITS file, by astropy."""
    from astropy.io import fits

    with fits.open(path) as content:
        images = (hdu.data for hdu in content if getattr(hdu, "is_image", False) and hdu.data is not None)
        return np.asarray(next(images), float)


def _places(record: FrameRecord, truth: dict[str, Any], focal_px: float, centre_px: FloatArray) -> FloatArray:
    """Pixels (n, 2) of the stars by the written quaternion and a pinhole; columns count along cam x, rows along y."""
    ra, dec = np.radians(np.asarray(truth["ra_deg"])), np.radians(np.asarray(truth["dec_deg"]))
    sky = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    cam = sky @ matrix_of_quaternion(record.quat_xyzw).T
    return np.asarray(np.where(cam[:, 2:] > 0.1, centre_px + focal_px * cam[:, :2] / cam[:, 2:], np.nan))


def _centred(image: FloatArray, place: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """First moments (n, 2) of the light within `HALF_PX` of places, and whether a pixel stands out of the window."""
    at = np.rint(np.clip(place, HALF_PX, np.array(image.shape[::-1]) - HALF_PX - 1)).astype(int)
    step = np.arange(-HALF_PX, HALF_PX + 1)
    window = image[at[:, 1, None, None] + step[None, :, None], at[:, 0, None, None] + step[None, None, :]]
    light = window - np.median(window, axis=(1, 2), keepdims=True)
    peak, scatter = light.max(axis=(1, 2)), np.median(np.abs(light), axis=(1, 2)) / 0.6745
    light = np.where(light > 0.1 * peak[:, None, None], light, 0.0)
    total = np.maximum(light.sum(axis=(1, 2)), 1e-300)
    moment = np.column_stack([(light.sum(1) * step).sum(1), (light.sum(2) * step).sum(1)]) / total[:, None]
    return at + moment, peak > PEAK_SIGMA * scatter


def _fitted(place: FloatArray, off: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Shift x, y [px], turn [rad], scale, distortion of third and fifth order; sigmas; which stars were kept."""
    x, y = place.T
    square = (x**2 + y**2) / np.max(x**2 + y**2)
    zero, one = np.zeros(len(x)), np.ones(len(x))
    along = np.column_stack([one, zero, -y, x, x * square, x * square**2])
    across = np.column_stack([zero, one, x, y, y * square, y * square**2])
    kept = np.ones(len(x), bool)
    for _ in range(4):
        if kept.sum() < LEAST_KEPT:
            return np.full(3, np.nan), np.full(3, np.nan), kept
        design = np.concatenate([along[kept], across[kept]])
        value = np.linalg.lstsq(design, np.concatenate([off[kept, 0], off[kept, 1]]), rcond=None)[0]
        left = off - np.column_stack([along @ value, across @ value])
        length = np.hypot(*left.T)
        kept = length < np.clip(4.0 * np.median(length), 0.05, FIT_PX)
    rms2 = float((left[kept] ** 2).sum() / max(2 * kept.sum() - 6, 1))
    covariance = rms2 * np.linalg.inv(design.T @ design)
    floor = FLOOR_PX * np.array([1.0, 1.0, 1.0 / np.sqrt(np.mean(x**2 + y**2))])
    return value[:3], np.sqrt(np.diag(covariance)[:3] + floor**2), kept


def pointing_off_arcsec(record: FrameRecord) -> float:
    """Largest difference of the written boresight and roll from the written quaternion, by astropy's angles."""
    import astropy.units as u
    from astropy.coordinates import SkyCoord

    to_sky = matrix_of_quaternion(record.quat_xyzw).T
    ahead, above = to_sky @ [0.0, 0.0, 1.0], to_sky @ [0.0, -1e-3, 1.0]  # up in the image: rows count downwards
    seen, up = (SkyCoord(*v, representation_type="cartesian", frame="icrs") for v in (ahead, above))
    seen, up = (SkyCoord(one.spherical.lon, one.spherical.lat, frame="icrs") for one in (seen, up))
    written = SkyCoord(record.ra_deg * u.deg, record.dec_deg * u.deg, frame="icrs")
    roll = (seen.position_angle(up).to_value(u.arcsec) - record.roll_deg * 3600.0 + 648000.0) % 1296000.0 - 648000.0
    return float(max(seen.separation(written).to_value(u.arcsec), abs(roll) * np.cos(np.radians(record.dec_deg))))


def turned_px(pixel_px: FloatArray, centre_px: FloatArray, turn_deg: float) -> FloatArray:
    """Places (n, 2) turned about the axis of the lens, columns towards rows."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return np.asarray(centre_px + (pixel_px - centre_px) @ np.array([[c, s], [-s, c]]))


def turn_missed_sigma(before: SolvedFrame, after: SolvedFrame) -> float:
    """How far two solutions of stars turned by `TURN_DEG` in between are off a turn about cam z, in sigmas."""
    expected = np.array([0.0, 0.0, TURN_DEG * 3600.0])
    return float(np.max(np.abs(after.error_arcsec - before.error_arcsec - expected) / before.sigma_arcsec))
