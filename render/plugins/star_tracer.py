"""Mitsuba integrator ``star_tracer``: renders the scene's ``star_field`` through its ``lens_camera``.

Properties
----------
sobol_log2_rays : int, default 16
    Logarithm of the rays per star and band where the pupil is not round and clear.
tolerance : float, default 3e-5
    Of the quadrature of the pupil (`render.tracing.pupil.quadrature_order`).
by_grid : bool, default false
    By waves: few stars too are taken from a grid of images over the field, which pays where many fields follow.
bodies : integrator, optional
    Integrator of all other light of the scene, e.g. ``path``: its image through the same lens is added to the stars'.

``mi.render`` returns expected photo-electrons in the exposure (the camera's ``shutter_open`` to ``shutter_close``), the
bands of the ``star_field`` as channels, of the pixels of the film's crop; the film receives the sum of the bands as its
luminance, and each of several bands as a channel of its name. Truth is in ``integrator.traced`` for the last image and
in ``integrator.traced_by(sensor)`` for the last one of a sensor, where pixels count on the whole film. ``seed``
scrambles the Sobol points and is the seed of ``bodies``.

Derivatives (`dr.backward`, `dr.forward` of what ``mi.render(scene, params)`` returns) are those of
`render.tracing.gradient`, with respect to directions, rates and ``rotation`` of the
stars, and all numbers of the camera.

Shapes that stand between the sky and the lens hide stars, ray by ray (`render.plugins.occlusion`).

With ``bodies``, radiances in the scene count photons per s, mm^2 and sr in each band; a band's light is divided evenly
between its wavelength nodes, each of which is traced backwards by an equal number of the samples. Charge diffusion
and the camera's response are applied as to the stars.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from optics.errors import BackendError, ConfigError
from render.detector.diffusion import diffuse
from render.engine.jit import dr
from render.plugins.occlusion import SceneShade
from render.plugins.star_gradient import attached_image
from render.tracing.convergence import TOLERANCE
from render.tracing.tracer import TracedStars, Tracer

MOST_TRACERS = 8
"""Cameras (with a seed each) whose compiled lens is cached."""


def put_on_film(mi: Any, film: Any, image: Any, bands: tuple[str, ...]) -> None:
    """Put an image (h, w, b) on a film: luminance, weight, and bands as channels; evaluated when the film is read."""
    if "HDRFilm" not in type(film).__name__ + str(film.class_name()):
        raise ConfigError(f"star_tracer: a film of kind {film.class_name()}; an hdrfilm is needed")
    if not film.rfilter().is_box_filter():
        raise ConfigError(
            "star_tracer: the film's reconstruction filter would blur the pixel values of the detector; set "
            "'rfilter': {'type': 'box'}"
        )
    names = list(bands) if len(bands) > 1 else []
    channels = film.prepare(names)
    height, width, count = image.shape
    at = dr.arange(mi.UInt32, height * width * channels)
    pixel, channel = at // channels, at % channels
    total = dr.zeros(mi.Float, 1)
    for band in range(count):
        total = total + dr.gather(mi.Float, image.array, pixel * count + band)
    first = channels - len(names)
    value = dr.select(channel == first - 1, 1.0, total)
    if names:
        value = dr.select(
            channel < first,
            value,
            dr.gather(mi.Float, image.array, pixel * count + (channel - first), channel >= first),
        )
    block = mi.ImageBlock(mi.TensorXf(value, (height, width, channels)), film.crop_offset())
    film.put_block(block)


def define(mi: Any, emitter_class: Any, camera_class: Any) -> type:
    """The plugin class for Mitsuba's active variant."""

    class StarTracer(mi.AdjointIntegrator):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.sobol_log2_rays = int(props.get("sobol_log2_rays", 16))
            if not 6 <= self.sobol_log2_rays <= 26:
                raise ConfigError(f"star_tracer: sobol_log2_rays = {self.sobol_log2_rays} is outside 6 ... 26")
            self.tolerance = float(props.get("tolerance", TOLERANCE))
            if not self.tolerance > 0.0:
                raise ConfigError(f"star_tracer: tolerance = {self.tolerance:g}; it must be positive")
            self.by_grid = bool(props.get("by_grid", False))
            self.bodies = props.get("bodies")
            if self.bodies is not None and (mi.is_spectral or mi.is_rgb):
                raise BackendError(
                    f"star_tracer: bodies cannot be rendered in the variant {mi.variant()}; use llvm_ad_mono or "
                    "cuda_ad_mono, one band at a time"
                )
            # a namespace: Dr.Jit walks through records that are attributes at every mi.render, 1 ms for a lens
            self._last = SimpleNamespace(traced=None, by_sensor={})
            self._seed = 0
            self._tracers: dict[tuple[int, int], Tracer] = {}

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            camera, field = self._contents(scene, sensor)
            self._seed = int(np.asarray(seed).item())  # of an integer or a Dr.Jit array of size one
            traced = self._last.traced = self._trace(scene, camera, field)
            self._last.by_sensor[id(camera)] = (camera, traced)
            film = camera.film()
            (left, top), (width, height) = film.crop_offset(), film.crop_size()
            electrons = traced.electrons[top : top + height, left : left + width]
            if self.bodies is not None:
                electrons = electrons + self._bodies(scene, camera, field.stars.wavelength_nm, spp)
            image = mi.TensorXf(np.ascontiguousarray(electrons))
            put_on_film(mi, film, image, field.stars.band)
            return image

        def render_forward(self, scene: Any, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> Any:
            """Derivative of the image along the gradients of the parameters."""
            with dr.resume_grad():
                image = self._attached(scene, sensor)
                dr.forward_to(image)
                return dr.grad(image)

        def render_backward(
            self, scene: Any, params: Any, grad_in: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0
        ) -> None:
            """Gradients of the parameters from that of the image."""
            with dr.resume_grad():
                image = self._attached(scene, sensor)
                dr.set_grad(image, grad_in)
                dr.enqueue(dr.ADMode.Backward, image)
                dr.traverse(dr.ADMode.Backward)

        def _attached(self, scene: Any, sensor: Any) -> Any:
            """The image with derivatives."""
            camera, field = self._contents(scene, sensor)
            motion = camera.star_motion
            if self.bodies is not None or (motion is not None and motion.path is not None):
                what = "bodies" if self.bodies is not None else "stars under a rolling shutter"
                raise ConfigError(f"star_tracer: derivatives with respect to {what} are not available")
            traced = self._last.by_sensor.get(id(camera))
            if traced is not None and traced[1].truth.electrons_hidden.any():
                raise ConfigError("star_tracer: derivatives of stars partly hidden by bodies are not available")
            return attached_image(mi, self.tracer(camera, self._seed), camera, field)

        def traced_by(self, sensor: Any) -> TracedStars:
            """Traced stars of the last image of a sensor."""
            traced: TracedStars = self._last.by_sensor[id(sensor)][1]
            return traced

        @property
        def traced(self) -> TracedStars | None:
            """Traced stars of the last image."""
            traced: TracedStars | None = self._last.traced
            return traced

        def _contents(self, scene: Any, sensor: Any) -> tuple[Any, Any]:
            """Camera and star field of a scene."""
            camera = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            if not isinstance(camera, camera_class):
                raise ConfigError(f"star_tracer: the sensor is a {type(camera).__name__}; a lens_camera is needed")
            fields = [emitter for emitter in scene.emitters() if isinstance(emitter, emitter_class)]
            if len(fields) != 1:
                raise ConfigError(
                    f"star_tracer: the scene holds {len(fields)} star_field emitters; exactly one is needed"
                )
            return camera, fields[0]

        def tracer(self, camera: Any, seed: int) -> Tracer:
            """Compiled lens and plans of a camera, for all its attitudes."""
            key = (id(camera.optics), seed)
            tracer = self._tracers.get(key)
            if tracer is None or tracer.camera is not camera.optics:
                while len(self._tracers) >= MOST_TRACERS:
                    self._tracers.pop(next(iter(self._tracers)))
                tracer = self._tracers[key] = Tracer(
                    camera.optics,
                    sobol_log2_rays=self.sobol_log2_rays,
                    sobol_seed=seed,
                    tolerance=self.tolerance,
                    by_grid=self.by_grid,
                )
            return tracer

        def _trace(self, scene: Any, camera: Any, field: Any) -> TracedStars:
            """Stars through the lens, without the light that bodies hide."""
            stars, motion = field.turned_stars, camera.star_motion
            attitude = camera.camera.rotation_cam_from_world
            shade = None
            if scene.shapes():
                middle = attitude if motion is None else motion.rotation_mid
                shade = SceneShade(scene, stars.direction, middle, camera.position, camera.scene_unit_mm)
            return self.tracer(camera, self._seed).render(
                stars,
                exposure_s=camera.exposure_s,
                rotation_cam_from_world=attitude if motion is None else None,
                motion=motion,
                shade=shade,
            )

        def _bodies(self, scene: Any, camera: Any, wavelength_nm: FloatArray, spp: int) -> NDArray[np.float32]:
            """Electrons (h, w, b) of everything but the stars, on the film's crop."""
            optics, before = camera.optics, camera.wavelength_nm
            bands, nodes = wavelength_nm.shape
            samples = -(-(spp or camera.sampler().sample_count()) // nodes)
            light = optics.response_at(wavelength_nm) * (optics.pixel_pitch_mm**2 * camera.exposure_s / nodes)
            layers = []
            try:
                for band, node in np.ndindex(bands, nodes):
                    camera.wavelength_nm = float(wavelength_nm[band, node])
                    seed = (self._seed * bands * nodes + band * nodes + node) % 2**32
                    irradiance = self.bodies.render(scene, sensor=camera, seed=seed, spp=samples)
                    layers.append(np.array(irradiance, dtype=np.float64)[..., 0] * light[band, node])
            finally:
                camera.wavelength_nm = before
            image = np.stack(layers, axis=-1).reshape(*layers[0].shape, bands, nodes).sum(-1)
            diffused = [diffuse(image[..., band], optics.blur_px) for band in range(bands)]
            return np.stack(diffused, axis=-1).astype(np.float32)

        def sample(self, scene: Any, sensor: Any, sampler: Any, block: Any, sample_scale: Any) -> None:
            raise NotImplementedError("star_tracer renders whole images; call mi.render")

        def to_string(self) -> str:
            return f"StarTracer[sobol_log2_rays={self.sobol_log2_rays}]"

    return StarTracer
