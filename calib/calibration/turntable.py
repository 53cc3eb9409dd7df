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
sideways tilt of a carried axis is a zero offset of its carrier (Turntable, experiments.laboratory); none of these are
unknowns here, they are part of s and A. With one axis moving, s and A are not determined apart ("singular"). Nearly the
same holds for the principal point and the two small turns of A across the boresight in a narrow field: their effects
differ in second order of the field angle only. The condition number and the covariance show it; it is not hidden by
fixing one.

Mirror. A mirrored image with the star at -s fits exactly as well as the true one with s: a reflection is a turn times
the inversion, and the inversion goes into s. Only the nominal direction of the star tells them apart; a solution far
from it is refused.

s is reported as azimuth and elevation, s = (cos e sin a, sin e, cos e cos a): azimuth from +Z towards +X, elevation
towards +Y; near e = 90 deg the azimuth loses its meaning, nothing else does. A is reported by the angles theta of ACF17
(`calib.attitude.link`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.link import angles_of_rotation, exponential, increment_per_angle, right_jacobian, skew
from calib.calibration.fit import fit_stages, frames_with, free_stages, mirrored, packed, refused, verdict, wahba
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.star_problem import Prior, StarProblem, StarState, free_mask
from calib.cameras.base import CameraModel
from calib.fitting.robust_loss import Loss, get_loss
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["TableErrors", "TableLink", "TableState", "calibrate_turntable", "star_direction"]

METHOD = "turntable"
STAR_NAMES = ("star_azimuth_rad", "star_elevation_rad")
TARGET_NAMES = ("target1_rad", "target2_rad", "target3_rad")
LARGEST_TURN = np.deg2rad(60.0)  # of the star from its start; further is not an error of a bench
INSTALLATION_NAMES = ("theta1_rad", "theta2_rad", "theta3_rad")


@dataclass(frozen=True, slots=True, kw_only=True)
class TableErrors:
    """What a table may have wrong.

    Attributes
    ----------
    axis_rate : (f, q, 3) or None
        Rotation vector of the table top in the laboratory per unit of each axis error, e.g. ``Turntable.lean_rates``.
    axis_names : tuple of str
        Their names, q.
    axis_sigma_rad : (q,) or None
        Prior standard deviations [rad]; without, they are free.
    reading_rate : (f, k, 3) or None
        Rotation vector in the laboratory per radian of each axis, e.g. ``Turntable.angle_rates``.
    reading_sigma_rad : (k,)
        Standard deviations of the readings [rad].
    """

    axis_rate: FloatArray | None = None
    axis_names: tuple[str, ...] = ()
    axis_sigma_rad: FloatArray | None = None
    reading_rate: FloatArray | None = None
    reading_sigma_rad: FloatArray | None = None

    def checked(self, frames: int) -> TableErrors:
        """The same, with arrays and shapes verified.

        Raises
        ------
        DomainError
            On a shape that does not fit, or a sigma that is not positive.
        """
        axis = np.zeros((frames, 0, 3)) if self.axis_rate is None else np.asarray(self.axis_rate, float)
        reading = np.zeros((frames, 0, 3)) if self.reading_rate is None else np.asarray(self.reading_rate, float)
        for name, rate, size in (
            ("axis_rate", axis, len(self.axis_names)),
            ("reading_rate", reading, np.size(() if self.reading_sigma_rad is None else self.reading_sigma_rad)),
        ):
            if rate.shape != (frames, size, 3) or not np.all(np.isfinite(rate)):
                raise DomainError(
                    f"TableErrors.{name}: shape {rate.shape} where finite ({frames}, {size}, 3) is needed"
                )
        sigmas = []
        for name, sigma, size in (
            ("axis_sigma_rad", self.axis_sigma_rad, axis.shape[1]),
            ("reading_sigma_rad", self.reading_sigma_rad, reading.shape[1]),
        ):
            value = np.full(size, np.inf) if sigma is None else np.asarray(sigma, float)
            if value.shape != (size,) or not np.all(value > 0):
                raise DomainError(f"TableErrors.{name} = {sigma}: {size} positive values are needed [rad]")
            sigmas.append(value)
        return TableErrors(
            axis_rate=axis,
            axis_names=self.axis_names,
            axis_sigma_rad=sigmas[0],
            reading_rate=reading,
            reading_sigma_rad=sigmas[1],
        )


@dataclass(frozen=True, slots=True)
class TableState:
    """Installation (3, 3), turn of the target in the laboratory (3, 3), axis errors (q,), reading errors (f, k)."""

    installation: FloatArray
    target: FloatArray
    axis: FloatArray
    reading: FloatArray


class TableLink:
    """Pose family of a camera on a turntable that looks at a fixed target.

    Parameters
    ----------
    table : (f, 3, 3)
        Laboratory from table top.
    target : (3,) or None
        Direction of the single star in the laboratory at the start; None for a target of several stars, which has
        three angles.
    errors : TableErrors
        Unknown errors of the table, checked.
    """

    def __init__(self, table: FloatArray, target: FloatArray | None, errors: TableErrors) -> None:
        assert errors.axis_rate is not None
        assert errors.reading_rate is not None
        assert errors.axis_sigma_rad is not None
        assert errors.reading_sigma_rad is not None
        self._back = table.swapaxes(1, 2)
        self._star = target
        self._axis_rate = errors.axis_rate.swapaxes(1, 2)
        self._reading_rate = errors.reading_rate.swapaxes(1, 2)
        self._axis_information = errors.axis_sigma_rad**-2.0
        self._reading_information = errors.reading_sigma_rad**-2.0
        self._target_size = 3 if target is None else 2
        self.names = (
            *(TARGET_NAMES if target is None else STAR_NAMES),
            *INSTALLATION_NAMES,
            *errors.axis_names,
        )
        frames, _, readings = self._reading_rate.shape
        self.block_size = readings
        self.block_unknowns = frames * readings
        self.prior_terms = frames * readings + int(np.count_nonzero(self._axis_information))

    def start(self, installation: FloatArray) -> TableState:
        """State without table errors, the target where it was said to be."""
        frames, _, readings = self._reading_rate.shape
        return TableState(installation, np.eye(3), np.zeros(self._axis_rate.shape[2]), np.zeros((frames, readings)))

    def _turn(self, state: TableState) -> FloatArray:
        """w_k (f, 3) [rad]."""
        return np.asarray(self._axis_rate @ state.axis + np.einsum("fik,fk->fi", self._reading_rate, state.reading))

    def rotations(self, state: TableState) -> FloatArray:
        """A T^T exp(-w) Q, Q the turn of the target."""
        return np.asarray(state.installation @ self._back @ exponential(-self._turn(state)) @ state.target)

    def direction(self, state: TableState) -> FloatArray:
        """Direction (3,) of the single star in the laboratory."""
        assert self._star is not None
        return np.asarray(state.target @ self._star)

    def _basis(self, state: TableState) -> FloatArray:
        """Rotation vectors (3, 2 or 3) in the laboratory by which the target may turn."""
        if self._star is None:
            return np.eye(3)
        s = self.direction(state)
        first = np.cross(s, np.eye(3)[np.argmin(np.abs(s))])
        first /= np.linalg.norm(first)
        return np.column_stack([first, np.cross(s, first)])

    def rates(self, state: TableState, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Target, installation, axis errors; reading errors of the frame."""
        from_laboratory = rotation @ state.target.T
        frames = len(rotation)
        by_turn = -from_laboratory @ right_jacobian(-self._turn(state))
        common = np.concatenate(
            [
                from_laboratory @ self._basis(state),
                np.broadcast_to(np.eye(3), (frames, 3, 3)),
                by_turn @ self._axis_rate,
            ],
            axis=2,
        )
        return common, by_turn @ self._reading_rate if self.block_size else None

    def move(self, state: TableState, common: FloatArray, block: FloatArray | None) -> TableState:
        """Turn target and installation, change the table's errors."""
        size = self._target_size
        turned = exponential(self._basis(state) @ common[:size]) @ state.target
        installation = exponential(common[size : size + 3]) @ state.installation
        reading = state.reading if block is None else state.reading + block
        return TableState(installation, turned, state.axis + common[size + 3 :], reading)

    def penalty(self, state: TableState) -> float:
        """Squares of the table's errors over their variances."""
        return float(
            np.sum(self._axis_information * state.axis**2) + np.sum(self._reading_information * state.reading**2)
        )

    def prior(self, state: TableState) -> Prior | None:
        """Diagonal."""
        size = len(self.names)
        first = size - len(state.axis)
        common, gradient = np.zeros((size, size)), np.zeros(size)
        common[first:, first:] = np.diag(self._axis_information)
        gradient[first:] = self._axis_information * state.axis
        return Prior(
            common=common,
            gradient=gradient,
            block=np.broadcast_to(
                np.diag(self._reading_information), (len(self._back), self.block_size, self.block_size)
            ),
            block_gradient=self._reading_information * state.reading,
        )

    def reported(self, state: TableState) -> tuple[FloatArray, FloatArray]:
        """Azimuth and elevation of the star (or the target's rotation vector), theta, axis errors."""
        size = self._target_size
        theta = angles_of_rotation(Rotation.from_matrix(state.installation))
        derivative = np.eye(len(self.names))
        derivative[size : size + 3, size : size + 3] = np.linalg.pinv(increment_per_angle(theta))
        if self._star is None:
            first = Rotation.from_matrix(state.target).as_rotvec()
            derivative[:3, :3] = np.linalg.inv(right_jacobian(-first))
        else:
            s = self.direction(state)
            across = max(float(np.hypot(s[0], s[2])), 1e-12)
            first = np.array([np.arctan2(s[0], s[2]), np.arctan2(s[1], across)])
            moved = -skew(s) @ self._basis(state)  # change of s per rotation
            derivative[0, :2] = (s[2] * moved[0] - s[0] * moved[2]) / across**2
            derivative[1, :2] = moved[1] / across
        return np.concatenate([first, theta, state.axis]), derivative


def star_direction(calibration: Calibration) -> FloatArray:
    """Unit vector (3,) towards the star in the laboratory from a turntable calibration.

    Raises
    ------
    DomainError
        If the calibration has no single star.
    """
    names = list(calibration.solution.names)
    if not set(STAR_NAMES) <= set(names):
        raise DomainError(f"a calibration by {calibration.method!r} has no single star")
    azimuth, elevation = (float(calibration.solution.value[names.index(n)]) for n in STAR_NAMES)
    return np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])


def calibrate_turntable(
    observations: Observations,
    table_rotation: Rotation,
    start_model: CameraModel,
    *,
    start_star: ArrayLike | None = None,
    start_installation: Rotation | None = None,
    errors: TableErrors | None = None,
    two_step: bool = True,
    loss: str | Loss = "linear",
    free: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate a camera, its installation on a turntable and the direction of the star.

    Parameters
    ----------
    observations : Observations
        Measured positions; ``direction`` is the nominal direction of the star in the laboratory, the same in every row
        for a single star. Each position of the table is a frame.
    table_rotation : Rotation
        f rotations, laboratory from table top, from the readings.
    start_model : CameraModel
        Start of the camera; fixed parameters keep their value.
    start_star : (3,), optional
        Start of the star's direction in the laboratory, if not ``observations.direction``.
    start_installation : Rotation, optional
        cam from table top; by default by Wahba's problem.
    errors : TableErrors, optional
        Errors of axes and readings to be fitted or allowed for; by default the table is perfect.
    two_step, loss, free
        As in `calib.calibration.attitude_correlated.calibrate_attitude_correlated`.

    Returns
    -------
    Calibration
        ``solution`` holds the free camera parameters, the star's azimuth and elevation, theta1..3 and the axis errors;
        ``attitude`` is cam from laboratory, such that the *nominal* directions fit; ``installation`` is cam from table.

    Raises
    ------
    DomainError
        If table rotations do not match the frames, shapes do not fit, or the list is in another pixel convention.
    ConfigError
        On an unknown parameter or loss.
    """
    chosen, mask = get_loss(loss), free_mask(start_model, free)
    table = table_rotation.as_matrix().reshape(-1, 3, 3)
    if len(table) != observations.frames:
        raise DomainError(f"{len(table)} table rotations for {observations.frames} frames; one for each is needed")
    selection = frames_with(observations, start_model, 1)
    stars = selection.observations
    nominal = stars.direction[0]
    single = bool(np.all(np.abs(stars.direction - nominal) < 1e-9))
    family = TableLink(table, nominal if single else None, (errors or TableErrors()).checked(observations.frames))
    seen = start_model.unproject(stars.pixel_px, stars.band)
    target = _turn_to(nominal, start_star) if single else np.eye(3)
    on_table = np.einsum("nji,nj->ni", table[stars.frame], stars.direction @ target.T)
    if start_installation is None:
        group = np.zeros(len(seen), dtype=np.int64)
        installation = wahba(seen, on_table, group, 1, robust=chosen.name != "linear")[0]
    else:
        installation = start_installation.as_matrix()
    begun = family.start(installation)
    start = TableState(begun.installation, target, begun.axis, begun.reading)
    names = (*(n for n, moves in zip(start_model.parameter_names, mask, strict=True) if moves), *family.names)
    if 2 * len(stars.frame) + family.prior_terms - family.block_unknowns <= len(names):
        return refused(
            METHOD,
            names,
            start_model,
            message=f"{len(stars.frame)} positions give {2 * len(stars.frame)} measurements for {len(names)} unknowns",
            selection=selection,
            unknowns=len(names),
            attitude=family.rotations(start),
            installation=Rotation.from_matrix(installation),
        )
    fit, spread = fit_stages(
        lambda stage: StarProblem(stars, start_model, stage, family),
        StarState(np.array(start_model.parameters), start),
        free_stages(start_model, mask, two_step=two_step),
        chosen,
    )
    status, message = verdict(
        fit, spread, chosen, lambda: mirrored(seen, on_table, np.zeros(len(seen), dtype=np.int64), 1)
    )
    turned = float(Rotation.from_matrix(fit.state.pose.target @ target.T).magnitude())
    if status != "refused" and turned > LARGEST_TURN:
        status = "refused"
        message = (
            f"the star comes out {np.degrees(turned):.0f} deg from where it was said to be: the image is mirrored "
            "(exchange the axes or turn one of them round), or start_star or the axes of the table are wrong"
        )
    return packed(
        METHOD,
        fit,
        start_model,
        mask,
        selection=selection,
        status=status,
        message=message,
        attitude=family.rotations(fit.state.pose),
        installation=Rotation.from_matrix(fit.state.pose.installation),
    )


def _turn_to(nominal: FloatArray, start: ArrayLike | None) -> FloatArray:
    """Rotation (3, 3) that brings the nominal direction to the start, by the shortest way."""
    if start is None:
        return np.eye(3)
    wanted = np.asarray(start, dtype=np.float64)
    if wanted.shape != (3,) or not abs(float(np.linalg.norm(wanted)) - 1.0) < 1e-6:
        raise DomainError(f"start_star = {start}; a unit vector (3,) in the laboratory is needed")
    return np.asarray(Rotation.align_vectors(wanted[None], nominal[None])[0].as_matrix())
