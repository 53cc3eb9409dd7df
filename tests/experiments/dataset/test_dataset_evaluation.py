"""A dataset that is looked at, from the command line to its report, against closed forms that share no code with it."""

from __future__ import annotations

import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from astropy.table import Table
from scipy.stats import chi2

from experiments.dataset.settings import main

pytestmark = pytest.mark.slow  # a whole run

FRAMES, SIDE, EXPOSURE_S, SKY_E_PER_S, DARK_FRAMES = 4, 640, 0.2, 2.0, 10
BINS_PER_DECADE = 6


@pytest.fixture(scope="module")
def folder(engine, tmp_path_factory):
    pytest.importorskip("tetra3rs")
    out = tmp_path_factory.mktemp("dataset") / "out"
    settings = {
        "instrument.width_px": SIDE,
        "instrument.height_px": SIDE,
        "instrument.exposure_s": EXPOSURE_S,
        "background.extra_e_per_s": SKY_E_PER_S,
        "catalogue.faintest_mag": 7.5,
        "passband.range_nm": "[460, 890]",
        "verify.dark_frames": DARK_FRAMES,
        "seed": 3,
    }
    options = [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
    assert main(["--frames", str(FRAMES), "--workers", "1", *options, "--out", str(out)], own_process=False) == 0
    return out


@pytest.fixture(scope="module")
def truth(folder):
    """All rows of all frames, and which of them nothing disturbs."""
    found = {
        name: np.concatenate([pq.read_table(file).column(name).to_numpy() for file in sorted(folder.glob("truth/*"))])
        for name in ("frame", "electrons", "variance_x_px2", "variance_y_px2", "snr", "flags")
    }
    return found | {"clean": found["flags"] == 0}


def pixel_variance_e2():
    """Of a dark-subtracted pixel without star, from the chip's data sheet: log-normal read noise, dark charge, sky."""
    from render.detector.spec import load_detector

    chip = load_detector("cmv4000")
    own = chip.read_noise_e**2 * np.exp(2.0 * chip.read_noise_spread**2) + 1.0 / (12.0 * chip.gain_dn_per_e**2)
    own += chip.dark_current_e_per_s * chip.dark_factor(0.0) * EXPOSURE_S
    return own * (1.0 + 1.0 / DARK_FRAMES) + SKY_E_PER_S * EXPOSURE_S, chip.diffusion_sigma_px


def gaussian_bound_px(truth):
    """Bound of clean stars as Gaussian spots: photon noise, noise of the pixels (I. R. King, PASP 95, 163 (1983))."""
    noise_e2, diffusion_px = pixel_variance_e2()
    light, rays = (truth[name][truth["clean"]] for name in ("electrons", "variance_x_px2"))
    rays = (rays + truth["variance_y_px2"][truth["clean"]]) / 2
    spot = rays + diffusion_px**2 + 1.0 / 12.0
    return np.sqrt(spot / light + 8.0 * np.pi * spot**2 * noise_e2 / light**2)


def test_bound_of_centroids_is_that_of_gaussian_spots(folder, truth):
    """The lens is a little out of focus: its spots are near enough to Gaussian for a tenth."""
    snr, bound = truth["snr"][truth["clean"]], gaussian_bound_px(truth)
    number = np.floor(np.log10(snr) * BINS_PER_DECADE)
    table = Table.read(folder / "centroids.ecsv")
    assert len(table) >= 4
    for row in table:
        mine = number == np.floor(np.log10(row["snr"]) * BINS_PER_DECADE)
        assert row["bound_px"] == pytest.approx(np.median(bound[mine]), rel=0.1)
        assert row["stars"] <= mine.sum()
    noise_alone = table[(table["snr"] >= 8.0) & (table["snr"] <= 25.0)]
    spread = np.sqrt(1.3604 / (2 * noise_alone["stars"].sum()))  # of a median absolute deviation, two axes a star
    ratio = np.average(noise_alone["ratio"], weights=noise_alone["stars"])
    assert 1.0 - 3.0 * spread < ratio < 1.0 + 3.0 * spread + 0.1  # never below the bound; a window loses some


def test_boresights_are_as_far_off_as_their_stars_allow(folder, truth):
    """Cross-boresight errors over one divided by the root of the sum of the weights of a frame's clean stars."""
    table, bound = Table.read(folder / "solved_frames.ecsv"), gaussian_bound_px(truth)
    pixel_arcsec = float(re.search(r"([\d.]+) arcsec per pixel", (folder / "README.md").read_text())[1])
    pulls = []
    for row in table:
        mine = truth["frame"][truth["clean"]] == row["frame"]
        sigma = pixel_arcsec / np.sqrt((1.0 / bound[mine] ** 2).sum())
        pulls += [row[f"error_arcsec_{axis}"] / sigma for axis in "xy"]
    low, high = chi2.ppf([0.005, 0.995], len(pulls))
    assert low < np.square(pulls).sum() < high


def test_counts_are_those_of_the_truth(folder, truth):
    """Flag bits as the data card lists them: 2 off the edge, 4 blended, 64 no light."""
    results = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["results"]
    lit = (truth["flags"] & 64) == 0
    assert results["frames"]["stars"]["value"] == lit.sum()
    bright = lit & (truth["snr"] >= 10.0) & ((truth["flags"] & 2) == 0)
    assert results["detection"]["bright_stars"]["value"] == bright.sum()
    flags = {row["flag"]: row["stars"] for row in Table.read(folder / "flags.ecsv")}
    assert flags["blended"] == (lit & ((truth["flags"] & 4) != 0)).sum()
    assert sum(Table.read(folder / "completeness.ecsv")["stars"]) == (lit & ((truth["flags"] & 2) == 0)).sum()
    assert results["frames"]["frames_made"]["value"] == FRAMES == results["attitudes"]["attempted"]["value"]


def test_the_data_card_names_every_column(folder):
    text = (folder / "README.md").read_text(encoding="utf-8")
    for heading, file in (("Truth", "truth/frame_000000.parquet"), ("Index", "index.parquet")):
        part = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
        listed = re.findall(r"^\| `(\w+)` \| (?:str|int32|int64|float64) \|", part, flags=re.MULTILINE)
        assert listed == pq.read_schema(folder / file).names
    with fits.open(folder / "frames" / "frame_000000.fits") as frame:
        assert f"{frame[0].header['NAXIS1']} x {frame[0].header['NAXIS2']} px, 16 bit" in text
    assert "{{" not in text
    assert "{%" not in text
