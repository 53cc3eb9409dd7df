"""Tables from quantities: what runs down, what runs across, heads and keys."""

import numpy as np
import pytest
from refusals import refuses

from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Quantities
from experiments.harness.summary import Measured
from experiments.harness.tables import to_astropy
from optics.errors import DomainError


@pytest.fixture
def data():
    q = Quantities()
    q.axis("method", ["cog", "epsf"], "Centroider", names=["centre of gravity", "ePSF fit"])
    q.axis("axis", ["x", "y"], "Axis")
    q.add("table.te_arcsec", [[1.0, 2.0], [3.0, 4.0]], "Error", unit="arcsec", dims="method axis", error=0.1)
    q.add("table.bound_arcsec", [0.5, 0.6], "Bound", unit="arcsec", dims="axis", format=".3f")
    q.add("table.place_px", np.arange(6.0).reshape(3, 2), "Place", unit="px", dims="star axis")
    q.add("other.flux_e", [7.0, 8.0, 9.0], "Flux", unit="e-", dims="star")
    return q.dataset


def test_rows_and_what_is_repeated(data):
    table = pivot(
        data,
        Pivot(rows="method axis", columns="table.te_arcsec table.bound_arcsec", section="table", caption="c", note="n"),
    )
    assert [(head.name, head.unit) for head in table.heads] == [
        ("Centroider", ""),
        ("Axis", ""),
        ("Error", "″"),
        ("Bound", "″"),
    ]
    assert table.rows[1] == ("centre of gravity", "y", Measured(value=2.0, unit="arcsec", uncertainty=0.1), 0.6)
    assert [row[3] for row in table.rows] == [0.5, 0.6, 0.5, 0.6]
    assert to_astropy(table).colnames == ["method", "axis", "te_arcsec", "te_arcsec_error", "bound_arcsec"]


def test_a_dimension_spread_over_columns(data):
    table = pivot(data, Pivot(rows="star", across="axis", columns="table.place_px other.flux_e", section="table"))
    assert [head.name for head in table.heads] == ["star", "Place x", "Place y", "Flux"]
    assert [head.key for head in table.heads] == ["", "place_px_x", "place_px_y", "other.flux_e"]
    assert table.rows[2] == (3, 4.0, 5.0, 9.0)


def test_some_rows_only(data):
    some = pivot(data, Pivot(rows="method axis", columns="table.te_arcsec", where={"method": ["epsf"]}))
    assert [(*row[:2], row[2].value) for row in some.rows] == [("ePSF fit", "x", 3.0), ("ePSF fit", "y", 4.0)]
    of_one = pivot(data, Pivot(rows="axis", columns="table.te_arcsec", where={"method": "cog"}))
    assert [(row[0], row[1].value) for row in of_one.rows] == [("x", 1.0), ("y", 2.0)]


def test_a_dimension_that_is_forgotten_is_told(data):
    refuses(DomainError, r"te.*axis", lambda: pivot(data, Pivot(rows="method", columns="table.te_arcsec")))
