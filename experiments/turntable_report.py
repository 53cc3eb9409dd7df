"""Words of the turntable report."""

from __future__ import annotations

from experiments.report import Figure, Report, Row, Section
from experiments.turntable_figures import error_maps, residual_arrows, star_windows, visited_places
from experiments.turntable_plots import correlation_matrix, field_curves, lean_curves, pull_bars, reading_curves
from experiments.turntable_result import Result
from experiments.turntable_sketch import bench_sketch
from experiments.turntable_tables import all_tables

__all__ = ["build_report"]


def build_report(result: Result) -> Report:
    """The report."""
    t = all_tables(result)
    return Report(
        title="Turntable",
        lead="x",
        sections=[
            Section(
                title="a",
                blocks=[
                    Figure(drawing=bench_sketch(result.config.two_axis.axes), caption="c"),
                    Figure(drawing=visited_places(result), caption="c"),
                    Row([Figure(drawing=star_windows(result), caption="c"), t["vectors"]]),
                    t["unknowns_two_axis"],
                    t["unknowns_three_axis"],
                    Figure(drawing=error_maps(result, result.cases), caption="c"),
                    Figure(drawing=residual_arrows(result), caption="c"),
                    Row([Figure(drawing=correlation_matrix(c), caption="c") for c in result.cases]),
                    Figure(drawing=field_curves(result), caption="c"),
                    t["field_sweep"],
                    t["noise_shares"],
                    t["map_error"],
                    Row(
                        [
                            Figure(drawing=reading_curves(result), caption="c"),
                            Figure(drawing=lean_curves(result), caption="c"),
                        ]
                    ),
                    t["reading_sweep"],
                    t["lean_sweep"],
                    Figure(drawing=pull_bars(result), caption="c"),
                ],
            )
        ],
    )
