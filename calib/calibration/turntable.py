"""Joint calibration on a turntable with a single-star simulator: camera, star direction, installation.

The bench of FISHER23 (S100, after CN1949002): a collimated star, fixed in the laboratory at the direction s, and a
camera on a table of two or three axes. With the table's attitude T_k (laboratory from table top, from its readings) and
the installation A (cam from table top), the star is seen along

    v_k = A T_k^T s.

Unknown: the camera, two angles of s, three of A; if wanted, errors of the table's axes e and of its readings r_k, which
turn the table in the laboratory by the rotation vector w_k,

    v_k = A T_k^T exp(-[w_k]x) s,       w_k = sum over q of e_q L_kq + sum over axes of r_ki Z_ki,

L the lean rates and Z the directions of the axes at that moment. Readings have a prior (their noise), so that they add
their noise to the right directions of every star and not more; they are eliminated frame by frame.

Gauge. T_k is known, so nothing is left free that could be turned without changing an image, as long as the table moves
about two axes. What would be free is fixed by convention: the laboratory frame *is* the table's frame at zero angles
("initial table frame"). A zero offset of the outermost axis turns s about it, one of the innermost turns A about it, a
sideways tilt of a carried axis is a zero offset of its carrier (`calib.calibration.table_axes`); none of these are
unknowns here, they are part of s and A. With one axis moving, s and A are not determined apart ("singular"). Nearly the
same holds for the principal point and the two small turns of A across the boresight in a narrow field: their effects
differ in second order of the field angle only. The condition number and the covariance show it; it is not hidden by
fixing one.

Mirror. A mirrored image with the star at -s fits exactly as well as the true one with s: a reflection is a turn times
the inversion, and the inversion goes into s. Only the nominal direction of the star tells them apart; a solution far
from it is refused.

s is reported as azimuth and elevation, s = (cos e sin a, sin e, cos e cos a): azimuth from +Z towards +X, elevation
towards +Y; near e = 90 deg the azimuth loses its meaning, nothing else does. A is reported by the angles theta of ACF17
(`calib.attitude.euler_angles`).

False minima. With few poses and strong distortion the fit from an undistorted camera can end where the camera folds its
image or chi-square contradicts the stated noise. Such a fit is repeated from cameras of barrel and pincushion
distortion (`DISTORTED_STARTS`), and the lowest chi-square is kept. If that is still improbable the status is "refuted".
Where readings are as coarse as centroids, few poses of a narrow field have a second minimum some 25 sigma away, to
which the fit without distortion runs; its chi-square is larger by 20 to 50, which no test of its size notices. A fit in
two steps is therefore repeated in one, and the lower minimum is kept.

First order. Where the readings are coarse, the covariance, which is of first order, can be wrong. Along its least
determined direction chi-square then does not rise by one at one stated standard deviation
(`calib.fitting.linearity.chi_square_rise`); the solution holds the rise, and its message says so above 1.5
(`calib.fitting.solution.LARGEST_RISE`; `docs/validation/laboratory.md` has the pulls of 800 fits).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import angle_per_increment, angles_of_rotation
from calib.attitude.wahba import rotations_of_groups
from calib.calibration.attitude_family import FamilyFit, RotationFamily
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.stages import free_stages
from calib.calibration.star_problem import Prior, StarState
from calib.calibration.verdict import parity_hint
from calib.cameras.base import CameraModel
from calib.fitting.linearity import chi_square_rise
from calib.fitting.misfit import joined
from calib.fitting.robust_loss import Loss
from calib.fitting.rotation_vectors import exponential, right_jacobian, skew
from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError
from optics.frames import perpendicular
from optics.records import freeze, locked

STAR_NAMES = ("star_azimuth_rad", "star_elevation_rad")
TARGET_NAMES = ("target1_rad", "target2_rad", "target3_rad")
INSTALLATION_NAMES = ("theta1_rad", "theta2_rad", "theta3_rad")
LARGEST_TURN = np.deg2rad(60.0)  # of the star from its start; further is not an error of a bench
SAME_DIRECTION = 1e-9  # rad: nominal directions closer than this are those of one star
DISTORTED_STARTS = (-0.05, 0.05, -0.15, 0.15)
"""Distortions of further starts: displacement at the corner of the detector over the corner's distance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableErrors:
    """Errors of a turntable; default: none.

    Attributes
    ----------
    axis_rate : (f, q, 3)
        Rotation vector of the table top in the laboratory per unit of each axis error, e.g. ``TableAxes.lean_rates``.
    axis_names : tuple of str
        Their names, q.
    axis_sigma_rad : (q,)
        Prior standard deviations [rad]; without, they are free.
    reading_rate : (f, k, 3)
        Rotation vector in the laboratory per radian of each axis, e.g. ``TableAxes.angle_rates``.
    reading_sigma_rad : (k,)
        Standard deviations of the readings [rad].

    Raises
    ------
    DomainError
        On a shape that does not fit, or a sigma that is not positive.
    """

    axis_rate: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    axis_names: tuple[str, ...] = ()
    axis_sigma_rad: FloatArray | None = None
    reading_rate: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    reading_sigma_rad: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        freeze(self, "axis_rate", shape=("f", len(self.axis_names), 3))
        freeze(self, "reading_rate", shape=("f", np.size(self.reading_sigma_rad), 3))
        if self.axis_sigma_rad is None:
            object.__setattr__(self, "axis_sigma_rad", np.full(len(self.axis_names), np.inf))
        for name, size in (
            ("axis_sigma_rad", len(self.axis_names)),
            ("reading_sigma_rad", self.reading_rate.shape[1]),
        ):
            sigma = freeze(self, name, shape=(size,), finite=False)
            if not np.all(sigma > 0):
                raise DomainError(f"TableErrors.{name} = {sigma.tolist()}: {size} positive values are needed [rad]")

    @property
    def axis_information(self) -> FloatArray:
        """Prior information on the axis errors (q,)."""
        assert self.axis_sigma_rad is not None
        return self.axis_sigma_rad**-2.0

    @property
    def reading_information(self) -> FloatArray:
        """Prior information on the errors of the readings (k,)."""
        return self.reading_sigma_rad**-2.0


@dataclass(frozen=True, slots=True)
class TableState:
    """Installation (3, 3), turn of the target in the laboratory (3, 3), axis errors (q,), reading errors (f, k).

    ``star`` is the nominal direction (3,) of a single star, None for a target of several stars.
    """

    installation: FloatArray
    target: FloatArray
    axis: FloatArray
    reading: FloatArray
    star: FloatArray | None

    def direction(self) -> FloatArray:
        """Direction (3,) of the single star in the laboratory."""
        assert self.star is not None
        return np.asarray(self.target @ self.star)

    def basis(self) -> FloatArray:
        """Rotation vectors (3, 2 or 3) in the laboratory by which the target may turn."""
        if self.star is None:
            return np.eye(3)
        return perpendicular(self.direction()).T


@dataclass(frozen=True, slots=True, kw_only=True)
class TurntableAttitudes(RotationFamily):
    """A camera on a turntable in front of a fixed star or target.

    The ``direction`` of the observations is the nominal one in the laboratory, the same in every row for a single star;
    each position of the table is a frame. A single star has two unknown angles, a target of several stars three. The
    attitudes of the result are cam from laboratory, such that the *nominal* directions fit. For a bound, the directions
    are the true ones.

    Attributes
    ----------
    table_rotation : Rotation
        f rotations, laboratory from table top, from the readings.
    star : (3,) or None
        Start of the star's direction in the laboratory, if not that of the observations.
    installation : Rotation or None
        cam from table top, where a fit starts or where a bound is taken; by default by Wahba's problem.
    errors : TableErrors
        Errors of axes and readings to be fitted or allowed for; by default the table is perfect.

    Raises
    ------
    DomainError
        On shapes that do not fit the number of table rotations, or a star that is no unit vector.
    """

    table_rotation: Rotation
    star: ArrayLike | None = None
    installation: Rotation | None = None
    errors: TableErrors = field(default_factory=TableErrors)
    _table: FloatArray = field(init=False, repr=False)
    _axis_rate: FloatArray = field(init=False, repr=False)
    _reading_rate: FloatArray = field(init=False, repr=False)

    method: ClassVar[str] = "turntable"
    per_frame: ClassVar[str] = "table rotations"

    def __post_init__(self) -> None:
        table = locked(self.table_rotation.as_matrix().reshape(-1, 3, 3))
        object.__setattr__(self, "_table", table)
        for name in ("axis_rate", "reading_rate"):
            rate = getattr(self.errors, name)
            wanted = (len(table), *rate.shape[1:])
            if rate.size and rate.shape != wanted:
                raise DomainError(f"TableErrors.{name}: shape {rate.shape} where {wanted} is needed")
            per_unit = rate if rate.size else np.zeros((len(table), 0, 3))
            object.__setattr__(self, f"_{name}", per_unit.swapaxes(1, 2))
        if self.star is not None:
            star = np.asarray(self.star, dtype=np.float64)
            if star.shape != (3,) or not abs(float(np.linalg.norm(star)) - 1.0) < 1e-6:
                raise DomainError(f"star = {self.star}; a unit vector (3,) in the laboratory is needed")

    @property
    def frames(self) -> int:
        """Number of table rotations."""
        return len(self._table)

    def names(self, stars: Observations) -> tuple[str, ...]:
        """Azimuth and elevation of the star (or the target's rotation vector), theta, axis errors."""
        target = TARGET_NAMES if _single_star(stars) is None else STAR_NAMES
        return (*target, *INSTALLATION_NAMES, *self.errors.axis_names)

    def frame_unknowns(self, stars: Observations) -> int:
        """Errors of the readings."""
        return self.frames * self._reading_rate.shape[2]

    @property
    def prior_terms(self) -> int:
        """Errors of the readings, and of axes with a sigma."""
        return self.frames * self._reading_rate.shape[2] + int(np.count_nonzero(self.errors.axis_information))

    def fit(
        self, stars: Observations, model: CameraModel, free: BoolArray, start: Any, *, two_step: bool, loss: Loss
    ) -> FamilyFit:
        """Fit from the start in two steps and in one, from distorted cameras where chi-square refutes the result."""

        def fit_from(camera: FloatArray, two_step: bool) -> FamilyFit:
            state = StarState(camera, start.pose)
            return RotationFamily.fit(self, stars, model, free, state, two_step=two_step, loss=loss)

        best = fit_from(start.camera, two_step)
        if len(free_stages(model, free, two_step=two_step)) > 1:
            best = _lower_minimum(best, fit_from(start.camera, False))
        for camera in _distorted_starts(model, free, start.camera):
            if best.solution.converged and not best.solution.misfit.refuted:
                break
            best = _lower_minimum(best, fit_from(camera, two_step))
        if not best.solution.converged:
            return best
        solution = best.solution
        rise, names = chi_square_rise(self.problem(stars, model, free), best.state, solution.robust_weight)
        solution = replace(solution, chi2_rise=rise)
        if solution.misfit.refuted:
            return replace(best, solution=replace(solution, status="refuted"))
        note = ""
        if not solution.first_order:
            note = (
                "the stated errors are of first order and do not hold: one sigma along the least determined direction "
                f"({', '.join(names)}) raises chi-square by {rise:.3g} where 1 is expected; finer readings or more of "
                "the field are needed"
            )
        return replace(best, solution=replace(solution, message=joined(solution.message, note)))

    def start_pose(self, stars: Observations, model: CameraModel, *, robust: bool) -> TableState:
        """No table errors; the installation from all stars together."""
        nominal = _single_star(stars)
        target = np.eye(3)
        if nominal is not None and self.star is not None:  # by the shortest way
            turn = Rotation.align_vectors(np.asarray(self.star, dtype=np.float64)[None], nominal[None])[0]
            target = np.asarray(turn.as_matrix())
        if self.installation is not None:
            installation = self.installation.as_matrix().reshape(3, 3)
        else:
            measured, group = model.unproject(stars.pixel_px, stars.band), np.zeros(len(stars), dtype=np.int64)
            installation = rotations_of_groups(measured, self._on_table(stars, target), group, 1, robust=robust)[0]
        axis, reading = np.zeros(len(self.errors.axis_names)), np.zeros((self.frames, self._reading_rate.shape[2]))
        return TableState(installation, target, axis, reading, nominal)

    def _on_table(self, stars: Observations, target: FloatArray) -> FloatArray:
        """Directions (n, 3) of the stars in the frame of the table top."""
        return np.asarray(np.einsum("nji,nj->ni", self._table[stars.frame], stars.direction @ target.T))

    def _turn(self, pose: TableState) -> FloatArray:
        """w_k (f, 3) [rad]."""
        return np.asarray(self._axis_rate @ pose.axis + np.einsum("fik,fk->fi", self._reading_rate, pose.reading))

    def rotations(self, pose: TableState) -> FloatArray:
        """A T^T exp(-w) Q, Q the turn of the target."""
        from_table = self._table.swapaxes(1, 2)
        return np.asarray(pose.installation @ from_table @ exponential(-self._turn(pose)) @ pose.target)

    def rates(self, pose: TableState, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Target, installation, axis errors; reading errors of the frame."""
        from_laboratory = rotation @ pose.target.T
        frames = len(rotation)
        by_turn = -from_laboratory @ right_jacobian(-self._turn(pose))
        common = np.concatenate(
            [
                from_laboratory @ pose.basis(),
                np.broadcast_to(np.eye(3), (frames, 3, 3)),
                by_turn @ self._axis_rate,
            ],
            axis=2,
        )
        return common, by_turn @ self._reading_rate if self._reading_rate.size else None

    def move(self, pose: TableState, common: FloatArray, block: FloatArray | None) -> TableState:
        """Turn target and installation, change the table's errors."""
        basis = pose.basis()
        size = basis.shape[1]
        target = exponential(basis @ common[:size]) @ pose.target
        installation = exponential(common[size : size + 3]) @ pose.installation
        reading = pose.reading if block is None else pose.reading + block
        return TableState(installation, target, pose.axis + common[size + 3 :], reading, pose.star)

    def penalty(self, pose: TableState) -> float:
        """Squares of the table's errors over their variances."""
        axis, reading = self.errors.axis_information, self.errors.reading_information
        return float(np.sum(axis * pose.axis**2) + np.sum(reading * pose.reading**2))

    def prior(self, pose: TableState) -> Prior | None:
        """Prior of the table's errors; its information is diagonal."""
        axis, reading = self.errors.axis_information, self.errors.reading_information
        first = pose.basis().shape[1] + 3
        size = first + len(axis)
        common, gradient = np.zeros((size, size)), np.zeros(size)
        common[first:, first:] = np.diag(axis)
        gradient[first:] = axis * pose.axis
        return Prior(
            common=common,
            gradient=gradient,
            block=np.broadcast_to(np.diag(reading), (len(self._table), len(reading), len(reading))),
            block_gradient=reading * pose.reading,
        )

    def reported(self, pose: TableState) -> tuple[FloatArray, FloatArray]:
        """Azimuth and elevation of the star (or the target's rotation vector), theta, axis errors."""
        basis = pose.basis()
        size = basis.shape[1]
        theta = angles_of_rotation(Rotation.from_matrix(pose.installation))
        derivative = np.eye(size + 3 + len(pose.axis))
        derivative[size : size + 3, size : size + 3] = angle_per_increment(theta)
        if pose.star is None:
            first = Rotation.from_matrix(pose.target).as_rotvec()
            derivative[:3, :3] = np.linalg.inv(right_jacobian(-first))
        else:
            s = pose.direction()
            across = max(float(np.hypot(s[0], s[2])), 1e-12)
            first = np.array([np.arctan2(s[0], s[2]), np.arctan2(s[1], across)])
            moved = -skew(s) @ basis  # change of s per rotation
            derivative[0, :2] = (s[2] * moved[0] - s[0] * moved[2]) / across**2
            derivative[1, :2] = moved[1] / across
        return np.concatenate([first, theta, pose.axis]), derivative

    def installation_of(self, pose: TableState) -> Rotation:
        """cam from table top."""
        return Rotation.from_matrix(pose.installation)

    def parity(self, stars: Observations, model: CameraModel) -> str:
        """All stars together, in the frame of the table top."""
        target = self.start_pose(stars, model, robust=False).target
        measured = model.unproject(stars.pixel_px, stars.band)
        return parity_hint(measured, self._on_table(stars, target), np.zeros(len(measured), dtype=np.int64), 1)

    def objection(self, start: TableState, pose: TableState) -> str:
        """A star far from where it was said to be: a reflection is a turn times the inversion of the star."""
        angle = float(Rotation.from_matrix(pose.target @ start.target.T).magnitude())
        if angle <= LARGEST_TURN:
            return ""
        return (
            f"the fitted star lies {np.degrees(angle):.0f} deg from its start value: the image is mirrored "
            "(exchange the axes or turn one of them round), or the start of the star or the axes of the table are wrong"
        )


def _lower_minimum(best: FamilyFit, other: FamilyFit) -> FamilyFit:
    """The converged fit with more stars, of equally many that with the lower chi-square; the first within 1."""
    if best.solution.converged and other.solution.converged:
        more = other.solution.degrees_of_freedom - best.solution.degrees_of_freedom
        return other if more > 0 or (more == 0 and other.solution.chi2 < best.solution.chi2 - 1.0) else best
    return other if other.solution.converged else best


def _distorted_starts(model: CameraModel, free: BoolArray, camera: FloatArray) -> list[FloatArray]:
    """Start parameters (p,) with the cubic radial distortion of `DISTORTED_STARTS`; none where it is not free."""
    cubic = next((i for i, name in enumerate(model.parameter_names) if name.startswith("q1_") and free[i]), None)
    if cubic is None:
        return []
    corner_px = model.geometry.half_diagonal_mm / model.geometry.pixel_pitch_mm
    displacement = corner_px * model.parameter_scales[cubic] * np.eye(len(camera))[cubic]
    return [np.where(displacement != 0.0, part * displacement, camera) for part in DISTORTED_STARTS]


def _single_star(stars: Observations) -> FloatArray | None:
    """Nominal direction (3,) of a single star, None for a target of several."""
    if not len(stars) or not np.all(np.abs(stars.direction - stars.direction[0]) < SAME_DIRECTION):
        return None
    return stars.direction[0]


def star_direction(calibration: Calibration) -> FloatArray:
    """Unit vector (3,) towards the star in the laboratory from a turntable calibration.

    Parameters
    ----------
    calibration : Calibration
        Of `calibrate` with `TurntableAttitudes`.

    Returns
    -------
    (3,) array
        Unit vector.

    Raises
    ------
    DomainError
        If the calibration is not a single-star calibration.
    """
    names = list(calibration.solution.names)
    if not set(STAR_NAMES) <= set(names):
        raise DomainError(f"a calibration by {calibration.method!r} is not a single-star calibration")
    azimuth, elevation = (float(calibration.solution.value[names.index(n)]) for n in STAR_NAMES)
    return np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
