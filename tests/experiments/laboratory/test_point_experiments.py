"""The commands temporal, hsfe and distortion: bad input in one line."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize(
    ("name", "setting", "said"),
    [
        ("temporal", "brightness.lowest_e=30000", "the first must be the lower one"),
        ("temporal", "place_px=[20, 20]", "off the detector"),
        ("temporal", "passband.range_nm=[300, 900]", "passband.range_nm"),
        ("temporal", "instrument.defocus_mm=0.5", "window_px"),
        ("hsfe", "steps.step_px=7", "not smaller than half the window"),
        ("hsfe", "steps.positions=1", "positions"),
        ("hsfe", "place_px=[90000, 20]", "off the detector"),
        ("distortion", "order=5", "more rows and columns than the order"),
        ("distortion", "target.edge_px=2000", "does not fit"),
        ("distortion", "reference=ideal", "reference"),
        ("distortion", "target.jitter_px=-1", "jitter_px"),
    ],
)
def test_bad_input_is_one_line(name, setting, said, refused_by):
    assert said in refused_by(name, "--set", setting)
