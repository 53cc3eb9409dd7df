"""Truth and index as Parquet or ECSV: typed columns with units; the record of a frame is metadata of its truth.

A truth file verifies itself: its metadata hold its own SHA-256, computed with zeros in place of the digest, and the
identity of its dataset.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from experiments.dataset.truth import COLUMNS, FLAGS, FileColumn, FrameRecord, record_from_text
from optics.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path


Format = Literal["parquet", "ecsv"]

RECORD, ORIGIN, DIGEST = "starbench_frame", "starbench_dataset", "starbench_sha256"
_BLANK = "0" * 64
_FLAG_TEXTS = {name: f"{bit}: {meaning}" for name, (bit, meaning) in FLAGS.items()}
_SEAL = re.compile(DIGEST.encode() + rb"[^0-9a-f]{1,6}([0-9a-f]{64})", re.DOTALL)

INDEX_COLUMNS = (
    FileColumn("frame", "int64", "", "number of the frame"),
    FileColumn("split", "str", "", "train, validation or test"),
    FileColumn("file", "str", "", "the frame, relative to this folder"),
    FileColumn("truth", "str", "", "its truth, relative to this folder"),
    FileColumn("ra_deg", "float64", "deg", "right ascension of the boresight in the middle of the exposure"),
    FileColumn("dec_deg", "float64", "deg", "declination of the boresight in the middle of the exposure"),
    FileColumn("roll_deg", "float64", "deg", "position angle of up in the image, from north through east"),
    *(FileColumn(f"quat_{axis}", "float64", "", "attitude cam from icrs, scalar last, w >= 0") for axis in "xyzw"),
    *(FileColumn(f"rate_{axis}_deg_per_s", "float64", "deg / s", "angular velocity in camera axes") for axis in "xyz"),
    FileColumn("epoch_year", "float64", "yr", "Julian year"),
    FileColumn("exposure_s", "float64", "s", "exposure time"),
    FileColumn("stars", "int32", "", "stars of which light reaches the detector"),
    FileColumn("saturated", "int32", "", "stars with a saturated pixel"),
    FileColumn("saturated_px", "int32", "", "saturated pixels"),
    FileColumn("background_e", "float64", "electron", "mean expected sky light per pixel"),
    FileColumn("sha256", "str", "", "digest of the frame's file"),
    FileColumn("truth_sha256", "str", "", "digest of its truth's file"),
)


def truth_bytes(rows: Mapping[str, Any], record: FrameRecord, form: Format, origin: str) -> bytes:
    """File of the truth of a frame; the same input gives the same bytes."""
    content = _WRITERS[form](COLUMNS, rows, {RECORD: record.to_text()}, {ORIGIN: origin, DIGEST: _BLANK})
    seal = _SEAL.search(content)
    assert seal is not None
    return content[: seal.start(1)] + hashlib.sha256(content).hexdigest().encode() + content[seal.end(1) :]


def _check_digest(path: Path, content: bytes) -> None:
    """Refuse a truth file whose content does not match its digest."""
    seal = _SEAL.search(content)
    if seal is None:
        raise ConfigError(f"{path}: is not a truth file of a dataset, or is damaged")
    blank = content[: seal.start(1)] + _BLANK.encode() + content[seal.end(1) :]
    if hashlib.sha256(blank).hexdigest().encode() != seal[1]:
        raise ConfigError(f"{path}: is damaged: its digest does not match")


def index_bytes(records: Sequence[FrameRecord], form: Format, truth_digest: Mapping[str, str]) -> bytes:
    """File of the index: one row per frame; ``truth_digest`` holds the digests of the truth files by name."""
    rows: dict[str, Any] = {}
    for column in INDEX_COLUMNS:
        name = column.name
        if name.startswith("quat_"):
            rows[name] = [record.quat_xyzw["xyzw".index(name[-1])] for record in records]
        elif name.startswith("rate_"):
            rows[name] = [record.rate_deg_per_s["xyz".index(name[5])] for record in records]
        elif name == "truth_sha256":
            rows[name] = [truth_digest[record.truth] for record in records]
        else:
            rows[name] = [getattr(record, name) for record in records]
    return _WRITERS[form](INDEX_COLUMNS, rows, {"starbench_index": "1"}, {})


def read_record(path: Path) -> FrameRecord:
    """Record of the frame in a truth file, which is read completely."""
    table, metadata = _read(path, sealed=True)
    try:
        names, rows = [column.name for column in COLUMNS], int(metadata.get("rows", len(table)))
        if table.colnames != names or len(table) != rows:
            raise ConfigError(f"{path}: its columns or rows do not match a truth file")
        return record_from_text(str(metadata[RECORD]))
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: its record of the frame is damaged ({error!r})") from None


def read_origin(path: Path) -> dict[str, Any]:
    """Configuration and software of the dataset that a truth file is of; errors as `read_record`."""
    try:
        origin = json.loads(_read(path, sealed=True)[1][ORIGIN])
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: does not say of which dataset it is ({error!r})") from None
    if not isinstance(origin, dict):
        raise ConfigError(f"{path}: does not say of which dataset it is")
    return origin


def read_table(path: Path) -> Any:
    """Truth or index of a file as an ``astropy.table.Table`` without units."""
    return _read(path, sealed=False)[0]


def _read(path: Path, *, sealed: bool) -> tuple[Any, Mapping[str, Any]]:
    """Columns and metadata."""
    from astropy.table import Table

    try:
        content = path.read_bytes()
        if sealed:
            _check_digest(path, content)
        if path.suffix == ".parquet":
            import pyarrow as pa
            import pyarrow.parquet as pq

            file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True)
            table = file.read()
            columns = {name: table.column(name).to_numpy() for name in table.column_names}
            return Table(columns), {
                key.decode(): value.decode() for key, value in (file.metadata.metadata or {}).items()
            }
        read = Table.read(content.decode(), format="ascii.ecsv")
        return Table({name: np.asarray(read[name]) for name in read.colnames}), read.meta
    except ConfigError:
        raise
    except Exception as error:  # pyarrow and astropy raise errors of many classes
        raise ConfigError(f"{path}: cannot be read ({' '.join(str(error).split())[:160]})") from None


@cache
def _schema(columns: tuple[FileColumn, ...]) -> Any:
    import pyarrow as pa

    def field(c: FileColumn) -> Any:
        kind = pa.string() if c.type == "str" else getattr(pa, c.type)()
        return pa.field(c.name, kind, nullable=False, metadata={"unit": c.unit, "description": c.description})

    return pa.schema(map(field, columns))


def _parquet(
    columns: tuple[FileColumn, ...], rows: Mapping[str, Any], metadata: Mapping[str, str], footer: Mapping[str, str]
) -> bytes:
    """``metadata`` goes into the schema, which Arrow keeps twice; ``footer`` is written once."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = _schema(columns)
    arrays = [
        pa.repeat(pa.scalar(rows[field.name]), len(rows["frame"]))
        if isinstance(rows[field.name], str)
        else pa.array(rows[field.name], field.type)
        for field in schema
    ]
    flags = {f"flag_{name}": text for name, text in _FLAG_TEXTS.items()} if "flags" in rows else {}
    table = pa.Table.from_arrays(arrays, schema=schema.with_metadata({**metadata, **flags}))
    text = [column.name for column in columns if column.type == "str"]
    sink = pa.BufferOutputStream()
    options = {"use_dictionary": text, "write_statistics": False, "write_page_checksum": True}
    with pq.ParquetWriter(sink, table.schema, compression="none", **options) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata(dict(footer))
    return bytes(sink.getvalue())


def _ecsv(
    columns: tuple[FileColumn, ...], rows: Mapping[str, Any], metadata: Mapping[str, str], footer: Mapping[str, str]
) -> bytes:
    from astropy.table import Column as TableColumn
    from astropy.table import Table

    size, table = len(rows["frame"]), Table()
    for c in columns:
        value, kind = rows[c.name], None if c.type == "str" else c.type
        data = np.full(size, value) if isinstance(value, str) else np.asarray(value, kind)
        table[c.name] = TableColumn(data, unit=c.unit or None, description=c.description)
    table.meta = {**metadata, **footer, "rows": size} | ({"flags": _FLAG_TEXTS} if "flags" in rows else {})
    text = io.StringIO()
    with np.printoptions(legacy=False):  # print options of the user's program may cut digits off
        table.write(text, format="ascii.ecsv", delimiter=",")
    return text.getvalue().encode()


_WRITERS = {"parquet": _parquet, "ecsv": _ecsv}
