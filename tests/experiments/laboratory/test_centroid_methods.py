"""Names of centroiders in configurations: whatever the registry holds, and nothing else."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from pydantic import BaseModel

from calib.measure.centroiding import registry
from calib.measure.centroiding.registry import register_centroider
from experiments.harness.config import load_config
from experiments.laboratory.bench.centroid_methods import (
    CentroiderName,
    MethodLabels,
    MethodName,
    list_methods,
    method_centroiders,
    needs_epsf,
    needs_measured_epsf,
)
from optics.errors import ConfigError
from render.records import EffectivePsf


class Settings(BaseModel):
    """A table of a configuration."""

    centroid: CentroiderName = "cog"
    compare: tuple[MethodName, ...] = ()


def psf(width):
    values = np.zeros((9, 9))
    values[4 - width : 5 + width, 4 - width : 5 + width] = 1.0
    return EffectivePsf(values=values, oversampling=1)


@dataclass(frozen=True, kw_only=True)
class Template:
    """A user's centroider that needs an ePSF."""

    name: ClassVar[str] = "template"
    label: ClassVar[str] = "template match"
    needs_epsf: ClassVar[bool] = True
    epsf: object

    def measure(self, stamps, noise):
        raise NotImplementedError


@pytest.fixture
def template(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    return register_centroider(Template)


def test_a_new_centroider_that_needs_an_epsf_makes_two_methods(template):
    assert list_methods()[-2:] == ("epsf_reference", "template_reference")
    config = load_config(Settings, settings=["centroid=template", 'compare=["template_reference", "cog"]'])
    assert config.compare == ("template_reference", "cog")
    assert needs_epsf("template")
    assert needs_epsf("template_reference")
    assert not needs_epsf("cog")
    assert "template" in Settings.model_json_schema()["properties"]["centroid"]["enum"]


def test_labels_tell_the_centroider_and_the_epsf_it_is_given(template):
    labels = MethodLabels(matched="of each filter", reference="of all")
    assert labels["template"] == "template match (of each filter)"
    assert labels["template_reference"] == "template match (of all)"
    assert labels["cog"] == "centre of gravity"
    assert MethodLabels()["template"] == "template match"
    assert set(labels) == set(list_methods())
    assert len(set(labels.values())) == len(labels)


def test_each_place_gets_its_own_psf_or_all_get_the_same(template):
    own = [psf(0), psf(1), psf(2)]
    made = method_centroiders(("cog", "template", "template_reference"), matched=own, reference=[own[1]] * 3)
    assert [type(one).__name__ for one in made.values()] == ["CentreOfGravity", "Template", "Template"]
    assert all(a is b for a, b in zip(made["template"].epsf, own, strict=True))
    assert [one is own[1] for one in made["template_reference"].epsf] == [True] * 3


def test_a_psf_built_from_frames_serves_every_place_and_must_be_there(template):
    own = [psf(0), psf(1)]
    made = method_centroiders(("epsf_measured",), matched=own, reference=own, measured=psf(2))
    np.testing.assert_array_equal([one.values for one in made["epsf_measured"].epsf], [psf(2).values] * 2)
    with pytest.raises(ConfigError, match="needs an ePSF built from frames"):
        method_centroiders(("epsf_measured",), matched=own, reference=own)
    assert "epsf_measured" not in list_methods()
    assert [m for m in list_methods(measured=True) if needs_measured_epsf(m)] == ["epsf_measured", "template_measured"]
    assert MethodLabels()["epsf_measured"] == "ePSF fit (measured ePSF)"
