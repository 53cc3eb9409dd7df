"""Real ray aiming: the chief ray of a star through the centre of the stop.

Newton's iteration started on the axis of a wide lens may end on a spurious ray. Every ray is therefore followed from
the axis outwards: the field angle grows in steps, each started by extrapolation from the previous ones. A step is
accepted only if Newton's corrections shrink fast and no surface is missed on the way, otherwise it is halved (natural
continuation; Allgower and Georg 1990, *Numerical Continuation Methods*, ch. 2). Rays do not influence each other.
Positions on the stop are measured on the stop's own surface.
"""

from __future__ import annotations

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
"""A correction is at most this part of the one before it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AimFrame:
    """Plane of launch, and the length scales of tolerances."""

    z_mm: float  # Plane of launch: the paraxial entrance pupil, or the first vertex where that is at infinity
    scale_mm: float  # Radius of the paraxial entrance pupil, or of the widest aperture
    stop_mm: float  # Radius of the stop, or ``scale_mm`` where it has none


@dataclass(frozen=True, slots=True, kw_only=True)
class AimedRays:
    """Rays through the centre of the stop."""

    x_mm: FloatArray  # Where they cross the plane of launch; where the aim failed, where it got lost
    y_mm: FloatArray
    z_mm: float  # That plane
    found: BoolArray  # Whether they pass the centre of the stop


def aim_frame(lens: LensSystem) -> AimFrame:
    """Plane of launch and sizes of a lens."""
    try:
        first = axial_paraxial(lens, lens.design_wavelength_nm)
        pupil = np.array([first.entrance_pupil_z_mm, first.entrance_pupil_radius_mm])
    except DomainError:  # no power
        pupil = np.array([np.nan, np.nan])
    rims = [s.semi_diameter_mm for s in lens.surfaces if np.isfinite(s.semi_diameter_mm)]
    near = bool(np.isfinite(pupil).all())
    if not (near or rims):
        raise ConvergenceError(f"lens {lens.name!r} has no aperture that limits a beam")
    z, scale = (float(v) for v in (pupil if near else (lens.surfaces[0].position_mm[2], max(rims))))
    stop = lens.surfaces[lens.stop_index].semi_diameter_mm
    return AimFrame(
        z_mm=z,
        scale_mm=scale,
        stop_mm=float(stop) if np.isfinite(stop) else scale,
    )


def front_of(program: LensProgram, stop: int) -> LensProgram:
    """The part of a compiled lens up to its stop, with the parameters of the lens."""
    return replace(program, steps=program.steps[: stop + 1])


def without_apertures(program: LensProgram) -> LensProgram:
    """A compiled lens that stops no ray, so that a ray's status tells whether it can be traced."""
    return replace(program, steps=tuple(replace(step, aperture_at=-1, outlines=()) for step in program.steps))


def without_holes(program: LensProgram) -> LensProgram:
    """A compiled lens without central obscurations."""
    steps = (
        replace(step, annular=False, outlines=tuple(outline for outline in step.outlines if not outline[3]))
        for step in program.steps
    )
    return replace(program, steps=tuple(steps))


class _Aim:
    """Continuation of n rays; lanes are numbered."""

    def __init__(self, lens: LensSystem, direction: FloatArray, wavelength_nm: FloatArray) -> None:
        self.frame = aim_frame(lens)
        program, theta = compile_lens(lens)
        self.front, self.theta = front_of(without_apertures(program), lens.stop_index), NUMPY.parameters(theta)
        self.stop = lens.stop_index
        side = np.hypot(direction[:, 0], direction[:, 1])
        self.angle = np.arctan2(side, direction[:, 2])
        self.cosine, self.sine = (
            np.divide(direction[:, k], side, out=np.full(len(side), 1.0 - k), where=side > 0.0) for k in (0, 1)
        )
        self.wavelength = wavelength_nm

    def launch(self, lanes: IntArray, at: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n,) of the plane of launch; ``at`` (2, n) counts in the plane normal to the ray, meridional first."""
        along = at[0] / np.cos(angle)
        c, s = self.cosine[lanes], self.sine[lanes]
        return along * c - at[1] * s, along * s + at[1] * c

    def miss(self, lanes: IntArray, at: FloatArray, angle: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Distance of rays from the centre of the stop, (2, n) in its radii, and whether they reach it."""
        x, y = self.launch(lanes, at, angle)
        side, dz = np.sin(angle), np.cos(angle)
        zero = np.zeros(len(lanes))
        rays = Rays(
            x=x, y=y, z=zero + self.frame.z_mm,
            dx=side * self.cosine[lanes], dy=side * self.sine[lanes], dz=dz,
            wavelength_nm=self.wavelength[lanes], opl_mm=zero,
            status=np.zeros(len(lanes), np.int32), failed_at=np.full(len(lanes), -1, np.int32),
        )  # fmt: skip
        passed = np.zeros((2, len(lanes)))

        def visit(number: int, rays: Rays) -> None:
            if number == self.stop:
                passed[:] = rays.x, rays.y

        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            status = trace_program(self.front, self.theta, rays, NUMPY, visit).status
        return passed / self.frame.stop_mm, np.asarray((status == OK) & np.isfinite(passed).all(0))

    def newton(self, lanes: IntArray, at: FloatArray, angle: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Points (2, n) from which rays of these angles meet the centre, from starts nearby, and which do."""
        at, found = at.copy(), np.zeros(len(lanes), bool)
        before = np.full(len(lanes), np.inf)
        h = DIFFERENCE * self.frame.scale_mm
        todo = np.arange(len(lanes))
        for last in [*[False] * NEWTON_STEPS, True]:
            here, traced = self.miss(lanes[todo], at[:, todo], angle[todo])
            met = traced & (np.hypot(*here) < TOLERANCE)
            found[todo[met]] = True
            going = traced & ~met
            todo, here = todo[going], here[:, going]
            if last or not len(todo):
                break
            slopes = []
            for k in (0, 1):
                moved = at[:, todo].copy()
                moved[k] += h
                there, traced = self.miss(lanes[todo], moved, angle[todo])
                slopes.append(np.where(traced, (there - here) / h, np.nan))
            (a, c), (b, d) = slopes
            with np.errstate(invalid="ignore", divide="ignore"):
                step = np.stack([b * here[1] - d * here[0], c * here[0] - a * here[1]]) / (a * d - b * c)
            size = np.hypot(*step)
            shrinks = size <= CONTRACTION * before[todo]
            before[todo] = size
            at[:, todo[shrinks]] += step[:, shrinks]
            todo = todo[shrinks]
        return at, found

    def run(self) -> tuple[FloatArray, BoolArray]:
        """Points (2, n) from which the rays start, and which of them were found."""
        count = len(self.angle)
        at, behind = np.zeros((2, count)), np.zeros((2, count))
        reached, left = np.zeros(count), np.zeros(count)  # angles, and those of the point behind
        step = np.full(count, FIRST_STEP_RAD)
        found, first = np.zeros(count, bool), np.ones(count, bool)
        todo = np.arange(count)
        while len(todo):
            goal = np.minimum(reached[todo] + step[todo], self.angle[todo])
            run = np.where(first[todo], 1.0, reached[todo] - left[todo])
            ahead = np.where(first[todo], 0.0, (goal - reached[todo]) / run)
            point, good = self.newton(todo, at[:, todo] + ahead * (at[:, todo] - behind[:, todo]), goal)
            on = todo[good]
            # the first point counts as one behind only after it has moved away from the start
            behind[:, on], left[on] = at[:, on], reached[on]
            at[:, on], reached[on] = point[:, good], goal[good]
            begun = first[on]
            behind[:, on[begun]] = at[:, on[begun]]
            left[on[begun]] = reached[on[begun]] - 1.0  # no slope known yet: the next step starts where this one ended
            first[on] = False
            found[on] = reached[on] >= self.angle[on]
            step[todo] = np.where(good, np.minimum(2.0 * step[todo], FIRST_STEP_RAD), 0.5 * step[todo])
            todo = todo[~found[todo] & (step[todo] > LEAST_STEP_RAD)]
        return at, found


def aim_at_stop(lens: LensSystem, direction: ArrayLike, wavelength_nm: ArrayLike) -> AimedRays:
    """Rays of stars that pass the centre of the stop.

    Shapes: ``direction`` (..., 3).
    """
    direction = np.asarray(direction, float)
    wave = np.asarray(wavelength_nm, float)
    shape = np.broadcast_shapes(direction.shape[:-1], wave.shape)
    lanes = np.broadcast_to(direction, (*shape, 3)).reshape(-1, 3)
    aim = _Aim(lens, lanes, np.broadcast_to(wave, shape).ravel())
    at, found = aim.run()
    x, y = aim.launch(np.arange(len(lanes)), at, np.where(found, aim.angle, 0.0))
    return AimedRays(x_mm=x.reshape(shape), y_mm=y.reshape(shape), z_mm=aim.frame.z_mm, found=found.reshape(shape))
