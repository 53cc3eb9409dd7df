"""Search of the movement of a lens element that brings a quantity of the image to a wanted value."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from optics.errors import ConvergenceError, DomainError
from optics.lens.perturb import decentre, tilt
from optics.lens.system import LensSystem

REACHED = 1e-12
"""A quantity that differs by no more from the wanted one needs no movement; of mirrors no movement shifts colours."""
REFINEMENTS = 5
"""Most steps of `refined_movement`."""


def moved_element(lens: LensSystem, element: str, kind: str, axis: int, amount: float) -> LensSystem:
    """The lens with an element decentred [mm] along x (``axis`` 0) or y (1), or tilted [deg] in the plane of it and z.

    ``kind`` is ``"decentre"`` or ``"tilt"``.
    """
    if kind not in ("decentre", "tilt"):
        raise DomainError(f"movement {kind!r}; 'decentre' or 'tilt' is needed")
    if kind == "decentre":
        return decentre(lens, element, *((amount, 0.0) if axis == 0 else (0.0, amount)))
    return tilt(lens, element, *((0.0, amount) if axis == 0 else (amount, 0.0)))


def smallest_movement(excess: Callable[[float], float], limit: float) -> float:
    """Movement nearest to zero at which a quantity less its target, ``excess``, vanishes.

    NaN where the slope at rest points to none within +-``limit``; ConvergenceError if the bracketed root is not
    reached.
    """
    rest = excess(0.0)
    if abs(rest) < REACHED:
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
            f"the search for a movement with the wanted shift did not converge in {state.iterations} steps"
        )
    return float(root)


def refined_movement(
    excess: Callable[[float], float], approximate: Callable[[float], float], amount: float, tolerance: float
) -> float:
    """Root of an expensive quantity from that of an approximation, by the slope of the latter (chord method)."""
    step = 1e-2 * abs(amount) + 1e-6
    slope = (approximate(amount + step) - approximate(amount - step)) / (2 * step)
    for _ in range(REFINEMENTS):
        difference = excess(amount)
        if abs(difference) < tolerance:
            return amount
        amount -= difference / slope
    return amount
