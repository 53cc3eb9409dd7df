"""Star field + camera -> noiseless image, through ``mi.load_dict`` and ``mi.render``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.errors import StarbenchError
from render.camera import Camera
from render.engine import Engine
from render.plugins.camera_properties import lens_camera_properties
from render.plugins.register import register_plugins
from render.plugins.star_field import share_collimation, share_motion
from render.records import ExpectedImage, StarField, checked_exposure
from render.tracing.motion import ExposureMotion
from render.tracing.tracer import TracedStars

__all__ = ["StarRenderer", "render_stars"]


class StarRenderer:
    """Renders star fields through one camera; loaded once, so that the lens is compiled and its pupil planned once.

    Parameters
    ----------
    camera : Camera
        The camera.
    exposure_s : float
        Exposure time.
    sobol_log2_rays : int
        Logarithm of the rays per star and band where the pupil is not round and clear.
    seed : int
        Scrambles the Sobol points; without effect on clear pupils.

    Raises
    ------
    DomainError
        Exposure not positive.

    Attributes
    ----------
    traced : TracedStars or None
        What the last image was made of, including how the pupil was sampled.
    """

    def __init__(self, camera: Camera, *, exposure_s: float = 1.0, sobol_log2_rays: int = 16, seed: int = 0) -> None:
        self.exposure_s = checked_exposure(exposure_s)
        register_plugins()
        self._mi = mi = Engine.active().mitsuba
        self.camera, self.seed = camera, int(seed)
        self.traced: TracedStars | None = None
        self._integrator = mi.load_dict({"type": "star_tracer", "sobol_log2_rays": sobol_log2_rays})
        self._sensor = mi.load_dict(lens_camera_properties(camera, shutter_close=self.exposure_s))

    def render(
        self,
        stars: StarField,
        *,
        rotation_cam_from_world: NDArray[np.float64] | None = None,
        motion: ExposureMotion | None = None,
    ) -> ExpectedImage:
        """Noiseless image with truth.

        Parameters
        ----------
        stars : StarField
            Stars in the camera's world frame.
        rotation_cam_from_world : (3, 3), optional
            Attitude; the camera's own if left out.
        motion : ExposureMotion, optional
            Attitudes during the exposure, in place of one (`render.tracing.motion.exposure_motion`).

        Raises
        ------
        DomainError
            Wavelength outside a glass's range, star behind the camera, motion for another exposure time.
        ConfigError
            Both an attitude and a motion.
        """
        mi = self._mi
        attitude: dict[str, Any] = {} if motion is None else {"motion": share_motion(motion)}
        if stars.collimation is not None:
            attitude["collimation"] = share_collimation(stars.collimation)
        if rotation_cam_from_world is not None:
            attitude["rotation"] = mi.TensorXf64(np.ascontiguousarray(rotation_cam_from_world, float)[None])
        scene = mi.load_dict(
            {
                "type": "scene",
                "camera": self._sensor,
                "stars": {
                    "type": "star_field",
                    "direction": mi.TensorXf64(stars.direction[None]),
                    "wavelength_nm": mi.TensorXf64(stars.wavelength_nm[None]),
                    "photon_rate": mi.TensorXf64(stars.photon_rate[None]),
                    "band": ",".join(name.replace(",", ";") for name in stars.band),
                    **attitude,
                },
            }
        )
        try:
            mi.render(scene, sensor=self._sensor, integrator=self._integrator, seed=self.seed)
        except RuntimeError as error:  # Mitsuba wraps what a plugin raises, Ctrl-C too
            if isinstance(error.__cause__, (StarbenchError, KeyboardInterrupt)):
                raise error.__cause__ from None
            raise
        traced: TracedStars = self._integrator.traced
        self.traced = traced
        return ExpectedImage(
            electrons=traced.electrons,  # what mi.render returned, before it became a tensor
            band=stars.band,
            exposure_s=self.exposure_s,
            diffused=True,
            truth=traced.truth,
        )


def render_stars(camera: Camera, stars: StarField, *, exposure_s: float = 1.0) -> ExpectedImage:
    """Noiseless image of a star field; see `StarRenderer` for many fields through one camera."""
    return StarRenderer(camera, exposure_s=exposure_s).render(stars)
