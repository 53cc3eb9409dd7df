"""The page of a lens: study, tables and figures in the layout of the reports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from experiments.harness.document import render_document
from experiments.harness.plotting import house_style
from experiments.harness.provenance import collect
from experiments.harness.quantities import Outcome
from experiments.lens import figures
from experiments.lens.tables import tables
from optics.lens_file import LensFile
from optics.lens_study import study


def page_of(file: LensFile, shown: str) -> str:
    """One self-contained HTML page."""
    results = study(file, shown)
    outcome = Outcome(config=None, result=results, data=xr.Dataset())

    def draw(name: str, *arguments: Any) -> Any:
        with house_style():
            return getattr(figures, name)(outcome, *arguments)

    return render_document(
        Path(__file__).with_name("report.md"),
        outcome,
        tables=tables(results),
        draw=draw,
        criteria=(),
        provenance=collect("lens", {"lens": shown, "seed": None}, variant=None, quick=False, times_s={}),
        folded=False,
    )
