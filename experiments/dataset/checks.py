"""What ``summary.json`` says of a dataset, and what has to hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from experiments.summary import Criterion

if TYPE_CHECKING:
    from experiments.dataset.result import Result

__all__ = ["criteria", "results"]


def results(result: Result) -> dict[str, Any]:
    """The numbers."""
    return {
        "frames": len(result.facts),
        "frames_made": result.made,
        "frames_per_s": result.frames_per_s,
        "workers": result.workers,
        "stars": sum(one.stars for one in result.facts),
        "frames_without_stars": sum(one.stars == 0 for one in result.facts),
        "exports": dict(result.exports),
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }


def criteria(result: Result) -> list[Criterion]:
    """What has to hold."""
    return [
        Criterion(
            name="frames that are there and whole",
            value=len(result.facts),
            limit=result.config.frames,
            relation=">=",
        )
    ]
