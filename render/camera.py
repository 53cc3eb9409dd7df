"""The camera: lens, detector geometry, focus, attitude and spectral response, as one record without Mitsuba."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.frames import field_angles_deg
from optics.glass.coating import Coating
from optics.lens.system import LensSystem
from optics.light.bsdf import ABg, HarveyShack, Particles, SummedScatter
from optics.light.transmission import lens_transmission
from optics.rays.chief_ray import chief_ray_points
from optics.rays.entrance_pupil import EntrancePupil, entrance_pupil
from optics.rays.paraxial import axial_paraxial
from optics.records import freeze
from optics.response import Response
from optics.units import UM_MM
from render.detector.spec import Detector

RESPONSE_STEP_NM = 5.0

Diffraction = Literal["rays", "waves", "exact_waves"]
"""How the images of stars are made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathLosses:
    """Losses of off-axis rays in surfaces and glasses, each along its own path; a response covers the axis only."""

    coating: Coating | None = None  # On air-glass surfaces for which the lens states none; bare glass if left out
    absorption: bool = True  # Whether glass absorbs

    def along_axis(self, lens: LensSystem, wavelength_nm: FloatArray) -> FloatArray:
        """Transmission along the axis."""
        return lens_transmission(lens, wavelength_nm, coating=self.coating, absorption=self.absorption)


FAR_NOISE = 0.25
"""Part of the read noise at which the image of a bright star ends."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FarLight:
    """Extent of images of bright stars (`render.tracing.waves.diffraction_spikes`); fainter ones end at stamps."""

    ends_e: float  # Electrons of a pixel at which an image ends
    saturated_e: float  # Of a star's brightest pixel, the full well, above which at most 1e-3 of its light lie beyond

    def __post_init__(self) -> None:
        for name in ("ends_e", "saturated_e"):
            if not (getattr(self, name) > 0.0 and math.isfinite(getattr(self, name))):
                raise DomainError(f"FarLight.{name} = {getattr(self, name):g} e-; it must be positive")

    @property
    def least_e(self) -> float:
        """Electrons below which no star reaches beyond its stamp, whose outermost pixels hold some 2e-5 of them."""
        return min(self.saturated_e, 2e4 * self.ends_e)


ScatterLaw = HarveyShack | ABg | Particles | SummedScatter
"""Angular law of light that is scattered."""
MOST_SCATTERED = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A lens in front of a pixelated detector.

    Attributes
    ----------
    lens : LensSystem
        The lens; its image plane is the nominal focus.
    width_px, height_px : int
        Columns and rows.
    pixel_pitch_mm : float
        Pixel pitch [mm].
    defocus_mm : float
        Detector shift along the light, positive away from the lens.
    centre_px : (2,)
        Where the axis of the lens meets the detector (column, row); default the centre of the image.
    charge_diffusion_px : float
        Standard deviation of the Gaussian charge-diffusion kernel [px], as far as the lens's PSF does not hold it.
    rotation_cam_from_world : (3, 3)
        ``v_cam = rotation_cam_from_world @ v_world``, float64.
    response : Response or None
        Electrons per photon against wavelength: quantum efficiency times lens transmission along the axis; None is 1.
    losses : PathLosses or None
        Loss of every ray in surfaces and glasses relative to the axial loss, which ``response`` includes; None: the
        axial loss holds for all rays.
    far : FarLight or None
        Extent of diffraction images of bright stars; None: all end at their stamps.
    scatter : HarveyShack, ABg, Particles, SummedScatter or None
        Scatter law of the whole lens, over differences of sines from the star; the light of the halos is taken from the
        stars' cores. None: no scatter.
    blind_columns_px : tuple of (int, int)
        First and last columns of insensitive strips, such as gaps between chips; light there is lost as off the edge.
    diffraction : {"rays", "waves", "exact_waves"}
        How stars are rendered: as ray densities, or as diffraction images of the traced wavefront. With ``waves``
        images of many stars are interpolated on a grid over the field if its measured error is small enough.
    """

    lens: LensSystem
    width_px: int
    height_px: int
    pixel_pitch_mm: float
    defocus_mm: float = 0.0
    centre_px: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    charge_diffusion_px: float = 0.0
    rotation_cam_from_world: FloatArray = field(default_factory=lambda: np.eye(3))
    response: Response | None = None
    losses: PathLosses | None = None
    far: FarLight | None = None
    scatter: ScatterLaw | None = None
    blind_columns_px: tuple[tuple[int, int], ...] = ()
    diffraction: Diffraction = "waves"

    def __post_init__(self) -> None:
        if self.diffraction not in get_args(Diffraction):
            raise unknown_name("diffraction", self.diffraction, get_args(Diffraction))
        for name in ("width_px", "height_px"):
            if getattr(self, name) < 1:
                raise DomainError(f"Camera.{name} = {getattr(self, name)} px; it must be at least 1")
        if not (self.pixel_pitch_mm > 0 and math.isfinite(self.pixel_pitch_mm)):
            raise DomainError(f"Camera.pixel_pitch_mm = {self.pixel_pitch_mm} mm; it must be positive")
        if not (self.charge_diffusion_px >= 0 and math.isfinite(self.charge_diffusion_px)):
            raise DomainError(f"Camera.charge_diffusion_px = {self.charge_diffusion_px} px; it must not be negative")
        if not math.isfinite(self.defocus_mm):
            raise DomainError(f"Camera.defocus_mm = {self.defocus_mm} mm; a finite number is needed")
        if self.defocus_mm and self.lens.measured is not None:
            raise DomainError(
                f"defocus_mm = {self.defocus_mm:g} mm: lens {self.lens.name!r} was measured in focus; defocus_mm "
                "must be 0"
            )
        if np.isnan(np.asarray(self.centre_px, float)).all():
            object.__setattr__(self, "centre_px", np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2]))
        freeze(self, "centre_px", shape=(2,))
        rotation = freeze(self, "rotation_cam_from_world", shape=(3, 3))
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9) or np.linalg.det(rotation) < 0:
            raise DomainError(
                "Camera.rotation_cam_from_world is not a proper rotation (a mirrored sky has determinant -1)"
            )

        if self.scatter is not None and not self.scatter.tis < MOST_SCATTERED:
            raise DomainError(
                f"Camera.scatter scatters {self.scatter.tis:.3g} of the light; at most {MOST_SCATTERED:g} is allowed"
            )
        for first, last in self.blind_columns_px:
            if not 0 <= first <= last < self.width_px:
                raise DomainError(
                    f"Camera.blind_columns_px: columns {first} to {last} of an image of {self.width_px} columns; first "
                    "and last column inside the image are needed"
                )

    @property
    def sensitive_columns(self) -> NDArray[np.bool_] | None:
        """Mask of the columns (w,) that collect light; None for all."""
        if not self.blind_columns_px:
            return None
        columns = np.ones(self.width_px, np.bool_)
        for first, last in self.blind_columns_px:
            columns[first : last + 1] = False
        return columns

    @property
    def blur_px(self) -> float:
        """Standard deviation [px] of the Gaussian that blurs images: charge diffusion and blur of the lens together."""
        return math.hypot(self.charge_diffusion_px, self.lens_blur_px)

    @property
    def lens_blur_px(self) -> float:
        """Standard deviation [px] of the lens's blur."""
        return math.hypot(self.lens.blur_um * UM_MM / self.pixel_pitch_mm, self.lens.blur_px)

    @property
    def least_blur_px(self) -> float:
        """Blur [px] of the narrowest part of the images of a measured lens; `blur_px` of others."""
        if self.lens.measured is None:
            return self.blur_px
        narrowest_mm2 = self.lens.measured.psf.narrowest_mm2
        return math.hypot(self.blur_px, math.sqrt(narrowest_mm2) / self.pixel_pitch_mm)

    @property
    def focused_lens(self) -> LensSystem:
        """The lens with its image plane where the detector is."""
        axis = self.lens.image_rotation[:, 2]
        return replace(self.lens, image_position_mm=self.lens.image_position_mm + self.defocus_mm * axis)

    @property
    def field_reach_rad(self) -> float:
        """Angle from the axis of the lens to the farthest corner of the detector, or the lens's own field if larger."""
        corners = np.array([[-0.5, -0.5], [self.width_px - 0.5, self.height_px - 0.5]]) - self.centre_px
        radius_mm = math.hypot(*np.abs(corners).max(0)) * self.pixel_pitch_mm
        focal_mm = abs(axial_paraxial(self.lens, self.lens.design_wavelength_nm).efl_mm)
        return max(math.radians(self.lens.max_field_deg), math.atan2(radius_mm, focal_mm))

    def to_pixel(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image-plane coordinates [mm, lens axes] to (column, row) [px]."""
        return self.centre_px[0] + x_mm / self.pixel_pitch_mm, self.centre_px[1] - y_mm / self.pixel_pitch_mm

    def chief_px(self, x: FloatArray, y: FloatArray, wavelength_nm: float | None = None) -> FloatArray:
        """Pixels (n, 2) of chief rays (design wavelength) of stars at X/Z = x, Y/Z = y in cam; rims stop none."""
        fx, fy = field_angles_deg(np.stack([x, y, np.ones_like(x)], axis=-1))
        landing_mm = chief_ray_points(self.focused_lens, fx, fy, wavelength_nm, blocked="follow")
        return np.stack(self.to_pixel(*landing_mm), axis=-1)

    def response_at(self, wavelength_nm: FloatArray) -> FloatArray:
        """Electrons per photon at each wavelength."""
        wavelength = np.asarray(wavelength_nm, float)
        return np.ones_like(wavelength) if self.response is None else self.response.interpolate(wavelength)

    def nominal_direction(
        self, x_px: FloatArray | float, y_px: FloatArray | float, focal_length_mm: float
    ) -> FloatArray:
        """Unit vectors in the camera frame that an ideal lens would image at (column, row); shape (..., 3)."""
        x = (np.asarray(x_px, float) - self.centre_px[0]) * self.pixel_pitch_mm / focal_length_mm
        y = (np.asarray(y_px, float) - self.centre_px[1]) * self.pixel_pitch_mm / focal_length_mm
        v = np.stack([x, y, np.ones_like(x)], axis=-1)
        return v / np.linalg.norm(v, axis=-1, keepdims=True)


def launch_disk(camera: Camera) -> EntrancePupil:
    """Launch disk of light for the detector, for the field of the detector or, if larger, of the lens."""
    return entrance_pupil(camera.focused_lens, max_field_deg=math.degrees(camera.field_reach_rad))


def build_camera(
    lens: LensSystem,
    detector: Detector,
    *,
    defocus_mm: float = 0.0,
    coating: Coating | None = None,
    absorption: bool = True,
    rotation_cam_from_world: FloatArray | None = None,
    diffraction: Diffraction = "waves",
) -> Camera:
    """Camera of a lens and a detector, with their geometry, diffusion and response.

    Parameters
    ----------
    lens, detector : LensSystem, Detector
        The parts.
    defocus_mm : float
        Detector shift away from the lens.
    coating : Coating, optional
        On every air-glass surface; bare glass if left out.
    absorption : bool
        Whether to count absorption in the glass; needs the internal transmittance of every glass.
    rotation_cam_from_world : (3, 3), optional
        Attitude; identity if left out.
    diffraction : {"rays", "waves", "exact_waves"}
        How stars are rendered.

    Returns
    -------
    Camera
        What `StarRenderer` renders with.

    Raises
    ------
    DomainError
        If quantum efficiency and lens have no wavelength in common.
    """
    efficiency = detector.quantum_efficiency
    low = max(efficiency.range_nm[0], lens.wavelength_range_nm[0])
    high = min(efficiency.range_nm[1], lens.wavelength_range_nm[1])
    if low >= high:
        raise DomainError(
            f"lens {lens.name!r} works at {lens.wavelength_range_nm[0]:g} ... {lens.wavelength_range_nm[1]:g} nm, "
            f"detector {detector.name!r} at {efficiency.range_nm[0]:g} ... {efficiency.range_nm[1]:g} nm; "
            "their ranges do not overlap"
        )
    wavelength = np.linspace(low, high, max(2, int((high - low) / RESPONSE_STEP_NM) + 1))
    response = Response(
        wavelength_nm=wavelength,
        value=efficiency.interpolate(wavelength)
        * lens_transmission(lens, wavelength, coating=coating, absorption=absorption),
        name=f"{lens.name} on {detector.name}",
        source=f"{lens.source}; {efficiency.source}",
    )
    diffused = lens.measured is not None and lens.measured.includes_charge_diffusion
    traceable = lens.measured is None and lens.throughput is None
    return Camera(
        lens=lens,
        width_px=detector.width_px,
        height_px=detector.height_px,
        pixel_pitch_mm=detector.pixel_pitch_mm,
        defocus_mm=defocus_mm,
        charge_diffusion_px=0.0 if diffused else detector.diffusion_sigma_px,
        rotation_cam_from_world=np.eye(3) if rotation_cam_from_world is None else rotation_cam_from_world,
        response=response,
        losses=PathLosses(coating=coating, absorption=absorption) if traceable else None,
        far=FarLight(ends_e=FAR_NOISE * max(detector.read_noise_e, 1.0), saturated_e=detector.full_well_e),
        blind_columns_px=detector.gap_columns_px,
        diffraction=diffraction,
    )
