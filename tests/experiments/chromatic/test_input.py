"""Whatever a user can get wrong in the chromatic test: one clear line, exit code 2, nothing written."""

import re
from pathlib import Path

import pytest

from experiments.chromatic.settings import main

ROOT = Path(__file__).parents[3]
LENS = ROOT / "optics" / "data" / "lenses" / "star_camera_206mm.toml"


@pytest.fixture
def refused(refused_by):
    """Runs the command; gives the one line it says."""

    def run(*arguments, within_s=5.0):
        return refused_by("chromatic", "--quick", *arguments, within_s=within_s)

    return run


SETTINGS = [
    # key and value, what the line has to say
    ("instrument.lens=star_camera_206", "unknown lens 'star_camera_206'; did you mean star_camera_206mm"),
    ("instrument.detector=absent.toml", "absent.toml: no such file"),
    ("decentre.element=L9", "unknown element 'L9'; did you mean L"),
    ("decentre.pair=800-500", "unknown decentre.pair '800-500'; did you mean 800-600"),
    ('compare=["cogg"]', "compare.0 = 'cogg': .*did you mean cog"),
    ("filters.centres_nm=[350,600,800]", "'350 nm' passes 295 ... 405 nm; .* 400 ... 1000 nm"),
    ("filters.centres_nm=[0,600,800]", "reaches below 0 nm"),
    ("filters.centres_nm=[600]", "at least 2 values are needed, not 1"),
    ("filters.centres_nm=[600,600,800]", "a centre is given twice"),
    ("filters.reference_nm=700", "filters.reference_nm = 700: it must be one of centres_nm = .500.0, 600.0, 800.0"),
    ("filters.width_nm=4", "edge 10 nm is outside 0 ... 4 nm"),
    ("dark_frames=1", "dark_frames = 1: .*at least 2"),
    ("window_px=5", "window_px = 5: .*at least 7 and at most 63"),
    ("window_px=14", "window_px = 14: an odd number"),
    ("target.pitch_px=3", "target.pitch_px = 3 px: at least window_px = 13 px"),
    ("target.pitch_px=1500", "3 x 3 points, 1500 px apart .* does not fit on 4096 x 2048 px"),
    ("target.edge_px=5", "target.edge_px = 5 px: at least 7 px"),
    ("instrument.defocus_mm=1", "RMS radius of 22.7 px, .*window_px = 13 is too small .*instrument.defocus_mm"),
    ("instrument.coating_nm=1", "MgF2: wavelength 1 nm is outside 200 ... 7000 nm"),
    ("stars.temperatures_k=[-5,3000]", "stars.temperatures_k.*-5.*at least 1000"),
    ("passband.range_nm=[300,900]", "passband.range_nm: .* passes 290 ... 910 nm; .* 400 ... 1000 nm"),
    ("passband.file=absent.csv", "absent.csv: no such file"),
]


@pytest.mark.parametrize(("setting", "expected"), SETTINGS, ids=[setting for setting, _ in SETTINGS])
def test_wrong_setting(refused, setting, expected):
    said = refused("--set", setting)
    assert re.search(expected, said), said


def test_lens_that_is_not_centred(refused, tmp_path):
    """The reference of the test is a centred lens; the element that moves is the test's own business."""
    text = LENS.read_text(encoding="utf-8")
    head, part, tail = text.rpartition("[[surface]]")
    (tmp_path / "tilted.toml").write_text(f"{head}{part}\ntilt_deg = [0.1, 0.0]{tail}", encoding="utf-8")
    assert "paraxial quantities exist for centred lenses only" in refused("--set", "instrument.lens=tilted.toml")


@pytest.mark.slow
def test_dark_charge_that_only_frames_show(refused):
    said = refused("--set", "instrument.exposure_s=1000", "--set", "instrument.diffraction=rays", within_s=20.0)
    assert "lower the dark current (1000 s at 0 C" in said


UNUSUAL = ["decentre.wanted_px=0", "target.rows=1", "target.columns=1", "filters.centres_nm=[600,800]"]


@pytest.mark.slow
def test_unusual_but_possible(tmp_path):
    """Nothing moves; one point; one pair of bands leaves the report without a witness, not without a report."""
    settings = [*UNUSUAL, "frames=4", "compare=[]", "instrument.diffraction=rays"]
    arguments = [word for setting in settings for word in ("--set", setting)]
    assert main(["--quick", *arguments, "--out", str(tmp_path / "out")]) == 0
    assert "witness" not in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
