"""Faults of a frame in one sentence each, with the measurements that remain valid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from calib.records import SensorImage
from experiments.twin.solve import Detections, Solved
from optics.arrays import FloatArray

FILLED = 0.5
"""Share of the converter's range from which a background is daylight."""
FEWEST = 4
WIDE_PX = 2.5
"""Width from which stars count as out of focus: a Gaussian fit sees only the middle of a disk."""
HALF_PX, BRIGHTEST = 12, 40
TRAILED = 2.0
"""Ratio of the axes from which stars are trailed; a lens that is out of focus or has coma stays below."""
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
    long_px, width_px, angle_deg = trail_of(image, seen)
    if long_px > 0.0:
        turn = (
            f", {206265 * long_px / image.exposure_s:.3g} arcsec/s over the focal length in px"
            if (image.exposure_s)
            else ""
        )
        return (
            f"trailed: stars are {long_px:.1f} px long at {angle_deg:.0f} deg from the columns' direction{turn}; "
            "shorter exposures or a steady mount"
        )
    if width_px > WIDE_PX:
        return f"out of focus: stars are {width_px:.1f} px wide (sigma), so that faint ones are lost in the noise"
    return ""


def trail_of(image: SensorImage, seen: Detections) -> tuple[float, float, float]:
    """Length of the trails [px] (0: none), width (sigma) across them [px], angle [deg] from +x towards +y.

    From the second moments of the light of the brightest stars, added up: what differs over the field averages out.
    """
    order = np.argsort(-seen.significance, kind="stable")
    place = np.rint(seen.start_px[order]).astype(np.int64)
    height, width = image.dn.shape
    y, x = np.mgrid[-HALF_PX : HALF_PX + 1, -HALF_PX : HALF_PX + 1]
    noise_dn = image.noise.gain_dn_per_e * float(np.median(seen.background.sigma_e))
    found: list[FloatArray] = []
    taken: list[FloatArray] = []
    for at in place:
        if any(np.abs(at - one).max() < HALF_PX for one in taken) or len(found) >= BRIGHTEST:
            continue
        taken.append(at)
        if not (HALF_PX <= at[0] < width - HALF_PX and HALF_PX <= at[1] < height - HALF_PX):
            continue
        cut = image.dn[at[1] - HALF_PX : at[1] + HALF_PX + 1, at[0] - HALF_PX : at[0] + HALF_PX + 1]
        light = cut - np.median(cut)
        parts, _ = label(light > 3.0 * noise_dn, np.ones((3, 3)))
        mine = parts[HALF_PX, HALF_PX]
        light = np.where((parts == mine) & (mine > 0), light, 0.0)  # neighbours and noise would make it wide
        if np.count_nonzero(light) < 6:
            continue
        share = light / light.sum()
        mean = np.array([(share * x).sum(), (share * y).sum()])
        off = np.stack([x - mean[0], y - mean[1]])
        found.append(np.einsum("yx,ayx,byx->ab", share, off, off))
    if len(found) < 3:
        return 0.0, float("nan"), float("nan")
    value, axes = np.linalg.eigh(np.median(found, axis=0))
    short, long = np.sqrt(np.maximum(value, 1e-9))
    angle = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])) % 180.0)
    trail = float(np.sqrt(12.0 * (value[1] - value[0]))) if long > TRAILED * short else 0.0
    return trail, float(short), angle


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
