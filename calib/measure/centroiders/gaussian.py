"""Maximum likelihood of a Gaussian star integrated over square pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from calib.flags import StarFlag
from calib.measure.centroiding.gaussian import LN_SIGMA_X, LN_SIGMA_Y, WIDTH_PRIOR_LN, WIDTH_PRIOR_PX, GaussianModel
from calib.measure.centroiding.maximum_likelihood import LikelihoodFit, PixelFit
from calib.measure.centroiding.options import option
from calib.records import Stamps
from optics.arrays import FloatArray

NARROWEST_PX = 0.25
"""Width below which the stated covariance of a position is too small, by 1.6 times at 0.2 px and 3 at 0.15 px."""

SHARP_PX, SHARP_MISFIT = 0.75, 25.0
"""Stars narrower than the first whose pixels differ from a Gaussian by more than the second in chi-square are flagged
``PIXEL_PHASE``: the error by pixel phase of a core sharper than the Gaussian is about a tenth of the root of the misfit
in standard deviations, half of one here (`tests/calib/measure/centroiding/test_sharp_stars.py`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianCentroider(LikelihoodFit):
    """Maximum likelihood of x, y, flux and widths of a pixel-integrated Gaussian, see
    `calib.measure.centroiding.maximum_likelihood`.

    Attributes
    ----------
    sigma_px : float or None
        Known width of the Gaussian (before the pixel); None: the widths along columns and rows are fitted.
    sigma_start_px : float
        First guess of the widths.
    fit_background, max_shift_px, tolerance, max_iterations
        As in `calib.measure.centroiding.maximum_likelihood.LikelihoodFit`.
    """

    name: ClassVar[str] = "gaussian"
    label: ClassVar[str] = "Gaussian fit"
    needs_epsf: ClassVar[bool] = False

    sigma_px: float | None = option(None, at_least=0.05, at_most=20, unit="px")
    sigma_start_px: float = option(0.8, at_least=0.05, at_most=20, unit="px")
    max_iterations: int = option(50, at_least=1)

    def models(self, stamps: Stamps) -> Callable[[slice], GaussianModel]:
        """The same model for every stamp."""
        return lambda rows: GaussianModel(stamps.window, self.sigma_px)

    def shape_start(self) -> FloatArray:
        """Widths, unless they are known."""
        return np.full(2, np.log(self.sigma_start_px)) if self.sigma_px is None else np.empty(0)

    def shape_columns(self, fit: PixelFit) -> dict[str, Any]:
        """``width_px``, and flags of undetermined widths and of cores sharper than a Gaussian."""
        misfit = np.maximum(fit.chi2 - 1.0, 0.0) * fit.freedom  # chi-square beyond what noise leaves
        sharp = (misfit > SHARP_MISFIT) & (misfit > 10.0 * np.sqrt(fit.freedom))
        if self.sigma_px is not None:
            sharp &= self.sigma_px < SHARP_PX
            return {"flags": np.where(sharp, int(StarFlag.PIXEL_PHASE), 0).astype(np.uint32)}
        widths = slice(LN_SIGMA_X, LN_SIGMA_Y + 1)
        ln_sigma = fit.parameters[:, widths]
        variance = np.diagonal(fit.covariance, axis1=1, axis2=2)[:, widths]
        lost = fit.iterations == 0
        unknown = (variance > 0.5 * WIDTH_PRIOR_LN**2) & (ln_sigma < np.log(WIDTH_PRIOR_PX)) | (
            ln_sigma < np.log(NARROWEST_PX)
        )
        flags = np.where(unknown.any(axis=1) & ~lost, int(StarFlag.WIDTH_UNKNOWN), 0).astype(np.uint32)
        flags[sharp & (np.exp(ln_sigma.min(axis=1)) < SHARP_PX) & ~lost] |= np.uint32(int(StarFlag.PIXEL_PHASE))
        return {"width_px": np.where(lost, np.nan, np.exp(ln_sigma.mean(axis=1))), "flags": flags}
