"""The obliquity convention of the sum of plane waves against vector diffraction of an aplanatic lens.

Richards & Wolf 1959, Proc. R. Soc. A 253, 358, eqs. 3.18, 3.20 and 3.24: a pixel takes the flux through its plane, the
z component of the mean Poynting vector, of an unpolarised star.
"""

import numpy as np
import pytest
from ideal_pupil import ideal_pupil
from scipy.special import jv

WAVE_MM = 550e-6


def vector(sine: float, r_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flux and |E|^2 (both of all light of the flux) at distances from the focus."""
    node, weight = np.polynomial.legendre.leggauss(200)
    theta, weight = 0.5 * np.arcsin(sine) * (1.0 + node), 0.5 * np.arcsin(sine) * weight
    c, s = np.cos(theta), np.sin(theta)
    k_r = 2.0 * np.pi / WAVE_MM * r_mm[:, None] * s
    parts = ((1.0 + c, 0), (s, 1), (1.0 - c, 2))
    i0, i1, i2 = ((jv(m, k_r) * np.sqrt(c) * s * f) @ weight for f, m in parts)
    scale = np.pi / (WAVE_MM**2 * sine**2)
    return scale * (i0**2 - i2**2), scale * (i0**2 + i2**2 + 2.0 * i1**2)


@pytest.mark.parametrize(
    ("f_number", "error", "density"), [(2.95, 5e-5, 0.007), (1.4, 6e-4, 0.033), (1.0, 2e-3, 0.066)]
)
def test_flux_of_an_unpolarised_star(f_number: float, error: float, density: float) -> None:
    """Peak and rings; the energy density |E|^2, which no pixel takes, peaks lower."""
    sine = 0.5 / f_number
    r = np.linspace(0.0, 3.0 * WAVE_MM * f_number, 61)
    ours = ideal_pupil(sine, order=(40, 64), index=1.0).intensity(r, np.zeros(1))[0]
    flux, energy = vector(sine, r)
    assert np.abs(ours - flux).max() < error * flux[0]
    # both hold all light: that of |E|^2 is larger by the mean of 1 / cos
    theta = np.arcsin(sine)
    light = 2.0 * (1.0 - np.cos(theta)) / sine**2
    assert 1.0 - energy[0] / light / flux[0] == pytest.approx(density, abs=0.002)
