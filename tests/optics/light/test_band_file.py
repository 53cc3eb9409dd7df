"""Filter curves from CSV files: what is read, what is converted, what is refused with the line."""

import numpy as np
import pytest

from optics.light.band_file import load_band

PLAIN = "500,0.0\n510,0.8\n520,0.4\n530,0.0\n"


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        "wavelength_nm,transmission\n" + PLAIN,
        "# from the maker\n\nWavelength (nm);T\n" + PLAIN.replace(",", "; "),
        PLAIN.replace(",", "\t"),
        "\ufeff" + PLAIN.replace("\n", "\r\n"),
        "wavelength_nm,transmission_percent\n500,0\n510,80\n520,40\n530,0\n",
        "\n".join(reversed(PLAIN.splitlines())),
        "300,0.00002\n490,0.0001\n" + PLAIN + "900,0.0003\n",  # a blocked filter leaks a little everywhere
        PLAIN.replace("530,0.0", "530,-0.0004"),  # noise of a spectrophotometer
    ],
    ids=["bare", "header", "semicolons", "tabs", "windows", "percent", "descending", "leaks", "noise"],
)
def test_the_same_curve_however_it_is_written(text, tmp_path):
    file = tmp_path / "green.csv"
    file.write_text(text, encoding="utf-8")
    band = load_band(file)
    assert band.name == band.source.removesuffix(".csv") == "green"
    assert band.transmission([505.0, 510.0, 515.0, 520.0]) == pytest.approx([0.4, 0.8, 0.6, 0.4], abs=1e-3)
    assert band.transmission([250.0, 480.0, 535.0, 1000.0]) == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(band.breakpoints_nm) <= 30.0
    file.write_text(text.lstrip("\ufeff"), encoding="utf-16")  # as spreadsheets export "Unicode text"
    assert load_band(file).transmission([505.0, 510.0]) == pytest.approx([0.4, 0.8], abs=1e-3)
