"""Every predicted noise against frames of the detector chain, for a chip whose noise is not that of the median pixel.

Its read noise differs widely from pixel to pixel (log-normal, its mean variance more than twice that of the median
pixel) and it has displacement damage (20 centres of 20 e- in a pixel and exposure, three times its read noise in
variance): a prediction that forgets either misses a quarter. Tolerances are four standard errors, taken from the
scatter of the measured quantities themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.measure.centroid_error.cramer_rao_bound import flux_snr
from experiments.dataset import truth as dataset_truth
from experiments.laboratory.bench.points import point_scene
from experiments.laboratory.bench.readout.frames import empty_frame, true_noise
from experiments.laboratory.temporal_error import measure_temporal, predict_temporal, star_target_directions
from render.detector.readout import expose
from render.engine.random import Streams
from render.sensor_file.instrument import build_instrument
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig

DATA_FILE = """
base = "cmv4000"
name = "damaged"
chip_width_px = 1536
chip_height_px = 768
hot_fraction = 0.0
read_noise_spread = 0.7
damage_centres_per_px = 20.0
damage_dark_e_per_s = 2880.0  # 0.1 s, 0 C: 20 e- each
"""


@pytest.fixture(scope="module")
def chip_file(tmp_path_factory):
    """Data file of a chip whose pixels differ: in their read noise, and by damage in their dark current."""
    path = tmp_path_factory.mktemp("chips") / "damaged.toml"
    path.write_text(DATA_FILE)
    return path


@pytest.fixture(scope="module")
def camera(chip_file):
    return build_instrument(InstrumentConfig(detector=str(chip_file)))


def within(measured: np.ndarray, predicted: np.ndarray) -> None:
    """The mean of ``measured`` is that of ``predicted`` within four standard errors of independent rows."""
    ratio = (np.asarray(measured) / np.mean(predicted)).reshape(len(measured), -1).mean(1)
    error = ratio.std(ddof=1) / np.sqrt(len(ratio))
    assert error < 0.15 * ratio.mean(), "too few samples to tell"
    assert abs(ratio.mean() - 1.0) < 4.0 * error, f"measured over predicted {ratio.mean():.3f} +- {error:.3f}"


@pytest.mark.slow
def test_temporal_error_of_a_point_target(engine, bench_of, camera):
    bench = bench_of(rows=10, columns=8, frames=30, dark_frames=30, methods=("epsf", "cog"))
    bench = replace(bench, target=bench.target.model_copy(update={"pitch_px": 40.4}))
    scene = point_scene(bench, camera)
    levels = {"levels_e": [6000.0], "place_px": (750.0, 375.0)}
    psf = scene.psfs(star_target_directions(scene.bench, camera, levels["place_px"]))
    measured = measure_temporal(bench, camera, streams=Streams(1), scene=scene, **levels)
    predicted = predict_temporal(bench, camera, psf=psf, draws=0, **levels)
    for method in bench.methods:
        within(measured.sigma_px[method][0] ** 2, predicted.linear_px[method][0] ** 2)


@pytest.fixture(scope="module")
def dataset(engine, chip_file):
    """Frames of the sky through the chip; the pixel variance of a frame without stars, measured."""
    from experiments.dataset.frame import FrameRenderer
    from experiments.dataset.scene import build_scene
    from experiments.dataset.settings import ConePointing, DatasetConfig, VerifyConfig

    config = DatasetConfig(
        instrument=InstrumentConfig(
            lens="star_tracker_26mm", detector=str(chip_file), width_px=128, height_px=128, exposure_s=0.1
        ),
        nodes=3,
        catalogue=CatalogueConfig(faintest_mag=9.0),
        pointing=ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1),
        verify=VerifyConfig(dark_frames=3),
    )
    maker = FrameRenderer(build_scene(config))
    return maker, maker.render(0)


def empty_pixels(scene, sky_e: float, dark_frames: int) -> np.ndarray:
    """Temporal variance (pixels,) of an empty sky less the mean of fresh dark frames; without dark frames for 0."""
    detector, sky, night = scene.instrument.detector, Streams(1), Streams(2)
    frames = []
    for number in range(40):
        one = empty_frame(scene.instrument, number, sky_e=sky_e, streams=sky)
        dn = one.dn.astype(float)
        for k in range(dark_frames):
            dark = empty_frame(scene.instrument, number * dark_frames + k, streams=night)
            dn = dn - dark.dn / dark_frames
        frames.append(dn[~one.defect] / detector.gain_dn_per_e)
    return np.var(frames, axis=0, ddof=1)


@pytest.mark.slow
def test_signal_to_noise_ratio_of_the_truth(dataset, monkeypatch):
    """The noise of an empty pixel that ratios are computed with."""
    maker, made = dataset
    stated = []

    def noted(electrons, area_px2, *, noise_e2):
        stated.append(noise_e2)
        return flux_snr(electrons, area_px2, noise_e2=noise_e2)

    monkeypatch.setattr(dataset_truth, "flux_snr", noted)
    assert np.array_equal(maker.render(0).truth["snr"], made.truth["snr"])
    within(empty_pixels(maker.scene, made.background_e, 0), stated[0])


def test_bound_of_the_dataset(dataset, engine):
    """The bound of a faint star is that of a background with the measured variance of a pixel."""
    from calib.measure.centroid_error.prediction import centroid_bound
    from calib.records import NoiseModel
    from experiments.dataset.detection import dataset_bound
    from render.psf_lattice import render_psf_grid

    maker, made = dataset
    scene = maker.scene
    psfs = render_psf_grid(scene.instrument, scene.light, temperature_k=5800.0, window_px=scene.config.window_px)
    stated = dataset_bound(scene, psfs, made.background_e)
    variance = empty_pixels(scene, made.background_e, scene.config.verify.dark_frames)
    nearest = int(np.hypot(*(psfs.place_px - scene.instrument.camera.centre_px).T).argmin())
    measured = centroid_bound(
        [psfs.psfs[nearest]],
        np.zeros(1),
        noise=NoiseModel(read_noise_e=float(np.sqrt(variance.mean()))),
        background_e=0.0,
        window_px=scene.config.window_px,
        electrons=(30.0, 40.0),
    )
    faint = np.full(1, 30.0), np.zeros((1, 2)), np.zeros(1)
    ratio = (measured.at(*faint) / stated.at(*faint)) ** 2  # of a faint star: the variance itself
    within(variance / variance.mean(), 1.0 / ratio)


def test_noise_that_centroiders_of_the_sky_are_told(camera):
    """Dark-subtracted frames without light: the variance that the reduction states is that of the pixels."""
    narrow = camera.windowed(128, 128)
    conditions = {"exposure_s": camera.config.exposure_s, "temperature_c": camera.config.chip_temperature_c}
    nothing, differences = np.zeros((128, 128), np.float32), []

    def read(seed, number):
        return expose(nothing, narrow.detector, streams=Streams(seed), frame=number, **conditions)

    for number in range(40):
        frame = read(1, number)
        dark = [read(2, 3 * number + k).dn for k in range(3)]
        differences.append((frame.dn - np.mean(dark, axis=0))[~frame.defect] / frame.gain_dn_per_e)
    within(np.var(differences, axis=0, ddof=1), true_noise(narrow, dark_frames=3).floor_e2)
