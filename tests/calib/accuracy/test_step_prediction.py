"""Predicted step tests of a Gaussian star: parts against the drawn whole, closed forms of patterns and places."""

from types import SimpleNamespace

import numpy as np
import pytest
from star_images import gaussian_epsf

from calib.accuracy.step_prediction import StepModel, step_term
from calib.measure.centroid_error.expected_windows import expected_windows
from calib.measure.centroiding.registry import get_centroider
from calib.records import NoiseModel
from render.detector.noise import PixelNoise
from render.detector.spec import load_detector
from render.records import EffectivePsf

CHIP = load_detector("cmv4000")
TOLD = NoiseModel(read_noise_e=CHIP.read_noise_e, gain_dn_per_e=CHIP.gain_dn_per_e, quantised=True)
PIXEL = PixelNoise.of(CHIP, temperature_c=0.0, exposure_s=0.1)
STARS, POSITIONS, STEP = 6, 3, 0.25
REST = np.array([[20.1, 20.2], [61.2, 20.0], [101.8, 20.8], [20.0, 60.9], [60.9, 60.2], [101.2, 60.1]])


@pytest.fixture(scope="module")
def psf():
    return gaussian_epsf(0.6, 8)


def windows(psf, step=STEP, offset=0.0):
    """Steps along the diagonal."""
    motion = np.linspace(-1.0, 1.0, POSITIONS)[:, None] * step / np.sqrt(2.0) + np.zeros((1, 2))
    position = (REST + (motion + offset)[:, None]).reshape(-1, 2)
    return expected_windows([psf], position, 6000.0, window_px=13)


def model(psf, step=STEP, **settings):
    given = {"noise": TOLD, "pixel": PIXEL, "frames": 40, "dark_frames": 40, "positions": POSITIONS, "draws": 400}
    return StepModel(windows=windows(psf, step), **{**given, **settings})


def test_causes_add_in_squares_to_the_rms_of_steps(psf):
    """Rationale: the number is drawn and reduced, its parts are closed forms, six stars less their mean counting 5/6.
    Expected: the sum of squares within 400 draws of some 20 differences each."""
    of = model(psf, roll_rad=1e-4).predict(get_centroider("epsf", epsf=[psf]), np.random.default_rng(1))
    parts = [*of.cause_px.values(), of.temporal_px, of.dark_px, of.roll_px]
    np.testing.assert_allclose(np.square(parts).sum(0), of.step_rms_px**2, rtol=4.5 * np.sqrt(2 / 10 / 400))
    assert of.cause_px["pattern"].tolist() == [0.0, 0.0]  # subtracted with the dark frames
    raw = model(psf, dark_subtracted=False).predict(get_centroider("cog"), np.random.default_rng(1))
    assert raw.dark_px.tolist() == [0.0, 0.0]
    assert raw.cause_position_px["pattern"].min() > 5.0 * of.cause_position_px["prnu"].max()


def test_draws_behind_an_s_curve_add_no_noise(psf):
    """Rationale: a mean over 20 draws has twice the variance of 40 frames. Expected: the number has that of frames."""
    gravity = get_centroider("cog")
    exact, drawn = (model(psf).predict(gravity, np.random.default_rng(2), noise_draws=n) for n in (0, 20))
    assert np.all(exact.temporal_px > 0.3 * exact.step_rms_px)
    np.testing.assert_allclose(drawn.step_rms_px**2, exact.step_rms_px**2, rtol=6.0 * np.sqrt(2 / 10 / 400))


def test_patterns_are_sampled_by_the_steps_of_an_erring_platform(psf):
    """Rationale: over so short a way a response changes in proportion. Expected: PRNU squared as steps squared are.
    Per axis s^2 / 2 of equal steps along the diagonal, and 2 e^2 of errors e of both positions: 1 + 4 e^2 / s^2."""
    s, e, paths, rng = 0.1, 0.04, 100, np.random.default_rng(3)
    offsets = list(e * rng.standard_normal((paths, POSITIONS, 2)))
    erring = {"offsets_px": offsets, "drawn_windows": [windows(psf, s, one) for one in offsets]}
    found, equal = (model(psf, s, draws=2, **more).predict(get_centroider("cog"), rng) for more in (erring, {}))
    for name in ("prnu", "dark"):
        a, b = (of.dark_px if name == "dark" else of.cause_px[name] for of in (found, equal))
        # two steps of two axes a path, each with a variance of twice its mean at most
        np.testing.assert_allclose((a / b) ** 2, 1.0 + 4.0 * e**2 / s**2, rtol=4.0 / np.sqrt(2.0 * paths))


def test_masked_pixels_move_the_stars_they_touch(psf):
    defect = np.zeros((100, 140), bool)
    defect[20, 21] = True
    of = model(psf, defect=defect, draws=2).predict(get_centroider("gaussian"), np.random.default_rng(4))
    clean = model(psf, draws=2).predict(get_centroider("gaussian"), np.random.default_rng(4))
    assert of.cause_position_px["defects"].max() > 0.0
    assert clean.cause_position_px["defects"].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(of.s_curve_px, clean.s_curve_px)


def test_faint_fits_are_biased_and_sessions_differ(psf):
    """A wide PSF built from frames puts an S-curve into the fit; noise of a faint star a bias."""
    faint = expected_windows([psf], windows(psf).position_px, 300.0, window_px=13)
    broad = EffectivePsf(values=psf.values**0.8, oversampling=8)
    sessions = [get_centroider("epsf", epsf=[one]) for one in (psf, broad)]
    steps = StepModel(windows=faint, positions=POSITIONS, noise=TOLD, pixel=PIXEL, frames=40, dark_frames=40, draws=4)
    of = steps.predict(sessions[0], np.random.default_rng(5), sessions=sessions, fit_draws=8)
    assert of.session_px2.shape == (2, 2)
    assert of.session_px2[1].min() > of.session_px2[0].max()
    assert np.sqrt((of.s_curve_px**2).mean()) > 1e-3


def test_places_average_chips_and_noise_and_no_session():
    """Places differ by chip and noise: the RMS over four scatters half as much as one; a PSF's session by all of it."""

    def place(sessions=()):
        return SimpleNamespace(
            step_rms_px=np.array([0.03, 0.04]),
            step_rms_scatter_px=np.array([0.002, 0.004]),
            session_px2=np.array(sessions),
        )

    found = step_term([place()] * 2, places=4, pixel_arcsec=5.0)
    np.testing.assert_allclose(found.arcsec, [0.45, 0.6])
    np.testing.assert_allclose(found.uncertainty_arcsec, [0.015, 0.03])
    shared = step_term([place([[1e-5, 1e-5], [3e-5, 3e-5]])] * 2, places=4, pixel_arcsec=5.0)
    assert (shared.uncertainty_arcsec > found.uncertainty_arcsec).all()
