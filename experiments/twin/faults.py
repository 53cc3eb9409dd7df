"""Faults of a frame, each a sentence with the measurements that remain valid."""

from __future__ import annotations

import numpy as np

from calib.measure.detection.limiting_magnitude import empty_fraction
from calib.measure.detection.trails import star_shape
from calib.records import SensorImage
from experiments.twin.night import Detections, FrameSolution
from optics.units import RAD_ARCSEC

DAYLIGHT_FRACTION = 0.5
"""Background over the converter's range from which a frame is taken in daylight."""
MIN_DETECTIONS = 4
WIDE_PX = 2.5
"""Width (sigma) above which stars are out of focus; a Gaussian fit follows only the middle of a disk."""
CLOUDED_FRACTION = 0.4
"""Fraction of a frame without a star above which clouds are the likely reason."""


def likely_fault(frame: FrameSolution) -> str:
    """Likely reason why a frame has no solution, with its background and noise."""
    count, shape = int(frame.detected.usable.sum()), shape_fault(frame.image, frame.detected)
    empty = empty_fraction(frame.image.dn.shape, frame.detected.start_px[frame.detected.usable])
    conversion, dn, message = frame.image.conversion, frame.image.dn, frame.identification.message
    full = conversion.full / conversion.step if conversion is not None and conversion.full else float(dn.max())
    if np.median(dn) > DAYLIGHT_FRACTION * max(full, 1.0):
        reason = "daylight or twilight: the background takes more than half of the range; wait for dusk"
    elif "mirrored" in message:
        reason = f"{message}; widths and noise remain valid"
    elif shape:
        reason = f"{shape}; {count} detections are too few to identify them"
    elif count < MIN_DETECTIONS:
        reason = f"no stars: fewer than {MIN_DETECTIONS} detections; lens cap, clouds or too short an exposure"
    elif empty > CLOUDED_FRACTION:
        reason = (
            f"clouds or an obstacle: {100 * empty:.0f} % of the frame has no star, the {count} detections of the rest "
            f"match no part of the sky ({message})"
        )
    else:
        reason = f"{count} detections match no part of the sky: {message}"
    noise, background = frame.image.noise, frame.detected.background
    level = noise.offset_dn + noise.gain_dn_per_e * float(np.median(background.level_e))
    sigma = noise.gain_dn_per_e * float(np.median(background.sigma_e))
    return f"{reason}. Measured nevertheless: background {level:.4g} DN, noise {sigma:.3g} DN"


def shape_fault(image: SensorImage, detected: Detections) -> str:
    """Trailed or out of focus, with the size; "" where stars are points."""
    order = np.argsort(-detected.significance, kind="stable")
    noise_dn = image.noise.gain_dn_per_e * float(np.median(detected.background.sigma_e))
    shape = star_shape(image.dn, detected.start_px[order], noise_dn=noise_dn)
    if shape.trail_px > 0.0:
        rate = RAD_ARCSEC * shape.trail_px / image.exposure_s if image.exposure_s else 0.0
        rate_text = f", {rate:.3g} arcsec/s over the focal length in px" if rate else ""
        return (
            f"trailed: stars are {shape.trail_px:.1f} px long at {shape.angle_deg:.0f} deg from the columns' "
            f"direction{rate_text}; shorter exposures or a steady mount"
        )
    if shape.width_px > WIDE_PX:
        return f"out of focus: stars are {shape.width_px:.1f} px wide (sigma), so that faint ones are lost in the noise"
    return ""
