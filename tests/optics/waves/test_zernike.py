"""Numbering against the published tables, orthonormality by quadrature, fits, maps."""

import numpy as np
import pytest

from optics import gauss_disk, load_lens, trace_pupil, wavefront, zernike_map
from optics.waves.zernike import fit_zernikes, zernike_numbers, zernikes


def test_numbering_is_that_of_the_published_tables():
    noll = zernike_numbers(22)  # Noll 1976, table I, and OpticStudio's list of standard terms
    assert noll[:11] == ((0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0))
    assert noll[21] == (6, 0)
    ansi = zernike_numbers(13, "ansi")
    assert ansi[:6] == ((0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2))
    assert ansi[12] == (4, 0)
    fringe = zernike_numbers(37, "fringe")
    assert fringe[:9] == ((0, 0), (1, 1), (1, -1), (2, 0), (2, 2), (2, -2), (3, 1), (3, -1), (4, 0))
    assert fringe[15] == (6, 0)
    assert fringe[16] == (4, 4)
    assert fringe[24] == (8, 0)
    assert fringe[35:] == ((10, 0), (12, 0))


def test_polynomials_are_orthonormal_known_and_fitted_again():
    disk = gauss_disk(12, 32)
    terms = zernikes(disk.x, disk.y, 45)
    assert (terms * disk.weight) @ terms.T == pytest.approx(np.eye(45), abs=1e-13)
    rim = zernikes(np.ones(1), np.zeros(1), 37, "fringe")[:, 0]
    assert rim == pytest.approx([0.0 if m < 0 else 1.0 for _, m in zernike_numbers(37, "fringe")], abs=1e-12)
    x, y = 0.3, -0.5
    r2 = x * x + y * y
    spherical, coma_y = (zernikes(np.array([x]), np.array([y]), 11)[j - 1, 0] for j in (11, 7))
    assert spherical == pytest.approx(np.sqrt(5.0) * (6.0 * r2**2 - 6.0 * r2 + 1.0))
    assert coma_y == pytest.approx(np.sqrt(8.0) * (3.0 * r2 - 2.0) * y)
    disk = gauss_disk(6, 16)
    value = 3.0 * zernikes(disk.x, disk.y, 8)[7]
    assert fit_zernikes(disk.x, disk.y, value, disk.weight, 11) == pytest.approx(3.0 * (np.arange(11) == 7), abs=1e-12)


@pytest.mark.parametrize("order", ["noll", "ansi", "fringe"])
def test_a_map_of_coefficients_is_found_again_in_the_wavefront(order):
    lens = load_lens("star_camera_206mm")
    field = trace_pupil(lens, 2.0, 0.0, 600.0, order=(12, 40))
    error = np.linspace(5.0, 25.0, 15)
    error[:3] = 0.0  # piston, and tilt, which the reference point takes up
    before, after = (wavefront(f).zernike_nm(21, order) for f in (field, zernike_map(error, order).added_to(field)))
    assert (after - before)[3:15] == pytest.approx(error[3:], abs=0.2)
