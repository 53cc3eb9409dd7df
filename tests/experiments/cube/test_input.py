"""Whatever a user can get wrong on the cube-mirror bench: one clear line, exit code 2, nothing written."""

import re

import pytest

SETTINGS = [
    (["trim.start_px=10000"], "the spot is off the screen: it reaches"),
    (["trim.start_px=100"], "is not wholly in the picture of 400 x 400 px"),
    (["cube.offset_mm=[30,0,0]"], "the beam misses face .Z: it falls"),
    (["cube.offset_mm=[0,9,0]"], "the beam is cut by the edge of face .Z"),
    (["cube.side_mm=3.2"], "the aperture of 2.5 mm is larger than the spot|face only"),
    (["simulator.source_arcmin=0"], "the aperture of 2.5 mm is as large as the spot of 2.5 mm"),
    (["simulator.source_arcmin=0.3"], "a rim of .* px shows around it"),
    (["screen.aperture_mm=19.5"], "the aperture of 19.5 mm is larger than the spot"),
    (["screen.aperture_mm=18.8"], "the beam is .* wide at the cube, its face only 19 mm"),
    (["simulator.diameter_mm=2"], "must be smaller than the beam"),
    (["trim.allowed=1"], "not concentric after trim.allowed = 1 settings: offsets .* allow more trims"),
    (['cube.faces=["+X","-X"]'], "the faces are parallel"),
    (['cube.faces=["+Z"]'], "the faces are parallel"),
    (['cube.faces=["+Z","+Y"]'], "the inner axis is parallel to the light and cannot trim"),
    (['cube.faces=["+Z","-Z"]'], "-Z is glued to the sensor"),
    (['cube.faces=["+Z","+X","-X"]'], "TRIAD takes two faces; set cube.method=wahba"),
    (['cube.faces=["+X","+Z"]'], "the first face must be .Z"),
    (["sensor.field_deg=50"], "a spot of the sun sensor leaves its detector"),
    (["camera.detector=absent.toml"], "absent.toml: no such file"),
    (["camera.plateau_e=2e5"], "saturates 'CCD, 15 um'"),
    (["sensor.plateau_e=15000"], "sensor.plateau_e = 15000 e- saturates"),
]

RENDERED = [
    (["trim.stop_px=0.001", "trim.allowed=2"], "not concentric after trim.allowed = 2 settings"),
    (
        ["camera.plateau_e=30"],
        "the pictures locate the spot to .* px only|edge points of the .* do not form a circle .*camera.plateau_e",
    ),
]


LIGHT = ["benches.shown_log2_particles=16", "benches.log2_particles=16"]


@pytest.mark.parametrize(
    ("settings", "said"),
    [*SETTINGS, *(pytest.param(*one, marks=pytest.mark.slow) for one in RENDERED)],
    ids=[" ".join(one) for one, _ in [*SETTINGS, *RENDERED]],
)
def test_one_clear_line(refused_by, settings, said):
    assert re.search(said, refused_by("cube", "--quick", settings=[*LIGHT, *settings]))
