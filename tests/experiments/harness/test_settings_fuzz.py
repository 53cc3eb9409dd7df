"""Every setting of every experiment, and of the sensor file, refuses what it cannot mean: one line, no traceback."""

import importlib
import math
import typing
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from experiments.dataset.folder import check
from experiments.dataset.plan import read_attitudes
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.harness.run import configuration_file
from experiments.laboratory.settings.sensor_file import SensorConfig
from experiments.reduce.frames_toml import FolderSettings, read_settings
from optics.errors import ConfigError
from optics.lens_file import load_lens
from optics.settings import alternatives, is_model
from optics.validate import parse_model
from render.catalogue.presets import preset_names
from render.catalogue.read import read_catalog
from render.detector.spec import load_detector
from render.sensor_file.file import read_sensor
from render.sensor_file.tables import CatalogueConfig

PACKAGES = Path(importlib.import_module("experiments").__file__ or "").parent
FOLDER = {
    "gain_dn_per_e": 1.0,
    "offset_dn": 100.0,
    "read_noise_e": 5.0,
    "pixel_arcsec": 40.0,
    "series": [{"files": ["a.fits"]}],
    "table": {"axes": "-ZY", "reading_noise_arcsec": [0.1]},
}
CONFIGS: list[BaseModel] = [
    SensorConfig(),
    FolderSettings.model_validate(FOLDER),
    *(
        importlib.import_module(f"experiments.{file.parent.name}.settings").experiment.config()
        for file in sorted(PACKAGES.glob("*/settings.py"))
        if file.parent.name != "laboratory"
    ),
]

HUGE = 1e308
NEVER = (math.nan, math.inf, -math.inf, [[["x"]]], {"no such key": 1}, object())
"""Values that no setting accepts."""


def tables(model: BaseModel) -> Iterator[BaseModel]:
    """A model and those within it, with every kind of a table that comes in several."""
    yield model
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from tables(value)
            yield from (kind() for kind in alternatives(field.annotation) if is_model(kind) and kind is not type(value))
        for item in value if isinstance(value, tuple) else ():
            yield from tables(item) if isinstance(item, BaseModel) else ()


def kinds(annotation: Any) -> set[Any]:
    """Plain types that an annotation is made of."""
    if typing.get_origin(annotation) is typing.Literal:
        return {"literal"}
    inside = [part for part in typing.get_args(annotation) if isinstance(part, type) or typing.get_args(part)]
    return set().union(*map(kinds, inside)) if inside else {annotation}


def wrong(annotation: Any, value: Any) -> Iterator[Any]:
    """What a setting must not take."""
    types = kinds(annotation)
    listed = any(typing.get_origin(part) is tuple for part in alternatives(annotation))
    bad: list[Any] = list(NEVER)
    if types & {int, float}:
        bad += [True, False, HUGE, -HUGE, *(() if str in types else ("1.5", "one"))]
    if int in types and float not in types:
        bad += [1.5, 10**400, -(10**400)]
    if "literal" in types:
        bad += ["no such name", 7777, True]
    if bool in types:
        bad += [1, 0, "true"]
    if str in types and not types & {int, float}:
        bad += [5, True]
    for wrong_value in bad:
        yield wrong_value
        if listed:
            yield [wrong_value]
            if value:
                yield [*value[:-1], wrong_value]


@pytest.mark.slow
def test_wrong_values_are_refused() -> None:
    """A truth value for a number, an exposure of 1e308 s, a list for a number: `ConfigError` that names the setting."""
    faults = []
    for model, table in {type(table): table for config in CONFIGS for table in tables(config)}.items():
        values = table.model_dump()
        for name, field in model.model_fields.items():
            for bad in wrong(field.annotation, values[name]):
                try:
                    parse_model(model, values | {name: bad}, "test")
                except ConfigError as error:
                    if name not in str(error):
                        faults.append(f"{model.__name__}: {name} = {bad!r:.40} gives {error}")
                else:
                    faults.append(f"{model.__module__}.{model.__name__}: {name} = {bad!r:.40} is accepted")
    assert not faults, "\n".join(faults)


def test_presets_of_catalogues_are_those_there_are() -> None:
    """Oracle: the registry that reads the files; an unknown name is refused even where no file is read."""
    named = typing.get_args(CatalogueConfig.model_fields["preset"].annotation)
    assert sorted(named) == sorted(preset_names())


READERS = {
    "lens": load_lens,
    "detector": load_detector,
    "catalogue": lambda name: read_catalog(name, "plain"),
    "attitudes": read_attitudes,
    "settings": lambda name: load_config(SensorConfig, file=name),
    "sensor": partial(read_sensor, model=SensorConfig),
    "own frames": lambda name: read_settings(Path(name)),
    "dataset": lambda name: check(Path(name), Progress()),
    "built-in settings": lambda name: load_config(SensorConfig, file=configuration_file(name)),
}


@pytest.mark.parametrize("name", ["l" * 300 + ".toml", "a\0b.csv"])
@pytest.mark.parametrize("what", READERS)
def test_names_that_the_file_system_refuses_are_one_line(what: str, name: str) -> None:
    """Rationale: such a name is no missing file to the system but an error of its own, which came out as traceback."""
    with pytest.raises(ConfigError) as caught:
        READERS[what](name)
    assert "\n" not in str(caught.value)
