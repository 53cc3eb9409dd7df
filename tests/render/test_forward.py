"""`StarRenderer`: many fields through one camera, as expected images with their truth."""

from dataclasses import replace

import numpy as np
import pytest

from optics.errors import DomainError
from render.forward import StarRenderer, render_stars
from render.tracing.tracer import Tracer


@pytest.fixture
def small(engine, bench):
    """A camera with a small film, and the whole camera it was cut from."""
    whole = bench.camera_of()
    return bench.window(whole, 120, 3000, 500), whole


def test_image_and_truth_are_those_of_the_tracer(engine, bench, small):
    camera, whole = small
    stars = bench.stars_at(whole, [2990.2, 3010.4], [500.3, 520.1], bands=((500.0, 50.0), (800.0, 100.0)))
    renderer = StarRenderer(camera, exposure_s=0.1)
    image = renderer.render(stars)
    traced = Tracer(camera).render(stars, exposure_s=0.1)
    assert np.array_equal(image.electrons, traced.electrons)
    for name in image.truth.__dataclass_fields__:
        assert np.array_equal(getattr(image.truth, name), getattr(traced.truth, name))
    assert (image.band, image.exposure_s, image.diffused) == (("500", "800"), 0.1, True)
    assert renderer.traced.sampling == traced.sampling == {"quadrature": (2, traced.sampling["quadrature"][1])}


def test_fields_do_not_influence_each_other(engine, bench, small):
    camera, whole = small
    first = bench.stars_at(whole, [2990.2], [500.3])
    second = bench.stars_at(whole, [3010.4, 2950.1], [520.1, 480.2], bands=((500.0, 50.0), (800.0, 100.0)))
    renderer = StarRenderer(camera)
    a, b, again = renderer.render(first), renderer.render(second), renderer.render(first)
    assert np.array_equal(a.electrons, again.electrons)
    assert np.array_equal(b.electrons, render_stars(camera, second).electrons)
    assert not a.electrons.flags.writeable


def test_camera_with_a_band_name_that_holds_a_comma(engine, bench, small):
    camera, whole = small
    stars = replace(bench.stars_at(whole, 3000.0, 500.0), band=("V, narrow",))
    assert render_stars(camera, stars).band == ("V, narrow",)


def test_errors_come_out_as_they_are_raised(engine, bench, small):
    """Not wrapped by Mitsuba: one line, of the library's own kind."""
    camera, whole = small
    stars = bench.stars_at(whole, 3000.0, 500.0)
    renderer = StarRenderer(camera)
    with pytest.raises(DomainError, match="star 0 lies behind the camera"):
        renderer.render(replace(stars, direction=-stars.direction))
    with pytest.raises(DomainError, match=r"glass N-FK51A.*wavelength 5000 nm is outside"):
        renderer.render(replace(stars, wavelength_nm=np.full_like(stars.wavelength_nm, 5000.0)))
    assert renderer.render(stars).electrons.sum() > 0  # still of use
