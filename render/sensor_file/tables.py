"""Tables of a sensor file: instrument, pass band, filters, star catalogue. Light to import."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from optics.errors import StarbenchError
from optics.settings import FileName, StrictModel, WavelengthNm
from render.sensor_file.housing import HousingConfig


def in_focus(lens: Any) -> bool:
    """Whether a lens is in focus by definition: an ideal or a measured lens."""
    if isinstance(lens, Mapping) or hasattr(lens, "focal_length_mm"):
        return True
    if not (isinstance(lens, str) and lens.lower().endswith(".toml")):
        return False
    from optics.validate import read_toml

    try:
        return read_toml(lens).get("kind") == "measured"
    except StarbenchError:
        return False


class IdealLensConfig(StrictModel):
    """Ideal thin lens without aberrations, in place of the name or file of a lens.

    It images by f tan(field), in focus at all wavelengths; its PSF is the Airy pattern of a round stop, blurred by a
    Gaussian. A measured lens is a file with ``kind = "measured"`` (`optics.lens.measured`).
    """

    dimensionless: ClassVar[frozenset[str]] = frozenset({"f_number", "transmission"})

    kind: Literal["ideal"] = Field(
        default="ideal", description="the only kind of this table; a measured lens is a file"
    )
    focal_length_mm: float = Field(gt=0, le=1e5, description="focal length in the air or vacuum around it")
    f_number: float = Field(gt=0.5, le=1000, description="focal length over the diameter of the stop")
    spot_um: float = Field(
        default=0.0, ge=0, le=1e4, description="RMS radius of a Gaussian spot that blurs the diffraction image"
    )
    psf_fwhm_px: float = Field(
        default=0.0, ge=0, le=100, description="full width at half maximum of this Gaussian, in place of spot_um"
    )
    transmission: float = Field(default=1.0, gt=0, le=1, description="transmission at all wavelengths")
    transmission_file: FileName = Field(
        default="", description="in place of transmission: CSV file with columns wavelength_nm and transmission"
    )
    design_wavelength_nm: WavelengthNm = Field(
        default=550.0, description="wavelength of chief rays, focal length and depth of focus"
    )
    max_field_deg: float = Field(
        default=30.0, gt=0, le=80, description="largest half field that the detector may cover"
    )

    @model_validator(mode="after")
    def _one_blur(self) -> Self:
        if self.spot_um and self.psf_fwhm_px:
            raise ValueError("spot_um and psf_fwhm_px: give one of them")
        return self

    @property
    def label(self) -> str:
        """Name of the lens in reports."""
        return f"ideal lens {self.focal_length_mm:g} mm F/{self.f_number:g}"


def _lens_form(value: Any) -> str:
    return "ideal" if isinstance(value, (Mapping, BaseModel)) else "name"


class InstrumentConfig(StrictModel):
    """Lens, detector and how they are operated."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"f_number"})

    lens: Annotated[
        Annotated[FileName, Tag("name")] | Annotated[IdealLensConfig, Tag("ideal")], Discriminator(_lens_form)
    ] = Field(
        default="star_camera_206mm",
        description="built-in lens, or a file: TOML, Zemax .zmx, CODE V .seq; or a table [instrument.lens]",
    )
    detector: FileName = Field(default="acc18_mosaic", description="built-in detector or TOML file")
    width_px: int = Field(
        default=0, ge=0, le=32768, description="columns read out in the middle of the detector; 0: all"
    )
    height_px: int = Field(default=0, ge=0, le=32768, description="rows read out in the middle of the detector; 0: all")
    defocus_mm: Annotated[float, Field(strict=True, ge=-10, le=10)] | Literal["best"] = Field(
        default=0.010, description="detector shift away from the lens; best: smallest RMS spot over the pass band"
    )
    f_number: float | None = Field(
        default=None, gt=0, le=1000, description="stop closed to this F-number; left out: the lens's own"
    )
    exposure_s: float = Field(default=0.1, gt=0, le=1e4, description="exposure time")
    line_time_us: float = Field(
        default=0.0, ge=0, le=1e4, description="rolling shutter: delay from row to row; 0: global shutter"
    )
    gain_dn_per_e: float | None = Field(
        default=None, gt=0, le=1e5, description="system gain; left out: the detector's own"
    )
    chip_temperature_c: float = Field(default=0.0, ge=-100, le=80, description="temperature of the detector")
    lens_temperature_c: float | None = Field(
        default=None,
        ge=-150,
        le=150,
        description="temperature of lens and housing; default: the prescription's temperature, at which it is focused",
    )
    housing: HousingConfig = HousingConfig()
    wavefront_zernike_nm: tuple[Annotated[float, Field(ge=-1e5, le=1e5)], ...] = Field(
        default=(),
        max_length=66,
        description="measured error of the wavefront on the axis: standard Zernike coefficients by Noll's index, "
        "from 1, positive where light is late",
    )
    wavefront_map: FileName = Field(
        default="",
        description="map of the wavefront error [nm], in place of the coefficients: square around the pupil, .npy or "
        "text, rows along +y",
    )
    absorption: bool = Field(
        default=True, description="include absorption in glass; every glass then needs an internal transmittance"
    )
    diffraction: Literal["rays", "waves", "exact_waves"] = Field(
        default="waves",
        description="stars as ray densities or as diffraction images, interpolated (waves) or one by one (exact_waves)",
    )
    coating_nm: float = Field(
        default=550.0, ge=0, le=2000, description="design wavelength of the MgF2 quarter-wave coatings; 0: bare glass"
    )

    @model_validator(mode="before")
    @classmethod
    def _in_focus(cls, values: Any) -> Any:
        """A lens in focus by definition stays there unless a focus is stated."""
        if isinstance(values, Mapping) and "defocus_mm" not in values and in_focus(values.get("lens")):
            return {**values, "defocus_mm": 0.0}
        return values

    @property
    def lens_label(self) -> str:
        """What reports call the lens."""
        return Path(self.lens).stem if isinstance(self.lens, str) else self.lens.label

    @model_validator(mode="after")
    def _one_wavefront(self) -> Self:
        if self.wavefront_zernike_nm and self.wavefront_map:
            raise ValueError("wavefront_zernike_nm and wavefront_map: give one of them")
        return self

    @field_validator("housing", mode="before")
    @classmethod
    def _material(cls, value: Any) -> Any:
        """A material alone is the barrel's."""
        return {"material": value} if isinstance(value, str | float | int) else value


class PassbandConfig(StrictModel):
    """Light that reaches the lens: a trapezoid, or a measured curve."""

    range_nm: tuple[WavelengthNm, WavelengthNm] = Field(
        default=(450.0, 900.0),
        description="half-maximum wavelengths; [0, 0]: the whole range of the lens and detector data",
    )
    edge_nm: float = Field(default=20.0, ge=0, le=400, description="width of each edge, from 0 to 100 %")
    file: FileName = Field(
        default="", description="in place of range_nm and edge_nm: CSV file, columns wavelength_nm and transmission"
    )

    @field_validator("range_nm")
    @classmethod
    def _increasing(cls, values: tuple[float, float]) -> tuple[float, float]:
        if values != (0.0, 0.0) and not 0.0 < values[0] < values[1]:
            raise ValueError("two increasing wavelengths are needed, or [0, 0]")
        return values

    @property
    def words(self) -> str:
        """The band in words, for reports."""
        if self.file:
            return f"the curve of {Path(self.file).name}"
        low, high = self.range_nm
        return f"{low:g} to {high:g} nm" if high else "all wavelengths that lens and detector are known for"


class CatalogueConfig(StrictModel):
    """Star catalogue."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"epoch_year"})

    source: FileName = Field(default="gaia", description="gaia: the built-in sky to G = 10; or a file, see preset")
    preset: Literal["hipparcos", "gaia", "bright_star", "open_bright_star", "plain"] = Field(
        default="plain", description="columns of the file"
    )
    magnitude_system: Literal["preset", "V", "G"] = Field(
        default="preset", description="system of a file's magnitudes; preset: the preset's own"
    )
    faintest_mag: float = Field(
        default=8.0, ge=-2, le=30, description="faintest stars rendered, in the catalogue's system (gaia: G)"
    )
    epoch_year: float = Field(default=2016.0, ge=1900, le=2100, description="Julian year of the exposures")
    observer: Literal["none", "earth"] = Field(
        default="none", description="earth: parallax, deflection by the Sun and aberration as seen from the Earth"
    )
    temperature: Literal["colour", "effective"] = Field(
        default="colour", description="black-body temperature of a star: by colour, or the catalogue's effective value"
    )


class FilterConfig(StrictModel):
    """Interference filters; shifts are measured relative to the filter at ``reference_nm``."""

    centres_nm: tuple[WavelengthNm, ...] = Field(
        default=(500.0, 600.0, 800.0), min_length=2, description="band centres"
    )
    reference_nm: float = Field(default=600.0, description="centre of the reference band; one of centres_nm")
    width_nm: float = Field(default=100.0, gt=0, le=400, description="full width at half maximum")
    edge_nm: float = Field(default=10.0, ge=0, le=100, description="width of each edge, from 0 to 100 %")
    files: tuple[FileName, ...] = Field(
        default=(),
        description="CSV files with columns wavelength_nm and transmission, one per centre; empty: trapezoids",
    )

    @field_validator("centres_nm")
    @classmethod
    def _different(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if len({f"{value:g}" for value in values}) != len(values):
            raise ValueError("a centre is given twice")
        return values

    @field_validator("reference_nm")
    @classmethod
    def _one_of_them(cls, value: float, info: ValidationInfo) -> float:
        centres = info.data.get("centres_nm")  # absent if invalid, which has its own message
        if centres is not None and value not in centres:
            raise ValueError(f"it must be one of centres_nm = {list(centres)}")
        return value

    @field_validator("files")
    @classmethod
    def _one_each(cls, values: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        centres = info.data.get("centres_nm")
        if values and centres is not None and len(values) != len(centres):
            raise ValueError(f"{len(values)} files for {len(centres)} centres_nm = {list(centres)}; give one for each")
        return values
