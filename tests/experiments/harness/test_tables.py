"""Tables: numbers as people read them, full precision for machines."""

import io
import math

import numpy as np
import pytest
from astropy.table import Table as AstropyTable

from experiments.harness.summary import Measured
from experiments.harness.tables import Column, Table, cell_text, to_rich, write_ecsv


@pytest.mark.parametrize(
    ("cell", "spec", "text"),
    [
        (None, "", ""),
        (np.bool_(False), "", "no"),
        (0.0, "", "0"),
        (0.123456, "", "0.1235"),
        (-0.000123456, "", "−0.0001235"),
        (1.5e-7, "", "1.500×10⁻⁷"),
        (-0.0001, ".2f", "0.00"),
        (1234567, "", "1\N{THIN SPACE}234\N{THIN SPACE}567"),
        (math.nan, ".3f", "–"),
        (-math.inf, "", "−∞"),
        (Measured(value=0.12034, uncertainty=0.0042), "", "0.1203 ± 0.0042"),
        (Measured(value=0.12034, uncertainty=0.00996), "", "0.120 ± 0.010"),
        (Measured(value=-1.3e-5, uncertainty=0.01), "", "0.000 ± 0.010"),
        (Measured(value=12345.6, uncertainty=34.0), "", "12346 ± 34"),
        (Measured(value=1.3e-7, uncertainty=2e-9), "", "(1.300 ± 0.020)×10⁻⁷"),
        (Measured(value=5.0), "", "5.000"),
        (Measured(value=math.nan, uncertainty=1.0), "", "–"),
    ],
)
def test_cell_text(cell, spec, text):
    assert cell_text(cell, spec) == text


@pytest.fixture
def table():
    return Table(
        columns=[
            "Band",
            Column(name="Shift x", unit="px"),
            Column(name="Stars", key="star_count"),
            Column(name="Noise", unit="e⁻"),
        ],
        rows=[
            ("600-500", Measured(value=0.1 / 3, unit="px", uncertainty=0.001), 25, 2.0),
            ("800-600", Measured(value=0.12, unit="px"), None, 3.0),
        ],
        caption="Table 1",
        note="N = 30 frames",
    )


@pytest.mark.parametrize("style", [False, "1.13"])
def test_ecsv_round_trip(table, tmp_path, style):
    path = tmp_path / "table1.ecsv"
    with np.printoptions(legacy=style):  # as colour-science leaves it where it is imported
        write_ecsv(table, path)
    back = AstropyTable.read(path, format="ascii.ecsv")
    assert back.colnames == ["band", "shift_x_px", "shift_x_px_error", "star_count", "noise_e"]
    assert back["shift_x_px"].unit == "pix"
    assert back["noise_e"].unit == "electron"
    assert back["shift_x_px"][0] == 0.1 / 3  # every bit
    assert back["shift_x_px_error"][0] == 0.001
    assert np.isnan(back["shift_x_px_error"][1])
    assert np.isnan(back["star_count"][1])
    assert back.meta["note"] == "N = 30 frames"


@pytest.mark.parametrize("width", [40, 80])
def test_terminal_table_too_wide_continues_below_with_every_number_whole(width):
    from rich.console import Console

    rows = [("measured", *(Measured(value=k + 0.12034, uncertainty=0.0042) for k in range(9)), "[red]5[/red]")]
    heads = ["Case", *(f"Number {k}" for k in range(9)), Column(name="x", unit="px")]
    wide = Table(columns=heads, rows=rows, note="*n* of `x`")
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(to_rich(wide, width))
    lines = console.export_text().splitlines()
    text = "\n".join(lines)
    assert max(map(len, lines)) <= width
    assert [text.count(cell_text(cell)) for cell in rows[0][1:]] == [1] * 10
    assert text.count("[px]") == 1
    assert text.count("measured") == text.count("Case") > 1
    assert lines[-1].strip() == "n of x"
