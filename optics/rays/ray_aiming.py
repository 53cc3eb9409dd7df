"""Real ray aiming: the chief ray of a star through the centre of the stop.

Newton's iteration started on the axis of a wide lens may end on a spurious ray. Every ray is therefore followed from
the axis outwards: the field angle grows in steps, each started by extrapolation from the previous ones. A step is
accepted only if Newton's corrections shrink fast and no surface is missed on the way, otherwise it is halved (natural
continuation; Allgower and Georg 1990, *Numerical Continuation Methods*, ch. 2). Rays do not influence each other.
Positions on the stop are measured on the stop's own surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, BoolArray, FloatArray, IntArray
from optics.errors import ConvergenceError, DomainError
from optics.lens.system import LensSystem
from optics.rays.paraxial import axial_paraxial
from optics.rays.program import LensProgram, compile_lens
from optics.rays.trace import OK, Rays, trace_program
from optics.units import DEG_RAD

FIRST_STEP_RAD, LEAST_STEP_RAD = 10.0 * DEG_RAD, 1e-3 * DEG_RAD
"""Longest and shortest step of the field angle."""
NEWTON_STEPS, TOLERANCE, DIFFERENCE = 8, 1e-11, 1e-5
"""Newton steps; residual in radii of the stop, difference of the slopes in radii of the paraxial pupil."""
CONTRACTION = 0.5
"""Largest ratio of a correction to the one before it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AimFrame:
    """Plane of launch, and the length scales of tolerances."""

    z_mm: float  # Plane of launch: the paraxial entrance pupil, or the first vertex where that is at infinity
    scale_mm: float  # Radius of the paraxial entrance pupil, or of the widest aperture
    stop_mm: float  # Radius of the stop, or ``scale_mm`` where it has none


@dataclass(frozen=True, slots=True, kw_only=True)
class AimedRays:
    """Rays through the centre of the stop."""

    x_mm: FloatArray  # Intersections with the plane of launch; where the aim failed, of the last iteration
    y_mm: FloatArray
    z_mm: float  # Plane of launch
    converged: BoolArray  # Whether they pass the centre of the stop


def aim_frame(lens: LensSystem) -> AimFrame:
    """Plane of launch and sizes of a lens."""
    try:
        first_order = axial_paraxial(lens, lens.design_wavelength_nm)
        z, scale = first_order.entrance_pupil_z_mm, first_order.entrance_pupil_radius_mm
    except DomainError:  # no power
        z, scale = math.nan, math.nan
    if not (math.isfinite(z) and math.isfinite(scale)):
        rims = [s.semi_diameter_mm for s in lens.surfaces if np.isfinite(s.semi_diameter_mm)]
        if not rims:
            raise ConvergenceError(f"lens {lens.name!r} has no aperture that limits a beam")
        z, scale = float(lens.surfaces[0].position_mm[2]), float(max(rims))
    stop = float(lens.surfaces[lens.stop_index].semi_diameter_mm)
    return AimFrame(z_mm=z, scale_mm=scale, stop_mm=stop if math.isfinite(stop) else scale)


def up_to_surface(program: LensProgram, last: int) -> LensProgram:
    """The part of a compiled lens up to a surface, with the parameters of the lens."""
    return replace(program, steps=program.steps[: last + 1])


def without_apertures(program: LensProgram) -> LensProgram:
    """A compiled lens that stops no ray, so that a ray's status tells whether it can be traced."""
    return replace(program, steps=tuple(replace(step, aperture_at=-1, outlines=()) for step in program.steps))


def without_obscurations(program: LensProgram) -> LensProgram:
    """A compiled lens without central obscurations."""
    steps = (
        replace(step, annular=False, outlines=tuple(outline for outline in step.outlines if not outline[3]))
        for step in program.steps
    )
    return replace(program, steps=tuple(steps))


class _Aiming:
    """Continuation of n rays; ``rays`` are their numbers (m,), ``launch`` (2, m) points of the plane normal to each
    ray, meridional component first."""

    def __init__(self, lens: LensSystem, direction: FloatArray, wavelength_nm: FloatArray) -> None:
        self.frame = aim_frame(lens)
        program, theta = compile_lens(lens)
        self.front, self.theta = up_to_surface(without_apertures(program), lens.stop_index), NUMPY.parameters(theta)
        self.stop = lens.stop_index
        sine = np.hypot(direction[:, 0], direction[:, 1])
        self.angle = np.arctan2(sine, direction[:, 2])
        self.cos_azimuth, self.sin_azimuth = (
            np.divide(direction[:, k], sine, out=np.full(len(sine), 1.0 - k), where=sine > 0.0) for k in (0, 1)
        )
        self.wavelength = wavelength_nm

    def launch_points(self, rays: IntArray, launch: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (m,) of the plane of launch [mm]."""
        radial = launch[0] / np.cos(angle)
        c, s = self.cos_azimuth[rays], self.sin_azimuth[rays]
        return radial * c - launch[1] * s, radial * s + launch[1] * c

    def residual(self, rays: IntArray, launch: FloatArray, angle: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Position on the stop from its centre, (2, m) in its radii, and whether rays reach it."""
        x, y = self.launch_points(rays, launch, angle)
        sine, dz = np.sin(angle), np.cos(angle)
        zero = np.zeros(len(rays))
        start = Rays(
            x=x, y=y, z=zero + self.frame.z_mm,
            dx=sine * self.cos_azimuth[rays], dy=sine * self.sin_azimuth[rays], dz=dz,
            wavelength_nm=self.wavelength[rays], opl_mm=zero,
            status=np.zeros(len(rays), np.int32), failed_at=np.full(len(rays), -1, np.int32),
        )  # fmt: skip
        position = np.zeros((2, len(rays)))

        def visit(number: int, now: Rays) -> None:
            if number == self.stop:
                position[:] = now.x, now.y

        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            status = trace_program(self.front, self.theta, start, NUMPY, visit).status
        return position / self.frame.stop_mm, np.asarray((status == OK) & np.isfinite(position).all(0))

    def newton(self, rays: IntArray, launch: FloatArray, angle: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Points (2, m) from which rays of these angles meet the centre, by Newton from starts nearby, and whether."""
        launch, converged = launch.copy(), np.zeros(len(rays), bool)
        last_step = np.full(len(rays), np.inf)
        h = DIFFERENCE * self.frame.scale_mm
        active = np.arange(len(rays))
        for last in [*[False] * NEWTON_STEPS, True]:
            residual, traced = self.residual(rays[active], launch[:, active], angle[active])
            met = traced & (np.hypot(*residual) < TOLERANCE)
            converged[active[met]] = True
            open_ = traced & ~met
            active, residual = active[open_], residual[:, open_]
            if last or not len(active):
                break
            columns = []  # of the Jacobian
            for k in (0, 1):
                moved = launch[:, active].copy()
                moved[k] += h
                moved_residual, traced = self.residual(rays[active], moved, angle[active])
                columns.append(np.where(traced, (moved_residual - residual) / h, np.nan))
            (a, c), (b, d) = columns
            with np.errstate(invalid="ignore", divide="ignore"):
                step = np.stack([b * residual[1] - d * residual[0], c * residual[0] - a * residual[1]])
                step /= a * d - b * c
            length = np.hypot(*step)
            shrinks = length <= CONTRACTION * last_step[active]
            last_step[active] = length
            launch[:, active[shrinks]] += step[:, shrinks]
            active = active[shrinks]
        return launch, converged

    def run(self) -> tuple[FloatArray, BoolArray]:
        """Launch points (2, n), and whether the full field angle was reached: linear extrapolation from the last two
        points, then Newton."""
        count = len(self.angle)
        launch, angle = np.zeros((2, count)), np.zeros(count)
        previous, previous_angle = np.zeros((2, count)), np.zeros(count)
        step = np.full(count, FIRST_STEP_RAD)
        converged, first = np.zeros(count, bool), np.ones(count, bool)
        active = np.arange(count)
        while len(active):
            target = np.minimum(angle[active] + step[active], self.angle[active])
            span = np.where(first[active], 1.0, angle[active] - previous_angle[active])
            ratio = np.where(first[active], 0.0, (target - angle[active]) / span)
            guess = launch[:, active] + ratio * (launch[:, active] - previous[:, active])
            solution, accepted = self.newton(active, guess, target)
            moved = active[accepted]
            previous[:, moved], previous_angle[moved] = launch[:, moved], angle[moved]
            launch[:, moved], angle[moved] = solution[:, accepted], target[accepted]
            begun = moved[first[moved]]  # no slope yet: the next step starts where the first one ended
            previous[:, begun], previous_angle[begun] = launch[:, begun], angle[begun] - 1.0
            first[moved] = False
            converged[moved] = angle[moved] >= self.angle[moved]
            step[active] = np.where(accepted, np.minimum(2.0 * step[active], FIRST_STEP_RAD), 0.5 * step[active])
            active = active[~converged[active] & (step[active] > LEAST_STEP_RAD)]
        return launch, converged


def aim_at_stop(lens: LensSystem, direction: ArrayLike, wavelength_nm: ArrayLike) -> AimedRays:
    """Rays of directions (..., 3) in the lens frame that pass the centre of the stop."""
    direction = np.asarray(direction, float)
    wave = np.asarray(wavelength_nm, float)
    shape = np.broadcast_shapes(direction.shape[:-1], wave.shape)
    directions = np.broadcast_to(direction, (*shape, 3)).reshape(-1, 3)
    aiming = _Aiming(lens, directions, np.broadcast_to(wave, shape).ravel())
    launch, converged = aiming.run()
    x, y = aiming.launch_points(np.arange(len(directions)), launch, np.where(converged, aiming.angle, 0.0))
    return AimedRays(
        x_mm=x.reshape(shape), y_mm=y.reshape(shape), z_mm=aiming.frame.z_mm, converged=converged.reshape(shape)
    )
