"""Files of a folder: frames, notes on the others; a real camera from a public set."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from experiments.harness.progress import Progress
from experiments.twin.folder import night_frames, pointing_of
from experiments.twin.pipeline import measure_night
from experiments.twin.settings import TwinConfig

REAL = Path(__file__).parents[3].parent / "shared" / "real"
NAME = "2019-07-29T204726_Alt40_Azi-135_Try1.tiff"


def save(path, image):
    Image.fromarray(image.astype(np.uint16)).save(path)


def test_pointing_of_a_name():
    assert pointing_of(NAME) == (40.0, -135.0)


LOCAL, EXACT = "2024-05-01_22-10-33_L_60.00s.fits", "2024-05-01T20-10-33Z.fits"


@pytest.mark.parametrize(
    ("name", "cards", "minutes", "note"),
    [
        (LOCAL, {"DATE-OBS": "2024-05-01T20:10:33", "EXPTIME": 120.0}, 1, "file name + half the exposure differs"),
        (LOCAL, {"EXPTIME": 120.0}, 121, "no time zone, read as UTC"),
        (EXACT, {"DATE-OBS": "2024-05-01T22:10:33", "TIMESYS": "LOCAL"}, 0, "TIMESYS = 'LOCAL' differs by +2.00 h"),
        (EXACT, {"DATE-OBS": "2024-05-01T20:10:33"}, 0, ""),
    ],
)  # fmt: skip
def test_a_header_overrules_a_name_and_uncertain_readings_are_noted(tmp_path, name, cards, minutes, note):
    fits.writeto(
        tmp_path / name, np.random.default_rng(1).poisson(100.0, (24, 32)).astype(np.uint16), fits.Header(cards)
    )
    (frame,), notes = night_frames(tmp_path)
    assert frame.taken == datetime(2024, 5, 1, 20, 10, 33, tzinfo=UTC) + timedelta(minutes=minutes)
    assert (note in notes[0] and name in notes[0]) if note else not notes


def test_another_camera_and_dead_links_are_named(tmp_path):
    rng = np.random.default_rng(1)
    for k in range(2):
        save(tmp_path / f"a{k}.tiff", 100 + rng.integers(0, 50, (64, 96)))
    save(tmp_path / "other.tiff", 100 + rng.integers(0, 50, (64, 64)))
    (tmp_path / "gone.png").symlink_to(tmp_path / "nothing.png")
    (tmp_path / "bad.fits").write_bytes(b"no image")
    (tmp_path / "notes.txt").write_text("not a frame")
    frames, notes = night_frames(tmp_path)
    assert [frame.name for frame in frames] == ["a0.tiff", "a1.tiff"]
    words = "\n".join(notes)
    assert "frames of two cameras: other.tiff (64 x 64 px" in words
    assert "gone.png is a link to nothing" in words
    assert "bad.fits" in words
    assert str(tmp_path) + os.sep not in words


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="the frames are not part of the project")
def test_a_real_camera():
    frames, _ = night_frames(REAL)
    config = TwinConfig(camera={"field_deg": 11.4, "pixel_pitch_um": 6.9}, orders=("pinhole", "radial_1"))
    night, _ = measure_night(frames, config, Progress())
    assert len(night.rows) == 8
    assert not [note for note in night.notes if "clouds" in note or "trailed" in note or "focus" in note]
    noise = night.fit.noise
    assert noise.gain_e_per_dn == pytest.approx(2.739, rel=0.03)
    assert night.fit.order == "radial_1"
    assert night.fit.camera.value("focal_length_mm") == pytest.approx(35.30, abs=0.03)
    assert night.zenith is not None
    assert night.zenith.latitude_deg == pytest.approx(52.0, abs=0.2)
    assert night.fit.photometry.extinction_mag == pytest.approx(0.32, abs=0.08)
