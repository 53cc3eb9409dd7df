"""Laboratory targets in the focal plane of the collimator: multi-star target, and surveyed grid over the detector."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.laboratory.settings.tables import GridTargetConfig, TargetConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
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
    """Unit vectors (rows * columns, 3) in cam towards the points, the centre of the target at ``centre_px``.

    The grid is flat in the collimator's focal plane and keeps its shape while the platform turns the camera without
    roll; rows run along detector rows.
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
    return _unit(turn.apply(points))


def corner_directions(target: TargetConfig, instrument: Instrument) -> FloatArray:
    """Unit vectors (4, rows * columns, 3) in cam towards the points, the target in the four corners (`CORNERS`)."""
    camera = instrument.camera
    centres = corner_centres(target, camera.width_px, camera.height_px)
    direction = np.stack([target_directions(target, instrument, centre) for centre in centres])
    _check_field("target", direction, instrument)
    return direction


def grid_directions(
    target: GridTargetConfig, instrument: Instrument, streams: Streams, *, part: str = "target"
) -> FloatArray:
    """True unit vectors (rows * columns, 3) in cam towards the points of the grid, row by row.

    The same streams give the same hardware: points of a prediction and of its measurement at the same pixel phases.
    """
    camera = instrument.camera
    low = np.full(2, target.edge_px)
    high = np.array([camera.width_px, camera.height_px]) - 1.0 - target.edge_px
    if np.any(low >= high):
        raise DomainError(
            f"a grid {target.edge_px:g} px from the edge does not fit on {camera.width_px} x {camera.height_px} px; "
            "lower target.edge_px"
        )
    x, y = np.meshgrid(np.linspace(low[0], high[0], target.columns), np.linspace(low[1], high[1], target.rows))
    position = np.stack([x.ravel(), y.ravel()], axis=1)
    deviates = streams.generator(part).standard_normal(position.shape)
    position = position + target.jitter_px * np.clip(deviates, -2.0, 2.0)
    direction = camera.nominal_direction(position[:, 0], position[:, 1], instrument.focal_length_mm)
    turned: FloatArray = Rotation.from_rotvec([0.0, 0.0, target.roll_arcmin * 60.0 * ARCSEC_RAD]).apply(direction)
    _check_field("grid", turned, instrument)
    return _unit(turned)


def survey(target: GridTargetConfig, direction: FloatArray, rng: np.random.Generator, *, copies: int = 1) -> FloatArray:
    """Measured directions of the points (copies, n, 3): independent surveys of the same target."""
    error = target.marking_error_arcsec * ARCSEC_RAD * rng.standard_normal((copies, len(direction), 2))
    plane = direction[:, :2] / direction[:, 2:]
    # an angle e on the sky is e (1 + t^2) radially in the tangent plane: 0.4 % more than e at 3.5 deg, neglected
    return _unit(np.concatenate([plane + error, np.ones((copies, len(direction), 1))], axis=2))


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))


def _check_field(name: str, direction: FloatArray, instrument: Instrument) -> None:
    lens = instrument.camera.lens
    widest_deg = np.degrees(np.arctan2(np.hypot(direction[..., 0], direction[..., 1]), direction[..., 2])).max()
    if widest_deg > lens.max_field_deg:
        raise DomainError(
            f"the {name} reaches {widest_deg:.2f} deg from the axis; lens {lens.name!r} has a field of "
            f"{lens.max_field_deg:g} deg; raise target.edge_px or take a smaller instrument.detector"
        )
