"""The Moon's face: libration against an almanac's example, maria against published areas, earthshine against a star."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.time import Time

from optics.lens_file import load_lens
from optics.light.band import TopHat
from optics.light.magnitudes import photon_rate
from render.bodies.body_image import BodyRenderer
from render.bodies.lunar_map import HIGHLAND, MARE, lunar_map, moon_rotation
from render.bodies.planet_magnitudes import planet_spectrum
from render.bodies.solar_system import solar_system
from render.bodies.sunlit_body import planet_body, sphere_photons
from render.camera import Camera


def subearth_point_and_axis(epoch_year):
    """Longitude and latitude of the point below the Earth's centre, and position angle of the axis [deg]."""
    system, turn = solar_system(epoch_year, bodies=["moon"]), moon_rotation(epoch_year)
    x, y, z = (system.to_observer_au[0] / system.distance_au[0]) @ turn
    direction = system.direction[0]
    east = np.cross([0.0, 0.0, 1.0], direction)
    east /= np.linalg.norm(east)
    north = np.cross(direction, east)
    pole = turn[:, 2]
    angles = np.arctan2(y, x), np.arcsin(z), np.arctan2(pole @ east, pole @ north)
    return [float(np.degrees(a)) for a in angles]


def test_libration_against_meeus():
    """Astronomical Algorithms, 2nd ed., example 53.a: 1992 April 12, 0 h TD: l = -1.23, b = +4.20, P = 15.08 deg.

    P counts from the equator of date, 0.04 deg away from that of J2000 here.
    """
    longitude, latitude, axis = subearth_point_and_axis(Time("1992-04-12", scale="tt").tdb.jyear)
    assert longitude == pytest.approx(-1.23, abs=0.03)
    assert latitude == pytest.approx(4.20, abs=0.03)
    assert axis == pytest.approx(15.08, abs=0.06)


@pytest.mark.slow
def test_libration_over_years():
    """Its extremes are the published ones: 7.9 deg in longitude, 6.9 in latitude."""
    seen = np.array([subearth_point_and_axis(year)[:2] for year in np.linspace(2020.0, 2029.0, 300)])
    assert np.abs(seen).max(0) == pytest.approx([7.9, 6.8], abs=0.25)


def test_maria_cover_what_is_published():
    """31 % of the near side, 2.6 % of the far side; the seas are where they are."""
    albedo = lunar_map()
    rows, columns = albedo.shape
    latitude = np.radians(-90.0 + 180.0 / rows * (np.arange(rows) + 0.5))
    area = np.cos(latitude)[:, None] * np.ones(columns)
    near = np.abs(-180.0 + 360.0 / columns * (np.arange(columns) + 0.5)) < 90.0
    dark = albedo < 0.5 * (MARE + HIGHLAND)
    assert (area * dark)[:, near].sum() / area[:, near].sum() == pytest.approx(0.31, abs=0.05)
    assert (area * dark)[:, ~near].sum() / area[:, ~near].sum() == pytest.approx(0.026, abs=0.025)

    def at(lon, lat):
        return albedo[int((lat + 90.0) / 180.0 * rows), int((lon + 180.0) / 360.0 * columns)]

    assert max(at(59.1, 17.0), at(17.5, 28.0), at(-57.4, 18.4)) < 0.095  # Crisium, Serenitatis, Procellarum
    assert min(at(0.0, -60.0), at(20.0, -35.0), at(150.0, 0.0)) > 0.11  # the southern highlands, the far side


def test_earthshine_of_the_whole_disk():
    """At new Moon, where the Earth is full: 12 to 17 mag per square arcsecond.

    P. Montanes-Rodriguez, E. Palle and P. R. Goode, AJ 134, 1145 (2007), over all phases; brightest at new Moon.
    """
    body = planet_body(solar_system(Time("2021-10-06T11:05", scale="tt").tdb.jyear, bodies=["moon"]), "moon")
    light = body.second_light
    lit = sphere_photons(replace(body, to_sun=light.towards, second_light=None), [550.0]) * light.irradiance
    magnitude = -2.5 * np.log10(lit / photon_rate(planet_spectrum("moon"), 0.0, wavelength_nm=np.array([550.0])))
    area = np.pi * (3600.0 * np.degrees(body.angular_radius_rad)) ** 2
    assert 12.0 < float(magnitude[0]) + 2.5 * np.log10(area) < 14.5


@pytest.mark.slow
def test_phase_map_and_earthshine_through_a_lens(engine):
    """A crescent: the dark part of the disk shows the Earth's light and the maria."""
    epoch = Time("2021-10-10", scale="tt").tdb.jyear  # four days after new Moon
    system = solar_system(epoch, bodies=["moon"])
    assert 120.0 < np.degrees(system.phase_rad[0]) < 150.0
    body = planet_body(system, "moon")
    axis = system.direction[0]
    right = np.cross([0.0, 0.0, 1.0], axis)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(axis, right), axis])
    camera = Camera(lens=load_lens("star_tracker_26mm"), width_px=120, height_px=120, pixel_pitch_mm=3e-3)
    band = (TopHat(centre_nm=550.0, width_nm=80.0),)
    image = BodyRenderer(camera, band).render(body, exposure_s=1e-3, rotation_cam_from_icrs=turn)
    electrons = image.image.electrons[..., 0].astype(float)
    assert body.second_light is not None
    row, column = np.indices(electrons.shape)
    focal_px = 26.0 / 3e-3
    x, y = (column - 59.5) / focal_px, (row - 59.5) / focal_px
    on_disk = np.hypot(x, y) < 0.9 * body.angular_radius_rad
    v = x[..., None] * turn[0] + y[..., None] * turn[1] + axis
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    along = v @ axis
    reach = along - np.sqrt(np.maximum((body.radius_km / body.distance_km) ** 2 - (1 - along**2), 0.0))
    normal = reach[..., None] * v - axis
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    night = on_disk & (normal @ body.to_sun < -0.25)
    day = electrons[on_disk & (normal @ body.to_sun > 0.25)].mean()
    assert night.sum() > 300
    # the Earth of T. D. Robinson, Planet. Sci. J. 7, 12 (2026), eq. 14; Sun V = -26.76 (Willmer 2018). The surface is
    # brighter in light that comes from behind the observer: ROLO's disk at 549 nm without libration (H. H. Kieffer and
    # T. C. Stone, AJ 129, 2887 (2005)), Allen's law beyond 97 deg, against a sphere after Lommel and Seeliger
    phase = np.degrees(system.phase_rad[0])
    earth = np.radians(180.0 - phase)
    lobe = (0.67**2 / (1.0 + 0.33**2 - 0.66 * np.cos(earth))) ** 1.5
    share = 0.23 * lobe * (6371.0 / (system.distance_au[0] * 149597870.7)) ** 2

    def rolo(degrees):
        g = np.radians(degrees)
        log = -2.10782 - 1.66736 * g + 0.41697 * g**2 - 0.22026 * g**3
        return np.exp(log + 0.36814 * np.exp(-degrees / 4.06054) - 0.09815 * np.exp(-degrees / 12.8802))

    half = np.radians(0.5 * phase)
    sphere = 1.0 - np.sin(half) * np.tan(half) * np.log(1.0 / np.tan(0.5 * half))
    beyond = 10 ** (-0.4 * (0.026 * (phase - 97.0) + 4e-9 * (phase**4 - 97.0**4)))
    expected = share * rolo(0.0) / rolo(97.0) / beyond * sphere
    assert body.second_light.irradiance == pytest.approx(expected, rel=0.15)  # the map's part that is lit differs
    # 12 to 17 mag per square arcsecond in V (P. Montanes-Rodriguez, E. Palle and P. R. Goode, AJ 134, 1145 (2007))
    arcsec2 = np.degrees(3600.0 / focal_px) ** 2
    dark = system.magnitude_v[0] - 2.5 * np.log10(electrons[night].mean() / electrons.sum() / arcsec2)
    assert 12.0 < dark < 17.0
    assert 5e-5 < electrons[night].mean() / day < 2e-3
    # maria: the eastern limb's Crisium lies on the night side no more; contrast of the dark part is that of the map
    spread = electrons[night].std() / electrons[night].mean()
    assert 0.08 < spread < 0.5
