"""Checked configuration: what a user reads when a key or value is wrong."""

import re
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, model_validator
from refusals import refuses

from optics.errors import ConfigError
from optics.validate import parse_model, read_toml


class Filter(BaseModel):
    model_config = ConfigDict(extra="forbid")
    centre_nm: Annotated[float, Field(gt=0, lt=2000, allow_inf_nan=False)]
    kind: Literal["top_hat", "table"] = "top_hat"


class Site(BaseModel):
    model_config = ConfigDict(extra="forbid")
    altitude_m: float = 0.0


class Camera(BaseModel):
    model_config = ConfigDict(extra="forbid")
    site: Site = Site()
    exposure_s: Annotated[float, Field(gt=0)] = 1.0
    filters: list[Filter] = []
    low: float = 0.0
    high: float = 1.0

    @model_validator(mode="after")
    def ordered(self):
        if self.low >= self.high:
            raise ValueError(f"low = {self.low} must be below high = {self.high}")
        return self


def fault(mapping: object) -> str:
    return refuses(ConfigError, ".", parse_model, Camera, mapping, "camera.toml")


def test_a_model_or_one_line_per_fault() -> None:
    camera = parse_model(Camera, {"exposure_s": 2, "filters": [{"centre_nm": 500}]}, "camera.toml")
    assert camera.exposure_s == 2.0
    assert camera.filters[0].centre_nm == 500.0
    assert len(fault({"exposure": 1.0, "exposure_s": -1.0}).splitlines()) == 2
    message = fault({"filters": [{"center_nm": 500.0}]})
    assert "did you mean 'centre_nm'" in message
    assert "missing" not in message


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        (
            {"filters": [{}] * 4},
            ["4 keys are missing: filters.0.centre_nm, filters.1.centre_nm, filters.2.centre_nm, filters.3.centre_nm"],
        ),
        ({"site": {"exposure": 1.0}}, ["unknown key 'site.exposure'", "did you mean 'exposure_s'"]),
        ({"hight": 1.0}, ["unknown key 'hight'", "did you mean 'high'"]),
        ({"altitude": 1.0}, ["unknown key 'altitude'", "did you mean 'site.altitude_m'"]),
        ({"zzz": 1.0}, ["unknown key 'zzz'", "known keys: exposure_s, filters, high, low, site"]),
        ({"filters": [{"center_nm": 1.0, "centre_nm": 1.0}]}, ["'filters.0.center_nm'", "did you mean 'centre_nm'"]),
        ({"filters": [{}]}, ["'filters.0.centre_nm' is missing", "above 0 and below 2000"]),
        ({"exposure_s": -1.0}, ["exposure_s = -1.0: out of range (allowed: above 0)"]),
        ({"exposure_s": "long"}, ["exposure_s = 'long': a number is needed"]),
        ({"filters": [{"centre_nm": float("nan")}]}, ["filters.0.centre_nm = nan"]),
        ({"filters": [{"centre_nm": 1, "kind": "tophat"}]}, ["'tophat'", "'top_hat'"]),
        ({"low": 2.0}, ["low = 2.0 must be below high = 1.0"]),
        (3, ["a table of keys is needed"]),
        ({"filters": [3]}, ["filters.0 = 3", "a table is needed with the keys", "centre_nm"]),
    ],
)
def test_fault_is_one_line_with_place_value_and_range(mapping: object, words: list[str]) -> None:
    message = fault(mapping)
    assert message.startswith("camera.toml: ")
    assert "\n" not in message
    for word in words:
        assert word in message


def test_toml_faults(tmp_path: Path) -> None:
    refuses(ConfigError, "no such file", read_toml, tmp_path / "missing.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("exposure_s = = 1\n")
    refuses(ConfigError, r"not valid TOML .*line 1", read_toml, broken)
    broken.write_bytes(bytes(range(256)))
    refuses(ConfigError, "not a text file", read_toml, broken)
    refuses(ConfigError, "not a regular file; a TOML file is needed", read_toml, tmp_path)
    for encoding in ("utf-8-sig", "utf-16", "utf-16-le", "iso-8859-1"):
        broken.write_bytes('name = "5 µm"\n'.encode(encoding))
        assert read_toml(broken) == {"name": "5 µm"}
    broken.write_text("exposure_s = 3\n")
    assert read_toml(broken) == {"exposure_s": 3}


class Sky(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["sky"] = "sky"


class Cone(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["cone"] = "cone"
    radius_deg: float = Field(default=1.0, le=180)


class Scan(BaseModel):
    model_config = ConfigDict(extra="forbid")
    pointing: Sky | Cone = Field(default=Sky(), discriminator="kind")


@pytest.mark.parametrize(
    ("pointing", "said"),
    [
        (
            {"kind": "sky", "radius_deg": 3.0},
            "key 'pointing.radius_deg' goes with pointing.kind = 'cone'; set that too",
        ),
        ({"kind": "cone", "radus_deg": 3.0}, "unknown key 'pointing.radus_deg'; did you mean 'radius_deg'"),
        ({"kind": "cone", "radius_deg": 200.0}, "pointing.radius_deg = 200.0"),
    ],
)
def test_the_kind_of_a_table_is_no_part_of_its_keys(pointing, said):
    message = refuses(ConfigError, said, parse_model, Scan, {"pointing": pointing}, "f.toml")
    assert not re.search(r"\.(cone|sky)\.", message)


@pytest.mark.parametrize("text", ["{} = 1", "[{}]\nx = 1", "x = {{ {} = 1 }}"])
def test_a_key_of_many_dots_is_refused_before_it_is_parsed(text, tmp_path):
    """tomllib took 10 GB for one of 60 000 dots."""
    path = tmp_path / "dots.toml"
    path.write_text(text.format(".".join(["a"] * 60_000)))
    refuses(ConfigError, "a key has more than 100 dots", read_toml, path)
    path.write_text('x = "a sentence. Another. ' + "1.5 " * 300 + '"\n')
    assert read_toml(path)["x"].startswith("a sentence")
