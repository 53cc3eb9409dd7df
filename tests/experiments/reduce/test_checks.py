"""Frames that are not what their folder says get a verdict; each is drawn here with NumPy alone."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from astropy.io import fits

from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import described
from experiments.harness.sections import judged as judge_sections
from experiments.harness.summary import Measured
from experiments.hsfe.own_frames import exchange_text
from experiments.reduce.checks import check_frames
from experiments.reduce.folder import read_folder
from experiments.reduce.poses import FIT, Fit
from experiments.temporal.own_frames import reduce
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


def judged(folder, frames, *, gain=GAIN, offset=OFFSET, centroid="gaussian", more=""):
    """Criteria by their names, and results, of a folder with one series in one cube."""
    folder.mkdir(parents=True, exist_ok=True)
    fits.PrimaryHDU(np.stack(frames)).writeto(folder / "cube.fits", overwrite=True)
    (folder / "frames.toml").write_text(
        f"gain_dn_per_e = {gain}\noffset_dn = {offset}\nread_noise_e = {READ}\npixel_arcsec = 5.5\npoints = 9\n{more}"
        '[[series]]\nfiles = "cube.fits"\nname = "still"\n'
    )
    config = Config(own_frames=str(folder), centroid=centroid, compare=())
    own = experiment.instead(config)
    outcome = own.outcome(config, own.run(config, progress=Progress()))
    return {one.name: one for one in own.judge(outcome)}, own.results(outcome)


def failed(criteria):
    return {name: one.advice for name, one in criteria.items() if one.failed}


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
    assert any("the image (x) drifts by +0." in one for one in said.values()), said
    assert results["moved_px"] == pytest.approx(0.3, abs=0.03)  # 30 frames of 9 points of some 0.02 px
    assert not any(name.startswith("gain by") for name in said)
    assert results["gain_dn_per_e"]["photon_transfer"].value == pytest.approx(GAIN, rel=0.1)


def test_a_jump_of_a_twentieth_of_a_pixel_is_named_with_its_frame(tmp_path, rng):
    """After frame 12 for good, and of frame 20 alone; 30 frames of 9 points of some 0.02 px each."""
    step = [readout(expected((0.05 * (n >= 12), 0.0)), rng) for n in range(FRAMES)]
    criteria, results = judged(tmp_path / "a", step)
    said = failed(criteria)["jump or drift of the image within a series, the most significant"]
    assert "the image (x) jumps by +0.0" in said
    assert "between cube.fits[11] and cube.fits[12] (still)" in said
    assert results["moved_px"] == pytest.approx(0.05, abs=0.012)
    single = [readout(expected((0.0, -0.08 * (n == 20))), rng) for n in range(FRAMES)]
    criteria, results = judged(tmp_path / "b", single)
    assert any("in cube.fits[20] alone" in one for one in failed(criteria).values()), failed(criteria)
    assert results["moved_px"] == pytest.approx(-0.08, abs=0.03)


def test_a_frame_behind_another_filter_or_exposed_otherwise_is_named(tmp_path, rng):
    frames = [readout(expected(signal=8000.0 * (0.85 if n == 7 else 1.0)), rng) for n in range(FRAMES)]
    criteria, results = judged(tmp_path / "a", frames)
    (said,) = failed(criteria).values()
    assert "in cube.fits[7] alone" in said
    assert results["light_change"] == pytest.approx(-0.15, abs=0.02)


def test_noise_that_frames_share_is_named(tmp_path, rng):
    """A frame that is another one with new read-out noise; a camera that averages over two frames."""
    frames = [readout(expected(), rng) for _ in range(FRAMES)]
    frames[9] = np.rint(frames[4] + 0.3 * GAIN * READ * rng.standard_normal(frames[4].shape)).astype(np.uint16)
    criteria, results = judged(tmp_path / "a", frames)
    assert "the noise of cube.fits[4] and cube.fits[9] (still) is 9" in failed(criteria)["common noise of two frames"]
    assert results["shared_noise"] > 0.9
    raw = [readout(expected(), rng).astype(float) for _ in range(FRAMES + 1)]
    mixed = [np.rint((a + b) / 2).astype(np.uint16) for a, b in pairwise(raw)]
    criteria, _ = judged(tmp_path / "b", mixed)
    assert "the camera averages over frames" in failed(criteria)["common noise of two frames"]


def test_frames_that_are_correlated_are_named_and_widen_errors(tmp_path, rng):
    """A wander of 0.03 px, correlated by 0.85 from frame to frame: no jump, no drift."""
    at, wander = 0.0, []
    for _ in range(60):
        at = 0.85 * at + 0.03 * np.sqrt(1 - 0.85**2) * rng.standard_normal()
        wander.append(readout(expected((at, 0.0)), rng))
    criteria, results = judged(tmp_path / "a", wander)
    said = failed(criteria)["correlation of frames with the next one, the most significant"]
    assert "x of all points, correlation +0." in said
    assert results["series"][0]["effective_frames"] < 30


def test_a_gain_ten_per_cent_off_is_named_by_flats(tmp_path, rng):
    """Four flats of 20 000 e- whose lamp flickers by 1 %, and four dark frames."""
    flats = [readout(np.full((SIZE, SIZE), 20000.0 * (1 + 0.01 * rng.standard_normal())), rng) for _ in range(4)]
    darks = [readout(np.zeros((SIZE, SIZE)), rng) for _ in range(4)]
    (tmp_path / "a").mkdir()
    for name, some in (("flat", flats), ("dark", darks)):
        fits.PrimaryHDU(np.stack(some)).writeto(tmp_path / "a" / f"{name}.fits")
    frames = [readout(expected(), rng) for _ in range(FRAMES)]
    more = "flat = 'flat.fits'\ndark = 'dark.fits'\n"
    criteria, results = judged(tmp_path / "a", frames, more=more)
    found = results["gain_dn_per_e"]["photon_transfer"]
    assert found.value == pytest.approx(GAIN, abs=4 * found.uncertainty)
    assert found.uncertainty < 0.02 * GAIN
    said = failed(criteria)
    assert not any(name.startswith("gain by") for name in said)
    # pixels respond alike: all that the flat shows is the noise of four flats and four dark frames
    flat = said["noise of the mean flat over its pixel-to-pixel pattern"]
    alone = 100.0 * np.sqrt((20000.0 + 2.0 * READ**2) / 4.0) / 20000.0
    assert [float(one) for one in re.findall(r"([\d.]+)%", flat)] == pytest.approx([alone] * 2, rel=0.04)
    criteria, _ = judged(tmp_path / "a", frames, gain=1.1 * GAIN, more=more)
    assert any(name.startswith("gain by") for name in failed(criteria)), failed(criteria)


def test_two_frames_are_not_judged_and_a_fifth_more_scatter_is_not_let_pass(tmp_path, rng):
    criteria, results = judged(tmp_path / "a", [readout(expected(), rng) for _ in range(2)])
    noise = next(one for name, one in criteria.items() if name.startswith("centroid scatter"))
    assert noise.passed is None
    assert "Only 2 frames in still, fewer than 30" in results["few_frames"]
    interval = results["interval_arcsec_3sigma"][0]["gaussian"]["x"]
    low, high, value = *interval.values(), results["temporal_error_arcsec_3sigma"][0]["gaussian"]["x"].value
    assert low < value < high
    assert high > 1.5 * low
    shaken = [readout(expected(0.021 * 0.68 * rng.standard_normal(2)), rng) for _ in range(FRAMES)]  # sqrt(1.21^2 - 1)
    criteria, results = judged(tmp_path / "b", shaken)
    assert failed(criteria)


def test_files_out_of_order_are_named(tmp_path, rng):
    (tmp_path / "a").mkdir()
    for number, second in enumerate((1, 2, 4, 3, 5, 6)):
        header = fits.Header({"DATE-OBS": f"2026-05-04T10:00:{second:02d}"})
        fits.PrimaryHDU(readout(expected(), rng), header).writeto(tmp_path / "a" / f"f{number}.fits")
    head = f"gain_dn_per_e = {GAIN}\noffset_dn = {OFFSET}\nread_noise_e = {READ}\npixel_arcsec = 5.5\npoints = 9\n"
    (tmp_path / "a" / "frames.toml").write_text(f"{head}[[series]]\nfiles = 'f*.fits'\n")
    read = read_folder(tmp_path / "a", window_px=13)
    checks = check_frames(read, reduce(read, ("gaussian",))[0], "gaussian")
    assert checks.disorder == ["f3.fits after f2.fits"]
    assert checks.copies == 0


def test_copies_are_named(tmp_path, rng):
    one = readout(expected(), rng)
    criteria, _ = judged(tmp_path / "a", [one] * FRAMES)
    said = failed(criteria)
    assert any("29 of 30 frames are copies (cube.fits[1] = cube.fits[0], " in words for words in said.values()), said
    some = [readout(expected(), rng) for _ in range(FRAMES - 1)]
    criteria, _ = judged(tmp_path / "b", [*some, some[3]])
    assert list(failed(criteria)) == ["frames identical to another frame"]


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


def test_noise_beside_that_of_the_model_is_named(tmp_path, rng):
    """Read noise of 23 e- where 12 are stated, the gain right; then means of four frames, as cameras store them."""
    loud = [np.rint(readout(expected(), rng) + 20.0 * GAIN * rng.standard_normal((SIZE, SIZE))) for _ in range(FRAMES)]
    criteria, _ = judged(tmp_path / "loud", np.array(loud, np.uint16))
    assert all("points scatter more than by photon" in one for one in failed(criteria).values()), failed(criteria)
    assert failed(criteria)
    frames = [
        np.rint(np.mean([readout(expected(), rng) for _ in range(4)], axis=0)).astype(np.uint16) for _ in range(FRAMES)
    ]
    criteria, _ = judged(tmp_path / "a", frames)
    assert any("frames were averaged" in one for one in failed(criteria).values())


def test_positions_in_the_wrong_order_are_named():
    commanded = 0.2 * np.outer(np.arange(12), [0.7, 0.7])
    said = exchange_text((3, 8), commanded, [f"step{n}" for n in range(12)])
    assert said == "step3 and step8 are interchanged: each lies at the commanded position of the other, 0.99 px away"


@pytest.mark.parametrize(("ratio", "said"), [(0.5, "smaller than stated"), (1.0, ""), (1.5, "larger than stated")])
def test_a_calibration_by_poses_is_judged_both_ways(ratio, said):
    fit = Fit(misfit="m", flat=True, fit_ratio=Measured(value=ratio, uncertainty=0.07), coverage=1.0)
    data = described({"fit": FIT}, Quantities(), {"fit": fit}).dataset
    criterion = judge_sections({"fit": FIT}, Outcome(config=None, result={"fit": fit}, data=data))[0]
    assert criterion.failed is bool(said)
    assert not said or said in criterion.advice
