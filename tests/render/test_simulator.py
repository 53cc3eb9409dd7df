"""Frames of the sky by name and angles: where astropy says that stars are, with the light that a catalogue says."""

import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from astropy.coordinates import SkyCoord, get_body
from astropy.time import Time
from scipy.spatial.transform import Rotation

from optics.attitude import attitude_from_angles
from optics.frame_html import Marks
from optics.lens.heated_lens import Housing, ThermalState, heated_lens
from optics.light.magnitudes import photon_rate
from optics.light.spectrum import Blackbody
from optics.rays.vignetting import collecting_area_mm2
from render.bodies.solar_system import solar_system
from render.bodies.sunlit_body import planet_body, sphere_photons
from render.sensor_file.load import load_star_sensor
from render.simulator import SkySimulator, observe
from render.sky.sky import load_sky

ORION = (83.8, -1.2)


@pytest.fixture(scope="module")
def sensor():
    return load_star_sensor("star_tracker_26mm", "cmv4000", window_px=512, diffraction="rays")


@pytest.fixture(scope="module")
def sky():
    return load_sky(faintest_mag=6.0)


@pytest.fixture(scope="module")
def simulator(sensor, sky):
    return SkySimulator(sensor, sky, exposure_s=0.1, seed=3)


@pytest.fixture(scope="module")
def observation(simulator):
    return simulator.observe(attitude_from_angles(*ORION, 90.0))


@pytest.mark.parametrize(
    ("rate_deg_per_s", "digest"), [(None, "b1934363e5607c93"), ((0.0, 0.1, 0.02), "ca9447c4d6d0c99d")]
)
def test_same_settings_and_seed_same_bytes(rate_deg_per_s, digest):
    small, settings = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=(128, 96)), {"zodiacal": True}
    settings |= {"exposure_s": 0.1, "seed": 3, "nodes": 3, "background_e_per_s": 20.0}
    towards = attitude_from_angles(*ORION)
    frame = observe(small, towards, load_sky(faintest_mag=8.0), rate_deg_per_s=rate_deg_per_s, **settings).frame
    assert hashlib.sha256(frame.dn.tobytes()).hexdigest()[:16] == digest


def test_the_belt_of_orion_is_where_astropy_puts_it(observation, sensor):
    """Tangent plane by astropy's offsets, roll 90 deg: up in the image is east, so a step north goes along +x."""
    table = observation.to_table()
    belt = table[np.argsort(table["magnitude"])[:3]]
    offset = SkyCoord(belt["ra"], belt["dec"]).transform_to(SkyCoord(*ORION, unit="deg").skyoffset_frame())
    north = np.tan(offset.lat.rad) / np.cos(offset.lon.rad)
    east = np.tan(offset.lon.rad)
    scale = 3600 * np.degrees(1.0) / sensor.pixel_arcsec
    expected = np.column_stack([255.5 + scale * north, 255.5 - scale * east])
    found = np.column_stack([belt["photon_x"], belt["photon_y"]])
    assert np.abs(found - expected).max() < 0.4  # px at 100 px from the axis: distortion, focus
    assert np.ptp(found, axis=0).max() > 100


def test_light_is_the_integral_over_the_pass_band(observation, sensor):
    """Electrons of every star against a sum over 1 nm steps; the rendering has 6 wavelengths."""
    table, wavelength = observation.to_table(), np.arange(400.5, 1000.0)
    through = sensor.passband().transmission(wavelength) * sensor.camera.response_at(wavelength)
    area_mm2 = collecting_area_mm2(sensor.camera.focused_lens)
    cosine = observation.field.direction @ observation.attitude.as_matrix()[2]
    for star in range(len(table)):
        sed = Blackbody(temperature_k=float(table["temperature"][star]))
        rate = photon_rate(sed, float(table["magnitude"][star]), wavelength_nm=wavelength, system="G")
        electrons = (rate * through).sum() * area_mm2 * cosine[star] * 0.1
        assert table["electrons_in"][star] == pytest.approx(electrons, rel=1e-2)


def test_a_master_dark_is_the_pattern_without_the_noise(simulator, sensor):
    dark = simulator.dark_dn(frames=4)
    one = simulator.dark_dn(frames=1)
    assert dark.shape == sensor.detector.shape
    assert np.median(dark) == pytest.approx(sensor.detector.offset_dn, abs=10)
    assert np.median(np.abs(one - dark)) > 0


def test_axes_show_the_frame_without_pyplot(observation):
    axes = observation.show(brightest=3)
    assert axes.get_ylim() == (511.5, -0.5)  # row 0 on top
    assert len(axes.texts) == 3
    assert observation.show(axes) is axes


@pytest.mark.slow
def test_moon_and_planets_are_where_astropy_puts_them(sensor):
    """Venus stands behind the Moon and is hidden; Jupiter is a point; the Moon's light is that of its spectrum."""
    epoch = 2019.0834474
    sky = load_sky(faintest_mag=4.0, epoch_year=epoch, observer="earth")
    simulator = SkySimulator(sensor, sky, exposure_s=2e-4, bodies=["moon", "venus", "jupiter"])
    time = Time(epoch, format="jyear", scale="tdb")
    for target, shown in (("moon", {"moon"}), ("jupiter", {"jupiter"})):
        seen = get_body(target, time, ephemeris="builtin")
        observation = simulator.observe(attitude_from_angles(seen.ra.deg, seen.dec.deg))
        assert set(observation.bodies) == shown
        x, y, electrons = observation.bodies[target]
        assert np.hypot(x - 255.5, y - 255.5) < (25.0 if target == "moon" else 0.7)  # half a crescent; focus
        assert observation.expected.electrons.sum() == pytest.approx(electrons, rel=1e-3)
        if target == "moon":
            wavelength = np.arange(400.5, 1000.0)
            through = sensor.passband().transmission(wavelength) * sensor.camera.response_at(wavelength)
            moon = planet_body(solar_system(epoch, observer=sky.observer, bodies=["moon"]), "moon")
            light = (sphere_photons(moon, wavelength) * through).sum()
            assert electrons == pytest.approx(light * collecting_area_mm2(sensor.camera.focused_lens) * 2e-4, rel=0.01)


def test_its_page_holds_the_frame_the_truth_and_the_errors_of_what_was_measured(observation, tmp_path):
    truth = observation.truth
    places = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
    apart = np.sort(np.linalg.norm(places[:, None] - places[None], axis=2), axis=1)[:, 1]
    bright = np.argsort(-np.where(apart > 5, truth.electrons_image[:, 0], -1.0))[:5]  # no doubles
    x, y = places[bright].T
    measured = Marks(name="measured", x_px=x + 0.25, y_px=y)
    page = observation.save_page(tmp_path / "page.html", [measured]).read_text(encoding="utf-8")
    told = json.loads(re.search(r'id="meta">(.*?)</script>', page, re.DOTALL)[1])
    true, own, errors = told["layers"]
    assert {round(one, 4) for one in x} <= set(true["x"])
    assert own["name"] == "measured"
    assert errors["dx"] == [0.25] * 5
    assert errors["dy"] == [0.0] * 5


class Accelerating:
    """About cam y from rest, evenly faster."""

    start_s, end_s = 0.0, 1.0

    def __init__(self, towards, rad_per_s2):
        self.towards, self.rad_per_s2 = towards, rad_per_s2

    def attitude(self, time_s):
        angle = 0.5 * self.rad_per_s2 * np.asarray(time_s, float) ** 2
        return Rotation.from_rotvec(angle[..., None] * np.array([0.0, 1.0, 0.0])) * self.towards

    def rate(self, time_s):
        return -self.rad_per_s2 * np.asarray(time_s, float)[..., None] * np.array([0.0, 1.0, 0.0])


@pytest.mark.slow
def test_an_accelerated_motion_moves_the_light(sensor, sky):
    """By a t^2 / 24: half of the acceleration times the variance of the time."""
    simulator = SkySimulator(sensor, sky, exposure_s=0.2, seed=3)
    towards = attitude_from_angles(ra_deg=ORION[0], dec_deg=ORION[1], roll_deg=30.0)
    pixel_rad = np.radians(sensor.pixel_arcsec / 3600.0)
    faster = 3.0 * pixel_rad * 24.0 / 0.2**2  # 3 px
    path = Accelerating(towards, faster)
    seen = simulator.observe(path)
    still = simulator.observe(path.attitude(0.1))
    row = dict(zip(seen.field.row.tolist(), range(len(seen.field)), strict=True))
    common = [k for k, one in enumerate(still.field.row.tolist()) if one in row and middle_of(still, k)]
    shift = [seen.truth.photon_x_px[row[still.field.row[k]], 0] - still.truth.photon_x_px[k, 0] for k in common]
    assert len(shift) >= 3
    # a positive turn about y takes a star at +z to +x
    np.testing.assert_allclose(shift, 3.0, rtol=0.05)


def middle_of(observation, star):
    truth = observation.truth
    return np.hypot(truth.photon_x_px[star, 0] - 255.5, truth.photon_y_px[star, 0] - 255.5) < 120.0


@pytest.fixture(scope="module")
def small():
    return load_star_sensor("star_tracker_26mm", "cmv4000", window_px=(128, 96), diffraction="rays")


@pytest.fixture(scope="module")
def deep():
    return load_sky(faintest_mag=8.0)


def test_velocity_of_a_frame_is_aberration(small, deep):
    """30 km/s across the boresight: v / c towards the velocity; an observer's own velocity is replaced, not added."""
    towards, simulator = attitude_from_angles(*ORION), SkySimulator(small, deep, exposure_s=0.1)
    velocity = 30.0 * towards.as_matrix()[0]
    rest, moved = simulator.expected(towards), simulator.expected(towards, velocity_km_per_s=velocity)
    row = {star: k for k, star in enumerate(moved.field.row.tolist())}
    pairs = [(k, row[star]) for k, star in enumerate(rest.field.row.tolist()) if star in row]
    shift = [moved.truth.photon_x_px[b, 0] - rest.truth.photon_x_px[a, 0] for a, b in pairs]
    assert len(shift) > 10
    expected = 3600.0 * np.degrees(30.0 / 299792.458) / small.pixel_arcsec
    np.testing.assert_allclose(shift, expected, rtol=0.02)
    earth = load_sky(faintest_mag=8.0, observer="earth")
    own = earth.field(simulator.view, towards)
    same = earth.field(simulator.view, towards, velocity_km_per_s=earth.observer.velocity_km_per_s)
    assert np.array_equal(own.direction, same.direction)


def test_a_lens_state_is_the_heated_lens(small, deep):
    """As a sensor whose lens was heated beforehand; its renderer is kept, the state zero is the sensor's own lens."""
    state, housing = ThermalState(mean_k=10.0, transverse_x_k=1.0), Housing(expansion_per_k=23.6e-6)
    towards = attitude_from_angles(*ORION)
    simulator = SkySimulator(small, deep, exposure_s=0.1, nodes=2, housing=housing)
    warm = simulator.expected(towards, lens_state=state)
    lens = heated_lens(small.camera.lens, state, housing)
    heated = load_star_sensor(lens, "cmv4000", window_px=(128, 96), diffraction="rays")
    same = SkySimulator(heated, deep, exposure_s=0.1, nodes=2).expected(towards)
    np.testing.assert_array_equal(warm.electrons, same.electrons)
    cold = simulator.expected(towards)
    assert np.abs(warm.truth.photon_x_px - cold.truth.photon_x_px).max() > 0.01
    np.testing.assert_array_equal(simulator.expected(towards, lens_state=ThermalState()).electrons, cold.electrons)


def test_light_is_read_out_many_times(small, deep):
    """The same number and label: the same bytes; what is added, a label or a throughput changes what it should."""
    simulator, towards = SkySimulator(small, deep, exposure_s=0.1, seed=5), attitude_from_angles(*ORION)
    light = simulator.expected(towards)
    first, again, other = (simulator.read(light, frame=3, label=name) for name in ("a", "a", "b"))
    assert np.array_equal(first.dn, again.dn)
    assert (first.dn != other.dn).mean() > 0.5
    assert (first.band, first.index) == ("a", 3)
    brighter = simulator.read(light, frame=3, label="a", added_e=500.0).dn.astype(float)
    assert np.median(brighter - first.dn) == pytest.approx(500.0 * first.gain_dn_per_e, rel=0.02)
    dimmed = SkySimulator(small, deep, exposure_s=0.1, throughput_fraction=0.5).expected(towards)
    np.testing.assert_allclose(dimmed.electrons, 0.5 * light.electrons, rtol=1e-5)
    stars = simulator.light.stars(small.direction_at(np.array([40.0]), np.array([30.0])), 4.0, 5800.0)
    chart = simulator.expected(Rotation.identity(), stars=stars)
    assert chart.field is None
    assert (chart.truth.photon_x_px[0, 0], chart.truth.photon_y_px[0, 0]) == pytest.approx((40.0, 30.0), abs=1.0)
    assert chart.electrons.sum(dtype=float) == pytest.approx(chart.truth.electrons_image.sum(), rel=1e-5)


def test_cosmic_rays_and_lag(small, deep):
    """Rays only add charge, where the simulator says; a detector keeps its part of the frame before, rays included."""
    lagging = replace(small, detector=replace(small.detector, lag=0.25))
    settings = {"exposure_s": 2.0, "seed": 5}
    flare, calm = (SkySimulator(lagging, deep, cosmic_rays=name, **settings) for name in ("solar_flare", None))
    light = calm.expected(attitude_from_angles(*ORION))
    more = flare.read(light, frame=1).dn.astype(int) - calm.read(light, frame=1).dn
    struck = flare.hits(1).hit_mask
    assert (more >= 0).all()
    assert struck.sum() > 5
    assert (more > 0)[struck].mean() > 0.5
    image = np.full_like(light.electrons, 4000.0)
    before, dark = replace(light, electrons=image), np.zeros_like(image)
    lag = calm.read(dark, frame=1, before=before).dn.astype(float) - calm.read(dark, frame=1).dn
    assert np.median(lag) == pytest.approx(0.25 * 4000.0 * small.detector.gain_dn_per_e, rel=0.03)
    kept = flare.read(dark, frame=1, before=before).dn.astype(float) - flare.read(dark, frame=1).dn
    first = flare.hits(0)
    strong = (first.charge_e > 1e3) & (first.charge_e < 5e3)
    if strong.any():
        assert np.median((kept - lag)[first.row[strong], first.column[strong]]) > 100.0


def test_the_wings_of_a_planet_beside_the_detector_are_in_the_frame(small):
    """Jupiter 24 px from the edge, farther than the stars that are rendered: brightest in the nearest column."""
    sky = load_sky(faintest_mag=1.0, epoch_year=2024.3, observer="earth")
    planets = solar_system(2024.3, observer=sky.observer, bodies=["jupiter"])
    direction = planets.direction[0]
    ra_deg, dec_deg = np.degrees(np.arctan2(direction[1], direction[0])), np.degrees(np.arcsin(direction[2]))
    turn = Rotation.from_rotvec([0.0, np.radians(88.0 * small.pixel_arcsec / 3600.0), 0.0])
    by_waves = replace(small, camera=replace(small.camera, diffraction="waves"))
    simulator = SkySimulator(by_waves, sky, exposure_s=0.2, nodes=1, bodies=planets, disks_above_px=np.inf)
    light = simulator.expected(turn * attitude_from_angles(ra_deg, dec_deg))
    assert light.planets.name == ("jupiter",)
    assert light.truth.photon_x_px[-1, 0] == pytest.approx(151.5, abs=2.0)
    columns = light.electrons.sum(0)
    assert columns.sum() > 100.0
    assert columns.argmax() == 127
    behind = simulator.expected(attitude_from_angles(ra_deg + 180.0, -dec_deg))
    assert len(behind.planets) == 0
