"""Quantities: described once, found again as JSON, arrays, table cells and netCDF."""

import numpy as np
import pytest
import xarray as xr
from refusals import refuses

from experiments.harness.quantities import Outcome, Quantities, shown_unit, to_results, write_netcdf
from experiments.harness.summary import Measured
from optics.errors import ConfigError, DomainError


@pytest.fixture
def q():
    q = Quantities()
    q.axis("method", ["cog", "epsf"], "Centroider", names={"cog": "centre of gravity", "epsf": "ePSF fit"})
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("level", [500.0, 1000.0, 2000.0], "Signal", unit="e-", format=".0f")
    q.add(
        "te_arcsec", np.arange(12.0).reshape(3, 2, 2), "Error", unit="arcsec", dims="level method axis", error=0.5, n=30
    )
    q.add("bound_arcsec", [[1.0, 2.0]] * 3, "Bound", unit="arcsec", dims="level axis", json="levels[level].bound")
    q.add("frames", 30, "Frames")
    return q


def test_places_in_the_summary():
    q = Quantities()
    q.axis("method", ["cog", "epsf"])
    q.axis("level", [1.0, 2.0])
    values = np.arange(4.0).reshape(2, 2)
    q.add("a", values, dims="level method", json="levels[level].methods[method].measured")
    q.add("b", values, dims="level method", json="levels[level].by_method")
    q.add("c", values, dims="level method", json="methods[method].levels")
    q.add("d", values, dims="level method", json="nested.deep")
    q.add("e", values, dims="level method", json="")
    q.add("f", "text")
    q.add("g", True)
    q.add("h", [[1, 2], [3, 4]], dims="row column")
    assert to_results(q.dataset) == {
        "levels": [
            {"methods": {"cog": {"measured": 0.0}, "epsf": {"measured": 1.0}}, "by_method": {"cog": 0.0, "epsf": 1.0}},
            {"methods": {"cog": {"measured": 2.0}, "epsf": {"measured": 3.0}}, "by_method": {"cog": 2.0, "epsf": 3.0}},
        ],
        "methods": {"cog": {"levels": [0.0, 2.0]}, "epsf": {"levels": [1.0, 3.0]}},
        "nested": {"deep": [{"cog": 0.0, "epsf": 1.0}, {"cog": 2.0, "epsf": 3.0}]},
        "f": "text",
        "g": True,
        "h": [[1, 2], [3, 4]],
    }


def test_nested_records_and_an_uncertainty_that_stands_apart():
    q = Quantities()
    q.axis("method", ["cog", "epsf"])
    q.axis("axis", ["x", "y"])
    values = np.arange(4.0).reshape(2, 2)
    q.add(
        "a", values, dims="method axis", error=0.5, json="found[method][axis].seen", json_error="found[method].spread"
    )
    q.add("b", 10.0 + values, dims="method axis", json="found[axis][method]")
    spread = {"x": 0.5, "y": 0.5}
    assert to_results(q.dataset[["a", "a_error", "method", "axis"]]) == {
        "found": {
            "cog": {"x": {"seen": 0.0}, "y": {"seen": 1.0}, "spread": spread},
            "epsf": {"x": {"seen": 2.0}, "y": {"seen": 3.0}, "spread": spread},
        }
    }
    assert to_results(q.dataset[["b", "method", "axis"]]) == {
        "found": {"x": {"cog": 10.0, "epsf": 12.0}, "y": {"cog": 11.0, "epsf": 13.0}}
    }


def test_uncertainty_and_samples_travel_with_the_value(q):
    cell = to_results(q.dataset)["te_arcsec"][1]["epsf"]["y"]
    assert cell == Measured(value=7.0, unit="arcsec", uncertainty=0.5, n=30)
    outcome = Outcome(config=None, result=None, data=q.dataset)
    assert outcome.value("te_arcsec", level=1000.0, method="epsf", axis="y") == cell
    assert outcome.errors("bound_arcsec", axis="x").tolist() == pytest.approx([np.nan] * 3, nan_ok=True)
    assert outcome.values("te_arcsec", method="cog").tolist() == [[0.0, 1.0], [4.0, 5.0], [8.0, 9.0]]
    assert outcome.heading("te_arcsec") == "Error [″]"
    assert outcome.names("method") == ["centre of gravity", "ePSF fit"]
    assert outcome.labels("method") == {"cog": "centre of gravity", "epsf": "ePSF fit"}
    assert outcome.label("axis", "y") == "y"


def test_sequences_of_measured_values_bring_their_own_uncertainty_and_unit():
    q = Quantities()
    row = [Measured(value=1.0, unit="px", uncertainty=0.1, n=4), Measured(value=2.0, unit="px")]
    q.add("shift", [row, row[::-1]], dims="a b")
    data = q.dataset
    assert data["shift"].attrs["units"] == "px"
    np.testing.assert_array_equal(data["shift_error"], [[0.1, np.nan], [np.nan, 0.1]])
    assert to_results(data)["shift"] == [row, row[::-1]]


@pytest.mark.parametrize(
    ("described", "said"),
    [
        ({"name": "te_arcsec", "values": 1.0}, "described twice"),
        ({"name": "x", "values": [1.0], "dims": ""}, "shape"),
        ({"name": "x", "values": [1.0, 2.0, 3.0], "dims": "axis"}, "axis"),
    ],
)
def test_a_wrong_description_is_refused(q, described, said):
    refuses(DomainError, said, lambda: q.add(described.pop("name"), described.pop("values"), **described))


def test_unknown_names_are_told_with_the_nearest_one(q):
    outcome = Outcome(config=None, result=None, data=q.dataset)
    refuses(ConfigError, "te_arcsec", outcome.values, "te_arcsek")
    refuses(ConfigError, "epsf", outcome.values, "te_arcsec", method="psf")
    refuses(ConfigError, "dimension", outcome.values, "bound_arcsec", method="cog")
    q.add("late", [1.0, 2.0], dims="axis", json="levels[level]")
    refuses(ConfigError, "level", to_results, q.dataset)


def test_identifiers_of_stars_survive_netcdf(tmp_path):
    q = Quantities()
    q.add("id", [4600042332025438208, 4600042332025438209], "Star", dims="star")
    write_netcdf(q.dataset, tmp_path / "results.nc")
    with xr.open_dataset(tmp_path / "results.nc") as data:
        assert data["id"].values.tolist() == ["4600042332025438208", "4600042332025438209"]


def test_netcdf_comes_back_with_labels_and_units(q, tmp_path):
    write_netcdf(q.dataset, tmp_path / "results.nc")
    with xr.open_dataset(tmp_path / "results.nc") as data:
        assert data["te_arcsec"].sel({"method": "epsf", "axis": "y"}).values.tolist() == [3.0, 7.0, 11.0]
        assert data["te_arcsec"].attrs["long_name"] == "Error"
        assert data["te_arcsec"].attrs["units"] == "arcsec"
        assert data["te_arcsec_n"].values.max() == 30
        assert list(data["method_label"].values) == ["centre of gravity", "ePSF fit"]


def test_units_along_a_dimension():
    q = Quantities()
    q.axis("unknown", ["x0_px", "f_mm"], "Unknown", units=["px", "mm"])
    q.add("estimate", [1.0, 2.0], unit="{unknown}", dims="unknown", error=0.5, json="unknowns[unknown].estimate")
    found = to_results(q.dataset)["unknowns"]
    assert [one["estimate"].unit for one in found.values()] == ["px", "mm"]
    assert shown_unit("{unknown}") == ""
