"""Records that pass between sky, renderer, detector and calibration; plain NumPy, importable without Mitsuba."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.light.collimation import Collimation
from optics.records import freeze, freeze_all

LONGEST_EXPOSURE_S = 1e7
"""Four months; far beyond it, numbers of electrons leave what the arithmetic of a detector can hold."""


def checked_exposure(exposure_s: float) -> float:
    """An exposure time [s] that can be rendered and read out."""
    if not 0.0 < exposure_s <= LONGEST_EXPOSURE_S:
        raise DomainError(
            f"exposure_s = {exposure_s:g} s; it must be positive and finite, at most {LONGEST_EXPOSURE_S:g} s"
        )
    return float(exposure_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class StarField:
    """Point sources at infinity with their light at the wavelength nodes of the filter bands.

    Attributes
    ----------
    direction : (n, 3)
        Unit vectors *towards* the stars, in the frame the camera's attitude refers to.
    wavelength_nm : (b, k)
        Wavelength nodes of each band (`optics.light.band.band_nodes`).
    photon_rate : (n, b, k)
        Photons per second and mm^2 of area normal to the beam that each node stands for: spectral photon irradiance
        times filter transmission times node weight.
    band : tuple of str
        Names of the b bands.
    collimation : Collimation, optional
        Of sources in a laboratory: error of the collimator that they stand behind, in cam.

    Raises
    ------
    DomainError
        On wrong shapes, NaN, negative rates or vectors that are not of unit length (1e-9).
    """

    direction: FloatArray
    wavelength_nm: FloatArray
    photon_rate: FloatArray
    band: tuple[str, ...]
    collimation: Collimation | None = None

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"b": len(self.band)}
        direction = freeze(self, "direction", shape=("n", 3), sizes=sizes)
        wavelength = freeze(self, "wavelength_nm", shape=("b", "k"), sizes=sizes)
        rate = freeze(self, "photon_rate", shape=("n", "b", "k"), sizes=sizes)
        if len(direction):
            length = np.linalg.norm(direction, axis=1)
            worst = int(np.argmax(np.abs(length - 1.0)))
            if abs(length[worst] - 1.0) > 1e-9:
                raise DomainError(
                    f"StarField.direction[{worst}] has length {length[worst]:.12g}; unit vectors are needed"
                )
        if np.any(rate < 0):
            worst = int(np.argwhere(rate < 0)[0][0])
            raise DomainError(
                f"StarField.photon_rate of star {worst} is negative ({rate[worst].min():.6g} photons/s/mm^2)"
            )
        if wavelength.size and wavelength.min() <= 0:
            raise DomainError(f"StarField.wavelength_nm contains {wavelength.min():.6g} nm; it must be positive")

        if self.collimation is not None and len(self.collimation.wavelength_nm) != len(self.band):
            raise DomainError(
                f"StarField.collimation is of {len(self.collimation.wavelength_nm)} bands, the field of "
                f"{len(self.band)}"
            )

    def __len__(self) -> int:
        return len(self.direction)

    def select(self, rows: slice | IntArray | NDArray[np.bool_]) -> StarField:
        """Some of the stars."""
        return replace(self, direction=self.direction[rows], photon_rate=self.photon_rate[rows])


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """True positions and light balance of every star and band; pixels are (column, row), integer = pixel centre.

    Attributes
    ----------
    chief_x_px, chief_y_px : (n, b)
        Ray through the centre of the aperture stop, at the mean of the band's wavelength nodes; NaN where the rim of an
        aperture stops it or no ray passes there. `missing` tells why a position is NaN.
    bundle_x_px, bundle_y_px : (n, b)
        Photon-weighted mean of all traced rays that reach the image plane.
    photon_x_px, photon_y_px : (n, b)
        Centroid of all light on the detector plane, after charge diffusion, without truncation at the detector's edge,
        integrated over cells much narrower than a pixel. A moment over whole pixels has a sampling bias (up to some
        1e-2 px for sharp spots), an error of the estimator and not of the light.
    electrons_in : (n, b)
        Electrons that would be collected if all light that the stop alone lets in reached the detector.
    electrons_image, electrons_vignetted, electrons_off_edge, electrons_hidden : (n, b)
        Balance of the light; the sum is ``electrons_in``. ``electrons_hidden`` is light blocked by bodies between sky
        and lens that would have reached the image plane.
    variance_x_px2, variance_y_px2 : (n, b)
        Second central moments of the ray bundle (no diffusion, no pixel).
    electrons_beyond : (n, b), optional
        Light of diffraction images beyond their stamps, which is not rendered; part of the balance. 0 for rays, and if
        left out.
    electrons_absorbed : (n, b), optional
        Loss of off-axis rays in surfaces and glasses in addition to the axial loss (`Camera.losses`), part of the
        balance; negative where the loss is smaller. 0 if left out.
    electrons_scattered : (n, b), optional
        Light that the lens scatters out of the star's image (`Camera.scatter`), part of the balance; the rendered halo
        is not part of ``electrons_image``. 0 if left out.
    noise_area_px2 : (n, b), optional
        Noise-equivalent area of the star's rendered image, cut by no edge of the detector: square of the sum of its
        pixels over the sum of their squares. NaN without light, and if left out.

    With diffraction ``photon_*_px`` is the centroid over an infinite window, light beyond the stamp included: by
    Parseval's theorem the mean of the rays at every wavelength. The centroid in a window of a few pixels differs.
    """

    chief_x_px: FloatArray
    chief_y_px: FloatArray
    bundle_x_px: FloatArray
    bundle_y_px: FloatArray
    photon_x_px: FloatArray
    photon_y_px: FloatArray
    electrons_in: FloatArray
    electrons_image: FloatArray
    electrons_vignetted: FloatArray
    electrons_off_edge: FloatArray
    electrons_hidden: FloatArray
    variance_x_px2: FloatArray
    variance_y_px2: FloatArray
    electrons_beyond: FloatArray | None = None
    noise_area_px2: FloatArray | None = None
    electrons_absorbed: FloatArray | None = None
    electrons_scattered: FloatArray | None = None

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name, missing in (
            ("electrons_beyond", 0.0),
            ("noise_area_px2", np.nan),
            ("electrons_absorbed", 0.0),
            ("electrons_scattered", 0.0),
        ):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(np.shape(self.electrons_in), missing))
        for name in self.__dataclass_fields__:  # `missing` gives the reason of a NaN
            freeze(self, name, shape=("n", "b"), sizes=sizes, finite=name.startswith("electrons"))

    def select(self, rows: slice | IntArray) -> Truth:
        """Some of the stars."""
        return Truth(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})

    @property
    def missing(self) -> NDArray[np.str_]:
        """Reasons of NaN positions, (n, b); empty without NaN."""
        dark = np.where(
            self.electrons_hidden > self.electrons_vignetted,
            "a body in front hides the star",
            "apertures of the lens stop all light of the star",
        )
        chief = np.where(np.isnan(self.chief_x_px), "the chief ray is stopped by a rim or misses the stop's centre", "")
        return np.where(np.isnan(self.bundle_x_px), dark, chief)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedImage:
    """Noiseless image: expected photo-electrons per pixel and band.

    Attributes
    ----------
    electrons : (h, w, b) float32
        Expectation, charge diffusion included if ``diffused``.
    band : tuple of str
        Names of the bands.
    exposure_s : float
        Exposure time the expectation was computed for.
    diffused : bool
        Whether the charge-diffusion kernel has been applied.
    truth : Truth or None
        Per star and band.
    """

    electrons: NDArray[np.float32]
    band: tuple[str, ...]
    exposure_s: float
    diffused: bool
    truth: Truth | None = None

    def __post_init__(self) -> None:
        electrons = freeze(
            self, "electrons", shape=("h", "w", "b"), dtype=np.float32, sizes={"b": len(self.band)}, finite=True
        )
        if electrons.size and electrons.min() < 0:
            raise DomainError(
                f"ExpectedImage.electrons contains {electrons.min():.6g} e-; expectations are not negative"
            )
        checked_exposure(self.exposure_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One readout of the detector.

    Attributes
    ----------
    dn : (h, w) uint16
        Digital numbers.
    saturated, defect : (h, w) bool
        Pixels that reached full well or the end of the converter; pixels known to be defective.
    gain_dn_per_e, offset_dn, read_noise_e : float
        System gain K, nominal offset and median read noise, as a user of the camera would know them.
    exposure_s : float
        Exposure time.
    band : str
        Filter band.
    index : int
        Frame number (the key of its random streams).
    """

    dn: NDArray[np.uint16]
    saturated: NDArray[np.bool_]
    defect: NDArray[np.bool_]
    gain_dn_per_e: float
    offset_dn: float
    read_noise_e: float
    exposure_s: float
    band: str
    index: int

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "dn", shape=("h", "w"), dtype=np.uint16, sizes=sizes)
        freeze_all(self, saturated=("h", "w"), defect=("h", "w"), dtype=np.bool_, sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowStack:
    """Readout of n windows in m frames, the same windows in each frame."""

    dn: NDArray[np.uint16]  # (m, n, h, w) Digital numbers
    saturated: NDArray[np.bool_]  # (m, n, h, w) Full well or end of the converter
    defect: NDArray[np.bool_]  # (n, h, w) Pixels known to be defective
    corner_px: NDArray[np.int64]  # (n, 2) (column, row) of each window's first pixel
    # gain_dn_per_e, offset_dn, read_noise_e, exposure_s, band: As in `Frame`
    gain_dn_per_e: float
    offset_dn: float
    read_noise_e: float
    exposure_s: float
    band: str
    first_index: int  # Number of the first frame

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "dn", shape=("m", "n", "h", "w"), dtype=np.uint16, sizes=sizes)
        freeze_all(self, saturated=("m", "n", "h", "w"), defect=("n", "h", "w"), dtype=np.bool_, sizes=sizes)
        freeze(self, "corner_px", shape=("n", 2), dtype=np.int64, sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EffectivePsf:
    """Pixel-integrated point-spread function on a grid finer than the pixel (Anderson & King 2000, PASP 112, 1360).

    Values (m, m), m odd: fraction of the star's light that a pixel collects whose centre lies at offset
    ``(column - (m-1)/2) / oversampling``, likewise for rows, from the star's position.
    """

    values: FloatArray
    oversampling: int  # Samples per pixel

    def __post_init__(self) -> None:
        values = freeze(self, "values", shape=("m", "m"), sizes={})
        if values.shape[0] % 2 == 0 or values.shape[0] < 3:
            raise DomainError(f"EffectivePsf.values has size {values.shape[0]}; an odd size of at least 3 is needed")
        if self.oversampling < 1:
            raise DomainError(f"EffectivePsf.oversampling = {self.oversampling}; it must be at least 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfGrid:
    """PSFs of one star colour over a detector, each centred on the mean of its rays."""

    psfs: tuple[EffectivePsf, ...]  # Row by row
    place_px: FloatArray  # (n, 2) Column and row of each

    def nearest(self, x_px: FloatArray, y_px: FloatArray) -> NDArray[np.int64]:
        """Number of the PSF nearest to places (n,)."""
        at = np.stack([x_px, y_px], axis=-1)
        return np.asarray(((at[:, None] - self.place_px) ** 2).sum(-1).argmin(1))


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelMap:
    """Noise-free map of star directions to pixels, the input of camera model fits."""

    direction: FloatArray  # (n, 3) Unit vectors in cam
    pixel_px: FloatArray  # (n, 2) Column and row
    # width_px, height_px: Size of the detector
    width_px: int
    height_px: int
    # pixel_pitch_mm, focal_length_mm: Nominal values, where a fit may start
    pixel_pitch_mm: float
    focal_length_mm: float

    def __post_init__(self) -> None:
        freeze_all(self, direction=("n", 3), pixel_px=("n", 2))
