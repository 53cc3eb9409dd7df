"""Numbers of the tables from runs with known errors: sizes, ratios, pulls and gains by hand, expectations by draws."""

import numpy as np
import pytest

from experiments.acf import table2 as table2_module
from experiments.acf import trials as monte_carlo
from experiments.acf.gain import gain, gains, sweep_points
from experiments.acf.methods import fig5_points, largest_distortion, methods
from experiments.acf.reprojection import (
    counts,
    counts_points,
    expected_at,
    fig3,
    fig3_points,
    fig4,
    inferred_point,
    matching_stars,
    overall,
    table2_point,
)
from experiments.acf.settings import Config, SkyConfig, SweepConfig
from experiments.acf.simulate import build_scene
from experiments.acf.table2 import (
    ROUNDING,
    TRUE,
    Covariances,
    _fit,
    covariances,
    in_degrees,
    printed_reprojection_px2,
    sums,
    table2,
)
from experiments.acf.trials import COMPARED, Point, Task, Trials, field_of, perform, residual_distortion, sky_of, work

CONFIG = Config(
    frames=12,
    runs=4,
    noise_px=(0.1, 0.4),
    bias_deg_per_h=(0.1,),
    angle_random_walk_deg_per_sqrt_h=(0.01,),
    counts=(8, 16),
    sky=SkyConfig(stars_per_frame=12.0),
    sweep=SweepConfig(stars=(4, 12), gyro_factor=(0.0, 20.0), skies=4),
)
SIZE = dict(zip(COMPARED, (1.0, 2.0, 3.0, 5.0, 7.0), strict=True))
SIGN = np.array([1.0, -1.0, 1.0, -1.0])[:, None]


def runs_of(point, method, gyro, **what):
    label = f"{method}@{gyro}" if method in monte_carlo.LINKED else method
    return {f"{label}.{name}": np.asarray(value, float) for name, value in what.items()}


@pytest.fixture(scope="module")
def fig5():
    """Errors of method m at noise s: m s (1 ... 14), of either sign; stated sigmas half as large."""
    trials = {}
    for point in fig5_points(CONFIG):
        values = {}
        for method, size in SIZE.items():
            error = SIGN * size * point.noise_px * np.arange(1.0, 15.0)
            wide = np.array([3.0, 5.0, 3.0, 5.0]) * size * point.noise_px
            values |= runs_of(
                point, method, 0, error=error, sigma=np.abs(error) / 2.0, distortion_px=wide, sight_arcsec=wide
            )
        trials[point.name] = Trials(point=point, values=values)
    return methods(CONFIG, trials)


def test_errors_by_noise(fig5):
    for name, one in zip(COMPARED, fig5["fig5"], strict=True):
        size = SIZE[name] * np.array(CONFIG.noise_px)
        for k, found in enumerate((one.x0_px, one.y0_px, one.focal_length_mm), 1):
            assert found == pytest.approx(k * size)
        assert [row.value for row in one.distortion_px] == pytest.approx(4.0 * size)
        # two of four differ by one from the mean: standard deviation sqrt(4 / 3), of the mean half of that
        assert [row.uncertainty for row in one.distortion_px] == pytest.approx(size / np.sqrt(3.0))
        assert [row.value for row in one.sight_arcsec] == pytest.approx(np.sqrt(17.0) * size)


def test_all_noises_together(fig5):
    acc, linked, free, iac, full = fig5["methods"]
    assert (acc.x0_px, acc.y0_px, acc.f_um) == pytest.approx((1.0, 2.0, 3000.0))
    assert (free.distortion_px, free.sight_arcsec) == pytest.approx((12.0, 3.0 * np.sqrt(17.0)))
    assert [one.over_acc for one in (acc, linked, free, iac, full)] == pytest.approx(list(SIZE.values()))
    should = fig5["fig5"][2].expected_sight_arcsec / CONFIG.noise_px
    assert np.ptp(should) < 1e-9 * should[0]  # free attitudes: in proportion to the noise
    assert free.over_expected.value == pytest.approx(3.0 * np.sqrt(17.0) / should[0])
    assert free.over_expected.uncertainty == pytest.approx(1.0 / np.sqrt(2.0 * 4.0 * 8))
    assert [one.ratio for one in fig5["ratios"]] == [pytest.approx([r] * 5) for r in (5.0, 7.0 / 3.0, 3.0)]
    assert (fig5["fig5_all"].fig5_n, fig5["fig5_all"].pull_n) == (4, 8)


def test_pulls_of_all_unknowns(fig5):
    expected = [covariances(CONFIG, point) for point in fig5_points(CONFIG)]
    for k, one in enumerate(fig5["pulls"]):
        assert (one.own, one.linked.value) == pytest.approx((2.0, 2.0))
        pulls = [(k + 1) * s / np.sqrt(should.acc[k, k]) for s, should in zip(CONFIG.noise_px, expected, strict=True)]
        assert one.carried == pytest.approx(np.hypot(*pulls) / np.sqrt(2.0))
        assert one.linked.uncertainty == pytest.approx(0.25)


def test_expected_errors(fig5):
    """In proportion to the noise for free attitudes; what the method says itself for interstar angles."""
    iac = fig5["fig5"][COMPARED.index("iac")]
    assert iac.expected_x0_px == pytest.approx(2.5 * np.array(CONFIG.noise_px))
    assert np.isnan(iac.expected_sight_arcsec).all()
    for name, noise in zip(("acc", "linked", "free", "iac_full"), (None, None, 4.0, 4.0), strict=True):
        one = fig5["fig5"][COMPARED.index(name)]
        rows = (one.expected_x0_px, one.expected_focal_length_mm, one.expected_distortion_px, one.expected_sight_arcsec)
        for row in rows:
            assert row[1] > row[0]
            if noise:
                assert row[1] / row[0] == pytest.approx(noise)


def test_expected_distortion_against_drawn_cameras():
    """400 cameras drawn from a covariance, judged as fitted ones are: two means of 400 agree to 4 standard errors."""
    camera, grid = build_scene(CONFIG).camera, field_of(CONFIG, None)
    sigma = 1e-3 * camera.parameter_scales
    drawn = np.random.default_rng(3).standard_normal((400, 8)) * sigma
    seen = [residual_distortion(camera, camera.with_parameters(camera.parameters + d), grid) for d in drawn]
    (expected,) = largest_distortion(CONFIG, [np.diag(sigma**2)])
    assert expected == pytest.approx(np.mean(seen), abs=4.0 * np.std(seen) * np.sqrt(2.0 / 400))


def test_a_gain_that_every_sky_has_is_certain():
    """Errors of both methods differ from sky to sky alike; of independent ones a ratio of medians of 1000 is drawn."""
    rng = np.random.default_rng(3)
    free, pick = rng.lognormal(0.0, 0.5, 1000), rng.integers(0, 1000, (400, 1000))
    certain, guessed = gain(free, 0.5 * free, pick), gain(free, rng.permutation(free), pick)
    assert (certain.value, certain.uncertainty) == pytest.approx((2.0, 0.0), abs=1e-12)
    # a median of n normal logarithms scatters by 0.5 sqrt(pi / 2 n)
    assert guessed.uncertainty == pytest.approx(0.5 * np.sqrt(np.pi / 2000) * np.sqrt(2.0), rel=0.3)


def test_gains_by_hand():
    """Three skies: medians 8 and 2; a run that did not converge counts as infinitely wrong."""
    trials = {}
    for n, point in enumerate(sweep_points(CONFIG), 1):
        values = runs_of(point, "free", None, sight_arcsec=[4, 8, 16], converged=[1, 1, 1], error=np.full((3, 8), 3.0))
        values["bound.free"] = np.full((3, 9), 6.0) * np.array([[1.0], [2.0], [3.0]])
        for k in range(2):
            for method in ("acc", "linked"):
                # the smallest error is of a run that failed: the median of 2, 4 and infinity
                values |= runs_of(
                    point, method, k, sight_arcsec=[0.1, 2.0 * n, n], converged=[0, 1, 1], error=np.full((3, 8), 1.0)
                )
                values[f"bound@{k}.{method}"] = np.full((3, 9), 2.0 + 2.0 * k)
            # medians 6 and 3, then 6 and 1.5: logarithms log 2 and log 4
            values[f"drawn@{k}.free"] = np.array([[6.0, 6.0], [5.0, 9.0], [9.0, 1.0]])
            values[f"drawn@{k}.linked"] = np.array([[3.0, 1.0], [2.0, 1.5], [9.0, 4.0]])
        trials[point.name] = Trials(point=point, values=values)
    few, many = gains(CONFIG, trials)
    assert (few.stars, many.stars) == (4, 12)
    assert [one.value for one in few.acc + few.linked] == pytest.approx([4.0] * 4)
    assert [one.value for one in many.acc] == pytest.approx([2.0] * 2)
    assert few.acc_bound == pytest.approx([6.0, 3.0])
    assert few.linked_bound == pytest.approx([6.0, 3.0])
    assert few.acc[0].uncertainty > 0.0
    spread = np.log(2.0) / np.sqrt(2.0)
    assert few.linked_z == pytest.approx([0.5 * np.log(2.0) / spread] * 2)
    assert few.linked_whole == pytest.approx([1.0 / spread] * 2)


@pytest.fixture(scope="module")
def reprojected():
    """Runs whose mean squares are 1.21 times the expected ones along both axes, twice as large for the second half."""
    trials, wide = {}, 1.1 * np.array([0.8, 1.0, 1.0, 1.2])
    inferred = inferred_point(CONFIG, 6.0, 20)
    for point in (*fig3_points(CONFIG), *counts_points(CONFIG), table2_point(CONFIG), inferred):
        values = {}
        for k in range(len(point.gyro)):
            (should,) = expected_at(CONFIG, point, k)
            length = wide * should.mean_px
            values |= runs_of(point, "acc", k, reprojection_px2=np.outer(length**2, [0.36, 0.64]))
            if point.keep_reprojections:
                values |= runs_of(
                    point, "acc", k, reprojected_px=np.tile([[[0.03, 0.04], [0.0, 0.01]]], (4, 1, 1)),
                    error=SIGN * np.arange(1.0, 15.0) * 1e-4, sight_arcsec=[3.0, 5.0, 3.0, 5.0],
                )  # fmt: skip
        trials[point.name] = Trials(point=point, values=values)
    return trials, inferred


def test_reprojection_over_its_prediction(reprojected):
    trials, inferred = reprojected
    found = overall(CONFIG, trials).reprojection_ratio
    assert (found.value, found.n) == (pytest.approx(1.1), 16)
    # four points of four runs; standard deviation of a run 1.1 sqrt(0.08 / 3)
    assert found.uncertainty == pytest.approx(1.1 * np.sqrt(0.08 / 3.0) / 4.0)
    by_bias, by_walk = fig3(CONFIG, trials)
    for part in (by_bias, by_walk):
        measured = np.array([[one.value for one in row] for row in part.rms_px])
        np.testing.assert_allclose(measured, 1.1 * part.expected_px, rtol=1e-9)
        assert (part.expected_px[:, 1] > part.expected_px[:, 0]).all()
        assert part.expected_px[1, 0] / part.expected_px[0, 0] == pytest.approx(4.0)  # perfect gyro
    assert np.array_equal(by_bias.expected_px[:, 0], by_walk.expected_px[:, 0])
    few, many = counts(CONFIG, trials)
    assert (few.stars, many.stars) == (8, 16)
    assert [one.value for one in few.rms_px] == pytest.approx(1.1 * few.expected_px)
    assert few.expected_px[0] / many.expected_px[0] == pytest.approx(np.sqrt(2.0), rel=0.15)  # sigma sqrt(14 / n)
    assumed, other = fig4(CONFIG, trials, inferred)
    rms = 1.1 * np.sqrt(1.02) * assumed.expected_px.value
    assert [one.value for one in assumed.rms_px] == pytest.approx([0.6 * rms, 0.8 * rms])
    assert np.hypot(*assumed.expected_axis_px) == pytest.approx(assumed.expected_px.value, rel=0.02)
    assert (assumed.largest_px, assumed.inside) == (pytest.approx(0.05), 0.5)
    assert (assumed.pixel_um, other.pixel_um, other.stars) == (CONFIG.camera.pixel_pitch_um, 6.0, 20)
    assert assumed.stars == pytest.approx(len(sky_of(CONFIG, table2_point(CONFIG), 0).stars.frame) / 12)
    published = np.hypot(0.0132, 0.0123)
    assert assumed.published_length_px == pytest.approx(published)
    sigma = assumed.expected_px.uncertainty
    assert assumed.published_deviation == pytest.approx((published - assumed.expected_px.value) / sigma)


def test_stars_that_give_the_published_error():
    """At the number found, the expectation is the published one; without the gyro's part it is sigma sqrt(14 / n)."""
    found = matching_stars(CONFIG, 10.0, stars=40)
    published = np.hypot(0.0132, 0.0123)
    assert found.closed_form == pytest.approx(14.0 * (CONFIG.table_noise_px / published) ** 2 / 6.0)
    assert found.range[0] <= found.with_gyro <= found.range[1]
    at_40, at_10 = (
        expected_at(CONFIG, Point(name="", runs=0, noise_px=0.1 * s, gyro=((0.03, 0.005),), methods=(), stars=40), 0)[0]
        for s in (1.0, 2.0)
    )
    gyro2 = (4.0 * at_40.total_px**2 - at_10.total_px**2) / 3.0  # a quarter of the stars: twice the noise
    assert found.gyro_px == pytest.approx(np.sqrt(gyro2), rel=1e-6)
    assert 40.0 / found.with_gyro * (at_40.total_px**2 - gyro2) + gyro2 == pytest.approx(published**2, rel=1e-6)


def test_table_2(reprojected):
    trials, _ = reprojected
    scene = build_scene(Config())
    np.testing.assert_allclose(scene.camera.parameters, TRUE[:8])
    assert (*Config().sky.phi_deg, *Config().gyro.installation_deg) == tuple(TRUE[8:])
    perfect = np.outer(np.arange(1.0, 15.0), np.arange(1.0, 15.0)) * (0.5 + 0.5 * np.eye(14))
    every = Covariances(perfect=perfect, acc=4.0 * perfect, linked=perfect, free=perfect[:8, :8])
    rows = table2(CONFIG, trials, every)
    degrees = np.r_[np.ones(8), np.full(6, 180.0 / np.pi)]
    for k, row in enumerate(rows):
        assert row.std == pytest.approx((k + 1) * 1e-4 * np.sqrt(4.0 / 3.0) * degrees[k])
        assert row.mean_error == pytest.approx(0.0, abs=1e-15)
        assert row.mean == pytest.approx(row.true)
        assert (row.bound, row.bound_with_gyro_error) == pytest.approx(((k + 1) * degrees[k], 2 * (k + 1) * degrees[k]))
    assert [row.published_error for row in rows[:3]] == pytest.approx([-0.19, -0.51, 0.0002], rel=1e-6)
    assert in_degrees(np.full((2, 14), np.pi))[1, 7:9] == pytest.approx([np.pi, 180.0])
    all_together = sums(CONFIG, trials, every)
    assert all_together.correlation == pytest.approx([0.5, 0.5, 0.5])
    assert all_together.sight_arcsec == pytest.approx(np.sqrt(17.0))


def test_printed_numbers_on_the_detector():
    """One pixel of the principal point moves every star by one; rounding alone is far from what many stars see."""
    assert printed_reprojection_px2(CONFIG, 8.0, TRUE) == pytest.approx(0.0, abs=1e-18)
    moved = TRUE + np.eye(14)[0]
    assert printed_reprojection_px2(CONFIG, 8.0, moved) == pytest.approx(1.0, rel=1e-9)
    stars = np.array([4.0, 16.0, 64.0])
    exact, off = (_fit(CONFIG, 8.0, stars, printed) for printed in (TRUE, moved))
    assert exact[0] == pytest.approx([0.0] * 3)
    assert (np.diff(off[0]) > 0.0).all()
    # between them the errors differ by chi-square alone: minus half of it in the logarithm
    assert off[1] - exact[1] == pytest.approx(-0.5 * off[0])
    # 11 unknowns, variances of some by stars alone: the logarithm grows by at most 11 ln 2 for four times the stars
    assert (np.diff(exact[1]) < 11.0 * np.log(2.0)).all()
    assert (np.diff(exact[1]) > 0.0).all()
    # digits count where they are coarser than the stars: x0 alone is known to 0.01 px over the root of 12 at best
    fine = _fit(CONFIG, 8.0, np.array([1e12]), TRUE + ROUNDING[0] * np.eye(14)[0])
    assert 0.0 < fine[0, 0] < 12.0


def test_what_a_run_is_judged_by(monkeypatch):
    """Noise of 1e-6 px: every method finds camera, attitudes and reprojection; tasks are put together by point."""
    point = Point(
        name="exact", runs=26, noise_px=1e-6, gyro=((0.0, 0.0),), methods=("acc",), stars=6, keep_reprojections=True
    )
    others = Point(name="all", runs=1, noise_px=1e-6, gyro=((0.0, 0.0),), methods=COMPARED, frames="all", stars=6)
    whole = work(Task(config=CONFIG, point=point, first=0, last=2))
    away, square = whole["acc@0.reprojected_px"], whole["acc@0.reprojection_px2"]
    assert 0.0 < np.abs(away).max() < 1e-5
    assert square == pytest.approx(np.array([np.diag(one.T @ one) / len(one) for one in away]))
    every = work(Task(config=CONFIG, point=others, first=0, last=1))
    for name in ("acc@0", "linked@0", "free", "iac", "iac_full"):
        assert every[f"{name}.converged"] == [1.0]
        assert every[f"{name}.distortion_px"][0] < 1e-4
        assert every[f"{name}.sight_arcsec"][0] < 1e-3
        assert (np.abs(every[f"{name}.error"]) < 6.0 * every[f"{name}.sigma"]).all()
    assert every["free.sigma"].shape == (1, 8)
    tasks = []

    def counted(work, tasks_made, advance, *, workers):
        tasks.extend((one.point.name, one.first, one.last) for one in tasks_made)
        for task in tasks_made:
            advance(task)
        return [{"run": np.arange(one.first, one.last)} for one in tasks_made]

    monkeypatch.setattr(monte_carlo, "shared", counted)
    done = []
    trials = perform(CONFIG, [point, others], advance=done.append)
    assert tasks == [("exact", 0, 25), ("exact", 25, 26), ("all", 0, 1)]
    assert done == [25, 1, 1]
    assert np.array_equal(trials["exact"].values["run"], np.arange(26))


def test_stars_of_the_design_stand_evenly_over_the_detector(monkeypatch):
    """Eleven by eleven middles of equal cells, in every second frame of the night."""
    seen = {}
    monkeypatch.setattr(table2_module.LinkedDesign, "at", lambda *given: seen.update(given=given))
    table2_module._even_design(CONFIG, 8.0)
    camera, attitude, _, direction, frame = seen["given"]
    assert np.unique(frame).tolist() == [0, 2, 4, 6, 8, 10]
    first = camera.project(attitude[0].apply(direction[frame == 0]))
    size = np.array([camera.geometry.width_px, camera.geometry.height_px])
    for axis in range(2):
        columns, count = np.unique(first[:, axis].round(6), return_counts=True)
        assert count.tolist() == [11] * 11
        assert np.diff(columns) == pytest.approx(np.full(10, size[axis] / 11))
    assert first.mean(0) == pytest.approx((size - 1) / 2.0)
