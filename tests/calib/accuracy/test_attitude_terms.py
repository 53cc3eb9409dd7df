"""The split of attitude errors: invented segments with known terms, correlations in closed form, stated errors."""

from dataclasses import replace

import numpy as np
import pytest

from calib.accuracy import attitude_terms

SEGMENTS, FRAMES = 40, 30
ACROSS, ROLL = (0, 1), (2,)
TIME_S = np.arange(FRAMES) / 5.0
NOISE, PIXEL = np.array([0.02, 0.02, 0.4]), np.array([0.012, 0.012, 0.25])
BIAS = np.array([0.02, -0.015, 0.4])


def prediction(errors, rate_px_per_s=(15.0, 0.0)):
    correlation = [attitude_terms.frame_correlation(rate_px_per_s, TIME_S)] * len(errors)
    return attitude_terms.AttitudePrediction(errors=errors, correlation=correlation, bias_arcsec=BIAS, switched=6)


@pytest.fixture(scope="module")
def told():
    rng = np.random.default_rng(1)
    return [
        attitude_terms.AttitudeErrors(
            time_s=100.0 * k,
            available=True,
            stars=16.0,
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
    """What a sensor that errs as told would show; no attitude in the last frame of every segment."""
    rng, errors, fine = np.random.default_rng(2), [], []
    for one in told:
        pixel = PIXEL * rng.standard_normal((FRAMES, 3))
        error = one.signed_arcsec + BIAS + pixel + NOISE * rng.standard_normal((2, FRAMES, 3))
        error[1, -1] = np.nan
        errors.append(error)
        fine.append(1e-4 * rng.standard_normal((2, 3, 3)))
    return {
        "error_arcsec": errors,
        "thermal_arcsec": [one.thermal_arcsec + noise[0] for one, noise in zip(told, fine, strict=True)],
        "aberration_arcsec": [one.aberration_arcsec + noise[1] for one, noise in zip(told, fine, strict=True)],
    }


@pytest.mark.parametrize(("axes", "axis"), [(ACROSS, 0), (ROLL, 2)], ids=["across", "roll"])
def test_known_terms_come_out_within_their_errors(flown, told, axes, axis):
    terms = prediction(told).compare(axes, **flown)
    assert set(terms) == {*attitude_terms.TERMS, "total"}
    for name, true in (("temporal_noise", NOISE), ("pixel_spatial", PIXEL)):
        root, error = terms[name].root_arcsec
        assert root == pytest.approx(true[axis], abs=4.0 * error)
        assert error < 0.1 * true[axis]
        assert terms[name].samples == len(axes) * SEGMENTS * (FRAMES - 1)
    for name, term in terms.items():
        ratio, error = term.ratio
        assert ratio == pytest.approx(1.0, abs=4.0 * error) or not term.comparable, name
    for name in ("thermo_elastic", "fov_spatial"):
        slope, error = terms[name].slope
        assert slope == pytest.approx(1.0, abs=4.0 * error)
    assert terms["aberration"].comparable == (axis == 0)
    assert np.isnan(terms["bias"].slope).all()


@pytest.mark.parametrize(
    ("change", "term", "axes", "number"),
    [
        (lambda one: {"thermal_arcsec": -one.thermal_arcsec}, "thermo_elastic", ACROSS, -1.0),
        (lambda one: {"aberration_arcsec": 0.5 * one.aberration_arcsec}, "aberration", ACROSS, 2.0),
        (lambda one: {"fov_arcsec": 1.4 * one.fov_arcsec}, "fov_spatial", ROLL, 1.0 / 1.4),
    ],
    ids=["sign of the temperature", "half of the aberration", "colour 1.4 times"],
)
def test_the_slope_shows_what_is_wrong_with_a_prediction(flown, told, change, term, axes, number):
    slope, error = prediction([replace(one, **change(one)) for one in told]).compare(axes, **flown)[term].slope
    assert slope == pytest.approx(number, abs=4.0 * error)
    assert error < 0.15


def test_errors_of_pixel_phase_are_as_certain_as_stated(told):
    """All stars cross pixels alike: the sum of their oscillations is one oscillation, of random size, per segment.
    12 stars, 10 segments of 30 frames, 40 flights: pulls of the mean square are 0 +- 0.16, their mean square is
    1 +- 0.27 (kurtosis 4: some 20 exponential deviates each); frames taken as independent would give 19."""
    rng, pulls = np.random.default_rng(6), []
    still = dict.fromkeys(("pixel_arcsec2", "fov_arcsec", "thermal_arcsec", "aberration_arcsec"), np.zeros(3))
    own = [replace(one, **still, spot_arcsec2=PIXEL**2, noise_arcsec2=1e-2 * PIXEL**2) for one in told[:10]]
    rate = 5.0 * np.array([0.448, 1.231])  # pixels per frame of the default flight, about x and y
    nothing = [np.zeros((3, 3))] * len(own)
    for _ in range(40):
        errors = []
        for _ in own:
            phase = rng.uniform(size=(12, 1, 2)) + TIME_S[:, None] * rate
            x, y = (np.sqrt(2.0) * np.sin(2.0 * np.pi * phase)).sum(axis=0).T / np.sqrt(12.0)
            oscillation = np.stack([x, y, (x + y) / np.sqrt(2.0)], axis=1)
            errors.append(PIXEL * (oscillation + 0.1 * rng.standard_normal((2, FRAMES, 3))))
        term = prediction(own, rate).compare(
            ACROSS, error_arcsec=errors, thermal_arcsec=nothing, aberration_arcsec=nothing
        )["pixel_spatial"]
        pulls.append((term.measured_arcsec2 - term.predicted_arcsec2) / term.error_arcsec2)
    assert np.mean(pulls) == pytest.approx(0.0, abs=0.64)
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=1.1)


def test_at_rest_pixel_and_focus_errors_stay_in_the_mean_of_a_segment(told):
    still, moving = prediction(told, (0.0, 0.0)).squares(ACROSS), prediction(told).squares(ACROSS)
    assert still["pixel_spatial"] == pytest.approx(0.0, abs=1e-15)
    assert still["fov_spatial"] == pytest.approx(moving["fov_spatial"] + moving["pixel_spatial"])
    assert still["total"] == moving["total"]
    # at rest all of their variance, and none of the pixel spatial error; crossing whole pixels neither
    errors = [replace(one, focus_arcsec2=PIXEL**2) for one in told]
    still, without = (prediction(each, (0.0, 0.0)).squares(ROLL) for each in (errors, told))
    assert still["thermo_elastic"] == pytest.approx(without["thermo_elastic"] + PIXEL[2] ** 2)
    assert still["pixel_spatial"] == pytest.approx(0.0, abs=1e-12)


def test_errors_of_known_sign_add_up_in_the_total(told):
    """Thermo-elastic errors that equal the aberration's in every segment are as one aberration of twice the size."""
    alike = [replace(one, thermal_arcsec=one.aberration_arcsec) for one in told]
    twice = [replace(one, thermal_arcsec=np.zeros(3), aberration_arcsec=2.0 * one.aberration_arcsec) for one in told]
    first, second = (prediction(errors).squares(ACROSS)["total"] for errors in (alike, twice))
    assert first == pytest.approx(second, rel=1e-12)


def test_correlations_of_frames():
    """0.3 px further about x: 0.75 by patterns 1.2 px wide; stars move along y, by a phase of 108 deg."""
    frames = attitude_terms.frame_correlation([0.3, 0.0], [0.0, 1.0])
    assert frames.patterns[0, 1] == pytest.approx(0.75)
    np.testing.assert_allclose(frames.phases[:, 0, 1], np.array([1.0, 0.0, 0.5]) * np.cos(0.6 * np.pi) + [0, 1, 0.5])
    assert attitude_terms.mean_correlation(frames.patterns) == pytest.approx(0.75)
    assert attitude_terms.mean_correlation(np.ones((3, 1, 1))).tolist() == [1.0, 1.0, 1.0]


def test_a_slope_of_few_values_is_as_uncertain_as_student_has_it():
    """Two errors beyond a level of 5 %: 95 % of 4000 slopes of three values lie within 1.96 stated errors."""
    rng, x = np.random.default_rng(3), np.array([1.0, -2.0, 0.5])
    fits = np.array([attitude_terms.slope_through_zero(x, 0.7 * x + rng.standard_normal(3), 0.05) for _ in range(4000)])
    inside = (np.abs(fits[:, 0] - 0.7) < 1.95996 * fits[:, 1]).mean()
    assert inside == pytest.approx(0.95, abs=4.0 * np.sqrt(0.05 * 0.95 / 4000))
    assert np.isnan(attitude_terms.slope_through_zero(0.0 * x, x)).all()
