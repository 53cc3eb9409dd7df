"""The Earth's limb beside a radiative transfer code, and its terminator."""

import numpy as np
import pytest

from optics.lens_file import load_lens
from optics.light.band import TopHat
from render.bodies.body_image import render_body
from render.bodies.earth_air import earth_air
from render.bodies.sunlit_body import SunlitBody
from render.camera import Camera

EARTH_KM, DISTANCE_KM = 6371.0, 7000.0
PITCH_MM, FOCAL_MM = 12e-3, 26.0
HEIGHT_KM = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
# pi times the radiance over the Sun's irradiance by SASKTRAN2 2026.10 (spherical, discrete ordinates with 16 streams,
# US standard atmosphere 1976, Rayleigh scattering alone, Lambertian ground of albedo 0.3), azimuth of the Sun 90 deg
SASKTRAN = {
    (400.0, 30.0): (0.3831, 0.2952, 0.1035, 0.0268, 0.0074),
    (550.0, 30.0): (0.2969, 0.1163, 0.0288, 0.0068, 0.0018),
    (800.0, 30.0): (0.1154, 0.0287, 0.0063, 0.0015, 0.0004),
    (550.0, 80.0): (0.2018, 0.0834, 0.0209, 0.0050, 0.0013),
}


def column_of(zenith_deg, wavelength_nm, *, to_sun=None, **changes):
    """One column of an image whose rows cross the limb, over that of a white surface lit square on; heights."""
    camera = Camera(
        lens=load_lens("star_tracker_26mm"), width_px=3, height_px=90, pixel_pitch_mm=PITCH_MM, charge_diffusion_px=0.0
    )
    angle = np.arcsin((EARTH_KM + 20.0) / DISTANCE_KM)
    z = np.radians(zenith_deg)
    settings = {
        "direction": np.array([0.0, np.sin(angle), np.cos(angle)]),
        "distance_km": DISTANCE_KM,
        "to_sun": np.array([np.sin(z), -np.cos(z), 0.0]),
        "radius_km": EARTH_KM,
        "albedo": [0.3],
        "air": earth_air(),
    }
    band = (TopHat(centre_nm=wavelength_nm, width_nm=2.0),)
    exposed = {"exposure_s": 1e-4, "nodes": 1, "ceiling_e": 1e12}
    image = render_body(camera, SunlitBody(**(settings | changes)), band, **exposed)
    ahead = {"direction": np.array([0.0, 0.0, 1.0]), "to_sun": np.array([0.0, 0.0, -1.0]), "albedo": [1.0]}
    white = render_body(camera, SunlitBody(**(settings | ahead)), band, **exposed)
    rows = np.arange(90)
    height = DISTANCE_KM * np.sin(angle - np.arctan((rows - 44.5) * PITCH_MM / FOCAL_MM)) - EARTH_KM
    return image.image.electrons[:, 1, 0] / white.image.electrons[44, 1, 0], height


@pytest.mark.parametrize(
    ("wavelength_nm", "zenith_deg"),
    [(550.0, 80.0), *(pytest.param(*key, marks=pytest.mark.slow) for key in SASKTRAN if key != (550.0, 80.0))],
)
def test_limb_against_sasktran(engine, wavelength_nm, zenith_deg):
    found, height = column_of(zenith_deg, wavelength_nm)
    order = np.argsort(height)
    there = np.exp(np.interp(HEIGHT_KM, height[order], np.log(found[order])))
    assert there == pytest.approx(np.array(SASKTRAN[wavelength_nm, zenith_deg]), rel=0.3)
    assert found[order][-1] < 0.02 * there[0]


@pytest.mark.slow
def test_light_ends_behind_the_terminator(engine):
    """Twilight: 5 deg behind it the Sun still lights the air from 24 km on, 12 deg behind it nothing below 140 km."""
    lit, height = column_of(95.0, 550.0)
    assert lit[height > 0.0].max() > 1e-5
    dark, height = column_of(102.0, 550.0)
    assert dark[height > 0.0].max() < 1e-8
