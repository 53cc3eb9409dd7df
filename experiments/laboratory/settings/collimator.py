"""The table ``[collimator]`` of a configuration: errors of the laboratory's collimator. Light to import."""

from __future__ import annotations

from pydantic import Field, model_validator

from optics.settings import StrictModel


class CollimatorConfig(StrictModel):
    """Errors of the collimator, its air and its mount; the defaults are a perfect paraboloid, focused, at rest."""

    focal_length_mm: float = Field(default=1000.0, ge=10, le=1e5, description="focal length")
    decollimation_um: float = Field(
        default=0.0, ge=-1e4, le=1e4, description="distance of the target behind the focus (away from the collimator)"
    )
    focus_wavelength_nm: tuple[float, ...] = Field(
        default=(), description="wavelengths of focus_um, at least two, increasing; empty: a reflective collimator"
    )
    focus_um: tuple[float, ...] = Field(
        default=(),
        description="focus shift away from the collimator at focus_wavelength_nm; monotone cubic interpolation",
    )
    offset_mm: tuple[float, float] = Field(
        default=(0.0, 0.0), description="offset of the camera's pupil from the axis of the beam, along columns and rows"
    )
    pinhole_um: float = Field(
        default=0.0, ge=0, le=1000, description="diameter of a target's pinhole; 0: a point source"
    )
    air_path_m: float = Field(default=2.0, ge=0, le=100, description="length of the path through air")
    air_gradient_k_per_m: tuple[float, float] = Field(
        default=(0.0, 0.0), description="temperature gradient of the air along columns and rows of the image"
    )
    seeing_arcsec: float = Field(
        default=0.0,
        ge=0,
        le=60,
        description="turbulence: RMS per axis of the angle of arrival, independent for each exposure",
    )
    vibration_hz: tuple[float, ...] = Field(
        default=(), description="frequencies of vibration_arcsec2_per_hz, at least two, increasing; empty: at rest"
    )
    vibration_arcsec2_per_hz: tuple[float, ...] = Field(
        default=(),
        description="one-sided power spectral density of the line of sight per axis; power laws between frequencies",
    )

    @model_validator(mode="after")
    def _tables(self) -> CollimatorConfig:
        for abscissa, ordinate in (("focus_wavelength_nm", "focus_um"), ("vibration_hz", "vibration_arcsec2_per_hz")):
            nodes, values = getattr(self, abscissa), getattr(self, ordinate)
            if len(nodes) != len(values):
                raise ValueError(
                    f"{ordinate} has {len(values)} values for {len(nodes)} of {abscissa}; give one for each"
                )
            if len(nodes) == 1 or any(b <= a for a, b in zip((0.0, *nodes), nodes, strict=False)):
                raise ValueError(f"{abscissa} = {list(nodes)}: at least two increasing values above 0 are needed")
        self._check_range(focus_um=1e5, offset_mm=1000.0, air_gradient_k_per_m=100.0)
        lowest = min(self.vibration_arcsec2_per_hz, default=1.0)
        if not lowest > 0:
            raise ValueError(f"vibration_arcsec2_per_hz: {lowest:g} is not above 0")
        return self

    def _check_range(self, **limits: float) -> None:
        for name, limit in limits.items():
            largest = max(map(abs, getattr(self, name)), default=0.0)
            if not largest <= limit:
                raise ValueError(f"{name}: {largest:g} is outside -{limit:g} ... {limit:g}")


class FilteredCollimatorConfig(CollimatorConfig):
    """A collimator with a filter wheel, whose filters may have wedges."""

    wedge_arcsec: tuple[float, ...] = Field(
        default=(), description="wedge angle of each filter, in the order of filters.centres_nm; empty: none"
    )
    wedge_direction_deg: tuple[float, ...] = Field(
        default=(),
        description="angle of the thin edge and of the image shift, from +columns towards +rows; empty: 0",
    )
    wedge_glass: str = Field(default="N-BK7", description="glass of the filters")
    filter_distance_mm: float | None = Field(
        default=None,
        gt=0,
        le=1e5,
        description="distance from target to filter; default: filters in the collimated beam",
    )

    @model_validator(mode="after")
    def _wedges(self) -> FilteredCollimatorConfig:
        if self.wedge_direction_deg and len(self.wedge_direction_deg) != len(self.wedge_arcsec):
            raise ValueError(
                f"wedge_direction_deg has {len(self.wedge_direction_deg)} values for {len(self.wedge_arcsec)} of "
                "wedge_arcsec; give one for each, or none"
            )
        self._check_range(wedge_arcsec=3600.0, wedge_direction_deg=360.0)
        if self.filter_distance_mm is not None and self.filter_distance_mm > self.focal_length_mm:
            raise ValueError(
                f"filter_distance_mm = {self.filter_distance_mm:g}: at most focal_length_mm = "
                f"{self.focal_length_mm:g}; leave it out for a filter in the collimated beam"
            )
        return self
