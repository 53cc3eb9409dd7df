"""Quantities: described once, found again as JSON, arrays, table cells and netCDF."""

import numpy as np
import pytest
import xarray as xr
from refusals import refuses

from experiments.harness.quantities import (
    IN_SUMMARY,
    Outcome,
    Quantities,
    shown_unit,
    to_coordinates,
    to_results,
    write_netcdf,
)
from experiments.harness.summary import Measured, to_json
from optics.errors import ConfigError, DomainError


@pytest.fixture
def q():
    q = Quantities()
    q.axis("method", ["cog", "epsf"], "Centroider", names={"cog": "centre of gravity", "epsf": "ePSF fit"})
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("level", [500.0, 1000.0, 2000.0], "Signal", unit="e-", format=".0f")
    values = np.arange(12.0).reshape(3, 2, 2)
    q.add("levels.te_arcsec", values, "Error", unit="arcsec", dims="level method axis", error=0.5, n=30)
    q.add("levels.bound_arcsec", [[1.0, 2.0]] * 3, "Bound", unit="arcsec", dims="level axis")
    q.add("stars.bound_arcsec", 3.0, "Bound", unit="arcsec")
    q.add("frames.frames", 30, "Frames")
    return q


def outcome_of(q, section=""):
    return Outcome(config=None, result=None, data=q.dataset, section=section)


def test_a_number_has_its_section_field_unit_dimensions_uncertainty_and_samples(q):
    q.add("frames.lens", "petzval")
    q.add("frames.saturated", [[True, False]], dims="row column")
    q.add("frames.cloud", np.zeros(IN_SUMMARY + 1), unit="px", dims="sample")
    q.add("stars.varied", [1.0, 2.0], dims="axis", n=[3, 4])
    results = to_results(q.dataset)
    assert list(results) == ["levels", "stars", "frames"]
    te, halves = results["levels"]["te_arcsec"], {"x": 0.5, "y": 0.5}
    assert {part: te[part] for part in ("unit", "dims", "n")} == {
        "unit": "arcsec",
        "dims": ["level", "method", "axis"],
        "n": 30,
    }
    assert te["value"][1] == {"cog": {"x": 4.0, "y": 5.0}, "epsf": {"x": 6.0, "y": 7.0}}
    assert te["uncertainty"] == [{"cog": halves, "epsf": halves}] * 3
    assert to_json(results["stars"]) == {
        "bound_arcsec": {"unit": "arcsec", "value": 3.0},
        "varied": {"unit": "", "dims": ["axis"], "value": {"x": 1.0, "y": 2.0}, "n": {"x": 3.0, "y": 4.0}},
    }
    assert to_json(results["frames"]) == {
        "frames": {"unit": "", "value": 30},
        "lens": {"value": "petzval"},
        "saturated": {"dims": ["row", "column"], "value": [[True, False]]},
        "cloud": {"unit": "px", "dims": ["sample"], "shape": [IN_SUMMARY + 1], "file": "results.nc"},
    }
    assert to_json(to_coordinates(q.dataset)["level"]) == {"label": "Signal", "unit": "e-", "value": [500, 1000, 2000]}


def test_parts_of_quantities_are_found_by_coordinates(q):
    outcome = outcome_of(q)
    cell = Measured(value=7.0, unit="arcsec", uncertainty=0.5, n=30)
    assert outcome.value("te_arcsec", level=1000.0, method="epsf", axis="y") == cell
    assert outcome.errors("levels.bound_arcsec", axis="x").tolist() == pytest.approx([np.nan] * 3, nan_ok=True)
    assert outcome.values("te_arcsec", method="cog").tolist() == [[0.0, 1.0], [4.0, 5.0], [8.0, 9.0]]
    assert outcome.heading("te_arcsec") == "Error [″]"
    assert outcome.names("method") == ["centre of gravity", "ePSF fit"]
    assert outcome.labels("method") == {"cog": "centre of gravity", "epsf": "ePSF fit"}
    assert outcome.label("axis", "y") == "y"


def test_a_field_alone_is_that_of_the_own_section_or_of_the_only_one(q):
    assert outcome_of(q, "stars").value("bound_arcsec") == 3.0
    assert outcome_of(q, "levels").dims("bound_arcsec") == ("level", "axis")
    assert outcome_of(q, "stars").name("te_arcsec") == "levels.te_arcsec"
    q.add("target.level", 7.0)  # the field, not the dimension of that name
    assert outcome_of(q).value("level") == 7.0
    refuses(DomainError, "levels.bound_arcsec, stars.bound_arcsec", outcome_of(q).value, "bound_arcsec")
    assert [name in outcome_of(q) for name in ("frames", "frames.frames", "axis", "nothing")] == [
        True,
        True,
        True,
        False,
    ]


def test_sequences_of_measured_values_bring_their_own_uncertainty_and_unit():
    q = Quantities()
    row = [Measured(value=1.0, unit="px", uncertainty=0.1, n=4), Measured(value=2.0, unit="px")]
    q.add("shift", [row, row[::-1]], dims="a b")
    data = q.dataset
    assert data["shift"].attrs["units"] == "px"
    np.testing.assert_array_equal(data["shift_error"], [[0.1, np.nan], [np.nan, 0.1]])
    assert Outcome(config=None, result=None, data=data).value("shift", a=1, b=1) == row[0]


@pytest.mark.parametrize(
    ("described", "said"),
    [
        ({"name": "levels.te_arcsec", "values": 1.0}, "described twice"),
        ({"name": "x", "values": [1.0], "dims": ""}, "shape"),
        ({"name": "x", "values": [1.0, 2.0, 3.0], "dims": "axis"}, "axis"),
    ],
)
def test_a_wrong_description_is_refused(q, described, said):
    refuses(DomainError, said, lambda: q.add(described.pop("name"), described.pop("values"), **described))


def test_unknown_names_are_told_with_the_nearest_one(q):
    outcome = outcome_of(q)
    refuses(ConfigError, "te_arcsec", outcome.values, "te_arcsek")
    refuses(ConfigError, "epsf", outcome.values, "te_arcsec", method="psf")
    refuses(ConfigError, "dimension", outcome.values, "levels.bound_arcsec", method="cog")


def test_identifiers_of_stars_survive_netcdf(tmp_path):
    q = Quantities()
    q.add("id", [4600042332025438208, 4600042332025438209], "Star", dims="star")
    write_netcdf(q.dataset, tmp_path / "results.nc")
    with xr.open_dataset(tmp_path / "results.nc") as data:
        assert data["id"].values.tolist() == ["4600042332025438208", "4600042332025438209"]


def test_netcdf_comes_back_with_labels_and_units(q, tmp_path):
    write_netcdf(q.dataset, tmp_path / "results.nc")
    with xr.open_dataset(tmp_path / "results.nc") as data:
        assert data["levels.te_arcsec"].sel({"method": "epsf", "axis": "y"}).values.tolist() == [3.0, 7.0, 11.0]
        assert data["levels.te_arcsec"].attrs["long_name"] == "Error"
        assert data["levels.te_arcsec"].attrs["units"] == "arcsec"
        assert data["levels.te_arcsec_n"].values.max() == 30
        assert list(data["method_label"].values) == ["centre of gravity", "ePSF fit"]


def test_units_along_a_dimension():
    q = Quantities()
    q.axis("unknown", ["x0_px", "f_mm"], "Unknown", units=["px", "mm"])
    q.add("fit.estimate", [1.0, 2.0], unit="{unknown}", dims="unknown")
    q.add("fit.name", ["principal point", "focal length"], dims="unknown")
    results = to_results(q.dataset)["fit"]
    assert results["estimate"]["unit"] == {"x0_px": "px", "f_mm": "mm"}
    assert results["name"]["value"] == {"x0_px": "principal point", "f_mm": "focal length"}
    assert shown_unit("{unknown}") == ""
