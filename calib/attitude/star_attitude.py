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
from calib.attitude.pattern_cache import kept_database
from calib.cameras.base import CameraModel
from calib.fitting.misfit import joined
from calib.flags import StarFlag, has_flag
from calib.records import StarTable
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.records import freeze, freeze_all
from optics.units import RAD_DEG

MATCH_PX = 1.0
LARGEST_COMMON_PX = 0.5
FEWEST = 3
CLIP_SIGMA, CLIP_ROUNDS = 3.5, 6
"""Stars beyond are left out: undetected blends, wrong partners. Of good ones 0.2 % lie there."""
FIELD_MARGIN = 0.06
"""A database of patterns is made for fields this much narrower and wider than the camera's."""
BRIGHTEST = 60
"""Detections that a rough attitude is matched with: about as deep as the catalogue, or chance matches abound."""


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
        note = self.solution.misfit.note if self.ok else self.solution.message
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
        Rough attitude, cam from icrs. Left out, tetra3rs searches the whole sky (``pip install 'starbench[solve]'``).
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
    no_star = stars.sharp | has_flag(stars.flags, StarFlag.TRAIL | StarFlag.UNDETERMINED)
    usable = np.flatnonzero(np.isfinite(stars.pixel_px).all(axis=1) & np.isfinite(stars.flux_e) & ~no_star)
    pixel, flux = stars.pixel_px[usable], stars.flux_e[usable]
    if near is not None:
        bright = usable[np.argsort(-flux, kind="stable")[:BRIGHTEST]]
        identified = _near(
            stars.pixel_px, bright, model, catalogue, near, radius_px=radius_px, tolerance_px=tolerance_px
        )
    else:
        patterns = star_patterns(model) if database is None else database
        identified = identify(pixel, model, patterns, flux=flux, catalogue=_ById(catalogue))
        if identified.status == "no_match":  # the catalogue may count its stars in another way than the patterns do
            identified = identify(pixel, model, patterns, flux=flux)
        identified = replace(identified, detected=usable[identified.detected])
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


def _near(
    pixel: FloatArray,
    rows: NDArray[np.int64],
    model: CameraModel,
    catalogue: CatalogueStars,
    near: Rotation,
    *,
    radius_px: float,
    tolerance_px: float,
) -> Identification:
    match = match_stars(
        pixel[rows], catalogue.direction, near, model, radius_px=radius_px, tolerance_px=min(tolerance_px, radius_px)
    )
    return Identification(
        status="identified" if match.ok else match.status,
        message=match.message,
        attitude=match.attitude,
        detected=rows[match.association.detected],
        catalogue_id=np.asarray(catalogue.id)[match.association.catalogue],
        direction=catalogue.direction[match.association.catalogue],
        false_match_probability=match.false_match_probability,
    )


def _field_deg(model: CameraModel) -> float:
    """Horizontal field of view."""
    middle = model.geometry.centre_px
    edge = np.array([model.geometry.width_px / 2, 0.0])
    first, last = model.unproject(np.stack([middle - edge, middle + edge]))
    return float(np.arccos(np.clip(first @ last, -1.0, 1.0)) * RAD_DEG)


def star_patterns(model: CameraModel) -> Any:
    """Patterns of the sky for a camera's field (needs tetra3rs), kept on disk: ``database`` of `identify_stars`."""
    return _database(round(_field_deg(model), 1))


@lru_cache(maxsize=4)
def _database(field_deg: float) -> Any:
    return kept_database(min_fov_deg=field_deg * (1.0 - FIELD_MARGIN), max_fov_deg=field_deg * (1.0 + FIELD_MARGIN))


class _ById(Mapping[int, FloatArray]):
    """Directions of a catalogue by identifier, without a dictionary of the whole sky."""

    def __init__(self, catalogue: CatalogueStars) -> None:
        self._catalogue, self._order = catalogue, np.argsort(catalogue.id, kind="stable")

    def __getitem__(self, identifier: int) -> FloatArray:
        rank = int(np.searchsorted(self._catalogue.id, identifier, sorter=self._order))
        if rank == len(self._order) or self._catalogue.id[self._order[rank]] != identifier:
            raise KeyError(identifier)
        return np.asarray(self._catalogue.direction[self._order[rank]])

    def __len__(self) -> int:
        return len(self._order)

    def __iter__(self) -> Iterator[int]:
        return iter(np.asarray(self._catalogue.id)[self._order].tolist())
