"""Header cards of a frame beyond those of any frame: attitude, rate, light, world coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optics.attitude import angles_from_attitude, quat_xyzw
from optics.units import RAD_DEG

if TYPE_CHECKING:
    from experiments.dataset.frames.maker import MadeFrame
    from experiments.dataset.frames.scene import Scene
    from render.fits.headers import Card

__all__ = ["header_cards"]


def header_cards(scene: Scene, made: MadeFrame) -> list[Card]:
    """Cards (keyword, value, comment) for ``write_frame(..., cards=...)``; nothing of the time or the machine."""
    config, attitude = scene.config, made.plan.attitude
    ra, dec, roll = angles_from_attitude(attitude)
    quaternion = zip("XYZW", quat_xyzw(attitude).tolist(), strict=True)
    rate = zip("XYZ", (made.plan.rate_rad_per_s * RAD_DEG).tolist(), strict=True)
    return [
        ("SEED", config.seed, "seed of the dataset"),
        ("SPLIT", made.plan.split, "part of the dataset"),
        ("RA_BORE", ra, "[deg] boresight, middle of the exposure"),
        ("DEC_BORE", dec, "[deg] boresight, middle of the exposure"),
        ("ROLL", roll, "[deg] position angle of up (smaller rows)"),
        *((f"QUAT_{axis}", value, "attitude cam from icrs, scalar last") for axis, value in quaternion),
        *((f"RATE_{axis}", value, "[deg/s] angular velocity in cam") for axis, value in rate),
        ("JYEAR", config.catalogue.epoch_year, "[yr] Julian year of the exposure"),
        ("OBSERVER", config.catalogue.observer, "earth: with parallax and aberration"),
        ("MAGLIMIT", scene.faintest_mag, "[mag] faintest stars rendered"),
        ("SKYLIGHT", made.background_e, "[e-] mean expected sky light per pixel"),
        *scene.wcs.header(attitude.as_matrix()),
    ]
