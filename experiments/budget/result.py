"""Everything that a run of the budget found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.budget.attitude import AttitudeStudy
from experiments.budget.combine import FRAME_TERMS, Budget
from experiments.budget.laboratory import Laboratory
from experiments.budget.settings import Config
from experiments.budget.sweep import Sweep, Tornado
from experiments.budget.terms import Measurement, PredictedTerms
from experiments.budget.thermal import ThermalTerm
from experiments.budget.tolerances import ToleranceStudy
from experiments.laboratory.collimator_effects import ChromaticEffect

__all__ = ["Result", "TermPair"]


@dataclass(frozen=True, slots=True)
class TermPair:
    """What one centroider should show, and what it shows."""

    predicted: PredictedTerms  # Without frames
    measured: Measurement  # From frames

    def ratio(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Predicted over measured (2,) and its standard deviation; NaN where nothing was found (`found`)."""
        a, b = self.predicted.budget[name], self.measured.budget[name]
        with np.errstate(divide="ignore", invalid="ignore"):
            value = a.arcsec / b.arcsec
            relative = self._together(name, a.uncertainty_arcsec / a.arcsec, b.uncertainty_arcsec / b.arcsec)
        known = self.found(name)
        return np.where(known, value, np.nan), np.where(known, value * relative, np.nan)

    def found(self, name: str) -> NDArray[np.bool_]:
        """Per axis, whether a term stands out of its uncertainty (5 sigma of the measurement): else no ratio."""
        a, b = self.predicted.budget[name], self.measured.budget[name]
        return np.asarray((a.arcsec > 5.0 * b.uncertainty_arcsec) & (a.arcsec > 0))

    def pulls(self, name: str) -> NDArray[np.float64]:
        """Predicted minus measured (2,) in standard deviations; of the chromatic term of its signed entries (b, 2)."""
        if name == "LSFE-S":
            a, b = self.predicted.chromatic, self.measured.chromatic
            entries = [
                (a.table1_px[pair] - b.table1_px[pair]) / np.hypot(a.sigma_px[pair], b.sigma_px[pair])
                for pair in b.table1_px
            ]
            return np.stack(entries)
        one, other = self.predicted.budget[name], self.measured.budget[name]
        spread = self._together(name, one.uncertainty_arcsec, other.uncertainty_arcsec)
        return np.asarray((one.arcsec - other.arcsec) / spread)

    def largest_pull(self, name: str) -> NDArray[np.float64]:
        """The largest of `pulls` per axis (2,)."""
        pulls = np.atleast_2d(self.pulls(name))
        return np.asarray(pulls[np.abs(pulls).argmax(0), [0, 1]])

    def together(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Root sum of squares of `FRAME_TERMS`, predicted over measured (2,), and its standard deviation."""
        sides = (self.predicted.budget, self.measured.budget)
        a, b = (np.sqrt(sum((one[name].arcsec ** 2 for name in FRAME_TERMS), np.zeros(2))) for one in sides)
        spread = np.zeros(2)
        for name in FRAME_TERMS:
            of = self._together(name, *(one[name].uncertainty_arcsec for one in sides))
            spread = spread + (sides[1][name].arcsec * of) ** 2
        return np.asarray(a / b), np.asarray(np.sqrt(spread) / b**2)

    @staticmethod
    def _together(name: str, predicted: NDArray[np.float64], measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of a difference.

        Of the HSFE and of C1 the prediction's is the scatter of the measured number itself, from chip to chip; what
        jackknife and surveys see is part of it and not added once more.
        """
        return np.asarray(predicted if name in ("HSFE", "LSFE-C1") else np.hypot(predicted, measured))


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A run."""

    config: Config  # Settings
    lab: Laboratory  # The instrument and its benches
    predicted: Mapping[str, PredictedTerms]  # Without frames, by centroider; the one that counts first
    measured: Mapping[str, Measurement]  # From frames, the same ones for all centroiders
    # ACC18's terms, added up by its own equations; None for another sensor than the published one
    published: Budget | None
    sweep: Sweep | None  # The budget against a parameter
    tornado: Tornado | None  # Sensitivities
    tolerances: ToleranceStudy  # Lenses as built
    attitude: AttitudeStudy  # From the measured budget
    thermal: ThermalTerm | str | None  # LSFE-T, apart from the budget; why there is none; None where it is switched off
    collimator: ChromaticEffect | None  # What the collimator adds to Table 1; None for a perfect one
    # (object, object) Settings that differ from the defaults: default, here
    changed: Mapping[str, tuple[object, object]]

    def pair(self, method: str) -> TermPair:
        """Both sides of a centroider."""
        return TermPair(self.predicted[method], self.measured[method])
