"""Colours BP-RP of black bodies through the Gaia DR3 passbands: makes render/data/blackbody_colours.csv.

    python docs/make_blackbody_colours.py passband.dat > render/data/blackbody_colours.csv

``passband.dat`` is table J/A+A/649/A3 of Riello et al., A&A 649, A3 (2021), at CDS: wavelength [nm] and transmissivity
of G, BP and RP, each followed by its uncertainty, 99.99 where undefined.
"""

from __future__ import annotations

import sys

import numpy as np

from optics.light.spectrum import Blackbody

ZERO_POINT_BP, ZERO_POINT_RP = 25.3385422158, 24.7478955012  # VEGAMAG, zeropt.dat of the same table
COLDEST_K, HOTTEST_K, ROWS = 1000.0, 60000.0, 96


def main(path: str) -> None:
    """Print the table."""
    table = np.loadtxt(path, usecols=(0, 3, 5))
    wavelength = table[:, 0]
    blue, red = (np.where(column > 90.0, 0.0, column) for column in table[:, 1:].T)
    print("# BP-RP (Gaia DR3, VEGAMAG) of black bodies; made by docs/make_blackbody_colours.py")
    print("# Passbands and zero points: Riello et al., A&A 649, A3 (2021), table J/A+A/649/A3 (ESA/Gaia/DPAC)")
    print("# Rows equally spaced in 1/T, for linear interpolation of 1/T against BP-RP")
    print("temperature_k,bp_rp_mag")
    for inverse in np.linspace(1.0 / HOTTEST_K, 1.0 / COLDEST_K, ROWS):
        photons = Blackbody(temperature_k=1.0 / inverse).photon_density(wavelength)
        ratio = np.trapezoid(photons * blue, wavelength) / np.trapezoid(photons * red, wavelength)
        print(f"{1.0 / inverse:.6g},{-2.5 * np.log10(ratio) + ZERO_POINT_BP - ZERO_POINT_RP:.5f}")


if __name__ == "__main__":
    main(sys.argv[1])
