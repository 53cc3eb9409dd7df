"""The split of the error and its verdicts: invented segments with known terms, and predictions that are wrong."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.flight.experiment import SECTIONS, axes
from experiments.flight.frames import Segment
from experiments.flight.prediction import SegmentErrors, attitude_of_shifts, covariance_of_noise
from experiments.flight.terms import measured_terms, predicted_terms
from experiments.harness.quantities import Outcome
from experiments.harness.sections import described, judged

SEGMENTS, FRAMES, STARS = 40, 30, 16
NOISE, PIXEL = np.array([0.02, 0.02, 0.4]), np.array([0.012, 0.012, 0.25])
BIAS = np.array([0.02, -0.015, 0.4])


def budget(rate_rad_per_s=(4e-4, 0.0)):
    trajectory = SimpleNamespace(rate=lambda _: np.array([*rate_rad_per_s, 0.0]))
    flight = SimpleNamespace(frame_times_s=lambda start: start + np.arange(FRAMES) / 5.0, trajectory=trajectory)
    config = SimpleNamespace(frames=SimpleNamespace(switched=6))
    return SimpleNamespace(flight=flight, pixel_rad=2.7e-5, bias_arcsec=lambda: BIAS, config=config)


@pytest.fixture(scope="module")
def told():
    rng = np.random.default_rng(1)
    return [
        SegmentErrors(
            time_s=100.0 * k,
            available=True,
            stars=float(STARS),
            noise_arcsec2=NOISE**2,
            pixel_arcsec2=PIXEL**2,
            fov_arcsec=rng.normal(0.0, [0.02, 0.02, 0.4]),
            spot_arcsec2=np.zeros(3),
            focus_arcsec2=np.zeros(3),
            thermal_arcsec=rng.normal(0.0, [0.03, 0.03, 0.4]),
            aberration_arcsec=np.append(0.025 * np.array([np.cos(k), np.sin(k)]), 0.0),
        )
        for k in range(SEGMENTS)
    ]


@pytest.fixture(scope="module")
def flown(told):
    """What a sensor that errs as told would show."""
    rng, segments = np.random.default_rng(2), []
    for one in told:
        common = one.fov_arcsec + one.thermal_arcsec + one.aberration_arcsec + BIAS
        pixel = PIXEL * rng.standard_normal((FRAMES, 3))
        error = common + pixel + NOISE * rng.standard_normal((2, FRAMES, 3))
        fine = 1e-4 * rng.standard_normal((2, 3, 3))
        segments.append(segment(one, error, fine))
    return segments


def segment(one, error, fine):
    """As a sensor with these errors (2, n, 3), and small ones by switching."""
    return Segment(
        start_s=one.time_s,
        blinded=False,
        error_arcsec=error,
        stars=np.full(FRAMES, float(STARS)),
        rejected=np.zeros(FRAMES),
        false_stars=np.zeros(FRAMES),
        thermal_arcsec=one.thermal_arcsec + fine[0],
        aberration_arcsec=one.aberration_arcsec + fine[1],
        acquired="ok",
        acquisition_s=0.1,
        wrong=0,
    )


def criteria(flown, told):
    terms = measured_terms(budget(), flown, told)
    sections = {"terms": SECTIONS["terms"]}
    data = described(sections, axes(None), {"terms": terms}).dataset
    return terms, judged(sections, Outcome(config=None, result={"terms": terms}, data=data))


def failed(flown, told):
    return [one.name for one in criteria(flown, told)[1] if one.failed]


def test_known_terms_come_out_and_every_verdict_holds(flown, told):
    terms, verdicts = criteria(flown, told)
    assert not [one.name for one in verdicts if one.failed]
    assert sum(one.passed is True for one in verdicts) >= 12
    found = {one.term: one for one in terms}
    for name, true in (("temporal_noise", NOISE), ("pixel_spatial", PIXEL)):
        for k, value in enumerate((true[0], true[2])):
            seen = found[name].measured_arcsec[k]
            assert seen.value == pytest.approx(value, abs=4.0 * seen.uncertainty)
            assert seen.uncertainty < 0.1 * value


@pytest.mark.parametrize(
    ("change", "term"),
    [
        (lambda one: {"thermal_arcsec": -one.thermal_arcsec}, "Thermo-elastic"),
        (lambda one: {"aberration_arcsec": 0.0 * one.aberration_arcsec}, "Aberration"),
        (lambda one: {"noise_arcsec2": one.noise_arcsec2 / STARS}, "Temporal noise"),
        (lambda one: {"pixel_arcsec2": 2.0 * one.pixel_arcsec2}, "Pixel spatial"),
        (lambda one: {"fov_arcsec": 1.4 * one.fov_arcsec}, "FOV spatial"),
    ],
    ids=["sign of the temperature", "aberration left out", "over N for its root", "patterns twice", "colour 1.4 times"],
)
def test_a_wrong_term_fails_its_verdict(flown, told, change, term):
    wrong = [replace(one, **change(one)) for one in told]
    assert any(term in name for name in failed(flown, wrong)), failed(flown, wrong)


def test_errors_of_pixel_phase_are_as_certain_as_stated(told):
    """All stars cross pixels alike: the sum of their oscillations is one oscillation, of random size, per segment.

    12 stars, 10 segments of 30 frames, 40 flights: pulls of the mean square are 0 +- 0.16, their mean square is
    1 +- 0.27 (kurtosis 4: some 20 exponential deviates each); frames taken as independent would give 19.
    """
    rng, times, pulls = np.random.default_rng(6), np.arange(FRAMES) / 5.0, []
    still = dict.fromkeys(("pixel_arcsec2", "fov_arcsec", "thermal_arcsec", "aberration_arcsec"), np.zeros(3))
    own = [replace(one, **still, spot_arcsec2=PIXEL**2, noise_arcsec2=1e-2 * PIXEL**2) for one in told[:10]]
    rate = np.array([0.448, 1.231])  # pixels per frame of the default flight
    flown = budget(tuple(5.0 * rate * 2.7e-5))
    for _ in range(40):
        segments = []
        for one in own:
            phase = rng.uniform(size=(12, 1, 2)) + 5.0 * times[:, None] * rate
            x, y = (np.sqrt(2.0) * np.sin(2.0 * np.pi * phase)).sum(axis=0).T / np.sqrt(12.0)
            error = PIXEL * (np.stack([x, y, (x + y) / np.sqrt(2.0)], 1) + 0.1 * rng.standard_normal((2, FRAMES, 3)))
            segments.append(segment(one, error, np.zeros((2, 3, 3))))
        ratio = {one.term: one.ratio for one in measured_terms(flown, segments, own)}["pixel_spatial"][0]
        pulls.append((ratio.value**2 - 1.0) / (2.0 * max(ratio.value, 0.5) * ratio.uncertainty))
    assert np.mean(pulls) == pytest.approx(0.0, abs=0.64)
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=1.1)


def test_at_rest_pixel_errors_stay_in_the_mean_of_a_segment(told):
    still = predicted_terms(budget((0.0, 0.0)), told)
    moving = predicted_terms(budget(), told)
    for at_rest, turning in zip(still, moving, strict=True):
        if at_rest.term == "pixel_spatial":
            assert not at_rest.predicted_arcsec.any()
        if at_rest.term == "total":
            np.testing.assert_allclose(at_rest.predicted_arcsec, turning.predicted_arcsec)


def test_errors_of_known_sign_add_up_in_the_total(told):
    """Thermo-elastic errors that equal the aberration's in every segment are as one aberration of twice the size."""
    alike = [replace(one, thermal_arcsec=one.aberration_arcsec) for one in told]
    twice = [replace(one, thermal_arcsec=np.zeros(3), aberration_arcsec=2.0 * one.aberration_arcsec) for one in told]
    totals = [predicted_terms(budget(), errors)[-1].predicted_arcsec for errors in (alike, twice)]
    np.testing.assert_allclose(totals[0], totals[1], rtol=1e-12)


def test_attitude_of_stars_follows_their_errors_to_first_order():
    """Against the estimator itself: Wahba's problem with weights, stars displaced and stars with noise."""
    from calib.attitude.solve import solve_wahba

    rng = np.random.default_rng(4)
    v = np.column_stack([rng.uniform(-0.1, 0.1, (9, 2)), np.ones(9)])
    v /= np.linalg.norm(v, axis=1)[:, None]
    sigma, shift = rng.uniform(1.0, 3.0, 9) * 1e-6, 1e-5 * rng.normal(size=(9, 3))
    shift -= (shift * v).sum(1)[:, None] * v
    seen = v + shift
    solved = solve_wahba(seen / np.linalg.norm(seen, axis=1)[:, None], v, sigma_rad=sigma)
    told = attitude_of_shifts(v, 1.0 / sigma**2, shift)
    np.testing.assert_allclose(told, solved.rotation.as_rotvec(), atol=2e-4 * np.abs(told).max())
    # with the right weights the covariance is the estimator's own
    covariance = covariance_of_noise(v, 1.0 / sigma**2, sigma**2)
    np.testing.assert_allclose(covariance, solved.covariance_rad2, rtol=1e-3, atol=1e-15)
