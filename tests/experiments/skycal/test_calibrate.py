"""Calibrations of stars whose positions are known by construction: maps, floors, predictions and records, no image."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.skycal import calibrate as study
from experiments.skycal import experiment as tables
from experiments.skycal.calibrate import METHODS, PARTS, calibrate_camera, rms, start_camera
from experiments.skycal.match import OUTCOMES, Matched
from experiments.skycal.positions import Chart
from optics.errors import DomainError

STATED_PX, MORE_PX, SHIFT_PX = 0.05, 0.08, 0.3
PSF_PX = np.array([0.0, 0.02])


@pytest.fixture(scope="module")
def sky(scene, camera, stars_of_frame):
    """Matched stars, positions by kind, chart. Faint stars (half of them) scatter as stated, the others more."""
    frames = [stars_of_frame(number) for number in range(scene.frames)]
    star, in_cam, position, _ = (np.concatenate(part) for part in zip(*frames, strict=True))
    frame = np.repeat(np.arange(scene.frames), [len(rows) for rows, *_ in frames])
    count = len(star)
    light = position + SHIFT_PX * np.array([1.0, 0.0])
    noise = np.random.default_rng(5).standard_normal((count, 2))
    star_psf = light + np.hypot(STATED_PX, MORE_PX) * noise
    positions = {
        "reference": position,
        "light": light,
        "star_psf": star_psf,
        "measured": star_psf + PSF_PX,
        "corrected": star_psf - (light - position),
    }
    matched = Matched(
        frame=frame,
        star=star,
        row=np.arange(count),
        direction=scene.sky.direction[star],
        pixel_px=star_psf,
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
    return matched, positions, chart


@pytest.fixture(scope="module")
def calibrated(scene, config, sky):
    matched, positions, chart = sky
    recording = SimpleNamespace(frames=[SimpleNamespace(star=np.zeros(70)) for _ in range(5)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "star_positions", lambda *_: positions)
        patch.setattr(study, "trace_chart", lambda *_: chart)
        return calibrate_camera(scene, recording, matched, config, advance=lambda: None)


def test_what_is_switched_on_shows_alone(calibrated):
    """The camera is one of the models; a shift of all stars is one of the principal point; the rest is noise."""
    assert calibrated.of("reference").rms_arcsec < 1e-5
    # tan^2 of half the field is 0.04: what is left of a shift that the camera cannot tell from a tilt
    assert 0.0 < calibrated.of("light").rms_arcsec < 0.04 * SHIFT_PX * calibrated.scene.pixel_arcsec
    assert np.abs(calibrated.corrected_model_error.error_arcsec).max() < 1e-5
    moved, before = (calibrated.of(data).calibration.model.value("x0_px") for data in ("light", "reference"))
    assert (before, moved) == pytest.approx((3.0, 3.0 + SHIFT_PX), abs=1e-5)
    assert calibrated.of("measured").calibration.model.value("y0_px") - calibrated.of(
        "star_psf"
    ).calibration.model.value("y0_px") == pytest.approx(PSF_PX[1], abs=1e-3)
    corrected = calibrated.of("corrected")
    error_arcsec = corrected.rms_arcsec - corrected.map.predicted_rms_arcsec
    assert abs(error_arcsec) < 4.0 * corrected.map.predicted_rms_spread_arcsec
    pull = corrected.error_arcsec / corrected.map.predicted_sigma_arcsec
    assert 0.2 < np.sqrt((pull**2).mean()) < 2.5  # some five shapes
    total = sum(calibrated.part_arcsec[name] for name in PARTS)
    np.testing.assert_allclose(total, calibrated.of("measured").error_arcsec, atol=1e-12)
    # a pinhole leaves the distortion: q r^3 less what principal point, scale and tilt take; seen with and without stars
    pinhole = calibrated.direct["pinhole"].rms_arcsec
    assert calibrated.direct["brown_conrady"].rms_arcsec < 1e-5
    assert pinhole > 1.0
    assert calibrated.of("reference", model="pinhole").rms_arcsec == pytest.approx(pinhole, rel=0.3)


def test_floor_is_the_scatter_that_was_not_stated(calibrated, sky):
    """n numbers of variance v: known to v sqrt(2 / n)."""
    matched, _, _ = sky
    variance = STATED_PX**2 + MORE_PX**2
    reach = 4.0 * variance * np.sqrt(2.0 / (2 * len(matched)))
    for floor in calibrated.floor_px.values():
        assert floor**2 == pytest.approx(MORE_PX**2, abs=reach)
    assert calibrated.of("measured").calibration.solution.reduced_chi2 == pytest.approx(1.0, abs=0.02)
    residual = calibrated.residual_px
    assert residual.var() == pytest.approx(variance, abs=reach)
    np.testing.assert_allclose(
        calibrated.of("measured").calibration.covariance, calibrated.of("corrected").calibration.covariance, rtol=0.05
    )


def test_attitudes_linked_by_a_gyro(calibrated, scene, config, sky):
    """A truly perfect gyro gives a map no worse than predicted; each method states less than free attitudes."""
    free = calibrated.of("corrected")
    assert {key[0] for key in calibrated.maps} == set(METHODS)
    for method in ("linked", "acc_true"):
        linked = calibrated.of("corrected", method=method)
        assert linked.calibration.solution.converged
        assert abs(linked.rms_arcsec - linked.map.predicted_rms_arcsec) < 4.0 * linked.map.predicted_rms_spread_arcsec
        assert linked.map.predicted_rms_arcsec < 1.01 * free.map.predicted_rms_arcsec
    matched, positions, chart = sky
    exact = study.Calibrator(
        scene=scene,
        matched=matched,
        config=config,
        chart=chart,
        used=np.ones(len(matched), bool),
        position_px=positions,
    )
    name = scene.config.model
    wrong, right = (exact.calibrate("reference", model=name, method=gyro).rms_arcsec for gyro in ("acc", "acc_true"))
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


def test_records(calibrated, scene, sky, truth):
    matched, positions, chart = sky
    result, count = tables.summarise_camera(calibrated), len(matched)
    assert (result.rendered, result.frames, result.frames_matched, result.stars) == (350, 5, 4, count)
    assert result.stars_per_frame == pytest.approx(count / 5)
    assert (result.wrong_matches, result.wrong_match_fraction) == (3, pytest.approx(3 / count))
    assert result.detections == list(range(1, 1 + len(OUTCOMES)))
    assert result.not_converged == 0
    scatter = np.hypot(1.0, MORE_PX / STATED_PX)  # faint ones: no floor in what they state
    ratio = result.centroid_scatter_ratio
    assert ratio.n == 2 * (count // 2)
    assert ratio.value == pytest.approx(scatter, abs=4.0 * scatter * ratio.uncertainty)
    assert ratio.uncertainty == pytest.approx(0.889 / np.sqrt(2 * (count // 2)))
    assert result.quadrature_arcsec == pytest.approx(
        np.linalg.norm([rms(calibrated.part_arcsec[part]) for part in PARTS])
    )
    assert result.part_correlation[1] == pytest.approx(
        (calibrated.part_arcsec["mismatch"] * calibrated.part_arcsec["noise"]).sum(1).mean()
        / (result.part_rms_arcsec[0] * result.part_rms_arcsec[2])
    )
    assert np.abs(result.part_correlation).max() <= 1.0
    assert len(tables.PAIRS) == len(result.part_correlation)
    assert tables.PAIRS[1] == "mismatch, noise"
    error = tables.compare_maps([calibrated, calibrated], "free")
    assert error.noise_map_rms_arcsec == pytest.approx([calibrated.of("corrected").rms_arcsec] * 2, rel=1e-4)
    assert error.measured_predicted_arcsec[0].value == calibrated.of("measured").map.predicted_rms_arcsec
    assert error.measured_rms_arcsec == [calibrated.of("measured").rms_arcsec] * 2
    fitted = {parameter.name: parameter.value for parameter in tables.tabulate_parameters(calibrated)}
    for name, value in truth.items():
        true = value + SHIFT_PX * (name == "x0_px") + PSF_PX[1] * (name == "y0_px")
        assert abs(fitted[name].value - true) < 4.5 * fitted[name].uncertainty
    assert error.corrected_sigma_f_um[0] == pytest.approx(1e3 * fitted["focal_length_mm"].uncertainty, rel=0.05)
    brown, pinhole = tables.compare_models(calibrated)
    assert (brown.parameters, pinhole.parameters) == (8, 3)
    assert pinhole.direct_arcsec == calibrated.direct["pinhole"].rms_arcsec > pinhole.corrected_predicted_arcsec
    rows = tables.tabulate_map(calibrated)
    assert len(rows) == 81
    assert np.array_equal(rows[7].position_px, chart.pixel_px[7])
    assert np.array_equal(rows[7].noise_arcsec, calibrated.part_arcsec["noise"][7])
    star = tables.tabulate_stars(calibrated)[3]
    assert (star.frame, star.magnitude) == (matched.frame[3], scene.sky.magnitude[matched.star[3]])
    np.testing.assert_allclose(star.sigma_px, STATED_PX)
    assert np.array_equal(star.light_px, positions["light"][3])


def test_too_few_stars_are_refused(scene, config, sky):
    matched, positions, chart = sky
    few = {name: np.where(np.arange(len(matched))[:, None] < 49, xy, np.nan) for name, xy in positions.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "star_positions", lambda *_: few)
        patch.setattr(study, "trace_chart", lambda *_: chart)
        with pytest.raises(DomainError, match=r"49 good stars matched in 1 frames|at least 50 are needed"):
            calibrate_camera(scene, None, replace(matched, frame=np.arange(len(matched)) % 5), config, advance=None)
