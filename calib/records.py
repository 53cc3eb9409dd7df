"""Records of the inverse model: inputs and outputs of detection and centroiding."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.fitting.misfit import ChiSquare, joined
from calib.flags import UNFIT, StarFlag, describe_flags, has_flag
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all

if TYPE_CHECKING:
    from datetime import datetime

    from astropy.table import Table

    from render.records import Frame, WindowStack

X, Y, FLUX = 0, 1, 2
"""Rows and columns of ``StarTable.covariance``, and of every vector that starts with (x, y, flux)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseModel:
    """Temporal noise of a pixel: electrons = (DN - offset) / gain, variance = expectation + read noise^2.

    The expectation holds everything that arrives as electrons: star, sky background and dark current. Rounding to
    whole DN adds ``1 / (12 gain^2)`` (EMVA 1288 Release 4.0, quantisation noise). Fixed patterns (PRNU, DSNU) are not
    temporal noise and are not in it.
    """

    read_noise_e: float  # Standard deviation of the signal-free pixel, not negative
    gain_dn_per_e: float = 1.0  # System gain K (EMVA 1288), positive
    offset_dn: float = 0.0  # DN of a pixel without electrons
    quantised: bool = False  # Whether the numbers were rounded to whole DN

    def __post_init__(self) -> None:
        if not (np.isfinite(self.read_noise_e) and self.read_noise_e >= 0):
            raise DomainError(f"NoiseModel.read_noise_e = {self.read_noise_e} e-; it must be finite and not negative")
        if not (np.isfinite(self.gain_dn_per_e) and self.gain_dn_per_e > 0):
            raise DomainError(f"NoiseModel.gain_dn_per_e = {self.gain_dn_per_e} DN/e-; it must be finite and positive")
        if not np.isfinite(self.offset_dn):
            raise DomainError(f"NoiseModel.offset_dn = {self.offset_dn} DN; it must be finite")

    @classmethod
    def of(cls, readout: Frame | WindowStack) -> NoiseModel:
        """Nominal noise model of a frame or of windows of whole DN."""
        gain, offset = readout.gain_dn_per_e, readout.offset_dn
        return cls(read_noise_e=readout.read_noise_e, gain_dn_per_e=gain, offset_dn=offset, quantised=True)

    @property
    def floor_e2(self) -> float:
        """Variance of a pixel without electrons [e-^2]."""
        rounding = 1.0 / (12.0 * self.gain_dn_per_e**2) if self.quantised else 0.0
        return float(self.read_noise_e**2 + rounding)

    def variance_e2(self, expected_e: FloatArray) -> FloatArray:
        """Variance [e-^2] of pixels that expect ``expected_e`` electrons; at least 1e-3 e-^2, for finite weights."""
        return np.maximum(np.maximum(expected_e, 0.0) + self.floor_e2, 1e-3)

    def to_electrons(self, dn: NDArray[Any]) -> FloatArray:
        """Electrons of ``dn``, any shape."""
        return (np.asarray(dn, dtype=np.float64) - self.offset_dn) / self.gain_dn_per_e


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureTime:
    """When a frame was exposed, and how that was read."""

    utc: datetime  # Middle of the exposure; of its start if the exposure time is unknown
    source: str  # Cards, tags, or the name of the file
    zone_stated: bool  # Whether the source states a zone, or its format fixes it; else read as UTC


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """Conversion of the numbers of a file to DN, and properties of the converter."""

    kind: str  # Format of the file
    stored: str  # Type of the stored numbers, NumPy's name
    step: float = 1.0  # Stored numbers per step of the converter; a DN of the image is a step
    repeated: bool = False  # Whether the upper bits stand again in the lower ones
    full: float | None = None  # Stored number from which a pixel counts as saturated
    channel: str = ""  # Which colours the image was made of
    gain: str = ""  # Card of the gain and what it is counted per, of padded converters
    taken: ExposureTime | None = None  # When the frame was exposed, by the file

    def __str__(self) -> str:
        parts = [f"{self.kind}, {self.stored}{', ' + self.channel if self.channel else ''}"]
        if self.full is not None:
            bits = np.log2((self.full + 1.0) / self.step if self.step == 1 else self.full / self.step + 1.0)
            parts.append(f"{bits:.3g} bit" + (f" in steps of {self.step:g}" if self.step != 1 else ""))
            parts.append(f"saturated from {self.full:g}")
        if self.repeated:
            parts.append("upper bits repeated in the lower ones")
        if self.gain:
            parts.append(self.gain)
        if self.kind == "JPEG":
            parts.append("compression and gamma cannot be undone: noise is correlated, fluxes are not linear")
        return "; ".join(parts)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorImage:
    """An image of any origin, ready for detection.

    Attributes
    ----------
    dn : (h, w)
        Digital numbers; where ``valid`` is false the value is 0 and means nothing.
    valid, saturated : (h, w) bool
        Usable pixels (finite, not defective); pixels at full well or the end of the converter.
    noise : NoiseModel
        Gain, offset and read noise.
    assumed : tuple of str
        Names of the noise-model fields that are not stated and therefore hold a default or an estimate.
    exposure_s : float or None
        Exposure time, if known.
    source : str
        Where the image comes from.
    conversion : Conversion or None
        Of an image that was read from a file: format, steps of the converter, saturation.
    """

    dn: FloatArray
    valid: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    noise: NoiseModel
    assumed: tuple[str, ...] = ()
    exposure_s: float | None = None
    source: str = ""
    conversion: Conversion | None = None

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        dn = freeze(self, "dn", shape=("h", "w"), sizes=sizes)
        freeze_all(self, valid=("h", "w"), saturated=("h", "w"), sizes=sizes, dtype=np.bool_)
        if dn.size == 0:
            raise DomainError(f"SensorImage.dn has shape {dn.shape}; an image needs at least one pixel")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamps:
    """Windows around stars, in electrons, background included; pixels are (column, row) of the full image."""

    electrons: FloatArray  # (n, h, w) (DN - offset) / gain. Where ``valid`` is false the value is 0 and means nothing
    # (n, h, w) Pixels that may be used: inside the image, finite, neither saturated nor defective
    valid: NDArray[np.bool_]
    corner_px: NDArray[np.int64]  # (n, 2) (column, row) of each window's first pixel
    background_e: FloatArray  # (n,) Expected electrons per pixel without the star
    start_px: FloatArray  # (n, 2) (column, row) where the measurement starts, in the full image
    flags: NDArray[np.uint32]  # (n,) `StarFlag` bits found while cutting
    psf_index: NDArray[np.int64]  # (n,) Which of several PSFs belongs to the star; zeros where there is one

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, electrons=("n", "h", "w"), background_e=("n",), start_px=("n", 2), sizes=sizes)
        freeze(self, "valid", shape=("n", "h", "w"), dtype=np.bool_, sizes=sizes)
        freeze_all(self, corner_px=("n", 2), psf_index=("n",), dtype=np.int64, sizes=sizes)
        freeze(self, "flags", shape=("n",), dtype=np.uint32, sizes=sizes)
        if min(sizes["h"], sizes["w"]) < 3:
            shape = self.electrons.shape[1:]
            raise DomainError(f"Stamps.electrons has windows of {shape} px; at least 3 x 3 is needed")

    def __len__(self) -> int:
        return len(self.electrons)

    @property
    def window(self) -> tuple[int, int]:
        """Rows and columns of a window."""
        return self.electrons.shape[1], self.electrons.shape[2]

    def select(self, rows: Any) -> Stamps:
        """The stamps picked by an index array, a mask or a slice."""
        return Stamps(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


_COLUMNS = (
    *("x_px", "y_px", "flux_e", "background_e", "sigma_x_px", "sigma_y_px", "sigma_flux_e"),
    *("correlation_xy", "correlation_x_flux", "correlation_y_flux"),
    *("chi2", "iterations", "flags", "width_px", "phase_error_px"),
)
_NOT_MEASURED = {"chi2": np.nan, "iterations": 0, "freedom": 0, "width_px": np.nan, "phase_error_px": np.nan}
"""Values of columns that are left out."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class StarTable:
    """Measured stars; a star that could not be measured keeps its row, with NaN and a flag.

    Attributes
    ----------
    x_px, y_px : (n,)
        Column and row, integer = pixel centre.
    flux_e : (n,)
        Electrons of the star.
    background_e : (n,)
        Electrons per pixel of the sky at the star.
    covariance : (n, 3, 3)
        Of (x, y, flux) [px, px, e-]: temporal noise by the noise model. Errors that depend on the position within the
        pixel are not included, see ``phase_error_px``.
    chi2 : (n,)
        Weighted squared residual per degree of freedom, NaN where no model was fitted.
    iterations : (n,) int64
        Steps the estimator took.
    freedom : (n,) int64
        Degrees of freedom of ``chi2``; 0 where no model was fitted.
    flags : (n,) uint32
        `StarFlag` bits.
    width_px : (n,)
        Standard deviation of the star as a Gaussian, before pixels integrate it; NaN where it was not measured.
    phase_error_px : (n,)
        RMS error per axis by the star's position in its pixel (S-curve, `calib.measure.centroid_error.s_curve`), for a
        Gaussian star of this width; NaN for centroiders that fit a PSF, whose error is that of their PSF.
    """

    x_px: FloatArray
    y_px: FloatArray
    flux_e: FloatArray
    background_e: FloatArray
    covariance: FloatArray
    flags: NDArray[np.uint32]
    chi2: FloatArray = field(default_factory=lambda: np.empty(0))
    iterations: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    freedom: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    width_px: FloatArray = field(default_factory=lambda: np.empty(0))
    phase_error_px: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name, value in _NOT_MEASURED.items():
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.full(len(self.x_px), value))
        names = ("x_px", "y_px", "flux_e", "background_e", "chi2", "width_px", "phase_error_px")
        shapes: dict[str, Any] = {"covariance": ("n", 3, 3), **dict.fromkeys(names, ("n",))}
        freeze_all(self, finite=False, sizes=sizes, **shapes)
        freeze_all(self, iterations=("n",), freedom=("n",), sizes=sizes, dtype=np.int64)
        freeze(self, "flags", shape=("n",), dtype=np.uint32, sizes=sizes)

    def __repr__(self) -> str:
        if not len(self):
            return "<StarTable: no stars>"
        flagged = [(describe_flags(int(bit)), int(has_flag(self.flags, bit).sum())) for bit in StarFlag]
        sigma = f"sigma {np.nanmedian(self.position_sigma_px):.3g} px" if self.fit.any() else ""
        flags = ", ".join(f"{count} {name}" for name, count in flagged if count)
        tested = str(self.misfit) if self.misfit.tested else ""
        return f"<StarTable: {joined(f'{len(self)} stars', sigma, flags, tested, self.misfit.note)}>"

    def __len__(self) -> int:
        return len(self.x_px)

    @property
    def misfit(self) -> ChiSquare:
        """Whether pixels scatter about the fitted stars as the noise model states, over all stars that are `fit`."""
        rows = self.fit & (self.freedom > 0) & np.isfinite(self.chi2)
        freedom = self.freedom[rows]
        return ChiSquare(value=float(self.chi2[rows] @ freedom), degrees_of_freedom=int(freedom.sum()))

    @classmethod
    def empty(cls) -> StarTable:
        """A table without rows, with all columns."""
        columns: dict[str, Any] = dict.fromkeys(("x_px", "y_px", "flux_e", "background_e", "flags"), np.empty(0))
        return cls(covariance=np.empty((0, 3, 3)), **columns)

    @property
    def pixel_px(self) -> FloatArray:
        """Positions (n, 2), column and row; NaN where there is none."""
        return np.column_stack([self.x_px, self.y_px])

    @property
    def fit(self) -> NDArray[np.bool_]:
        """Whether each star (n,) may be used for an attitude: measured, and without a flag of `UNFIT`."""
        measured = np.isfinite(self.covariance).all(axis=(1, 2)) & np.isfinite(self.x_px) & np.isfinite(self.y_px)
        return measured & ~has_flag(self.flags, UNFIT)

    @property
    def sharp(self) -> NDArray[np.bool_]:
        """Detections (n,) that are sharper than a star or sit on a pixel that is known to be bad."""
        return has_flag(self.flags, StarFlag.SPIKE | StarFlag.DEFECT)

    @property
    def position_sigma_px(self) -> FloatArray:
        """Standard deviation per axis (n,) of a position: noise, mean of both axes, and the error by pixel phase."""
        noise = 0.5 * (self.covariance[:, X, X] + self.covariance[:, Y, Y])
        return np.asarray(np.sqrt(noise + np.nan_to_num(self.phase_error_px) ** 2))

    @property
    def sigma_x_px(self) -> FloatArray:
        """Standard deviation of x [px]."""
        return np.sqrt(self.covariance[:, X, X])

    @property
    def sigma_y_px(self) -> FloatArray:
        """Standard deviation of y [px]."""
        return np.sqrt(self.covariance[:, Y, Y])

    @property
    def sigma_flux_e(self) -> FloatArray:
        """Standard deviation of the flux [e-]."""
        return np.sqrt(self.covariance[:, FLUX, FLUX])

    def _correlation(self, i: int, j: int) -> FloatArray:
        return np.asarray(self.covariance[:, i, j] / np.sqrt(self.covariance[:, i, i] * self.covariance[:, j, j]))

    @property
    def correlation_xy(self) -> FloatArray:
        """Correlation of x and y."""
        return self._correlation(X, Y)

    @property
    def correlation_x_flux(self) -> FloatArray:
        """Correlation of x and flux."""
        return self._correlation(X, FLUX)

    @property
    def correlation_y_flux(self) -> FloatArray:
        """Correlation of y and flux."""
        return self._correlation(Y, FLUX)

    def select(self, rows: Any) -> StarTable:
        """The stars picked by an index array, a mask or a slice."""
        return StarTable(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})

    def to_table(self) -> Table:
        """The stars as an `astropy.table.Table` of plain columns with units, e.g. to write ECSV."""
        from astropy.table import Table

        units = {name: "pix" if name.endswith("_px") else "electron" for name in _COLUMNS if name[-2:] in ("px", "_e")}
        return Table({name: np.array(getattr(self, name)) for name in _COLUMNS}, units=units)
