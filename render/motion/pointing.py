"""Random attitudes and angular velocities."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.frames import equatorial_deg


def random_attitude(rng: np.random.Generator) -> Rotation:
    """An attitude, all of them equally likely: a direction uniform on the 3-sphere is a uniform rotation."""
    return Rotation.from_quat(rng.standard_normal(4))


def random_attitude_in_cone(
    rng: np.random.Generator, *, ra_deg: float, dec_deg: float, radius_deg: float, roll_deg: float | None = None
) -> Rotation:
    """cam from icrs with the boresight uniform in a cone about a direction; random roll if none is given."""
    height = rng.uniform(math.cos(math.radians(radius_deg)), 1.0)  # equal heights of a cap are equal areas
    azimuth_deg, roll = rng.uniform(0.0, 360.0, 2)
    azimuth, across = math.radians(azimuth_deg), math.sqrt(max(0.0, 1.0 - height * height))
    centre = attitude_from_angles(ra_deg, dec_deg, 0.0)
    boresight = centre.inv().apply([across * math.cos(azimuth), across * math.sin(azimuth), height])
    ra, dec = equatorial_deg(boresight)
    return attitude_from_angles(float(ra), float(dec), roll if roll_deg is None else roll_deg)


def random_rate(
    rng: np.random.Generator, low: float, high: float, distribution: Literal["uniform", "log_uniform"] = "uniform"
) -> FloatArray:
    """Angular velocity (3,) about a random axis, its size between two values in their unit."""
    axis = rng.standard_normal(3)
    part = rng.uniform()
    size = low * (high / low) ** part if distribution == "log_uniform" else low + (high - low) * part
    return np.asarray(axis / np.linalg.norm(axis) * size)
