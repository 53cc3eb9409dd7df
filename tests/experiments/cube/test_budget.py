"""Lines of the budget from drawn errors of many benches; terms by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.cube import budget as study
from experiments.cube.budget import build_budget, eq13_arcsec, eq14_arcsec, perfect_sensor, predict_terms
from experiments.cube.montecarlo import CASES, CaseResult
from optics.units import RAD_ARCSEC

PICTURE, SENSOR = np.array([0.2, 0.2, 0.2]), np.array([0.3, 0.1, 0.2])


@pytest.fixture(scope="module")
def single(laboratory):
    return predict_terms(laboratory, perfect_sensor(laboratory), np.array([0.5, 0.25]))


def benches_of(case, sigma, count, seed=1):
    """CaseErrors whose errors are normal, of the sensor a third, half as large as it states."""
    benches = [
        SimpleNamespace(
            error_arcsec=error,
            sensor_error_arcsec=error / 3.0,
            sensor_sigma_arcsec=2.0 * sigma / 3.0,
            trims=(SimpleNamespace(rows=[1, 2, 3]), SimpleNamespace(rows=[1])),
        )
        for error in sigma * np.random.default_rng(seed).standard_normal((count, 3))
    ]
    return CaseResult(case=case, bench=tuple(benches))


def test_equations_13_and_14_with_the_right_units(laboratory):
    """7 um over 650 mm, halved by the mirror, printed as 2.34 arcsec in CUBE09; its sum with 2, 2, 0.4."""
    pixel = eq13_arcsec(laboratory)
    assert pixel == pytest.approx(2.38, abs=0.01)
    assert eq14_arcsec(laboratory) == pytest.approx(np.sqrt(pixel**2 + 4.0 + 4.0 + 0.16), rel=1e-9)


def test_terms_alone(laboratory, single):
    pixel, repeats = eq13_arcsec(laboratory), np.sqrt(laboratory.config.cube.repeats)
    assert single["pixel"] == pytest.approx([pixel / repeats] * 3)
    assert single["trim"] * repeats == pytest.approx(pixel * np.array([0.25, 0.5, 0.25]))
    assert single["mounting"] * repeats == pytest.approx([2.0] * 3)
    outer, inner = laboratory.config.table.outer_reading_arcsec, laboratory.config.table.inner_reading_arcsec
    assert single["reading"] * repeats == pytest.approx([outer, inner, outer])
    assert single["square"][2] == pytest.approx(1.0, rel=0.05)  # 2 arcsec, half of which cancels; about z alone
    assert np.abs(single["square"][:2]).max() < 0.02
    often = laboratory.config.model_copy(update={"cube": laboratory.config.cube.model_copy(update={"repeats": 4})})
    four = predict_terms(replace(laboratory, config=often), perfect_sensor(laboratory), np.array([0.5, 0.25]))
    for name in ("pixel", "trim", "mounting", "reading"):
        assert four[name] == pytest.approx(0.5 * repeats * single[name])


def test_noise_of_pictures_and_sun_sensor_by_their_sizes(laboratory):
    """A pixel of a picture is the angle of eq. 13; one of the sun sensor its pitch over the gap, over many spots."""
    picture, sensor = study._noise_arcsec(
        laboratory, CASES[-1], SimpleNamespace(one_picture_px=0.2, two_pictures_px=0.1)
    )
    repeats = np.sqrt(laboratory.config.cube.repeats)
    assert picture == pytest.approx([0.2 * eq13_arcsec(laboratory) / repeats] * 3, rel=0.01)
    config = laboratory.config.sensor
    pixel_arcsec = laboratory.sensor_detector.pixel_pitch_mm / config.gap_mm * RAD_ARCSEC
    assert (sensor < 0.05 * pixel_arcsec).all()
    assert (sensor > 1e-4 * pixel_arcsec).all()


def test_budget_of_benches_with_the_predicted_errors(laboratory, single, monkeypatch):
    """400 benches a case: the RMS of an axis known to 1 / sqrt(800), with its stated uncertainty."""
    monkeypatch.setattr(study, "_noise_arcsec", lambda *_: (PICTURE, SENSOR))
    monkeypatch.setattr(study, "trim_remainder_px", lambda *_: np.array([0.5, 0.25]))
    on = {
        "pixel": ["pixel"],
        "trim": ["trim"],
        "square": ["square"],
        "mounting": ["mounting"],
        "reading": ["reading"],
        "all": ["pixel", "square", "mounting", "reading"],
        "procedure": ["trim", "square", "mounting", "reading"],
        "improved": ["reading"],
    }
    cases, expected = {}, {}
    for number, case in enumerate(CASES):
        squares = sum(single[name] ** 2 for name in on[case.name])
        expected[case.name] = np.sqrt(squares + PICTURE**2 + SENSOR**2)
        cases[case.name] = benches_of(case, expected[case.name], 400, seed=number)
    pictures = SimpleNamespace(two_pictures_px=0.1, one_picture_px=0.1)
    rows = {row.term: row for row in build_budget(laboratory, cases, pictures)}
    for name, row in rows.items():
        assert [axis.value for axis in row.predicted] == pytest.approx(expected[name])
        error = np.array([axis.uncertainty for axis in row.measured])
        difference = np.array([axis.value for axis in row.measured]) - expected[name]
        # stratification removes scatter: never more than that of independent draws
        assert (error < 1.01 * (difference + expected[name]) / np.sqrt(800)).all()
        assert np.abs(difference).max() < 4.0 * expected[name].max() / np.sqrt(800)
        assert row.predicted_over_measured.value == pytest.approx(1.0, abs=4.0 / np.sqrt(800))
        assert row.measured[0].n == 400
    free = rows["reading"].measured[0]  # nothing stratified
    assert free.uncertainty == pytest.approx(free.value / np.sqrt(800))
    prediction_error = np.hypot(PICTURE[0] ** 2, 0.15 * SENSOR[0] ** 2) / expected["pixel"][0]
    assert rows["pixel"].predicted[0].uncertainty == pytest.approx(prediction_error)
    assert rows["square"].acts_on.tolist() == [False, False, True]
    assert rows["improved"].acts_on.all()
    assert rows["all"].published_arcsec == 3.69
    assert (rows["procedure"].test_limit_arcsec, rows["improved"].test_limit_arcsec) == (4.0, 1.0)
    assert np.isnan(rows["pixel"].test_limit_arcsec)
    few = {"procedure": benches_of(CASES[6], expected["procedure"], 50)}
    (row,) = build_budget(laboratory, few, pictures)
    assert (row.specified_arcsec, row.test_limit_arcsec) == (4.0, pytest.approx(4.0 * 1.3))


def test_statistics_of_a_case():
    result = benches_of(CASES[0], np.array([1.0, 2.0, 3.0]), 200)
    assert result.rms_arcsec == pytest.approx([1.0, 2.0, 3.0], rel=4.0 / np.sqrt(400))
    assert result.sensor_rms_arcsec == pytest.approx(result.rms_arcsec / 3.0)
    assert result.sensor_rms_pull == pytest.approx(result.rms_arcsec / [2.0, 4.0, 6.0])
    for (mean, sigma), part in ((result.mean_arcsec, 1.0), (result.sensor_mean_arcsec, 1.0 / 3.0)):
        assert sigma == pytest.approx(part * np.array([1.0, 2.0, 3.0]) / np.sqrt(200), rel=4.0 / np.sqrt(400))
        assert (np.abs(mean) < 4.0 * sigma).all()
    assert result.trims.tolist() == [3, 1] * 200
