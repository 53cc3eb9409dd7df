"""A PSF built from frames measures as the one predicted without them, and as the PSF of the simulator."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.measure.centroid_error.expected_windows import noiseless_positions
from calib.measure.centroiding.registry import get_centroider
from experiments.laboratory.bench.epsf_session import _chip_deviates, epsf_session, measured_epsf, predicted_epsfs
from experiments.laboratory.bench.point_bench import one_filter
from experiments.laboratory.bench.points import point_scene
from experiments.laboratory.bench.ray_prediction import target_windows
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.settings.tables import HexapodConfig
from experiments.laboratory.temporal_error import star_target_directions
from render.engine.random import Streams


def test_few_points_take_more_positions(bench_of):
    assert epsf_session(bench_of(rows=5, columns=5)).positions == 5
    assert epsf_session(bench_of(rows=1, columns=2)).positions == 10  # a PSF of four samples per pixel needs 16 stars


def test_a_pixel_has_one_response_at_all_positions():
    corner = np.array([[10, 20], [40, 20], [11, 20], [40, 19]])  # two stars at two positions
    windows = SimpleNamespace(corner_px=corner, light_e=np.zeros((4, 5, 6)))
    drawn, seen = _chip_deviates(windows, 2, np.random.default_rng(1)), {}
    for (x0, y0), window in zip(corner.tolist(), drawn, strict=True):
        for (y, x), value in np.ndenumerate(window):
            assert seen.setdefault((x0 + x, y0 + y), value) == value
    assert len(seen) == 5 * 7 + 6 * 6 == len(set(seen.values()))


@pytest.mark.slow
def test_a_measured_psf_places_stars_as_the_predicted_and_the_true_one_do(engine, bench_of, small_camera):
    """Rationale: same pixels, other PSFs. Expected: positions alike within what the noise of the session leaves."""
    bench = bench_of(rows=3, columns=3, frames=30, dark_frames=100)
    bench = replace(bench, target=bench.target.model_copy(update={"pitch_px": 40.4}))
    scene, rest = point_scene(bench, small_camera), star_target_directions(bench, small_camera)
    psf = scene.psfs(rest)
    platform = HexapodConfig(step_error_arcsec=0.4, roll_error_arcsec=1.0, reading_error_arcsec=0.2)
    measured = measured_epsf(bench, small_camera, platform, psf=psf, streams=Streams(4), scene=scene)
    predicted = predicted_epsfs(bench, small_camera, psf, seed=1)[0]
    windows = target_windows(one_filter(bench), small_camera, rest[None], psf)
    alone = replace(windows, psf_index=np.zeros(len(rest), np.int64))
    told = nominal_noise(small_camera)
    place = {
        name: noiseless_positions(get_centroider("epsf", epsf=one), alone, told) - windows.position_px
        for name, one in (("measured", measured), ("predicted", predicted))
    }
    # 45 stars of 30 frames: a frame's 0.01 px becomes 0.002 px for each phase of the pixel; the points are 40 px apart
    for found in place.values():
        assert np.sqrt((found**2).mean()) < 8e-3
    assert np.sqrt(((place["measured"] - place["predicted"]) ** 2).mean()) < 6e-3
