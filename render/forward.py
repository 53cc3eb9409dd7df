"""Star field + camera -> noiseless image, through ``mi.load_dict``, ``mi.traverse`` and ``mi.render``."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.errors import ConfigError, StarbenchError
from render.camera import Camera
from render.engine import Engine
from render.plugins.camera_properties import lens_camera_properties, share_motion
from render.plugins.register import register_plugins
from render.plugins.scene_files import save_scene
from render.plugins.star_field import share_collimation
from render.records import ExpectedImage, StarField, checked_exposure
from render.tracing.convergence import TOLERANCE
from render.tracing.motion.exposure import ExposureMotion
from render.tracing.tracer import TracedStars, Tracer

SCENES = "STARBENCH_SCENES"
"""Environment variable that names a folder: the scene of every image of stars is saved there."""
_number = itertools.count()
STARS = ("direction", "wavelength_nm", "photon_rate")


def star_scene(
    camera: Camera,
    stars: StarField,
    *,
    exposure_s: float = 1.0,
    motion: ExposureMotion | None = None,
    sobol_log2_rays: int = 16,
    tolerance: float = TOLERANCE,
    by_grid: bool = False,
    contents: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Scene for ``mi.load_dict``: integrator, camera, stars in its world, and ``contents``, e.g. shapes [mm].

    Sobol rays, tolerance and grid as in ``star_tracer``; a motion takes the place of the attitude.
    """
    mi = Engine.active().mitsuba
    register_plugins()
    moving = {} if motion is None else {"exposure_motion": share_motion(motion)}
    bent = {} if stars.collimation is None else {"collimation": share_collimation(stars.collimation)}
    tensors = {name: mi.TensorXf64(np.ascontiguousarray(getattr(stars, name))[None]) for name in STARS}
    return {
        "type": "scene",
        "integrator": {
            "type": "star_tracer",
            "sobol_log2_rays": sobol_log2_rays,
            "tolerance": tolerance,
            "by_grid": by_grid,
        },
        "camera": lens_camera_properties(camera, shutter_close=exposure_s, **moving),
        "stars": {
            "type": "star_field",
            **tensors,
            "band": ",".join(name.replace(",", ";") for name in stars.band),
            **bent,
        },
        **(contents or {}),
    }


class StarRenderer:
    """Renders star fields through a camera in a single scene; lens and pupil sampling are prepared once.

    Stars and attitude are parameters of the scene (`mi.traverse`); nothing is loaded again from frame to frame.

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
    tolerance : float
        Of the quadrature of the pupil.
    by_grid : bool
        By waves: few stars too are taken from a grid of images over the field, which pays where many fields follow.
    contents : mapping, optional
        Further entries of the scene (`star_scene`): bodies that hide stars.

    Attributes
    ----------
    traced : TracedStars or None
        Ray and pupil data of the last image.
    label : str
        Name of the next image's scene file if `SCENES` is set; numbered where it is empty.

    Raises
    ------
    DomainError
        Exposure not positive.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        exposure_s: float = 1.0,
        sobol_log2_rays: int = 16,
        seed: int = 0,
        tolerance: float = TOLERANCE,
        by_grid: bool = False,
        contents: Mapping[str, Any] | None = None,
    ) -> None:
        self.exposure_s = checked_exposure(exposure_s)
        register_plugins()
        self._mi = Engine.active().mitsuba
        self.camera, self.seed = camera, int(seed)
        self.traced: TracedStars | None = None
        self.label = ""
        self._settings: dict[str, Any] = {
            "exposure_s": self.exposure_s,
            "sobol_log2_rays": sobol_log2_rays,
            "tolerance": tolerance,
            "by_grid": by_grid,
            "contents": contents,
        }
        self._scene: Any = None
        self._params: Any = None
        self._field: Any = None
        self._last: tuple[NDArray[np.float64], StarField, ExposureMotion | None] | None = None

    def render(
        self,
        stars: StarField,
        *,
        rotation_cam_from_world: NDArray[np.float64] | None = None,
        motion: ExposureMotion | None = None,
    ) -> ExpectedImage:
        """Noiseless image with truth; parameters and errors as `trace`."""
        traced = self.trace(stars, rotation_cam_from_world=rotation_cam_from_world, motion=motion)
        return ExpectedImage(
            electrons=traced.electrons, band=stars.band, exposure_s=self.exposure_s, diffused=True, truth=traced.truth
        )

    def trace(
        self,
        stars: StarField,
        *,
        rotation_cam_from_world: NDArray[np.float64] | None = None,
        motion: ExposureMotion | None = None,
    ) -> TracedStars:
        """As `render`, directly from ``mi.render``, without copies and checks.

        Parameters
        ----------
        stars : StarField
            Stars in the camera's world frame.
        rotation_cam_from_world : (3, 3), optional
            Attitude; the camera's own if left out.
        motion : ExposureMotion, optional
            Attitudes during the exposure, in place of one (`render.tracing.motion.exposure.exposure_motion`).

        Raises
        ------
        DomainError
            Wavelength outside a glass's range, star behind the camera, motion for another exposure time.
        ConfigError
            Both an attitude and a motion.
        """
        if rotation_cam_from_world is not None and motion is not None:
            raise ConfigError("an attitude and a motion are given; leave one of them out")
        rotation = self.camera.rotation_cam_from_world if rotation_cam_from_world is None else rotation_cam_from_world
        try:
            self._update(rotation, stars, motion)
            image = self._mi.render(self._scene, seed=self.seed, seed_grad=self.seed + 1)  # else drawn by a kernel
        except RuntimeError as error:  # Mitsuba wraps what a plugin raises, Ctrl-C too
            if isinstance(error.__cause__, (StarbenchError, KeyboardInterrupt)):
                raise error.__cause__ from None
            raise
        self._last = (rotation, stars, motion)
        if folder := os.environ.get(SCENES):
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.save(Path(folder) / f"{self.label or f'stars_{os.getpid()}_{next(_number):06d}'}.xml")
        self.traced = replace(self._scene.integrator().traced, electrons=image.numpy())
        return self.traced

    @property
    def tracer(self) -> Tracer | None:
        """Tracer of the last image; by waves it has the light of its stars (`render.tracing.psf.render_epsf`)."""
        if self._scene is None:
            return None
        tracer: Tracer = self._scene.integrator().tracer(self._scene.sensors()[0], self.seed)
        return tracer

    def save(self, path: str | Path) -> list[Path]:
        """Write the scene of the last image (`render.plugins.scene_files.save_scene`), for ``mi.load_file``.

        `ConfigError` before the first image.
        """
        if self._last is None:
            raise ConfigError("no image was rendered yet; render one, then save its scene")
        rotation, stars, motion = self._last
        camera = replace(self.camera, rotation_cam_from_world=rotation)
        return save_scene(path, star_scene(camera, stars, motion=motion, **self._settings))

    def _update(self, rotation: NDArray[np.float64], stars: StarField, motion: ExposureMotion | None) -> None:
        """Load the scene, or bring it up to date."""
        mi = self._mi
        if self._scene is None:
            self._scene = mi.load_dict(star_scene(self.camera, stars, **self._settings))
            self._field = next(emitter for emitter in self._scene.emitters() if hasattr(emitter, "photon_rate"))
            self._params = mi.traverse(self._scene)
            self._params.keep(["camera.rotation", *(f"stars.{name}" for name in STARS)])
        self._scene.sensors()[0].exposure_motion = motion
        self._field.collimation = stars.collimation
        for name in STARS:
            self._params[f"stars.{name}"] = mi.TensorXf64(np.ascontiguousarray(getattr(stars, name)))
        self._params["camera.rotation"] = mi.TensorXf64(np.ascontiguousarray(rotation))
        self._params.update()


def render_stars(camera: Camera, stars: StarField, *, exposure_s: float = 1.0) -> ExpectedImage:
    """Noiseless image of a star field; see `StarRenderer` for many fields through one camera."""
    return StarRenderer(camera, exposure_s=exposure_s).render(stars)
