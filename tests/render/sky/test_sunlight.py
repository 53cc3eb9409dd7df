"""The Sun's spectrum against its published magnitudes and the solar constant."""

import numpy as np
import pytest

from optics.light.magnitudes import synthetic_magnitude
from render.sky.sunlight import sun_spectrum, sunlight


def test_magnitudes_of_the_sun():
    # C. N. A. Willmer, ApJS 236, 47 (2018), table 3: V = -26.76; L. Casagrande and D. A. VandenBerg, MNRAS 479, L102
    # (2018): G = -26.90 +- 0.01
    assert synthetic_magnitude(sun_spectrum(), system="V") == pytest.approx(-26.76, abs=0.01)
    assert synthetic_magnitude(sun_spectrum(), system="G") == pytest.approx(-26.90, abs=0.015)


def test_energy_of_the_fine_spectrum_is_kept():
    sun = sun_spectrum()
    # the part of ASTM G173-03's 1347.9 W/m^2 between 285 and 1300 nm, by the trapezoids of its 0.5 and 1 nm steps
    assert 1e6 * np.trapezoid(sun.value, sun.wavelength_nm) == pytest.approx(1109.10, rel=1e-4)


def test_four_times_weaker_at_twice_the_distance():
    assert sunlight(600.0, distance_au=2.0) == pytest.approx(sunlight(600.0) / 4, rel=1e-12)
