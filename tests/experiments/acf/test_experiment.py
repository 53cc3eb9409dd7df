"""The attitude-correlated-frames experiment on a small scale: what it finds against closed forms, what it writes."""

import numpy as np
import pytest

from experiments.acf import experiment as study
from experiments.acf.reprojection import root_mean_square
from experiments.acf.settings import Config, SkyConfig, SweepConfig, experiment
from experiments.acf.table2 import PRINTED, ROUNDING, TRUE, implied
from experiments.acf.trials import Point, Task, work
from experiments.harness.progress import Progress

SMALL = Config(
    frames=16,
    runs=4,
    noise_px=(0.1, 0.4),
    bias_deg_per_h=(0.1,),
    angle_random_walk_deg_per_sqrt_h=(0.01,),
    counts=(8, 16),
    sky=SkyConfig(stars_per_frame=12.0),
    sweep=SweepConfig(stars=(4, 12), gyro_factor=(0.0, 20.0), skies=4),
)


@pytest.fixture(scope="module")
def guess():
    return implied(points=11)


@pytest.fixture(scope="module")
def outcome(guess):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "implied", lambda: guess)
        return experiment.outcome(SMALL, study.run(SMALL, progress=Progress()))


@pytest.mark.slow
def test_nothing_fails_to_converge_from_the_poor_start(outcome):
    assert outcome.values("failed.n", method="acc") == 4 * (2 * 3 + 2 + 2 * 2 + 1 + 2)  # by hand
    assert outcome.values("failed.failed").sum() == 0


def test_runs_do_not_depend_on_how_they_are_cut_into_tasks():
    point = Point(
        name="cut", runs=3, noise_px=0.2, gyro=((0.03, 0.005),), methods=("acc", "free"), own_sky=True, stars=8
    )
    whole = work(Task(config=SMALL, point=point, first=0, last=3))
    first, rest = (work(Task(config=SMALL, point=point, first=a, last=b)) for a, b in ((0, 1), (1, 3)))
    assert set(whole) == set(first)
    for key, values in whole.items():
        assert np.array_equal(values, np.concatenate([first[key], rest[key]])), key


@pytest.mark.slow
def test_the_printed_table_tells_the_pixel(guess):
    """Where the printed errors of y0 [px] and phi1 [arcsec] cancel: 26.64 arcsec x 25.6 mm / 0.51 px = 6.48 um."""
    pixel = guess.pixel_um
    assert np.deg2rad(26.64 / 3600) * 25.6 / 0.51 * 1e3 == pytest.approx(pixel.value, abs=3 * pixel.uncertainty)
    assert pixel.uncertainty < 0.4
    assert guess.chi2 < 30.0 < guess.chi2_assumed
    assert guess.stars_range[0] < guess.stars < guess.stars_range[1]


@pytest.mark.slow
def test_pixel_and_stars_of_simulated_tables_are_found_again():
    """Eight runs with 8 um pixels and 20 stars per frame, printed with the document's digits.

    Pulls of the pixel: mean within 4 / sqrt(8); their RMS within a factor of two. The true number of stars lies in the
    68 % range of most of them, and chi^2 of 11 averages to 11 within 4 sqrt(22 / 8).
    """
    point = Point(name="again", runs=8, noise_px=0.1, gyro=((0.03, 0.005),), methods=("acc",), stars=20, pixel_um=8.0)
    runs = work(Task(config=Config(), point=point, first=0, last=8))["acc@0.error"]
    runs[:, 8:] = np.degrees(runs[:, 8:])
    pulls, inside, chi2 = [], [], []
    for error in runs:
        found = implied(points=11, printed=np.round((TRUE + error) / ROUNDING) * ROUNDING)
        pulls.append((found.pixel_um.value - 8.0) / found.pixel_um.uncertainty)
        inside.append(found.stars_range[0] < 20 < found.stars_range[1])
        chi2.append(found.chi2)
    assert abs(np.mean(pulls)) < 4 / np.sqrt(8)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 2.0
    assert sum(inside) >= 3
    assert np.mean(chi2) == pytest.approx(11, abs=4 * np.sqrt(22 / 8))


def test_defaults_are_the_published_run():
    config = Config()
    camera, gyro = config.camera, config.gyro
    assert (config.frames, config.frame_rate_hz, config.runs) == (60, 1.0, 100)
    assert (camera.focal_length_mm, camera.x0_px, camera.y0_px) == (25.6, 10.0, -10.0)
    assert config.noise_px == pytest.approx(np.arange(1, 11) * 0.05)
    assert (gyro.rate_hz, gyro.angular_speed_deg_per_s, gyro.bias_deg_per_h) == (100.0, 0.5, 0.03)
    assert gyro.angle_random_walk_deg_per_sqrt_h == 0.005
    assert config.start.focal_length_mm == 20.0
    error = np.abs(PRINTED - TRUE)
    assert 3600 * error[8:] == pytest.approx([26.64, 13.68, 3.6, 6.84, 18.0, 0.36], abs=0.01)  # as printed
    assert error[:4] == pytest.approx([0.19, 0.51, 2e-4, 4e-6], rel=1e-6)


@pytest.mark.slow
def test_workers_change_no_number(outcome, guess, monkeypatch):
    """The same bits from one process as from two."""
    monkeypatch.setattr(study, "implied", lambda: guess)
    config = SMALL.model_copy(update={"workers": 2})
    assert outcome.data.identical(experiment.outcome(config, study.run(config, progress=Progress())).data)


def test_error_of_a_root_mean_square():
    """Of n normal numbers of size s: s within s / sqrt(2 n), which the estimate of that gives to some percent."""
    n, size = 20000, 3.0
    rms, error = root_mean_square((size * np.random.default_rng(7).standard_normal((n, 2))) ** 2, 0)
    assert rms == pytest.approx([size, size], abs=4 * size / np.sqrt(2 * n))
    assert error == pytest.approx([size / np.sqrt(2 * n)] * 2, rel=0.05)
