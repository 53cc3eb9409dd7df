"""Data card: the README.md of a dataset, for whoever finds the folder; its words stand in ``data_card.md``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.dataset.frames.plan import SPLITS
from experiments.dataset.production.folder import IDENTITY
from experiments.dataset.production.identity import identity
from experiments.dataset.truth.files import INDEX_COLUMNS
from experiments.dataset.truth.labels import CLASSES
from experiments.dataset.truth.star_truth import COLUMNS, FLAGS
from experiments.harness.outputs import flat

if TYPE_CHECKING:
    from experiments.dataset.result import Result

__all__ = ["data_card"]


def data_card(result: Result) -> str:
    """Markdown; the same dataset gives the same text, whoever made how much of it and when."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters["g"] = lambda value: f"{value:g}"
    template = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    scene = result.scene
    return environment.from_string(template).render(
        result=result,
        config=result.config,
        records=result.records,
        scene=scene,
        instrument=scene.instrument,
        camera=scene.instrument.camera,
        chip=scene.instrument.detector,
        catalogue=scene.catalogue.catalog,
        jitter=scene.plan.jitter,
        stars=sum(one.stars for one in result.records),
        fastest_deg_per_s=max(math.hypot(*one.rate_deg_per_s) for one in result.records),
        splits=SPLITS,
        identity_file=IDENTITY,
        truth_columns=COLUMNS,
        index_columns=INDEX_COLUMNS,
        flags=FLAGS,
        classes=CLASSES,
        settings=flat(identity(result.config)),
    )
