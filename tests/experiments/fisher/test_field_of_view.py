"""The sweep over fields of view agrees with its closed forms."""

import pytest

from experiments.fisher.field_of_view import _percent_above_one, field_sweep
from experiments.fisher.settings import FieldConfig
from render.engine.random import Streams


def test_monte_carlo_has_the_predicted_bias() -> None:
    config = FieldConfig(field_deg=(3.0, 20.0), directions=1000, runs=6)
    for point in field_sweep(config, Streams(3), advance=lambda: None):
        for percent, expected in (
            (point.pixel_method_bias_percent, point.closed_form_percent),
            (point.pixel_noise_fisher_percent, point.pixel_noise_quadrature_percent),
            (point.fisher_bias_percent, 0.0),
        ):
            assert percent.value == pytest.approx(expected, abs=6 * percent.uncertainty)


def test_error_of_a_mean_over_runs() -> None:
    mean = _percent_above_one([1.0, 1.2])
    assert (mean.value, mean.uncertainty) == (pytest.approx(10.0), pytest.approx(10.0))
