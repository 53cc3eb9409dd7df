"""The page "add a centroider", followed: its file and its line of the registry, then what it promises."""

import contextlib
import importlib
import io
import re
import shlex
import sys
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from star_images import NOISE, SIZE, gaussian_stars, stamps_of

import calib.measure.centroiders
from calib.measure.centroiding import registry
from calib.measure.centroiding.registry import get_centroider, list_centroiders
from experiments.harness.config import load_config
from experiments.laboratory.bench.centroid_methods import MethodLabels
from optics.errors import ConfigError, DomainError

ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "extending" / "add_a_centroider.md").read_text(encoding="utf-8")
FILE = Path(re.search(r"^`(calib/measure/centroiders/\w+\.py)`:$", PAGE, re.M)[1])
SOURCE, LINE, SCRIPT = re.findall(r"```python\n(.*?)```", PAGE, re.S)
COMMANDS = re.findall(r"^python -m experiments\.(\w+) (.*)$", PAGE, re.M)
FLUX_E, SKY_E = 8000.0, 20.0


@pytest.fixture
def followed(tmp_path, monkeypatch):
    """The page's file beside the other centroiders, its line in the registry; gone after the test."""
    (tmp_path / FILE.name).write_text(SOURCE, encoding="utf-8")
    monkeypatch.setattr(calib.measure.centroiders, "__path__", [*calib.measure.centroiders.__path__, str(tmp_path)])
    name, target = re.fullmatch(r'\s*"(\w+)": "([\w.:]+)",\n', LINE).groups()
    monkeypatch.setattr(registry, "_REGISTRY", {**registry._REGISTRY, name: target})
    importlib.invalidate_caches()
    yield name
    sys.modules.pop(target.partition(":")[0], None)
    with contextlib.suppress(AttributeError):
        delattr(calib.measure.centroiders, FILE.stem)


@pytest.mark.parametrize("harmonic", [1, 2])
def test_places_are_right_at_every_phase_whatever_the_background(followed, harmonic):
    """Of the components beside the one used, sampling folds back less than 4e-4 of the next: 1e-3 px."""
    phase = SIZE // 2 + (np.arange(12) + 0.5) / 12 - 0.5
    x, y = (axis.ravel() for axis in np.meshgrid(phase, phase))
    electrons = FLUX_E * gaussian_stars(x, y, 0.7) + SKY_E
    start = np.rint(x), np.rint(y)
    measure = get_centroider(followed, harmonic=harmonic).measure
    right = measure(stamps_of(electrons, *start, background_e=SKY_E), NOISE)
    assert np.abs(right.x_px - x).max() < 1e-3
    assert np.abs(right.y_px - y).max() < 1e-3
    wrong = measure(stamps_of(electrons, *start, background_e=0.5 * SKY_E), NOISE)
    assert wrong.x_px == pytest.approx(right.x_px, abs=1e-10)


def test_options_are_held_to_their_range_and_the_name_is_known(followed):
    assert followed in list_centroiders()
    with pytest.raises(DomainError, match=r"harmonic = 5; it must be at least 1 and at most 4"):
        get_centroider(followed, harmonic=5)
    with pytest.raises(ConfigError, match="did you mean harmonic"):
        get_centroider(followed, harmonics=1)


def test_the_script_finds_its_star(followed):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(SCRIPT, {})  # the page's own words
    x, y, sigma = (float(number) for number in re.findall(r"[\d.]+(?:e-?\d+)?", printed.getvalue()))
    assert abs(x - 40.25) < 5.0 * sigma < 0.1
    assert abs(y - 20.5) < 5.0 * sigma


def test_every_configuration_takes_the_name(followed):
    assert [name for name, _ in COMMANDS] == ["temporal", "chromatic", "dataset"]
    others = [("hsfe", "--set centroid="), ("distortion", "--set centroid="), ("budget", "--set centroid=")]
    others += [("skycal", "--set centroid=")]
    for name, text in [*COMMANDS, *((name, text + followed) for name, text in others)]:
        settings = get_type_hints(importlib.import_module(f"experiments.{name}.experiment").run)["config"]
        option, setting = shlex.split(text)
        assert option == "--set"
        assert followed in str(load_config(settings, settings=[setting]).model_dump())
        with pytest.raises(ConfigError, match=f"did you mean {followed}"):
            load_config(settings, settings=[setting.replace(followed, "fouriers")])
        assert followed in str(settings.model_json_schema())
    assert MethodLabels()[followed] == "Fourier phase"
