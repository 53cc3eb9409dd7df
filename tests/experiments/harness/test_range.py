"""A sweep as text: which number of a configuration, and its values."""

import numpy as np
import pytest
from refusals import refuses

from experiments.budget.settings import BudgetConfig
from experiments.harness.range import logarithmic, parse_sweep, value_at, with_value
from optics.errors import ConfigError


def test_sweep_text():
    sweep = parse_sweep("defocus_mm=-0.2:0.2:9", BudgetConfig)
    assert sweep.key == "instrument.defocus_mm"
    np.testing.assert_allclose(sweep.values, np.arange(-4, 5) * 0.05, atol=1e-15)
    assert sweep.values[4] == 0.0
    assert parse_sweep("frames=10:20:3", BudgetConfig).values == (10, 15, 20)
    assert parse_sweep("source.signal_e=1000:1e5:5:log", BudgetConfig).values == (
        1e3,
        3162.27766017,
        1e4,
        31622.7766017,
        1e5,
    )
    assert parse_sweep("frames=40,10, 20", BudgetConfig).values == (10, 20, 40)
    assert [logarithmic(v) for v in ((1, 2, 4, 8), (1, 2, 3), (1, 2, 5, 10), (-1, 1, 2), (8.0, 4.0, 2.0))] == [
        True, False, True, False, True,
    ]  # fmt: skip
    assert value_at(with_value(BudgetConfig(), "detector.prnu", 0.03), "detector.prnu") == 0.03


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("defocs_mm=-0.2:0.2:9", "did you mean defocus_mm"),
        ("defocus_mm=-0.1:0.1:9:log", "a logarithmic"),
        ("defocus_mm=0.1,0.1", "1 different values"),
        ("edge_nm=10:20:3", "passband.edge_nm or filters.edge_nm"),
        ("defocus_mm=0.1:0.1:3", "empty"),
        ("defocus_mm=0:inf:3", "finite"),
        ("defocus_mm=a:0.1:3", "numbers"),
        ("defocus_mm=0:0.1:1", "2 to 200"),
        ("defocus_mm=0:0.1", "KEY=LOW:HIGH:POINTS"),
        ("defocus_mm=-30:30:3", "at least -10"),
        ("frames=10.1:10.3:5", "whole numbers"),
        ("lens=1:2:3", "instrument.lens cannot be swept"),
        ("attitude.stars=2:4:3", "does not depend on attitude.stars"),
    ],
)
def test_sweep_refused(text, words):
    assert refuses(ConfigError, words, parse_sweep, text, BudgetConfig, ["attitude"]).startswith(f"--sweep {text}: ")
