"""Settings of small star sensors: part of a detector behind the 26 mm tracker or an ideal lens."""

from typing import Any


def sensor(size_px: int = 800, lens: Any = "star_tracker_26mm", **instrument: Any) -> dict[str, Any]:
    """``instrument`` and ``passband`` of a square part of the cmv4000, 0.2 s, 500 to 800 nm."""
    chip = {"detector": "cmv4000", "width_px": size_px, "height_px": size_px, "exposure_s": 0.2}
    return {"instrument": {"lens": lens, **chip, **instrument}, "passband": {"range_nm": [500.0, 800.0]}}


def ideal_lens(focal_length_mm: float = 25.0, f_number: float = 2.0, spot_um: float = 4.0) -> dict[str, Any]:
    """An ideal lens."""
    return {"kind": "ideal", "focal_length_mm": focal_length_mm, "f_number": f_number, "spot_um": spot_um}


RAYS = {"defocus_mm": 0.0, "diffraction": "rays"}
"""Focus at the detector, PSFs by rays."""
