"""Maximum likelihood of a Gaussian star integrated over square pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.measure.gaussian import GaussianModel
from calib.measure.options import option
from calib.measure.scoring import LikelihoodFit
from calib.records import NoiseModel, Stamps, StarTable

__all__ = ["GaussianCentroider"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianCentroider(LikelihoodFit):
    """Maximum likelihood of x, y, flux and widths of a pixel-integrated Gaussian, see `calib.measure.scoring`.

    Attributes
    ----------
    sigma_px : float or None
        Known width of the Gaussian (before the pixel); None: the widths along columns and rows are fitted.
    sigma_start_px : float
        First guess of the widths.
    fit_background, max_shift_px, tolerance, max_iterations
        As in `calib.measure.scoring.LikelihoodFit`.
    """

    name: ClassVar[str] = "gaussian"
    label: ClassVar[str] = "Gaussian fit"
    needs_epsf: ClassVar[bool] = False

    sigma_px: float | None = option(None, at_least=0.05, at_most=20, unit="px")
    sigma_start_px: float = option(0.8, at_least=0.05, at_most=20, unit="px")
    max_iterations: int = option(50, at_least=1)

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Position, flux and covariance of every stamp."""
        window = (stamps.electrons.shape[1], stamps.electrons.shape[2])
        start = np.full(2, np.log(self.sigma_start_px)) if self.sigma_px is None else np.empty(0)
        return self.fit(stamps, noise, lambda part, rows: GaussianModel(window, self.sigma_px), shape_start=start)
