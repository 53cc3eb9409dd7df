"""Everything that a run of the budget found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.budget.attitude import AttitudeStudy
from experiments.budget.combine import Budget
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
    predicted : PredictedTerms
        Without frames.
    measured : Measurement
        From frames.
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
    predicted: PredictedTerms
    measured: Measurement
    published: Budget
    sweep: Sweep | None
    tornado: Tornado | None
    tolerances: ToleranceStudy
    attitude: AttitudeStudy
    changed: Mapping[str, tuple[object, object]]

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

    def pull(self, name: str) -> NDArray[np.float64]:
        """Predicted minus measured (2,) in standard deviations; of the chromatic term by its signed entries."""
        if name == "LSFE-S":
            return self.chromatic_pull
        a, b = self.predicted.budget[name], self.measured.budget[name]
        spread = self._together(name, a.uncertainty_arcsec, b.uncertainty_arcsec)
        return np.asarray((a.arcsec - b.arcsec) / spread)

    @staticmethod
    def _together(name: str, predicted: NDArray[np.float64], measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of a difference.

        Of the HSFE and of C1 both are estimates of one scatter, by model and from the data (jackknife over the stars,
        surveys); the larger counts. That of C1 contains what is frozen into chip and frames, which no survey shows.
        """
        same = name in ("HSFE", "LSFE-C1")
        return np.asarray(np.maximum(predicted, measured) if same else np.hypot(predicted, measured))

    @property
    def chromatic_pull(self) -> NDArray[np.float64]:
        """Largest distance (2,) of a signed entry of Table 1 from its prediction, in standard deviations."""
        a, b = self.predicted.chromatic, self.measured.chromatic
        pulls = [
            (a.table1_px[name] - b.table1_px[name]) / np.hypot(a.sigma_px[name], b.sigma_px[name])
            for name in b.table1_px
        ]
        return np.asarray(np.stack(pulls)[np.abs(pulls).argmax(0), [0, 1]])
