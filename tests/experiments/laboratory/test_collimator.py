"""The collimator's errors against published numbers, closed forms and brute force; broken equations are noticed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf, j1

from calib.accuracy.chromatic import shifts, table1
from experiments.chromatic.settings import ChromaticConfig
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.points import filter_scene, frame_light
from experiments.laboratory.bench.ray_prediction import bundle_prediction, expected_spots
from experiments.laboratory.devices import collimator_effects as effects
from experiments.laboratory.devices.collimator import build_collimator
from experiments.laboratory.devices.target import corner_directions
from experiments.laboratory.settings.collimator import CollimatorConfig, FilteredCollimatorConfig
from optics.glass.absolute_index import Environment
from optics.light.spectrum import Blackbody
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.filters import interference_filters
from render.sensor_file.instrument import build_instrument

D_LINE = np.array([[587.5618]])
BAND = [SimpleNamespace(name="d")]


def light(**settings):
    return build_collimator(FilteredCollimatorConfig(**settings), BAND).light(BAND, D_LINE, Environment())


def test_wedge_of_bk7_turns_light_by_half_its_angle():
    """n_d = 1.51680 (SCHOTT); halfway between target and collimator the angle in the collimated beam is half of it."""
    slope = light(wedge_arcsec=(10.0,), wedge_direction_deg=(90.0,)).slope_rad[0, 0] / ARCSEC_RAD
    np.testing.assert_allclose(slope, [0.0, 5.1680], atol=2e-4)
    near = light(wedge_arcsec=(10.0,), filter_distance_mm=500.0).slope_rad[0, 0] / ARCSEC_RAD
    np.testing.assert_allclose(near, [2.5840, 0.0], atol=2e-4)


def test_only_filters_that_have_a_wedge_turn_light():
    """A wheel whose band is not among the wedges, as the open hole: decollimated like the others, not turned."""
    wheel = build_collimator(FilteredCollimatorConfig(wedge_arcsec=(10.0,), decollimation_um=100.0), BAND)
    seen = wheel.light([*BAND, SimpleNamespace(name="open")], np.repeat(D_LINE, 2, axis=0), Environment())
    assert seen.slope_rad[0, 0, 0] / ARCSEC_RAD == pytest.approx(5.168, abs=2e-4)
    assert not seen.slope_rad[1].any()
    assert seen.vergence_per_mm[0, 0] == seen.vergence_per_mm[1, 0] != 0.0


def test_target_behind_the_focus_is_imaged_in_front_of_the_camera():
    """1 / s' = 1 / f - 1 / s; light that runs together there comes, for a camera beside the axis, from its own side."""
    seen = light(decollimation_um=300.0, offset_mm=(5.0, 0.0))
    image_mm = 1.0 / (1.0 / 1000.0 - 1.0 / 1000.3)
    assert -1.0 / seen.vergence_per_mm[0, 0] == pytest.approx(image_mm, rel=1e-9)
    np.testing.assert_allclose(seen.slope_rad[0, 0], [5.0 / image_mm, 0.0], rtol=1e-9)
    colour = light(focus_wavelength_nm=(486.0, 656.0), focus_um=(-100.0, 100.0))
    part = (D_LINE[0, 0] - 486.0) / 170.0 * 200.0 - 100.0
    assert colour.vergence_per_mm[0, 0] == pytest.approx(part * 1e-3 / 1000.0**2, rel=1e-3)


def test_warm_air_seems_to_draw_the_source():
    """dn/dT of air is -0.93e-6 / K at 20 C (Ciddor 1996)."""
    slope = light(air_path_m=2.0, air_gradient_k_per_m=(0.0, 1.0)).slope_rad[0, 0]
    np.testing.assert_allclose(slope, [0.0, 2.0 * 0.93e-6], rtol=0.01, atol=1e-15)


def test_vibration_is_split_by_the_exposure():
    """Drawn oscillations, averaged; nothing of the integral over sinc² takes part."""
    config = CollimatorConfig(vibration_hz=(0.5, 8.0, 60.0), vibration_arcsec2_per_hz=(0.2, 0.05, 1e-4))
    collimator = build_collimator(config)
    between, within = collimator.power_arcsec2(0.1)
    assert between + within == pytest.approx(collimator.spectrum.rms_arcsec[0] ** 2, rel=1e-6)
    assert 0.2 < between / within < 5.0
    count = 4000
    seen = [collimator.offsets_px(Streams(n), count // 20, 0.1, 2.0).var(0, ddof=1) * 4.0 for n in range(20)]
    np.testing.assert_allclose(np.mean(seen, axis=0), between, rtol=4.0 * np.sqrt(2.0 / count))


def test_frames_hold_the_light_where_the_line_of_sight_stands():
    """Against pixel integrals of a Gaussian at every place."""
    sigma, cells, size = 0.6, 8, 13

    def along(pixel, place):
        low, high = (pixel - place + side for side in (-0.5, 0.5))
        return 0.5 * (erf(high / sigma / 2**0.5) - erf(low / sigma / 2**0.5))

    grid = np.arange(-48, 49) / cells
    psf = EffectivePsf(values=np.outer(along(grid, 0.0), along(grid, 0.0)), oversampling=cells)
    offset = np.array([[0.0, 0.0], [0.31, -0.17], [-0.6, 0.4]])
    moving = SimpleNamespace(offsets_px=lambda *_: offset)
    bench, instrument = (
        SimpleNamespace(collimator=moving, frames=3),
        SimpleNamespace(exposure_s=0.1, pixel_arcsec=5.0),
    )
    pixel, place = np.arange(size), np.array([6.2, 5.9])

    def image(at):
        return 5000.0 * np.outer(along(pixel, at[1]), along(pixel, at[0]))

    light = SimpleNamespace(
        light_e=image(place)[None], corner_px=np.zeros((1, 2), int), bundle_px=place[None], psf=[psf]
    )
    frames = frame_light(light, bench, instrument, Streams(0))
    for frame, shift in zip(frames[:, 0], offset, strict=True):
        np.testing.assert_allclose(frame, image(place + shift), atol=0.5)


def test_a_pinhole_spreads_the_psf_over_its_disk():
    """A Gaussian, averaged over places all over the disk, none of them by a transform."""
    sigma, cells, radius_px = 0.7, 8, 0.9
    pixel_rad = 0.5 * 10.0e-3 / 1000.0 / radius_px
    at = np.arange(-56, 57) / cells
    point = EffectivePsf(values=np.exp(-0.5 * (at**2 + at[:, None] ** 2) / sigma**2), oversampling=cells)
    seen = build_collimator(CollimatorConfig(pinhole_um=10.0)).pinhole_psf(point, pixel_rad).values
    along = (np.arange(80) + 0.5) / 40 - 1.0
    inside = np.argwhere(along**2 + along[:, None] ** 2 < 1.0)
    there = radius_px * along[inside]
    expected = np.exp(-0.5 * (at[:, None] - there[:, 0]) ** 2 / sigma**2) @ np.exp(
        -0.5 * (at - there[:, 1, None]) ** 2 / sigma**2
    )
    np.testing.assert_allclose(seen, expected / len(there), atol=1e-3)


def test_motion_of_the_line_of_sight_over_its_prediction_scatters_as_stated():
    """Two levels of 30 frames move by 0.02 px along both axes; means of the stars' own errors add 0.01 px."""
    rng, runs = np.random.default_rng(5), 2000
    bench = SimpleNamespace(power_px2=lambda _: (4e-4, 1e-4), frames=30)
    instrument = SimpleNamespace(pixel_arcsec=5.0)
    seen = np.hypot(0.02, 0.01) * rng.standard_normal((runs, 2, 30, 2))
    own = np.full((runs, 2, 2), 1e-4)
    every = np.stack([seen.var(2, ddof=1) - own, own], axis=2)  # levels, (motion, own), axes
    found = [effects.line_of_sight(bench, instrument, one) for one in every]
    assert (found[0].frame_to_frame_arcsec, found[0].within_frame_arcsec) == pytest.approx((0.3, 0.15))
    ratio, stated = np.array([[(m.value, m.uncertainty) for m in one.ratio] for one in found]).transpose(2, 0, 1)
    assert (ratio**2).mean() == pytest.approx(1.0, abs=4.0 * 2.0 * stated.mean() / np.sqrt(2 * runs))
    assert ratio.std() == pytest.approx(stated.mean(), rel=4.0 / np.sqrt(4 * runs) + 0.03)
    assert effects.line_of_sight(SimpleNamespace(power_px2=lambda _: (0.0, 0.0)), instrument, every[0]) is None


@pytest.fixture(scope="module")
def laboratory():
    config = ChromaticConfig.model_validate(
        {
            "instrument": {"detector": "cmv4000", "width_px": 700, "height_px": 500},
            "target": {"rows": 2, "columns": 2, "edge_px": 60.0},
            "collimator": {
                "decollimation_um": 200.0,
                "focus_wavelength_nm": [400.0, 600.0, 900.0],
                "focus_um": [150.0, 0.0, 250.0],
                "offset_mm": [30.0, -20.0],
                "pinhole_um": 10.0,
                "wedge_arcsec": [12.0, 0.0, 8.0],
                "wedge_direction_deg": [30.0, 0.0, 200.0],
                "air_path_m": 50.0,
                "air_gradient_k_per_m": [-20.0, 20.0],
            },
        }
    )
    instrument, filters = build_instrument(config.instrument), interference_filters(config.filters)
    bench = Bench(
        target=config.target,
        lamp=Blackbody(temperature_k=3000.0),
        filters=filters,
        reference=1,
        signal_e=6000.0,
        frames=2,
        dark_frames=2,
        window_px=13,
        methods=("cog",),
        collimator=build_collimator(config.collimator, filters),
    )
    return bench, instrument, corner_directions(config.target, instrument)


def shift_of(laboratory):
    """What a laboratory without noise finds, by ray trace, beside the closed forms."""
    bench, instrument, direction = laboratory
    table = np.array([table1(s) for s in shifts(bundle_prediction(bench, instrument, direction), bench.pairs).values()])
    radius = np.hypot(
        expected_spots(bench, instrument, direction)[1] * instrument.camera.pixel_pitch_mm * 1e3,
        bench.collimator.source_radius_rad * instrument.focal_length_mm * 1e3 / 2**0.5,
    )
    return effects.collimator_shift(bench, instrument, direction, table, 0.0 * table, radius.mean((0, 1)))


def apart_px(effect):
    """Largest deviation from the closed forms."""
    return max(
        abs(seen.value - known)
        for seen, known in zip(effect.measured_px.flat, effect.closed_form_sum_px.flat, strict=True)
    )


def test_closed_forms_hold_and_are_constant_over_the_field(laboratory):
    effect = shift_of(laboratory)
    assert (
        apart_px(effect) < 0.03 * np.abs(effect.closed_form_sum_px).max()
    )  # distortion changes the scale over the field
    assert effect.spot_ratio == pytest.approx(1.0, abs=0.03)
    assert np.abs(effect.closed_form_px).max((1, 2)).min() > 0.01
    bench, instrument, direction = laboratory
    without = shifts(bundle_prediction(replace(bench, collimator=None), instrument, direction), bench.pairs)
    seen = shifts(bundle_prediction(bench, instrument, direction), bench.pairs)
    for pair, shift in seen.items():
        added = shift - without[pair]
        assert np.abs(added - added.mean((0, 1))).max() < 0.02 * np.abs(added.mean((0, 1))).max()
        assert np.abs(table1(without[pair])).max() < 1e-6  # lateral colour is odd: nothing of it is left


@pytest.mark.slow
def test_a_pinhole_is_seen_alike_in_image_and_psf(engine, laboratory):
    bench, instrument, direction = laboratory
    bare = replace(bench.collimator, config=bench.collimator.config.model_copy(update={"pinhole_um": 0.0}))
    target, sharp = (filter_scene(replace(bench, collimator=one), instrument) for one in (bench.collimator, bare))
    size = bench.collimator.source_radius_rad / (instrument.pixel_arcsec * ARCSEC_RAD)
    found, point = (one.filter_psfs(direction[0], 8)[0][1] for one in (target, sharp))
    grown = np.subtract(*(one.image(direction[0]).truth.variance_x_px2 for one in (target, sharp)))
    np.testing.assert_allclose(grown, size**2 / 4.0, rtol=0.01)  # 0.4 % by the slope of the field

    # the tails of diffraction have no second moment: the transfer functions, whose ratio is that of a uniform disk
    def transfer(one, frequency):
        x = (np.arange(len(one.values)) - (len(one.values) - 1) / 2) / one.oversampling
        return np.abs(np.exp(-2j * np.pi * frequency[:, None] * x) @ one.values.sum(0))

    frequency = np.array([0.1, 0.3, 0.5, 0.7])  # cycles per pixel; the disk leaves 0.998 to 0.917
    argument = 2 * np.pi * frequency * size
    np.testing.assert_allclose(
        transfer(found, frequency) / transfer(point, frequency), 2 * j1(argument) / argument, atol=3e-4
    )
    assert found.values.sum() == pytest.approx(point.values.sum(), rel=1e-4)
