"""Parts of the laboratory that whole sessions use without noticing their numbers."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.laboratory.distortion_model import camera_projector
from experiments.laboratory.distortion_statistics import camera_terms
from experiments.laboratory.readout.psf_grid import PsfGrid
from experiments.laboratory.temporal_error import target_place, temporal_error_arcsec
from render.records import EffectivePsf


@pytest.mark.parametrize(("reference", "count"), [("nominal", 0), ("aligned", 4), ("calibrated", 8)])
def test_what_a_camera_explains_is_kept_whole_and_nothing_else(reference, count):
    """Brown and Conrady's terms, written in real coordinates; a projector has the trace of its dimension."""
    place = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 2))
    projector = camera_projector(place, reference)
    terms = camera_terms(place, reference).reshape(80, count)
    np.testing.assert_allclose(projector @ terms, terms, atol=1e-12)
    assert np.trace(projector) == pytest.approx(count)
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)


def test_the_nearest_psf_of_a_grid():
    place = np.array([[10.0, 10.0], [50.0, 10.0], [10.0, 40.0]])
    psf = EffectivePsf(values=np.ones((9, 9)), oversampling=2)
    grid = PsfGrid(psfs=(psf,) * 3, place_px=place)
    assert grid.nearest(np.array([12.0, 31.0, 9.0, 60.0]), np.array([9.0, 10.0, 26.0, 0.0])).tolist() == [0, 1, 2, 1]


def test_three_times_the_mean_over_the_stars_and_how_well_it_is_known():
    """Drawn standard deviations of 5 stars in 20 frames: scatter over runs as stated; frames times stars behind it."""
    rng, true = np.random.default_rng(2), np.array([0.02, 0.05])
    drawn = [
        temporal_error_arcsec((true * rng.standard_normal((20, 5, 2))).std(0, ddof=1), 4.0, 20) for _ in range(1000)
    ]
    for axis in range(2):
        values = np.array([one[axis].value for one in drawn])
        assert values.mean() == pytest.approx(12.0 * true[axis] * (1.0 - 1.0 / (4 * 19)), rel=0.01)
        told = np.sqrt(np.mean([one[axis].uncertainty ** 2 for one in drawn]))
        assert told == pytest.approx(values.std(), rel=4.0 / np.sqrt(2000))
        assert drawn[0][axis].n == 100


def test_the_target_stands_in_the_middle_of_the_first_chip(star_camera, bench_of):
    direction = target_place(bench_of(rows=3, columns=3), star_camera)
    tangent = direction[:, :2] / direction[:, 2:] * star_camera.focal_length_mm / star_camera.camera.pixel_pitch_mm
    pixel = tangent + np.array(star_camera.camera.centre_px)
    chip = star_camera.detector
    middle = [(chip.chip_width_px - 1) / 2, (chip.chip_height_px - 1) / 2]
    np.testing.assert_allclose(pixel[4], middle, atol=1e-6)
    elsewhere = target_place(bench_of(rows=3, columns=3), star_camera, (700.0, 300.0))
    tangent = elsewhere[4, :2] / elsewhere[4, 2] * star_camera.focal_length_mm / star_camera.camera.pixel_pitch_mm
    np.testing.assert_allclose(tangent + np.array(star_camera.camera.centre_px), [700.0, 300.0], atol=1e-6)
