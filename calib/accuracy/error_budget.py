"""Sum of the terms of the error budget of a star camera (ACC18, eq. 31-32), with uncertainties.

    sigma_LSFE = sqrt(sigma_S^2 + (sigma_C1 + sigma_C2)^2)
    total      = sqrt(TE^2 + HSFE^2 + sigma_LSFE^2)
    attitude   = total / sqrt(N)

All numbers are 3 sigma in arcsec, (2,) for x and y.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from optics.arrays import FloatArray
from optics.records import freeze_all

TERMS = ("TE", "HSFE", "LSFE-S", "LSFE-C1", "LSFE-C2")
FRAME_TERMS = ("TE", "HSFE", "LSFE-S")
"""Terms that frames alone measure: C2 is the scatter of surveys, and C1 of a good lens follows from it."""
SUMS = ("LSFE", "total", "attitude")
ECSS = {
    "TE": "temporal noise",
    "HSFE": "pixel spatial error",
    "LSFE-S": "field-of-view spatial error, chromatic",
    "LSFE-C1": "field-of-view spatial error, distortion",
    "LSFE-C2": "(target marking, of the laboratory)",
    "LSFE": "field-of-view spatial error",
    "total": "",
    "attitude": "",
}
"""Names of ECSS-E-ST-60-20C Rev.2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorTerm:
    """A term of the budget, 3 sigma, per axis."""

    arcsec: FloatArray  # (2,) x (along a row), y (along a column)
    # (2,) Standard deviation of the term; NaN where the sample does not tell
    uncertainty_arcsec: FloatArray = field(default_factory=lambda: np.zeros(2))
    n: int = 0  # Samples; 0 for a prediction

    def __post_init__(self) -> None:
        freeze_all(self, arcsec=(2,), uncertainty_arcsec=(2,), finite=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorBudget:
    """All terms and their sums."""

    term: Mapping[str, ErrorTerm]  # By the names of `TERMS`
    lsfe: ErrorTerm  # Eq. 31
    total: ErrorTerm  # Eq. 32
    attitude: ErrorTerm  # Predicted: `over_stars` of the total; measured: of solved attitudes

    def __getitem__(self, name: str) -> ErrorTerm:
        """A term or a sum by its name."""
        sums = {"LSFE": self.lsfe, "total": self.total, "attitude": self.attitude}
        return sums[name] if name in sums else self.term[name]


def over_stars(total_arcsec: FloatArray, stars: int) -> FloatArray:
    """ACC18's attitude error from N stars."""
    return np.asarray(total_arcsec / np.sqrt(stars))


def combine(term: Mapping[str, ErrorTerm], *, stars: int) -> ErrorBudget:
    """Add up the terms (ACC18 eq. 31-32).

    Parameters
    ----------
    term : mapping of str to ErrorTerm
        The five terms by the names of `TERMS`.
    stars : int
        Number of stars N of the attitude.

    Returns
    -------
    ErrorBudget
        Terms and sums; uncertainties to first order, of independent terms.
    """
    te, hsfe, s, c1, c2 = (term[name] for name in TERMS)
    linear = c1.arcsec + c2.arcsec
    lsfe = np.hypot(s.arcsec, linear)
    total = np.sqrt(te.arcsec**2 + hsfe.arcsec**2 + lsfe**2)
    of_lsfe = np.hypot(s.arcsec * s.uncertainty_arcsec, linear * np.hypot(c1.uncertainty_arcsec, c2.uncertainty_arcsec))
    of_total = np.sqrt(
        (te.arcsec * te.uncertainty_arcsec) ** 2 + (hsfe.arcsec * hsfe.uncertainty_arcsec) ** 2 + of_lsfe**2
    )
    least = 1e-300
    total_term = ErrorTerm(arcsec=total, uncertainty_arcsec=of_total / np.maximum(total, least))
    return ErrorBudget(
        term=dict(term),
        lsfe=ErrorTerm(arcsec=lsfe, uncertainty_arcsec=of_lsfe / np.maximum(lsfe, least)),
        total=total_term,
        attitude=ErrorTerm(
            arcsec=over_stars(total, stars), uncertainty_arcsec=over_stars(total_term.uncertainty_arcsec, stars)
        ),
    )
