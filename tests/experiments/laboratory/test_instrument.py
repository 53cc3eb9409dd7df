"""The instrument as configuration: lens, detector, focus, coatings."""

import numpy as np
import pytest

from experiments.laboratory.instrument import build_instrument
from experiments.laboratory.settings import InstrumentConfig
from optics.errors import ConfigError
from optics.lens.perturb import decentre


def test_default_is_the_camera_of_the_publication(star_camera):
    camera = star_camera.camera
    assert (camera.width_px, camera.height_px) == (4096, 2048)
    assert star_camera.focal_length_mm == pytest.approx(206.2, abs=0.1)  # printed with the lens
    assert star_camera.pixel_arcsec == pytest.approx(5.5, abs=0.01)  # ACC18: 5.5 arcsec per pixel
    assert star_camera.pixel_arcsec == pytest.approx(206264.806 * 5.5e-3 / star_camera.focal_length_mm, rel=1e-7)


def test_defocus_moves_the_detector_away_from_the_lens(star_camera):
    moved = build_instrument(InstrumentConfig(defocus_mm=0.25)).camera.focused_lens.image_position_mm
    base = star_camera.camera.lens.image_position_mm
    assert moved - base == pytest.approx([0, 0, 0.25], abs=1e-12)


def test_coatings_let_more_light_through():
    wavelength = np.array([450.0, 550.0, 700.0, 900.0])
    coated = build_instrument(InstrumentConfig()).camera.response_at(wavelength)
    bare = build_instrument(InstrumentConfig(coating_nm=0.0)).camera.response_at(wavelength)
    assert np.all(coated > bare)
    assert np.argmax(coated / bare) == 1  # most at the coatings' design wavelength of 550 nm
    assert np.all((bare > 0) & (coated < 1))


def test_perturbed_copy_keeps_the_nominal_focal_length(star_camera):
    lens = star_camera.camera.lens
    moved = build_instrument(InstrumentConfig(), decentre(lens, "L2", 0.1))
    assert moved.focal_length_mm == star_camera.focal_length_mm
    at = lens.indices_of("L2")[0]
    assert moved.camera.lens.surfaces[at].position_mm - lens.surfaces[at].position_mm == pytest.approx([0.1, 0, 0])


@pytest.mark.parametrize(
    ("settings", "said"),
    [({"lens": "star_camera_206"}, "star_camera_206mm"), ({"detector": "acc18_mosiac"}, "acc18_mosaic")],
)
def test_unknown_name_brings_the_nearest(settings, said):
    with pytest.raises(ConfigError, match=said):
        build_instrument(InstrumentConfig(**settings))
