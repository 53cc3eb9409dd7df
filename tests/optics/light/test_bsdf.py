"""Scatter: published figures, integrals by quadrature, and counts of particles summed size by size."""

import numpy as np
import pytest
from lens_texts import table_lens
from scipy.integrate import quad

from optics.glass.catalogue import get_glass
from optics.light import bsdf


def test_roughness() -> None:
    """A mirror of 5 nm at 500 nm scatters 0.015791 (example of the program FRED), a lens (n - 1)^2 / 4 of it."""
    assert float(bsdf.roughness_tis(5.0, 500.0, 1.0, -1.0)) == pytest.approx(0.015791, abs=5e-7)
    assert float(bsdf.roughness_tis(5.0, 500.0, 1.0, 1.5)) == pytest.approx(0.015791 / 16.0, rel=1e-4)
    cosine = np.cos(np.radians(60.0))
    assert float(bsdf.roughness_tis(5.0, 500.0, 1.0, -1.0, cosine)) == pytest.approx(0.015791 / 4.0, rel=1e-4)


@pytest.mark.parametrize(
    "law",
    [
        bsdf.HarveyShack(b0=3.0, shoulder=0.02, slope=-1.5),
        bsdf.HarveyShack(b0=3.0, shoulder=0.02, slope=-2.0),
        bsdf.HarveyShack(b0=0.1, shoulder=0.3, slope=-2.7),
        bsdf.ABg(a=1e-3, b=1e-4, g=2.0),
        bsdf.ABg(a=1e-3, b=1e-2, g=1.4),
        bsdf.ABg(a=1e-5, b=1e-5, g=2.6),
    ],
)
def test_total_scatter_is_the_integral_over_the_hemisphere(law: bsdf.HarveyShack | bsdf.ABg) -> None:
    integral = quad(lambda log: 2.0 * np.pi * np.exp(2.0 * log) * float(law.bsdf(np.exp(log))), -30.0, 0.0, limit=400)
    assert law.tis == pytest.approx(integral[0], rel=1e-9)


@pytest.mark.parametrize("level", [100.0, 300.0, 750.0])
def test_area_coverage_is_the_sum_over_particles(level: float) -> None:
    """Disks counted in 200 000 classes of size; the largest particle at its own size."""
    edges = np.geomspace(1.0, level, 200_001)
    number = bsdf.particles_per_mm2(level, edges)
    middle = np.sqrt(edges[1:] * edges[:-1])
    covered = 0.25e-6 * np.pi * (np.sum(middle**2 * (number[:-1] - number[1:])) + level**2 * number[-1])
    assert bsdf.area_coverage(level) == pytest.approx(covered, rel=1e-6)
    assert number[-1] * 1e5 == pytest.approx(1.0)


def test_a_lens_scatters_what_its_surfaces_do() -> None:
    """A plate: twice (n - 1)^2 / 4 of the mirror's 0.015791; behind a mirror, that as well."""
    face = {"kind": "plane", "thickness_mm": 5.0, "semi_diameter_mm": 10.0}
    plate = [{**face, "medium": "N-BK7", "stop": True}, {**face, "medium": "air"}]
    both = 0.5 * (float(get_glass("N-BK7").index(500.0)) - 1.0) ** 2
    fold = {**face, "medium": "mirror", "thickness_mm": -5.0}
    for surfaces, mirrors in ((plate, both), ([*plate, fold], both + 1.0)):
        assert bsdf.lens_scatter(table_lens(*surfaces), 5.0, 500.0) == pytest.approx(0.015791 * mirrors, rel=1e-3)


@pytest.mark.parametrize("level", [50.0, 300.0, 700.0])
def test_dust_diffracts_as_much_as_it_covers(level: float) -> None:
    """Babinet: the integral of the diffracted light is the coverage, which is summed elsewhere in closed form."""
    law = bsdf.Particles(level=level, wavelength_nm=600.0, forward=0.0)
    delta = np.append(0.0, np.geomspace(1e-8, 4.0, 8000))
    light = np.trapezoid(2.0 * np.pi * delta * law.bsdf(delta), delta)
    assert light == pytest.approx(bsdf.area_coverage(level), rel=5e-3)
    assert law.tis == pytest.approx(bsdf.area_coverage(level), rel=1e-12)


def test_dust_of_one_size_is_an_airy_disk_and_what_it_throws_on_is_even() -> None:
    """At level 1 all particles are 1 um wide: n (pi D^2 / 4 lambda)^2 straight on, half of it where Airy has it."""
    law = bsdf.Particles(level=1.0, wavelength_nm=500.0, forward=0.0)
    count = 1e-5 * 1.0  # one particle on 0.1 m^2, counted twice: as the distribution and as the largest
    straight = (np.pi * 1e-6 / 4.0 / 5e-4) ** 2
    assert float(law.bsdf(0.0)) == pytest.approx(count * straight, rel=0.01)
    assert float(law.bsdf(1.6163 / np.pi * 0.5) / law.bsdf(0.0)) == pytest.approx(0.5, abs=0.01)
    bare, bright = (bsdf.Particles(level=300.0, wavelength_nm=600.0, forward=g) for g in (0.0, 0.8))
    apart = bright.bsdf([0.01, 0.5]) - bare.bsdf([0.01, 0.5])
    np.testing.assert_allclose(apart, 0.8 * bsdf.area_coverage(300.0) / np.pi, rtol=1e-9)


def test_a_polished_surface_scatters_what_it_is_told() -> None:
    for slope in (-1.5, -2.0, -3.0):
        assert bsdf.polished(0.0123, 0.02, slope).tis == pytest.approx(0.0123, rel=1e-12)
