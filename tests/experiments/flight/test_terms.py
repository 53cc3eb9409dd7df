"""Verdicts on the terms: invented segments as predicted hold, wrong predictions fail by the term that is wrong."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.accuracy.attitude_terms import AttitudeErrors
from experiments.flight.experiment import SECTIONS, axes
from experiments.flight.terms import measured_terms, predicted_terms
from experiments.harness.quantities import Outcome
from experiments.harness.sections import described, judged

SEGMENTS, FRAMES = 40, 30
NOISE, PIXEL, BIAS = np.array([0.02, 0.02, 0.4]), np.array([0.012, 0.012, 0.25]), np.array([0.02, -0.015, 0.4])
BUDGET = SimpleNamespace(
    flight=SimpleNamespace(
        frame_times_s=lambda start: start + np.arange(FRAMES) / 5.0,
        trajectory=SimpleNamespace(rate=lambda _: np.array([4e-4, 0.0, 0.0])),
    ),
    config=SimpleNamespace(frames=SimpleNamespace(switched=6)),
    pixel_rad=2.7e-5,
    bias_arcsec=lambda: BIAS,
)


@pytest.fixture(scope="module")
def told():
    rng, zero = np.random.default_rng(1), np.zeros(3)
    return [
        AttitudeErrors(
            time_s=100.0 * k, available=True, stars=16.0, noise_arcsec2=NOISE**2, pixel_arcsec2=PIXEL**2,
            fov_arcsec=rng.normal(0.0, [0.02, 0.02, 0.4]), spot_arcsec2=zero, focus_arcsec2=zero,
            thermal_arcsec=rng.normal(0.0, [0.03, 0.03, 0.4]),
            aberration_arcsec=np.append(0.025 * np.array([np.cos(k), np.sin(k)]), 0.0),
        )
        for k in range(SEGMENTS)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def flown(told):
    """What a sensor that errs as told would show."""
    rng, segments = np.random.default_rng(2), []
    for one in told:
        pixel = PIXEL * rng.standard_normal((FRAMES, 3))
        error = one.signed_arcsec + BIAS + pixel + NOISE * rng.standard_normal((2, FRAMES, 3))
        fine = 1e-4 * rng.standard_normal((2, 3, 3))
        segments.append(
            SimpleNamespace(
                error_arcsec=error,
                solved=np.ones(FRAMES, bool),
                thermal_arcsec=one.thermal_arcsec + fine[0],
                aberration_arcsec=one.aberration_arcsec + fine[1],
            )
        )
    return segments


def criteria(flown, told):
    terms, sections = measured_terms(BUDGET, flown, told), {"terms": SECTIONS["terms"]}
    data = described(sections, axes(None), {"terms": terms}).dataset
    return judged(sections, Outcome(config=None, result={"terms": terms}, data=data))


def test_every_verdict_on_a_sensor_that_errs_as_predicted_holds(flown, told):
    verdicts = criteria(flown, told)
    assert not [one.name for one in verdicts if one.failed]
    assert sum(one.passed is True for one in verdicts) >= 12


@pytest.mark.parametrize(
    ("change", "term"),
    [
        (lambda one: {"thermal_arcsec": -one.thermal_arcsec}, "Thermo-elastic"),
        (lambda one: {"noise_arcsec2": one.noise_arcsec2 / 16.0}, "Temporal noise"),
    ],
    ids=["sign of the temperature", "over N for its root"],
)
def test_a_wrong_term_fails_its_verdict(flown, told, change, term):
    failed = [one.name for one in criteria(flown, [replace(one, **change(one)) for one in told]) if one.failed]
    assert any(term in name for name in failed), failed


def test_terms_of_too_few_measured_segments_are_the_predicted_ones(flown, told):
    terms = measured_terms(BUDGET, flown[:1], told[:1])
    assert terms[-1].measured_arcsec is None
    np.testing.assert_allclose(terms[-1].predicted_arcsec, predicted_terms(BUDGET, told[:1])[-1].predicted_arcsec)
    assert predicted_terms(BUDGET, [replace(told[0], available=False)]) == []
