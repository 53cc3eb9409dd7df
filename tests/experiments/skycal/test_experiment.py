"""Calibration under the sky from end to end: what it writes, and whether its parts agree."""

import json
from dataclasses import replace

import pytest

from experiments.harness.cli import command
from experiments.skycal.settings import experiment, main
from optics.lens_file import load_lens
from optics.rays.paraxial import axial_paraxial

pytestmark = pytest.mark.slow

SMALL = {
    "frames": 6,
    "dark_frames": 5,
    "motion.rate_deg_per_s": 3.0,
    "map_points": 11,
    "narrow.faintest_mag": 8.7,
    "narrow.psf_spacing_px": 400.0,
    "narrow.instrument.diffraction": "rays",
    "wide.instrument.diffraction": "rays",
    "narrow.models": '["brown_conrady", "polynomial_3"]',
    "wide.faintest_mag": 6.2,
    "wide.psf_spacing_px": 190.0,
    "wide.models": '["brown_conrady"]',
}


def arguments(out, **changes):
    settings = SMALL | changes
    return ["--out", str(out), "--seed", "4", *(w for k, v in settings.items() for w in ("--set", f"{k}={v}"))]


@pytest.fixture(scope="module")
def outcome(tmp_path_factory, small_detector):
    """Exit code, folder and result of one small run through the command line."""
    folder, kept = tmp_path_factory.mktemp("skycal") / "out", {}

    def keep(config, **keywords):
        kept.update(experiment.part(experiment.run)(config, **keywords))
        return kept

    given = arguments(folder, **{"narrow.instrument.detector": small_detector})
    status = command(replace(experiment, run=keep))(given, own_process=False)
    return status, folder, {one.made.scene.name: one.made for one in kept["cameras"]}


@pytest.fixture(scope="module")
def summary(outcome):
    return json.loads((outcome[1] / "summary.json").read_text(encoding="utf-8"))


def test_all_criteria_hold(outcome, summary):
    assert [one["name"] for one in summary["criteria"] if one["passed"] is False] == []
    assert len(summary["criteria"]) == 5
    assert outcome[0] == 0


def test_every_frame_is_matched_and_no_star_wrongly(summary):
    for one in summary["results"]["rendered"].values():
        assert one["wrong_matches"] == 0
        assert one["frames_matched"] == 6


@pytest.mark.parametrize(("name", "lens"), [("narrow", "star_camera_206mm"), ("wide", "star_tracker_26mm")])
def test_focal_length_is_that_of_the_prescription(summary, name, lens):
    """Started 22 % off. Light from infinity is imaged at the paraxial focal length plus about the defocus of 0.010 mm;
    what terms of distortion leave to the focal length is less than 0.1 %."""
    found = summary["results"]["rendered"][name]["parameters"]["focal_length_mm"]["value"]
    built = load_lens(lens)
    assert found == pytest.approx(axial_paraxial(built, built.design_wavelength_nm).efl_mm + 0.010, rel=1e-3)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"wide.instrument.exposure_s": 20.0}, "detections are saturated; lower wide.instrument.exposure_s"),
    ],
)
def test_bad_exposures_are_one_line(settings, said, tmp_path, capsys):
    small = {"which": "wide", "frames": 4, "dark_frames": 1, "wide.faintest_mag": 5.0, "wide.psf_spacing_px": 900.0}
    assert main(arguments(tmp_path / "out", **small, **settings)) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1
