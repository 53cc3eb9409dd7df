import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from star_images import gaussian_epsf, gaussian_stars, noisy, stamps_of

from calib.flags import UNFIT, StarFlag, has_flag
from calib.measure.centroiding import registry
from calib.measure.centroiding.registry import centroider_class, get_centroider, list_centroiders, register_centroider
from calib.records import NoiseModel

ROOT = Path(__file__).parents[4]
FIVE = ("cog", "tcog", "windowed", "gaussian", "epsf")
NAMES = list_centroiders()
LIKELIHOOD = ("gaussian", "epsf")


def needs_epsf(name):
    return centroider_class(name).needs_epsf


@pytest.fixture
def make():
    """Centroider by name, with the ePSF it may need."""

    def by_name(name, **options):
        return get_centroider(name, **({"epsf": gaussian_epsf(0.7)} | options if needs_epsf(name) else options))

    return by_name


@pytest.fixture
def stars():
    """Forty noisy stars with truth, background 4 e-."""
    rng = np.random.default_rng(11)
    x, y = 5.0 + rng.uniform(-0.5, 0.5, (2, 40))
    electrons = noisy(8000.0 * gaussian_stars(x, y, 0.7) + 4.0, 5.0, rng)
    return stamps_of(electrons, x + 0.1, y - 0.1, background_e=4.0)


def test_the_five_are_registered_under_their_names_which_are_read_without_numpy():
    assert set(FIVE) <= set(NAMES)
    for name in NAMES:
        assert centroider_class(name).name == name
    labels = [centroider_class(name).label for name in NAMES]
    assert len(set(labels)) == len(NAMES)
    assert [name for name in FIVE if needs_epsf(name)] == ["epsf"]
    # A command line checks a configuration's names before anything slow is imported
    code = "import sys, calib.measure.centroiding.registry as r; r.list_centroiders(); print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "False"


@dataclass(frozen=True, kw_only=True)
class BrightestPixel:
    """A centroider of a user."""

    name: ClassVar[str] = "brightest"
    label: ClassVar[str] = "brightest pixel"
    needs_epsf: ClassVar[bool] = False

    def measure(self, stamps, noise):
        raise NotImplementedError


def test_a_registered_class_is_known_by_its_name(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    assert register_centroider(BrightestPixel) is BrightestPixel
    assert register_centroider(BrightestPixel) is BrightestPixel, "twice does no harm"
    assert list_centroiders() == (*NAMES, "brightest")
    assert isinstance(get_centroider("brightest"), BrightestPixel)


@pytest.mark.parametrize("name", NAMES)
def test_positions_are_near_the_truth_and_x_is_the_column(name, make, noise):
    x, y = np.array([4.7, 5.2]), np.array([5.3, 4.9])
    electrons = 1e6 * gaussian_stars(x, y, 0.7, height=11, width=11)
    table = make(name).measure(stamps_of(electrons, [5.0, 5.0], [5.0, 5.0], corner=(100, 2000)), noise)
    assert table.x_px == pytest.approx(x + 100, abs=0.05)
    assert table.y_px == pytest.approx(y + 2000, abs=0.05)
    assert table.flux_e == pytest.approx([1e6, 1e6], rel=1e-3)
    assert not has_flag(table.flags, UNFIT).any()


@pytest.mark.parametrize("name", NAMES)
def test_moving_the_window_moves_the_star(name, make, stars, noise):
    by = np.array([30, -7])
    moved = replace(stars, corner_px=stars.corner_px + by, start_px=stars.start_px + by)
    one, two = make(name).measure(stars, noise), make(name).measure(moved, noise)
    assert two.x_px - one.x_px == pytest.approx(np.full(40, 30.0), abs=1e-9)
    assert two.y_px - one.y_px == pytest.approx(np.full(40, -7.0), abs=1e-9)
    assert two.covariance == pytest.approx(one.covariance, rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_transposed_and_mirrored_stamps(name, make, stars, noise):
    one = make(name).measure(stars, noise)
    turned = replace(stars, electrons=stars.electrons.transpose(0, 2, 1), start_px=stars.start_px[:, ::-1])
    two = make(name).measure(turned, noise)
    assert two.x_px == pytest.approx(one.y_px, abs=1e-8)
    assert two.y_px == pytest.approx(one.x_px, abs=1e-8)
    assert two.covariance[:, 0, 0] == pytest.approx(one.covariance[:, 1, 1], rel=1e-6)
    mirrored = replace(
        stars, electrons=stars.electrons[:, :, ::-1], start_px=np.array([10.0, 0.0]) + [-1.0, 1.0] * stars.start_px
    )
    three = make(name).measure(mirrored, noise)
    assert three.x_px == pytest.approx(10.0 - one.x_px, abs=1e-8)
    assert three.y_px == pytest.approx(one.y_px, abs=1e-8)
    assert three.flux_e == pytest.approx(one.flux_e, rel=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_inputs_stay_and_results_repeat(name, make, stars, noise):
    before = {f: np.array(getattr(stars, f)) for f in stars.__dataclass_fields__}
    one, two = make(name).measure(stars, noise), make(name).measure(stars, noise)
    for f, values in before.items():
        assert np.array_equal(getattr(stars, f), values), f
    assert np.array_equal(one.x_px, two.x_px)
    assert np.array_equal(one.covariance, two.covariance)


@pytest.mark.parametrize("name", NAMES)
def test_a_star_does_not_depend_on_its_company(name, make, stars, noise):
    together = make(name).measure(stars, noise)
    alone = make(name).measure(stars.select(slice(7, 8)), noise)
    assert alone.x_px[0] == pytest.approx(together.x_px[7], abs=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_zero_stamps_give_an_empty_table(name, make, stars, noise):
    table = make(name).measure(stars.select(slice(0, 0)), noise)
    assert len(table) == 0
    assert table.covariance.shape == (0, 3, 3)


@pytest.mark.parametrize("toward", [(1, 0), (-1, 0), (0, 1), (0, -1)])
@pytest.mark.parametrize(("lever", "outside"), [(0.9, False), (1.2, True)])
def test_centre_of_gravity_beyond_each_edge_is_flagged(noise, toward, lever, outside):
    """Light 1 + k in the middle and -k at an edge: the centre of gravity lies 5 k px towards the other edge."""
    electrons = np.zeros((1, 11, 11))
    electrons[0, 5, 5] = 1000.0 * (1.0 + lever)
    electrons[0, 5 - 5 * toward[1], 5 - 5 * toward[0]] = -1000.0 * lever
    centroider = get_centroider("cog", half_width_px=None)
    table = centroider.measure(stamps_of(electrons, np.array([5.0]), np.array([5.0])), noise)
    assert [table.x_px[0] - 5.0, table.y_px[0] - 5.0] == pytest.approx(5.0 * lever * np.array(toward))
    assert has_flag(table.flags, StarFlag.NOT_CONVERGED).tolist() == [outside]


@pytest.mark.parametrize("name", NAMES)
def test_window_without_a_usable_pixel_is_flagged(name, make, stars, noise):
    valid = np.array(stars.valid)
    valid[3] = False
    table = make(name).measure(replace(stars, valid=valid, electrons=np.where(valid, stars.electrons, 0.0)), noise)
    assert has_flag(table.flags, StarFlag.NO_DATA).nonzero()[0].tolist() == [3]
    assert np.isnan(table.x_px[3])
    assert np.isnan(table.covariance[3]).all()
    assert np.isfinite(np.delete(table.x_px, 3)).all()


@pytest.mark.parametrize("name", NAMES)
def test_window_without_a_star_is_survived(name, make, noise):
    """Noise only, and a window of exactly nothing: no crash, no warning, finite or flagged."""
    electrons = np.random.default_rng(5).normal(0.0, 5.0, (50, 11, 11))
    electrons[0] = 0.0
    electrons[1] = -100.0
    table = make(name).measure(stamps_of(electrons, np.full(50, 5.0), np.full(50, 5.0)), noise)
    assert len(table) == 50
    assert np.all(np.isfinite(table.x_px) | has_flag(table.flags, StarFlag.NO_DATA))


@pytest.mark.parametrize("name", LIKELIHOOD)
def test_saturated_pixels_are_left_out_and_do_no_harm(name, make):
    """The core is cut off; the wings still give the place, with an honest (larger) error."""
    rng = np.random.default_rng(8)
    n = 2000
    noise = NoiseModel(read_noise_e=5.0)
    x, y = 5.0 + rng.uniform(-0.5, 0.5, (2, n))
    electrons = noisy(3e5 * gaussian_stars(x, y, 0.7), 5.0, rng)
    valid = electrons < 30000.0
    clipped = np.minimum(electrons, 30000.0)
    option = {"sigma_px": 0.7} if name == "gaussian" else {}
    table = make(name, **option).measure(stamps_of(clipped, x + 0.1, y - 0.1, valid=valid), noise)
    fine = ~has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA)
    assert fine.mean() > 0.99
    pull = ((table.x_px - x) / table.sigma_x_px)[fine]
    assert pull.std() == pytest.approx(1.0, abs=5 / np.sqrt(2 * n))
    whole = make(name, **option).measure(stamps_of(electrons, x, y), noise)
    assert np.median(table.sigma_x_px) > 1.2 * np.median(whole.sigma_x_px)


def test_far_neighbour_pulls_a_fit_away_and_is_reported(make, noise):
    electrons = 1e5 * gaussian_stars([9.0], [9.0], 0.7) + 200.0 * gaussian_stars([5.0], [5.0], 0.7)
    table = make("epsf", max_shift_px=1.0).measure(stamps_of(electrons, [6.5], [6.5]), noise)
    assert has_flag(table.flags, StarFlag.NOT_CONVERGED)[0]


@pytest.mark.parametrize("stated_e", [0.5, 5.0, 50.0])
@pytest.mark.parametrize("name", LIKELIHOOD)
def test_fitted_stars_tell_whether_the_noise_was_stated_rightly(name, make, stated_e):
    """Faint stars on read noise of 5 e-; moments have no residuals, and say that nothing was tested."""
    rng = np.random.default_rng(12)
    x, y = 5.0 + rng.uniform(-0.5, 0.5, (2, 30))
    stamps = stamps_of(noisy(500.0 * gaussian_stars(x, y, 0.7), 5.0, rng), x, y)
    table = make(name).measure(stamps, NoiseModel(read_noise_e=stated_e))
    assert ("stated too small" in repr(table)) == (stated_e < 5)
    assert ("stated too large" in repr(table)) == (stated_e > 5)
    assert not make("windowed").measure(stamps, NoiseModel(read_noise_e=stated_e)).misfit.tested
