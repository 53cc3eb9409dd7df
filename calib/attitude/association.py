"""Association of detections with catalogue stars, for an approximately known attitude.

`associate` assumes a correct attitude: the catalogue is projected, and a detection with exactly one catalogue star
within the radius, which has no other detection within it, is a match. Detections with two candidates are ambiguous and
left out: a wrong match costs a calibration more than a missing one.

`match_stars` tolerates an attitude error. All pairs within a wide radius are candidates; two of them whose angle in the
camera equals the angle in the catalogue propose an attitude (Fischler and Bolles 1981, Commun. ACM 24, 381; all pairs
or an even selection of them, no random draw), and the attitude that explains most detections is taken. `associate` and
Wahba's problem are then iterated until the matches are stable. Where that explains nothing (false detections by the
hundred make most pairs wrong), all pairs first vote on the correction of the attitude (Hough transform: cells of the
rotation vector), and only those of the fullest cell propose. The result is accepted if the number of matches is
improbable by chance (`calib.attitude.false_match_probability`). Otherwise the flipped image is tried, to distinguish a
mirrored sky from an empty one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from calib.attitude.attitude_solution import AttitudeSolution, solve_wahba, solve_wahba_many
from calib.attitude.false_match_probability import false_match_probability
from calib.cameras.base import CameraModel
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all

MAX_CANDIDATES = 600  # candidates from which proposals are made
MAX_PROPOSALS = 2000  # attitudes that are tried
LARGEST_FALSE_MATCH_PROBABILITY = 1e-6  # above it no match is claimed
MAX_ROUNDS = 20
MAX_PAIRS = 10_000  # that propose before a vote
CELLS = 50  # of a vote, at most, from the given direction to the radius


@dataclass(frozen=True, slots=True, kw_only=True)
class Association:
    """Matches of one frame, one to one."""

    # (k,) Row of the detection and of the catalogue star of each match, in the order of the detections
    detected: IntArray
    catalogue: IntArray
    distance_px: FloatArray  # (k,) From the detection to the projected star [px]
    # (a,) Detections with more than one possible star, or with a star that has more than one detection
    ambiguous: IntArray
    in_field: int  # Catalogue stars that are projected onto the detector

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, detected=("k",), catalogue=("k",), sizes=sizes, dtype=np.int64)
        freeze(self, "distance_px", shape=("k",), sizes=sizes)
        freeze(self, "ambiguous", shape=("a",), dtype=np.int64)

    def __len__(self) -> int:
        return len(self.detected)


@dataclass(frozen=True, slots=True, kw_only=True)
class StarMatch:
    """Result of `match_stars`."""

    # ``"matched"``; ``"too_few"``: fewer than three detections or catalogue stars to work with; ``"no_match"``;
    # ``"mirrored"``: no attitude fits, but one does after an axis of the image was flipped
    status: str
    message: str  # One line on what happened
    association: Association  # The matches; empty unless matched
    # Attitude from the matches (all weighing the same, sigma estimated); None unless matched
    attitude: AttitudeSolution | None
    false_match_probability: float  # Of as many matches by chance

    @property
    def ok(self) -> bool:
        """Whether the stars were matched."""
        return self.status == "matched"


class _Pairs(NamedTuple):
    """Detections and catalogue stars closer than a radius: rows of both, distance [px], and stars on the detector."""

    detected: IntArray
    catalogue: IntArray
    distance_px: FloatArray
    in_field: int


def associate(
    pixel_px: ArrayLike,
    catalogue_direction: ArrayLike,
    attitude: Rotation,
    model: CameraModel,
    *,
    radius_px: float,
    band: int = 0,
) -> Association:
    """Match detections to catalogue stars by a known attitude and camera.

    Parameters
    ----------
    pixel_px : (n, 2)
        Positions (column, row) of the detections [px]; rows that are not finite are never matched.
    catalogue_direction : (m, 3)
        Unit vectors of the catalogue in the reference frame; all of the sky is fine.
    attitude : Rotation
        cam from reference.
    model : CameraModel
        The camera.
    radius_px : float
        Largest distance of a match [px]. Two candidates within it make a detection ambiguous, so that it should not be
        much larger than attitude and model require.
    band : int
        Band of the frame, for models that depend on it.

    Returns
    -------
    Association
        Pairs of detections and catalogue stars, their distances [px], and what is ambiguous.

    Raises
    ------
    DomainError
        On wrong shapes, directions that are not unit vectors, or a radius that is not positive.
    """
    pixel, direction = _checked(pixel_px, catalogue_direction, attitude, radius_px)
    pairs = _pairs_within(pixel, direction, attitude, model, radius_px, band)
    return _one_to_one(pairs, len(pixel), len(direction))


def match_stars(
    pixel_px: ArrayLike,
    catalogue_direction: ArrayLike,
    attitude: Rotation,
    model: CameraModel,
    *,
    radius_px: float,
    tolerance_px: float = 2.0,
    band: int = 0,
) -> StarMatch:
    """Match detections to catalogue stars by a rough attitude, and refine it.

    Parameters
    ----------
    pixel_px : (n, 2)
        Positions (column, row) of the detections [px]; false ones among them are tolerated, rows that are not finite
        are left out.
    catalogue_direction : (m, 3)
        Unit vectors of the catalogue in the reference frame; about as deep as the detections, or chance matches abound.
    attitude : Rotation
        cam from reference, roughly.
    model : CameraModel
        The camera, good to ``tolerance_px`` apart from the attitude.
    radius_px : float
        How far from its place the rough attitude may put a star [px].
    tolerance_px : float
        How far from its place the right attitude may put it [px]: centroid and camera model.
    band : int
        Band of the frame.

    Returns
    -------
    StarMatch
        The pairs and the refined attitude.

    Raises
    ------
    DomainError
        As `associate`.
    """
    pixel, direction = _checked(pixel_px, catalogue_direction, attitude, radius_px)
    if not (np.isfinite(tolerance_px) and 0 < tolerance_px <= radius_px):
        raise DomainError(
            f"tolerance_px = {tolerance_px} px; it must be positive and at most radius_px = {radius_px} px"
        )
    match = _match(pixel, direction, attitude, model, radius_px, tolerance_px, band)
    if match.status != "no_match":
        return match
    width, height = model.geometry.width_px, model.geometry.height_px
    flips = {
        "columns run backwards": np.column_stack([width - 1 - pixel[:, 0], pixel[:, 1]]),
        "rows run backwards": np.column_stack([pixel[:, 0], height - 1 - pixel[:, 1]]),
        "columns and rows are exchanged": pixel[:, ::-1],
    }
    for flip, flipped in flips.items():
        mirrored = _match(flipped, direction, attitude, model, radius_px, tolerance_px, band)
        if mirrored.ok:
            count = len(mirrored.association)
            message = f"mirrored sky: {count} stars match if {flip}; correct the axes of the image"
            return replace(match, status="mirrored", message=message)
    return match


def _checked(
    pixel_px: ArrayLike, catalogue_direction: ArrayLike, attitude: Rotation, radius_px: float
) -> tuple[FloatArray, FloatArray]:
    pixel, direction = np.asarray(pixel_px, float), np.asarray(catalogue_direction, float)
    if pixel.ndim != 2 or pixel.shape[1] != 2:
        raise DomainError(f"pixel_px has shape {pixel.shape}; positions (column, row) of shape (n, 2) are needed")
    if direction.ndim != 2 or direction.shape[1] != 3:
        raise DomainError(f"catalogue_direction has shape {direction.shape}; unit vectors of shape (m, 3) are needed")
    length = np.sqrt(np.einsum("mi,mi->m", direction, direction))
    if not (np.abs(length - 1) < 1e-6).all():
        row = int(np.flatnonzero(~(np.abs(length - 1) < 1e-6))[0])
        raise DomainError(f"catalogue_direction: row {row} has length {length[row]:.6g}; unit vectors are needed")
    if not isinstance(attitude, Rotation) or not attitude.single:
        raise DomainError("attitude: a single scipy Rotation, cam from reference, is needed")
    if not (np.isfinite(radius_px) and radius_px > 0):
        raise DomainError(f"radius_px = {radius_px} px; it must be finite and positive")
    return pixel, direction


def _pairs_within(
    pixel: FloatArray, direction: FloatArray, attitude: Rotation, model: CameraModel, radius_px: float, band: int
) -> _Pairs:
    corners = model.unproject(model.geometry.corners_px)
    axis_cosine = np.nanmin(np.append(corners[:, 2], 1.0))
    # A little more than the field, so that the exact question is asked of few stars only.
    reach = 1.2 * np.arccos(np.clip(axis_cosine, -1.0, 1.0)) + radius_px * model.pixel_angle_rad
    boresight = attitude.inv().apply([0.0, 0.0, 1.0])
    near = np.flatnonzero(direction @ boresight >= np.cos(min(reach, np.pi)))
    v_cam = attitude.apply(direction[near]) if len(near) else np.empty((0, 3))
    visible = model.visible(v_cam, band, margin_px=radius_px)
    near, star_px = near[visible], model.project(v_cam[visible], band)
    on_detector = int(np.count_nonzero(model.geometry.contains(star_px)))
    usable = np.flatnonzero(np.isfinite(pixel).all(axis=1))
    if not len(near) or not len(usable):
        return _Pairs(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), on_detector)
    close = cKDTree(pixel[usable]).sparse_distance_matrix(cKDTree(star_px), radius_px, output_type="ndarray")
    order = np.lexsort((close["j"], close["i"]))
    return _Pairs(usable[close["i"][order]], near[close["j"][order]], close["v"][order], on_detector)


def _one_to_one(pairs: _Pairs, detections: int, stars: int) -> Association:
    single = np.bincount(pairs.detected, minlength=detections)[pairs.detected] == 1
    single &= np.bincount(pairs.catalogue, minlength=stars)[pairs.catalogue] == 1
    return Association(
        detected=pairs.detected[single],
        catalogue=pairs.catalogue[single],
        distance_px=pairs.distance_px[single],
        ambiguous=np.unique(pairs.detected[~single]),
        in_field=pairs.in_field,
    )


def _match(
    pixel: FloatArray,
    direction: FloatArray,
    attitude: Rotation,
    model: CameraModel,
    radius_px: float,
    tolerance_px: float,
    band: int,
) -> StarMatch:
    v_cam = _unprojected(pixel, model, band)
    with_direction = np.asarray(np.isfinite(v_cam).all(axis=1))
    pixel, usable = np.where(with_direction[:, None], pixel, np.nan), int(np.count_nonzero(with_direction))
    pairs = _pairs_within(pixel, direction, attitude, model, radius_px, band)
    stars = len(np.unique(pairs.catalogue))
    if usable < 3 or min(stars, len(np.unique(pairs.detected))) < 3:
        return _unmatched(
            "too_few",
            f"{usable} usable detections and {stars} catalogue stars within {radius_px:g} px of one of them: at least "
            "3 of both are needed",
        )
    tolerance_rad = tolerance_px * model.pixel_angle_rad
    cell_rad = max(tolerance_px, radius_px / CELLS) * model.pixel_angle_rad
    for vote in (False, True) if len(pairs.detected) <= MAX_PAIRS else (True,):
        chosen, cells = pairs, 1
        if vote:
            v_rough = attitude.apply(direction[pairs.catalogue])
            rows, cells = _voted(v_cam[pairs.detected], v_rough, radius_px * model.pixel_angle_rad, cell_rad)
            chosen = _Pairs(pairs.detected[rows], pairs.catalogue[rows], pairs.distance_px[rows], pairs.in_field)
        best, proposals = _best_proposal(v_cam[chosen.detected], direction[chosen.catalogue], chosen, tolerance_rad)
        association, solution = _refined(pixel, v_cam, direction, best, model, tolerance_px, band)
        probability = false_match_probability(
            len(association),
            usable,
            cells * proposals,
            stars=association.in_field,
            radius_px=tolerance_px,
            area_px2=model.geometry.width_px * model.geometry.height_px,
        )
        if solution is not None and solution.status != "degenerate" and probability <= LARGEST_FALSE_MATCH_PROBABILITY:
            break
    else:
        return _unmatched(
            "no_match",
            f"no attitude within {radius_px:g} px of the given one explains the {usable} detections: "
            f"{len(association)} match, which chance gives with probability {probability:.2g}",
            probability,
        )
    return StarMatch(
        status="matched",
        message=f"{len(association)} of {usable} detections matched, up to {association.distance_px.max():.3g} px from "
        f"their places, {len(association.ambiguous)} ambiguous",
        association=association,
        attitude=solution,
        false_match_probability=probability,
    )


_NO_MATCHES = Association(
    detected=np.empty(0, np.int64),
    catalogue=np.empty(0, np.int64),
    distance_px=np.empty(0),
    ambiguous=np.empty(0, np.int64),
    in_field=0,
)


def _unmatched(status: str, message: str, probability: float = 1.0) -> StarMatch:
    return StarMatch(
        status=status,
        message=message,
        association=_NO_MATCHES,
        attitude=None,
        false_match_probability=probability,
    )


def _unprojected(pixel: FloatArray, model: CameraModel, band: int) -> FloatArray:
    """Directions (n, 3) of the detections, NaN where there is none."""
    v_cam = np.full((len(pixel), 3), np.nan)
    finite = np.isfinite(pixel).all(axis=1)
    v_cam[finite] = model.unproject(pixel[finite], band)
    return v_cam


def _refined(
    pixel: FloatArray,
    v_cam: FloatArray,
    direction: FloatArray,
    attitude: Rotation | None,
    model: CameraModel,
    tolerance_px: float,
    band: int,
) -> tuple[Association, AttitudeSolution | None]:
    """Association and attitude in turn, until the matches stay; no attitude from fewer than three."""
    association: Association = _NO_MATCHES
    solution: AttitudeSolution | None = None
    for _ in range(MAX_ROUNDS if attitude is not None else 0):
        assert attitude is not None
        pairs = _pairs_within(pixel, direction, attitude, model, tolerance_px, band)
        previous, association = association, _one_to_one(pairs, len(pixel), len(direction))
        if len(association) < 3:
            return association, None
        solution = solve_wahba(v_cam[association.detected], direction[association.catalogue])
        attitude = solution.rotation
        if np.array_equal(previous.detected, association.detected) and np.array_equal(
            previous.catalogue, association.catalogue
        ):
            break
    return association, solution


def _best_proposal(
    v_cam: FloatArray, v_ref: FloatArray, pairs: _Pairs, tolerance_rad: float
) -> tuple[Rotation | None, int]:
    """The attitude, proposed by two of the candidates (c, 3), that explains most detections, and their number."""
    candidates = _evenly(len(v_cam), MAX_CANDIDATES)
    first, second = (candidates[index] for index in np.triu_indices(len(candidates), 1))
    different = (pairs.detected[first] != pairs.detected[second]) & (pairs.catalogue[first] != pairs.catalogue[second])
    first, second = first[different], second[different]
    in_camera = np.linalg.norm(v_cam[first] - v_cam[second], axis=1)
    in_catalogue = np.linalg.norm(v_ref[first] - v_ref[second], axis=1)
    # Both ends may be off by the tolerance. Short baselines say too little about the roll.
    equal = (np.abs(in_camera - in_catalogue) < 2 * tolerance_rad) & (in_camera > 20 * tolerance_rad)
    first, second = first[equal], second[equal]
    chosen = _evenly(len(first), MAX_PROPOSALS)
    if not len(chosen):
        return None, 0
    rows = np.stack([first[chosen], second[chosen]], axis=1).ravel()
    solved = solve_wahba_many(v_cam[rows], v_ref[rows], np.repeat(np.arange(len(chosen)), 2))
    matrix = solved.rotation.as_matrix()
    # |v_cam - R v_ref|^2 = 2 - 2 v_cam . R v_ref, as one product of (proposals, 9) and (9, candidates).
    outer = (v_cam[:, :, None] * v_ref[:, None, :]).reshape(-1, 9)
    distance2 = np.maximum(2.0 - 2.0 * matrix.reshape(-1, 9) @ outer.T, 0.0)
    # Twice the tolerance: the two stars that made a proposal carry their own errors across the field.
    score = np.maximum(1.0 - distance2 / (2 * tolerance_rad) ** 2, 0.0)
    starts = np.flatnonzero(np.diff(pairs.detected, prepend=-1))
    total = np.maximum.reduceat(score, starts, axis=1).sum(axis=1)
    return Rotation.from_matrix(matrix[int(np.argmax(total))]), len(chosen)


def _voted(v_cam: FloatArray, v_rough: FloatArray, radius_rad: float, cell_rad: float) -> tuple[IntArray, int]:
    """Candidates (c, 3) that agree on one correction of the attitude, and the number of cells that were compared.

    For every roll the tilt is computed that turns a catalogue direction u in the rough camera into the measured v: with
    the axis w across the boresight, v - u = w x (u + v) / 2, exactly, of length 2 tan(angle / 2).
    """
    sine = float(np.max(np.hypot(v_cam[:, 0], v_cam[:, 1]), initial=cell_rad))
    steps = int(np.ceil(min(2.0 * radius_rad / cell_rad, np.pi * sine / cell_rad)))
    rolls = np.arange(-steps, steps + 1) * cell_rad / sine  # one cell at the edge of the field
    side = 2 * int(np.ceil(2.0 * radius_rad / cell_rad)) + 2
    most, agreeing = 0, np.empty(0, np.int64)
    for roll in rolls:
        x = np.cos(roll) * v_rough[:, 0] - np.sin(roll) * v_rough[:, 1]
        y = np.sin(roll) * v_rough[:, 0] + np.cos(roll) * v_rough[:, 1]
        depth = np.maximum(0.5 * (v_rough[:, 2] + v_cam[:, 2]), cell_rad)
        column = np.floor((v_cam[:, 0] - x) / (depth * cell_rad)).astype(np.int64) + side // 2
        row = np.floor((v_cam[:, 1] - y) / (depth * cell_rad)).astype(np.int64) + side // 2
        inside = np.flatnonzero((column >= 0) & (column < side) & (row >= 0) & (row < side))
        column, row = column[inside], row[inside]
        votes = np.bincount(row * side + column, minlength=side * side).reshape(side, side)
        blocks = votes[1:, 1:] + votes[1:, :-1] + votes[:-1, 1:] + votes[:-1, :-1]  # a peak may lie on a border
        top, first = np.unravel_index(int(np.argmax(blocks)), blocks.shape)
        if blocks[top, first] > most:
            most = int(blocks[top, first])
            agreeing = inside[(row - top >= 0) & (row - top < 2) & (column - first >= 0) & (column - first < 2)]
    return agreeing, len(rolls) * side * side


def _evenly(count: int, limit: int) -> IntArray:
    """At most ``limit`` of the numbers 0 to count - 1, evenly spread."""
    if count <= limit:
        return np.arange(count)
    return np.asarray(np.linspace(0, count - 1, limit).round(), np.int64)
