"""A Moon for pictures: maria and four rayed craters in their places, thousands of random craters, lunar photometry.

Heights follow the crater shapes of Pike (1977, in Impact and Explosion Cratering, p. 489): depth 0.196 D^1.01 and rim
0.036 D^1.014 below 15 km diameter, depth 1.044 D^0.301 and rim 0.236 D^0.399 above (km). The surface scatters after
Lommel and Seeliger; its dependence on the phase angle is chosen such that the whole disk follows Allen (Astrophysical
Quantities, 1973, sec. 66): 0.026 mag/deg + 4e-9 mag/deg^4. Earthshine: an Earth of -17 mag seen from the Moon.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from render.bodies.lunar_map import HIGHLAND, MARE, MARIA, RAYED
from render.engine import Engine
from render.plugins.lunar_surface import lommel_seeliger_phase

__all__ = ["MOON_RADIUS_KM", "moon_scene"]

MOON_RADIUS_KM = 1737.4
EARTHSHINE = 10 ** (-0.4 * (26.75 - 17.0))
GRID, REACH_DEG = 1300, 105.0
CRATERS, SMALLEST_KM, LARGEST_KM = 6000, 11.0, 230.0


def on_moon(longitude_deg: Any, latitude_deg: Any) -> np.ndarray:
    """Unit vectors: x to lunar east (right in the northern sky), y north, z towards the Earth."""
    a, b = np.radians(longitude_deg), np.radians(latitude_deg)
    return np.stack([np.cos(b) * np.sin(a), np.sin(b) * np.ones_like(a), np.cos(b) * np.cos(a)], axis=-1)


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (n, 3) of a cap around the sub-Earth point, equidistant in angle, and triangles (m, 3)."""
    side = np.linspace(-1, 1, GRID)
    x, y = (v.ravel() for v in np.meshgrid(side, side))
    angle, azimuth = np.radians(REACH_DEG) * np.hypot(x, y), np.arctan2(y, x)
    v = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)
    corner = (np.arange(GRID - 1)[:, None] * GRID + np.arange(GRID - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + GRID], axis=1)
    upper = np.stack([corner + 1, corner + GRID + 1, corner + GRID], axis=1)
    return v, np.concatenate([lower, upper])


def noise(v: np.ndarray, rng: np.random.Generator, frequency: float, waves: int = 40) -> np.ndarray:
    """Smooth random field of unit variance with features of about 1/frequency rad."""
    k = rng.normal(size=(waves, 3)).astype(np.float32) * frequency
    phase = rng.uniform(0, 2 * np.pi, waves).astype(np.float32)
    return np.sqrt(2 / waves) * np.cos(v.astype(np.float32) @ k.T + phase).sum(1)


def maria(v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """How much of each point is mare, 0 to 1."""
    edge = 0.18 * noise(v, rng, 7.0) + 0.14 * noise(v, rng, 17.0) + 0.09 * noise(v, rng, 45.0)
    depth = np.full(len(v), -np.inf)
    for longitude, latitude, radius in MARIA:
        distance = np.arccos(np.clip(v @ on_moon(longitude, latitude), -1, 1)) * MOON_RADIUS_KM
        depth = np.maximum(depth, 1.0 - distance / radius)
    return 1.0 / (1.0 + np.exp(-(depth + edge) / 0.05))


def crater_height(s: np.ndarray, diameter_km: float) -> np.ndarray:
    """Height [km] at s radii from the centre."""
    if diameter_km < 15:
        depth, rim = 0.196 * diameter_km**1.01, 0.036 * diameter_km**1.014
    else:
        depth, rim = 1.044 * diameter_km**0.301, 0.236 * diameter_km**0.399
    floor = 0.0 if diameter_km < 15 else min(0.75, 0.25 + diameter_km / 200)
    bowl = np.clip((s**2 - floor**2) / (1 - floor**2), 0, 1)
    inside = rim - depth * (1 - bowl)
    if diameter_km > 30:
        inside = inside + 0.35 * depth * np.exp(-((s / 0.13) ** 2))
    return np.where(s < 1, inside, rim * np.maximum(s, 1.0) ** -3.5 * np.clip(2.5 - s, 0, 1))


def terrain(v: np.ndarray, mare: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Height [km] and albedo of every point."""
    height = 0.5 * noise(v, rng, 8.0) * (1 - mare) - 1.2 * mare
    for frequency in (60.0, 150.0):
        height += 5.0 / frequency * noise(v, rng, frequency) * (1 - 0.7 * mare)
    albedo = HIGHLAND + (MARE - HIGHLAND) * mare
    albedo *= 1 + 0.07 * noise(v, rng, 12.0) + 0.05 * noise(v, rng, 45.0)
    tree, mare_of = cKDTree(v), mare
    part = rng.uniform(size=CRATERS)
    diameters = SMALLEST_KM * (1 - part * (1 - (SMALLEST_KM / LARGEST_KM) ** 1.8)) ** (-1 / 1.8)
    centres = rng.normal(size=(CRATERS, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    rayed = [(on_moon(lon, lat), size) for lon, lat, size, _ in RAYED]
    for centre, diameter in [*zip(centres, np.sort(diameters)[::-1], strict=True), *rayed]:
        near = np.array(tree.query_ball_point(centre, 1.25 * diameter / MOON_RADIUS_KM), int)
        young = any(centre is c for c, _ in rayed)
        if not len(near) or (not young and rng.random() < 0.93 * mare_of[near].mean()):
            continue
        s = np.arccos(np.clip(v[near] @ centre, -1, 1)) * MOON_RADIUS_KM / (0.5 * diameter)
        worn = 1.0 if young else rng.uniform(0.35, 1.0)
        height[near] += worn * crater_height(s, float(diameter))
    return height, albedo * (1 + rays(v, rng))


def rays(v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Brightening by the ejecta of young craters, streaks and a bright collar."""
    total = np.zeros(len(v))
    for longitude, latitude, diameter, length in RAYED:
        centre = on_moon(longitude, latitude)
        distance = np.arccos(np.clip(v @ centre, -1, 1)) * MOON_RADIUS_KM
        east = np.cross([0, 1, 0], centre)
        azimuth = np.arctan2(v @ np.cross(centre, east), v @ east)
        streak = sum(np.cos(k * azimuth + rng.uniform(0, 2 * np.pi)) * rng.normal() for k in range(3, 28)) / np.sqrt(12)
        total += 0.9 * np.clip(streak - 0.4, 0, 1.5) * np.exp(-distance / (0.5 * length)) * (distance > 0.5 * diameter)
        total += 0.7 * np.exp(-((distance / diameter) ** 2))
    return total


def disk_function(phase_rad: float) -> float:
    """What brings the disk of a Lommel-Seeliger sphere to Allen's phase law."""
    degrees = np.degrees(phase_rad)
    return float(10 ** (-0.4 * (0.026 * degrees + 4e-9 * degrees**4)) / lommel_seeliger_phase(phase_rad))


def moon_scene(
    towards: np.ndarray, sky_frame: np.ndarray, phase_deg: float, sun_position_angle_deg: float
) -> dict[str, Any]:
    """Moon at the origin [km] and its lights, as a part of a scene dictionary; a Sun of unit irradiance.

    Parameters
    ----------
    towards : (3,)
        Direction in which the camera sees the Moon.
    sky_frame : (3, 3)
        Rows: west, south and ``towards`` in the world.
    phase_deg : float
        Angle Sun - Moon - camera.
    sun_position_angle_deg : float
        Direction of the Sun in the sky, from north through east.
    """
    mi = Engine.active().mitsuba
    rng = np.random.default_rng(11)
    v, faces = grid()
    mare = maria(v, rng)
    height, albedo = terrain(v, mare, rng)
    west, south, _ = sky_frame
    world = np.stack([west, -south, -towards])  # lunar x, y, z; lunar east is the sky's west
    points = ((1 + height / MOON_RADIUS_KM)[:, None] * v * MOON_RADIUS_KM) @ world
    phase, at = np.radians(phase_deg), np.radians(sun_position_angle_deg)
    sideways = -np.sin(at) * west - np.cos(at) * south
    to_sun = -np.cos(phase) * towards + np.sin(phase) * sideways
    bsdf = mi.load_dict({"type": "lunar_surface", "albedo": {"type": "mesh_attribute", "name": "vertex_albedo"}})
    props = mi.Properties()
    props["bsdf"] = bsdf
    mesh = mi.Mesh("moon", len(v), len(faces), props=props, has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(points.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    mesh.add_attribute("vertex_albedo", 1, mi.Float((albedo * disk_function(phase)).astype(np.float32)))
    earth_to_sun = EARTHSHINE / disk_function(phase)  # earthshine arrives at phase angle 0
    return {
        "moon": mesh,
        "sun": {"type": "directional", "direction": (-to_sun).tolist(), "irradiance": 1.0},
        "earth": {"type": "directional", "direction": towards.tolist(), "irradiance": float(earth_to_sun)},
    }
