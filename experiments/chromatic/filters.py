"""Filters in own frames: a wedge separated from the lens, exchanged files of two filters.

The shift of a point at r between a filter and the reference filter, at a place of the field whose filters have the
angle t to the camera, is

    shift = lens + scale (r - centre) + R(t) wedge,

``lens`` the shift by a decentred element (prism: uniform, turns with the camera), ``wedge`` the shift by the filter
relative to the reference filter (turns with the filter), R the rotation from +x to +y. At one angle only the sum of
both is known. If the angles of filter and reference filter differ, ``(R(t) - R(t of the reference)) wedge of the
reference`` is added; undetermined quantities are NaN.

Exchanged files: light and width of a spot are a product of filter and place. If exchanging two filters at a place makes
places agree that otherwise disagree, the filters are exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from experiments.reduce.series import SeriesFrames
from optics.arrays import FloatArray

LIGHT_FLOOR, WIDTH_FLOOR = 0.03, 0.02
"""How far filters may differ from place to place: vignetting and aberrations that hang on the wavelength."""
LEAST, LEFT = 25.0, 0.25
"""Least reduction of the squares over these floors by an exchange, absolute and as a ratio."""
DETERMINED = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """Parts of the shift of a pair [px]; NaN where the angles do not determine them."""

    constant_px: FloatArray  # (2,) The same everywhere, mean over the places
    lens_px: FloatArray  # (2,) Of it the lens's
    wedge_px: FloatArray  # (2,) Of it the filter's over the reference's, as at the angle 0
    constant_sigma_px: FloatArray  # (2,) Standard deviations
    lens_sigma_px: FloatArray  # (2,)
    wedge_sigma_px: FloatArray  # (2,)


def _turn(angle_deg: float) -> FloatArray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s], [s, c]])


def parts_of_shift(
    shift_px: FloatArray,
    sigma_px: FloatArray,
    from_centre_px: FloatArray,
    filter_deg: FloatArray,
    reference_deg: FloatArray,
) -> Parts:
    """Least squares of the module's equation.

    Shapes: ``shift_px``, ``sigma_px``, ``from_centre_px`` (p, j, 2) of j points at p places; ``filter_deg``,
    ``reference_deg`` (p,), angle of filter and reference filter to the camera.
    """
    places, points, _ = shift_px.shape
    design = np.zeros((places, 2, 6))
    for place, (own, reference) in enumerate(zip(filter_deg, reference_deg, strict=True)):
        design[place] = np.hstack([np.eye(2), _turn(own), _turn(own) - _turn(reference)])
    # the scale from the points of each place alone: what moved between the series of a place moved all of them
    middle = from_centre_px.mean(1)
    along = (from_centre_px - middle[:, None]) / sigma_px
    power = max(float((along**2).sum()), 1e-300)
    scale = float((along * (shift_px - shift_px.mean(1, keepdims=True)) / sigma_px).sum()) / power
    scale_variance = 1.0 / power if points > 1 else 0.0
    variance = ((sigma_px**2).sum(1) / points**2).ravel()
    weight, rows = 1.0 / np.sqrt(variance), design.reshape(-1, 6)
    _, size, ways = np.linalg.svd(rows * weight[:, None])
    rank = int((size > DETERMINED * size[0]).sum())
    free = ways[rank:]
    back = np.linalg.pinv(rows * weight[:, None], rcond=DETERMINED) * weight
    data = (shift_px.mean(1) - scale * middle).ravel()
    found = back @ data
    left, degrees = (data - rows @ found) * weight, len(data) - rank
    scatter = max(float(left @ left) / degrees, 1.0) if degrees else 1.0
    noise = np.diag(variance) * scatter + scale_variance * np.outer(middle, middle)
    covariance = back @ noise @ back.T

    def part(functional: FloatArray) -> tuple[FloatArray, FloatArray]:
        known = np.linalg.norm(free @ functional.T, axis=0) < np.sqrt(DETERMINED)
        sigma = np.sqrt(np.einsum("ik,kl,il->i", functional, covariance, functional))
        return np.where(known, functional @ found, np.nan), np.where(known, sigma, np.nan)

    (every, every_sigma), (lens, lens_sigma), (wedge, wedge_sigma) = (
        part(one) for one in (design.mean(0), np.eye(6)[:2], np.eye(6)[2:4])
    )
    return Parts(
        constant_px=every,
        lens_px=lens,
        wedge_px=wedge,
        constant_sigma_px=every_sigma,
        lens_sigma_px=lens_sigma,
        wedge_sigma_px=wedge_sigma,
    )


def _width_px(one: SeriesFrames) -> float:
    """RMS radius of the mean spots within half the window, mean over the points."""
    light = one.mean_e - np.median(one.mean_e[:, [0, -1]], axis=(1, 2))[:, None, None]
    size = light.shape[1]
    axis = np.arange(size) - (size - 1) / 2.0
    near = np.hypot(*np.meshgrid(axis, axis)) <= 0.3 * size
    light = np.where(near, np.maximum(light, 0.0), 0.0)
    total = light.sum((1, 2))
    x, y = (light.sum(k) @ axis / total for k in (1, 2))
    square = (light * np.add.outer(axis**2, axis**2)).sum((1, 2)) / total - x**2 - y**2
    return float(np.sqrt(np.maximum(square, 1e-6)).mean())


def exchanged(grid: Sequence[Sequence[SeriesFrames]], filters_nm: Sequence[float]) -> list[str]:
    """Exchanged series by place and filter, in words; a single place shows none."""
    if len(grid) < 2:
        return []
    rate = [[max(one.signal_e, 1e-3) / (one.exposure_s if one.exposure_s > 0 else 1.0) for one in row] for row in grid]
    features = np.stack(
        [np.log(rate) / LIGHT_FLOOR, np.log([[_width_px(one) for one in row] for row in grid]) / WIDTH_FLOOR]
    )

    def misfit(values: FloatArray) -> float:
        apart = (
            values - values.mean(1, keepdims=True) - values.mean(2, keepdims=True) + values.mean((1, 2), keepdims=True)
        )
        return float((apart**2).sum())

    before, tried = misfit(features), {}
    for place, (one, other) in (
        (place, pair) for place in range(len(grid)) for pair in combinations(range(len(filters_nm)), 2)
    ):
        swapped = features.copy()
        swapped[:, place, [one, other]] = features[:, place, [other, one]]
        tried[place, one, other] = misfit(swapped)
    least = min(tried.values())
    if before - least < LEAST or least > LEFT * before:
        return []
    found = []
    for (place, one, other), value in tried.items():
        if value <= least + 1e-9 * before:
            ratios = np.array(rate)[:, other] / np.array(rate)[:, one]
            low, high = f"{filters_nm[one]:g}", f"{filters_nm[other]:g}"
            found.append(
                f"the files of {low} and {high} nm at place {grid[place][one].settings.place!r} (light of {high} over "
                f"{low} nm is {ratios[place]:.3g} there, {np.delete(ratios, place).mean():.3g} elsewhere)"
            )
    return [" or ".join(found)]
