"""The lens traversed backwards, from the image plane to the sky.

The origin of its lens frame is the origin of the original image plane. Without mirrors its axes are those of the lens
frame turned by 180 deg about y, so that light travels towards +z again: (x, y, z) -> (-x, y, z_image - z). With
mirrors, behind which light may travel in any direction, they are the axes of the image plane, turned in the same way
(right-handed). Its image plane is the plane z = 0 of the original lens.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import HALF_TURN, LensSystem
from optics.rays.trace import OK, Rays


def right_handed(axes: FloatArray) -> FloatArray:
    """Axes (3, 3) of an image plane with the first reversed if they are left-handed, as behind a mirror."""
    return np.asarray(axes * [np.sign(np.linalg.det(axes)), 1.0, 1.0])


def reversed_turn(lens: LensSystem) -> FloatArray:
    """Rotation (3, 3) from the lens frame to that of the reversed lens."""
    if not any(surface.mirror for surface in lens.surfaces):
        return HALF_TURN
    return np.asarray(HALF_TURN @ right_handed(lens.image_rotation).T)


def reverse(lens: LensSystem) -> LensSystem:
    """Lens for light from the image side.

    Parameters
    ----------
    lens : LensSystem
        The lens.

    Returns
    -------
    LensSystem
        Surfaces in reverse order; see the module for its frame. Reversing twice gives back a lens whose image plane is
        untilted (without mirrors) and right-handed, and which is otherwise the same.
    """
    turn = reversed_turn(lens)
    surfaces = tuple(
        replace(
            surface if surface.mirror else surface.from_behind(),
            position_mm=turn @ (surface.position_mm - lens.image_position_mm),
            rotation=turn @ surface.rotation @ (np.eye(3) if surface.mirror else HALF_TURN),
            medium=medium,
            index_offset=offset,
        )
        for surface, (medium, offset) in zip(reversed(lens.surfaces), reversed(lens.media[:-1]), strict=True)
    )
    return replace(
        lens,
        surfaces=surfaces,
        image_position_mm=-turn @ lens.image_position_mm,
        image_rotation=turn @ HALF_TURN,
    )


def retraced(lens: LensSystem, arrived: Rays) -> Rays:
    """Rays that start where traced rays ended and go back, in the frame of ``reverse(lens)``."""
    if np.any(arrived.status != OK):
        raise DomainError(
            f"{int(np.sum(arrived.status != OK))} rays did not reach the image plane; retrace the rays that did"
        )
    turn = reversed_turn(lens) @ lens.image_rotation
    point = turn @ np.stack([np.ravel(v) for v in (arrived.x, arrived.y, arrived.z)])
    direction = -turn @ np.stack([np.ravel(v) for v in (arrived.dx, arrived.dy, arrived.dz)])
    shape = np.shape(arrived.x)
    x, y, z = (v.reshape(shape) for v in point)
    return Rays.create(
        x_mm=x,
        y_mm=y,
        z_mm=z,
        direction=np.moveaxis(direction.reshape(3, *shape), 0, -1),
        wavelength_nm=arrived.wavelength_nm,
    )
