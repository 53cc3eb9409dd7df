"""One camera under the moving sky: lens and detector, stars and their light, true and a priori attitudes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import rotation_of_angles
from calib.attitude.gyro_attitude import integrate_rates
from calib.cameras.base import SensorGeometry
from experiments.skycal.settings import SkycalCameraConfig, SkycalConfig, SkycalMotionConfig, SkycalSkyConfig
from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import DomainError, StarbenchError
from optics.rays.vignetting import collecting_area_mm2
from optics.units import ARCSEC_RAD, DEG_RAD
from render.engine.random import Streams
from render.motion.gyro import Gyro, simulate_gyro
from render.motion.trajectory import SampledAttitude, mounted, precession
from render.records import StarField
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument, build_instrument
from render.simulator import SkySimulator
from render.sky.sky import Sky, load_sky
from render.sky.star_light import StarLight, star_light

STEPS_PER_FRAME = 20
"""Integration steps of the trajectory; a spline through the result is the truth."""
AXIS_TURN_DEG = 180.0
"""Rotation of the axis about the boresight in the sequence. With a fixed axis, the rotation of the installation about
this axis would not be observable."""
MIN_STARS = 3
"""Smallest mean number of stars per frame."""
RENDER_MARGIN_FRACTION, RENDER_MARGIN_PX = 0.02, 8.0
"""Border around the detector whose stars are rendered: fraction of the width for distortion, pixels for the PSF."""
REFERENCE_MAG = 5.0
"""Magnitude of traced stars, whose positions do not depend on it."""
TEMPERATURE_RANGE_K = (1200.0, 50000.0)
"""Range of the table of starlight, to which colour temperatures are clipped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraScene:
    """A camera, its sky and its motion; f frames."""

    name: str  # "narrow", "wide" or "own"
    config: SkycalCameraConfig
    instrument: Instrument  # Camera and detector, cut to the window that is read out
    simulator: SkySimulator  # Stars down to the faintest that are rendered, in the full pass band
    time_s: FloatArray  # (f,) Times of the frames
    attitude: Rotation  # True attitudes (f), cam from icrs
    prior_attitude: Rotation  # Start of the matching, with an error of arcminutes
    gyro_rotation: Rotation  # Gyro body at frame k from gyro body at the first frame, integrated from noisy rates
    true_gyro_rotation: Rotation  # True rotation of the gyro body
    installation: Rotation  # Mounting: cam from gyro body

    @property
    def sky(self) -> Sky:
        """Stars of the simulator."""
        return self.simulator.sky

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.attitude)

    @property
    def pixel_arcsec(self) -> float:
        """Angle of a pixel on the axis [arcsec]."""
        return self.instrument.pixel_arcsec

    @property
    def geometry(self) -> SensorGeometry:
        """Size and pitch of the detector, for camera models."""
        camera = self.instrument.camera
        size = {"width_px": camera.width_px, "height_px": camera.height_px}
        return SensorGeometry(**size, pixel_pitch_mm=camera.pixel_pitch_mm)

    def of_one_colour(self, direction: FloatArray, temperature_k: float) -> StarField:
        """Stars of one colour and brightness at directions (n, 3) in cam."""
        return self.simulator.light.stars(direction, REFERENCE_MAG, np.clip(temperature_k, *TEMPERATURE_RANGE_K))

    def in_cam(self, frame: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Rows of the stars that may fall on the detector in a frame, and their directions (n, 3) in cam."""
        field = self.sky.field(self.simulator.view, self.attitude[frame])
        return field.row, field.direction @ field.rotation_cam_from_icrs.T


def build_scene(name: str, config: SkycalConfig, streams: Streams) -> CameraScene:
    """Scene of a camera; all checks that need no rendering."""
    camera_config = config.cameras[name]
    instrument = _instrument(name, camera_config)
    band = open_band(config.passband, instrument, "full pass band")
    path = _trajectory(config.sky, config.motion, config.frames)
    time_s = np.arange(config.frames) / config.motion.frame_rate_hz
    installation = rotation_of_angles(np.radians(config.gyro.installation_deg))
    body = mounted(path, installation.inv())
    record = simulate_gyro(body, _gyro(config, streams), streams)
    attitude = path.attitude(time_s)
    body_attitude = body.attitude(time_s)
    error = streams.generator("told attitude").normal(size=(config.frames, 3))
    error *= config.motion.attitude_error_arcmin * 60.0 * ARCSEC_RAD
    light = star_light([band], nodes=config.sky.nodes, magnitude_system="G")
    detectable_mag = _detectable_mag(instrument, light, camera_config, config)
    sky = load_sky(faintest_mag=min(camera_config.faintest_mag, detectable_mag))
    scene = CameraScene(
        name=name,
        config=camera_config,
        instrument=instrument,
        simulator=SkySimulator(
            instrument,
            replace(sky, temperature_k=np.clip(sky.temperature_k, *TEMPERATURE_RANGE_K)),
            exposure_s=instrument.config.exposure_s,
            passband=band,
            nodes=config.sky.nodes,
            temperature_c=instrument.config.chip_temperature_c,
            background_e_per_s=camera_config.background_e_per_s,
            sobol_log2_rays=camera_config.sobol_log2_rays,
            margin_px=RENDER_MARGIN_FRACTION * instrument.camera.width_px + RENDER_MARGIN_PX,
        ),
        time_s=time_s,
        attitude=attitude,
        prior_attitude=Rotation.from_rotvec(error) * attitude,
        gyro_rotation=integrate_rates(record.time_s, record.rate_rad_per_s, at_s=time_s),
        true_gyro_rotation=body_attitude * body_attitude[0].inv(),
        installation=installation,
    )
    _check_stars(scene)
    return scene


def _gyro(config: SkycalConfig, streams: Streams) -> Gyro:
    """The gyro, with a bias of random sign on every axis."""
    sign = np.where(streams.generator("bias").uniform(size=3) < 0.5, -1.0, 1.0)
    return Gyro(
        rate_hz=config.gyro.rate_hz,
        bias_deg_per_h=config.gyro.bias_deg_per_h * sign,
        angle_random_walk_deg_per_sqrt_h=np.full(3, config.gyro.angle_random_walk_deg_per_sqrt_h),
    )


def _detectable_mag(
    instrument: Instrument, light: StarLight, camera_config: SkycalCameraConfig, config: SkycalConfig
) -> float:
    """Magnitude (G) of stars that would not be detected if all their light fell on one pixel; rounded towards faint."""
    camera = instrument.camera
    exposure_s = instrument.config.exposure_s
    rate = light.photon_rate(np.zeros(2), np.array(TEMPERATURE_RANGE_K))[:, 0] @ camera.response_at(
        light.wavelength_nm[0]
    )
    electrons = rate.max() * collecting_area_mm2(camera.lens) * exposure_s
    noise_e2 = float(instrument.pixel_noise().temporal_e2(camera_config.background_e_per_s * exposure_s))
    return 0.5 * float(np.ceil(5.0 * np.log10(electrons / (config.threshold_sigma * np.sqrt(noise_e2)))))


def _trajectory(sky: SkycalSkyConfig, motion: SkycalMotionConfig, frames: int) -> SampledAttitude:
    """Camera from icrs until one interval after the last frame: constant speed, the axis turns in the camera."""
    return precession(
        attitude_from_angles(sky.ra_deg, sky.dec_deg),
        rate_rad_per_s=motion.rate_deg_per_s * DEG_RAD,
        tilt_rad=motion.axis_deg * DEG_RAD,
        turn_rad=AXIS_TURN_DEG * DEG_RAD,
        end_s=frames / motion.frame_rate_hz,
        steps=frames * STEPS_PER_FRAME,
        knot_every=STEPS_PER_FRAME // 4,
    )


def _instrument(name: str, config: SkycalCameraConfig) -> Instrument:
    """The instrument; refuses a detector beyond the field of the lens."""
    try:
        instrument = build_instrument(config.instrument)
        instrument.check_field()
    except StarbenchError as error:
        raise type(error)(f"{name}.{error}" if str(error).startswith("instrument.") else f"{name}: {error}") from None
    return instrument


def _check_stars(scene: CameraScene) -> None:
    """Refuse a sequence with fewer than `MIN_STARS` per frame."""
    count = np.array([len(scene.in_cam(frame)[0]) for frame in range(scene.frames)])
    if count.mean() < MIN_STARS:
        width, height = scene.instrument.field_deg
        raise DomainError(
            f"{scene.name}: {count.mean():.1f} stars per frame to G = {scene.config.faintest_mag:g} in the field of "
            f"{width:.1f} x {height:.1f} deg; at least {MIN_STARS} are needed: raise {scene.name}.faintest_mag or "
            "point elsewhere (sky.ra_deg, sky.dec_deg)"
        )
