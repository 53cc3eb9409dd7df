"""Frames that do not work: each is told by its own sentence, with what it still tells."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from calib.measure.image import sensor_image
from experiments.harness.progress import Progress
from experiments.twin.faults import clouded, shape_words, what_is_wrong
from experiments.twin.folder import NightFrame
from experiments.twin.pipeline import _pitch_mm, reduce_night
from experiments.twin.settings import Config
from experiments.twin.solve import Solver, solve_all
from optics.errors import DomainError
from render.sky.sky import load_sky

SIZE, FOCAL_PX, LEVEL = 512, 2600.0, 300.0
FIELD_DEG = 2.0 * np.degrees(np.arctan(SIZE / 2.0 / FOCAL_PX))


@lru_cache
def sky():
    return load_sky(faintest_mag=8.5)


def light_of(seed, *, focal_px=FOCAL_PX, sigma_px=0.9, trail_px=0.0, disk_px=0.0):
    """Light of the catalogue's stars through a pinhole, each star a trail of pixels, a disk or a Gaussian."""
    turn = Rotation.random(rng=np.random.default_rng(seed))
    v = turn.apply(np.array(sky().direction))
    place = focal_px * v[:, :2] / np.maximum(v[:, 2:], 1e-6) + (SIZE - 1) / 2.0
    shown = (v[:, 2] > 0.5) & (place > -5).all(axis=1) & (place < SIZE + 5).all(axis=1)
    place, flux = place[shown], 4e4 * 10.0 ** (-0.4 * (np.array(sky().magnitude)[shown] - 5.0))
    rng = np.random.default_rng(seed + 1)
    grown = [np.zeros(2)]
    if trail_px:
        grown = [np.array([0.8, 0.6]) * t for t in np.linspace(-0.5, 0.5, 40) * trail_px]
    if disk_px:
        radius, angle = disk_px * np.sqrt(rng.uniform(size=120)), rng.uniform(0, 2 * np.pi, 120)
        grown = list(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    image, fine = np.zeros((SIZE, SIZE)), np.arange(-4, 5)
    for (x, y), light in zip(place, flux, strict=True):
        for dx, dy in grown:
            at_x, at_y = x + dx, y + dy
            ix, iy = round(at_x), round(at_y)
            if 4 <= ix < SIZE - 4 and 4 <= iy < SIZE - 4:
                gx, gy = (np.exp(-0.5 * ((i + fine - a) / sigma_px) ** 2) for i, a in ((ix, at_x), (iy, at_y)))
                patch = np.outer(gy / gy.sum(), gx / gx.sum()) * light / len(grown)
                image[iy - 4 : iy + 5, ix - 4 : ix + 5] += patch
    return image


def frame(light, seed=3, level=LEVEL, **options):
    rng = np.random.default_rng(seed)
    return sensor_image(rng.poisson(light + level).astype(float), saturation_dn=65535.0, source="frame", **options)


def solved(image):
    pytest.importorskip("tetra3rs")
    solver = Solver(SIZE, SIZE, field_deg=round(FIELD_DEG, 1))
    return solve_all(["a"], [image], solver, Progress())[0]


def test_a_good_frame_is_solved_and_nothing_is_wrong():
    one = solved(frame(light_of(1)))
    assert one.attitude is not None
    assert one.scale == pytest.approx(FOCAL_PX, rel=2e-3)
    assert shape_words(one.image, one.seen) == ""


@pytest.mark.parametrize(
    ("options", "words"),
    [({"trail_px": 14.0}, "trailed: stars are"), ({"disk_px": 9.0}, "out of focus: stars are")],
)
def test_images_that_are_no_points(options, words):
    one = solved(frame(light_of(2, **options)))
    told = what_is_wrong(one) if one.attitude is None else None
    assert told is None or words in told
    assert words in shape_words(one.image, one.seen)


def test_a_mirrored_sky_is_told():
    told = what_is_wrong(solved(frame(light_of(1)[:, ::-1])))
    assert "mirrored" in told
    assert "background 300" in told


def test_clouds_over_a_part_of_the_frame():
    light = light_of(1)
    cover = gaussian_filter((np.indices(light.shape)[1] > 150).astype(float), 30.0)
    one = solved(frame(light * (1.0 - 0.995 * cover) + 60.0 * cover))
    told = what_is_wrong(replace(one, words="no match", attitude=None))
    assert "of the frame has no star" in told
    rng = np.random.default_rng(0)
    place = rng.uniform(0, SIZE, (300, 2))
    assert clouded(one.image, place, place[:, 0] < SIZE / 3) == pytest.approx(2 / 3)
    assert clouded(one.image, place, np.ones(300, bool)) == 0.0


@pytest.mark.slow
def test_frames_of_two_cameras_and_clouds_are_notes_of_a_night():
    lights = [light_of(k) for k in range(3)]
    covered = light_of(3)
    covered[:, SIZE // 2 :] *= 0.03
    levels = (150.0, 400.0, 900.0, 300.0)
    images = [frame(one, k, level) for k, (one, level) in enumerate(zip([*lights, covered], levels, strict=True))]
    other = frame(light_of(5, focal_px=2950.0), 9)
    frames = [NightFrame(name=f"f{k}", image=one) for k, one in enumerate([*images, other])]
    config = Config(camera={"field_deg": round(FIELD_DEG, 1)}, orders=("pinhole",))
    pytest.importorskip("tetra3rs")
    reduced, _ = reduce_night(frames, config, Progress())
    words = "\n".join(reduced.notes)
    assert "f4: frames of two cameras: solved with 29" in words
    assert "f3: clouds or an obstacle over about" in words
    assert len(reduced.rows) == 4


def test_a_pitch_that_the_stars_contradict_is_told():
    solver, words = Solver(SIZE, SIZE), []
    solver.focal_px = 5117.0
    config = Config(camera={"pixel_pitch_um": 3.45, "focal_length_mm": 35.3})
    assert _pitch_mm(config, solver, words) == pytest.approx(3.45e-3)
    assert "pitch of 6.9 um, pixel_pitch_um = 3.45 is stated (binning?)" in words[0]
    assert _pitch_mm(Config(camera={"focal_length_mm": 35.3}), solver, []) == pytest.approx(6.9e-3, rel=1e-3)


def test_nothing_but_trails_is_refused_in_a_sentence():
    frames = [NightFrame(name="a", image=frame(light_of(2, trail_px=30.0)))]
    pytest.importorskip("tetra3rs")
    with pytest.raises(DomainError, match="trailed: stars are"):
        reduce_night(frames, Config(camera={"field_deg": round(FIELD_DEG, 1)}), Progress())
