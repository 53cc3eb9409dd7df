"""Index of air against the NIST calculator and against formulas of other authors."""

import numpy as np
import pytest

from optics.glass.air import air_index

# NIST Engineering Metrology Toolbox (Stone and Zimmerman), Ciddor equation, 450 ppm; printed to 1e-9:
# wavelength [nm], temperature [C], pressure [hPa], humidity, index
NIST = [
    (321.456, 20.0, 1013.25, 0.5, 1.000283543),
    (500.0, 20.0, 1013.25, 0.5, 1.000273781),
    (600.1234, 20.0, 1013.25, 0.5, 1.000271818),
    (633.0, 20.0, 1013.25, 0.5, 1.000271373),
    (1000.987, 20.0, 1013.25, 0.5, 1.000269038),
    (1500.8, 20.0, 1013.25, 0.5, 1.00026819),
    (633.0, -20.0, 1013.25, 0.5, 1.00031489),
    (633.0, 0.0, 1013.25, 0.5, 1.000291647),
    (633.0, 40.123, 1013.25, 0.5, 1.000253031),
    (633.0, 60.45, 1013.25, 0.5, 1.000235516),
    (633.0, 20.0, 100.0, 0.5, 1.000026385),
    (633.0, 20.0, 501.23, 0.5, 1.000133999),
    (633.0, 20.0, 1400.0, 0.5, 1.000375169),
    (633.0, 20.0, 1013.25, 0.0, 1.0002718),
    (633.0, 20.0, 1013.25, 1.0, 1.000270949),
]


@pytest.mark.parametrize(("wave", "celsius", "hpa", "humidity", "index"), NIST)
def test_ciddor_gives_the_values_of_the_nist_calculator(
    wave: float, celsius: float, hpa: float, humidity: float, index: float
) -> None:
    """Half a printed unit, and as much again: the calculator uses another formula for the saturation pressure."""
    assert float(air_index(wave, celsius, hpa, humidity=humidity, formula="ciddor")) == pytest.approx(index, abs=1e-9)


@pytest.mark.slow
def test_standard_air_of_other_authors() -> None:
    """Edlen 1953 (Penndorf 1957) is the same dispersion; Edlen 1966 and Peck-Reeder 1972 are later measurements."""
    rayleigh = pytest.importorskip("colour.phenomena.rayleigh")
    wave = np.linspace(350.0, 1000.0, 66)
    ours = air_index(wave, 15.0)
    assert ours == pytest.approx(rayleigh.air_refraction_index_Penndorf1957(wave * 1e-3), abs=1e-15)
    assert ours == pytest.approx(rayleigh.air_refraction_index_Edlen1966(wave * 1e-3), abs=2e-8)
    ciddor = air_index(wave, 15.0, formula="ciddor")
    assert ciddor == pytest.approx(rayleigh.air_refraction_index_Peck1972(wave * 1e-3), abs=2e-8)


@pytest.mark.parametrize("celsius", [-40.0, 0.0, 20.0, 60.0])
def test_the_two_formulas_agree_in_dry_air(celsius: float) -> None:
    wave = np.linspace(350.0, 1100.0, 31)
    difference = air_index(wave, celsius) - air_index(wave, celsius, formula="ciddor")
    assert np.abs(difference).max() < (5e-8 if celsius >= 0.0 else 2e-7)  # ideal gas against real gas in the cold


def test_air_thins_out_to_vacuum() -> None:
    for formula in ("kohlrausch", "ciddor"):
        assert float(air_index(550.0, 20.0, 0.0, formula=formula)) == 1.0  # type: ignore[arg-type]
        thin, thick = (float(air_index(550.0, 20.0, p, formula=formula)) - 1.0 for p in (1.0, 2.0))  # type: ignore[arg-type]
        assert thick == pytest.approx(2.0 * thin, rel=1e-5)
