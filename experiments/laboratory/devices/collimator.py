"""The laboratory's collimator with its errors: its light at the camera, frame by frame.

The light of a target has four errors:

* an angle and a vergence that depend on the wavelength: the wedge of a filter, a temperature gradient of the air, and a
  target out of focus at this colour (`Collimator.light`);
* a point is a pinhole, which is convolved into the image (`Collimator.motion`, `Collimator.pinhole_psf`);
* vibration above the frequency of the exposures is a blur (`experiments.laboratory.bench.points.filter_scene`);
* below it, with the seeing, the line of sight differs from frame to frame, equally for all points
  (`Collimator.offsets_px`).

The position of the camera's pupil in the beam is the same for all target points; the shift of the beam of off-axis
points over the aperture is neglected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from experiments.laboratory.settings.collimator import CollimatorConfig, FilteredCollimatorConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.glass.absolute_index import Environment
from optics.glass.catalogue import get_glass
from optics.light.collimation import Collimation, air_deviation_rad, wedge_deviation_rad
from optics.rays.pupil_sampling import gauss_disk
from optics.units import ARCSEC_RAD, DEG_RAD, UM_MM
from render.engine.random import Streams
from render.motion.jitter import JitterSpectrum, jittered
from render.motion.trajectory import ConstantRate
from render.records import EffectivePsf
from render.sensor_file.filters import Filter
from render.tracing.motion.exposure import ExposureMotion, gauss_times
from render.tracing.psf import of_disk

RINGS_PER_PX = 3.0
"""Radii of the quadrature over a pinhole, per pixel of its radius; the image has no detail below a third of a pixel."""
STEPS_PER_CYCLE = 4.0
"""Times at which an exposure is sampled, per cycle of the highest frequency."""
LONG_CYCLES = 1e4
"""Of the lowest frequency, over which frames are spread."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Collimator:
    """A collimator with errors; made by `build_collimator`."""

    config: CollimatorConfig  # Its errors
    wedge: Mapping[str, tuple[float, float]]  # By filter: angle between its faces [arcsec], azimuth of the shift [deg]

    @property
    def wedge_lever(self) -> float:
        """Deviation of the collimated light over that of the filter: less than 1 near the target."""
        distance = getattr(self.config, "filter_distance_mm", None)
        return 1.0 if distance is None else float(distance / self.config.focal_length_mm)

    @property
    def source_radius_rad(self) -> float:
        """Angular radius of a point of the target."""
        return 0.5 * self.config.pinhole_um * UM_MM / self.config.focal_length_mm

    @property
    def spectrum(self) -> JitterSpectrum | None:
        """Spectrum of the line of sight; None at rest."""
        if not self.config.vibration_hz:
            return None
        psd = np.array(self.config.vibration_arcsec2_per_hz)
        return JitterSpectrum(
            frequency_hz=np.array(self.config.vibration_hz), psd_arcsec2_per_hz=np.stack([psd, psd, 0.0 * psd])
        )

    def focus_mm(self, wavelength_nm: FloatArray) -> FloatArray:
        """Focus against its nominal place, away from the collimator."""
        nodes = self.config.focus_wavelength_nm
        if not nodes:
            return np.zeros_like(wavelength_nm)
        low, high = float(wavelength_nm.min()), float(wavelength_nm.max())
        if low < nodes[0] or high > nodes[-1]:
            raise DomainError(
                f"collimator.focus_wavelength_nm = {nodes[0]:g} ... {nodes[-1]:g} nm does not cover the light of "
                f"{low:.0f} ... {high:.0f} nm"
            )
        return np.asarray(PchipInterpolator(nodes, self.config.focus_um)(wavelength_nm)) * UM_MM

    def light(
        self, filters: Sequence[Filter], wavelength_nm: FloatArray, environment: Environment
    ) -> Collimation | None:
        """Slope and vergence of the light behind filters at their wavelengths (b, k); None where it is collimated."""
        config, wedges = self.config, [self.wedge.get(band.name, (0.0, 0.0)) for band in filters]
        gradient = np.array(config.air_gradient_k_per_m)
        if not (config.decollimation_um or any(config.focus_um) or gradient.any() or any(a for a, _ in wedges)):
            return None
        f = config.focal_length_mm
        vergence = 1.0 / (f + config.decollimation_um * UM_MM) - 1.0 / (f + self.focus_mm(wavelength_nm))
        # diverging light comes from the opposite side of the offset
        slope = -vergence[..., None] * np.array(config.offset_mm)
        for band, (angle, azimuth) in enumerate(wedges):
            if angle:
                assert isinstance(config, FilteredCollimatorConfig)
                glass = get_glass(config.wedge_glass)
                deviation = wedge_deviation_rad(angle * ARCSEC_RAD, glass, wavelength_nm[band], environment)
                direction = np.array([np.cos(azimuth * DEG_RAD), np.sin(azimuth * DEG_RAD)])
                slope[band] += self.wedge_lever * deviation[:, None] * direction
        if gradient.any():
            if not environment.pressure_hpa:
                raise DomainError(
                    "collimator.air_gradient_k_per_m: the lens stands in a vacuum; there is no air to refract"
                )
            slope = slope + air_deviation_rad(config.air_path_m, wavelength_nm, environment)[..., None] * gradient
        return Collimation(wavelength_nm=wavelength_nm, slope_rad=slope, vergence_per_mm=vergence)

    def motion(self, exposure_s: float, pixel_rad: float) -> ExposureMotion | None:
        """Attitudes that spread a point uniformly over the disk of its pinhole; None for a point."""
        radius = self.source_radius_rad
        if not radius:
            return None
        rings = 2 + int(np.ceil(RINGS_PER_PX * radius / pixel_rad))
        disk = gauss_disk(rings, 8 * ((rings + 1) // 2))
        # (-y, x, 0) turns the axis by (x, y)
        vector = np.stack([-disk.y, disk.x, np.zeros_like(disk.x)], axis=-1) * radius
        return ExposureMotion(
            start_s=0.0,
            exposure_s=exposure_s,
            line_time_s=0.0,
            time_s=np.full(len(disk.x), 0.5 * exposure_s),
            weight=disk.weight,
            rotation_cam_from_world=Rotation.from_rotvec(vector).as_matrix(),
            rotation_mid=np.eye(3),
            length_px=2.0 * radius / pixel_rad,
            path=None,
        )

    def pinhole_psf(self, point: EffectivePsf, pixel_rad: float) -> EffectivePsf:
        """The PSF of a pinhole from that of a point."""
        radius_px = self.source_radius_rad / pixel_rad
        return of_disk(point, radius_px) if radius_px else point

    def power_arcsec2(self, exposure_s: float) -> tuple[float, float]:
        """Variance of the line of sight per axis: of its mean over an exposure, and within one."""
        seeing = self.config.seeing_arcsec**2
        if self.spectrum is None:
            return seeing, 0.0
        between, within = self.spectrum.exposure_power_arcsec2(exposure_s)
        return seeing + float(between[0]), float(within[0])

    def offsets_px(self, streams: Streams, frames: int, exposure_s: float, pixel_arcsec: float) -> FloatArray | None:
        """Mean line of sight (frames, 2) [px] of exposures, drawn; None where it is at rest.

        Vibration is drawn as oscillations and averaged over the exposure. Frames start at random times: they are
        uncorrelated, as frames are that lie apart by more than the correlation time of the motion.
        """
        config, spectrum = self.config, self.spectrum
        if not config.seeing_arcsec and spectrum is None:
            return None
        streams = streams.child("collimator")
        offset = config.seeing_arcsec * streams.generator("seeing").standard_normal((frames, 2))
        if spectrum is not None:
            rest = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.zeros(3), end_s=exposure_s)
            moving = jittered(rest, spectrum, streams=streams)
            nodes, weight = gauss_times(16 + int(STEPS_PER_CYCLE * spectrum.frequency_hz[-1] * exposure_s))
            rate, phase = (2.0j * np.pi * moving.frequency_hz[:2], 1.0j * moving.phase_rad[:2])
            swing = moving.amplitude_rad[:2] * (np.exp(rate[..., None] * nodes * exposure_s) @ weight)
            last_s = LONG_CYCLES / spectrum.frequency_hz[0]
            start_s = streams.generator("start").uniform(0.0, last_s, frames)[:, None, None]
            offset += (swing * np.exp(rate * start_s + phase)).real.sum(-1) / ARCSEC_RAD
        return np.asarray(offset / pixel_arcsec)


def build_collimator(
    config: CollimatorConfig, filters: Sequence[Filter] = (), setting: str = "filters.centres_nm"
) -> Collimator | None:
    """The collimator of a configuration; None for a perfect one."""
    wedge: dict[str, tuple[float, float]] = {}
    if isinstance(config, FilteredCollimatorConfig) and config.wedge_arcsec:
        if len(config.wedge_arcsec) != len(filters):
            raise DomainError(
                f"collimator.wedge_arcsec has {len(config.wedge_arcsec)} values for {len(filters)} filters "
                f"({setting}); give one for each"
            )
        get_glass(config.wedge_glass)
        azimuths = config.wedge_direction_deg or (0.0,) * len(filters)
        wedge = {
            band.name: (angle, azimuth)
            for band, angle, azimuth in zip(filters, config.wedge_arcsec, azimuths, strict=True)
        }
    return None if config == type(config)() else Collimator(config=config, wedge=wedge)
