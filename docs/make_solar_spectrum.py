"""The Sun's spectrum outside the atmosphere in steps of 5 nm: makes render/data/solar_spectrum.csv.

    python docs/make_solar_spectrum.py > render/data/solar_spectrum.csv

From the extraterrestrial column of ASTM G173-03 (C. A. Gueymard's synthesis; NREL), which colour-science carries. Each
value is the mean under a triangle that reaches to its neighbours, so that straight lines between the values hold the
energy of the fine spectrum.
"""

from __future__ import annotations

import numpy as np
from colour.plotting.datasets.astm_g_173 import SD_ASTMG173_ETR

FIRST_NM, LAST_NM, STEP_NM = 285, 1300, 5


def main() -> None:
    """Print the table."""
    wavelength, value = SD_ASTMG173_ETR.wavelengths, SD_ASTMG173_ETR.values
    offset = np.linspace(-STEP_NM, STEP_NM, 201)
    weight = 1.0 - np.abs(offset) / STEP_NM
    print("# Solar spectral irradiance at 1 au [W m^-2 nm^-1]; made by docs/make_solar_spectrum.py")
    print("# ASTM G173-03, extraterrestrial, averaged under triangles of 5 nm half width")
    for at in range(FIRST_NM, LAST_NM + 1, STEP_NM):
        print(f"{at},{np.average(np.interp(at + offset, wavelength, value), weights=weight):.4f}")


if __name__ == "__main__":
    main()
