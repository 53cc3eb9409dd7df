"""Orientation of a cube mirror and a sun sensor from a turntable: the reduction of CUBE09, with its errors corrected.

Frames. The table carries sensor and cube. At angles (outer, inner) = (a, b) its top stands at
``v_lab = Rot(X', a) Rot(Y', b) v_table`` (outer axis X' fixed in the laboratory, inner axis Y' carried by it; CUBE09,
section 2 and eq. 9-10). The simulated sun is at ``s = (0, 0, 1)`` in the laboratory. A face whose normal returns the
light into its own aperture has that normal along s, whichever face it is (eq. 7, and eq. 8 with its n2 replaced by s):

    r = Rot(Y', b)^-1 Rot(X', a)^-1 s = (-sin b cos a, sin a, cos b cos a).

Which angle is which. The text of CUBE09 (section 2, steps 2 and 3, the sentence after Table 1) gives X' to the outer
axis and the large angles, 180 and 90 deg, to the inner one; eq. 7 and the heads of Table 1 give the large angles to
X'. Both cannot be: with X' outer at 90 deg the inner axis points along the light, so that turning it moves no spot,
and the published trims of theta4 (20.2 to 0.4 px) could not have happened. Here the large angle is
the inner one, Y', and the second face is the one with normal X, which the paper calls YZ: n2 = (1, 0, 0).

Cube frame (ECSS): Z is the normal of the first face, X the part of the second normal that is square to Z, Y completes.
TRIAD gives exactly this frame, so faces that are not square to each other do no harm: only their angle is noted.

Order of matrices. With the rows a^T, b^T, c^T of eq. 2 and 4, eq. 5 does not chain; they have to stand as columns. With
``M_n = [a b c]`` of the cube's normals and ``M_r`` of the same directions in the table frame, ``R_pr = M_n M_r^T``
takes table to cube, R_sr table to sensor, and ``R_sp = R_pr R_sr^-1`` takes a sun vector of the sensor into the cube
frame, as eq. 12 wants it. The printed order of eq. 11, ``R_rs^-1 R_pr``, holds for row vectors.

Errors. Every error here is a rotation vector e in the cube frame, ``R_estimated = exp([e]x) R_true``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.link import skew
from calib.attitude.solve import solve_wahba
from calib.fitting.misfit import UNTESTED, ChiSquare
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import RAD_DEG

SUN_LAB = (0.0, 0.0, 1.0)
PARALLEL_RAD = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class MirrorSolution:
    """Cube mirror against table."""

    rotation: Rotation  # R_pr, cube from table
    covariance_rad2: FloatArray  # (3, 3) Of the error's rotation vector in the cube frame
    face_angle_rad: float  # Between the first two normals
    # Whether the measured normals agree with one another, and with the cube's by Wahba's problem, as their
    # covariances state; not tested for TRIAD of two faces measured once
    misfit: ChiSquare = UNTESTED

    def __post_init__(self) -> None:
        freeze(self, "covariance_rad2", shape=(3, 3))


def table_matrix(outer_rad: float, inner_rad: float) -> FloatArray:
    """Laboratory from table (3, 3), ``Rot(X', outer) Rot(Y', inner)`` with the matrices of CUBE09 eq. 9 and 10."""
    ca, sa, cb, sb = np.cos(outer_rad), np.sin(outer_rad), np.cos(inner_rad), np.sin(inner_rad)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    return np.asarray(about_x @ about_y)


def normal_in_table(outer_rad: float, inner_rad: float, lab: ArrayLike = SUN_LAB) -> FloatArray:
    """Direction in the table frame (3,) of something at ``lab`` in the laboratory: eq. 7, and eq. 8 as it has to read.

    Parameters
    ----------
    outer_rad, inner_rad : float
        Angles of the table about X' and Y' [rad].
    lab : (3,)
        Unit vector in the laboratory; by default the Sun's, which is the normal of a face that is trimmed.
    """
    return np.asarray(table_matrix(outer_rad, inner_rad).T @ np.asarray(lab, float))


def normal_of_offset(offset_mm: ArrayLike, distance_mm: float) -> FloatArray:
    """Normal in the laboratory (3,) of a face that puts its spot ``offset_mm`` (x, y) from the aperture.

    A face tilted by t turns the light by 2 t: the spot moves by ``distance tan(2 t)``; the normal halves the way
    between aperture and spot as seen from the face.
    """
    spot = np.array([*np.asarray(offset_mm, float), distance_mm])
    half = spot / np.linalg.norm(spot) + np.array(SUN_LAB)
    return np.asarray(half / np.linalg.norm(half))


def pixel_angle_rad(pixel_mm: float, distance_mm: float) -> float:
    """Tilt of a face that moves the spot by one pixel, eq. 13: arctan(pixel / distance) / 2."""
    return float(np.arctan(pixel_mm / distance_mm) / 2)


def angle_between_rad(first: ArrayLike, second: ArrayLike) -> float:
    """Angle of two vectors, accurate at any size."""
    u, v = np.asarray(first, float), np.asarray(second, float)
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))


def triad(reference: Sequence[ArrayLike], observed: Sequence[ArrayLike]) -> FloatArray:
    """Two-vector attitude (3, 3): takes the observed frame to the reference frame (CUBE09 eq. 1-5; Black 1964).

    Parameters
    ----------
    reference, observed : two vectors (3,)
        The same two directions in both frames; the first is met exactly.

    Raises
    ------
    DomainError
        If the two directions are parallel within 0.01 rad.
    """
    if len(reference) != 2 or len(observed) != 2:
        raise DomainError(f"TRIAD takes two directions; {len(reference)} and {len(observed)} were given")
    return np.asarray(_columns(*reference) @ _columns(*observed).T)


def _columns(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """[a b c] of eq. 1 and 3."""
    u, v = np.asarray(first, float), np.asarray(second, float)
    angle = angle_between_rad(u, v)
    if min(angle, np.pi - angle) < PARALLEL_RAD:
        raise DomainError(
            f"the normals of the two faces enclose {angle * RAD_DEG:.4f} deg; two faces that are not parallel are "
            f"needed (at least {PARALLEL_RAD * RAD_DEG:.2f} deg apart)"
        )
    a = u / np.linalg.norm(u)
    b = np.cross(u, v)
    b /= np.linalg.norm(b)
    return np.column_stack([a, b, np.cross(a, b)])


def cube_from_table(
    normal_cube: ArrayLike,
    normal_table: ArrayLike,
    *,
    covariance_rad2: ArrayLike,
    method: Literal["triad", "wahba"] = "triad",
) -> MirrorSolution:
    """R_pr from the normals of two or more faces, measured once or several times.

    Parameters
    ----------
    normal_cube : (n, 3)
        Normals in the cube frame. The two of TRIAD may be nominal: with (0, 0, 1) and (1, 0, 0) the ECSS frame results
        for any angle between the faces. Wahba's problem takes them at their word; give the known (or measured) normals.
    normal_table : (n, 3)
        The same normals as measured, table frame.
    covariance_rad2 : (n, 3, 3)
        Covariance of each measured normal, table frame; nothing along the normal itself.
    method : {"triad", "wahba"}
        ``triad`` uses the first two directions; measurements of a direction already used are averaged into it.
        ``wahba`` weights all by the inverse of their mean variance.

    Returns
    -------
    MirrorSolution

    Raises
    ------
    DomainError
        Shapes that do not fit, all faces parallel, or Wahba's problem degenerate.
    """
    cube, table = np.atleast_2d(np.asarray(normal_cube, float)), np.atleast_2d(np.asarray(normal_table, float))
    spread = np.asarray(covariance_rad2, float)
    if cube.shape != table.shape or cube.shape[1:] != (3,) or spread.shape != (len(cube), 3, 3):
        raise DomainError(
            f"normals of shape {cube.shape} (cube), {table.shape} (table), covariance {spread.shape}; "
            "(n, 3), (n, 3), (n, 3, 3) are needed"
        )
    cube, table, spread, repeats = _merged(cube, table, spread)
    if len(cube) < 2:
        raise DomainError("a single face was measured; a second, non-parallel face is needed")
    if method == "wahba":
        variance = np.maximum(np.trace(spread, axis1=1, axis2=2) / 2, 1e-24)
        solution = solve_wahba(cube, table, sigma_rad=np.sqrt(variance))
        if solution.status == "degenerate":
            raise DomainError(f"the faces do not determine the cube's attitude: {solution.message}")
        rotation, covariance = solution.rotation, solution.covariance_rad2
        repeats = ChiSquare(
            value=repeats.value + solution.misfit.value,
            degrees_of_freedom=repeats.degrees_of_freedom + solution.misfit.degrees_of_freedom,
        )
    else:
        matrix = triad((cube[0], cube[1]), (table[0], table[1]))
        rotation = Rotation.from_matrix(matrix)
        covariance = _triad_covariance(matrix, table[:2], spread[:2])
    return MirrorSolution(
        rotation=rotation,
        covariance_rad2=covariance,
        face_angle_rad=angle_between_rad(table[0], table[1]),
        misfit=repeats,
    )


def _merged(
    cube: FloatArray, table: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, ChiSquare]:
    """Repeated measurements of a face averaged, and how they scatter; faces keep the order of first appearance."""
    first: list[int] = []
    group = np.empty(len(cube), int)
    for i, normal in enumerate(cube):
        same = [k for k, at in enumerate(first) if angle_between_rad(cube[at], normal) < 1e-9]
        if not same:
            first.append(i)
        group[i] = same[0] if same else len(first) - 1
    mean, covariance = [], []
    scatter, freedom = 0.0, 0
    for k in range(len(first)):
        rows = group == k
        together = table[rows].mean(0)
        mean.append(together / np.linalg.norm(together))
        covariance.append(spread[rows].sum(0) / rows.sum() ** 2)
        off = table[rows] - together
        # nothing is known along the normal itself: two directions count
        scatter += float(np.einsum("ni,nij,nj->", off, np.linalg.pinv(spread[rows], hermitian=True, rcond=1e-9), off))
        freedom += 2 * (int(rows.sum()) - 1) if spread[rows].any() else 0
    return cube[first], np.array(mean), np.array(covariance), ChiSquare(value=scatter, degrees_of_freedom=freedom)


def _triad_covariance(matrix: FloatArray, table: FloatArray, spread: FloatArray) -> FloatArray:
    """First-order covariance of the error e in the reference frame: ``e x b1 = -db1``; about b1 the second is turned
    into the plane of the reference, ``n . (db2 + e x b2) = 0`` with n = b1 x b2 / |.|."""
    b1, b2 = (matrix @ table.T).T
    normal = np.cross(b1, b2)
    sine = np.linalg.norm(normal)
    normal = normal / sine
    by_first = -skew(b1)
    about = -np.outer(b1, normal @ (-skew(b2) @ by_first)) / sine
    by_second = -np.outer(b1, normal) / sine
    total = np.zeros((3, 3))
    for jacobian, one in zip((by_first + about, by_second), spread, strict=True):
        turned = jacobian @ matrix
        total += turned @ one @ turned.T
    return total


def sensor_to_cube(
    cube: MirrorSolution, sensor_from_table: Rotation, sensor_covariance_rad2: ArrayLike
) -> tuple[Rotation, FloatArray]:
    """R_sp, cube from sensor, ``v_cube = R_sp v_sensor`` (CUBE09 eq. 11-12).

    Parameters
    ----------
    cube : MirrorSolution
        R_pr.
    sensor_from_table : Rotation
        R_sr.
    sensor_covariance_rad2 : (3, 3)
        Of R_sr's error, rotation vector in the sensor frame.

    Returns
    -------
    rotation, covariance_rad2
        R_sp, and the covariance (3, 3) of its error in the cube frame: the two calibrations are independent.
    """
    rotation = cube.rotation * sensor_from_table.inv()
    turn = rotation.as_matrix()
    return rotation, cube.covariance_rad2 + turn @ np.asarray(sensor_covariance_rad2, float) @ turn.T


def rotation_error_rad(estimated: Rotation, true: Rotation) -> FloatArray:
    """Error's rotation vector (3,) [rad] in the frame that the rotations lead to."""
    return np.asarray((estimated * true.inv()).as_rotvec())
