"""Accuracy of star vectors: the rendered bench, then the pixel method on vectors of known noise."""

from __future__ import annotations

from typing import Any

from experiments.fisher import accuracy
from experiments.fisher.accuracy import check_config, run_rendered
from experiments.fisher.field_of_view import FIELDS, field_sweep
from experiments.fisher.settings import FisherConfig
from experiments.harness.progress import Progress
from render.engine.random import Streams

SECTIONS = {**accuracy.SECTIONS, "fields": FIELDS}


def run(config: FisherConfig, *, progress: Progress) -> dict[str, Any]:
    """Render, calibrate, evaluate; then fields of view on coordinates."""
    instrument = check_config(config)
    streams = Streams(config.seed).child("fisher")
    sections = run_rendered(config, instrument, streams, progress)
    with progress.stage("fields of view", total=len(config.field.field_deg)) as stage:
        fields = field_sweep(config.field, streams, advance=stage.advance)
    return {**sections, "fields": fields}
