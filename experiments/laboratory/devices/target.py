"""Laboratory target: a grid of point sources in the focal plane of a collimator, placed in the field."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.laboratory.settings.tables import TargetConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.sensor_file.instrument import Instrument

CORNERS = ("upper left", "upper right", "lower left", "lower right")
"""Positions of the target in the order of ACC18 (Fig. 3); row 0 is the upper edge."""


def corner_centres(target: TargetConfig, width_px: int, height_px: int) -> FloatArray:
    """Centres (4, 2) of the target in the four corners, (column, row)."""
    half_x, half_y = (target.columns - 1) * target.pitch_px / 2, (target.rows - 1) * target.pitch_px / 2
    left, upper = target.edge_px + half_x, target.edge_px + half_y
    right, lower = width_px - 1 - left, height_px - 1 - upper
    if left > right or upper > lower:
        raise DomainError(
            f"a target of {target.columns} x {target.rows} points, {target.pitch_px:g} px apart and {target.edge_px:g} "
            f"px from the edge, does not fit on {width_px} x {height_px} px; lower target.pitch_px or target.edge_px"
        )
    return np.array([[left, upper], [right, upper], [left, lower], [right, lower]])


def target_directions(target: TargetConfig, instrument: Instrument, centre_px: FloatArray) -> FloatArray:
    """Unit vectors (rows * columns, 3) in cam towards the points, the grid's middle at ``centre_px``.

    The grid is flat in the collimator's focal plane and keeps its shape while the platform turns the camera (without
    roll), as on the bench; rows run along detector rows.
    """
    camera, f = instrument.camera, instrument.focal_length_mm
    x = (np.arange(target.columns) - (target.columns - 1) / 2) * target.pitch_px
    y = (np.arange(target.rows) - (target.rows - 1) / 2) * target.pitch_px
    grid_x, grid_y = np.meshgrid(x, y)
    points = camera.nominal_direction(camera.centre_px[0] + grid_x, camera.centre_px[1] + grid_y, f).reshape(-1, 3)
    aim = camera.nominal_direction(centre_px[0], centre_px[1], f)
    axis = np.cross([0.0, 0.0, 1.0], aim)
    sine = np.linalg.norm(axis)
    turn = Rotation.from_rotvec(axis / sine * np.arctan2(sine, aim[2])) if sine > 0 else Rotation.identity()
    turned: FloatArray = turn.apply(points)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def corner_directions(target: TargetConfig, instrument: Instrument) -> FloatArray:
    """Unit vectors (4, rows * columns, 3) in cam towards the points, the target in the four corners (`CORNERS`)."""
    camera = instrument.camera
    centres = corner_centres(target, camera.width_px, camera.height_px)
    direction = np.stack([target_directions(target, instrument, centre) for centre in centres])
    widest = float(np.degrees(np.arctan2(np.hypot(direction[..., 0], direction[..., 1]), direction[..., 2])).max())
    if widest > camera.lens.max_field_deg:
        raise DomainError(
            f"the target reaches {widest:.2f} deg from the axis; lens {camera.lens.name!r} has a field of "
            f"{camera.lens.max_field_deg:g} deg; raise target.edge_px or take a smaller instrument.detector"
        )
    return direction
