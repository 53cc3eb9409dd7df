"""Made-up directions of stars, over the sky or in a camera's field, and their errors."""

import numpy as np


def sky_directions(count, seed=1):
    """Unit vectors (n, 3), even over the sky."""
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def field_directions(rng, count, half_width_deg):
    """Unit vectors (n, 3) in cam, even over a square field."""
    edge = np.tan(np.radians(half_width_deg))
    v = np.column_stack([rng.uniform(-edge, edge, (count, 2)), np.ones(count)])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def noisy_directions(rng, v, sigma_rad):
    """Unit vectors (n, 3) moved across themselves by normal errors."""
    error = sigma_rad * rng.standard_normal(v.shape)
    moved = v + error - np.sum(error * v, axis=1, keepdims=True) * v
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)
