"""Mitsuba emitter ``star_field``: point sources at infinity, with float64 directions and light per wavelength node.

Properties
----------
direction : TensorXf64 (n, 3)
    Unit vectors towards the stars.
wavelength_nm : TensorXf64 (b, k)
    Wavelength nodes of each band.
photon_rate : TensorXf64 (n, b, k)
    Photons per second and mm^2 per node, filter included (`render.records.StarField`).
band : str, optional
    Names of the bands, separated by commas.
filename : str
    In place of these four, a file that `save_star_field` wrote; for scenes in XML.
rotation : TensorXf64 (3, 3) or str of nine numbers, optional
    Turns the stars in the scene, ``v_world = rotation @ direction``: with world the frame of a spacecraft and its
    camera, its attitude. Left out, directions are in the world frame.
collimation : str, optional
    Handle of the error of a collimator (`share_collimation`), or a file of one (`optics.record_files`).
sampling_weight : float, default 1e-30
    How often stock integrators pick the stars rather than another emitter, against 1 of these. By default never, so
    that the stars add no noise to bodies that the Sun or a lamp lights; where they are the only light they are picked.
scene_centre, scene_radius : point, float
    Sphere that holds the scene, where ``ptracer`` starts its rays; without it the stars give it no light, which a
    warning says.

Each tensor may have a leading axis of size one: Mitsuba's property parser takes a tensor whose first axis has three
entries for a colour, and nanobind says so on the error stream before it falls back to the tensor. Directions,
wavelengths, rates and ``rotation`` are parameters of the scene (``mi.traverse``), without that axis. Directions that
are set there are divided by their lengths, and their gradients are tangential: an optimiser may take any step.

``star_tracer`` images the stars themselves. To stock integrators (``path``, ``volpath``, ``prb``, ``ptracer``) the
field is a light from discrete directions: it lights bodies, and is invisible itself, as no ray meets it by chance. In
variants without spectra its light is grey, all photons of all bands (an albedo is the reflected fraction of these); in
spectral ones the light of a node is spread evenly over its part of the band, per nm.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.light.collimation import Collimation
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.plugins.handles import Handles, resolved, rotation_of
from render.records import StarField

NEVER = 1e-30
"""Sampling weight that any other emitter's outweighs; of 0 alone Mitsuba makes no distribution."""
NO_RADIUS = "ptracer starts rays around the scene; give scene_centre and scene_radius of a sphere that holds it"
FAR = 1e10
"""Distance in scene units at which shadow rays may end."""
NARROWEST_NM = 10.0
"""Width of a band of one node."""
TENSORS = (("direction", 2), ("wavelength_nm", 2), ("photon_rate", 3))


COLLIMATIONS: Handles[Collimation] = Handles(Collimation, "collimation")


def share_collimation(collimation: Collimation) -> str:
    """Handle by which ``load_dict`` takes the error of a collimator."""
    return COLLIMATIONS.share(collimation)


def save_star_field(path: str | Path, stars: StarField) -> None:
    """Write a file (.npz) for the property ``filename``."""
    arrays = {name: getattr(stars, name) for name, _ in TENSORS}
    np.savez(path, band=np.array(stars.band), **arrays)


def _arrays(props: Any) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Directions, wavelengths, rates and names of bands."""
    if "filename" in props:
        path = resolved(str(props["filename"]))
        try:
            with np.load(path) as file:
                arrays = {name: file[name] for name, _ in TENSORS}
                return arrays, tuple(str(name) for name in file["band"])
        except (OSError, KeyError, ValueError) as error:
            raise ConfigError(f"star_field: {path} is not a file that save_star_field wrote ({error})") from None
    arrays = {}
    for name, axes in TENSORS:
        if name not in props:
            raise ConfigError(f"star_field: property {name!r} is missing (a TensorXf64)")
        array = np.array(props[name], dtype=float)
        arrays[name] = array[0] if array.ndim == axes + 1 and array.shape[0] == 1 else array
    return arrays, tuple(str(props["band"]).split(",")) if props.get("band", "") else ()


def _of_unit_length(direction: FloatArray) -> FloatArray:
    """Directions (n, 3) over their lengths; rounding, and what has no length, stay as they are.

    Lengths right to 1e-9, which `StarField` takes, would still be 3e-4 of a derivative by differences of 3e-7.
    """
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.divide(direction, length, out=direction.copy(), where=(np.abs(length - 1.0) > 1e-14) & (length > 0.0))


def _cells(wavelength_nm: FloatArray) -> FloatArray:
    """Interval (low, high) of the band around every node (b, k), (b, k, 2) [nm]."""
    nodes = np.sort(wavelength_nm, axis=1)
    if nodes.shape[1] == 1:
        half = np.full_like(nodes, 0.5 * NARROWEST_NM)
        return np.stack([nodes - half, nodes + half], axis=-1)
    middle = 0.5 * (nodes[:, 1:] + nodes[:, :-1])
    first, last = 2.0 * nodes[:, :1] - middle[:, :1], 2.0 * nodes[:, -1:] - middle[:, -1:]
    edges = np.concatenate([first, middle, last], axis=1)
    order = np.argsort(np.argsort(wavelength_nm, axis=1), axis=1)
    return np.stack([np.take_along_axis(edges, order + side, 1) for side in (0, 1)], axis=-1)


class _DirectionalLight:
    """The stars as a light of stock integrators, in Mitsuba's float32."""

    def __init__(self, mi: Any, stars: StarField, rotation: FloatArray | None) -> None:
        self.mi, self.bands = mi, stars.wavelength_nm.size
        toward = stars.direction if rotation is None else stars.direction @ rotation.T
        self.toward = [uploaded(mi.Float, toward[:, axis]) for axis in range(3)]
        photons = stars.photon_rate.reshape(len(stars), -1)
        self.total = mi.Float(photons.sum(1))
        self.distribution = mi.DiscreteDistribution(self.total)
        cells = _cells(stars.wavelength_nm).reshape(-1, 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            density = np.nan_to_num(photons / (cells[:, 1] - cells[:, 0]), posinf=0.0)
        self.low, self.high = (uploaded(mi.Float, cells[:, side]) for side in (0, 1))
        self.density = uploaded(mi.Float, density)

    def direction(self, star: Any, active: Any) -> Any:
        """Towards a star."""
        gather = (dr.gather(self.mi.Float, component, star, active) for component in self.toward)
        return dr.normalize(self.mi.Vector3f(*gather))

    def irradiance(self, star: Any, wavelengths: Any, active: Any) -> Any:
        """Photons per second and mm^2 of a star, per nm in spectral variants."""
        mi = self.mi
        if not mi.is_spectral:
            value = mi.UnpolarizedSpectrum(dr.gather(mi.Float, self.total, star, active))
        else:
            value = dr.zeros(mi.UnpolarizedSpectrum)
            for node in range(self.bands):
                index = mi.UInt32(node)
                low, high = (dr.gather(mi.Float, edge, index) for edge in (self.low, self.high))
                inside = (wavelengths >= low) & (wavelengths < high)
                density = dr.gather(mi.Float, self.density, star * self.bands + node, active)
                value += dr.select(inside, mi.UnpolarizedSpectrum(density), 0.0)
        return mi.depolarizer(value) if mi.is_polarized else value


def define(mi: Any) -> type:
    """The plugin class for Mitsuba's active variant."""

    class StarFieldEmitter(mi.Emitter):
        def __init__(self, props: Any) -> None:
            if "sampling_weight" not in props:
                props["sampling_weight"] = NEVER
            super().__init__(props)
            arrays, self._names = _arrays(props)
            self.direction, self.wavelength_nm, self.photon_rate = (mi.TensorXf64(v) for v in arrays.values())
            rotation = rotation_of(props, "star_field")
            self.turned = rotation is not None
            self.rotation = mi.TensorXf64(np.eye(3) if rotation is None else rotation)
            handle = str(props.get("collimation", ""))
            self.collimation = COLLIMATIONS.named(handle) if handle else None
            self._centre = mi.ScalarPoint3f(props.get("scene_centre", mi.ScalarPoint3f(0.0)))
            self._radius = float(props.get("scene_radius", 0.0))
            self._warned = False
            self._moved = False
            self._stars: StarField | None = None
            self._light: _DirectionalLight | None = None
            self.m_needs_sample_3 = True
            self.m_flags = mi.EmitterFlags.DeltaDirection | mi.EmitterFlags.Infinite
            _ = self.stars  # refuses wrong input now

        @property
        def stars(self) -> StarField:
            """The present stars, before ``rotation``."""
            if self._stars is None:
                arrays = {name: dr.detach(getattr(self, name)).numpy() for name, _ in TENSORS}
                bands = arrays["wavelength_nm"].shape[0]
                names = self._names or tuple(f"band {i}" for i in range(bands))
                if self._moved:
                    arrays["direction"] = _of_unit_length(arrays["direction"])
                self._stars = StarField(band=names, collimation=self.collimation, **arrays)
            return self._stars

        @property
        def turned_stars(self) -> StarField:
            """The present stars, in the scene's world."""
            rotation = self.world_from_stars
            if rotation is None:
                return self.stars
            direction = self.stars.direction @ rotation.T
            return replace(self.stars, direction=direction / np.linalg.norm(direction, axis=1, keepdims=True))

        @property
        def world_from_stars(self) -> FloatArray | None:
            """``rotation`` (3, 3); None without."""
            return np.array(dr.detach(self.rotation).numpy(), float).reshape(3, 3) if self.turned else None

        def traverse(self, callback: Any) -> None:
            for name in ("direction", "wavelength_nm", "photon_rate", "rotation"):
                callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            self.turned |= not keys or "rotation" in keys
            self._moved |= not keys or "direction" in keys
            if self._names and len(self._names) != self.wavelength_nm.shape[0]:
                self._names = ()
            self._stars = self._light = None

        def _as_light(self) -> _DirectionalLight:
            if self._light is None:
                self._light = _DirectionalLight(mi, self.stars, self.world_from_stars)
            return self._light

        def eval(self, si: Any, active: Any = True) -> Any:
            return dr.zeros(mi.Spectrum)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            light = self._as_light()
            star, probability = light.distribution.sample_pmf(sample.x, active)
            ds = dr.zeros(mi.DirectionSample3f, dr.width(sample))
            ds.d = light.direction(star, active)
            ds.dist = mi.Float(FAR)
            ds.p, ds.n = it.p + ds.d * FAR, mi.Normal3f(-ds.d)
            ds.uv = mi.Point2f(mi.Float(star), 0.0)  # number of the star, for `eval_direction`
            ds.time, ds.pdf, ds.delta = it.time, probability, mi.Mask(True)
            ds.emitter = mi.EmitterPtr(self)
            lit = active & (probability > 0.0)
            return ds, (light.irradiance(star, it.wavelengths, lit) / probability) & lit

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return self._as_light().irradiance(mi.UInt32(ds.uv.x), it.wavelengths, active) & active

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            return dr.zeros(mi.PositionSample3f, dr.width(sample)), mi.Float(0.0)

        def pdf_position(self, ps: Any, active: Any = True) -> Any:
            return mi.Float(0.0)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """Ray from a disk across a star's direction that covers the scene; weight for ``ptracer``."""
            if not (self._radius > 0.0 or self._warned):  # no error: other scenes trace this field
                mi.Log(mi.LogLevel.Warn, f"star_field '{self.id()}' adds no light: {NO_RADIUS}")
                self._warned = True
            light = self._as_light()
            star, probability = light.distribution.sample_pmf(sample3.x, active)
            toward = light.direction(star, active)
            wavelengths, weight = self.sample_wavelengths(None, sample1)
            across = mi.warp.square_to_uniform_disk_concentric(sample2)
            offset = mi.Frame3f(toward).to_world(mi.Vector3f(across.x, across.y, 1.0))
            origin = mi.Point3f(self._centre) + offset * self._radius
            lit = active & (probability > 0.0)
            power = light.irradiance(star, wavelengths, lit) * (math.pi * self._radius**2) / probability
            return mi.Ray3f(origin, -toward, time, wavelengths), (weight * power) & lit

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            if not mi.is_spectral:
                return mi.Color0f(), mi.Spectrum(1.0)
            wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(sample))
            return wavelengths, mi.Spectrum(weight)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def to_string(self) -> str:
            return f"StarField[stars={len(self.stars)}, bands={', '.join(self.stars.band)}]"

    return StarFieldEmitter
