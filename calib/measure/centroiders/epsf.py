"""Maximum likelihood of a known effective PSF, shifted and scaled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from calib.measure.centroiding.maximum_likelihood import LikelihoodFit
from calib.measure.epsf.bspline import EpsfModel, epsf_bank
from calib.records import Stamps
from optics.errors import DomainError
from render.records import EffectivePsf


@dataclass(frozen=True, slots=True, kw_only=True)
class EpsfCentroider(LikelihoodFit):
    """Effective-PSF maximum likelihood of x, y and flux (and background), see
    `calib.measure.centroiding.maximum_likelihood`.

    Positions refer to the origin of the `EffectivePsf`; its scale defines the flux.

    Attributes
    ----------
    epsf : EffectivePsf or sequence of EffectivePsf
        The PSF; of several, ``Stamps.psf_index`` is the index of each star's PSF.
    fit_background, max_shift_px, tolerance, max_iterations
        As in `calib.measure.centroiding.maximum_likelihood.LikelihoodFit`.
    """

    name: ClassVar[str] = "epsf"
    label: ClassVar[str] = "ePSF fit"
    needs_epsf: ClassVar[bool] = True

    epsf: EffectivePsf | Sequence[EffectivePsf]

    def models(self, stamps: Stamps) -> Callable[[slice], EpsfModel]:
        """The PSF of every stamp."""
        psfs = (self.epsf,) if isinstance(self.epsf, EffectivePsf) else tuple(self.epsf)
        bank = epsf_bank(psfs, stamps.window)
        if len(stamps) and not (stamps.psf_index.min() >= 0 and stamps.psf_index.max() < len(psfs)):
            raise DomainError(
                f"Stamps.psf_index spans {stamps.psf_index.min()} to {stamps.psf_index.max()}; "
                f"{len(psfs)} PSF(s) are given, indices 0 to {len(psfs) - 1}"
            )
        return lambda rows: EpsfModel(bank, stamps.psf_index[rows])
