"""Downloads: what is asked, and one line where there is no network, no astroquery or no answer."""

import sys
import types

import pytest
from astropy.table import Table

from optics.errors import ConfigError, DomainError
from render.catalogue.online import download_gaia, download_vizier

HIPPARCOS = Table(
    rows=[(32349, 101.28854105, -16.71314306, -546.01, -1223.08, 379.21, -1.44, 0.009)],
    names=["HIP", "RAICRS", "DEICRS", "pmRA", "pmDE", "Plx", "Vmag", "B-V"],
)


def pretend(monkeypatch, *, answer=None, fault=None):
    """An astroquery that answers or fails, and keeps what it was asked."""
    asked = {}

    def reply():
        print("Status messages could not be retrieved")  # as astroquery does
        if fault is not None:
            raise fault
        return answer

    class Vizier:
        def __init__(self, **arguments):
            asked.update(arguments)

        def query_constraints(self, catalog):
            asked["catalog"] = catalog
            return reply()

    class GaiaClass:
        def __init__(self, **arguments):
            asked.update(arguments)

        def launch_job_async(self, query):
            asked["query"] = query
            return types.SimpleNamespace(get_results=reply)

    monkeypatch.setitem(sys.modules, "astroquery", types.ModuleType("astroquery"))
    monkeypatch.setitem(sys.modules, "astroquery.vizier", types.SimpleNamespace(Vizier=Vizier))
    monkeypatch.setitem(sys.modules, "astroquery.gaia", types.SimpleNamespace(GaiaClass=GaiaClass))
    return asked


def test_vizier(monkeypatch):
    asked = pretend(monkeypatch, answer=[HIPPARCOS])
    catalog = download_vizier("hipparcos", magnitude_limit=6.5)
    assert catalog.id.tolist() == [32349]
    assert catalog.epoch_year == 1991.25
    assert asked["catalog"] == "I/239/hip_main"
    assert asked["column_filters"] == {"Vmag": "<=6.5"}
    assert asked["row_limit"] == -1
    assert set(HIPPARCOS.colnames) <= set(asked["columns"])


def test_gaia(monkeypatch):
    table = Table({"source_id": [1, 2], "ra": [1.0, 2.0], "dec": [3.0, 4.0], "phot_g_mean_mag": [2.5, 2.9]})
    asked = pretend(monkeypatch, answer=table)
    catalog = download_gaia(magnitude_limit=3)
    assert catalog.magnitude.tolist() == [2.5, 2.9]
    assert "phot_g_mean_mag <= 3" in asked["query"]
    assert "radial_velocity" in asked["query"]


@pytest.mark.parametrize(
    "ask", [lambda: download_gaia(magnitude_limit=3), lambda: download_vizier("gaia", magnitude_limit=3)]
)
@pytest.mark.parametrize(
    "fault", [OSError("[Errno -2] Name or service not known"), TimeoutError(), RuntimeError("a\nb")]
)
def test_offline_is_one_line(monkeypatch, capsys, ask, fault):
    pretend(monkeypatch, fault=fault)
    with pytest.raises(ConfigError, match="works offline") as error:
        ask()
    assert "\n" not in str(error.value)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    "ask", [lambda: download_gaia(magnitude_limit=3), lambda: download_vizier("gaia", magnitude_limit=3)]
)
def test_not_installed_is_one_line(monkeypatch, ask):
    for name in ("astroquery", "astroquery.vizier", "astroquery.gaia"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=r"pip install 'starbench\[online\]'") as error:
        ask()
    assert "\n" not in str(error.value)


def test_no_stars(monkeypatch):
    pretend(monkeypatch, answer=[])
    with pytest.raises(ConfigError, match="no stars"):
        download_vizier("hipparcos", magnitude_limit=-9)


def test_refused(monkeypatch):
    asked = pretend(monkeypatch)
    with pytest.raises(ConfigError, match="did you mean hipparcos"):
        download_vizier("hiparcos", magnitude_limit=6)
    with pytest.raises(DomainError, match="magnitude_limit"):
        download_gaia(magnitude_limit=float("nan"))
    assert not asked
