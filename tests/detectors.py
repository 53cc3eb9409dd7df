"""Detectors without noise and patterns; a data sheet as a file."""

from dataclasses import replace
from typing import Any

from render.detector.spec import Detector, load_detector

SILENT = dict.fromkeys(
    (
        *("prnu", "dark_current_e_per_s", "dark_spread_e_per_s", "hot_fraction", "dead_fraction", "read_noise_e"),
        *("read_noise_spread", "dsnu_e", "column_pattern_e", "crosstalk_horizontal", "crosstalk_vertical"),
        "crosstalk_diagonal",
    ),
    0.0,
)
SHEET = """name = "own"
source = "data sheet"
chip_width_px = 640
chip_height_px = 480
pixel_pitch_um = 5.0
full_well_e = 10000.0
read_noise_e = 5.0
adc_bits = 12
"""
CURVES = '[quantum_efficiency]\nsource = "test"\nfile = "qe.csv"\n[dark_current]\nfile = "dark.csv"\n'


def ideal_detector(height_px: int, width_px: int, **changes: Any) -> Detector:
    """A linear CMV4000 of another size with Poisson noise alone, 1 DN/e- and 16 bits."""
    settings = {"chip_width_px": width_px, "chip_height_px": height_px, "nonlinearity": (), "gain_dn_per_e": 1.0}
    settings |= {"name": "ideal", "offset_dn": 100.0, "full_well_e": 60000.0, "adc_bits": 16}
    return replace(load_detector("cmv4000"), **SILENT | settings | changes)
