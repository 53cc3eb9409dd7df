"""Attitude from the measured stars of one frame: identification, then a weighted fit of all stars.

The weights combine the centroids' own covariances and an unmodelled common error (undersampling, colour), chosen such
that the residuals match their expectation, after R. C. Paule and J. Mandel, J. Res. NBS 87, 377 (1982), here by their
median. Stars beyond 3.5 sigma are left out: undetected blends, wrong partners.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from calib.attitude.association import associate, match_stars
from calib.attitude.attitude_solution import AttitudeSolution, solve_wahba
from calib.attitude.identify import Identification, identify, with_residuals
from calib.attitude.pattern_cache import camera_database
from calib.cameras.base import CameraModel
from calib.fitting.misfit import SAME_SPREAD, joined
from calib.flags import StarFlag, has_flag
from calib.records import StarTable
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.errors import ConfigError, DomainError
from optics.records import freeze, freeze_all
from optics.units import RAD_DEG

MATCH_PX = 1.0
LARGEST_COMMON_PX = 0.5
FEWEST, FEWEST_LOST_IN_SPACE = 3, 4
CLIP_SIGMA, CLIP_ROUNDS = 3.5, 6
"""Stars beyond are left out: undetected blends, wrong partners. Of good ones 0.2 % lie there."""
BRIGHTEST = 60
"""Detections that a rough attitude is matched with first: about as deep as the catalogue, or chance matches abound. All
are taken where these are not explained: many bright false stars."""
MOST_PATTERN_STARS = 60
"""Brightest detections that form patterns where the usual 24 do not help. Of 25 frames with 60 false stars as bright as
the brightest real ones 4 to 6 are identified with 24, 23 to 25 with 60; a search in vain takes 0.5 s."""
NARROWEST_BLIND_DEG = 2.0
"""Field below which patterns contain too few stars: of 40 random attitudes with stars to 9.5 mag, 40 were solved blind
at 2 deg and 36 at 1.5 deg."""


class CatalogueStars(Protocol):
    """The catalogue that attitudes are solved with, such as `render.sky.sky.Sky`."""

    @property
    def id(self) -> NDArray[np.int64]:
        """Identifiers (n,)."""
        ...

    @property
    def direction(self) -> FloatArray:
        """Unit vectors (n, 3) along icrs, as the camera sees them: aberration included if the frame has it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class StarAttitude:
    """Attitude of a frame from its stars.

    Attributes
    ----------
    solution : AttitudeSolution
        Rotation cam from icrs, covariance, status.
    detected, catalogue : (k,) int64
        Rows of the stars that it was made of: in the star table and in the catalogue.
    residual_px : (k, 2)
        Measured position minus that of the catalogue star in this attitude.
    common_px : float
        Common centroid error per axis, in addition to the covariances, implied by the residuals; NaN if too few stars.
    """

    solution: AttitudeSolution
    detected: NDArray[np.int64]
    catalogue: NDArray[np.int64]
    residual_px: FloatArray
    common_px: float

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, detected=("k",), catalogue=("k",), sizes=sizes, dtype=np.int64)
        freeze(self, "residual_px", shape=("k", 2), sizes=sizes)

    def __repr__(self) -> str:
        x, y, z = self.sigma_arcsec
        text = f"{len(self)} stars, sigma {x:.3g}, {y:.3g}, {z:.3g} arcsec"
        common = f"{self.common_px:.2g} px in addition to the stated noise" if self.common_px > 0 else ""
        note = self.solution.message.removeprefix(f"{len(self)} stars").removeprefix("; ")
        return f"<StarAttitude {self.solution.status}: {joined(text, common, note)}>"

    def __len__(self) -> int:
        return len(self.detected)

    @property
    def ok(self) -> bool:
        """Whether the attitude can be used."""
        return self.solution.ok

    @property
    def rotation(self) -> Rotation:
        """Attitude, cam from icrs."""
        return self.solution.rotation

    @property
    def sigma_arcsec(self) -> FloatArray:
        """Predicted standard deviation (3,) about cam x, y (across the boresight) and z (roll)."""
        return self.solution.sigma_arcsec

    def error_arcsec(self, truth: Rotation) -> FloatArray:
        """Error (3,) about cam x, y (across the boresight) and z (roll) against a true attitude, cam from icrs."""
        return attitude_error_arcsec(self.rotation, truth)


def identify_stars(
    stars: StarTable,
    model: CameraModel,
    catalogue: CatalogueStars,
    *,
    near: Rotation | None = None,
    radius_px: float = 50.0,
    tolerance_px: float = 2.0,
    model_error_px: float = 0.0,
    database: Any = None,
) -> Identification:
    """Identify the stars of a frame, lost in space or near a rough attitude.

    Parameters
    ----------
    stars : StarTable
        Measured stars (`calib.find_stars`); stars flagged as hot pixels or trails are not used.
    model : CameraModel
        The camera.
    catalogue : CatalogueStars
        The sky.
    near : Rotation, optional
        Rough attitude, cam from icrs. Left out, tetra3rs searches the whole sky (``pip install 'starbench[solve]'``);
        so it does, where it is installed, if the stars fit no attitude near the given one.
    radius_px : float
        How far from its place the rough attitude may put a star.
    tolerance_px : float
        How far from its place the right attitude may put it.
    model_error_px : float
        Allowed error of the camera model per axis, in addition to the noise of the stars; stars beyond both are listed
        in ``beyond`` and in the message.
    database : tetra3rs.SolverDatabase, optional
        Patterns (`calib.attitude.identify.build_database`); if left out, those for the field of the camera, which are
        kept on disk.

    Returns
    -------
    Identification
        ``ok``, or a status that says why not; ``detected`` counts in ``stars``.

    Raises
    ------
    ConfigError
        tetra3rs is needed and missing.
    """
    finite = np.isfinite(stars.pixel_px).all(axis=1) & np.isfinite(stars.flux_e)
    no_star = stars.sharp | has_flag(stars.flags, StarFlag.TRAIL | StarFlag.UNDETERMINED)
    usable = np.flatnonzero(finite & ~no_star)
    if near is None:
        patterns = star_patterns(model) if database is None else database
        identified = _lost_in_space(stars, usable, np.flatnonzero(finite), model, catalogue, patterns)
    else:
        identified = _near(
            stars, usable, model, catalogue, near, radius_px=radius_px, tolerance_px=min(tolerance_px, radius_px)
        )
        if identified.status in ("no_match", "too_few"):
            identified = _searched(identified, stars, usable, np.flatnonzero(finite), model, catalogue, near, database)
    sigma_px = stars.position_sigma_px
    stated = np.isfinite(sigma_px[identified.detected]).all()
    return with_residuals(identified, stars.pixel_px, model, sigma_px if stated else None, model_error_px)


def solve_attitude(
    stars: StarTable,
    identified: Identification,
    model: CameraModel,
    catalogue: CatalogueStars,
    *,
    match_px: float = MATCH_PX,
) -> StarAttitude:
    """Attitude from all stars of a frame that match a catalogue star.

    Parameters
    ----------
    stars : StarTable
        Measured stars; those without a flag against them (`StarTable.fit`) are used.
    identified : Identification
        Gives the attitude that stars are looked up with (`identify_stars`).
    model : CameraModel
        The camera.
    catalogue : CatalogueStars
        The sky.
    match_px : float
        Largest distance of a star from its place.

    Returns
    -------
    StarAttitude
        Not `ok`, and without a star, if none were identified.
    """
    if not identified.ok or identified.attitude is None:
        return _without_stars(solve_wahba(np.empty((0, 3)), np.empty((0, 3))))
    fit = np.flatnonzero(stars.fit)
    pixel = stars.pixel_px[fit]
    pairs = associate(pixel, catalogue.direction, identified.attitude.rotation, model, radius_px=match_px)
    if len(pairs) < FEWEST:
        return _without_stars(identified.attitude)
    covariance = stars.covariance[fit[pairs.detected]]
    variance = (covariance[:, 0, 0] + covariance[:, 1, 1]) / 2.0
    v_cam, v_ref = model.unproject(pixel[pairs.detected]), catalogue.direction[pairs.catalogue]
    solution, inliers, common_px = balanced_attitude(v_cam, v_ref, variance, model.pixel_angle_rad)
    residual_px = pixel[pairs.detected] - model.project(solution.rotation.apply(v_ref))
    return StarAttitude(
        solution=solution,
        detected=fit[pairs.detected][inliers],
        catalogue=pairs.catalogue[inliers],
        residual_px=residual_px[inliers],
        common_px=common_px,
    )


def _without_stars(solution: AttitudeSolution) -> StarAttitude:
    rows = np.empty(0, np.int64)
    return StarAttitude(
        solution=solution, detected=rows, catalogue=rows, residual_px=np.empty((0, 2)), common_px=float("nan")
    )


def balanced_attitude(
    v_cam: FloatArray, v_ref: FloatArray, variance_px2: FloatArray, pixel_rad: float
) -> tuple[AttitudeSolution, NDArray[np.bool_], float]:
    """Attitude with outliers left out and a common error that makes the residuals as large as they should be.

    Without outliers a sum of squares that is improbable by chance but within `SAME_SPREAD` is a small error of the
    camera model, which thousands of stars show: the attitude is accepted, its message states the excess.

    Shapes: ``v_cam`` (n, 3), ``v_ref`` (n, 3), ``variance_px2`` (n,).
    """
    v_ref = np.array(v_ref)  # SciPy's rotations refuse write-locked arrays, such as those of records
    inliers = np.ones(len(v_cam), bool)
    for _ in range(CLIP_ROUNDS):
        solution, common_px = _balanced(v_cam[inliers], v_ref[inliers], variance_px2[inliers], pixel_rad)
        distance_px = np.linalg.norm(v_cam - solution.rotation.apply(v_ref), axis=1) / pixel_rad
        near = distance_px < CLIP_SIGMA * np.sqrt(variance_px2 + common_px**2)
        if np.array_equal(near, inliers) or np.count_nonzero(near) < max(FEWEST, len(inliers) // 2):
            break
        inliers = near
    if solution.status == "inconsistent" and solution.parity >= 0 and solution.misfit.ratio <= SAME_SPREAD:
        excess = f"loss {solution.loss:.4g} where {solution.expected_loss:.4g} is expected: residuals are "
        excess += f"{solution.misfit.ratio:.3g} times their stated sigma, which the covariance does not include"
        solution = replace(solution, status="ok", message=f"{solution.stars} stars; {excess}")
    return solution, inliers, common_px


def _balanced(
    v_cam: FloatArray, v_ref: FloatArray, variance_px2: FloatArray, pixel_rad: float
) -> tuple[AttitudeSolution, float]:
    def solved(common_px: float) -> AttitudeSolution:
        return solve_wahba(v_cam, v_ref, sigma_rad=pixel_rad * np.sqrt(variance_px2 + common_px**2))

    def excess(common_px: float) -> float:
        distance_px = np.linalg.norm(v_cam - solved(common_px).rotation.apply(v_ref), axis=1) / pixel_rad
        typical = float(np.median(distance_px**2 / (variance_px2 + common_px**2))) / (2.0 * np.log(2.0))
        return typical - (2 * len(v_cam) - 3) / (2 * len(v_cam))

    if excess(0.0) <= 0.0:
        return solved(0.0), 0.0
    if excess(LARGEST_COMMON_PX) > 0.0:
        return solved(LARGEST_COMMON_PX), LARGEST_COMMON_PX
    common_px = float(brentq(excess, 0.0, LARGEST_COMMON_PX, xtol=1e-3))
    return solved(common_px), common_px


def _lost_in_space(
    stars: StarTable,
    usable: NDArray[np.int64],
    finite: NDArray[np.int64],
    model: CameraModel,
    catalogue: CatalogueStars,
    patterns: Any,
) -> Identification:
    """Identification by patterns of the usable rows, then of all: a narrow PSF may look like hot pixels; at last by
    patterns of more stars, among bright false ones."""
    by_id = _ById(catalogue)
    for rows in (usable, finite) if len(finite) > len(usable) else (usable,):
        # the catalogue may count its stars in another way than the patterns do
        for directions in (by_id, None):
            identified = identify(stars.pixel_px[rows], model, patterns, flux=stars.flux_e[rows], catalogue=directions)
            if identified.status != "no_match":
                return replace(identified, detected=rows[identified.detected])
    identified = identify(
        stars.pixel_px[usable],
        model,
        patterns,
        flux=stars.flux_e[usable],
        catalogue=by_id,
        pattern_stars=MOST_PATTERN_STARS,
    )
    return replace(identified, detected=usable[identified.detected])


def _near(
    stars: StarTable,
    usable: NDArray[np.int64],
    model: CameraModel,
    catalogue: CatalogueStars,
    near: Rotation,
    *,
    radius_px: float,
    tolerance_px: float,
) -> Identification:
    order = usable[np.argsort(-stars.flux_e[usable], kind="stable")]
    for rows in (order[:BRIGHTEST], order) if len(order) > BRIGHTEST else (order,):
        match = match_stars(
            stars.pixel_px[rows], catalogue.direction, near, model, radius_px=radius_px, tolerance_px=tolerance_px
        )
        if match.status not in ("no_match", "too_few"):
            break
    return Identification(
        status="identified" if match.ok else match.status,
        message=match.message,
        attitude=match.attitude,
        detected=rows[match.association.detected],
        catalogue_id=np.asarray(catalogue.id)[match.association.catalogue],
        direction=catalogue.direction[match.association.catalogue],
        false_match_probability=match.false_match_probability,
    )


def _searched(
    unmatched: Identification,
    stars: StarTable,
    usable: NDArray[np.int64],
    finite: NDArray[np.int64],
    model: CameraModel,
    catalogue: CatalogueStars,
    near: Rotation,
    database: Any,
) -> Identification:
    """What the whole sky says of stars that fit no attitude near the given one; the latter's failure if nothing."""
    try:
        if database is None:
            if max(_field_deg(model)) < NARROWEST_BLIND_DEG or len(usable) < FEWEST_LOST_IN_SPACE:
                return unmatched
            database = star_patterns(model)
        searched = _lost_in_space(stars, usable, finite, model, catalogue, database)
    except (ConfigError, DomainError):  # without tetra3rs, or in a field without patterns
        return unmatched
    if not searched.ok or searched.attitude is None:
        return unmatched
    error_deg = (searched.attitude.rotation * near.inv()).magnitude() * RAD_DEG
    return replace(searched, message=joined(searched.message, f"the given attitude is {error_deg:.3g} deg off"))


def _field_deg(model: CameraModel) -> tuple[float, float]:
    """Horizontal and vertical field of view."""
    geometry = model.geometry
    half = np.diag([geometry.width_px / 2, geometry.height_px / 2])
    first, last = (model.unproject(geometry.centre_px + side * half) for side in (-1, 1))
    width, height = np.arccos(np.clip(np.sum(first * last, axis=1), -1.0, 1.0)) * RAD_DEG
    return float(width), float(height)


def star_patterns(model: CameraModel) -> Any:
    """Patterns of the sky for a camera's field (needs tetra3rs), kept on disk: ``database`` of `identify_stars`."""
    width, height = _field_deg(model)
    return _database(round(width, 1), round(height, 1))


@lru_cache(maxsize=4)
def _database(width_deg: float, height_deg: float) -> Any:
    return camera_database(width_deg, height_deg)


class _ById(Mapping[int, FloatArray]):
    """Directions of a catalogue by identifier, without a dictionary of the whole sky."""

    def __init__(self, catalogue: CatalogueStars) -> None:
        self._catalogue, self._order = catalogue, np.argsort(catalogue.id)

    def __getitem__(self, identifier: int) -> FloatArray:
        rank = int(np.searchsorted(self._catalogue.id, identifier, sorter=self._order))
        if rank == len(self._order) or self._catalogue.id[self._order[rank]] != identifier:
            raise KeyError(identifier)
        return np.asarray(self._catalogue.direction[self._order[rank]])

    def __len__(self) -> int:
        return len(self._order)

    def __iter__(self) -> Iterator[int]:
        return iter(np.asarray(self._catalogue.id)[self._order].tolist())
