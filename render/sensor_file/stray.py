"""Settings of stray light in a sensor file: baffle, scatter of surfaces, dust. Light to import."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from optics.settings import FileName, StrictModel


class BaffleConfig(StrictModel):
    """Baffle in front of the lens; the default is a vaned tube that shades the lens from 35 deg on."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"vanes", "diffuse", "specular", "roughness"})

    fitted: bool = Field(default=True, description="false: lens without baffle")
    mesh: FileName = Field(
        default="",
        description="closed mesh [mm] in place of the tube (.ply, .obj, .glb), +z to the sky, z = 0: first surface",
    )
    shade_deg: float = Field(
        default=35.0,
        gt=0,
        lt=90,
        description="smallest Sun angle at which the lens is fully shaded; determines the length",
    )
    length_mm: float | None = Field(default=None, gt=0, le=1e4, description="length, in place of shade_deg")
    vane_depth_mm: float = Field(default=8.0, gt=0, le=1e3, description="how far the front vane reaches into the tube")
    vanes: int | None = Field(
        default=None,
        ge=0,
        le=60,
        description="number of vanes, which then sets their depth; 0: plain tube; default: from vane_depth_mm",
    )
    clearance_mm: float = Field(
        default=0.5, ge=-100, le=100, description="gap between the beams of the field and the vanes"
    )
    edge_radius_um: float = Field(default=20.0, ge=0, le=1000, description="radius of the edges of the vanes")
    coating: Literal["z306", "black_anodised", "magic_black", "own"] = Field(
        default="z306", description="black coating; own: the three numbers below"
    )
    diffuse: float = Field(default=0.04, ge=0, le=1, description="own: Lambertian reflectance")
    specular: float = Field(default=0.0, ge=0, le=0.04, description="own: specular reflectance at normal incidence")
    roughness: float = Field(default=0.3, ge=0.01, le=1, description="own: GGX alpha of the specular lobe")

    @model_validator(mode="after")
    def _reflects(self) -> Self:
        if self.diffuse + 25.0 * self.specular > 1.0:
            raise ValueError(
                f"diffuse = {self.diffuse:g} with specular = {self.specular:g} reflects more than all grazing light; "
                "specular is at most 0.04 (1 - diffuse)"
            )
        return self


class ScatterConfig(StrictModel):
    """Scatter of the lens surfaces (the same for all) and reflectance of the detector; defaults are typical values."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"shoulder", "slope", "detector_reflectance"})

    roughness_nm: float = Field(default=1.5, ge=0, le=50, description="RMS roughness in the band that scatters")
    shoulder: float = Field(
        default=0.01, gt=0, le=1, description="Harvey-Shack l: sine of the angle where the BSDF starts to fall"
    )
    slope: float = Field(default=-1.5, ge=-6, lt=0, description="Harvey-Shack s: exponent of the fall")
    detector_reflectance: float = Field(default=0.2, ge=0, le=1, description="specular reflectance of the detector")
    halos: bool = Field(default=False, description="halos of stars, from polish and dust, in frames of dataset")


class ContaminationConfig(StrictModel):
    """Dust by IEST-STD-CC1246."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"level", "inner_level"})

    level: float = Field(default=300.0, ge=1, le=5000, description="cleanliness level of the first surface")
    inner_level: float = Field(
        default=100.0, ge=1, le=5000, description="cleanliness level of all other surfaces next to air"
    )
    forward_fraction: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="fraction of the light intercepted by dust that is scattered forwards, uniformly (assumed)",
    )
