"""A star sensor: a camera, the detector that reads it out, and how they are operated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import field_angles_deg, light_direction
from optics.glass.coating import QuarterWave
from optics.lens.system import LensSystem
from optics.lens_file import load_lens
from optics.light.band import Band, TopHat, band_nodes
from optics.light.spectrum import Blackbody
from optics.rays.best_focus import FocusCurve, white_focus
from optics.rays.distortion import plate_scale_mm
from optics.rays.entrance_pupil import launch_disks
from optics.rays.ghosts import GhostPath
from optics.rays.pupil_sampling import gauss_disk
from optics.rays.spots import spot_moments, trace_spots
from optics.rays.trace import Rays
from render.camera import Camera, Diffraction, build_camera
from render.catalogue.temperature import TYPICAL_TEMPERATURE_K
from render.detector.noise import PixelNoise
from render.detector.spec import Detector, load_detector
from render.records import PixelMap

_ROUNDING = 1e-12
_MAP_GRID, _MAP_NODES, _MAP_ORDER = 15, 8, (5, 12)
"""Places along each side of the map of a camera, wavelengths, rings and azimuths of the pupil."""
_LOSS_ORDER = (3, 8)
"""Rings and azimuths of the rays that tell how transmission varies."""
_MAP_REACH = 0.985
"""Share of the detector's half-width that the map spans: the rays of its outermost stars stay on the detector."""
_REACH = 1.02
"""The corner of a detector may lie this much outside the field that the lens was made for."""
_NEAR, _STEPS = 0.01, 16
FIELD_FRACTIONS = (0.0, 0.45, 0.7, 0.87, 1.0)
"""Fields, as fractions of the distance from the middle to the corner of the detector."""
EXPOSURE_S = 0.2
"""Exposure time where none is stated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StarSensor:
    """A camera and its detector; created by `build_star_sensor`, or from a file by `render.load_star_sensor`.

    Attributes
    ----------
    camera : Camera
        Lens, geometry, response.
    detector : Detector
        Noise and conversion.
    focal_length_mm : float
        Scale of the image: displacement of chief rays at the detector per tangent of the field angle, about the axis,
        at the design wavelength (`optics.rays.distortion.plate_scale_mm`). Where the detector is not in the paraxial
        focus, the paraxial focal length is another one.
    exposure_s : float
        Exposure time of frames that state none.
    temperature_c : float or None
        Temperature of the detector in these frames; None: its reference temperature.
    band : Band or None
        Light that reaches the lens in these frames; None: all that lens and detector are known for.
    """

    camera: Camera
    detector: Detector
    focal_length_mm: float
    exposure_s: float = EXPOSURE_S
    temperature_c: float | None = None
    band: Band | None = None

    @property
    def pixel_arcsec(self) -> float:
        """Angle of a pixel on the axis."""
        return float(np.degrees(self.camera.pixel_pitch_mm / self.focal_length_mm) * 3600.0)

    @property
    def field_deg(self) -> tuple[float, float]:
        """Width and height of the field of an undistorted lens."""
        half = np.array([self.camera.width_px, self.camera.height_px]) * self.camera.pixel_pitch_mm / 2
        width, height = np.degrees(2 * np.arctan(half / self.focal_length_mm))
        return float(width), float(height)

    @property
    def diagonal_deg(self) -> float:
        """Diagonal of the field of an undistorted lens."""
        half_mm = 0.5 * self.camera.pixel_pitch_mm * math.hypot(self.camera.width_px, self.camera.height_px)
        return math.degrees(2.0 * math.atan(half_mm / self.focal_length_mm))

    @property
    def known_range_nm(self) -> tuple[float, float]:
        """Wavelengths of the lens design with data of glasses, coatings and quantum efficiency."""
        (low, _), (high, _) = self._limits_nm
        return low, high

    @property
    def _limits_nm(self) -> tuple[tuple[float, str], tuple[float, str]]:
        """Both ends of `known_range_nm`, each with what ends there."""
        lens, response = self.camera.lens, self.camera.response
        ranges = [(glass.range_nm, f"glass {name}") for name, glass in lens.glasses.items()]
        ranges.append((lens.wavelength_range_nm, "the lens"))
        if response is not None:
            ranges.append((response.range_nm, "the quantum efficiency and transmission tables"))
        return max((span[0], source) for span, source in ranges), min((span[1], source) for span, source in ranges)

    def passband(self, range_nm: tuple[float, float] | None = None, *, edge_nm: float = 20.0, name: str = "") -> TopHat:
        """A pass band with sloping edges.

        Parameters
        ----------
        range_nm : (float, float), optional
            Wavelengths at which half of the light passes; left out, the feet lie at the ends of all that is known of
            lens and detector.
        edge_nm : float
            Length of the edges.
        name : str
            What to call it; its range if left out.

        Raises
        ------
        DomainError
            It reaches beyond what is known, or is narrower than its edges.
        """
        low, high = self.known_range_nm
        first, last = (low + edge_nm / 2, high - edge_nm / 2) if range_nm is None else range_nm
        if last - first <= edge_nm:
            raise DomainError(
                f"range_nm is {last - first:g} nm wide; with edges of edge_nm = {edge_nm:g} nm more than "
                f"{edge_nm:g} nm is needed"
            )
        band = TopHat(
            centre_nm=(first + last) / 2,
            width_nm=last - first,
            edge_nm=edge_nm,
            name=name or f"{first:.0f}-{last:.0f}nm",
        )
        self.check_band("range_nm", band)
        return band

    def check_band(self, key: str, band: Band) -> None:
        """Refuse a band beyond the data of glasses, coatings and quantum efficiency (`DomainError`).

        The message names ``key``, the setting that describes the band, with the band and the range.
        """
        lens, ((low, first), (high, last)) = self.camera.lens, self._limits_nm
        start, end = min(band.breakpoints_nm), max(band.breakpoints_nm)
        if start < low * (1.0 - _ROUNDING) or end > high * (1.0 + _ROUNDING):
            limit = first if start < low else last
            raise DomainError(
                f"{key}: {band.name!r} passes {start:g} ... {end:g} nm; lens {lens.name!r} on {self.detector.name!r} "
                f"has data for {low:g} ... {high:g} nm (range of {limit})"
            )

    def pixel_noise(self, detector: Detector | None = None) -> PixelNoise:
        """Noise of a pixel in one exposure, of the sensor's detector or of another one under its conditions."""
        chip = self.detector if detector is None else detector
        temperature_c = chip.dark_reference_c if self.temperature_c is None else self.temperature_c
        return PixelNoise.of(chip, temperature_c=temperature_c, exposure_s=self.exposure_s)

    def windowed(self, width_px: int, height_px: int) -> Self:
        """The sensor of which only the middle of the detector is read out.

        `DomainError` on a window larger than the detector, or cut from several chips.
        """
        detector, camera = self.detector, self.camera
        if (width_px, height_px) == (detector.width_px, detector.height_px):
            return self
        for key, wanted, most in (("width", width_px, detector.width_px), ("height", height_px, detector.height_px)):
            if not 1 <= wanted <= most:
                raise DomainError(
                    f"{key}_px = {wanted} px; detector {detector.name!r} has {most} px; set it to at most that"
                )
        if detector.chips > 1:
            raise DomainError(
                f"width_px = {width_px} px, height_px = {height_px} px on detector {detector.name!r} of "
                f"{detector.chips} chips; a window must lie on a single chip: read the whole detector, or choose "
                "another one"
            )
        return replace(
            self,
            detector=replace(detector, chip_width_px=width_px, chip_height_px=height_px),
            camera=replace(camera, width_px=width_px, height_px=height_px, centre_px=np.full(2, np.nan)),
        )

    def direction_at(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Unit vectors (n, 3) in the camera frame of stars that land near (column, row), n each, distortion and all.

        Chief rays at the design wavelength meet the places to `_NEAR` of the half diagonal. A lens that cannot be
        traced so far gives `render.camera.Camera.nominal_direction`.
        """
        camera, scale = self.camera, self.camera.pixel_pitch_mm / self.focal_length_mm
        target_px = np.stack([x_px, y_px], axis=-1)
        near = _NEAR * 0.5 * math.hypot(camera.width_px, camera.height_px)
        aim_px = target_px
        try:
            for _ in range(_STEPS if camera.lens.measured is None else 0):
                tangent = (aim_px - camera.centre_px) * scale
                miss_px = target_px - camera.chief_px(tangent[:, 0], tangent[:, 1])
                if np.hypot(miss_px[:, 0], miss_px[:, 1]).max(initial=0.0) <= near:
                    break
                aim_px = aim_px + miss_px
        except ConvergenceError:
            aim_px = target_px
        return camera.nominal_direction(aim_px[:, 0], aim_px[:, 1], self.focal_length_mm)

    def radial_field_deg(self, radius_px: FloatArray) -> FloatArray:
        """Field angles (n,) at distances (n,) from the middle of the detector."""
        middle = self.camera.centre_px
        direction = self.direction_at(middle[0] + radius_px, middle[1] + 0.0 * radius_px)
        return np.degrees(np.arctan2(direction[:, 0], direction[:, 2]))

    def focus_curve(self, wavelength_nm: FloatArray, fraction: FloatArray) -> FocusCurve:
        """Mean square spot over the detector against a shift of the detector.

        ``fraction`` (w,) is the light, relative, at the wavelengths (w,).
        """
        camera, lens = self.camera, self.camera.focused_lens
        radius_px = 0.5 * math.hypot(camera.width_px, camera.height_px) * np.array(FIELD_FRACTIONS)
        field_deg = np.minimum(self.radial_field_deg(radius_px), lens.max_field_deg)
        return white_focus(trace_spots(lens, field_deg, 0.0 * field_deg, wavelength_nm), fraction).mean

    def pixel_map(self, band: Band | None = None, *, temperature_k: float = TYPICAL_TEMPERATURE_K) -> PixelMap:
        """Positions of stars of one colour: photon-weighted means of traced rays on a grid over the detector.

        Parameters
        ----------
        band : Band, optional
            Pass band; all that lens and detector are known for if left out.
        temperature_k : float
            Colour of the stars, as black bodies: a lens puts stars of other colours elsewhere.

        Raises
        ------
        ConvergenceError
            No light on most of the grid.
        """
        camera = self.camera
        half = _MAP_REACH * np.array([camera.width_px, camera.height_px]) / 2
        x, y = np.meshgrid(*(np.linspace(-h, h, _MAP_GRID) for h in half))
        direction = self.direction_at((x + camera.centre_px[0]).ravel(), (y + camera.centre_px[1]).ravel())
        nodes = band_nodes([self.passband() if band is None else band], _MAP_NODES)
        wave = nodes.wavelength_nm[0]
        spectrum = Blackbody(temperature_k=temperature_k).photon_density(wave) * camera.response_at(wave)
        spots = spot_moments(camera.focused_lens, *field_angles_deg(direction), wave, order=_MAP_ORDER)
        transmission, shift_mm = _path_losses(camera, direction, wave)
        light = nodes.weight_nm[0] * nodes.transmission[0] * spectrum * spots.transmitted_mm2 * transmission
        lit = light.sum(1) > 0.0
        if np.count_nonzero(lit) < _MAP_GRID**2 // 2:
            raise ConvergenceError(
                f"lens {camera.lens.name!r}: light reaches {np.count_nonzero(lit)} of {_MAP_GRID**2} places of the "
                "detector; a smaller window is needed to calibrate it"
            )
        light = light[lit] / light[lit].sum(1, keepdims=True)
        landing_mm = [v + p for v, p in zip((spots.x_mm, spots.y_mm), shift_mm, strict=True)]
        mean = [(np.where(light > 0.0, v[lit], 0.0) * light).sum(1) for v in landing_mm]
        return PixelMap(
            direction=direction[lit],
            pixel_px=np.stack(camera.to_pixel(*mean), axis=-1),
            width_px=camera.width_px,
            height_px=camera.height_px,
            pixel_pitch_mm=camera.pixel_pitch_mm,
            focal_length_mm=self.focal_length_mm,
        )

    def check_field(self) -> None:
        """Refuse a detector far larger than the design field of the lens: `DomainError` with the window that is not."""
        camera, limit = self.camera, self.camera.lens.max_field_deg
        corner_px = math.hypot(camera.width_px, camera.height_px) / 2
        corner = self.direction_at(*camera.centre_px[:, None] + [[corner_px], [0.0]])[0]
        corner_deg = math.degrees(math.atan2(math.hypot(corner[0], corner[1]), corner[2]))
        if corner_deg > _REACH * limit:
            edge = camera.chief_px(np.array([math.tan(math.radians(limit))]), np.zeros(1))[0]
            fraction = float(np.hypot(*(edge - camera.centre_px))) / corner_px
            raise DomainError(
                f"the corners of {camera.width_px} x {camera.height_px} px see {corner_deg:.1f} deg from the axis, "
                f"lens {camera.lens.name!r} is made for {limit:g} deg; read at most "
                f"{int(camera.width_px * fraction)} x {int(camera.height_px * fraction)} px"
            )


def _path_losses(camera: Camera, direction: FloatArray, wave: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the transmission of rays along their own paths does to bundles that weigh them equally.

    The share (f, w) of the light over that of the axis, and by how much (2, f, w) means move [mm].
    """
    lens, losses = camera.focused_lens, camera.losses
    points = gauss_disk(*_LOSS_ORDER)
    transmission, shift_mm = np.ones((len(direction), len(wave))), np.zeros((2, len(direction), len(wave)))
    if losses is not None:
        disks, path = (
            launch_disks(lens, direction, wave),
            GhostPath(lens, None, None, losses.coating, losses.absorption),
        )
        radius, x, y = (v.reshape(-1, 1) for v in (disks.radius_mm, disks.x_mm, disks.y_mm))
        x, y = x + radius * points.x, y + radius * points.y
        along = np.repeat(light_direction(direction), len(points.x), axis=0)
        for w, (nm, axis) in enumerate(zip(wave, losses.along_axis(lens, wave), strict=True)):
            start = Rays.create(
                x_mm=x.ravel(), y_mm=y.ravel(), z_mm=float(disks.z_mm), direction=along, wavelength_nm=nm
            )
            out = path.trace(start, np.ones(x.size))
            light = out.weight.reshape(x.shape) * points.weight
            landing_mm = np.where(light > 0.0, np.stack([out.rays.x, out.rays.y]).reshape(2, *x.shape), 0.0)
            uniform = points.weight * (light > 0.0)
            sums = [np.maximum(weights.sum(1), 1e-300) for weights in (light, uniform)]
            transmission[:, w] = np.where(uniform.any(1), sums[0] / sums[1] / axis, 1.0)
            shift_mm[:, :, w] = (landing_mm * light).sum(2) / sums[0] - (landing_mm * uniform).sum(2) / sums[1]
    return transmission, shift_mm


def build_star_sensor(
    lens: str | Path | LensSystem,
    detector: str | Path | Detector,
    *,
    window_px: int | tuple[int, int] | None = None,
    defocus_mm: float = 0.0,
    coating_nm: float = 550.0,
    absorption: bool = True,
    diffraction: Diffraction = "waves",
) -> StarSensor:
    """Star sensor of a lens and a detector, by name, file or record; see `render.load_star_sensor`.

    Parameters
    ----------
    lens, detector
        The parts.
    window_px : int or (int, int), optional
        Width and height that are read out in the middle of the detector; all of it if left out.
    defocus_mm : float
        Detector shift away from the lens.
    coating_nm : float
        Design wavelength of the MgF2 quarter-wave coatings on all surfaces; 0: bare glass.
    absorption, diffraction
        As in `render.build_camera`.
    """
    chosen = lens if isinstance(lens, LensSystem) else load_lens(lens)
    chip = detector if isinstance(detector, Detector) else load_detector(detector)
    camera = build_camera(
        chosen,
        chip,
        defocus_mm=defocus_mm,
        coating=QuarterWave(design_wavelength_nm=coating_nm) if coating_nm > 0 else None,
        absorption=absorption,
        diffraction=diffraction,
    )
    sensor = StarSensor(camera=camera, detector=chip, focal_length_mm=plate_scale_mm(camera.focused_lens))
    if window_px is None:
        return sensor
    width, height = (window_px, window_px) if isinstance(window_px, int) else window_px
    return sensor.windowed(width, height)
