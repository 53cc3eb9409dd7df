r"""Direct and scattered light of a baffle at the lens, by Mitsuba's ``path`` integrator backwards from the entrance.

Points of the entrance and directions into the baffle are drawn. The radiance L along each is that of the stock ``path``
integrator, which samples the Sun (a directional emitter) at every surface it meets, so that its cost does not depend on
the amount of light. The lens's own point-source transmittance weights the directions:

.. math:: PST_{walls} = \frac{1}{A} \int dA \int L(x, \omega)\, PST_{lens}(\theta_\omega)\, d\omega

for a source of unit irradiance through a plane normal to its light. The direct light is PST_lens times the lit part of
the entrance. Edges of vanes are too thin for random hits: each is a Lambertian cylinder of the edge's radius in closed
form, its shadows by rays. Light returned by the lens into the baffle and diffraction at edges are neglected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import perpendicular
from optics.rays.pupil_sampling import gauss_disk
from render.baffle.black_coating import BlackCoating
from render.baffle.mesh import Mesh
from render.baffle.vaned_baffle import VanedBaffle, vaned_mesh
from render.engine import Engine
from render.engine.triangle_mesh import mitsuba_mesh
from render.engine.upload import uploaded

BOUNCES = 8
"""Surfaces that light meets at most."""
LOG2_PASS, MOST_PASSES, FEWEST_PASSES = 15, 64, 4
"""Rays of a pass as a power of two, and numbers of passes."""
KNOTS = 181
EDGE_POINTS, ENTRANCE_RINGS, ENTRANCE_ARMS = 144, 3, 12
LIFT_MM = 0.02
"""Distance of the start of rays from their surface; vertices are float32."""
DIRECT_RINGS, DIRECT_ARMS = 24, 96
FLOOR = 1e-30

LensWeight = Callable[[FloatArray], FloatArray]
"""PST of the bare lens at angles [rad] from the boresight."""


def lens_weight(angle_deg: ArrayLike, value: ArrayLike) -> LensWeight:
    """PST of a lens as a function, from values at angles, in the logarithms of both."""
    angle = np.log(np.radians(np.asarray(angle_deg, dtype=np.float64)))
    log = np.log(np.maximum(np.asarray(value, dtype=np.float64), FLOOR))

    def at(theta: FloatArray) -> FloatArray:
        return np.asarray(np.exp(np.interp(np.log(np.maximum(theta, 1e-9)), angle, log)))

    return at


def cylinder_intensity(
    to_source: FloatArray, to_eye: FloatArray, along: FloatArray, radius_mm: float, reflectance: float
) -> FloatArray:
    """Radiant intensity per length [W sr^-1 mm^-1] of a thin Lambertian cylinder in light of 1 W / mm^2.

    rho r / pi sin(s) sin(e) [(pi - a) cos a + sin a] / 2 with the angles s, e of source and eye to the axis and a
    between their projections on the plane normal to it; arguments are unit vectors (..., 3).
    """
    planes = [v - along * (v * along).sum(axis=-1, keepdims=True) for v in (to_source, to_eye)]
    sines = [np.linalg.norm(v, axis=-1) for v in planes]
    cosine = (planes[0] * planes[1]).sum(axis=-1) / np.maximum(sines[0] * sines[1], 1e-12)
    a = np.arccos(np.clip(cosine, -1.0, 1.0))
    phase = 0.5 * ((np.pi - a) * np.cos(a) + np.sin(a))
    return np.asarray(reflectance * radius_mm / np.pi * sines[0] * sines[1] * phase)


@dataclass(frozen=True, slots=True, kw_only=True)
class BaffleLight:
    """PST of a source behind a baffle, by cause."""

    direct: float  # Fraction of the entrance in the light of the source
    walls: float  # PST by walls and vanes
    walls_error: float  # Standard error
    edges: float  # PST by the edges of vanes
    edges_error: float  # As if its points were random
    rays: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorstPaths:
    """Origin on the baffle of the light that passes the lens: first surfaces visible from the lens."""

    point_mm: FloatArray  # (n, 3)
    entrance_mm: FloatArray  # (n, 3)
    fraction: FloatArray  # (n,) Of the PST of the walls


class BaffleScene:
    """A baffle ready to be lit, in its frame; `DomainError` if it cuts the beams of the field (half angle)."""

    def __init__(
        self, parts: VanedBaffle | Mesh, coating: BlackCoating, *, entrance_mm: float, field_deg: float, seed: int = 0
    ) -> None:
        mi = self._mi = Engine.active().mitsuba
        self.baffle = parts if isinstance(parts, VanedBaffle) else None
        self.mesh = vaned_mesh(parts) if isinstance(parts, VanedBaffle) else parts
        self.coating, self.entrance_mm, self.seed = coating, entrance_mm, seed
        shape = mitsuba_mesh("baffle", self.mesh.vertex_mm, self.mesh.face, coating.bsdf())
        sun = {"type": "directional", "direction": [0.0, 0.0, -1.0], "irradiance": 1.0}
        self._scene = mi.load_dict({"type": "scene", "baffle": shape, "sun": sun})
        self._parameters = mi.traverse(self._scene)
        self._integrator = mi.load_dict({"type": "path", "max_depth": BOUNCES + 1, "rr_depth": BOUNCES + 1})
        self._filled = self._filled_fraction()
        self._check_field(field_deg)

    def _ray(self, origin: FloatArray, direction: FloatArray) -> Any:
        mi = self._mi
        o, d = (np.broadcast_to(v, np.broadcast_shapes(origin.shape, direction.shape)) for v in (origin, direction))
        return mi.Ray3f(
            mi.Point3f(*(uploaded(mi.Float, v) for v in o.T)), mi.Vector3f(*(uploaded(mi.Float, v) for v in d.T))
        )

    def blocked(self, origin: FloatArray, direction: FloatArray, far_mm: FloatArray | None = None) -> Any:
        """Whether rays (n, 3) along unit vectors meet the baffle, within lengths (n,)."""
        ray = self._ray(origin, direction)
        if far_mm is not None:
            ray.maxt = uploaded(self._mi.Float, far_mm)
        return np.array(self._scene.ray_test(ray), dtype=bool)

    def _disk(self, rings: int, arms: int) -> tuple[FloatArray, FloatArray]:
        """Points of the entrance (n, 3) and their weights, of sum 1."""
        samples = gauss_disk(rings, arms)
        x, y = self.entrance_mm * samples.x, self.entrance_mm * samples.y
        return np.stack([x, y, np.full(len(x), LIFT_MM)], 1), samples.weight

    def _check_field(self, field_deg: float) -> None:
        azimuth = 2.0 * np.pi * np.arange(48) / 48
        samples = gauss_disk(4, 48)
        scale = 0.999 * self.entrance_mm / np.hypot(samples.x, samples.y).max()
        origin = np.stack([scale * samples.x, scale * samples.y, np.full(len(samples.x), LIFT_MM)], axis=1)
        for theta in np.radians(field_deg) * np.array([0.0, 0.5, 1.0]):
            for phi in azimuth if theta else azimuth[:1]:
                if self.blocked(origin, _vector(theta, phi)[None]).any():
                    raise DomainError(
                        f"the baffle cuts the beam of the field at {np.degrees(theta):.3g} deg; its vanes must leave "
                        f"the entrance of radius {self.entrance_mm:.4g} mm free up to {field_deg:.3g} deg"
                    )

    def _filled_fraction(self) -> FloatArray:
        """Fraction of the directions in each of KNOTS - 1 bins of the angle that meet the baffle."""
        rng = np.random.default_rng(self.seed)
        theta = 0.5 * np.pi * (np.repeat(np.arange(KNOTS - 1), 200) + rng.random(200 * (KNOTS - 1))) / (KNOTS - 1)
        phi, r, azimuth = (rng.random(theta.size) for _ in range(3))
        direction = _vector(theta, 2.0 * np.pi * phi)
        met = self.blocked(self._entrance(self.entrance_mm * np.sqrt(r), 2.0 * np.pi * azimuth), direction)
        return np.asarray(met.reshape(KNOTS - 1, -1).mean(axis=1))

    @staticmethod
    def _entrance(radius_mm: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Points (n, 3) of the entrance."""
        return np.stack(
            [radius_mm * np.cos(azimuth), radius_mm * np.sin(azimuth), np.full(len(azimuth), LIFT_MM)], axis=1
        )

    def light(
        self, v_source: ArrayLike, weight: LensWeight, *, error: float = 0.05, number: int = 0, least: float = 0.0
    ) -> BaffleLight:
        """PST of a distant point source at a unit vector (3,) in cam, through a lens of PST ``weight`` (`lens_weight`).

        Ends at a relative standard error of the walls, or an absolute one (``least``); ``number`` seeds the rays.
        """
        source = np.asarray(v_source, dtype=np.float64)
        start, area = self._disk(DIRECT_RINGS, DIRECT_ARMS)
        direct = float((~self.blocked(start, source[None])) @ area) if source[2] > 0.0 else 0.0
        self._point_sun(source)
        means = []
        for pass_number in range(MOST_PASSES):
            origin, direction, factor = self._draw(weight, (number, pass_number))
            means.append(float((self._radiance(origin, direction, (number, pass_number)) * factor).mean()))
            if len(means) >= FEWEST_PASSES:
                spread = float(np.std(means, ddof=1) / math.sqrt(len(means)))
                if spread <= max(error * float(np.mean(means)), least):
                    break
        edges, edges_error = self._edges(source, weight)
        return BaffleLight(
            direct=direct,
            walls=float(np.mean(means)),
            walls_error=spread,
            edges=edges,
            edges_error=edges_error,
            rays=len(means) << LOG2_PASS,
        )

    def worst_paths(self, v_source: ArrayLike, weight: LensWeight, count: int = 40) -> WorstPaths:
        """The rays of a pass that carry most of the light."""
        self._point_sun(np.asarray(v_source, dtype=np.float64))
        origin, direction, factor = self._draw(weight, (0, MOST_PASSES))
        light = self._radiance(origin, direction, (0, MOST_PASSES)) * factor
        best = np.argsort(-light)[:count]
        best = best[light[best] > 0.0]
        hit = self._scene.ray_intersect_preliminary(self._ray(origin[best], direction[best]))
        distance = np.array(hit.t, dtype=np.float64)[:, None] if len(best) else np.zeros((0, 1))
        return WorstPaths(
            point_mm=origin[best] + distance * direction[best],
            entrance_mm=origin[best],
            fraction=light[best] / max(float(light.sum()), FLOOR),
        )

    def _point_sun(self, source: FloatArray) -> None:
        mi, v = self._mi, -source / np.linalg.norm(source)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([*perpendicular(v), v], axis=1)
        self._parameters["sun.to_world"] = mi.Transform4f(matrix)
        self._parameters.update()

    def _draw(self, weight: LensWeight, number: tuple[int, int]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Origins, directions and their weights: PST of the lens over the density of the draw."""
        stream = np.random.default_rng([self.seed, 1, *number])
        u = qmc.Sobol(4, scramble=True, rng=stream).random_base2(LOG2_PASS)
        edge = np.linspace(0.0, 0.5 * np.pi, KNOTS)
        middle = 0.5 * (edge[1:] + edge[:-1])
        solid = np.cos(edge[:-1]) - np.cos(edge[1:])
        visible = solid * (self._filled + 1e-3)
        weighted = weight(middle) * visible
        probability = 0.5 * weighted / weighted.sum() + 0.5 * visible / visible.sum()
        cumulative = np.append(0.0, np.cumsum(probability))
        cumulative[-1] = 1.0
        row = np.clip(np.searchsorted(cumulative, u[:, 0], side="right") - 1, 0, KNOTS - 2)
        inside = (u[:, 0] - cumulative[row]) / probability[row]
        cosine = np.cos(edge[row]) - inside * solid[row]
        theta = np.arccos(np.clip(cosine, 0.0, 1.0))
        density = probability[row] / (2.0 * np.pi * solid[row])
        origin = self._entrance(self.entrance_mm * np.sqrt(u[:, 2]), 2.0 * np.pi * u[:, 3])
        return origin, _vector(theta, 2.0 * np.pi * u[:, 1]), weight(theta) / density

    def _radiance(self, origin: FloatArray, direction: FloatArray, number: tuple[int, int]) -> FloatArray:
        mi = self._mi
        sampler = mi.load_dict({"type": "independent"})
        seed = int(np.random.default_rng([self.seed, 2, *number]).integers(2**31))
        sampler.seed(seed, len(origin))
        ray = mi.RayDifferential3f(self._ray(origin, direction))
        value, valid, _ = self._integrator.sample(self._scene, sampler, ray)
        light = np.array(value, dtype=np.float64).reshape(-1, len(origin))[0]
        return np.where(np.array(valid, dtype=bool) & np.isfinite(light), light, 0.0)

    def _edges(self, source: FloatArray, weight: LensWeight) -> tuple[float, float]:
        """PST of the edges of all vanes, and its error; a mesh of the user contains its edges."""
        baffle, reflectance = self.baffle, self.coating.diffuse + self.coating.specular
        if baffle is None or baffle.edge_mm == 0.0 or reflectance == 0.0:
            return 0.0, 0.0
        phi = 2.0 * np.pi * (np.arange(EDGE_POINTS) + 0.5) / EDGE_POINTS
        entrance, area = self._disk(ENTRANCE_RINGS, ENTRANCE_ARMS)
        total, square = 0.0, 0.0
        lift = max(baffle.edge_mm, LIFT_MM)
        for z, radius in zip(baffle.vane_z_mm.tolist(), baffle.vane_mm.tolist(), strict=True):
            if radius >= baffle.tube_mm:
                continue
            around = np.stack([np.cos(phi), np.sin(phi), 0.0 * phi], axis=1)
            point = (radius - lift) * around + np.array([0.0, 0.0, z])
            lit = ~self.blocked(point, source[None])
            if not lit.any():
                continue
            along = np.stack([-np.sin(phi), np.cos(phi), 0.0 * phi], axis=1)[lit]
            point = point[lit]
            towards = entrance[None] - point[:, None]
            distance = np.linalg.norm(towards, axis=-1)
            towards = towards / distance[..., None]
            visible = ~self.blocked(
                np.repeat(point, len(entrance), axis=0), towards.reshape(-1, 3), 0.999 * distance.ravel()
            ).reshape(distance.shape)
            intensity = cylinder_intensity(source, towards, along[:, None], baffle.edge_mm, reflectance)
            theta = np.arccos(np.clip(-towards[..., 2], 0.0, 1.0))
            step = 2.0 * np.pi * radius / EDGE_POINTS
            part = (np.where(visible, intensity, 0.0) / distance**2 * weight(theta)) @ area * step
            total, square = total + float(part.sum()), square + float((part**2).sum())
        return total, math.sqrt(square)


def _vector(theta: FloatArray, phi: FloatArray) -> FloatArray:
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
