"""Tables of the temporal-error test, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome
from experiments.harness.tables import Table

__all__ = ["tables"]


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name."""
    signal = f"{outcome.value('signal_e'):.0f} e⁻"
    result, beside = outcome.result, ""
    if "published_arcsec" in outcome.data:
        x, y = outcome.values("published_arcsec")
        beside = f"; published {x}″ in x and {y}″ in y"
    main = Pivot(
        rows="method axis",
        columns="dark_arcsec raw_arcsec influence_arcsec drawn_arcsec ratio",
        caption=f"Temporal error (3 σ) of one star at {signal} per frame, dark-subtracted and raw{beside}.",
        note=f"{result.nominal.frames} frames of {len(result.nominal.light)} stars. Measured values carry the "
        "small-sample factor of a standard deviation, as the document's do; it is taken out of *Ratio*, measured over "
        "drawn noise.",
    )
    return {
        "temporal_error": _with_bound(outcome, main),
        "levels": Pivot(
            rows="level method axis",
            columns="level_magnitude_mag level_dark_arcsec level_raw_arcsec level_influence_arcsec level_drawn_arcsec "
            "level_bound_arcsec",
            caption="Temporal error (3 σ) against signal; V: the star that gives it.",
        ),
        "stars": Pivot(
            rows="star",
            across="axis",
            columns="star_light_px star_sigma_px star_predicted_px star_bound_px",
            caption=f"Standard deviation of each star, {outcome.names('method')[0]}, at {signal}.",
        ),
    }


def _with_bound(outcome: Outcome, main: Pivot) -> Table:
    """The bound as two more rows, in the column of the prediction that it bounds."""
    table = pivot(outcome.data, main)
    bound = outcome.values("bound_arcsec")
    rows = [("Cramér-Rao", axis, None, None, float(bound[n]), None, None) for n, axis in enumerate("xy")]
    return Table(columns=table.columns, rows=(*table.rows, *rows), caption=table.caption, note=table.note)
