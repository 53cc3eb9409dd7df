"""Numbers of the tables from runs with known errors: sizes, ratios, pulls and gains by hand, expectations by draws."""

import numpy as np
import pytest

from experiments.acf import experiment as study
from experiments.acf import table2 as table2_module
from experiments.acf import trials as monte_carlo
from experiments.acf.gain import gain_by_stars, median_ratio, sweep_points
from experiments.acf.methods import compare_methods, fig5_points, largest_distortion
from experiments.acf.reprojection import (
    counts_points,
    expected_at,
    fig3,
    fig3_points,
    fig4,
    infer_star_count,
    inferred_point,
    pool_ratios,
    root_mean_square,
    sweep_star_counts,
    table2_point,
)
from experiments.acf.settings import AcfConfig, AcfSkyConfig, SweepConfig, experiment
from experiments.acf.simulate import build_scene
from experiments.acf.table2 import (
    PRINTED,
    ROUNDING,
    TRUE,
    Covariances,
    _fit,
    covariances,
    degeneracy,
    implied,
    in_degrees,
    printed_reprojection_px2,
    table2,
)
from experiments.acf.trials import (
    COMPARED,
    Task,
    TrialPoint,
    Trials,
    map_grid,
    residual_distortion,
    run_task,
    run_trials,
    sky_of,
)
from experiments.harness.progress import Progress

CONFIG = AcfConfig(
    frames=12,
    runs=4,
    noise_px=(0.1, 0.4),
    bias_deg_per_h=(0.1,),
    angle_random_walk_deg_per_sqrt_h=(0.01,),
    counts=(8, 16),
    sky=AcfSkyConfig(stars_per_frame=12.0),
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
                point,
                method,
                0,
                error=error,
                sigma=np.abs(error) / 2.0,
                residual_distortion_px=wide,
                line_of_sight_arcsec=wide,
            )
        trials[point.name] = Trials(point=point, values=values)
    return compare_methods(CONFIG, trials)


def test_errors_by_noise(fig5):
    for name, errors in zip(COMPARED, fig5["fig5"], strict=True):
        size = SIZE[name] * np.array(CONFIG.noise_px)
        for k, error in enumerate((errors.x0_px, errors.y0_px, errors.focal_length_mm), 1):
            assert error == pytest.approx(k * size)
        assert [number.value for number in errors.residual_distortion_px] == pytest.approx(4.0 * size)
        # values 3, 5, 3, 5: standard deviation sqrt(4 / 3), of the mean half of that
        assert [number.uncertainty for number in errors.residual_distortion_px] == pytest.approx(size / np.sqrt(3.0))
        assert [number.value for number in errors.line_of_sight_arcsec] == pytest.approx(np.sqrt(17.0) * size)


def test_all_noises_together(fig5):
    acc, linked, free, iac, full = fig5["methods"]
    assert (acc.x0_px, acc.y0_px, acc.f_um) == pytest.approx((1.0, 2.0, 3000.0))
    assert (free.residual_distortion_px, free.line_of_sight_arcsec) == pytest.approx((12.0, 3.0 * np.sqrt(17.0)))
    assert [method.ratio_to_acc for method in (acc, linked, free, iac, full)] == pytest.approx(list(SIZE.values()))
    expected = fig5["fig5"][2].expected_line_of_sight_arcsec / CONFIG.noise_px
    assert np.ptp(expected) < 1e-9 * expected[0]  # free attitudes: in proportion to the noise
    assert free.ratio_to_expected.value == pytest.approx(3.0 * np.sqrt(17.0) / expected[0])
    assert free.ratio_to_expected.uncertainty == pytest.approx(1.0 / np.sqrt(2.0 * 4.0 * 8))
    assert [pair.error_ratio for pair in fig5["ratios"]] == [pytest.approx([r] * 5) for r in (5.0, 7.0 / 3.0, 3.0)]
    assert (fig5["fig5"][0].n, fig5["pulls"][0].n) == (4, 8)


def test_pulls_of_all_unknowns(fig5):
    predicted = [covariances(CONFIG, point) for point in fig5_points(CONFIG)]
    for k, unknown in enumerate(fig5["pulls"]):
        assert (unknown.acc, unknown.linked.value) == pytest.approx((2.0, 2.0))
        pulls = [(k + 1) * s / np.sqrt(p.acc[k, k]) for s, p in zip(CONFIG.noise_px, predicted, strict=True)]
        assert unknown.acc_with_gyro_error == pytest.approx(np.hypot(*pulls) / np.sqrt(2.0))
        assert unknown.linked.uncertainty == pytest.approx(0.25)


def test_expected_errors(fig5):
    """In proportion to the noise for free attitudes; what the method says itself for interstar angles."""
    iac = fig5["fig5"][COMPARED.index("iac")]
    assert iac.expected_x0_px == pytest.approx(2.5 * np.array(CONFIG.noise_px))
    assert np.isnan(iac.expected_line_of_sight_arcsec).all()
    for name, noise in zip(("acc", "linked", "free", "iac_full"), (None, None, 4.0, 4.0), strict=True):
        method = fig5["fig5"][COMPARED.index(name)]
        for quantity in ("x0_px", "focal_length_mm", "residual_distortion_px", "line_of_sight_arcsec"):
            expected = getattr(method, f"expected_{quantity}")
            assert expected[1] > expected[0]
            if noise:
                assert expected[1] / expected[0] == pytest.approx(noise)


def test_expected_distortion_against_drawn_cameras():
    """400 cameras drawn from a covariance, judged as fitted ones are: two means of 400 agree to 4 standard errors."""
    camera, grid = build_scene(CONFIG).camera, map_grid(CONFIG, None)
    sigma = 1e-3 * camera.parameter_scales
    drawn = np.random.default_rng(3).standard_normal((400, 8)) * sigma
    largest = [residual_distortion(camera, camera.with_parameters(camera.parameters + d), grid) for d in drawn]
    (expected,) = largest_distortion(CONFIG, [np.diag(sigma**2)])
    assert expected == pytest.approx(np.mean(largest), abs=4.0 * np.std(largest) * np.sqrt(2.0 / 400))


def test_a_gain_that_every_sky_has_is_certain():
    """Errors of both methods differ from sky to sky alike; of independent ones a ratio of medians of 1000 is drawn."""
    rng = np.random.default_rng(3)
    free, pick = rng.lognormal(0.0, 0.5, 1000), rng.integers(0, 1000, (400, 1000))
    certain, guessed = median_ratio(free, 0.5 * free, pick), median_ratio(free, rng.permutation(free), pick)
    assert (certain.value, certain.uncertainty) == pytest.approx((2.0, 0.0), abs=1e-12)
    # a median of n normal logarithms scatters by 0.5 sqrt(pi / 2 n)
    assert guessed.uncertainty == pytest.approx(0.5 * np.sqrt(np.pi / 2000) * np.sqrt(2.0), rel=0.3)


def test_gains_by_hand():
    """Three skies: medians 8 and 2; a run that did not converge counts as infinitely wrong."""
    trials = {}
    for n, point in enumerate(sweep_points(CONFIG), 1):
        values = runs_of(
            point, "free", None, line_of_sight_arcsec=[4, 8, 16], converged=[1, 1, 1], error=np.full((3, 8), 3.0)
        )
        values["free.predicted_arcsec"] = np.array([6.0, 12.0, 18.0])
        for k in range(2):
            for method in ("acc", "linked"):
                # the smallest error is of a run that failed: the median of 2, 4 and infinity
                values |= runs_of(
                    point,
                    method,
                    k,
                    line_of_sight_arcsec=[0.1, 2.0 * n, n],
                    converged=[0, 1, 1],
                    error=np.full((3, 8), 1.0),
                )
                values[f"{method}@{k}.predicted_arcsec"] = np.full(3, 2.0 + 2.0 * k)
            # medians 6 and 3, then 6 and 1.5: logarithms log 2 and log 4
            values[f"linked@{k}.sampled_free_arcsec"] = np.array([[6.0, 6.0], [5.0, 9.0], [9.0, 1.0]])
            values[f"linked@{k}.sampled_arcsec"] = np.array([[3.0, 1.0], [2.0, 1.5], [9.0, 4.0]])
        trials[point.name] = Trials(point=point, values=values)
    few, many = gain_by_stars(CONFIG, trials)
    assert (few.stars_per_frame, many.stars_per_frame) == (4, 12)
    assert [one.value for one in few.acc + few.linked] == pytest.approx([4.0] * 4)
    assert [one.value for one in many.acc] == pytest.approx([2.0] * 2)
    assert few.acc_expected == pytest.approx([6.0, 3.0])
    assert few.linked_expected == pytest.approx([6.0, 3.0])
    assert few.acc[0].uncertainty > 0.0
    spread = np.log(2.0) / np.sqrt(2.0)
    assert few.linked_log_gain_z == pytest.approx([0.5 * np.log(2.0) / spread] * 2)
    assert few.linked_log_gain_unit_z == pytest.approx([1.0 / spread] * 2)


@pytest.fixture(scope="module")
def reprojected():
    """Runs whose mean squares are 1.21 times the expected ones along both axes, twice as large for the second half."""
    trials, wide = {}, 1.1 * np.array([0.8, 1.0, 1.0, 1.2])
    inferred = inferred_point(CONFIG, 6.0, 20)
    for point in (*fig3_points(CONFIG), *counts_points(CONFIG), table2_point(CONFIG), inferred):
        values = {}
        for k in range(len(point.gyro)):
            (expected,) = expected_at(CONFIG, point, k)
            length = wide * expected.mean_px
            values |= runs_of(point, "acc", k, reprojection_px2=np.outer(length**2, [0.36, 0.64]))
            if point.keep_reprojection_errors:
                values |= runs_of(
                    point, "acc", k, reprojection_error_px=np.tile([[[0.03, 0.04], [0.0, 0.01]]], (4, 1, 1)),
                    error=SIGN * np.arange(1.0, 15.0) * 1e-4, line_of_sight_arcsec=[3.0, 5.0, 3.0, 5.0],
                )  # fmt: skip
        trials[point.name] = Trials(point=point, values=values)
    return trials, inferred


def test_reprojection_over_its_prediction(reprojected):
    trials, inferred = reprojected
    ratio = pool_ratios(CONFIG, trials).ratio_to_expected
    assert (ratio.value, ratio.n) == (pytest.approx(1.1), 16)
    # four points of four runs; standard deviation of a run 1.1 sqrt(0.08 / 3)
    assert ratio.uncertainty == pytest.approx(1.1 * np.sqrt(0.08 / 3.0) / 4.0)
    by_bias, by_walk = fig3(CONFIG, trials)
    for panel in (by_bias, by_walk):
        measured = np.array([[number.value for number in row] for row in panel.rms_px])
        np.testing.assert_allclose(measured, 1.1 * panel.expected_px, rtol=1e-9)
        assert (panel.expected_px[:, 1] > panel.expected_px[:, 0]).all()
        assert panel.expected_px[1, 0] / panel.expected_px[0, 0] == pytest.approx(4.0)  # perfect gyro
    assert np.array_equal(by_bias.expected_px[:, 0], by_walk.expected_px[:, 0])
    eight, sixteen = sweep_star_counts(CONFIG, trials)
    assert (eight.stars_per_frame, sixteen.stars_per_frame) == (8, 16)
    assert [number.value for number in eight.rms_px] == pytest.approx(1.1 * eight.expected_px)
    assert eight.expected_px[0] / sixteen.expected_px[0] == pytest.approx(np.sqrt(2.0), rel=0.15)  # sigma sqrt(14 / n)
    assumed, other = fig4(CONFIG, trials, inferred)
    rms = 1.1 * np.sqrt(1.02) * assumed.expected_rms_length_px.value
    assert [number.value for number in assumed.rms_px] == pytest.approx([0.6 * rms, 0.8 * rms])
    assert np.hypot(*assumed.expected_rms_px) == pytest.approx(assumed.expected_rms_length_px.value, rel=0.02)
    assert (assumed.largest_px, assumed.fraction_below_0_04_px) == (pytest.approx(0.05), 0.5)
    assert (assumed.pixel_um, other.pixel_um, other.stars_per_frame) == (CONFIG.camera.pixel_pitch_um, 6.0, 20)
    assert assumed.stars_per_frame == pytest.approx(len(sky_of(CONFIG, table2_point(CONFIG), 0).stars.frame) / 12)
    published = np.hypot(0.0132, 0.0123)
    assert assumed.published_rms_length_px == pytest.approx(published)
    expected = assumed.expected_rms_length_px
    assert assumed.published_deviation_sigma == pytest.approx((published - expected.value) / expected.uncertainty)


def test_stars_that_give_the_published_error():
    """The expectation at the result is the published RMS; without the gyro's part it is sigma sqrt(14 / n)."""
    result = infer_star_count(CONFIG, 10.0, stars=40)
    published = np.hypot(0.0132, 0.0123)
    assert result.stars_per_frame_perfect_gyro == pytest.approx(14.0 * (CONFIG.table_noise_px / published) ** 2 / 6.0)
    assert result.stars_per_frame_range[0] <= result.stars_per_frame <= result.stars_per_frame_range[1]
    at_40, at_10 = (
        expected_at(
            CONFIG, TrialPoint(name="", runs=0, noise_px=0.1 * s, gyro=((0.03, 0.005),), methods=(), stars=40), 0
        )[0]
        for s in (1.0, 2.0)
    )
    gyro2 = (4.0 * at_40.total_px**2 - at_10.total_px**2) / 3.0  # a quarter of the stars: twice the noise
    assert result.gyro_rms_px == pytest.approx(np.sqrt(gyro2), rel=1e-6)
    star2 = 40.0 / result.stars_per_frame * (at_40.total_px**2 - gyro2)
    assert star2 + gyro2 == pytest.approx(published**2, rel=1e-6)


def test_table_2(reprojected):
    trials, _ = reprojected
    scene = build_scene(AcfConfig())
    np.testing.assert_allclose(scene.camera.parameters, TRUE[:8])
    assert (*AcfConfig().sky.phi_deg, *AcfConfig().gyro.installation_deg) == tuple(TRUE[8:])
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
    joint = degeneracy(CONFIG, trials, every)
    assert joint.radial_correlation == pytest.approx([0.5, 0.5, 0.5])
    assert joint.line_of_sight_arcsec == pytest.approx(np.sqrt(17.0))


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


def test_errors_of_a_run(monkeypatch):
    """Noise of 1e-6 px: every method recovers camera, attitudes and reprojection; tasks are joined by point."""
    point = TrialPoint(
        name="exact",
        runs=26,
        noise_px=1e-6,
        gyro=((0.0, 0.0),),
        methods=("acc",),
        stars=6,
        keep_reprojection_errors=True,
    )
    others = TrialPoint(name="all", runs=1, noise_px=1e-6, gyro=((0.0, 0.0),), methods=COMPARED, frames="all", stars=6)
    two_runs = run_task(Task(config=CONFIG, point=point, first=0, last=2))
    error_px, square = two_runs["acc@0.reprojection_error_px"], two_runs["acc@0.reprojection_px2"]
    assert 0.0 < np.abs(error_px).max() < 1e-5
    assert square == pytest.approx(np.array([np.diag(run.T @ run) / len(run) for run in error_px]))
    every = run_task(Task(config=CONFIG, point=others, first=0, last=1))
    for name in ("acc@0", "linked@0", "free", "iac", "iac_full"):
        assert every[f"{name}.converged"] == [1.0]
        assert every[f"{name}.residual_distortion_px"][0] < 1e-4
        assert every[f"{name}.line_of_sight_arcsec"][0] < 1e-3
        assert (np.abs(every[f"{name}.error"]) < 6.0 * every[f"{name}.sigma"]).all()
    assert every["free.sigma"].shape == (1, 8)
    tasks = []

    def counted(run_task, tasks_made, advance, *, workers):
        tasks.extend((one.point.name, one.first, one.last) for one in tasks_made)
        for task in tasks_made:
            advance(task)
        return [{"run": np.arange(one.first, one.last)} for one in tasks_made]

    monkeypatch.setattr(monte_carlo, "shared", counted)
    done = []
    trials = run_trials(CONFIG, [point, others], advance=done.append)
    assert tasks == [("exact", 0, 25), ("exact", 25, 26), ("all", 0, 1)]
    assert done == [25, 1, 1]
    assert np.array_equal(trials["exact"].values["run"], np.arange(26))


def test_stars_of_the_scaled_design_are_a_regular_grid(monkeypatch):
    """Eleven by eleven centres of equal cells, in every second frame of the night."""
    monkeypatch.setattr(table2_module.LinkedDesign, "at", lambda *arguments: arguments)
    camera, attitude, _, direction, frame = table2_module._even_design(CONFIG, 8.0)
    assert np.unique(frame).tolist() == [0, 2, 4, 6, 8, 10]
    first = camera.project(attitude[0].apply(direction[frame == 0]))
    size = np.array([camera.geometry.width_px, camera.geometry.height_px])
    for axis in range(2):
        columns, count = np.unique(first[:, axis].round(6), return_counts=True)
        assert count.tolist() == [11] * 11
        assert np.diff(columns) == pytest.approx(np.full(10, size[axis] / 11))
    assert first.mean(0) == pytest.approx((size - 1) / 2.0)


@pytest.fixture(scope="module")
def from_table2():
    return implied(points=11)


@pytest.fixture(scope="module")
def outcome(from_table2):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "implied", lambda: from_table2)
        return experiment.outcome(CONFIG, study.run(CONFIG, progress=Progress()))


def test_every_calibration_converges_from_the_start_of_table_2(outcome):
    assert outcome.values("convergence.n", method="acc") == 4 * (2 * 3 + 2 + 2 * 2 + 1 + 2)  # by hand
    assert outcome.values("convergence.failed").sum() == 0


def test_runs_do_not_depend_on_how_they_are_cut_into_tasks():
    point = TrialPoint(
        name="cut", runs=3, noise_px=0.2, gyro=((0.03, 0.005),), methods=("acc", "free"), new_sky_each_run=True, stars=8
    )
    together = run_task(Task(config=CONFIG, point=point, first=0, last=3))
    first, rest = (run_task(Task(config=CONFIG, point=point, first=a, last=b)) for a, b in ((0, 1), (1, 3)))
    assert set(together) == set(first)
    for key, values in together.items():
        assert np.array_equal(values, np.concatenate([first[key], rest[key]])), key


@pytest.mark.slow
def test_the_printed_table_implies_the_pixel(from_table2):
    """Where the printed errors of y0 [px] and phi1 [arcsec] cancel: 26.64 arcsec x 25.6 mm / 0.51 px = 6.48 um."""
    pixel = from_table2.pixel_um
    assert np.deg2rad(26.64 / 3600) * 25.6 / 0.51 * 1e3 == pytest.approx(pixel.value, abs=3 * pixel.uncertainty)
    assert pixel.uncertainty < 0.4
    assert from_table2.chi2 < 30.0 < from_table2.chi2_at_assumed_pixel
    assert from_table2.stars_per_frame_range[0] < from_table2.stars_per_frame < from_table2.stars_per_frame_range[1]


@pytest.mark.slow
def test_pixel_and_stars_of_simulated_tables_are_recovered():
    """Eight runs with 8 um pixels and 20 stars per frame, printed with ACF17's digits.

    Pulls of the pixel: mean within 4 / sqrt(8); their RMS within a factor of two. The true number of stars lies in the
    68 % range of most of them, and chi^2 of 11 averages to 11 within 4 sqrt(22 / 8).
    """
    point = TrialPoint(
        name="again", runs=8, noise_px=0.1, gyro=((0.03, 0.005),), methods=("acc",), stars=20, pixel_um=8.0
    )
    runs = run_task(Task(config=AcfConfig(), point=point, first=0, last=8))["acc@0.error"]
    runs[:, 8:] = np.degrees(runs[:, 8:])
    pulls, inside_range, chi2 = [], [], []
    for error in runs:
        result = implied(points=11, printed=np.round((TRUE + error) / ROUNDING) * ROUNDING)
        pulls.append((result.pixel_um.value - 8.0) / result.pixel_um.uncertainty)
        inside_range.append(result.stars_per_frame_range[0] < 20 < result.stars_per_frame_range[1])
        chi2.append(result.chi2)
    assert abs(np.mean(pulls)) < 4 / np.sqrt(8)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 2.0
    assert sum(inside_range) >= 3
    assert np.mean(chi2) == pytest.approx(11, abs=4 * np.sqrt(22 / 8))


def test_defaults_are_the_published_run():
    config = AcfConfig()
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
def test_workers_change_no_number(outcome, from_table2, monkeypatch):
    """The same bits from one process as from two."""
    monkeypatch.setattr(study, "implied", lambda: from_table2)
    config = CONFIG.model_copy(update={"workers": 2})
    assert outcome.data.identical(experiment.outcome(config, study.run(config, progress=Progress())).data)


def test_error_of_a_root_mean_square():
    """Of n normal numbers of size s: s within s / sqrt(2 n), which the estimate of that gives to some percent."""
    n, size = 20000, 3.0
    rms, error = root_mean_square((size * np.random.default_rng(7).standard_normal((n, 2))) ** 2, 0)
    assert rms == pytest.approx([size, size], abs=4 * size / np.sqrt(2 * n))
    assert error == pytest.approx([size / np.sqrt(2 * n)] * 2, rel=0.05)
