"""The movement of one lens element that gives a wanted chromatic shift, by ray trace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from experiments.laboratory.bench import Bench, point_field
from experiments.laboratory.chromatic_error import rms, shifts, table1
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.readout.search import SEARCH_MARGIN_PX
from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.lens.perturb import decentre, tilt
from optics.lens.system import LensSystem
from render.tracing.tracer import Tracer

__all__ = ["Solution", "check_motion", "perturbed", "solve_perturbation"]


def perturbed(lens: LensSystem, element: str, kind: str, axis: int, amount: float) -> LensSystem:
    """The lens with one element moved: ``decentre`` [mm] along x or y, ``tilt`` [deg] in the plane of x or y and z."""
    if kind == "decentre":
        return decentre(lens, element, *((amount, 0.0) if axis == 0 else (0.0, amount)))
    return tilt(lens, element, *((0.0, amount) if axis == 0 else (amount, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """The movement of one element that gives the published mean shift."""

    element: str  # Which, and how: ``decentre`` or ``tilt``
    kind: str  # Which, and how: ``decentre`` or ``tilt``
    amount: float  # um for a decentre, arcmin for a tilt; NaN, as all below, when none up to the limit does
    table1_px: dict[str, FloatArray]  # (2,) ACC18's statistic at this amount, by ray trace
    rms_px: dict[str, FloatArray]  # (2,) RMS shift per axis
    boresight_px: FloatArray  # (2,) Motion of the whole image in the reference band

    @property
    def unit(self) -> str:
        """Unit of `amount`."""
        return "um" if self.kind == "decentre" else "arcmin"

    @property
    def shown_unit(self) -> str:
        """The same for readers."""
        return self.unit.replace("um", "µm")

    @property
    def label(self) -> str:
        """What is moved, and how far, e.g. "L2 decentred +117 µm"."""
        verb, digits = ("decentred", 0) if self.kind == "decentre" else ("tilted", 1)
        return f"{self.element} {verb} {self.amount:+.{digits}f} {self.shown_unit}"

    def apply(self, lens: LensSystem, axis: int) -> LensSystem:
        """The lens with the element moved by this amount; see `perturbed`."""
        return perturbed(lens, self.element, self.kind, axis, self.amount / _UNIT[self.kind])


REACHED_PX = 1e-12
"""A mean shift that differs by no more from the wanted one needs no movement; mirrors have no other."""
_LIMIT = {"decentre": 3.0, "tilt": 3.0}
_UNIT = {"decentre": 1e3, "tilt": 60.0}
"""um per mm, arcmin per deg: `Solution.amount` against the argument of `perturbed`."""


def solve_perturbation(
    bench: Bench,
    instrument: Instrument,
    direction: FloatArray,
    *,
    element: str,
    kind: str,
    pair: str,
    axis: int,
    wanted_px: float,
) -> Solution:
    """How far one element has to move for the statistic of one pair of bands to reach a value."""
    lens = instrument.camera.lens
    stars = point_field(bench, instrument, direction.reshape(-1, 3))

    def means(amount: float) -> FloatArray:
        camera = replace(instrument.camera, lens=perturbed(lens, element, kind, axis, amount))
        mean = Tracer(camera, general=True).bundle_means(stars, rings=4, arms=12)
        return mean.reshape(*direction.shape[:2], len(bench.filters), 2)

    def excess(amount: float) -> float:
        return float(table1(shifts(means(amount), bench.pairs)[pair])[axis]) - wanted_px

    amount, rest = _root(excess, _LIMIT[kind]), means(0.0)
    found = means(amount) if np.isfinite(amount) else np.full_like(rest, np.nan)
    every = shifts(found, bench.pairs)
    return Solution(
        element=element,
        kind=kind,
        amount=amount * _UNIT[kind],
        table1_px={name: table1(shift) for name, shift in every.items()},
        rms_px={name: rms(shift) for name, shift in every.items()},
        boresight_px=(found - rest)[:, :, bench.reference].mean((0, 1)),
    )


def _root(excess: Callable[[float], float], limit: float) -> float:
    """Root nearest to zero within +-limit; NaN if there is none.

    The statistic is nearly linear in the movement, so its slope at zero tells where to look.
    """
    rest = excess(0.0)
    if abs(rest) < REACHED_PX:
        return 0.0
    step = limit * 1e-2
    slope = (excess(step) - excess(-step)) / (2 * step)
    guess = -rest / slope if slope != 0.0 else np.inf
    if not abs(guess) < 1.5 * limit:
        return float("nan")
    for margin in (0.3 * abs(guess) + 0.1 * step, limit):
        low, high = max(guess - margin, -limit), min(guess + margin, limit)
        if low < high and excess(low) * excess(high) <= 0:
            break
    else:
        return float("nan")
    root, state = brentq(excess, low, high, xtol=limit * 1e-6, full_output=True)
    if not state.converged:
        raise ConvergenceError(
            f"the movement that gives the wanted shift was not found within {state.iterations} steps"
        )
    return float(root)


def check_motion(bench: Bench, chosen: Solution, wanted_px: float) -> None:
    """Refuse a moved element that carries the target's image out of the search area or off the detector."""
    moves = float(np.abs(chosen.boresight_px).max())
    room = min(float(SEARCH_MARGIN_PX), bench.target.edge_px - bench.window_px // 2 - 1)
    if moves > room:
        raise DomainError(
            f"a mean shift of decentre.wanted_px = {wanted_px:g} px takes a {chosen.kind} of {chosen.element} by "
            f"{chosen.amount:.0f} {chosen.unit}, which moves the whole image by {moves:.0f} px; at most {room:.0f} px "
            f"can be followed (target.edge_px = {bench.target.edge_px:g} px, and {SEARCH_MARGIN_PX} px in any case): "
            "lower decentre.wanted_px or name another decentre.element"
        )
