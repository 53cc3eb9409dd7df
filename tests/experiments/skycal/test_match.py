"""Identification of detections, on star tables without rendering."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.flags import StarFlag
from calib.records import StarTable
from experiments.skycal.match import match_frames, sheet_camera
from experiments.skycal.measure import FrameStars
from experiments.skycal.positions import colour_classes
from optics.errors import DomainError

NOISE_PX = 0.05


def table_of(x, y, flux, flags):
    count = len(x)
    covariance = np.tile(np.diag([NOISE_PX**2, NOISE_PX**2, 1.0]), (count, 1, 1))
    covariance[:, 2, 2] = (flux / 50.0) ** 2  # a signal-to-noise ratio of 50
    return StarTable(
        x_px=x,
        y_px=y,
        flux_e=flux,
        background_e=np.zeros(count),
        covariance=covariance,
        chi2=np.ones(count),
        iterations=np.ones(count, np.int64),
        flags=flags,
    )


def frame_of(stars, number, rng, *, false=20, flags=0):
    """Stars of a frame at the positions of the camera, brightest first, among false detections."""
    rows, direction, position, magnitude = stars(number)
    order = np.argsort(magnitude)
    rows, direction, position = rows[order], direction[order], position[order]
    detected = np.concatenate([position + rng.normal(0, NOISE_PX, position.shape), rng.uniform(6, 1855, (false, 2))])
    flux = np.concatenate([10 ** (-0.4 * magnitude[order]), np.full(false, 1e-3)]) * 1e7
    brightest_first = np.argsort(-flux, kind="stable")
    return FrameStars(
        detections=table_of(*detected[brightest_first].T, flux[brightest_first], np.full(len(flux), flags, np.uint32)),
        first_row=1000 * number,
        star=rows,
        direction=direction,
        photon_px=position,
        electrons=flux[: len(rows)],
    )


@pytest.fixture(scope="module")
def recording_of(stars_of_frame, config):
    def make(**options):
        rng = np.random.default_rng(5)
        frames = tuple(frame_of(stars_of_frame, k, rng, **options) for k in range(config.frames))
        return SimpleNamespace(frames=frames)

    return make


def test_true_stars_are_identified_and_false_detections_are_not(scene, config, recording_of):
    recording = recording_of()
    matched = match_frames(scene, recording, config)
    assert matched.first_matched == scene.frames
    assert matched.correct.all()
    rendered = sum(len(scene.in_cam(k)[0]) for k in range(scene.frames))
    assert len(matched) > 0.8 * rendered
    # 20 false detections per frame among 70 stars on 1862 px: chance within 2 px of a star is 70 pi 4 / 1862^2
    assert matched.count["not matched"] >= 0.95 * 20 * scene.frames
    assert sum(matched.count.values()) == sum(len(frame.detections) for frame in recording.frames)
    error = matched.pixel_px - matched.photon_px
    assert error.std() == pytest.approx(NOISE_PX, rel=5 / np.sqrt(2 * error.size))
    # rows lead back to the detections
    frame = recording.frames[2]
    in_frame = matched.frame == 2
    detected_px = frame.detections.x_px[matched.row[in_frame] - frame.first_row]
    assert detected_px == pytest.approx(matched.pixel_px[in_frame, 0])


def test_data_sheet_camera_is_wrong_by_what_was_asked(scene, config):
    camera = sheet_camera(scene, config)
    assert camera.value("focal_length_mm") / scene.instrument.focal_length_mm == pytest.approx(1.003)
    assert camera.value("q1_per_mm2") == 0


def test_frames_that_cannot_be_matched_are_refused(scene, config, recording_of):
    """Three refusals of `match_frames` that need a recording."""
    empty = SimpleNamespace(frames=[replace(frame, detections=StarTable.empty()) for frame in recording_of().frames])
    wrong = config.model_copy(update={"start": config.start.model_copy(update={"sheet_error_fraction": 0.09})})
    for recording, settings, words in (
        (empty, config, "wide: no star was detected in 5 frames at 6 sigma"),
        (recording_of(flags=int(StarFlag.SATURATED)), config, r"wide: \d+ of \d+ detections are saturated"),
        (recording_of(), wrong, r"the stars of \d of 5 frames were matched; at least half are needed"),
    ):
        with pytest.raises(DomainError, match=words):
            match_frames(scene, recording, settings)


def test_colour_classes_divide_the_stars_evenly():
    temperature = np.random.default_rng(4).lognormal(np.log(5000), 0.4, 1000)
    colour, member = colour_classes(temperature)
    assert np.all(np.diff(colour) > 0)
    assert np.bincount(member).min() >= 1000 // len(colour) - 1
    for k, typical in enumerate(colour):
        assert temperature[member == k].min() <= typical <= temperature[member == k].max()
    colour, member = colour_classes(np.full(7, 4000.0))
    assert colour == pytest.approx([4000.0])
    assert np.all(member == 0)
