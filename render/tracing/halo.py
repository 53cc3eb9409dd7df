"""The halo of light scattered by the surfaces of a lens around each star: removed from its core, added around it.

One law for all surfaces (`optics.light.bsdf`) gives the radiance against differences of sines from the star. A pixel
receives BSDF times its solid angle, (pitch / focal length)^2, times the light that passes the lens; near the star the
law is averaged over pixels. The halo ends where a pixel receives ``Camera.far.ends_e`` (`LEAST_E` without), but the
whole TIS is removed from the core and counted in ``Truth.electrons_scattered``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from render.camera import Camera, ScatterLaw
from render.records import Truth
from render.tracing.motion.exposure import IdealLens

LEAST_E = 0.1
"""Electrons of a pixel at which halos end by default."""
NEAR_PX, PARTS = 12, 12
"""Distance within which the law is averaged over pixels, and points along either side of one."""
KNOTS = 4000


def with_scattered(truth: Truth, tis: float) -> Truth:
    """Truth with all light, of stars rendered without the scattered part of it."""
    per_unscattered = 1.0 / (1.0 - tis)
    lost = {name: getattr(truth, f"electrons_{name}") for name in ("vignetted", "hidden", "absorbed")}
    transmitted_e = truth.electrons_in - sum(lost.values())
    return replace(
        truth,
        electrons_in=truth.electrons_in * per_unscattered,
        electrons_scattered=transmitted_e * (per_unscattered - 1.0),
        **{f"electrons_{name}": value * per_unscattered for name, value in lost.items()},
    )


def add_halos(camera: Camera, law: ScatterLaw, truth: Truth, image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Add halos of all stars to an image (h, w, b); their light alone."""
    assert truth.electrons_scattered is not None
    halo = np.zeros_like(image)
    ends_e = LEAST_E if camera.far is None else camera.far.ends_e
    height, width = image.shape[:2]
    per_px = 1.0 / IdealLens.of(camera).focal_px
    radius = np.concatenate([[0.0], np.geomspace(0.1, np.hypot(height, width), KNOTS)])
    profile = law.bsdf(np.minimum(radius * per_px, 1.0)) * per_px**2 / law.tis
    part = (np.arange(PARTS) + 0.5) / PARTS - 0.5
    for star, band in np.argwhere(truth.electrons_scattered * profile[0] > ends_e).tolist():
        light = float(truth.electrons_scattered[star, band])
        x, y = float(truth.photon_x_px[star, band]), float(truth.photon_y_px[star, band])
        if not np.isfinite(x + y):
            continue
        reach = float(radius[np.flatnonzero(light * profile > ends_e)[-1]])
        (left, right), (top, bottom) = (
            (max(0, int(np.ceil(v - reach))), min(size, int(np.floor(v + reach)) + 1))
            for v, size in ((x, width), (y, height))
        )
        if left >= right or top >= bottom:
            continue
        column, row = np.arange(left, right) - x, np.arange(top, bottom) - y
        distance = np.hypot(column, row[:, None])
        values = np.interp(distance, radius, profile)
        for r, c in np.argwhere(distance < NEAR_PX).tolist():
            inside = np.hypot(column[c] + part, (row[r] + part)[:, None])
            values[r, c] = np.interp(inside, radius, profile).mean()
        halo[top:bottom, left:right, band] += (light * values * (distance <= reach)).astype(np.float32)
    columns: FloatArray | NDArray[np.bool_] | None = camera.sensitive_columns
    if columns is not None:
        halo *= columns[:, None]
    image += halo
    return halo
