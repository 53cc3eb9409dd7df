"""Setting and reading of the table at the places of the star's image, at rest and in motion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, star_direction
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.acquisition import TableMotion, merged_nodes, visit_once
from experiments.laboratory.single_star.visits import visit
from optics.frames import field_direction
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.records import StarField


@pytest.fixture
def bench() -> StarBench:
    return StarBench(
        table=build_turntable("xy", reading_noise_arcsec=2.0, setting_noise_arcsec=10.0),
        star=star_direction(0.3, -0.2),
        installation=Rotation.from_rotvec([0.01, -0.02, 0.3]),
    )


def test_a_visit_knows_what_is_and_what_is_read(bench) -> None:
    wanted = field_direction([1.0, -1.0], [0.5, 2.0])
    visits = visit(bench, np.zeros((2, 2)), wanted, np.zeros(2), Streams(5), readings=2)
    np.testing.assert_allclose(visits.direction, bench.star_in_cam(visits.true_rad.copy()), atol=1e-15)
    off = np.linalg.norm(visits.direction - wanted, axis=1) / ARCSEC_RAD
    assert np.all((off > 0.1) & (off < 60.0))
    read = np.abs(visits.reading_rad - visits.true_rad) / ARCSEC_RAD
    assert np.all((read > 0.0) & (read < 10.0))


def test_motion_moves_the_star_along_one_axis(bench) -> None:
    motion = TableMotion(rate_rad_per_s=1e-2, jitter_s=1e-3, samples=4)
    field = np.stack(np.meshgrid(np.linspace(-5, 5, 9), np.linspace(-5, 5, 9)), axis=-1).reshape(-1, 2)
    places = visit_once(bench, field_direction(*field.T), np.zeros(81), motion, 9, Streams(2))
    np.testing.assert_allclose(np.abs(places.rate_rad_per_s), np.tile([0.0, 1e-2], (81, 1)))
    assert places.rate_rad_per_s[0, 1] == -places.rate_rad_per_s[9, 1]
    seen = places.directions(bench, exposure_s=0.1)
    assert seen.shape == (81, 4, 3)
    np.testing.assert_allclose(motion.instants_s(0.1), [-0.0375, -0.0125, 0.0125, 0.0375])
    length = np.linalg.norm(seen[:, 3] - seen[:, 0], axis=1)
    np.testing.assert_allclose(length, 1e-2 * 0.075, rtol=0.05)
    late = (places.reading_rad - places.true_rad)[:, 1]
    assert late.std() == pytest.approx(np.hypot(1e-5, 2.0 * ARCSEC_RAD), rel=4 / np.sqrt(162))


def test_merged_nodes_keep_light_and_mean_wavelength() -> None:
    rate = np.random.default_rng(1).uniform(0.5, 1.5, (1, 1, 6)) * np.ones((4, 1, 1))
    stars = StarField(
        direction=np.tile([0.0, 0.0, 1.0], (4, 1)),
        wavelength_nm=np.array([[450.0, 500.0, 560.0, 640.0, 700.0, 800.0]]),
        photon_rate=rate,
        band=("x",),
    )
    merged = merged_nodes(stars)
    assert merged.wavelength_nm.shape == (1, 3)
    np.testing.assert_allclose(merged.photon_rate.sum(2), stars.photon_rate.sum(2))
    np.testing.assert_allclose(
        (merged.photon_rate * merged.wavelength_nm).sum(2), (stars.photon_rate * stars.wavelength_nm).sum(2)
    )
