"""Faults of a frame in one sentence each, with the measurements that remain valid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.measure.trails import star_shape
from calib.records import SensorImage
from experiments.twin.solve import Detections, Solved
from optics.arrays import FloatArray

FILLED = 0.5
"""Share of the converter's range from which a background is daylight."""
FEWEST = 4
WIDE_PX = 2.5
"""Width from which stars count as out of focus: a Gaussian fit sees only the middle of a disk."""
TILES, CLOUD_TILES = 5, 3
FEWEST_EXPECTED, CLOUDED_SHARE, EMPTY_SHARE = 5, 0.5, 0.4


def what_is_wrong(one: Solved) -> str:
    """The likely reason why a frame has no solution, and its remaining measurements."""
    count, shape = int(one.seen.sane.sum()), shape_words(one.image, one.seen)
    empty = _empty_share(one.image, one.seen)
    conversion, dn = one.image.conversion, one.image.dn
    full = conversion.full / conversion.step if conversion is not None and conversion.full else float(dn.max())
    if np.median(dn) > FILLED * max(full, 1.0):
        words = "daylight or twilight: the background takes more than half of the range; wait for dusk"
    elif "mirrored" in one.words:
        words = f"{one.words}; widths and noise remain valid"
    elif shape:
        words = f"{shape}; {count} detections are too few to identify them"
    elif count < FEWEST:
        words = f"no stars: fewer than {FEWEST} detections; lens cap, clouds or too short an exposure"
    elif empty > EMPTY_SHARE:
        words = (
            f"clouds or an obstacle: {100 * empty:.0f} % of the frame has no star, the {count} detections of the rest "
            f"match no part of the sky ({one.words})"
        )
    else:
        words = f"{count} detections match no part of the sky: {one.words}"
    return f"{words}. {_sky_words(one)}"


def _sky_words(one: Solved) -> str:
    noise, background = one.image.noise, one.seen.background
    level = noise.offset_dn + noise.gain_dn_per_e * float(np.median(background.level_e))
    return (
        f"Measured nevertheless: background {level:.4g} DN, noise "
        f"{noise.gain_dn_per_e * float(np.median(background.sigma_e)):.3g} DN"
    )


def shape_words(image: SensorImage, seen: Detections) -> str:
    """Trailed or out of focus, with the size; nothing where stars are points."""
    order = np.argsort(-seen.significance, kind="stable")
    noise_dn = image.noise.gain_dn_per_e * float(np.median(seen.background.sigma_e))
    shape = star_shape(image.dn, seen.start_px[order], noise_dn=noise_dn)
    if shape.trail_px > 0.0:
        turn = (
            f", {206265 * shape.trail_px / image.exposure_s:.3g} arcsec/s over the focal length in px"
            if (image.exposure_s)
            else ""
        )
        return (
            f"trailed: stars are {shape.trail_px:.1f} px long at {shape.angle_deg:.0f} deg from the columns' "
            f"direction{turn}; shorter exposures or a steady mount"
        )
    if shape.width_px > WIDE_PX:
        return f"out of focus: stars are {shape.width_px:.1f} px wide (sigma), so that faint ones are lost in the noise"
    return ""


def _empty_share(image: SensorImage, seen: Detections) -> float:
    """Share of the tiles of a frame without a detection, if the rest has several each."""
    count = _tiles(seen.start_px[seen.sane], image, TILES)
    return float((count == 0).mean()) if count.sum() >= 2 * (count > 0).sum() > 0 else 0.0


def _tiles(place_px: FloatArray, image: SensorImage, tiles: int) -> FloatArray:
    height, width = image.dn.shape
    edges = [np.linspace(-0.5, n - 0.5, tiles + 1) for n in (height, width)]
    return np.histogram2d(place_px[:, 1], place_px[:, 0], bins=edges)[0]


def clouded(image: SensorImage, expected_px: FloatArray, found: NDArray[np.bool_]) -> float:
    """Share of a frame in which most of the stars that clear sky shows are missing.

    Shapes: ``expected_px`` (n, 2) of stars well above the limit, ``found`` (n,) bool.
    """
    known = _tiles(expected_px, image, CLOUD_TILES)
    seen = _tiles(expected_px[np.asarray(found, bool)], image, CLOUD_TILES)
    told = known >= FEWEST_EXPECTED
    if not told.any():
        return 0.0
    return float((seen[told] < CLOUDED_SHARE * known[told]).mean())
