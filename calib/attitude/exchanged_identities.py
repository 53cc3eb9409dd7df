"""Two stars of a frame with interchanged identities, detected by trying all pairs.

Wahba's problem for a frame with an interchanged pair has a large loss, and with few stars a reflection may even fit
better than any rotation, so that the sky looks mirrored. Exchanging the references of stars i and j changes the profile
matrix by one product,

    B' = B + (w_i v_i - w_j v_j) (r_j - r_i)^T,

and its best rotation has the loss ``sum w - (s1 + s2 + d s3)`` with the singular values s of B' and its parity d. All
pairs are tried at once. An exchange does not repair a mirrored sky, unless its stars lie symmetrically.
"""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray, IntArray

MOST_STARS = 40
"""Stars of a frame that are tried, those farthest off: the two that are exchanged are among them."""


def best_exchange(
    v_cam: FloatArray, v_ref: FloatArray, weight: FloatArray, rotation: FloatArray
) -> tuple[IntArray, float]:
    """The two stars of one frame that fit best with their references exchanged.

    Shapes: ``v_cam`` (n, 3), ``v_ref`` (n, 3), ``weight`` (n,), ``rotation`` (3, 3), returns (2,).
    """
    square = weight * np.sum((v_cam - v_ref @ rotation.T) ** 2, axis=1)
    tried = np.sort(np.argsort(-square, kind="stable")[:MOST_STARS])
    i, j = (tried[k] for k in np.triu_indices(len(tried), 1))
    weighted = weight[:, None] * v_cam
    change = (weighted[i] - weighted[j])[:, :, None] * (v_ref[j] - v_ref[i])[:, None, :]
    profile = (weighted.T @ v_ref + change) / weight.sum()
    u, singular_values, vt = np.linalg.svd(profile)
    parity = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    best = int(np.argmax(singular_values[:, :2].sum(axis=1) + parity * singular_values[:, 2]))
    # the loss itself from the residuals: the difference above loses the digits of small angles
    turn = (u[best] * [1.0, 1.0, parity[best]]) @ vt[best]
    swapped = np.array(v_ref)
    swapped[[i[best], j[best]]] = v_ref[[j[best], i[best]]]
    loss = 0.5 * float(np.sum(weight * np.sum((v_cam - swapped @ turn.T) ** 2, axis=1)))
    return np.array([i[best], j[best]]), loss
