"""The reflected spot of the bench by geometry: landing point, brightness, scatter by the particles of a rendering."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from render.bench.scene import BenchGeometry, CubePose
from render.bench.trace import OVERSCAN, sobol_net


def reflected_spot_mm(geometry: BenchGeometry, pose: CubePose, face: str) -> FloatArray:
    """Landing point of the axis of the beam on the screen (2,), by the law of reflection."""
    centre, normal = pose.face(face, geometry)
    light = np.array([0.0, 0.0, -1.0])
    hit = light * ((centre @ normal) / (light @ normal))
    reflected = light - 2 * (light @ normal) * normal
    return np.asarray((hit - reflected * (hit[2] / reflected[2]))[:2])


def spot_profile(geometry: BenchGeometry, radius_mm: ArrayLike) -> FloatArray:
    """Irradiance of the spot over that of the beam at distances from its centre: aperture convolved with the Sun.

    The part of the Sun's disk visible in the mirror through the aperture is the overlap of two circles, the aperture
    (radius a) and the image of the Sun over the path from the aperture to the face and back (radius b), r apart. The
    distance of the aperture from the simulator has no influence.
    """
    a, b = geometry.aperture_mm / 2, geometry.blur_mm(geometry.path_mm)
    r = np.maximum(np.asarray(radius_mm, float), 1e-12)
    cos_a = np.clip((r**2 + a**2 - b**2) / (2 * r * a), -1, 1)
    cos_b = np.clip((r**2 + b**2 - a**2) / (2 * r * b), -1, 1)
    angle_a, angle_b = np.arccos(cos_a), np.arccos(cos_b)
    overlap = a**2 * (angle_a - np.sin(2 * angle_a) / 2) + b**2 * (angle_b - np.sin(2 * angle_b) / 2)
    overlap = np.where(r >= a + b, 0.0, np.where(r <= abs(a - b), np.pi * min(a, b) ** 2, overlap))
    return np.asarray(overlap / (np.pi * b**2))


def landing_points_px(
    hole_px: float, sun_px: float, log2_particles: int, seed: int
) -> tuple[FloatArray, FloatArray, float]:
    """Landing points of the particles of a net about the middle of a concentric spot, without a scene.

    Radii of the hole that the light passes and of the image of the Sun after the path; 2^log2_particles particles under
    a digital shift (`render.bench.trace.trace_screen`). Returns x, y (n,) of the particles that pass the hole [px], and
    particles per px^2 of the hole.

    To first order particles add the sum of a measurement's response over the landing points of a Sobol net, scrambled
    anew each time; it is about a quarter of that of independent particles.
    """
    u = _shifted(sobol_net(log2_particles), seed)
    radius, angle = OVERSCAN * hole_px * np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    sun, azimuth = sun_px * np.sqrt(u[:, 2]), 2 * np.pi * u[:, 3]
    passed = radius < hole_px
    x, y = (f(angle) * radius + f(azimuth) * sun for f in (np.cos, np.sin))
    return x[passed], y[passed], len(u) / (np.pi * (OVERSCAN * hole_px) ** 2)


def _shifted(net: NDArray[np.uint32], seed: int) -> FloatArray:
    """A net (4, n) under another random digital shift, (n, 4) in 0 to 1."""
    shift = np.random.default_rng(seed).integers(0, 2**32, 4, dtype=np.uint32)
    return np.asarray(((net.T ^ shift) + 0.5) / 2.0**32)


def mask_spot_variance_px2(
    hole_px: float, sun_px: float, cosine: FloatArray, log2_particles: int, nets: int = 4
) -> float:
    """Variance of a sun sensor's spots by the number of their particles, each in the pixel that it falls into.

    Radii of the hole, and of the image of the Sun behind it on the axis; cosines (n,) of the angles of the spots from
    the axis; mean over ``nets``. The width of the Sun, wider by 1 / cos^2 along the slant and 1 / cos across, halves
    the gain of the net's evenness.
    """
    suns = len(cosine)
    net = sobol_net(log2_particles + int(np.ceil(np.log2(suns))))[:, : suns << log2_particles]
    rng, means = np.random.default_rng(1), []
    for seed in range(nets):
        u = _shifted(net, seed).reshape(suns, -1, 4)
        radius, sun = OVERSCAN * hole_px * np.sqrt(u[..., 0]), sun_px * np.sqrt(u[..., 2])
        passed = radius < hole_px
        for f, width in ((np.cos, 1.0 / cosine**2), (np.sin, 1.0 / cosine)):
            centre = rng.uniform(-0.5, 0.5, (suns, 1))  # in its pixel
            landed = radius * f(2 * np.pi * u[..., 1]) + sun * width[:, None] * f(2 * np.pi * u[..., 3])
            means.append((np.rint(landed + centre) * passed).sum(1) / passed.sum(1) - centre[:, 0])
    return float(np.mean(np.square(means)))
