"""Mitsuba integrator ``star_tracer``: renders the scene's ``star_field`` through its ``lens_camera``.

Properties
----------
sobol_log2_rays : int, default 16
    Logarithm of the rays per star and band where the pupil is not round and clear.

``mi.render`` returns an image (h, w, bands) of expected photo-electrons in the exposure (the camera's ``shutter_open``
to ``shutter_close``); its ``seed`` scrambles the Sobol points. The truth of the last image is in ``integrator.traced``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from optics.errors import ConfigError
from render.tracing.tracer import TracedStars, Tracer

__all__ = ["define"]

KEPT = 8
"""Cameras (with a seed each) whose compiled lens is kept for the next image."""


def define(mi: Any, emitter_class: Any, camera_class: Any) -> type:
    """The plugin class for Mitsuba's active variant."""

    class StarTracer(mi.AdjointIntegrator):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.sobol_log2_rays = int(props.get("sobol_log2_rays", 16))
            if not 6 <= self.sobol_log2_rays <= 26:
                raise ConfigError(f"star_tracer: sobol_log2_rays = {self.sobol_log2_rays} is outside 6 ... 26")
            self.traced: TracedStars | None = None
            self._tracers: dict[tuple[int, int], tuple[Any, Tracer]] = {}

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            camera = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            if not isinstance(camera, camera_class):
                raise ConfigError(f"star_tracer: the sensor is a {type(camera).__name__}; a lens_camera is needed")
            fields = [emitter for emitter in scene.emitters() if isinstance(emitter, emitter_class)]
            if len(fields) != 1:
                raise ConfigError(
                    f"star_tracer: the scene holds {len(fields)} star_field emitters; exactly one is needed"
                )
            number = int(np.asarray(seed).item())  # a number, or a Dr.Jit array of one
            key = (id(camera), number)
            if key not in self._tracers:  # the sensor is kept too, so that its id stays taken
                while len(self._tracers) >= KEPT:
                    self._tracers.pop(next(iter(self._tracers)))
                tracer = Tracer(camera.camera, sobol_log2_rays=self.sobol_log2_rays, sobol_seed=number)
                self._tracers[key] = (camera, tracer)
            self.traced = self._tracers[key][1].render(
                fields[0].stars,
                exposure_s=camera.exposure_s,
                rotation_cam_from_world=fields[0].rotation,
                motion=fields[0].motion,
            )
            return mi.TensorXf(self.traced.electrons)

        def sample(self, scene: Any, sensor: Any, sampler: Any, block: Any, sample_scale: Any) -> None:
            raise NotImplementedError("star_tracer renders whole images; call mi.render")

        def to_string(self) -> str:
            return f"StarTracer[sobol_log2_rays={self.sobol_log2_rays}]"

    return StarTracer
