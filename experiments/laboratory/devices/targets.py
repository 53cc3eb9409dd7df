"""Targets in the focal plane of the collimator: true and surveyed positions of their points."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.laboratory.settings.tables import GridTargetConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument


def grid_directions(
    target: GridTargetConfig, instrument: Instrument, streams: Streams, *, part: str = "target"
) -> FloatArray:
    """True unit vectors (rows * columns, 3) in cam towards the points, row by row.

    The same streams are the same hardware: what is predicted and what is measured has its points at the same fractions
    of a pixel.
    """
    rng = streams.generator(part)
    camera = instrument.camera
    low = np.full(2, target.edge_px)
    high = np.array([camera.width_px, camera.height_px]) - 1.0 - target.edge_px
    if np.any(low >= high):
        raise DomainError(
            f"a grid {target.edge_px:g} px from the edge does not fit on {camera.width_px} x {camera.height_px} px; "
            "lower target.edge_px"
        )
    x, y = np.meshgrid(np.linspace(low[0], high[0], target.columns), np.linspace(low[1], high[1], target.rows))
    place = np.stack([x.ravel(), y.ravel()], axis=1)
    place = place + target.jitter_px * np.clip(rng.standard_normal(place.shape), -2.0, 2.0)
    direction = camera.nominal_direction(place[:, 0], place[:, 1], instrument.focal_length_mm)
    roll = Rotation.from_rotvec([0.0, 0.0, target.roll_arcmin * 60.0 * ARCSEC_RAD])
    turned: FloatArray = roll.apply(direction)
    widest = float(np.degrees(np.arctan2(np.hypot(turned[:, 0], turned[:, 1]), turned[:, 2]).max()))
    if widest > camera.lens.max_field_deg:
        raise DomainError(
            f"the grid reaches {widest:.2f} deg from the axis; lens {camera.lens.name!r} has a field of "
            f"{camera.lens.max_field_deg:g} deg; raise target.edge_px or take a smaller instrument.detector"
        )
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def survey(target: GridTargetConfig, direction: FloatArray, rng: np.random.Generator, *, copies: int = 1) -> FloatArray:
    """Places of the points as they were measured (copies, n, 3): independent surveys of the same target."""
    error = target.marking_error_arcsec * ARCSEC_RAD * rng.standard_normal((copies, len(direction), 2))
    plane = direction[:, :2] / direction[:, 2:]
    # an angle e on the sky is e (1 + t^2) radially in the tangent plane; at 3.5 deg the difference is 0.4 % of e
    moved = np.concatenate([plane + error, np.ones((copies, len(direction), 1))], axis=2)
    return np.asarray(moved / np.linalg.norm(moved, axis=2, keepdims=True))
