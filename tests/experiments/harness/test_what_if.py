"""Sweeps and comparisons of a telescope whose predictions are closed forms: 500 arcsec mm / D, 1 / t, 1 / stars."""

import json
from dataclasses import dataclass

import pytest
from astropy.table import Table
from pydantic import Field

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.sections import Section, col
from experiments.harness.sweeps import SweptConfig, with_what_if
from optics.errors import DomainError
from optics.settings import read_settings


class Config(SweptConfig):
    name: str = ""
    aperture_mm: float = Field(default=20.0, gt=0, le=100)
    exposure_s: float = Field(default=0.2, gt=0)
    guide_stars: int = Field(default=10, ge=0)
    largest_arcsec: float = 25.0
    least_hz: float = 4.0

    @classmethod
    def of_sensor(cls, file):
        return read_settings(cls, file)


@dataclass(frozen=True, slots=True, kw_only=True)
class Performance:
    resolution_arcsec: float = col("Resolution", "arcsec", ".2f")
    rate_hz: float = col("Update rate", "Hz")
    attitude_px: float = col("Attitude", "px")


@dataclass(frozen=True, slots=True, kw_only=True)
class AtWavelength:
    wavelength_nm: float = col("Wavelength", "nm")
    airy_arcsec: float = col("Airy radius", "arcsec")


def predict(config, *, progress):
    if config.aperture_mm > 50.0:
        raise DomainError("aperture_mm: at most 50 mm is ground")
    performance = Performance(
        resolution_arcsec=500.0 / config.aperture_mm, rate_hz=1 / config.exposure_s, attitude_px=1 / config.guide_stars
    )
    airy = [AtWavelength(wavelength_nm=w, airy_arcsec=0.25 * w / config.aperture_mm) for w in (500.0, 600.0)]
    return {"performance": performance, "airy": airy}


main = command(
    with_what_if(
        Experiment(
            name="telescope",
            config=Config,
            run=predict,
            predict=predict,
            sections={
                "performance": Section(record=Performance),
                "airy": Section(record=AtWavelength, dim="wavelength", along="wavelength_nm"),
            },
            swept=("resolution_arcsec", "rate_hz", "attitude_px"),
            compared=("airy_arcsec",),
            limits=lambda config: {
                "resolution_arcsec": (config.largest_arcsec, False),
                "rate_hz": (config.least_hz, True),
                "attitude_px": (0.07, False),
                "mass_kg": (1.0, False),
            },
        )
    )
)


@pytest.fixture
def results(tmp_path):
    """``results(arguments)``: the results of a command that succeeds, its folder and its page."""

    def run(*arguments):
        out = tmp_path / "out"
        assert main([*arguments, "--out", str(out), "--force"], own_process=False) == 0
        page = (out / "report.html").read_text(encoding="utf-8")
        return json.loads((out / "summary.json").read_text(encoding="utf-8"))["results"], out, page

    return run


def test_sweep_of_a_key(results):
    """25 arcsec need an aperture of 20 mm; above 50 mm a point is refused."""
    found, folder, page = results("--sweep", "aperture_mm=10:60:6", "--set", "guide_stars=20")
    points = Table.read(folder / "sweep.ecsv")
    assert list(points["resolution_arcsec"][:5]) == pytest.approx([50.0, 25.0, 500 / 30, 12.5, 10.0])
    assert list(points["meets"]) == [False, True, True, True, True, False]
    assert points["misses"][0] == "resolution_arcsec"
    assert "at most 50 mm is ground" in points["refusal"][5]
    (crossed,) = found["crossings"]["at"]["value"]
    assert crossed == pytest.approx(20.0, abs=0.02 * 10.0)
    assert found["crossings"]["met"]["value"] == ["above"]
    assert found["swept"]["left_out"]["value"] == "mass_kg"
    answer = "4 of 6 points meet all 3 requirements. Best resolution among these: 10.00″ at aperture 50 mm."
    assert found["swept"]["answer"]["value"] == answer
    assert "Not judged" in page


def test_crossing_of_a_whole_number_stands_midway(results):
    """0.07 px needs 1 / 0.07 = 14.3 stars: not 14, but 15; no prediction lies between."""
    found, *_ = results("--sweep", "guide_stars=10,14,15,20")
    assert found["crossings"]["at"]["value"] == [14.5]


def test_map_over_two_keys(results):
    found, folder, page = results(
        "--sweep", "aperture_mm=10:40:4:log", "--sweep", "exposure_s=0.1:0.4:3", "--set", "guide_stars=20"
    )
    assert "crossings" not in found
    assert len(Table.read(folder / "sweep.ecsv")) == 12
    assert "crosses: points that miss a requirement" in page


def test_comparison_of_sensors(results, tmp_path, capsys):
    sensors = []
    for aperture in (15.0, 30.0, 60.0):
        (tmp_path / f"{aperture}.toml").write_text(f"name = 'A'\naperture_mm = {aperture}\nguide_stars = 20\n")
        sensors += ["--sensor", str(tmp_path / f"{aperture}.toml")]
    found, _, page = results(*sensors[:4])
    assert found["sensors"]["requirements_missed"]["value"] == {"A": 1, "A (2)": 0}
    assert "MISSED, −33 %" in page
    assert found["differences"]["value"]["value"] == {"aperture_mm": {"A": "15", "A (2)": "30"}}
    assert main([*sensors, "--out", str(tmp_path / "three")], own_process=False) == 2
    assert capsys.readouterr().err == "error: sensor 3 (A): aperture_mm: at most 50 mm is ground\n"
