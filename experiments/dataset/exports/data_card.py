"""Data card: the README.md of a dataset, for whoever finds the folder; its words stand in ``data_card.md``."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.dataset.exports.about import about
from experiments.dataset.frames.splits import GAP, SPLITS, Leak, leakage
from experiments.dataset.production.folder import IDENTITY
from experiments.dataset.production.identity import identity
from experiments.dataset.truth.files import INDEX_COLUMNS
from experiments.dataset.truth.labels import CLASSES
from experiments.dataset.truth.star_truth import COLUMNS, FLAGS
from experiments.harness.outputs import flat

if TYPE_CHECKING:
    from experiments.dataset.result import Result

__all__ = ["data_card", "plain_text"]


def data_card(result: Result) -> str:
    """Markdown; the same dataset gives the same text, whoever made how much of it and when."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters |= {"g": lambda value: f"{value:g}", "plain": plain_text, "quoted": json.dumps}
    template = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    scene = result.scene
    return environment.from_string(template).render(
        result=result,
        baseline=_baseline(result),
        about=about(result.config, scene.catalogue.catalog),
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
        gaps=sum(one.split == GAP for one in result.records),
        leaks=_leaks(result),
        identity_file=IDENTITY,
        truth_columns=COLUMNS,
        index_columns=INDEX_COLUMNS,
        flags=FLAGS,
        classes=CLASSES,
        exported=list(result.exports),
        settings=flat(identity(result.config)),
    )


def _leaks(result: Result) -> dict[str, Leak]:
    """What validation and test share with training."""
    places: dict[str, list[tuple[float, float]]] = {}
    for one in result.records:
        places.setdefault(one.split, []).append((one.ra_deg, one.dec_deg))
    return leakage(places, result.scene.diagonal_deg)


def _baseline(result: Result) -> dict[str, str]:
    """What simple methods find in the frames: for whoever wants to do better."""
    from experiments.dataset.quantities import describe

    if result.evaluation is None or not len(result.evaluation.stars.magnitude):
        return {}
    found = describe(result).dataset
    half = float(found["bright_magnitude_of_half"])
    faint = f", half of those of {half:.2f} mag" if math.isfinite(half) else ""
    looked = f"first {int(found['frames_looked_at'])} frames"
    said = {
        f"detection at {result.config.threshold_sigma:g} sigma, {looked}": (
            f"{100 * float(found['bright_undisturbed']):.2f} % of undisturbed stars of SNR 10 and more{faint}; "
            f"{float(found['false_not_flagged']):.2f} false ones a frame"
        ),
        f"centroid ({result.config.centroid})": (f"error {float(found['bound_ratio']):.2f} times the Cramer-Rao bound"),
    }
    if "solved" in found:
        said["attitude (tetra3rs, lost in space)"] = (
            f"{int(found['solved'])} of {int(found['attempted'])} frames solved, boresight error "
            f"{float(found['median_arcsec']):.2f} arcsec in the median, {float(found['p95_arcsec']):.2f} for 95 %"
        )
    return said


def plain_text(value: object) -> str:
    """Text of users and files for a Markdown table: on one line, nothing in it is markup."""
    one_line = " ".join("".join(c if c.isprintable() else " " for c in str(value)).split())
    return re.sub(r"([\\|`*\[\]<>&#])", lambda found: f"&#{ord(found[1])};", one_line)
