"""ACC18's chromatic statistic and calibrations on hand-made fields; uncertainties on many simulated cameras."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.measure.stamps import stamps_from_windows
from experiments.laboratory.bench.point_bench import band_pairs
from experiments.laboratory.bench.points import nominal_px, pattern_effect
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from experiments.laboratory.bench.readout.search import common_shift
from experiments.laboratory.chromatic_error import (
    after_calibration,
    measure_chromatic,
    rms,
    shift_sigma,
    shifts,
    table1,
    table1_sigma,
)
from optics.lens.perturb import decentre
from optics.rays.spots import trace_spots
from render.engine.random import Streams
from render.sensor_file.instrument import build_instrument
from render.sensor_file.tables import InstrumentConfig


@pytest.fixture
def field():
    """Places (4, 25, 2) of the target's points from the centre, and a generator."""
    grid = np.stack(np.meshgrid(np.arange(-2, 3) * 150.0, np.arange(-2, 3) * 150.0), axis=-1).reshape(25, 2)
    centres = np.array([[-1600, -570], [1600, -570], [-1600, 570], [1600, 570.0]])
    return centres[:, None] + grid


def test_pairs_put_the_longer_wavelength_first():
    assert band_pairs((500.0, 600.0, 800.0), 1) == [("600-500", 1, 0), ("800-600", 2, 1)]
    assert band_pairs((800.0, 600.0, 500.0), 1) == [("800-600", 0, 1), ("600-500", 1, 2)]
    assert band_pairs((500.0, 600.0, 800.0), 0) == [("600-500", 1, 0), ("800-500", 2, 0)]
    assert band_pairs((656.3, 486.1), 0) == [("656.3-486.1", 0, 1)]


def test_shift_is_longer_minus_shorter_wavelength():
    position = np.zeros((4, 25, 3, 2))
    position[..., 0, :], position[..., 2, :] = [1.0, 2.0], [10.0, 20.0]
    found = shifts(position, band_pairs((500.0, 600.0, 800.0), 1))
    assert np.all(found["600-500"] == [-1.0, -2.0])
    assert np.all(found["800-600"] == [10.0, 20.0])


def test_eq_16_of_an_odd_field_vanishes_and_of_a_constant_is_half(field):
    odd = field * 1e-4 + field * (field**2).sum(-1, keepdims=True) * 1e-11
    assert np.abs(odd).max() > 0.2
    assert table1(odd) == pytest.approx([0, 0], abs=1e-15)
    assert table1(odd + np.array([0.24, -0.1])) == pytest.approx([0.12, -0.05], abs=1e-15)


def test_eq_16_counts_every_point_alike():
    one = np.zeros((4, 25, 2))
    one[2, 7] = [200.0, -400.0]
    assert table1(one) == pytest.approx([1.0, -2.0])  # 200 / (2 * 4 * 25)
    assert table1(np.stack([one, 2 * one])) == pytest.approx(np.array([[1.0, -2.0], [2.0, -4.0]]))


def test_rms_is_per_axis():
    shift = np.zeros((4, 25, 2))
    shift[:, :, 0] = 0.3 * np.where(np.arange(25) % 2, 1, -1)
    shift[:2, :, 1] = 0.4
    assert rms(shift) == pytest.approx([0.3, 0.4 / np.sqrt(2)])


def test_calibration_of_a_pure_offset_and_of_a_pure_scale(field):
    left = after_calibration(np.broadcast_to([0.2, -0.1], field.shape), field)
    assert np.abs(left["as found"] - [0.2, -0.1]).max() == 0
    assert np.abs(left["principal point"]).max() < 1e-14
    # the four positions lie symmetrically: no scale looks like an offset
    assert np.abs(left["focal length"] - [0.2, -0.1]).max() < 1e-14
    assert np.abs(left["both"]).max() < 1e-14
    left = after_calibration(1e-4 * field, field)
    assert np.abs(left["principal point"] - 1e-4 * field).max() < 1e-14
    assert np.abs(left["focal length"]).max() < 1e-14
    assert np.abs(left["both"]).max() < 1e-14


def test_calibration_of_both_on_one_side_of_the_field(field):
    """Away from symmetry the two parameters mix; fitted together they still find each its own."""
    place = field[:1] + np.array([5000.0, 3000.0])
    left = after_calibration(1e-4 * place + [0.2, -0.1], place)
    assert np.abs(left["both"]).max() < 1e-12
    assert np.abs(left["focal length"]).max() > 1e-3
    assert np.abs(left["principal point"]).max() > 1e-3


def test_calibration_leaves_the_cubic(field):
    """What is left is orthogonal to what was fitted, and is the cubic minus its own best scale."""
    squared = (field**2).sum(-1, keepdims=True)
    cubic = 1e-11 * squared * field
    left = after_calibration(cubic + 3e-5 * field + [0.05, 0.02], field)["both"]
    scale = (squared**2).sum() / squared.sum()  # sum(r^3 r) / sum(r r)
    assert np.abs(left - 1e-11 * (squared - scale) * field).max() < 1e-13
    assert (left * field).sum() == pytest.approx(0, abs=1e-9)
    assert left.sum((0, 1)) == pytest.approx([0, 0], abs=1e-11)


def test_common_shift_is_what_most_detections_agree_on():
    rng = np.random.default_rng(1)
    offset = np.concatenate([rng.normal([31.0, -12.0], 0.5, (25, 2)), rng.uniform(-80, 80, (60, 2))])
    assert common_shift(offset) == pytest.approx([31.0, -12.0], abs=0.5)
    assert common_shift(np.full((3, 2), 500.0)) == pytest.approx([0, 0])


@pytest.fixture(scope="module")
def small_camera(tmp_path_factory):
    """The default lens, by rays, in front of few pixels: patterns of a whole chip would take most of the time."""
    path = tmp_path_factory.mktemp("chip") / "few.toml"
    path.write_text('base = "cmv4000"\nname = "few"\nchip_width_px = 640\nchip_height_px = 512\n')
    return build_instrument(InstrumentConfig(detector=str(path), diffraction="rays"))


def quick_measure(bench, instrument, seed):
    return measure_chromatic(bench, instrument, Streams(seed).child("test"), advance=lambda: None)


def with_sensor(instrument, sensor_seed, **changes):
    return replace(instrument, detector=replace(instrument.detector, sensor_seed=sensor_seed, **changes))


@pytest.fixture(scope="module")
def measured(engine, bench_of, small_camera):
    return quick_measure(bench_of(rows=1, columns=2, frames=2, dark_frames=2), small_camera, 1)


def test_record_of_every_position_point_and_filter(measured, small_camera):
    """Shapes as documented; spots at 800 nm are those of the lens's diagram at the points."""
    for of in (measured.mean_px, measured.sigma_px):
        assert of["epsf"].shape == measured.noise_px.shape == (4, 2, 3, 2)
    assert np.abs(measured.mean_px["epsf"] - measured.photon_px).max() < 0.1
    assert measured.pattern_px["epsf"].shape[1:] == (4, 2, 3, 2)
    direction = measured.direction.reshape(-1, 3)
    field = np.degrees(np.arctan(direction[:, :2] / direction[:, 2:])).T
    spots = trace_spots(small_camera.camera.focused_lens, *field, np.array([800.0]), order=(12, 24))
    x, y, light = spots.rays.x, spots.rays.y, spots.area_mm2
    total = light.sum(-1, keepdims=True)
    square = sum((light * (v - (light * v).sum(-1, keepdims=True) / total) ** 2).sum(-1) for v in (x, y))
    assert measured.rms_spot_um[2] == pytest.approx(1e3 * np.sqrt(square / total[..., 0]).mean(), rel=0.02)


@pytest.mark.slow
def test_a_wedge_in_one_filter_shows_as_half_of_its_motion(measured, bench_of, small_camera):
    """Rationale: eq. 13-16 on frames, by a motion of whole pixels behind the last filter. Expected: half of it."""
    bench = bench_of(rows=1, columns=2, frames=2, dark_frames=2)
    x, y = nominal_px(small_camera, measured.direction.reshape(-1, 3)).T
    turned = small_camera.camera.nominal_direction(x + 2.0, y - 1.0, small_camera.focal_length_mm)
    turned = turned.reshape(measured.direction.shape)
    wedged = measure_chromatic(bench, small_camera, Streams(7).child("test"), directions=turned)
    place = measured.mean_px["epsf"].copy()
    place[:, :, 2] = wedged.mean_px["epsf"][:, :, 2]
    before, after = (
        {name: table1(shift) for name, shift in shifts(one, bench.pairs).items()}
        for one in (measured.mean_px["epsf"], place)
    )
    sigma = table1_sigma(measured, bench.pairs, "epsf")["800-600"]
    # 0.2 %: distortion and lateral colour change the scale of the image
    assert np.abs(after["800-600"] - before["800-600"] - [1.0, -0.5]).max() < 4 * np.sqrt(2) * sigma.max() + 2e-3
    assert np.array_equal(after["600-500"], before["600-500"])


@pytest.mark.slow
def test_moved_image_is_found_again(engine, bench_of, small_camera):
    """The target is looked for where the lens puts it, up to 80 px away; its comatic spots are not given up."""
    bench = bench_of(frames=2, dark_frames=2)
    moved = build_instrument(small_camera.config, decentre(small_camera.camera.lens, "L2", -0.4, 0.1))
    measured = quick_measure(bench, moved, 3)
    expected = bundle_prediction(bench, moved, measured.direction)
    assert np.abs(measured.nominal_px - expected[:, :, 1]).max() > 40
    assert np.abs(measured.mean_px["epsf"] - expected).max() < 0.1


RUNS = 16


@pytest.mark.slow
def test_uncertainties_of_table_1_are_as_stated(engine, bench_of, small_camera, traced_once):
    """16 cameras (fixed patterns) and noise seeds: the entries scatter about the truth as their sigma says.

    Two pairs share the 600 nm band (correlation 1/2, so 1/4 between their squares) and the two axes are independent:
    the variance of the mean of 64 squared pulls is 2.5/64, and four standard deviations are allowed.
    """
    bench = bench_of()
    pulls = []
    for seed in range(RUNS):
        camera = with_sensor(small_camera, 1000 + seed)
        found = quick_measure(bench, camera, seed)
        seen, light = (shifts(place, bench.pairs) for place in (found.mean_px["epsf"], found.photon_px))
        sigma = table1_sigma(found, bench.pairs, "epsf")
        pulls.append([(table1(seen[name]) - table1(light[name])) / sigma[name] for name in sigma])
    pulls = np.array(pulls)
    spread = np.sqrt(2.5 / pulls.size)
    assert abs((pulls**2).mean() - 1) < 4 * spread
    # no bias: the mean of 16 independent pulls per entry, the largest of four
    assert np.abs(pulls.mean(0)).max() * np.sqrt(RUNS) < 4


SENSORS = 16


@pytest.mark.slow
def test_effect_of_the_fixed_pattern_is_predicted(engine, bench_of, small_camera, traced_once):
    """The prediction draws response patterns; here 16 sensors are made, and their mean centroids scatter.

    16 points x 2 axes x 16 sensors, against 48 predicted patterns for each of those: the relative standard deviation of
    their variances is sqrt(2 / 512) and sqrt(2 / 24576), together 6.3 %; four of them are allowed. The filters do not
    count, the pattern is common to them. The temporal part is taken off.
    """
    bench = bench_of(frames=40, dark_frames=100)
    place, temporal, predicted, noise = [], [], [], []
    for seed in range(SENSORS):
        camera = with_sensor(small_camera, 2000 + seed, prnu=0.05)
        measured = quick_measure(bench, camera, seed)
        place.append(measured.mean_px["epsf"] - measured.photon_px)
        temporal.append((measured.sigma_px["epsf"] ** 2 / measured.frames_used[..., None]).mean())
        predicted.append((measured.pattern_px["epsf"] ** 2).mean((0, 1, 2)))
        noise.append(measured.sigma_px["epsf"] ** 2 / measured.noise_px**2)
    found = np.var(place, axis=0, ddof=1).mean((0, 1)) - np.mean(temporal)  # (b, 2)
    spread = np.sqrt(2 / (32 * SENSORS) + 2 / (32 * 48 * SENSORS))
    assert found.mean() > 10 * np.mean(temporal)
    assert abs(found.mean() / np.mean(predicted) - 1) < 4 * spread
    # the noise of every point, of 16 x 39 differences
    assert np.abs(np.mean(noise, axis=0) - 1.0).max() < 4.5 * np.sqrt(2.0 / (SENSORS * 39))


def test_sigma_of_a_shift_is_that_of_its_own_point(measured):
    """Noise of points differs by three, and patterns add: pulls of variance 1, whatever the scatter of the others."""
    rng = np.random.default_rng(5)
    noise = rng.uniform(0.5, 1.5, (4, 9, 3, 2))
    pattern = 1e-4 * rng.standard_normal((200, *noise.shape))  # the noise of a mean is twice as large
    frames = 1.1e-3 * noise * rng.standard_normal((400, 30, *noise.shape))  # 10 % more than was foreseen
    pulls = []
    for number, run in enumerate(frames):
        found = replace(
            measured,
            mean_px={"epsf": run.mean(0)},
            sigma_px={"epsf": run.std(0, ddof=1)},
            noise_px=1e-3 * noise,
            pattern_px={"epsf": pattern},
            frames_used=np.full(noise.shape[:3], 30),
        )
        pairs = [("800-600", 2, 1)]
        sigma = shift_sigma(found, pairs, "epsf")["800-600"]
        pulls.append(shifts(run.mean(0) + pattern[number % 200], pairs)["800-600"] / sigma)
    # 400 pulls of 72 points: the largest and least of their variances, and the mean
    square = np.square(pulls).mean(0)
    assert np.abs(square - 1.0).max() < 4.5 * np.sqrt(2.0 / 400)
    assert abs(square.mean() - 1.0) < 4.5 * np.sqrt(2.0 / (400 * 72))


def test_sigma_of_eq_16_is_the_scatter_of_its_mean(measured):
    """Noise of points, motion that the points of a position share, patterns: 4000 drawn means of each."""
    rng, common = np.random.default_rng(6), 5e-4
    noise = 1e-3 * rng.uniform(0.5, 1.5, (4, 9, 3, 2))
    pattern = 1e-4 * rng.standard_normal((200, *noise.shape))
    found = replace(
        measured,
        sigma_px={"epsf": np.hypot(noise, common)},
        pattern_px={"epsf": pattern},
        frames_used=np.full(noise.shape[:3], 30),
        common_px=common,
    )
    pairs = [("800-600", 2, 1)]
    moved = noise * rng.standard_normal((4000, *noise.shape)) + common * rng.standard_normal((4000, 4, 1, 3, 2))
    drawn = table1(shifts(moved / np.sqrt(30) + np.tile(pattern, (20, 1, 1, 1, 1)), pairs)["800-600"])
    assert table1_sigma(found, pairs, "epsf")["800-600"] == pytest.approx(drawn.std(0), rel=4.5 / np.sqrt(2 * 4000))


def test_pattern_effect_on_a_centre_of_gravity(measured):
    """No PRNU and no dark noise: nothing moves. With PRNU: the closed form of a centre of gravity."""

    class Centre:
        def measure(self, stamps, noise):
            index = np.arange(stamps.electrons.shape[1])
            total = stamps.electrons.sum((1, 2))
            return SimpleNamespace(
                x_px=(stamps.electrons.sum(1) * index).sum(1) / total,
                y_px=(stamps.electrons.sum(2) * index).sum(1) / total,
            )

    stamps, noise = stamps_from_windows(measured.windows[0], background_e=0.0, start_px=measured.photon_px[0, :, 0])
    light = np.random.default_rng(2).uniform(10, 20, (2, 13, 13))
    still = pattern_effect(Centre(), stamps, noise, light, prnu=0.0, dark_e=0.0, rng=np.random.default_rng(3))
    assert np.all(still == 0)
    moved = pattern_effect(Centre(), stamps, noise, light, prnu=0.01, dark_e=0.0, rng=np.random.default_rng(3))
    # centroid of independent pixel errors: var = prnu^2 sum (x - c)^2 e^2 / (sum e)^2
    index = np.arange(13)
    total = light.sum((1, 2))
    centre = (light.sum(1) * index).sum(1) / total
    variance = 1e-4 * ((index - centre[:, None]) ** 2 * (light**2).sum(1)).sum(1) / total**2
    # 48 patterns x 2 points: the variance is known to sqrt(2 / 96) = 14 %; four of them
    assert (moved[..., 0] ** 2).mean() == pytest.approx(variance.mean(), rel=0.58)
