"""A star tracker: frame and time in, quaternion with covariance out.

Lost in space, all stars of the frame are detected and identified (`calib.attitude.star_attitude.identify_stars`)
without detections unlike stars (tracks of cosmic rays, `unlike_stars`). Afterwards only windows around predicted guide
stars are measured; the prediction extrapolates the last attitude by the rate of a gyro or the turn between the last two
attitudes. A window is rejected if its star is off its place after the common shift of all (hot pixel, cosmic ray,
planet, wrong star); then stars beyond 3.5 sigma of the best attitude are rejected. With too few stars left the whole
frame is searched; if that fails, the status states the reason and there is no attitude.

Times are the middles of the exposures. Directions of the guide stars include the aberration of the given velocity; the
quaternion is cam from icrs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from calib.attitude.attitude_solution import AttitudeSolution, solve_wahba
from calib.attitude.star_attitude import identify_stars
from calib.cameras.base import CameraModel
from calib.flags import StarFlag
from calib.measure.background import estimate_background
from calib.measure.centroiding.registry import Centroider, get_centroider
from calib.measure.find import find_stamps
from calib.measure.images.sensor_image import image_from_frame, subtract_dark
from calib.measure.stamps import ring_background, stamps_from_windows
from calib.records import NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray
from optics.attitude import quat_xyzw
from optics.errors import DomainError
from optics.records import freeze, freeze_all
from optics.stellar_aberration import aberrated
from optics.units import RAD_ARCSEC
from render.records import EffectivePsf, Frame, WindowStack

CLIP_SIGMA, CLIP_ROUNDS = 3.5, 6
ROUGH_PX = 1.0
"""A rough attitude that moves all windows by more has them cut anew, where the stars are."""
SNR = 5.0
"""Signal-to-noise ratio of the flux below which a window holds no star."""
CONFIRMED_FRACTION = 0.5
"""Smallest fraction of the predicted stars to be found after an acquisition; below, it was a chance match."""
BRIGHTEST = (20, 12)
"""Number of brightest detections to identify if all of them form no pattern."""
DOUBTFUL = StarFlag.SPIKE | StarFlag.TRAIL | StarFlag.UNDETERMINED
MISFIT = 0.1
"""Residual of a fit over the star fitted, root of their powers against the noise, above which light is no star's."""
LONGEST_GAP_S = 5.0
"""A turn is carried on for so long; then the sky is searched anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GuideCatalogue:
    """Stars that a tracker looks for; made by `guide_catalogue`."""

    id: NDArray[np.int64]  # (n,)
    direction: FloatArray  # (n, 3) Unit vectors along icrs, at the epoch, without aberration
    magnitude: FloatArray  # (n,) In the tracker's own band
    row: NDArray[np.int64]  # (n,) In the catalogue they were chosen from

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "id", shape=("n",), dtype=np.int64, sizes=sizes)
        freeze_all(self, direction=("n", 3), magnitude=("n",), sizes=sizes)
        freeze(self, "row", shape=("n",), dtype=np.int64, sizes=sizes)

    def __len__(self) -> int:
        return len(self.id)


def guide_catalogue(
    identifier: ArrayLike,
    direction: ArrayLike,
    magnitude: ArrayLike,
    *,
    faintest_mag: float,
    brightest_mag: float = -2.0,
    apart_rad: float,
    fainter_mag: float = 3.0,
) -> GuideCatalogue:
    """Stars that stand alone, between two magnitudes of the instrument; brightest first.

    Shapes: ``identifier``, ``magnitude`` (n,), ``direction`` (n, 3) along icrs, of all stars of the sky. Magnitudes are
    instrumental: of stars of the same electrons and one colour. No other star that is not fainter by ``fainter_mag``
    may be nearer than ``apart_rad``. `DomainError` without any star left.
    """
    direction, magnitude = np.asarray(direction, float), np.asarray(magnitude, float)
    if not brightest_mag < faintest_mag:
        raise DomainError(
            f"guide stars from {brightest_mag:g} to {faintest_mag:g} mag: the first must be the lower magnitude"
        )
    if not apart_rad > 0.0:
        raise DomainError(f"apart_rad = {apart_rad:g} rad; it must be positive")
    near = np.flatnonzero(magnitude <= faintest_mag + fainter_mag)
    pairs = cKDTree(direction[near]).query_pairs(2.0 * np.sin(0.5 * min(apart_rad, np.pi)), output_type="ndarray")
    isolated = np.ones(len(magnitude), bool)
    for star, neighbour in (pairs.T, pairs.T[::-1]):
        disturbed = magnitude[near[neighbour]] < magnitude[near[star]] + fainter_mag
        isolated[near[star[disturbed]]] = False
    row = np.flatnonzero(isolated & (magnitude >= brightest_mag) & (magnitude <= faintest_mag))
    if not len(row):
        raise DomainError(
            f"no guide star from {brightest_mag:g} to {faintest_mag:g} mag is isolated by apart_rad in the catalogue"
        )
    row = row[np.argsort(magnitude[row], kind="stable")]
    return GuideCatalogue(
        id=np.asarray(identifier, np.int64)[row], direction=direction[row], magnitude=magnitude[row], row=row
    )


def sky_coverage(guides: GuideCatalogue, model: CameraModel, *, attitudes: int = 1000, margin_px: float = 0.0) -> Any:
    """Number of guide stars in the field (attitudes,), in attitudes spread evenly over the sky and all rolls."""
    k = np.arange(attitudes)
    z = 1.0 - (2.0 * k + 1.0) / attitudes
    golden = np.pi * (3.0 - np.sqrt(5.0))
    attitude = Rotation.from_euler("ZYZ", np.column_stack([golden * k, np.arccos(z), k * np.sqrt(2.0) * np.pi])).inv()
    reach = 2.0 * np.sin(0.5 * _half_field_rad(model))
    tree, counts = cKDTree(guides.direction), np.zeros(attitudes, np.int64)
    for n, matrix in enumerate(attitude.as_matrix()):
        near = tree.query_ball_point(matrix[2], 1.02 * reach)
        if near:
            star_px = model.project(guides.direction[near] @ matrix.T)
            counts[n] = np.count_nonzero(model.geometry.contains(star_px, margin_px=-margin_px))
    return counts


def _half_field_rad(model: CameraModel) -> float:
    """Angle of the farther of two opposite corners of the detector from the boresight."""
    corner = model.unproject(model.geometry.corners_px[[0, 2]])
    return float(np.arccos(np.clip(corner[:, 2].min(), -1.0, 1.0)))


def expected_guides(
    guides: GuideCatalogue,
    model: CameraModel,
    attitude: Rotation,
    *,
    velocity_km_per_s: ArrayLike | None = None,
    margin_px: float = 0.0,
    most: int | None = None,
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Guide stars in the field of an attitude, cam from icrs; parameters as of `StarTracker`.

    Returns rows of the catalogue (k,), brightest first; directions (k, 3) along icrs with aberration; places (k, 2) on
    the detector, at least ``margin_px`` inside its edge.
    """
    near = np.flatnonzero(guides.direction @ attitude.as_matrix()[2] > np.cos(1.05 * _half_field_rad(model)))
    if not len(near):
        return near, np.empty((0, 3)), np.empty((0, 2))
    apparent = _apparent(guides.direction[near], velocity_km_per_s)
    star_px = model.project(attitude.apply(apparent))
    rows = np.flatnonzero(model.geometry.contains(star_px, margin_px=-margin_px))[:most]
    return near[rows], apparent[rows], star_px[rows]


def _apparent(direction: FloatArray, velocity: ArrayLike | None) -> FloatArray:
    return np.array(direction) if velocity is None else aberrated(np.array(direction), np.asarray(velocity, float))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackedAttitude:
    """Result of the tracker for one frame.

    Status: ``"ok"``; ``"few_stars"``: fewer than needed; ``"not_identified"``: stars, but of no known pattern;
    ``"not_confirmed"``: a pattern, but most guide stars are missing in it.
    """

    time_s: float  # Middle of the exposure, as the tracker was told
    mode: str  # "acquisition" or "tracking": how the stars were found
    status: str
    attitude: Rotation | None = None  # cam from icrs; None unless ok
    # Of the error's rotation vector in cam; infinite unless ok
    covariance_rad2: FloatArray = field(default_factory=lambda: np.full((3, 3), np.inf))
    # (k,) Guide stars that the attitude was made of
    star_id: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    pixel_px: FloatArray = field(default_factory=lambda: np.empty((0, 2)))  # (k, 2) Their centroids
    rejected: int = 0  # Windows that held light, but no star that fits
    expected: int = 0  # Windows that were looked at

    def __post_init__(self) -> None:
        freeze(self, "covariance_rad2", shape=(3, 3), finite=False)
        sizes: dict[str, int] = {}
        freeze(self, "star_id", shape=("k",), dtype=np.int64, sizes=sizes)
        freeze(self, "pixel_px", shape=("k", 2), sizes=sizes)

    @property
    def ok(self) -> bool:
        """Whether there is an attitude."""
        return self.status == "ok"

    @property
    def quat_xyzw(self) -> FloatArray:
        """Quaternion (4,), scalar last and not negative; NaN where there is none."""
        return np.full(4, np.nan) if self.attitude is None else quat_xyzw(self.attitude)

    @property
    def sigma_arcsec(self) -> FloatArray:
        """Standard deviation (3,) about cam x, y (across the boresight) and z (roll) [arcsec]."""
        return np.asarray(np.sqrt(np.diag(self.covariance_rad2)) * RAD_ARCSEC)


def unlike_stars(stars: StarTable) -> NDArray[np.bool_]:
    """Detections (n,) of another shape than a star's (tracks of cosmic rays): residual above `MISFIT`, beyond noise.

    By the chi-square of a fitted PSF; a centroider that fits none rejects nothing.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        excess = (stars.chi2 - 1.0) * stars.freedom
        star = stars.flux_e**2 / stars.covariance[:, 2, 2]
        return np.asarray(excess > 4.0 * np.sqrt(2.0 * stars.freedom) + MISFIT**2 * star)


class StarTracker:
    """Attitudes from frames; keeps the last ones for tracking.

    Parameters
    ----------
    model : CameraModel
        The calibrated camera.
    guides : GuideCatalogue
        Stars to look for.
    dark_dn : (h, w), optional
        Mean frame without light, subtracted from every frame.
    noise : NoiseModel, optional
        Of a frame minus that mean; the frame's own if left out.
    centroid : str
        Centroider (`calib.measure.centroiding.registry.list_centroiders`).
    psfs, psf_place_px : sequence of EffectivePsf, (p, 2), optional
        PSFs for a centroider that needs them, and where on the detector they hold; the nearest is taken.
    window_px : int
        Side of the windows, odd.
    threshold_sigma, fwhm_px : float
        Detection limit of the acquisition, and width of its filter.
    fewest, most : int
        Stars that an attitude needs, and that are tracked at most, the brightest.
    gate_px : float
        How far a star may lie from its place after the common shift of all.
    star_error_px : float or (guides,)
        Error per axis of every guide star that the noise of a centroid does not hold (pixel patterns, colours,
        calibration): added to it in weights, covariance and the limit of outliers.
    scale_error : float
        Relative error of the image scale (temperature of the lens), added likewise: it grows with the distance from
        the middle.
    database : tetra3rs.SolverDatabase, optional
        As of `identify_stars`.
    """

    def __init__(
        self,
        model: CameraModel,
        guides: GuideCatalogue,
        *,
        dark_dn: NDArray[np.float32] | None = None,
        noise: NoiseModel | None = None,
        centroid: str = "epsf",
        psfs: Sequence[EffectivePsf] = (),
        psf_place_px: ArrayLike | None = None,
        window_px: int = 13,
        threshold_sigma: float = 5.0,
        fwhm_px: float = 1.8,
        fewest: int = 4,
        most: int = 30,
        gate_px: float = 2.0,
        star_error_px: ArrayLike = 0.0,
        scale_error: float = 0.0,
        database: Any = None,
    ) -> None:
        if not 3 <= fewest <= most:
            raise DomainError(f"fewest = {fewest}, most = {most}: 3 <= fewest <= most is needed")
        self.model, self.guides = model, guides
        self._dark, self._noise, self._window = dark_dn, noise, window_px
        self._centroid, self._psfs = centroid, tuple(psfs)
        self._centroider([])  # refuses an unknown name, or PSFs that are missing, now
        self._psf_place = np.zeros((1, 2)) if psf_place_px is None else np.asarray(psf_place_px, float)
        self._threshold, self._fwhm = threshold_sigma, fwhm_px
        self._fewest, self._most, self._gate = fewest, most, gate_px
        self._star_error = np.broadcast_to(np.asarray(star_error_px, float), (len(guides),))
        self._scale_error = scale_error
        self._database = database
        self._margin = window_px // 2 + 1.0
        self._pixel_rad = model.pixel_angle_rad
        self.reset()

    def reset(self) -> None:
        """Forget all attitudes: the next frame is searched as a whole."""
        self._last: list[tuple[float, Rotation]] = []

    def begin(self, time_s: float, attitude: Rotation) -> None:
        """Hand an attitude over, cam from icrs: that of another sensor, or of an acquisition elsewhere."""
        self._last = [(time_s, attitude)]

    def __call__(
        self,
        frame: Frame,
        time_s: float,
        *,
        velocity_km_per_s: ArrayLike | None = None,
        rate_rad_per_s: ArrayLike | None = None,
        near: Rotation | None = None,
    ) -> TrackedAttitude:
        """Attitude of a frame.

        Parameters
        ----------
        frame : Frame
            As read out.
        time_s : float
            Middle of the exposure; later than that of the frame before.
        velocity_km_per_s : (3,), optional
            Velocity of the tracker against the barycentre of the solar system, along icrs, for the aberration; left
            out: none is corrected.
        rate_rad_per_s : (3,), optional
            Rate since the last frame in axes of the camera, as a gyro gives it; left out: as between the last two
            attitudes.
        near : Rotation, optional
            Rough attitude from elsewhere; the memory is left alone: neither read nor written.

        Raises
        ------
        DomainError
            A time that is not later than the last one.
        """
        if near is None and self._last and not time_s > self._last[-1][0]:
            raise DomainError(f"time_s = {time_s:g} s, after {self._last[-1][0]:g} s; frames must be in order of time")
        velocity = None if velocity_km_per_s is None else np.asarray(velocity_km_per_s, float)
        rough = near if near is not None else self._predicted(time_s, rate_rad_per_s)
        tracked = None if rough is None else self._track(frame, time_s, rough, velocity, "tracking")
        if near is None and (tracked is None or not tracked.ok):
            tracked = self._acquire(frame, time_s, velocity)
        assert tracked is not None
        if near is None:
            self._last = [*self._last[-1:], (time_s, tracked.attitude)] if tracked.attitude is not None else []
        return tracked

    def _predicted(self, time_s: float, rate: ArrayLike | None) -> Rotation | None:
        if not self._last or time_s - self._last[-1][0] > LONGEST_GAP_S:
            return None
        last_s, attitude = self._last[-1]
        if rate is not None:
            return Rotation.from_rotvec(-np.asarray(rate, float) * (time_s - last_s)) * attitude
        if len(self._last) < 2:
            return attitude
        before_s, before = self._last[0]
        turn = (attitude * before.inv()).as_rotvec()
        return Rotation.from_rotvec(turn * (time_s - last_s) / (last_s - before_s)) * attitude

    def _track(
        self, frame: Frame, time_s: float, rough: Rotation, velocity: FloatArray | None, mode: str
    ) -> TrackedAttitude:
        row, apparent, expected_px = expected_guides(
            self.guides, self.model, rough, velocity_km_per_s=velocity, margin_px=self._margin, most=self._most
        )
        shift = self._common_shift(frame, expected_px) if len(row) else np.zeros(2)
        if np.hypot(*shift) > ROUGH_PX:
            inside = self.model.geometry.contains(expected_px + shift, margin_px=-self._margin)
            row, apparent, expected_px = row[inside], apparent[inside], expected_px[inside] + shift
        result = partial(TrackedAttitude, time_s=time_s, mode=mode, expected=len(row))
        if len(row) < self._fewest:
            return result(status="few_stars")
        stars = self._measured(frame, expected_px)
        light = stars.fit & (stars.flux_e > SNR * np.sqrt(np.maximum(stars.covariance[:, 2, 2], 0.0)))
        shift_px = stars.pixel_px - expected_px
        good = light.copy()
        if light.any():  # a rough attitude shifts all stars alike; what is off by more is something else
            distance_px = np.hypot(*(shift_px - np.median(shift_px[light], axis=0)).T)
            good &= np.nan_to_num(distance_px, nan=np.inf) <= self._gate
        used = np.flatnonzero(good)
        if len(used) < self._fewest:
            return result(status="few_stars", rejected=int(light.sum()) - len(used))
        solution, inliers = self._solved(stars, used, apparent, self._star_error[row])
        used = used[inliers]
        rejected = int(light.sum()) - len(used)
        if not solution.ok or len(used) < self._fewest:
            return result(status="few_stars", rejected=rejected)
        return result(
            status="ok",
            attitude=solution.rotation,
            covariance_rad2=solution.covariance_rad2,
            star_id=self.guides.id[row[used]],
            pixel_px=stars.pixel_px[used],
            rejected=rejected,
        )

    def _pixels(self, centre_px: FloatArray) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """First pixels (n, 2) of windows around positions, and index of all their pixels (n, window, window)."""
        corner = np.rint(centre_px).astype(np.int64) - self._window // 2
        step = np.arange(self._window)
        return corner, (corner[:, 1, None, None] + step[:, None], corner[:, 0, None, None] + step)

    def _common_shift(self, frame: Frame, expected_px: FloatArray) -> FloatArray:
        """Shift of the brightest pixels of the windows from the stars: median (2,) of the brighter half [px]."""
        corner, at = self._pixels(expected_px[: max(len(expected_px) // 2, self._fewest)])
        light = frame.dn[at] - (0.0 if self._dark is None else self._dark[at])
        peak = np.where(frame.defect[at], -np.inf, light).reshape(len(corner), -1).argmax(axis=1)
        peak_px = corner + np.stack([peak % self._window, peak // self._window], axis=-1)
        return np.asarray(np.median(peak_px - expected_px[: len(corner)], axis=0))

    def _measured(self, frame: Frame, expected_px: FloatArray) -> StarTable:
        """Centroids in windows around positions (n, 2), all of them inside the frame."""
        corner, at = self._pixels(expected_px)
        stack = WindowStack(
            dn=frame.dn[at][None],
            saturated=frame.saturated[at][None],
            defect=frame.defect[at],
            corner_px=corner,
            gain_dn_per_e=frame.gain_dn_per_e,
            offset_dn=frame.offset_dn,
            read_noise_e=frame.read_noise_e,
            exposure_s=frame.exposure_s,
            band=frame.band,
            first_index=frame.index,
        )
        stamps, noise = stamps_from_windows(stack, expected_px)
        electrons = stamps.electrons
        if self._dark is not None:
            dark = (self._dark[at] - frame.offset_dn) / frame.gain_dn_per_e
            electrons = np.where(stamps.valid, electrons - dark, 0.0)
        level = ring_background(electrons, stamps.valid)
        psf_index = self._nearest_psf(expected_px)
        stamps = replace(stamps, electrons=electrons, background_e=level, psf_index=psf_index)
        return self._fitted(stamps, noise if self._noise is None else self._noise)

    def _centroider(self, rows: Any) -> Centroider:
        """The centroider with some of the PSFs."""
        psfs = tuple(self._psfs[row] for row in rows) or self._psfs[:1]
        return get_centroider(self._centroid, **({"epsf": psfs} if psfs else {}))

    def _fitted(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Centroids; each PSF that is near a star is prepared, no other."""
        if not self._psfs:
            return self._centroider([]).measure(stamps, noise)
        rows, index = np.unique(stamps.psf_index, return_inverse=True)
        return self._centroider(rows).measure(replace(stamps, psf_index=index), noise)

    def _nearest_psf(self, position_px: FloatArray) -> NDArray[np.int64]:
        return np.asarray(((position_px[:, None] - self._psf_place) ** 2).sum(-1).argmin(1))

    def _solved(
        self, stars: StarTable, used: NDArray[np.int64], apparent: FloatArray, star_error_px: FloatArray
    ) -> tuple[AttitudeSolution, NDArray[np.bool_]]:
        v_cam, v_ref = self.model.unproject(stars.pixel_px[used]), apparent[used]
        from_centre_px = stars.pixel_px[used] - self.model.geometry.centre_px
        systematic_px2 = star_error_px[used] ** 2 + 0.5 * self._scale_error**2 * (from_centre_px**2).sum(1)
        sigma = self._pixel_rad * np.sqrt(stars.position_sigma_px[used] ** 2 + systematic_px2)
        inliers = np.asarray(np.isfinite(v_cam).all(axis=1))
        for _ in range(CLIP_ROUNDS):
            solution = solve_wahba(v_cam[inliers], v_ref[inliers], sigma_rad=sigma[inliers])
            distance = np.linalg.norm(v_cam - solution.rotation.apply(v_ref), axis=1)
            # the worst are left out first: a far star pulls the attitude, and all others beyond their limits
            limit = np.maximum(CLIP_SIGMA * sigma, 0.5 * np.nanmax(distance[inliers], initial=0.0))
            if (distance[inliers] <= CLIP_SIGMA * sigma[inliers]).all():
                break
            near = np.asarray(inliers & (distance <= limit))
            if np.count_nonzero(near) < self._fewest or np.array_equal(near, inliers):
                break
            inliers = near
        if solution.status == "inconsistent":  # stars beyond the stated errors: an attitude all the same
            solution = replace(solution, status="ok")
        return solution, inliers

    def _acquire(self, frame: Frame, time_s: float, velocity: FloatArray | None) -> TrackedAttitude:
        result = partial(TrackedAttitude, time_s=time_s, mode="acquisition")
        image = image_from_frame(frame) if self._dark is None else subtract_dark(frame, self._dark)
        if self._noise is not None:
            image = replace(image, noise=self._noise)
        try:
            background = estimate_background(image, step_px=2)
        except DomainError:  # saturated all over
            return result(status="few_stars")
        stamps = find_stamps(
            image, background=background, threshold_sigma=self._threshold, fwhm_px=self._fwhm, size_px=self._window
        )
        if not len(stamps):
            return result(status="few_stars")
        stamps = replace(stamps, psf_index=self._nearest_psf(stamps.start_px))
        stars = self._fitted(stamps, image.noise)
        flags = stars.flags | np.uint32(StarFlag.SPIKE) * unlike_stars(stars)
        stars = replace(stars, flags=flags.astype(np.uint32))
        apparent_guides = replace(self.guides, direction=_apparent(self.guides.direction, velocity))
        identified = identify_stars(stars, self.model, apparent_guides, database=self._database)
        # bright stars in sharp focus look like hot pixels; then all that shines is tried, at last the brightest alone
        shining = replace(stars, flags=stars.flags & ~np.uint32(DOUBTFUL))
        rank = np.argsort(np.argsort(-np.nan_to_num(stars.flux_e, nan=-np.inf)))
        for most in (len(stars), *BRIGHTEST):
            if not identified.ok:
                brightest = replace(shining, flux_e=np.where(rank < most, stars.flux_e, np.nan))
                identified = identify_stars(brightest, self.model, apparent_guides, database=self._database)
        if not identified.ok or identified.attitude is None:
            return result(status="few_stars" if identified.status == "too_few" else "not_identified")
        tracked = self._track(frame, time_s, identified.attitude.rotation, velocity, "acquisition")
        if tracked.ok and len(tracked.star_id) < CONFIRMED_FRACTION * tracked.expected:
            return result(status="not_confirmed", rejected=tracked.rejected, expected=tracked.expected)
        return tracked
