"""Names for detections, on star tables made without rendering."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.cameras import BrownConrady
from calib.flags import StarFlag
from calib.records import StarTable
from experiments.skycal.match import match_frames, sheet_camera
from experiments.skycal.measure import FrameStars
from experiments.skycal.positions import colour_classes
from experiments.skycal.scene import build_scene
from experiments.skycal.settings import Config
from optics.errors import DomainError
from render.engine.random import Streams

NOISE_PX = 0.05


@pytest.fixture(scope="module")
def config():
    wide = Config().wide.model_copy(update={"faintest_mag": 6.0})
    return Config(frames=5, which="wide", wide=wide, motion={"rate_deg_per_s": 3.0})


@pytest.fixture(scope="module")
def scene(config):
    return build_scene("wide", config, Streams(8).child("wide"))


def truth_camera(scene):
    """A camera with a principal point and a distortion that the data sheet does not know."""
    return BrownConrady.create(
        scene.geometry, focal_length_mm=scene.instrument.focal_length_mm, x0_px=3.0, y0_px=-2.0, q1_per_mm2=2e-5
    )


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


def frame_of(scene, number, rng, *, false=20, flags=0):
    """Stars of a frame where the camera puts them, brightest first, among false detections."""
    rows, direction = scene.in_cam(number)
    place = truth_camera(scene).project(direction)
    inside = np.all((place > 6) & (place < 1855), axis=1)
    rows, direction, place = rows[inside], direction[inside], place[inside]
    order = np.argsort(scene.sky.magnitude[rows])
    rows, direction, place = rows[order], direction[order], place[order]
    seen = place + rng.normal(0, NOISE_PX, place.shape)
    noise = rng.uniform(6, 1855, (false, 2))
    every = np.concatenate([seen, noise])
    flux = np.concatenate([10 ** (-0.4 * scene.sky.magnitude[rows]), np.full(false, 1e-3)]) * 1e7
    mix = np.argsort(-flux, kind="stable")
    return FrameStars(
        found=table_of(every[mix, 0], every[mix, 1], flux[mix], np.full(len(mix), flags, np.uint32)),
        first_row=1000 * number,
        star=rows,
        direction=direction,
        photon_px=place,
        electrons=flux[: len(rows)],
    )


def recording_of(scene, **options):
    rng = np.random.default_rng(5)
    return SimpleNamespace(frames=tuple(frame_of(scene, k, rng, **options) for k in range(scene.frames)))


def test_all_stars_get_their_names_and_false_ones_none(scene, config):
    matched = match_frames(scene, recording_of(scene), config)
    assert matched.first_matched == scene.frames
    assert matched.correct.all()
    rendered = sum(len(scene.in_cam(k)[0]) for k in range(scene.frames))
    assert len(matched) > 0.8 * rendered
    # 20 false detections per frame among 70 stars on 1862 px: chance within 2 px of a star is 70 pi 4 / 1862^2
    assert matched.count["not matched"] >= 0.95 * 20 * scene.frames
    assert sum(matched.count.values()) == sum(len(one.found) for one in recording_of(scene).frames)
    error = matched.pixel_px - matched.photon_px
    assert error.std() == pytest.approx(NOISE_PX, rel=5 / np.sqrt(2 * error.size))
    # rows lead back to the detections
    frame = recording_of(scene).frames[2]
    mine = matched.frame == 2
    assert frame.found.x_px[matched.row[mine] - frame.first_row] == pytest.approx(matched.pixel_px[mine, 0])


def test_data_sheet_camera_is_wrong_by_what_was_asked(scene, config):
    camera = sheet_camera(scene, config)
    assert camera.value("focal_length_mm") / scene.instrument.focal_length_mm == pytest.approx(1.003)
    assert camera.value("q1_per_mm2") == 0


def test_what_cannot_be_matched_is_refused(scene, config):
    nothing = recording_of(scene)
    empty = SimpleNamespace(
        frames=tuple(
            FrameStars(
                found=StarTable.empty(),
                first_row=0,
                star=one.star,
                direction=one.direction,
                photon_px=one.photon_px,
                electrons=one.electrons,
            )
            for one in nothing.frames
        )
    )
    with pytest.raises(DomainError, match=r"wide: no star was detected in 5 frames at 6 sigma"):
        match_frames(scene, empty, config)
    with pytest.raises(DomainError, match=r"wide: \d+ of \d+ detections are saturated"):
        match_frames(scene, recording_of(scene, flags=int(StarFlag.SATURATED)), config)
    wrong = config.model_copy(update={"start": config.start.model_copy(update={"sheet_error_fraction": 0.09})})
    with pytest.raises(DomainError, match=r"the stars of \d of 5 frames were matched; at least half are needed"):
        match_frames(scene, recording_of(scene), wrong)


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
