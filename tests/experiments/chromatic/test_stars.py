"""Stars through the full pass band: photometry scales as it must, shifts follow temperature and the lens's symmetry."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.chromatic.stars import stellar_shift, stellar_shift_statistics
from experiments.laboratory.bench.signal import electrons_of_star, signal_of
from experiments.laboratory.settings.tables import SignalConfig, StarsConfig
from optics.errors import DomainError
from optics.lens.perturb import decentre
from optics.light.band import TopHat
from render.sensor_file.filters import open_band
from render.sensor_file.tables import PassbandConfig

PASSBAND = TopHat(centre_nm=675.0, width_nm=450.0, edge_nm=20.0)
TEMPERATURES_K = (3000.0, 4500.0, 5800.0, 9000.0, 30000.0)


@pytest.fixture(scope="module")
def shift(star_camera):
    return stellar_shift(StarsConfig(temperatures_k=TEMPERATURES_K, grid=3), PASSBAND, star_camera)[1]


def test_reference_star_does_not_move(shift):
    assert np.all(shift[2] == 0)


def test_shift_has_the_symmetry_of_the_lens(shift):
    field = shift.reshape(len(TEMPERATURES_K), 3, 3, 2)
    assert np.abs(field[:, ::-1] * [1, -1] - field).max() < 1e-6
    assert np.abs(field[:, :, ::-1] * [-1, 1] - field).max() < 1e-6
    assert np.abs(field[:, 1, 1]).max() < 1e-6


def test_statistics_of_the_field(shift):
    length = np.hypot(shift[..., 0], shift[..., 1])
    stars = stellar_shift_statistics(shift, [np.full((9, 2), 0.3), np.zeros((9, 2))])
    assert stars.rms_shift_px == pytest.approx(np.sqrt(np.mean(length**2, axis=1)))
    assert stars.max_shift_px == pytest.approx(length.max(1), rel=1e-12)
    assert stars.mean_shift_length_px == pytest.approx(np.hypot(*shift.mean(1).T), abs=1e-12)
    assert stars.one_third_rule_px == pytest.approx(0.3 * np.sqrt(2) / 6)
    # 3000 K and 30000 K lie on opposite sides of the reference star
    apart = shift[0] - shift[-1]
    assert stars.max_pairwise_rms_px == pytest.approx(np.sqrt((apart**2).sum(1).mean()))
    assert stars.max_pairwise_rms_px == pytest.approx(stars.rms_shift_px[0] + stars.rms_shift_px[-1], rel=0.05)


def test_decentred_element_shifts_all_stars_alike(star_camera):
    """A prism moves red against blue everywhere by about the same: the mean over the field no longer vanishes."""
    camera = replace(star_camera.camera, lens=decentre(star_camera.camera.lens, "L2", 0.117))
    config = StarsConfig(temperatures_k=(3000.0, 30000.0), grid=2)
    centred = stellar_shift(config, PASSBAND, star_camera)[1].mean(1)
    moved = stellar_shift(config, PASSBAND, replace(star_camera, camera=camera))[1].mean(1)
    assert np.abs(centred).max() < 1e-6
    assert moved[0, 0] * moved[1, 0] < 0
    assert abs(moved[0, 0]) > 0.02
    assert np.abs(moved[:, 1]).max() < 1e-6


def test_electrons_follow_exposure_and_pass_band(star_camera):
    longer = replace(star_camera, config=star_camera.config.model_copy(update={"exposure_s": 0.3}))
    one = electrons_of_star(PASSBAND, star_camera, magnitude=7.5, temperature_k=5800.0)
    assert electrons_of_star(PASSBAND, longer, magnitude=7.5, temperature_k=5800.0) == pytest.approx(3 * one, rel=1e-12)
    parts = [
        electrons_of_star(
            TopHat(centre_nm=(low + high) / 2, width_nm=high - low), star_camera, magnitude=7.5, temperature_k=5800.0
        )
        for low, high in ((450.0, 640.0), (640.0, 900.0), (450.0, 900.0))
    ]
    assert parts[0] + parts[1] == pytest.approx(parts[2], rel=1e-4)


def test_electrons_of_a_star_in_round_numbers(star_camera):
    """V = 0: about 1000 photons s^-1 cm^-2 per angstrom at 550 nm (Bessell 1979); over the pass band half are detected.

    38.5 cm^2 x 0.1 s x 4500 A x 1e3 x 10^-3 at V = 7.5 is 17 000 photons; quantum efficiency, glass and the slope of
    the spectrum leave a quarter to a half.
    """
    electrons = electrons_of_star(PASSBAND, star_camera, magnitude=7.5, temperature_k=5800.0)
    assert 17e3 * 0.2 < electrons < 17e3 * 0.6


def test_electrons_and_magnitude_say_the_same(star_camera):
    """A star of the magnitude that electrons mean gives them; 2.512 times less light is a magnitude."""
    found = signal_of(SignalConfig(signal_e=3000.0), PASSBAND, star_camera, 5800.0)
    star = signal_of(SignalConfig(magnitude_mag=found.magnitude_mag), PASSBAND, star_camera, 5800.0)
    seen = electrons_of_star(PASSBAND, star_camera, magnitude=found.magnitude_mag, temperature_k=5800.0)
    assert star.signal_e == pytest.approx(3000.0, rel=1e-12) == seen
    fainter = electrons_of_star(PASSBAND, star_camera, magnitude=found.magnitude_mag + 1.0, temperature_k=5800.0)
    assert found.magnitude_of(fainter) == pytest.approx(found.magnitude_mag + 1.0)
    assert fainter == pytest.approx(3000.0 / 2.511886, rel=1e-6)


def test_half_of_the_light_passes_at_the_ends_of_the_range(star_camera):
    band = open_band(PassbandConfig(range_nm=(450.0, 900.0), edge_nm=20.0), star_camera)
    assert band.transmission(np.array([439.0, 450.0, 461.0, 675.0, 900.0])) == pytest.approx([0, 0.5, 1, 1, 0.5])


def test_light_outside_the_tables_is_refused_by_name(star_camera):
    with pytest.raises(DomainError, match=r"star_camera_206mm.*290\.\d+ nm is outside 400 ... 1000 nm"):
        stellar_shift(StarsConfig(grid=2), TopHat(centre_nm=600.0, width_nm=600.0, edge_nm=20.0), star_camera)
