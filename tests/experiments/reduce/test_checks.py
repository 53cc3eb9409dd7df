"""Frames that are not what their folder says get a verdict; each is drawn here with NumPy alone."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from astropy.io import fits
from target_frames import GAIN, HEAD, OFFSET, READ, readout, spots, write

from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import described
from experiments.harness.sections import judged as judge_sections
from experiments.harness.summary import Measured
from experiments.hsfe.own_frames import exchange_text
from experiments.reduce.checks import check_frames
from experiments.reduce.folder import read_folder
from experiments.reduce.poses import FIT, PoseFit
from experiments.temporal.own_frames import reduce
from experiments.temporal.settings import TemporalConfig, experiment

PLACES = np.array([(25.0 + 22.3 * i, 25.0 + 22.2 * j) for j in range(3) for i in range(3)])
SIZE, FRAMES, SIGMA = 92, 30, 1.1


def expected(shift=(0.0, 0.0), signal=8000.0):
    return spots((SIZE, SIZE), PLACES + shift, signal, SIGMA)


def judged(folder, frames, *, gain=GAIN, offset=OFFSET, centroid="gaussian", more=""):
    """Criteria by their names, and results, of a folder with one series in one cube."""
    folder.mkdir(parents=True, exist_ok=True)
    fits.PrimaryHDU(np.stack(frames)).writeto(folder / "cube.fits", overwrite=True)
    (folder / "frames.toml").write_text(
        f"gain_dn_per_e = {gain}\noffset_dn = {offset}\nread_noise_e = {READ}\npixel_arcsec = 5.5\npoints = 9\n{more}"
        '[[series]]\nfiles = "cube.fits"\nname = "still"\n'
    )
    config = TemporalConfig(own_frames=str(folder), centroid=centroid, compare=())
    own = experiment.instead(config)
    outcome = own.outcome(config, own.run(config, progress=Progress()))
    return {one.name: one for one in own.judge(outcome)}, outcome


def failed(criteria):
    return {name: one.advice for name, one in criteria.items() if one.failed}


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def still(rng, count=FRAMES, **options):
    return [readout(expected(), rng, **options) for _ in range(count)]


def at(rng, shifts):
    return [readout(expected((shift, 0.0)), rng) for shift in shifts]


def derived(rng):
    frames = still(rng)
    frames[9] = np.rint(frames[4] + 0.3 * GAIN * READ * rng.standard_normal(frames[4].shape)).astype(np.uint16)
    return frames


def averaged(rng, frames):
    return [np.rint(np.mean(still(rng, frames), axis=0)).astype(np.uint16) for _ in range(FRAMES)]


def running_mean(rng):
    return [np.rint((a.astype(float) + b) / 2).astype(np.uint16) for a, b in pairwise(still(rng, FRAMES + 1))]


def wander(rng):
    """0.03 px, correlated by 0.85 from frame to frame: no jump, no drift."""
    track = rng.standard_normal(60)
    for k in range(1, 60):
        track[k] = 0.85 * track[k - 1] + np.sqrt(1.0 - 0.85**2) * track[k]
    return at(rng, 0.03 * track)


def loud(rng):
    noise = 20.0 * GAIN * rng.standard_normal((FRAMES, SIZE, SIZE))
    return list(np.rint(np.array(still(rng)) + noise).astype(np.uint16))


FAULTS = {
    "gain in e-/DN": (still, {"gain": 1.0 / GAIN}, "the reciprocal: it was given in e⁻/DN"),
    "moves": (lambda rng: at(rng, rng.uniform(-1.0, 1.0, FRAMES)), {}, "from frame to frame, all points alike"),
    "drifts": (lambda rng: at(rng, np.linspace(0.0, 0.3, FRAMES)), {}, "the image (x) drifts by +0."),
    "jumps": (lambda rng: at(rng, 0.05 * (np.arange(FRAMES) >= 12)), {}, "between cube.fits[11] and cube.fits[12]"),
    "a frame is off": (lambda rng: at(rng, -0.08 * (np.arange(FRAMES) == 20)), {}, "in cube.fits[20] alone"),
    "a filter": (
        lambda rng: [readout(expected(signal=8000.0 * (0.85 if n == 7 else 1.0)), rng) for n in range(FRAMES)],
        {},
        "the light is off by -1",
    ),
    "derived": (derived, {}, "the noise of cube.fits[4] and cube.fits[9] (still) is 9"),
    "running mean": (running_mean, {}, "the camera averages over frames"),
    "correlated": (wander, {}, "x of all points, correlation +0."),
    "copies": (lambda rng: still(rng, 1) * 30, {}, "29 of 30 frames are copies (cube.fits[1] = cube.fits[0], "),
    "clipped": (lambda rng: still(rng, top=200), {}, "state saturation_dn = 200"),
    "shifted bits": (
        lambda rng: [16 * dn for dn in still(rng)],
        {"gain": 16 * GAIN, "offset": 16 * OFFSET},
        "all readings are 16 DN apart",
    ),
    "no offset": (
        lambda rng: [(dn.astype(int) - int(OFFSET)).clip(0).astype(np.uint16) for dn in still(rng)],
        {"offset": 0.0},
        "noise is clipped at zero",
    ),
    "read noise": (loud, {}, "points scatter more than by photon"),
    "averaged": (lambda rng: averaged(rng, 4), {}, "frames were averaged"),
    "shaken by a fifth more": (
        lambda rng: [readout(expected(0.021 * 0.68 * rng.standard_normal(2)), rng) for _ in range(FRAMES)],
        {},
        "",
    ),
}


@pytest.mark.parametrize(("frames", "options", "words"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_named(frames, options, words, tmp_path, rng):
    criteria, _ = judged(tmp_path, frames(rng), **options)
    assert any(words in advice for advice in failed(criteria).values()), failed(criteria)


def test_good_frames_hold_every_criterion(tmp_path):
    """With the centre of gravity, whose shift by a PRNU of 1 % of a Gaussian spot is 1 % / sqrt(8 pi), of any width."""
    criteria, results = judged(tmp_path, still(np.random.default_rng(12)), centroid="cog")
    assert not failed(criteria)
    assert len(criteria) >= 8
    gain = results.value("transfer_gain")
    assert gain.value == pytest.approx(GAIN, abs=4 * gain.uncertainty)
    assert gain.uncertainty < 0.05 * GAIN
    assert results.value("percent_px") == pytest.approx(0.01 / np.sqrt(8 * np.pi), rel=0.05)
    assert results.values("effective_frames")[0] == FRAMES


def test_a_gain_ten_per_cent_off_is_named_by_flats(tmp_path, rng):
    """Four flats of 20 000 e- whose lamp flickers by 1 %, and four dark frames."""
    flats = [readout(np.full((SIZE, SIZE), 20000.0 * (1 + 0.01 * rng.standard_normal())), rng) for _ in range(4)]
    darks = [readout(np.zeros((SIZE, SIZE)), rng) for _ in range(4)]
    (tmp_path / "a").mkdir()
    for name, frames in (("flat", flats), ("dark", darks)):
        write(tmp_path / "a" / f"{name}.fits", np.stack(frames))
    frames = [readout(expected(), rng) for _ in range(FRAMES)]
    more = "flat = 'flat.fits'\ndark = 'dark.fits'\n"
    criteria, results = judged(tmp_path / "a", frames, more=more)
    found = results.value("transfer_gain")
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


def test_two_frames_are_not_judged(tmp_path, rng):
    criteria, results = judged(tmp_path / "a", still(rng, 2))
    noise = next(one for name, one in criteria.items() if name.startswith("centroid scatter"))
    assert noise.passed is None
    assert "Only 2 frames in still, fewer than 30" in results.value("few_text")
    low, high, value = (results.values(name)[0, 0, 0] for name in ("low_arcsec", "high_arcsec", "measured_arcsec"))
    assert low < value < high
    assert high > 1.5 * low


def test_files_out_of_order_are_named(tmp_path, rng):
    (tmp_path / "a").mkdir()
    for number, second in enumerate((1, 2, 4, 3, 5, 6)):
        cards = {"DATE-OBS": f"2026-05-04T10:00:{second:02d}"}
        write(tmp_path / "a" / f"f{number}.fits", readout(expected(), rng), **cards)
    (tmp_path / "a" / "frames.toml").write_text(f"{HEAD}points = 9\n[[series]]\nfiles = 'f*.fits'\n")
    read = read_folder(tmp_path / "a", window_px=13)
    checks = check_frames(read, reduce(read, ("gaussian",))[0], "gaussian")
    assert checks.disorder == ["f3.fits after f2.fits"]
    assert checks.copies == 0


def test_positions_in_the_wrong_order_are_named():
    commanded = 0.2 * np.outer(np.arange(12), [0.7, 0.7])
    said = exchange_text((3, 8), commanded, [f"step{n}" for n in range(12)])
    assert said == "step3 and step8 are interchanged: each lies at the commanded position of the other, 0.99 px away"


@pytest.mark.parametrize(("ratio", "said"), [(0.5, "smaller than stated"), (1.0, ""), (1.5, "larger than stated")])
def test_a_calibration_by_poses_is_judged_both_ways(ratio, said):
    measured = Measured(value=ratio, uncertainty=0.07)
    fit = PoseFit(misfit="m", flat=True, fit_ratio=measured, coverage=1.0, chi2_rise=ratio + 0.2)
    data = described({"fit": FIT}, Quantities(), {"fit": fit}).dataset
    criterion, _, first_order = judge_sections({"fit": FIT}, Outcome(config=None, result={"fit": fit}, data=data))
    assert criterion.failed is bool(said)
    assert first_order.failed is (ratio > 1.0)
    assert not said or said in criterion.advice
