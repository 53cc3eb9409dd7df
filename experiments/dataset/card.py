"""Description of a dataset: data card, index, Croissant, contact sheet, a zoomable frame."""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.dataset.folder import IDENTITY, file_digest, identity
from experiments.dataset.frame import LAYER_WORDS
from experiments.dataset.labels import CLASSES
from experiments.dataset.truth import COLUMNS, FLAGS, FileColumn, FrameRecord
from experiments.dataset.truth_files import INDEX_COLUMNS, index_bytes
from optics.settings import flat
from render.fits.files import read_frame
from render.fits.preview import preview
from render.sky.partition import GAP, PARTS, leakage

if TYPE_CHECKING:
    from experiments.dataset.detection import Example
    from experiments.dataset.scene import DatasetScene
    from experiments.dataset.settings import DatasetConfig
    from render.catalogue.record import StarCatalog


def write_closing_files(
    scene: DatasetScene,
    source: Path,
    records: Sequence[FrameRecord],
    folder: Path,
    *,
    exports: Mapping[str, str],
    baseline: Mapping[str, str],
    example: Example | None,
) -> None:
    """Index, data card, Croissant, contact sheet and a frame's page into a folder; frames and truth from ``source``."""
    truth = {record.truth: file_digest(source / record.truth) for record in records}
    if scene.config.files.truth == "ecsv":
        (folder / "index.ecsv").write_bytes(index_bytes(records, "ecsv", truth))
    (folder / "index.parquet").write_bytes(index_bytes(records, "parquet", truth))
    for split in PARTS:
        if members := [record for record in records if record.split == split]:
            (folder / f"index_{split}.parquet").write_bytes(index_bytes(members, "parquet", truth))
    (folder / "croissant.json").write_text(croissant(scene, records, folder), encoding="utf-8")
    card = data_card(scene, records, exports=exports, baseline=baseline, page=example is not None)
    (folder / "README.md").write_text(card, encoding="utf-8")
    if example is not None:
        _write_frame_page(source, records, example, folder)
    (folder / "contact_sheet.png").write_bytes(contact_sheet(source, records))


def about(config: DatasetConfig, catalogue: StarCatalog) -> dict[str, str]:
    """Title, version, licence (SPDX identifier), licence_url, citation; each on one line."""
    card = config.card
    licence = card.licence or ("CC-BY-SA-3.0-IGO" if "CC BY-SA 3.0 IGO" in catalogue.attribution else "")
    texts = {
        "title": card.title,
        "version": card.version,
        "licence": licence or "that of the star catalogue",
        "licence_url": f"https://spdx.org/licenses/{licence}.html" if licence else "",
        "citation": card.citation or f"{card.title}, version {card.version}, made by starbench; {catalogue.source}",
    }
    return {name: " ".join(text.split()) for name, text in texts.items()}


def data_card(
    scene: DatasetScene,
    records: Sequence[FrameRecord],
    *,
    exports: Mapping[str, str],
    baseline: Mapping[str, str],
    page: bool,
) -> str:
    """README.md of a dataset, from ``data_card.md``; the text depends on the dataset alone."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters |= {"g": lambda value: f"{value:g}", "plain": plain_text, "quoted": json.dumps}
    template = Path(__file__).with_name("data_card.md").read_text(encoding="utf-8")
    boresights: dict[str, list[tuple[float, float]]] = {}
    for record in records:
        boresights.setdefault(record.split, []).append((record.ra_deg, record.dec_deg))
    return environment.from_string(template).render(
        baseline=baseline,
        exports=exports,
        page=page,
        about=about(scene.config, scene.catalogue),
        config=scene.config,
        records=records,
        scene=scene,
        instrument=scene.instrument,
        camera=scene.instrument.camera,
        chip=scene.instrument.detector,
        catalogue=scene.catalogue,
        jitter=scene.plan.jitter,
        stars=sum(record.stars for record in records),
        fastest_deg_per_s=max(math.hypot(*record.rate_deg_per_s) for record in records),
        splits=PARTS,
        gaps=sum(record.split == GAP for record in records),
        leaks=leakage(boresights, scene.instrument.diagonal_deg),
        identity_file=IDENTITY,
        truth_columns=COLUMNS,
        index_columns=INDEX_COLUMNS,
        flags=FLAGS,
        classes=CLASSES,
        layer_words=LAYER_WORDS,
        settings=flat(identity(scene.config)),
    )


def plain_text(value: object) -> str:
    """Text of users and files for a Markdown table: on one line, markup escaped."""
    line = " ".join("".join(c if c.isprintable() else " " for c in str(value)).split())
    return re.sub(r"([\\|`*\[\]<>&#])", lambda match: f"&#{ord(match[1])};", line)


# --- Croissant 1.0: JSON-LD for dataset catalogues (https://docs.mlcommons.org/croissant/docs/croissant-spec.html)

_CROISSANT_TERMS = (
    "citeAs column equivalentProperty extract field fileObject fileProperty fileSet format includes isLiveDataset "
    "jsonPath key md5 parentField path recordSet references regex repeated replace samplingRate separator source "
    "subField transform"
)
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{word: f"cr:{word}" for word in _CROISSANT_TERMS.split()},
}
_TYPES = {"str": "sc:Text", "int32": "cr:Int32", "int64": "cr:Int64", "float64": "cr:Float64"}
_PARQUET = "application/x-parquet"


def croissant(scene: DatasetScene, records: Sequence[FrameRecord], folder: Path) -> str:
    """JSON-LD text of the content of a dataset; ``folder`` holds the index."""
    texts = about(scene.config, scene.catalogue)
    truth = scene.config.files.truth
    files = [
        {
            "@type": "cr:FileObject",
            "@id": "index.parquet",
            "name": "index.parquet",
            "contentUrl": "index.parquet",
            "encodingFormat": _PARQUET,
            "sha256": hashlib.sha256((folder / "index.parquet").read_bytes()).hexdigest(),
        },
        _file_set("frames", "frames/*.fits", "application/fits", "one image per frame"),
        _file_set("truth", f"truth/*.{truth}", _PARQUET if truth == "parquet" else "text/csv", "one table per frame"),
    ]
    sets = [_record_set("index", "one record per frame", INDEX_COLUMNS, {"fileObject": {"@id": "index.parquet"}})]
    if truth == "parquet":
        sets.append(_record_set("stars", "one record per star and frame", COLUMNS, {"fileSet": {"@id": "truth"}}))
    content = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": texts["title"],
        "description": f"{len(records)} synthetic frames of a star sensor, each with the truth of every star",
        "version": texts["version"],
        "license": texts["licence_url"] or texts["licence"],
        "citeAs": texts["citation"],
        "distribution": files,
        "recordSet": sets,
    }
    return json.dumps(content, indent=1, ensure_ascii=False)


def _file_set(name: str, glob: str, kind: str, text: str) -> dict[str, Any]:
    entry = {"@type": "cr:FileSet", "@id": name, "name": name, "description": text}
    return entry | {"includes": glob, "encodingFormat": kind}


def _record_set(name: str, text: str, columns: Sequence[FileColumn], source: dict[str, Any]) -> dict[str, Any]:
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"{name}/{column.name}",
            "name": column.name,
            "description": f"{column.description} [{column.unit}]" if column.unit else column.description,
            "dataType": _TYPES[column.type],
            "source": {**source, "extract": {"column": column.name}},
        }
        for column in columns
    ]
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "description": text, "field": fields}


# --- Contact sheet

ROWS, COLUMNS_OF_SHEET = 4, 6
TITLE_IN = 0.15


def sheet_records(records: Sequence[FrameRecord]) -> list[FrameRecord]:
    """Frames for the sheet, spread evenly over the dataset."""
    count = min(ROWS * COLUMNS_OF_SHEET, len(records))
    return [records[i] for i in np.unique(np.linspace(0, len(records) - 1, count).round().astype(int))]


def contact_sheet(folder: Path, records: Sequence[FrameRecord]) -> bytes:
    """PNG of up to 24 frames of a dataset; the same frames give the same bytes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = sheet_records(records)
    columns = min(COLUMNS_OF_SHEET, len(shown))
    rows = -(-len(shown) // columns)
    pictures = [preview(read_frame(folder / record.file)) for record in shown]
    height, width = pictures[0].shape
    panel_in = 2.0 * height / width
    inches = (2.0 * columns, (panel_in + TITLE_IN) * rows)
    figure = Figure(figsize=inches, dpi=150, facecolor="#111418")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    figure.subplots_adjust(left=0.004, right=0.996, bottom=0.004, top=1.0 - TITLE_IN / inches[1])
    figure.subplots_adjust(wspace=0.02, hspace=TITLE_IN / panel_in)
    for panel in axes:
        panel.set_axis_off()
    for panel, record, picture in zip(axes, shown, pictures, strict=False):
        panel.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        title = f"{record.frame}   {record.ra_deg:.1f}° {record.dec_deg:+.1f}°   {record.stars} stars"
        panel.set_title(title, color="#d7dbe0", fontsize=6.5, pad=2.0)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def _write_frame_page(source: Path, records: Sequence[FrameRecord], example: Example, folder: Path) -> None:
    """``frame.html``: the frame of the report, zoomable."""
    from calib.figures import star_marks
    from experiments.laboratory.bench.truth_marks import truth_marks
    from optics.fits import image_header
    from optics.frame_html import differences, save_frame_page
    from render.fits.wcs import sky_grid

    record = next(record for record in records if record.frame == example.frame)
    frame, true = read_frame(source / record.file), truth_marks(example.truth)
    measured = star_marks(example.measured.stars)
    save_frame_page(
        folder / "frame.html",
        frame.dn,
        [true, *measured, differences([layer for layer in measured if layer.shape != "cross"], true)],
        title=f"Frame {record.frame}",
        facts={"exposure": f"{record.exposure_s:g} s", "split": record.split, "filter": frame.band},
        flags={"saturated": frame.saturated, "defective": frame.defect},
        sky=sky_grid(image_header(source / record.file), frame.dn.shape),
    )
