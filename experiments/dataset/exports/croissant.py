"""Croissant: what a dataset holds, as JSON-LD that dataset catalogues and learning programs read.

Croissant 1.0, https://docs.mlcommons.org/croissant/docs/croissant-spec.html.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.dataset.exports.about import about
from experiments.dataset.truth.files import INDEX_COLUMNS
from experiments.dataset.truth.star_truth import COLUMNS, Column

if TYPE_CHECKING:
    from experiments.dataset.result import Result

__all__ = ["croissant"]

_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
_TYPES = {"str": "sc:Text", "int32": "cr:Int32", "int64": "cr:Int64", "float64": "cr:Float64"}
_PARQUET = "application/x-parquet"


def croissant(result: Result, folder: Path) -> str:
    """JSON-LD text; ``folder`` holds the index."""
    said = about(result.config, result.scene.catalogue.catalog)
    truth = result.config.files.truth
    files = [
        {
            "@type": "cr:FileObject",
            "@id": "index.parquet",
            "name": "index.parquet",
            "contentUrl": "index.parquet",
            "encodingFormat": _PARQUET,
            "sha256": hashlib.sha256((folder / "index.parquet").read_bytes()).hexdigest(),
        },
        _set("frames", "frames/*.fits", "application/fits", "one image per frame"),
        _set("truth", f"truth/*.{truth}", _PARQUET if truth == "parquet" else "text/csv", "one table per frame"),
    ]
    records = [_records("index", "one record per frame", INDEX_COLUMNS, {"fileObject": {"@id": "index.parquet"}})]
    if truth == "parquet":
        records.append(_records("stars", "one record per star and frame", COLUMNS, {"fileSet": {"@id": "truth"}}))
    content = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": said["title"],
        "description": f"{len(result.records)} synthetic frames of a star sensor, each with the truth of every star",
        "version": said["version"],
        "license": said["licence_url"] or said["licence"],
        "citeAs": said["citation"],
        "distribution": files,
        "recordSet": records,
    }
    return json.dumps(content, indent=1, ensure_ascii=False)


def _set(name: str, glob: str, kind: str, text: str) -> dict[str, Any]:
    return {"@type": "cr:FileSet", "@id": name, "name": name, "description": text, "includes": glob} | {
        "encodingFormat": kind
    }


def _records(name: str, text: str, columns: Sequence[Column], source: dict[str, Any]) -> dict[str, Any]:
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"{name}/{one.name}",
            "name": one.name,
            "description": f"{one.about} [{one.unit}]" if one.unit else one.about,
            "dataType": _TYPES[one.type],
            "source": {**source, "extract": {"column": one.name}},
        }
        for one in columns
    ]
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "description": text, "field": fields}
