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
from experiments.budget.tolerances import ToleranceStudy

__all__ = ["Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A run.

    Attributes
    ----------
    config : Config
        Settings.
    lab : Laboratory
        The instrument and its benches.
    predicted : dict of str to PredictedTerms
        Without frames, by centroider; the one that counts first.
    measured : dict of str to Measurement
        From frames, the same ones for all centroiders.
    published : Budget
        ACC18's terms, added up by its own equations.
    sweep : Sweep or None
        The budget against a parameter.
    tornado : Tornado or None
        Sensitivities.
    tolerances : ToleranceStudy
        Lenses as built.
    attitude : AttitudeStudy
        From the measured budget.
    changed : mapping of str to (object, object)
        Settings that differ from the defaults: default, here.
    """

    config: Config
    lab: Laboratory
    predicted: Mapping[str, PredictedTerms]
    measured: Mapping[str, Measurement]
    published: Budget
    sweep: Sweep | None
    tornado: Tornado | None
    tolerances: ToleranceStudy
    attitude: AttitudeStudy
    changed: Mapping[str, tuple[object, object]]

    def ratio(self, name: str, method: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Predicted over measured (2,) and its standard deviation; NaN where nothing was found (`found`)."""
        a, b = self.predicted[method].budget[name], self.measured[method].budget[name]
        with np.errstate(divide="ignore", invalid="ignore"):
            value = a.arcsec / b.arcsec
            relative = self._together(name, a.uncertainty_arcsec / a.arcsec, b.uncertainty_arcsec / b.arcsec)
        known = self.found(name, method)
        return np.where(known, value, np.nan), np.where(known, value * relative, np.nan)

    def found(self, name: str, method: str) -> NDArray[np.bool_]:
        """Per axis, whether a term stands out of its uncertainty (5 sigma of the measurement): else no ratio."""
        a, b = self.predicted[method].budget[name], self.measured[method].budget[name]
        return np.asarray((a.arcsec > 5.0 * b.uncertainty_arcsec) & (a.arcsec > 0))

    def pull(self, name: str, method: str) -> NDArray[np.float64]:
        """Predicted minus measured (2,) in standard deviations; of the chromatic term by its signed entries."""
        if name == "LSFE-S":
            return self.chromatic_pull(method)
        a, b = self.predicted[method].budget[name], self.measured[method].budget[name]
        spread = self._together(name, a.uncertainty_arcsec, b.uncertainty_arcsec)
        return np.asarray((a.arcsec - b.arcsec) / spread)

    def together(self, method: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Root sum of squares of `FRAME_TERMS`, predicted over measured (2,), and its standard deviation."""
        sides = (self.predicted[method].budget, self.measured[method].budget)
        a, b = (np.sqrt(sum((one[name].arcsec ** 2 for name in FRAME_TERMS), np.zeros(2))) for one in sides)
        spread = np.zeros(2)
        for name in FRAME_TERMS:
            of = self._together(name, *(one[name].uncertainty_arcsec for one in sides))
            spread = spread + (sides[1][name].arcsec * of) ** 2
        return np.asarray(a / b), np.asarray(np.sqrt(spread) / b**2)

    @staticmethod
    def _together(name: str, predicted: NDArray[np.float64], measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of a difference.

        Of the HSFE and of C1 both are estimates of one scatter, by model and from the data (jackknife over the stars,
        surveys); the larger counts. That of C1 contains what is frozen into chip and frames, which no survey shows.
        """
        same = name in ("HSFE", "LSFE-C1")
        return np.asarray(np.maximum(predicted, measured) if same else np.hypot(predicted, measured))

    def chromatic_pulls(self, method: str) -> NDArray[np.float64]:
        """Distance of every signed entry of Table 1 (b, 2) from its prediction, in standard deviations."""
        a, b = self.predicted[method].chromatic, self.measured[method].chromatic
        return np.stack(
            [
                (a.table1_px[name] - b.table1_px[name]) / np.hypot(a.sigma_px[name], b.sigma_px[name])
                for name in b.table1_px
            ]
        )

    def chromatic_pull(self, method: str) -> NDArray[np.float64]:
        """The largest of them (2,)."""
        pulls = self.chromatic_pulls(method)
        return np.asarray(pulls[np.abs(pulls).argmax(0), [0, 1]])
