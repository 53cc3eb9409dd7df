"""Header cards of a frame beyond those of any frame: time, instrument, attitude, rate, light, world coordinates."""

from __future__ import annotations

from datetime import datetime, timedelta
from functools import lru_cache
from importlib import metadata
from typing import TYPE_CHECKING

from optics.attitude import angles_from_attitude, quat_xyzw
from optics.units import RAD_DEG

if TYPE_CHECKING:
    from experiments.dataset.frames.maker import MadeFrame
    from experiments.dataset.frames.scene import Scene
    from experiments.laboratory.instrument import Instrument
    from render.fits.headers import Card

__all__ = ["header_cards", "instrument_cards"]

_J2000 = datetime(2000, 1, 1, 12)
_MJD_J2000, _YEAR_DAYS, _DAY_S = 51544.5, 365.25, 86400.0


def header_cards(scene: Scene, made: MadeFrame) -> list[Card]:
    """Cards (keyword, value, comment) for ``write_frame(..., cards=...)``; nothing of the machine or its clock."""
    config, attitude = scene.config, made.plan.attitude
    ra, dec, roll = angles_from_attitude(attitude)
    quaternion = zip("XYZW", quat_xyzw(attitude).tolist(), strict=True)
    rate = zip("XYZ", (made.plan.rate_rad_per_s * RAD_DEG).tolist(), strict=True)
    days = (config.catalogue.epoch_year - 2000.0) * _YEAR_DAYS + _since_epoch_s(scene, made) / _DAY_S
    return [
        ("TIMESYS", "TDB", "time scale of the dates"),
        ("DATE-OBS", (_J2000 + timedelta(days=days)).isoformat(timespec="milliseconds"), "start of the exposure"),
        ("MJD-OBS", _MJD_J2000 + days, "[d] start of the exposure"),
        *instrument_cards(scene.instrument),
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


def _since_epoch_s(scene: Scene, made: MadeFrame) -> float:
    """Start of an exposure after the epoch: frames of a scan follow each other, the middle of any other is at it."""
    path = scene.plan.path
    return made.plan.start_s - path.start_s if path is not None else -0.5 * scene.plan.duration_s


def instrument_cards(instrument: Instrument) -> list[Card]:
    """What made the image."""
    camera, chip, config = instrument.camera, instrument.detector, instrument.config
    pitch_um = 1e3 * camera.pixel_pitch_mm
    return [
        ("INSTRUME", _ascii(f"{camera.lens.name} + {chip.name}"), "lens and detector"),
        ("LENS", _ascii(camera.lens.name), "lens prescription"),
        ("DETECTOR", _ascii(chip.name), "detector description"),
        ("FOCALLEN", instrument.focal_length_mm, "[mm] focal length"),
        ("XPIXSZ", pitch_um, "[um] pixel pitch along columns"),
        ("YPIXSZ", pitch_um, "[um] pixel pitch along rows"),
        ("CCD-TEMP", config.chip_temperature_c, "[C] temperature of the chip"),
        ("SATURATE", _saturation_dn(instrument), "[DN] full well or end of the converter"),
        ("CREATOR", _creator(), "program"),
    ]


def _saturation_dn(instrument: Instrument) -> int:
    chip = instrument.detector
    curve = 1.0 + sum(chip.nonlinearity)  # at the full well
    return min(chip.largest_dn, int(chip.offset_dn + chip.gain_dn_per_e * chip.full_well_e * curve))


@lru_cache(maxsize=1)
def _creator() -> str:
    try:
        return f"starbench {metadata.version('starbench')}"
    except metadata.PackageNotFoundError:
        return "starbench"


def _ascii(text: str) -> str:
    """Header text: printable ASCII, short enough for a card."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)[:60]
