"""Input of the chromatic test that only frames refuse, and unusual input that is possible."""

import pytest

from experiments.chromatic.settings import main


@pytest.mark.slow
def test_dark_charge_that_only_frames_show(refused_by):
    settings = ("instrument.exposure_s=1000", "instrument.diffraction=rays")
    said = refused_by("chromatic", "--quick", settings=settings, within_s=20.0)
    assert "lower the dark current (1000 s at 0 C" in said


UNUSUAL = ["decentre.wanted_px=0", "target.rows=1", "target.columns=1", "filters.centres_nm=[600,800]"]


@pytest.mark.slow
def test_unusual_but_possible(tmp_path):
    """No movement, a single point, a single pair of bands."""
    settings = [*UNUSUAL, "frames=4", "compare=[]", "instrument.diffraction=rays"]
    arguments = [word for setting in settings for word in ("--set", setting)]
    assert main(["--quick", *arguments, "--out", str(tmp_path / "out")]) == 0
