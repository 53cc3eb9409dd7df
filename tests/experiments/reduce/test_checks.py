"""Frames that are not what their folder says get a verdict; each is drawn here with NumPy alone."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.io import fits

from experiments.harness.progress import Progress
from experiments.reduce.checks import photon_transfer
from experiments.temporal.settings import Config, experiment

GAIN, OFFSET, READ = 0.25, 60.0, 12.0
PLACES = np.array([(25.0 + 22.3 * i, 25.0 + 22.2 * j) for j in range(3) for i in range(3)])
SIZE, FRAMES, SIGMA = 92, 30, 1.1


def expected(shift=(0.0, 0.0), signal=8000.0):
    """Light [e-] of Gaussian spots sampled on the pixels."""
    row, column = np.indices((SIZE, SIZE))
    light = np.zeros((SIZE, SIZE))
    for x, y in PLACES + shift:
        light += signal / (2 * np.pi * SIGMA**2) * np.exp(-((column - x) ** 2 + (row - y) ** 2) / (2 * SIGMA**2))
    return light


def readout(light, rng, *, top=65535, step=1):
    electrons = rng.poisson(light) + rng.normal(0.0, READ, light.shape)
    return (np.rint((OFFSET + GAIN * electrons) / step) * step).clip(0, top).astype(np.uint16)


def judged(folder, frames, *, gain=GAIN, offset=OFFSET, centroid="gaussian"):
    """Criteria by their names, and results, of a folder with one series in one cube."""
    folder.mkdir(parents=True, exist_ok=True)
    fits.PrimaryHDU(np.stack(frames)).writeto(folder / "cube.fits", overwrite=True)
    (folder / "frames.toml").write_text(
        f"gain_dn_per_e = {gain}\noffset_dn = {offset}\nread_noise_e = {READ}\npixel_arcsec = 5.5\npoints = 9\n"
        '[[series]]\nfiles = "cube.fits"\nname = "still"\n'
    )
    config = Config(own_frames=str(folder), centroid=centroid, compare=())
    own = experiment.instead(config)
    outcome = own.outcome(config, own.run(config, progress=Progress()))
    return {one.name: one for one in own.judge(outcome)}, own.results(outcome)


def failed(criteria):
    return {name: one.advice for name, one in criteria.items() if not one.passed}


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def test_good_frames_hold_every_criterion(tmp_path, rng):
    criteria, results = judged(tmp_path / "a", [readout(expected(), rng) for _ in range(FRAMES)])
    assert not failed(criteria)
    assert len(criteria) >= 8
    found = results["gain_dn_per_e"]["photon_transfer"]
    assert found.value == pytest.approx(GAIN, abs=4 * found.uncertainty)
    assert found.uncertainty < 0.05 * GAIN


def test_what_missing_flats_mean_is_said(tmp_path, rng):
    """Of a Gaussian spot a response of 1 % moves the centre of gravity by 1 % / sqrt(8 pi), of any width."""
    _, results = judged(tmp_path / "a", [readout(expected(), rng) for _ in range(5)], centroid="cog")
    alone = results["without_flat"]
    assert alone["one_percent_moves_px"] == pytest.approx(0.01 / np.sqrt(8 * np.pi), rel=0.05)
    assert 0.02 < alone["over_noise_of_mean"] < 0.5


def test_a_gain_in_electrons_per_dn_is_named(tmp_path, rng):
    frames = [readout(expected(), rng) for _ in range(FRAMES)]
    criteria, results = judged(tmp_path / "a", frames, gain=1.0 / GAIN)
    said = failed(criteria)
    assert any("the reciprocal: it was given in e⁻/DN" in one for one in said.values()), said
    assert results["gain_dn_per_e"]["photon_transfer"].value == pytest.approx(GAIN, rel=0.1)


def test_a_target_that_moves_is_named(tmp_path, rng):
    """By 2 px at random, and by 0.3 px as a drift, which photon transfer does not take for noise."""
    moving = [readout(expected(rng.uniform(-1.0, 1.0, 2)), rng) for _ in range(FRAMES)]
    criteria, _ = judged(tmp_path / "a", moving)
    assert any("from frame to frame, all points alike" in one for one in failed(criteria).values())
    drifting = [readout(expected((0.3 * n / (FRAMES - 1), 0.0)), rng) for n in range(FRAMES)]
    criteria, results = judged(tmp_path / "b", drifting)
    said = failed(criteria)
    assert any("the image drifts by" in one for one in said.values()), said
    assert results["drift_px"] == pytest.approx(0.3, abs=0.03)  # 30 frames of 9 points of some 0.02 px
    assert not any(name.startswith("gain by") for name in said)
    assert results["gain_dn_per_e"]["photon_transfer"].value == pytest.approx(GAIN, rel=0.1)


def test_copies_are_named(tmp_path, rng):
    one = readout(expected(), rng)
    criteria, _ = judged(tmp_path / "a", [one] * FRAMES)
    said = failed(criteria)
    assert any("29 of 30 frames are copies" in words for words in said.values()), said
    some = [readout(expected(), rng) for _ in range(FRAMES - 1)]
    criteria, _ = judged(tmp_path / "b", [*some, some[3]])
    assert list(failed(criteria)) == ["frames that repeat another frame of their series, pixel by pixel"]


def test_ends_of_the_converter_are_named(tmp_path, rng):
    """Clipped at 300 DN without saturation_dn; twelve bits stored in sixteen; an offset below the noise."""
    clipped = [readout(expected(), rng, top=200) for _ in range(FRAMES)]
    criteria, _ = judged(tmp_path / "a", clipped)
    assert any("state saturation_dn = 200" in one for one in failed(criteria).values()), failed(criteria)
    shifted = [16 * readout(expected(), rng) for _ in range(FRAMES)]
    criteria, _ = judged(tmp_path / "b", shifted, gain=16 * GAIN, offset=16 * OFFSET)
    assert criteria["common step of all readings"].value == 16
    assert not criteria["common step of all readings"].passed
    low = [(readout(expected(), rng).astype(int) - int(OFFSET)).clip(0).astype(np.uint16) for _ in range(FRAMES)]
    criteria, _ = judged(tmp_path / "c", low, offset=0.0)
    assert not criteria["share of readings of 0 DN"].passed


def test_too_little_noise_is_named(tmp_path, rng):
    """Means of four frames each, as some cameras store them."""
    frames = [
        np.rint(np.mean([readout(expected(), rng) for _ in range(4)], axis=0)).astype(np.uint16) for _ in range(FRAMES)
    ]
    criteria, _ = judged(tmp_path / "a", frames)
    assert any("frames were averaged" in one for one in failed(criteria).values())


def test_photon_transfer_states_its_own_error():
    """Forty cameras whose offsets (12 e-) and read noise (30 %) differ from pixel to pixel, images that wander: pulls.

    Offsets and spots of 1000 e- in the brightest pixel as of the CMV4000.
    """
    rng, pulls = np.random.default_rng(2), []
    row, column = np.indices((13, 13)) - 6.0
    for _ in range(40):
        shape, offset, read = (
            (25, 9, 13, 13),
            rng.normal(0.0, 12.0, (9, 13, 13)),
            READ * rng.lognormal(0, 0.3, (9, 13, 13)),
        )
        at = rng.normal(0.0, 0.03, (25, 1, 1, 1, 2))
        spot = np.exp(-((column - at[..., 0]) ** 2 + (row - at[..., 1]) ** 2) / (2 * SIGMA**2))
        light = np.broadcast_to(1000.0 * rng.uniform(0.95, 1.05, (25, 1, 1, 1)) * spot, shape)
        electrons = rng.poisson(light) + offset + read * rng.standard_normal(shape)
        dn = np.rint(200.0 + GAIN * electrons).clip(0, 65535).astype(np.uint16)
        found = photon_transfer([dn], [np.ones(shape[1:], bool)])
        pulls.append((found.value - GAIN) / found.uncertainty)
        assert found.uncertainty < 0.1 * GAIN
    assert np.mean(pulls) == pytest.approx(0.0, abs=4 / np.sqrt(40))
    assert np.std(pulls) == pytest.approx(1.0, abs=4 / np.sqrt(80))
