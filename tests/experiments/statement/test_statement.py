"""The performance statement: numbers with level and derivation, clauses that were read, what is missing."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.flight.experiment import SECTIONS, AgePrediction, axes
from experiments.flight.terms import AttitudeTerm
from experiments.harness.quantities import to_results
from experiments.harness.sections import described
from experiments.harness.summary import Measured, to_json
from experiments.statement.clauses import UNREAD
from experiments.statement.page import page_of, tables
from experiments.statement.study import LEVELS, Statement, StatementLine, _thermal, predict_statement


def flight_results() -> dict[str, Any]:
    """Results of a flight as its sections describe them."""
    terms = [
        AttitudeTerm(
            term=term,
            measured_arcsec=[Measured(value=v, unit="arcsec", uncertainty=s, n=99) for v, s in measured],
            predicted_arcsec=np.array(predicted),
        )
        for term, measured, predicted in (
            ("temporal_noise", ((1.25, 0.02), (11.5, 0.3)), (1.2, 11.0)),
            ("bias", ((np.nan, np.nan), (np.nan, np.nan)), (0.5, 2.0)),
        )
    ]
    unused = {"limiting_magnitude_mag": 6.0, "electrons_e": 1.0, "stars": 9.0, "available_percent": 90.0}
    ages = [
        AgePrediction(age=age, dark_e=dark_e, noise_arcsec=np.ones(2), total_arcsec=np.array(total), **unused)
        for age, dark_e, total in (("begin", 1.0, (1.5, 12.0)), ("end", 9.0, (1.75, 14.0)))
    ]
    result = {"terms": terms, "ageing": ages}
    sections = {name: SECTIONS[name] for name in result}
    results = to_json(to_results(described(sections, axes(None), result).dataset))
    return results | {"mission": {"available_percent": {"value": 93.5}, "wrong_attitudes": {"value": 0}}}


FLIGHT = {"experiment": "flight", "results": flight_results()}


def line(clause: str, quantity: str = "attitude") -> StatementLine:
    return StatementLine(
        clause=clause, quantity=quantity, value="1″", statistic="AME", conditions="sky", derivation="analysis"
    )


STATEMENT = Statement(
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


def test_page_with_its_clauses_and_those_not_covered() -> None:
    page = page_of(STATEMENT, "my.toml")
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))
    assert "Performance statement: made up" in text
    for text_part in (
        "3.2.8.4",
        UNREAD,
        "focus_shift_um",
        "Robustness to solar events",
        "needs a flight run",
        "annex B",
    ):
        assert text_part in text, text_part
    assert not re.search(r"https?://(?!www\.w3\.org)", page)
    not_covered = tables(replace(STATEMENT, flight="out/flight"))["missing"].rows
    assert 0 < len(not_covered) < len(tables(STATEMENT)["missing"].rows)
    assert not any("flight run" in why for _, why in not_covered)


def test_lines_stand_in_the_order_of_the_clauses_each_named_once() -> None:
    rows = tables(STATEMENT)["errors"].rows
    assert [row[0].partition(" (")[0] for row in rows] == [
        "Pixel spatial error",
        "Temporal noise",
        "",
        "Attitude error, all terms",
    ]
    assert [row[1] for row in rows[1:3]] == ["b", "a"]


def test_an_existing_page_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
    result = predict_statement((str(tmp_path / "my.toml"),), ("sky.attitudes=20",), str(tmp_path))
    judged = {requirement.key: requirement.met for requirement in result.requirements}
    assert judged == {"attitude_cross_arcsec": False, "limiting_magnitude_mag": True}
    assert result.unjudged == ["sun_exclusion_deg"]
    mixed = [line for line in result.errors if line.clause == "total" and "mixed" in line.statistic]
    bound = [[float(part.rstrip("″")) for part in line.value.split(" / ")] for line in mixed]
    assert len(bound) == len(LEVELS)
    assert all(np.diff(np.array(bound), axis=0).ravel() > 0.0)
    assert result.ame_arcsec == pytest.approx(bound[1], rel=0.01)
    flown = [line for line in result.errors if "flight" in line.conditions]
    assert {(line.clause, line.value, line.derivation) for line in flown} == {
        ("temporal_noise", "1.25″ / 11.5″", "rendered simulation"),
        ("temporal_noise", "1.2″ / 11″", "analysis"),
        ("bias", "0.5″ / 2″", "analysis"),
        ("total", "1.5″ / 12″", "analysis"),
        ("total", "1.75″ / 14″", "analysis"),
    }
    assert "± 0.02″ / 0.3″" in next(line.statistic for line in flown if line.derivation == "rendered simulation")
    assert [line.value for line in result.detection if "flight" in line.conditions] == ["93.5 %", "0"]
    assert next(line.value for line in result.errors if line.clause == "aberration") == "20.5″"
    assert not any(line.clause == "thermo_elastic" for line in result.errors)
    assert "ideal lens without glass" in result.notes[0]
    assert "mine" in page_of(result, "my.toml")


def test_thermal_lines_are_derivatives_at_the_corner() -> None:
    """A quarter of a radian: 50 ppm of scale are 12.8 ppm of a radian, 2.63 arcsec."""
    sensitivity = SimpleNamespace(
        boresight_arcsec_per_k=np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 0.4]]),
        scale_ppm_per_k=[50.0, -10.0],
        distortion_arcsec_per_k=[0.012],
        focus_um_per_k=[-1.5],
    )
    lines = list(_thermal(sensitivity, lambda name: np.degrees(0.5)))
    assert [line.value for line in lines] == ["0.5″/K", "+2.63″/K", "-0.527″/K", "0.012″/K", "-1.5 µm/K"]


def test_the_command_writes_the_page_and_says_what_is_missed(tmp_path: Path, monkeypatch, capsys) -> None:
    missed = SimpleNamespace(label="NEA", met=False, at_least=False, required=1, predicted=2.0, unit="″", margin="")
    result = replace(STATEMENT, requirements=[missed])
    monkeypatch.setattr("experiments.statement.study.predict_statement", lambda *arguments: result)
    assert main(["statement", "--out", str(tmp_path / "s.html")]) == 0
    assert "1 / 2 arcsec (AME, 95 %)\nrequired values met: 0 of 1\n  not met: NEA" in capsys.readouterr().out
    assert "made up" in (tmp_path / "s.html").read_text(encoding="utf-8")
