"""A sweep as text: which number of a configuration, and its values."""

import numpy as np

from experiments.budget.settings import BudgetConfig
from experiments.harness.range import logarithmic, parse_sweep, value_at, with_value


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
