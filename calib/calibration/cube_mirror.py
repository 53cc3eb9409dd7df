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

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.attitude_solution import solve_wahba
from calib.attitude.triad import angle_between_rad, triad
from calib.calibration.table_axes import TableAxes
from calib.fitting.misfit import UNTESTED, ChiSquare
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze

SUN_LAB = (0.0, 0.0, 1.0)


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


def normal_in_table(table: TableAxes, angle_rad: ArrayLike, lab: ArrayLike = SUN_LAB) -> FloatArray:
    """Direction in the table frame (3,) of something at ``lab`` in the laboratory: eq. 7, and eq. 8 as it has to read.

    Parameters
    ----------
    table : TableAxes
        The table; the axes of CUBE09 are ``TableAxes.create("xy")``.
    angle_rad : (2,)
        Angles about X' and Y' [rad].
    lab : (3,)
        Unit vector in the laboratory; by default the Sun's, which is the normal of a face that is trimmed.
    """
    return np.asarray(table.rotation(np.atleast_2d(angle_rad))[0].inv().apply(np.array(lab, float)))


def normal_covariance(table: TableAxes, angle_rad: ArrayLike, tilt_covariance_rad2: ArrayLike) -> FloatArray:
    """Covariance (3, 3) in the table frame of a normal whose tilts about the light have a covariance (2, 2)."""
    spread = np.zeros((3, 3))
    spread[:2, :2] = tilt_covariance_rad2
    turn = table.rotation(np.atleast_2d(angle_rad))[0].inv().as_matrix()
    return np.asarray(turn @ spread @ turn.T)


def concentric_angles(
    table: TableAxes, normal: ArrayLike, start_rad: ArrayLike, beam: ArrayLike = SUN_LAB
) -> FloatArray:
    """Angles (outer, inner) [rad] at which a normal (table frame) looks along the beam; Newton on the true table.

    ``start_rad`` (2,) tells which turn of the angles is meant.
    """
    direction = np.asarray(normal, float)
    nominal = np.array([np.arcsin(direction[1]), np.arctan2(-direction[0], direction[2])])
    start = np.asarray(start_rad, np.float64)
    angle = start + (nominal - start + np.pi) % (2 * np.pi) - np.pi
    step = np.full(2, np.inf)
    while np.max(np.abs(step)) > 1e-9:
        looks = table.rotation(angle[None])[0].apply(direction)
        leverage = np.cross(table.angle_rates(angle[None])[0], looks)[:, :2].T
        step = np.linalg.solve(leverage, looks[:2] - np.asarray(beam)[:2])
        angle = angle - step
    return angle


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
        attitude = triad(list(cube[:2]), list(table[:2]), covariance_rad2=spread[:2])
        rotation, covariance = attitude.rotation, attitude.covariance_rad2
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


def lean_covariance(rate: ArrayLike, rotation: Rotation, lean_sigma_rad: float, cross_rad2: ArrayLike) -> FloatArray:
    """What a fitted non-orthogonality of the table adds to the covariance of R_sp (3, 3).

    ``e = J dl - R_sp e_s`` with the rate J (3,) of R_pr by the lean, its error dl, and the error e_s of R_sr, whose
    covariance with dl is ``cross_rad2`` (3,).
    """
    change = np.asarray(rate, float)
    cross = np.outer(change, rotation.as_matrix() @ np.asarray(cross_rad2, float))
    return np.asarray(np.outer(change, change) * lean_sigma_rad**2 - cross - cross.T)


def rotation_error_rad(estimated: Rotation, true: Rotation) -> FloatArray:
    """Error's rotation vector (3,) [rad] in the frame that the rotations lead to."""
    return np.asarray((estimated * true.inv()).as_rotvec())


def trimmed_offset_px(
    start_px: float,
    step_px: float,
    noise_px: float,
    *,
    stop_px: float,
    gain: float,
    settings: int,
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """RMS of the offset [px], x and y, that a stop rule leaves, simulated ``count`` times.

    Offsets are at first uniform to ``start_px`` per axis. In each of at most ``settings`` settings the operator takes
    away the part ``gain`` of an offset that is measured with the noise ``noise_px``, in steps of the table of
    ``step_px``, until both axes are below ``stop_px``.
    """
    offset = rng.uniform(-1, 1, (count, 2)) * start_px
    phase = rng.uniform(0, 1, (count, 2)) * step_px
    going = np.ones(count, bool)

    def on_steps(value: FloatArray) -> FloatArray:
        return np.asarray(np.rint((value - phase) / step_px) * step_px + phase) if step_px > 0 else value

    offset = on_steps(offset)
    for _ in range(settings):
        measured = offset + rng.standard_normal((count, 2)) * noise_px
        going = going & ~np.all(np.abs(measured) < stop_px, axis=1)
        offset = np.where(going[:, None], on_steps(offset - gain * measured), offset)
    return np.asarray(np.sqrt(np.mean(offset[~going] ** 2, axis=0)))
