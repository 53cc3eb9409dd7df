"""Published numbers stand beside the published sensor only."""

import pytest

from experiments.budget.settings import BudgetConfig
from experiments.harness.config import load_config
from experiments.laboratory.settings.published import is_published_sensor


def test_what_the_document_leaves_open_may_change():
    assert is_published_sensor(BudgetConfig())
    open_keys = [
        "instrument.defocus_mm=0.02",
        "instrument.exposure_s=0.2",
        "source.magnitude_mag=7",
        "instrument.diffraction=exact_waves",
    ]
    assert is_published_sensor(load_config(BudgetConfig, settings=open_keys))
    assert is_published_sensor(load_config(BudgetConfig, file="experiments/data/acc18_tuned.toml"))


@pytest.mark.parametrize(
    "setting",
    ["instrument.lens=star_camera_50mm", "instrument.f_number=4", "passband.range_nm=[450,850]", "filters.width_nm=80"],
)
def test_another_sensor_is_not_the_published_one(setting):
    assert not is_published_sensor(load_config(BudgetConfig, settings=[setting]))
