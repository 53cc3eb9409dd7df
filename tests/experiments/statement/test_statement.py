"""The performance statement: numbers with level and derivation, clauses that were read, what is missing."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refuses

from experiments.__main__ import main
from experiments.camera.settings import Config
from experiments.statement.clauses import UNREAD
from experiments.statement.page import page_of, tables
from experiments.statement.study import LEVELS, Line, Statement, _thermal, read_flight, statement
from optics.errors import ConfigError

FLIGHT = {
    "experiment": "flight",
    "results": {
        "terms": {
            "temporal_noise": {
                "measured_arcsec": {
                    "across": {"value": 1.25, "unit": "arcsec", "uncertainty": 0.02, "n": 99},
                    "roll": {"value": 11.5, "unit": "arcsec", "uncertainty": 0.3, "n": 99},
                },
                "predicted_arcsec": {"across": 1.2, "roll": 11.0},
            },
            "bias": {"measured_arcsec": None, "predicted_arcsec": {"across": 0.5, "roll": 2.0}},
        },
        "lives": [
            {"dark_e": 1.0, "total_arcsec": {"across": 1.5, "roll": 12.0}},
            {"dark_e": 9.0, "total_arcsec": {"across": 1.75, "roll": 14.0}},
        ],
        "available_percent": 93.5,
        "wrong_attitudes": 0,
    },
}


def line(clause: str, what: str = "attitude") -> Line:
    return Line(clause=clause, what=what, value="1″", statistic="AME", conditions="sky", derivation="analysis")


MADE = Statement(
    name="made up",
    conditions=[("Exposure", "0.1 s", "input")],
    errors=[line("total"), line("temporal_noise", "b"), line("pixel_spatial"), line("temporal_noise", "a")],
    detection=[line("field")],
    requirements=[],
    unjudged=["focus_shift_um"],
    flight="",
    ame_arcsec=(1.0, 2.0),
    limiting_mag=6.0,
)


def test_page_tells_what_it_holds_and_what_not() -> None:
    page = page_of(MADE, "my.toml")
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))
    assert "Performance statement: made up" in text
    for said in ("3.2.8.4", UNREAD, "focus_shift_um", "Robustness to solar events", "needs a flight run", "annex B"):
        assert said in text, said
    assert not re.search(r"https?://(?!www\.w3\.org)", page)
    flown = tables(replace(MADE, flight="out/flight"))["missing"].rows
    assert 0 < len(flown) < len(tables(MADE)["missing"].rows)
    assert not any("flight run" in why for _, why in flown)


def test_lines_stand_in_the_order_of_the_clauses_each_named_once() -> None:
    rows = tables(MADE)["errors"].rows
    assert [row[0].partition(" (")[0] for row in rows] == [
        "Pixel spatial error",
        "Temporal noise",
        "",
        "Attitude error, all terms",
    ]
    assert [row[1] for row in rows[1:3]] == ["b", "a"]


def test_a_folder_that_holds_no_flight(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refuses(ConfigError, "--flight takes the folder", read_flight, tmp_path, None)
    (tmp_path / "summary.json").write_text('{"experiment": "camera", "results": {}}')
    assert main(["statement", "--flight", str(tmp_path), "--out", str(tmp_path / "s.html")]) == 2
    assert "is of 'camera'" in capsys.readouterr().err
    (tmp_path / "summary.json").write_text("[")
    refuses(ConfigError, "not a run's summary", read_flight, tmp_path, None)
    (tmp_path / "s.html").write_text("mine")
    assert main(["statement", "--out", str(tmp_path / "s.html")]) == 2
    assert "--force" in capsys.readouterr().err
    assert (tmp_path / "s.html").read_text() == "mine"


IDEAL = """name = "mine"
[instrument]
detector = "cmv4000"
width_px = 512
height_px = 512
[instrument.lens]
kind = "ideal"
focal_length_mm = 26.0
f_number = 2.0
psf_fwhm_px = 1.8
max_field_deg = 20.0
[requirements]
attitude_cross_arcsec = 0.001
limiting_magnitude_mag = 3.0
sun_exclusion_deg = 30.0
"""


def test_statement_of_a_sensor_with_a_flight(tmp_path: Path) -> None:
    """Levels in their order; the flight beside the prediction; what is asked for, judged; no glass, no derivatives."""
    (tmp_path / "summary.json").write_text(json.dumps(FLIGHT))
    (tmp_path / "my.toml").write_text(IDEAL)
    made = statement((str(tmp_path / "my.toml"),), ("sky.attitudes=20",), str(tmp_path))
    judged = {one.key: one.met for one in made.requirements}
    assert judged == {"attitude_cross_arcsec": False, "limiting_magnitude_mag": True}
    assert made.unjudged == ["sun_exclusion_deg"]
    by = [one for one in made.errors if one.clause == "total" and "mixed" in one.statistic]
    bound = [[float(part.rstrip("″")) for part in one.value.split(" / ")] for one in by]
    assert len(bound) == len(LEVELS)
    assert all(np.diff(np.array(bound), axis=0).ravel() > 0.0)
    assert made.ame_arcsec == pytest.approx(bound[1], rel=0.01)
    flown = [one for one in made.errors if "flight" in one.conditions]
    assert {(one.clause, one.value, one.derivation) for one in flown} == {
        ("temporal_noise", "1.25″ / 11.5″", "rendered simulation"),
        ("temporal_noise", "1.2″ / 11″", "analysis"),
        ("bias", "0.5″ / 2″", "analysis"),
        ("total", "1.5″ / 12″", "analysis"),
        ("total", "1.75″ / 14″", "analysis"),
    }
    assert "± 0.02″ / 0.3″" in next(one.statistic for one in flown if one.derivation == "rendered simulation")
    assert [one.value for one in made.detection if "flight" in one.conditions] == ["93.5 %", "0"]
    assert next(one.value for one in made.errors if one.clause == "aberration") == "20.5″"
    assert not any(one.clause == "thermo_elastic" for one in made.errors)
    assert "ideal lens without glass" in made.notes[0]
    assert "mine" in page_of(made, "my.toml")


def test_thermal_lines_are_derivatives_at_the_corner() -> None:
    """A quarter of a radian: 50 ppm of scale are 12.8 ppm of a radian, 2.63 arcsec."""
    found = SimpleNamespace(
        boresight_arcsec_per_k=np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 0.4]]),
        scale_ppm_per_k=[50.0, -10.0],
        distortion_arcsec_per_k=[0.012],
        focus_um_per_k=[-1.5],
    )
    lines = list(_thermal(found, lambda name: np.degrees(0.5)))
    assert [line.value for line in lines] == ["0.5″/K", "+2.63″/K", "-0.527″/K", "0.012″/K", "-1.5 µm/K"]


def test_the_command_writes_the_page_and_says_what_is_missed(tmp_path: Path, monkeypatch, capsys) -> None:
    missed = SimpleNamespace(label="NEA", met=False, at_least=False, required=1, predicted=2.0, unit="″", margin="")
    made = replace(MADE, requirements=[missed])
    monkeypatch.setattr("experiments.statement.study.statement", lambda *arguments: made)
    assert main(["statement", "--out", str(tmp_path / "s.html")]) == 0
    assert "1 / 2 arcsec (AME, 95 %)\nrequired values met: 0 of 1\n  not met: NEA" in capsys.readouterr().out
    assert "made up" in (tmp_path / "s.html").read_text(encoding="utf-8")


def test_a_flight_of_another_sensor_is_refused(tmp_path: Path) -> None:
    config = Config()
    flown = config.model_dump(mode="json")
    (tmp_path / "summary.json").write_text(json.dumps({**FLIGHT, "config": flown}))
    assert read_flight(tmp_path, config)["wrong_attitudes"] == 0
    flown["instrument"]["housing"]["material"] = "invar_36"
    (tmp_path / "summary.json").write_text(json.dumps({**FLIGHT, "config": flown}))
    with pytest.raises(ConfigError, match=r"another sensor: instrument\.housing\.material = 'invar_36' there"):
        read_flight(tmp_path, config)
