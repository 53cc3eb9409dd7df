"""``report.html`` of a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.report import Report, Section, Text

if TYPE_CHECKING:
    from experiments.dataset.result import Result

__all__ = ["build_report"]


def build_report(result: Result) -> Report:
    """What was made."""
    stars = sum(one.stars for one in result.facts)
    return Report(
        title="A dataset of star frames",
        lead=f"{len(result.facts)} frames of the real sky with the exact truth of {stars} star images.",
        sections=[Section(title="Provenance", blocks=[Text(result.scene.catalogue.catalog.attribution or "–")])],
    )
