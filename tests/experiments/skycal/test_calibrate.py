"""Calibrations of stars whose positions are known by construction: maps, floors, predictions and records, no image."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.cameras import BrownConrady
from experiments.skycal import calibrate as study
from experiments.skycal import experiment as tables
from experiments.skycal.calibrate import METHODS, PARTS, calibrate_camera, rms, start_camera
from experiments.skycal.match import OUTCOMES, Matched
from experiments.skycal.positions import Chart
from experiments.skycal.scene import build_scene
from experiments.skycal.settings import Config
from optics.errors import DomainError
from render.engine.random import Streams

STATED_PX, MORE_PX, SHIFT_PX = 0.05, 0.08, 0.3
PSF_PX = np.array([0.0, 0.02])
TRUTH = {"x0_px": 3.0, "y0_px": -2.0, "q1_per_mm2": 2e-5}


@pytest.fixture(scope="module")
def config():
    wide = Config().wide.model_copy(update={"faintest_mag": 6.0, "models": ("brown_conrady", "pinhole")})
    return Config(frames=5, which="wide", wide=wide, motion={"rate_deg_per_s": 3.0})


@pytest.fixture(scope="module")
def scene(config):
    return build_scene("wide", config, Streams(8).child("wide"))


@pytest.fixture(scope="module")
def camera(scene):
    return BrownConrady.create(scene.geometry, focal_length_mm=scene.instrument.focal_length_mm, **TRUTH)


@pytest.fixture(scope="module")
def sky(scene, camera):
    """Matched stars, positions by kind, chart. Faint stars (half of them) scatter as stated, the others more."""
    rng, frames = np.random.default_rng(5), []
    for number in range(scene.frames):
        star, in_cam = scene.in_cam(number)
        place = camera.project(in_cam)
        inside = np.all((place > 6) & (place < 1855), axis=1)
        frames.append((np.full(inside.sum(), number), star[inside], in_cam[inside], place[inside]))
    frame, star, in_cam, place = (np.concatenate(part) for part in zip(*frames, strict=True))
    count = len(star)
    light = place + SHIFT_PX * np.array([1.0, 0.0])
    own = light + np.hypot(STATED_PX, MORE_PX) * rng.standard_normal((count, 2))
    places = {
        "reference": place,
        "light": light,
        "own": own,
        "measured": own + PSF_PX,
        "corrected": own - (light - place),
    }
    matched = Matched(
        frame=frame,
        star=star,
        row=np.arange(count),
        direction=scene.sky.direction[star],
        pixel_px=own,
        covariance_px2=np.tile(STATED_PX**2 * np.eye(2), (count, 1, 1)),
        snr=np.where(np.arange(count) % 2, 20.0, 200.0),
        photon_px=light,
        in_cam=in_cam,
        correct=np.arange(count) > 2,
        count=dict(zip(OUTCOMES, range(1, 1 + len(OUTCOMES)), strict=True)),
        first_matched=4,
    )
    pixel = camera.geometry.grid_px(9)
    chart = Chart(direction=camera.unproject(pixel), pixel_px=pixel, rows=9, columns=9)
    return matched, places, chart


@pytest.fixture(scope="module")
def made(scene, config, sky):
    matched, places, chart = sky
    recording = SimpleNamespace(frames=[SimpleNamespace(star=np.zeros(70)) for _ in range(5)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "positions", lambda *_: places)
        patch.setattr(study, "trace_chart", lambda *_: chart)
        return calibrate_camera(scene, recording, matched, config, advance=lambda: None)


def test_what_is_switched_on_shows_alone(made):
    """The camera is one of the models; a shift of all stars is one of the principal point; the rest is noise."""
    assert made.of("reference").rms_arcsec < 1e-5
    # tan^2 of half the field is 0.04: what is left of a shift that the camera cannot tell from a tilt
    assert 0.0 < made.of("light").rms_arcsec < 0.04 * SHIFT_PX * made.scene.pixel_arcsec
    assert np.abs(made.clean.error_arcsec).max() < 1e-5
    moved, before = (made.of(data).calibration.model.value("x0_px") for data in ("light", "reference"))
    assert (before, moved) == pytest.approx((3.0, 3.0 + SHIFT_PX), abs=1e-5)
    assert made.of("measured").calibration.model.value("y0_px") - made.of("own").calibration.model.value(
        "y0_px"
    ) == pytest.approx(PSF_PX[1], abs=1e-3)
    found = made.of("corrected")
    assert abs(found.rms_arcsec - found.map.predicted_rms_arcsec) < 4.0 * found.map.predicted_rms_spread_arcsec
    pull = found.error_arcsec / found.map.predicted_sigma_arcsec
    assert 0.2 < np.sqrt((pull**2).mean()) < 2.5  # some five shapes
    total = sum(made.part_arcsec[name] for name in PARTS)
    np.testing.assert_allclose(total, made.of("measured").error_arcsec, atol=1e-12)
    # a pinhole leaves the distortion: q r^3 less what principal point, scale and tilt take; seen with and without stars
    pinhole = made.direct["pinhole"].rms_arcsec
    assert made.direct["brown_conrady"].rms_arcsec < 1e-5
    assert pinhole > 1.0
    assert made.of("reference", model="pinhole").rms_arcsec == pytest.approx(pinhole, rel=0.3)


def test_floor_is_the_scatter_that_was_not_stated(made, sky):
    """n numbers of variance v: known to v sqrt(2 / n)."""
    matched, _, _ = sky
    variance = STATED_PX**2 + MORE_PX**2
    reach = 4.0 * variance * np.sqrt(2.0 / (2 * len(matched)))
    for floor in made.floor_px.values():
        assert floor**2 == pytest.approx(MORE_PX**2, abs=reach)
    assert made.of("measured").calibration.solution.reduced_chi2 == pytest.approx(1.0, abs=0.02)
    residual = made.residual_px
    assert residual.var() == pytest.approx(variance, abs=reach)
    np.testing.assert_allclose(
        made.of("measured").calibration.covariance, made.of("corrected").calibration.covariance, rtol=0.05
    )


def test_attitudes_linked_by_a_gyro(made, scene, config, sky):
    """A truly perfect gyro gives a map no worse than predicted; each way states less than free attitudes do."""
    free = made.of("corrected")
    assert {key[0] for key in made.maps} == set(METHODS)
    for method in ("linked", "acc_true"):
        found = made.of("corrected", method=method)
        assert found.calibration.solution.converged
        assert abs(found.rms_arcsec - found.map.predicted_rms_arcsec) < 4.0 * found.map.predicted_rms_spread_arcsec
        assert found.map.predicted_rms_arcsec < 1.01 * free.map.predicted_rms_arcsec
    matched, places, chart = sky
    exact = study.Calibrator(
        scene=scene, matched=matched, config=config, chart=chart, used=np.ones(len(matched), bool), position_px=places
    )
    name = scene.config.model
    wrong, right = (exact.calibrate("reference", model=name, method=one).rms_arcsec for one in ("acc", "acc_true"))
    assert right < 1e-3
    assert wrong > 10.0 * right


def test_start_cameras(scene, config):
    for name, free in (("brown_conrady", None), ("pinhole", ("x0_px", "y0_px", "focal_length_mm"))):
        model, names = start_camera(scene, config, name)
        assert names == free
        assert model.value("focal_length_mm") == pytest.approx(
            config.start.focal_ratio * scene.instrument.focal_length_mm
        )
        assert model.value("q1_per_mm2") == 0.0
    polynomial, names = start_camera(scene, config, "polynomial_3")
    assert names is None
    assert len(polynomial.parameters) == 2 * 10 - 3  # terms of a cubic in two variables, less a rotation
    assert rms(np.array([[3.0, 4.0], [np.nan, 1.0], [0.0, 1.0]])) == pytest.approx(np.sqrt(13.0))


def test_records(made, scene, sky):
    matched, places, chart = sky
    record, count = tables.camera(made), len(matched)
    assert (record.rendered, record.frames, record.frames_matched, record.stars) == (350, 5, 4, count)
    assert record.stars_per_frame == pytest.approx(count / 5)
    assert (record.wrong_matches, record.wrong_part) == (3, pytest.approx(3 / count))
    assert record.detections == list(range(1, 1 + len(OUTCOMES)))
    assert record.not_converged == 0
    scatter = np.hypot(1.0, MORE_PX / STATED_PX)  # faint ones: no floor in what they state
    assert record.centroid_pull.n == 2 * (count // 2)
    assert record.centroid_pull.value == pytest.approx(scatter, abs=4.0 * scatter * record.centroid_pull.uncertainty)
    assert record.centroid_pull.uncertainty == pytest.approx(0.889 / np.sqrt(2 * (count // 2)))
    assert record.quadrature_arcsec == pytest.approx(np.linalg.norm([rms(made.part_arcsec[one]) for one in PARTS]))
    assert record.part_correlation[1] == pytest.approx(
        (made.part_arcsec["mismatch"] * made.part_arcsec["noise"]).sum(1).mean()
        / (record.part_rms_arcsec[0] * record.part_rms_arcsec[2])
    )
    assert all(-1.0 <= one <= 1.0 for one in record.part_correlation)
    assert len(tables.PAIRS) == len(record.part_correlation)
    assert tables.PAIRS[1] == "mismatch, noise"
    error = tables.map_error([made, made], "free")
    assert error.noise_map_rms_arcsec == pytest.approx([made.of("corrected").rms_arcsec] * 2, rel=1e-4)
    assert error.measured_predicted_arcsec[0].value == made.of("measured").map.predicted_rms_arcsec
    assert error.measured_rms_arcsec == [made.of("measured").rms_arcsec] * 2
    fitted = {one.name: one.value for one in tables.parameters(made)}
    for name, value in (TRUTH | {"focal_length_mm": scene.instrument.focal_length_mm}).items():
        true = value + SHIFT_PX * (name == "x0_px") + PSF_PX[1] * (name == "y0_px")
        assert abs(fitted[name].value - true) < 4.5 * fitted[name].uncertainty
    assert error.corrected_sigma_f_um[0] == pytest.approx(1e3 * fitted["focal_length_mm"].uncertainty, rel=0.05)
    brown, pinhole = tables.models(made)
    assert (brown.parameters, pinhole.parameters) == (8, 3)
    assert pinhole.direct_arcsec == made.direct["pinhole"].rms_arcsec > pinhole.predicted_arcsec
    rows = tables.places(made)
    assert len(rows) == 81
    assert np.array_equal(rows[7].place_px, chart.pixel_px[7])
    assert np.array_equal(rows[7].noise_arcsec, made.part_arcsec["noise"][7])
    star = tables.stars(made)[3]
    assert (star.frame, star.magnitude) == (matched.frame[3], scene.sky.magnitude[matched.star[3]])
    np.testing.assert_allclose(star.sigma_px, STATED_PX)
    assert np.array_equal(star.light_px, places["light"][3])


def test_too_few_stars_are_refused(scene, config, sky):
    matched, places, chart = sky
    few = {name: np.where(np.arange(len(matched))[:, None] < 49, place, np.nan) for name, place in places.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "positions", lambda *_: few)
        patch.setattr(study, "trace_chart", lambda *_: chart)
        with pytest.raises(DomainError, match=r"49 good stars matched in 1 frames|at least 50 are needed"):
            calibrate_camera(scene, None, replace(matched, frame=np.arange(len(matched)) % 5), config, advance=None)
