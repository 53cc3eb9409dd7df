"""Numbers of the step test from drawn errors, and S-curves against sums over pixels: no frames."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf

from calib.accuracy.step_prediction import CAUSES
from experiments.hsfe.experiment import CAUSE_NAMES, compute_s_curves, tabulate_causes, tabulate_steps
from experiments.laboratory.high_frequency import HighFrequencyMeasurement
from render.records import EffectivePsf

POSITIONS, STARS, FRAMES, PIXEL_ARCSEC = 40, 30, 10, 4.0
ERROR_PX, NOISE_PX = np.array([0.02, 0.03]), np.array([0.04, 0.05])


def drawn(rng):
    """A measurement of independent errors of the positions, after noise of the frames, of a path that rolls."""
    shape, (light, error) = (POSITIONS, STARS, 2), rng.standard_normal((2, POSITIONS, STARS, 2))
    place = 0.2 * np.arange(POSITIONS)[:, None, None] + 0.005 * light
    noise = NOISE_PX / np.sqrt(FRAMES) * rng.standard_normal(shape)
    clean = place + ERROR_PX * error
    runs = {"all": clean + noise, "none": place, "only prnu": place + ERROR_PX * error, "without prnu": place + noise}
    others = [cause for cause in CAUSES if cause not in ("s_curve", "prnu")]
    runs |= {f"only {one}": place for one in others} | {f"without {one}": clean + noise for one in others}
    # the same in every run: mean 0, standard deviation NOISE_PX
    ramp = np.arange(FRAMES) - np.arange(FRAMES).mean()
    in_frames = (ramp / ramp.std(ddof=1))[:, None, None, None] * NOISE_PX
    return HighFrequencyMeasurement(
        pixel_arcsec=PIXEL_ARCSEC,
        photon_px=place,
        position_px={name: {"cog": value + in_frames} for name, value in runs.items()},
        noiseless_px={"cog": place + 0.01 * error},
        corner_px=None,
        moving=False,
        motion_px2=np.zeros((POSITIONS, 2, 2)),
    )


def model(document, single):
    """A prediction with a scatter of a tenth, without finite samples of its own."""
    given = {
        "step_rms_px": document,
        "step_rms_scatter_px": 0.1 * document,
        "position_rms_px": single,
        "roll_px": 0.5 * document,
    }
    given |= {"position_rms_scatter_px": 0.1 * single, "dark_px": 0.25 * document, "temporal_px": 2.0 * document}
    parts = {cause: document * n for n, cause in enumerate(CAUSES, 1)}
    return SimpleNamespace(**given, cause_px=parts, cause_position_px=parts, s_curve_px=np.zeros((POSITIONS, STARS, 2)))


@pytest.fixture(scope="module")
def frames():
    return drawn(np.random.default_rng(7))


def test_independent_errors_show_sqrt_2_times_and_once(frames):
    """Document: sqrt(2 (e^2 + s^2/N + light^2)); one position: e alone. Their counts give the limits."""
    share = np.sqrt(1.0 - 1.0 / STARS)
    document = np.sqrt(2.0 * (ERROR_PX**2 + NOISE_PX**2 / FRAMES + 0.005**2)) * share
    found = tabulate_steps(frames, model(2.0 * document, ERROR_PX), model(document, 0.5 * ERROR_PX), "cog")
    scale, limit = 3.0 * PIXEL_ARCSEC, 5.0 / np.sqrt(POSITIONS * STARS)
    for axis in range(2):
        assert found.measured_arcsec[axis].value == pytest.approx(scale * document[axis], rel=limit)
        assert found.ratio[axis].value == pytest.approx(1.0, abs=limit)
        assert found.ratio[axis].uncertainty == pytest.approx(0.1)
        assert found.prior_ratio[axis].value == pytest.approx(0.5 * found.ratio[axis].value)
        assert found.single_position_ratio[axis].value == pytest.approx(2.0, rel=limit)
        assert found.predicted_arcsec[axis].value == pytest.approx(scale * document[axis])
        assert found.prior_predicted_arcsec[axis].uncertainty == pytest.approx(0.2 * scale * document[axis])
    np.testing.assert_allclose(found.single_position_arcsec, scale * ERROR_PX, rtol=limit)
    both = np.sqrt(ERROR_PX**2 + 0.005**2)
    np.testing.assert_allclose(found.independent_position_arcsec, scale * both, rtol=limit)
    np.testing.assert_allclose(found.roll_arcsec, 0.5 * scale * document)
    np.testing.assert_allclose(found.dark_frames_arcsec, 0.25 * scale * document)


@pytest.mark.slow
def test_the_error_of_one_position_is_as_uncertain_as_its_noise_makes_it():
    """Over runs with the same errors: what taking the noise away leaves, of the noise's square and of its product."""
    rng, apart, told = np.random.default_rng(8), [], []
    error = ERROR_PX * rng.standard_normal((POSITIONS, STARS, 2))
    for _ in range(120):
        one = drawn(rng)
        noise = NOISE_PX / np.sqrt(FRAMES) * rng.standard_normal(error.shape)
        shifted = one.position_px["all"]["cog"]
        shifted += one.photon_px + error + noise - shifted.mean(0)
        apart.append(one.single_px("cog"))
        exact = SimpleNamespace(**{**vars(model(ERROR_PX, ERROR_PX)), "position_rms_scatter_px": np.zeros(2)})
        ratio = tabulate_steps(one, exact, exact, "cog").single_position_ratio
        told.append([part.uncertainty for part in ratio])
    np.testing.assert_allclose(np.mean(told, axis=0), np.std(apart, axis=0) / ERROR_PX, rtol=4.0 / np.sqrt(240))


def test_causes_are_differences_of_runs(frames):
    share = np.sqrt(1.0 - 1.0 / STARS)
    after = SimpleNamespace(method={"cog": model(ERROR_PX, ERROR_PX)})
    found = dict(zip(CAUSE_NAMES, tabulate_causes(frames, after, ["cog"]), strict=True))
    scale, limit = 3.0 * PIXEL_ARCSEC, 5.0 / np.sqrt(POSITIONS * STARS)
    np.testing.assert_allclose(found["prnu"].alone_arcsec[0], scale * 2**0.5 * share * ERROR_PX, rtol=limit)
    np.testing.assert_allclose(found["prnu"].single_position_alone_arcsec[0], scale * ERROR_PX, rtol=limit)
    np.testing.assert_allclose(found["prnu"].switched_off_arcsec[0], scale * 2**0.5 * share * ERROR_PX, rtol=limit)
    np.testing.assert_allclose(found["s_curve"].single_position_alone_arcsec[0], scale * 0.01, rtol=limit)
    assert not found["pattern"].alone_arcsec.any()
    of_frames = scale * np.sqrt(2.0 / FRAMES) * NOISE_PX * share
    np.testing.assert_allclose(found["temporal"].alone_arcsec[0], of_frames, rtol=1e-9)
    for number, cause in enumerate(CAUSES, 1):
        np.testing.assert_allclose(found[cause].predicted_arcsec[0], scale * number * ERROR_PX)
    square = sum((found[one].alone_arcsec[0] ** 2 for one in CAUSES), of_frames**2 + scale**2 * frames.motion_px**2)
    np.testing.assert_allclose(scale * frames.quadrature_px("cog"), np.sqrt(square))


@pytest.mark.parametrize("sigma", [0.25, 0.4])
def test_s_curve_of_an_undersampled_star_is_that_of_its_pixel_sums(star_camera, bench_of, sigma):
    """Oracle: centre of gravity of a Gaussian integrated over the pixels, sum by sum."""

    def pixels(index, place):
        low, high = (index - place + side for side in (-0.5, 0.5))
        return 0.5 * (erf(high / sigma / 2**0.5) - erf(low / sigma / 2**0.5))

    cells = np.arange(-64, 65) / 8
    psf = EffectivePsf(values=np.outer(pixels(cells, 0.0), pixels(cells, 0.0)), oversampling=8)
    found = compute_s_curves(bench_of(methods=("cog", "epsf"), signal_e=50000.0), star_camera, psf)
    index = np.arange(-6, 7)
    expected = [index @ pixels(index, at) / pixels(index, at).sum() - at for at in found.phase_px]
    np.testing.assert_allclose(found.s_curve_px[0], expected, atol=2e-3)
    np.testing.assert_allclose(found.s_curve_px[1], 0.0, atol=1e-3)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(found.phase_px[[0, 50, 100]], [-0.5, 0.0, 0.5])
