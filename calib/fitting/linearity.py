"""Whether a covariance of first order holds: chi-square at the end of its longest axis.

For a linear problem with normal noise the region of one standard deviation is an ellipsoid on whose surface chi-square
has risen by one (Beale 1960, J. R. Stat. Soc. B 22, 41, compares the two surfaces). Where the valley of chi-square
curves or narrows within a standard deviation, the rise on the ellipsoid's longest axis is another one, and the
covariance states neither the size nor the shape of the errors.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.fitting.block_arrow import GaussNewtonStep, spectrum
from calib.fitting.least_squares import Problem
from optics.arrays import FloatArray

NAMED_PART = 0.1
"""Squared component of an unknown in a direction above which the unknown is named."""


def chi_square_rise(problem: Problem, state: Any, weight: FloatArray) -> tuple[float, list[str]]:
    """Rise of chi-square at one sigma along the least determined direction; unknowns that take part in it.

    The mean over both directions, with weights (n,) of the groups of residuals at the minimum: 1 for a linear problem,
    infinite if a side leaves the domain, NaN if a direction is not determined at all.
    """
    evaluation = problem.evaluate(state)
    reduced = problem.system(evaluation, weight).reduce()
    eigenvalues, eigenvectors, determined = spectrum(reduced)
    if not determined.all():
        return float("nan"), []
    scale = np.where(reduced.scale > 0, reduced.scale, 1.0)
    sigma = eigenvectors[:, 0] / scale / np.sqrt(eigenvalues[0])

    def chi_square(at: Any) -> float:
        squares = np.einsum("ni,ni->n", at.residual, at.residual)
        return float(weight @ squares + at.penalty)

    rises = []
    for common in (sigma, -sigma):
        block = None if reduced.border is None else -np.einsum("fbp,p->fb", reduced.border, common)
        moved = problem.evaluate(
            problem.move(state, GaussNewtonStep(common=common, block=block, decrease=0.0, length=1.0))
        )
        rises.append(chi_square(moved) - chi_square(evaluation))
    rise = float(np.mean(rises))
    names = [name for name, part in zip(problem.names, eigenvectors[:, 0] ** 2, strict=True) if part > NAMED_PART]
    return rise if np.isfinite(rise) else float("inf"), names
