"""Rendered light against the closed form: how far the spot moves, and what its edge looks like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.cube.bench import NOMINAL_CUBE, SQUARE, Laboratory
from experiments.cube.checks import spot_profile
from experiments.cube.trim import (
    exposed,
    fit_aperture,
    fit_hole,
    fit_spot,
    measure_offset,
    spot_light,
    spot_reach_mm,
    take_aperture,
)
from optics.arrays import FloatArray
from render.bench.scene import CubePose, place_cube
from render.bench.trace import land
from render.engine.random import Streams

__all__ = ["LightCheck", "Repeatability", "check_light", "repeatability"]


TILTS_ARCSEC = (700.0, 800.0, 1000.0, 1300.0)
LOG2_PARTICLES = 20
RINGS = 60
REPEATS = 24
SMOOTH_LOG2 = 21
"""Particles of the light that is exposed again and again: from 2^19 on their texture changes the scatter no more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LightCheck:
    """Particles on the screen beside closed forms."""

    tilt_arcsec: FloatArray  # (t,) Tilts of the face
    displacement_mm: FloatArray  # (t,) Mean landing point of the rendered particles from the aperture, along the tilt
    # (t,) 2 x tilt x distance, exactly: distance tan(2 tilt), with the distance to where the tilted face is met
    law_mm: FloatArray
    radius_mm: FloatArray  # (r,) Distances from the middle of the spot
    # (r,) Irradiance of the spot over that of the beam: particles counted in rings, and two circles overlapping
    profile: FloatArray
    # (r,) Irradiance of the spot over that of the beam: particles counted in rings, and two circles overlapping
    closed_profile: FloatArray

    @property
    def worst_displacement_um(self) -> float:
        """Largest difference between the two displacements."""
        return float(np.max(np.abs(self.displacement_mm - self.law_mm)) * 1e3)

    @property
    def worst_profile(self) -> float:
        """Largest difference between the two profiles."""
        return float(np.max(np.abs(self.profile - self.closed_profile)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeatability:
    """One concentric bench, pictured again and again."""

    # Scatter of the offset per axis: aperture and spot from two pictures, and both from the picture of the spot
    two_px: float
    # Scatter of the offset per axis: aperture and spot from two pictures, and both from the picture of the spot
    own_px: float
    # The same with one and the same light each time, so that only the noise of light and detector is new
    two_detector_px: float
    # The same with one and the same light each time, so that only the noise of light and detector is new
    own_detector_px: float
    stated_px: float  # What the covariances of the fits say of the first
    pictures: int  # How many

    @property
    def stated_over_scatter(self) -> float:
        """Above 1: the fits state too much."""
        return self.stated_px / self.two_px


def repeatability(laboratory: Laboratory) -> Repeatability:
    """Scatter of the measured offset on a bench where nothing moves."""
    place_cube(laboratory.scene, laboratory.geometry, tilted_pose(laboratory, 0.0))
    radius, reach = laboratory.geometry.aperture_mm / 2, spot_reach_mm(laboratory)

    def traced(streams: Streams, log2_particles: int) -> NDArray[np.float32]:
        inner = max(radius - 3 * laboratory.pitch_mm, 0.0)
        return spot_light(laboratory, streams, sensor=laboratory.sensor, log2_particles=log2_particles, inner_mm=inner)

    smooth = traced(laboratory.streams.child("repeatability"), SMOOTH_LOG2)
    offsets: list[list[FloatArray]] = [[], [], [], []]
    stated = []
    for number in range(REPEATS):
        streams = laboratory.streams.child("repeatability", number)
        aperture = fit_aperture(take_aperture(laboratory, streams), radius)
        sampled = traced(streams, laboratory.config.benches.log2_particles)
        for kind, light in enumerate((sampled, smooth)):
            picture = exposed(laboratory, light, streams.child("spot"))
            spot = fit_spot(picture, aperture, reach)
            two = measure_offset(aperture, spot, laboratory.pitch_mm)
            offsets[2 * kind].append(two.offset_px)
            own = measure_offset(fit_hole(picture, aperture), spot, laboratory.pitch_mm)
            offsets[2 * kind + 1].append(own.offset_px)
            if light is sampled:
                stated.append(np.trace(two.covariance_px2) / 2)
    scatter = [float(np.sqrt(np.var(one, axis=0, ddof=1).mean())) for one in offsets]
    return Repeatability(
        two_px=scatter[0],
        own_px=scatter[1],
        two_detector_px=scatter[2],
        own_detector_px=scatter[3],
        stated_px=float(np.sqrt(np.mean(stated))),
        pictures=REPEATS,
    )


def tilted_pose(laboratory: Laboratory, tilt_rad: float) -> CubePose:
    """A perfect cube whose +Z face looks at the light but for a tilt that moves the spot along +x."""
    table = Rotation.from_rotvec([0.0, tilt_rad, 0.0]) * Rotation.from_euler("y", 180, degrees=True)
    return CubePose.of_table(laboratory.geometry, table.as_matrix(), NOMINAL_CUBE, SQUARE)


def check_light(laboratory: Laboratory) -> LightCheck:
    """Tilt the face far enough for the whole spot to leave the aperture, and look where the particles land."""
    geometry = laboratory.geometry
    clear = geometry.aperture_mm + geometry.blur_mm(geometry.path_mm)  # spot beside the hole
    least = 1.05 * clear / geometry.path_mm
    tilts = least * np.array(TILTS_ARCSEC) / TILTS_ARCSEC[0]
    moved, law = [], []
    points = np.empty((0, 2))
    for i, tilt in enumerate(tilts):
        points = _landing(laboratory, float(tilt), seed=i)
        moved.append(float(points[:, 0].mean()))
        law.append(_law_mm(laboratory, float(tilt)))
    radius, profile = _rings(laboratory, points, np.array([law[-1], 0.0]))
    return LightCheck(
        tilt_arcsec=np.degrees(tilts) * 3600,
        displacement_mm=np.array(moved),
        law_mm=np.array(law),
        radius_mm=radius,
        profile=profile,
        closed_profile=_ring_means(laboratory),
    )


def _landing(laboratory: Laboratory, tilt: float, *, seed: int) -> FloatArray:
    place_cube(laboratory.scene, laboratory.geometry, tilted_pose(laboratory, tilt))
    found = land(laboratory.scene, laboratory.geometry, log2_particles=LOG2_PARTICLES, seed=seed)
    return found.screen_mm


def _law_mm(laboratory: Laboratory, tilt: float) -> float:
    """The face turns about the middle of the cube, so the light meets it a little farther away, off its centre."""
    geometry = laboratory.geometry
    half = geometry.cube_mm / 2
    distance = geometry.distance_mm + half - half / np.cos(tilt)
    return float(distance * np.tan(2 * tilt))


def _rings(laboratory: Laboratory, points: FloatArray, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Irradiance over that of the beam in rings of equal area."""
    geometry = laboratory.geometry
    edge = ring_edges(laboratory)
    count, _ = np.histogram(np.hypot(*(points - centre).T), edge)
    area = np.pi * np.diff(edge**2)
    per_area = len(points) / (np.pi * (geometry.aperture_mm / 2) ** 2)  # all that passes the aperture comes back
    return (edge[1:] + edge[:-1]) / 2, count / area / per_area


def _ring_means(laboratory: Laboratory) -> FloatArray:
    """Closed form averaged over the rings."""
    edge = ring_edges(laboratory)
    fine = edge[:-1, None] + np.diff(edge)[:, None] * (np.arange(16) + 0.5) / 16
    value = spot_profile(laboratory.geometry, fine.ravel()).reshape(fine.shape)
    return np.asarray((value * fine).sum(1) / fine.sum(1))


def ring_edges(laboratory: Laboratory) -> FloatArray:
    """Radii of rings of equal area, to a little beyond the spot [mm]."""
    geometry = laboratory.geometry
    reach = geometry.aperture_mm / 2 + geometry.blur_mm(geometry.path_mm)
    return np.asarray(1.05 * reach * np.sqrt(np.linspace(0.0, 1.0, RINGS + 1)))
