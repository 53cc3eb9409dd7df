"""Calibration products of a dataset against the detector's own maps; headers by the rules of fitsverify."""

from __future__ import annotations

import shutil
import subprocess
from datetime import datetime

import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time

from experiments.dataset.calibration import write_calibration
from experiments.dataset.job import Job, make_frame
from experiments.dataset.scene import build_scene
from experiments.dataset.settings import DatasetConfig, ScanPointing, VerifyConfig
from render.detector.maps import sensor_maps
from render.engine import Engine
from render.sensor_file.tables import InstrumentConfig

FRAMES = 20
CONFIG = DatasetConfig(
    instrument=InstrumentConfig(
        lens="star_tracker_26mm",
        detector="cmv4000",
        exposure_s=0.5,
        diffraction="rays",
        width_px=160,
        height_px=128,
        chip_temperature_c=40.0,
    ),
    nodes=2,
    pointing=ScanPointing(ra_deg=56.75, dec_deg=24.12, rate_deg_per_s=(0.0, 0.0, 0.0), frame_rate_hz=0.5),
    verify=VerifyConfig(frames=0),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    Engine.start("llvm")
    made = tmp_path_factory.mktemp("calibration")
    for name in ("frames", "truth"):
        (made / name).mkdir()
    for frame in (0, 3):
        make_frame(Job(config=CONFIG.model_dump_json(), folder=str(made), backend="llvm"), frame)
    return made


@pytest.fixture(scope="module")
def calibrated(folder):
    write_calibration(build_scene(CONFIG), folder, FRAMES, lambda: None)
    return folder


def product(folder, name):
    with fits.open(folder / "calibration" / f"{name}.fits", checksum=True) as content:
        assert content[0]._checksum_valid
        assert content[0].header["NCOMBINE"] == FRAMES
        return content[0].data.astype(float), content["ERR"].data.astype(float)


def pull(image, error, truth):
    """Mean square of (image - truth) over its error, which has Student's spread: (n - 1) / (n - 3)."""
    some = error > 0
    return np.mean(((image - truth)[some] / error[some]) ** 2) * (FRAMES - 3) / (FRAMES - 1)


@pytest.mark.slow
def test_products_are_the_detector_within_their_own_noise(calibrated):
    chip = build_scene(CONFIG).instrument.detector
    maps = sensor_maps(chip)
    sound = ~maps.defect
    bias, bias_error = product(calibrated, "bias")
    dark, dark_error = product(calibrated, "dark")
    flat, flat_error = product(calibrated, "flat")
    gain, gain_error = product(calibrated, "gain_map")
    spread = 4.0 * np.sqrt(2.0 / sound.sum()) + 0.1  # fat tails of 20 frames; rounding of the numbers
    assert pull(bias[sound], bias_error[sound], maps.offset_dn[sound]) == pytest.approx(1.0, abs=spread)
    charge = maps.dark_current_e_per_s * chip.dark_factor(40.0) * 0.5
    expected = maps.offset_dn + chip.gain_dn_per_e * charge
    assert pull(dark[sound], dark_error[sound], expected[sound]) == pytest.approx(1.0, abs=spread)
    response = maps.response / np.median(maps.response)
    assert pull(flat[sound], flat_error[sound], response[sound]) == pytest.approx(1.0, abs=spread)
    # a block that holds hot pixels still has the gain of the chip; the response of a pixel is no part of it
    # at half the full well the curve K x (1 - 0.01 x / full well) has slope 0.99 K and mean 0.995 K x
    seen = 0.3 * 0.99**2 / 0.995
    assert np.median(gain) == pytest.approx(seen, abs=4.0 * np.median(gain_error) / np.sqrt(20))
    assert np.median(gain_error) < 0.02 * chip.gain_dn_per_e
    defect = fits.getdata(calibrated / "calibration" / "defect_map.fits")
    np.testing.assert_array_equal(defect.astype(bool), maps.defect)


@pytest.mark.slow
def test_the_same_bytes_again(calibrated, tmp_path):
    write_calibration(build_scene(CONFIG), tmp_path, FRAMES, lambda: None)
    for file in (calibrated / "calibration").iterdir():
        assert (tmp_path / "calibration" / file.name).read_bytes() == file.read_bytes(), file.name


def test_headers_tell_who_when_and_with_what(folder):
    """Keywords of the FITS standard and of FITS camera programs; world coordinates in the order of the standard."""
    first, later = (fits.getheader(folder / "frames" / f"frame_{k:06d}.fits") for k in (0, 3))
    assert (first["LENS"], first["DETECTOR"], first["CCD-TEMP"]) == ("star_tracker_26mm", "CMV4000", 40.0)
    assert first["XPIXSZ"] == 5.5
    assert first["FOCALLEN"] == pytest.approx(25.6, abs=0.05)
    assert first["SATURATE"] == 4049  # 0.3 DN/e- times 13 500 e-, 1 % less by its curve, and the offset of 40 DN
    assert first["CREATOR"].startswith("starbench")
    start = Time(CONFIG.catalogue.epoch_year, format="jyear", scale="tdb")
    assert Time(first["DATE-OBS"], scale="tdb").mjd == pytest.approx(start.mjd, abs=1e-8)
    assert first["MJD-OBS"] == pytest.approx(start.mjd, abs=1e-9)
    gone = datetime.fromisoformat(later["DATE-OBS"]) - datetime.fromisoformat(first["DATE-OBS"])
    assert gone.total_seconds() == pytest.approx(6.0, abs=1e-3)  # three frames at 0.5 Hz
    names = list(first)
    of_wcs = [
        k for k, name in enumerate(names) if name.startswith(("CRVAL", "CRPIX", "CTYPE", "CD1_", "CD2_", "CUNIT"))
    ]
    assert names.index("WCSAXES") < min(of_wcs)
    assert all(card.is_blank or len(card.image) % 80 == 0 for card in first.cards)


@pytest.mark.reference
def test_fitsverify(calibrated):
    """HEASARC's own judge, where it is installed (Debian: fitsverify)."""
    if shutil.which("fitsverify") is None:
        pytest.skip("fitsverify is not installed")
    files = [*(calibrated / "frames").glob("*.fits"), *(calibrated / "calibration").glob("*.fits")]
    assert len(files) == 7
    for file in files:
        done = subprocess.run(["fitsverify", str(file)], capture_output=True, text=True, check=False)
        assert "found 0 warning(s) and 0 error(s)" in done.stdout, done.stdout
