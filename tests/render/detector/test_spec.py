"""Detector data: shipped files, and what a reader of a broken one is told."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from detectors import CURVES, SHEET

from optics.errors import DomainError
from render.detector.spec import Detector, list_detectors, load_detector


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def test_data_sheet_values() -> None:
    """CMV4000 data sheet, specification overview."""
    chip = load_detector("cmv4000")
    assert chip.shape == (2048, 2048)
    assert chip.pixel_pitch_mm == pytest.approx(5.5e-3)
    assert chip.full_well_e == 13500
    assert chip.read_noise_e == 13
    assert chip.dark_current_e_per_s == 125
    assert chip.quantum_efficiency.interpolate(550.0) == pytest.approx(0.60)
    assert chip.quantum_efficiency.interpolate(900.0) == pytest.approx(0.08)
    assert chip.gain_dn_per_e * chip.full_well_e + chip.offset_dn < chip.largest_dn == 4095


def test_every_shipped_converter_shows_the_full_well_and_eight_are_not_of_one_base() -> None:
    chips = [load_detector(name) for name in list_detectors()]
    assert sum(not chip.from_base for chip in chips) >= 8
    for chip in chips:
        assert chip.converter_top_e > 0.99 * chip.full_well_e


def test_dark_current_over_temperature_is_that_of_the_data_sheet() -> None:
    """e2v: 1.14e6 T^3 exp(-9080 K / T) of that at 293 K; between the points of the table too."""
    chip = load_detector("ccd42_40")
    for celsius in (-45.0, -33.3, 0.0, 17.0, 35.0):
        kelvin = celsius + 273.15
        stated = 250.0 * 1.14e6 * kelvin**3 * np.exp(-9080.0 / kelvin)
        assert chip.dark_current_e_per_s * chip.dark_factor(celsius) == pytest.approx(stated, rel=0.01)


def test_a_data_sheet_with_curves_from_csv(tmp_path: Path) -> None:
    (tmp_path / "qe.csv").write_text("wavelength_nm,quantum_efficiency_percent\n800,20\n600,50\n400,30\n")
    (tmp_path / "dark.csv").write_text("temperature_c;e_per_s\n0;1.0\n20;8.0\n")
    chip = load_detector(written(tmp_path, SHEET + 'gain_dn_per_e = 0.9\nassumed = ["adc_bits"]\n' + CURVES))
    assert chip.quantum_efficiency.interpolate(500.0) == pytest.approx(0.4)
    assert chip.dark_reference_c == 20.0
    assert chip.dark_current_e_per_s == pytest.approx(8.0)
    assert chip.dark_factor(0.0) == pytest.approx(1 / 8)
    assert chip.offset_dn == pytest.approx(45.0)  # 10 x 5 e- x 0.9 DN/e-
    default, assumed, converter = chip.remarks()
    assert "prnu" in default
    assert "chips" not in default
    assert "dark_doubling_c" not in default
    assert assumed.endswith("assumed, not in the source: adc_bits.")
    assert "the converter ends at 4500 e-, 45 % of the full well of 10000 e-" in converter
    (tmp_path / "qe.csv").write_text("wavelength_nm,quantum_efficiency_percent\n800,0.2\n600,0.5\n")
    with pytest.raises(DomainError, match=r"up to 0.5 %; if the values are fractions"):
        load_detector(written(tmp_path, SHEET + "gain_dn_per_e = 0.9\n" + CURVES))


def test_mosaic_size_and_gap() -> None:
    mosaic = load_detector("acc18_mosaic")
    assert mosaic.shape == (2048, 4096)
    assert mosaic.gap_px == 0
    assert mosaic.full_well_e == load_detector("cmv4000").full_well_e
    assert dataclasses.replace(mosaic, gap_px=10).shape == (2048, 4106)


def test_dark_current_law() -> None:
    chip = load_detector("cmv4000")
    assert chip.dark_factor(25.0) == 1.0
    assert chip.dark_factor(31.5) == pytest.approx(2.0)
    assert chip.dark_factor(12.0) == pytest.approx(0.25)


def test_own_file_on_a_base(tmp_path: Path) -> None:
    detector = load_detector(written(tmp_path, 'base = "cmv4000"\nname = "quiet"\nread_noise_e = 2.0\n'))
    assert isinstance(detector, Detector)
    assert (detector.name, detector.read_noise_e, detector.prnu) == ("quiet", 2.0, 0.01)
    assert "prnu" in detector.from_base
    assert "read_noise_e" not in detector.from_base
    assert "read_noise_spread" in detector.assumed  # of the base, and still its
