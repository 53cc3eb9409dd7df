"""Judgement of a finished fit: usable or refused, with the reason.

A calibration is refused if the typical residual is far above the stated sigma, if too many stars do not fit, if the
remaining stars are too few to identify wrong ones, or if the sky is mirrored. The numbers stay in the record.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.fitting.misfit import LARGEST_RATIO, LARGEST_WRONG_PART, joined
from calib.fitting.solution import Solution
from optics.arrays import BoolArray, FloatArray, IntArray

WRONG_PULL = 6.0  # length of a star's residual [sigma] beyond which it counts as a wrong match


def verdict(
    solution: Solution,
    hint: Callable[[], str],
    *,
    spread: float,
    degrees_of_freedom: int,
    wrong: BoolArray | None = None,
    left_out: int = 0,
) -> tuple[str, str]:
    """Status and message of a finished fit.

    ``hint`` tells what could be the cause, and is asked only when the fit is refused or did not converge; ``spread`` is
    the typical residual over the stated sigma; ``wrong`` (n,) are the stars that do not fit, None where no robust loss
    has looked for them; ``left_out`` stars have no weight, and count in no degree of freedom.
    """
    if solution.status == "refused":
        reason = solution.message
    elif wrong is None:
        reason = _too_far_off(spread)
    else:
        reason = _too_many_wrong(spread, wrong, left_out, degrees_of_freedom)
    if reason or solution.status in ("stalled", "iteration_limit"):
        return "refused" if reason else solution.status, joined(reason or solution.message, hint())
    lost = "" if wrong is None or not wrong.any() else f"{np.count_nonzero(wrong)} stars do not fit"
    return solution.status, joined(solution.message, lost, solution.misfit.note)


def _too_far_off(spread: float) -> str:
    """Reason to refuse a least-squares fit, or nothing."""
    if not spread > LARGEST_RATIO:
        return ""
    return (
        f"residuals are {spread:.3g} times the stated sigma, more than {LARGEST_RATIO:g}: wrong matches (take the loss "
        '"tukey"), a wrong camera model or too small a sigma'
    )


def _too_many_wrong(spread: float, wrong: BoolArray, left_out: int, degrees_of_freedom: int) -> str:
    """Reason to refuse a robust fit, or nothing: without as many degrees of freedom to spare as stars were left out,
    almost any stars can be made to fit."""
    part = float(np.mean(wrong)) if len(wrong) else 0.0
    if spread > LARGEST_RATIO:
        return (
            f"the typical residual is {spread:.3g} times the stated sigma, more than {LARGEST_RATIO:g}: about half of "
            "the matches are wrong, or the camera model or the sigma is"
        )
    if part > LARGEST_WRONG_PART:
        return f"{100 * part:.0f} % of the stars do not fit, more than {100 * LARGEST_WRONG_PART:g} %"
    if degrees_of_freedom < 1 or (left_out > 0 and degrees_of_freedom < 2 * left_out):
        return (
            f"{left_out} stars do not fit, and the rest has only {max(degrees_of_freedom, 0)} degrees of freedom, too "
            "few to tell wrong stars from right ones"
        )
    return ""


def parity_hint(measured: FloatArray, reference: FloatArray, group: IntArray, groups: int) -> str:
    """Hint on parity: whether reflections fit the directions better than rotations do.

    The profile matrix of Wahba's problem, sum of u_seen u_reference^T, has the singular values s1 >= s2 >= s3; the best
    rotation reaches s1 + s2 + d s3 with the parity d = +-1, the best reflection s1 + s2 - d s3 (Markley 1988, J.
    Astronaut. Sci. 36, 245).

    Shapes: ``measured`` (n, 3), ``reference`` (n, 3), ``group`` (n,).
    """
    finite = np.all(np.isfinite(measured), axis=1)
    products = (measured[finite][:, :, None] * reference[finite][:, None, :]).reshape(-1, 9)
    profile = np.stack([np.bincount(group[finite], products[:, i], minlength=groups) for i in range(9)], axis=1)
    u, size, vt = np.linalg.svd(profile.reshape(-1, 3, 3))
    parity = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    enough = np.bincount(group[finite], minlength=groups) >= 3
    total = float(np.count_nonzero(finite)) - float(np.sum(size[:, :2]))  # loss without the third part
    third = float(np.sum((parity * size[:, 2])[enough]))
    if third < 0 and abs(third) > 0.5 * abs(total - abs(third)):
        return (
            "the sky is mirrored: reflections fit better than rotations; exchange the axes "
            "(row, column) -> (column, row) or turn one of them round"
        )
    return ""
