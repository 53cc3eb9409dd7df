"""Stray light of Sun, Moon and Earth in electrons: closed forms, and the road into a frame."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optics.attitude import attitude_from_angles
from optics.light.pst import PointSourceTransmittance, write_pst
from render.bodies.stray_light import EARTH_ALBEDO, StrayLight, band_light, earth_limb_pst, earth_points, limb_pst
from render.catalogue.motion import Observer, earth_observer
from render.sensor_file.load import load_star_sensor
from render.simulator import SkySimulator
from render.sky.sky import load_sky
from render.sky.sunlight import sunlight


def flat(value: float = 1e-6) -> PointSourceTransmittance:
    return PointSourceTransmittance(
        angle_deg=np.array([1.0, 90.0]), azimuth_deg=np.zeros(1), causes=("pst",),
        value=np.full((1, 1, 2), value), error=np.zeros((1, 1, 2)),
    )  # fmt: skip


def test_a_cap_has_its_solid_angle_and_stands_where_it_is_told() -> None:
    for radius in (0.01, 0.3, 1.2):
        towards = np.array([0.6, -0.48, 0.64])
        points, solid = earth_points(towards, radius)
        assert solid.sum() == pytest.approx(2.0 * np.pi * (1.0 - np.cos(radius)), rel=1e-12)
        assert np.arccos(np.clip(points @ towards, -1, 1)).max() < radius
        np.testing.assert_allclose(np.cross(points.T @ solid, towards), 0.0, atol=1e-12)


def test_a_disk_that_reaches_behind_the_camera_counts_in_front() -> None:
    """A hemisphere about a point abeam: half of it in front, of PST 1e-6."""
    half = limb_pst(flat(), [1.0, 0.0, 0.0], 0.5 * np.pi)
    assert half == pytest.approx(EARTH_ALBEDO / np.pi * 1e-6 * np.pi, rel=0.02)
    # seen from a radius above the ground the disk reaches 30 deg; its limb at 60 deg: centre abeam
    assert earth_limb_pst(flat(), 60.0, 6371.0084) == pytest.approx(limb_pst(flat(), [1.0, 0.0, 0.0], np.pi / 6))
    whole = limb_pst(flat(), [0.0, 0.0, 1.0], 0.5)
    assert whole == pytest.approx(EARTH_ALBEDO * 2e-6 * (1.0 - np.cos(0.5)), rel=1e-9)


def test_the_sun_gives_its_photons_times_pst_and_efficiency() -> None:
    sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=64)
    band = sensor.passband()
    light = band_light(sensor.detector, band)
    wave = np.linspace(410.0, 990.0, 4000)
    rate = sunlight(wave) * sensor.detector.quantum_efficiency.interpolate(wave)
    whole = np.trapezoid(rate, wave) * sensor.detector.pixel_pitch_mm**2
    assert light.sun_e_per_s == pytest.approx(whole, rel=0.03)
    # V of Sun and full Moon are 14.0 mag apart; the Moon is redder
    assert 1.0 < light.full_moon_e_per_s / light.sun_e_per_s / 10.0 ** (-0.4 * 14.02) < 1.2

    observer = earth_observer(2020.0)
    to_sun = observer.to_sun
    towards, _ = Rotation.align_vectors([[np.sin(0.5), 0.0, np.cos(0.5)]], [to_sun])
    stray = StrayLight(flat(), light, observer=observer, epoch_year=2020.0)
    found = stray.total(towards)
    assert found["sun"] == pytest.approx(1e-6 * light.sun_e_per_s / (observer.from_sun_au**2).sum(), rel=1e-9)
    behind, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [to_sun])
    assert stray.total(behind)["sun"] == 0.0


def north_of_the_sun(observer: Observer, angle_deg: float) -> Rotation:
    x, y, z = observer.to_sun
    return attitude_from_angles(np.degrees(np.arctan2(y, x)), min(np.degrees(np.arcsin(z)) + angle_deg, 89.0))


@pytest.mark.slow
def test_a_frame_holds_the_stray_light(tmp_path) -> None:
    sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=64)
    sky = load_sky(observer="earth", faintest_mag=5.0)
    attitude = north_of_the_sun(sky.observer, 40.0)
    table = write_pst(tmp_path / "pst.ecsv", flat(1e-7))
    lit, dark = (SkySimulator(sensor, sky, exposure_s=0.2, stray_light=one).observe(attitude) for one in (table, None))
    wanted = SkySimulator(sensor, sky, stray_light=flat(1e-7)).stray_e_per_s(attitude)
    apart = lit.expected.electrons - dark.expected.electrons
    np.testing.assert_allclose(apart, 0.2 * sum(wanted.values()), rtol=1e-5)
    assert apart.mean() > 100.0


@pytest.mark.slow
def test_ghosts_of_the_sun_fall_where_paths_lead_with_the_light_of_the_table() -> None:
    sensor = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=512)
    sky = load_sky(observer="earth", faintest_mag=5.0)
    attitude, part = north_of_the_sun(sky.observer, 15.0), flat(5e-8)
    value, error = (np.repeat(v, 2, axis=0) for v in (part.value, part.error))
    both = replace(part, causes=("ghosts", "polish"), value=value, error=error)
    seen = SkySimulator(sensor, sky, stray_light=both, ghosts=True).observe(attitude, layers=True)
    wanted = 0.1 * sum(SkySimulator(sensor, sky, stray_light=both).stray_e_per_s(attitude).values())
    assert seen.layers["ghosts"].mean(dtype=float) == pytest.approx(wanted, rel=1e-3)
    assert seen.layers["stray"] == pytest.approx(wanted, rel=1e-3)
    assert np.ptp(seen.layers["ghosts"]) > 0.1 * wanted
    assert "sun" in seen.sources_outside
    assert {seen.sources_outside[row - len(seen.field)] for row in seen.ghosts.star if row >= len(seen.field)} == {
        *seen.sources_outside
    }
