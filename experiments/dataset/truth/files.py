"""Truth and index as Parquet or ECSV: typed columns with units; the record of a frame is metadata of its truth."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from experiments.dataset.truth.frame_record import FrameRecord, record_from_text
from experiments.dataset.truth.star_truth import COLUMNS, FLAGS, Column

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["INDEX_COLUMNS", "index_bytes", "read_record", "read_table", "truth_bytes"]

Format = Literal["parquet", "ecsv"]

RECORD = "starbench_frame"

INDEX_COLUMNS = (
    Column("frame", "int32", "", "number of the frame"),
    Column("split", "str", "", "train, validation or test"),
    Column("file", "str", "", "the frame, relative to this folder"),
    Column("truth", "str", "", "its truth, relative to this folder"),
    Column("ra_deg", "float64", "deg", "right ascension of the boresight in the middle of the exposure"),
    Column("dec_deg", "float64", "deg", "its declination"),
    Column("roll_deg", "float64", "deg", "position angle of up in the image, from north through east"),
    *(Column(f"quat_{axis}", "float64", "", "attitude cam from icrs, scalar last, w >= 0") for axis in "xyzw"),
    *(Column(f"rate_{axis}_deg_per_s", "float64", "deg / s", "angular velocity in camera axes") for axis in "xyz"),
    Column("epoch_year", "float64", "yr", "Julian year"),
    Column("exposure_s", "float64", "s", "exposure time"),
    Column("stars", "int32", "", "stars of which light reaches the detector"),
    Column("saturated", "int32", "", "stars with a saturated pixel"),
    Column("saturated_px", "int32", "", "saturated pixels"),
    Column("background_e", "float64", "electron", "mean expected sky light per pixel"),
    Column("sha256", "str", "", "digest of the frame's file"),
)


def truth_bytes(rows: Mapping[str, Any], record: FrameRecord, form: Format) -> bytes:
    """File of the truth of a frame; the same input gives the same bytes.

    Parameters
    ----------
    rows : mapping
        Columns (`experiments.dataset.truth.star_truth.star_rows`).
    record : FrameRecord
        Goes into the schema's metadata (Parquet) or the header (ECSV) as JSON, key ``starbench_frame``.
    form : {"parquet", "ecsv"}
        Format.
    """
    metadata = {RECORD: record.to_text()}
    return _parquet(COLUMNS, rows, metadata) if form == "parquet" else _ecsv(COLUMNS, rows, metadata)


def index_bytes(records: Sequence[FrameRecord], form: Format) -> bytes:
    """File of the index: one row per frame."""
    rows: dict[str, Any] = {}
    for column in INDEX_COLUMNS:
        name = column.name
        if name.startswith("quat_"):
            rows[name] = [one.quat_xyzw["xyzw".index(name[-1])] for one in records]
        elif name.startswith("rate_"):
            rows[name] = [one.rate_deg_per_s["xyz".index(name[5])] for one in records]
        else:
            rows[name] = [getattr(one, name) for one in records]
    metadata = {"starbench_index": "1"}
    return _parquet(INDEX_COLUMNS, rows, metadata) if form == "parquet" else _ecsv(INDEX_COLUMNS, rows, metadata)


def read_record(path: Path) -> FrameRecord:
    """Record of the frame in a truth file, all of which is read.

    Raises
    ------
    Exception
        Whatever pyarrow or astropy raise on a file that is damaged; ValueError where the rows are not as many as stars.
    """
    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        table = pq.read_table(path, page_checksum_verification=True)
        if table.column_names != [column.name for column in COLUMNS]:
            raise ValueError("other columns")
        return record_from_text(table.schema.metadata[RECORD.encode()].decode())
    from astropy.table import Table

    text = path.read_text(encoding="utf-8")
    table = Table.read(text, format="ascii.ecsv")
    if table.colnames != [column.name for column in COLUMNS] or len(table) != int(table.meta["rows"]):
        raise ValueError("other columns or rows")
    return record_from_text(table.meta[RECORD])


def read_table(path: Path) -> Any:
    """Truth or index of a file as an ``astropy.table.Table`` without units."""
    from astropy.table import Table

    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        table = pq.read_table(path)
        return Table({name: table.column(name).to_numpy() for name in table.column_names})
    read = Table.read(path, format="ascii.ecsv")
    return Table({name: np.asarray(read[name]) for name in read.colnames})


@cache
def _schema(columns: tuple[Column, ...]) -> Any:
    import pyarrow as pa

    types = {"str": pa.string(), "int32": pa.int32(), "int64": pa.int64(), "float64": pa.float64()}
    return pa.schema(
        [
            pa.field(c.name, types[c.type], nullable=False, metadata={"unit": c.unit, "description": c.about})
            for c in columns
        ]
    )


def _parquet(columns: tuple[Column, ...], rows: Mapping[str, Any], metadata: Mapping[str, str]) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = _schema(columns)
    size = next(len(value) for value in rows.values() if not isinstance(value, str))
    arrays = [
        pa.repeat(pa.scalar(rows[field.name]), size)
        if isinstance(rows[field.name], str)
        else pa.array(rows[field.name], field.type)
        for field in schema
    ]
    flags = {f"flag_{name}": f"{bit}: {about}" for name, (bit, about) in FLAGS.items()} if "flags" in rows else {}
    table = pa.Table.from_arrays(arrays, schema=schema.with_metadata({**metadata, **flags}))
    text = [column.name for column in columns if column.type == "str"]
    sink = pa.BufferOutputStream()
    pq.write_table(
        table, sink, compression="none", use_dictionary=text, write_statistics=False, write_page_checksum=True
    )
    return bytes(sink.getvalue())


def _ecsv(columns: tuple[Column, ...], rows: Mapping[str, Any], metadata: Mapping[str, str]) -> bytes:
    from astropy.table import Column as TableColumn
    from astropy.table import Table

    size = next(len(value) for value in rows.values() if not isinstance(value, str))
    table = Table()
    for c in columns:
        value = rows[c.name]
        kind = None if c.type == "str" else c.type
        data = np.full(size, value) if isinstance(value, str) else np.asarray(value, kind)
        table[c.name] = TableColumn(data, unit=c.unit or None, description=c.about)
    table.meta = {**metadata, "rows": size}
    if "flags" in rows:
        table.meta["flags"] = {name: f"{bit}: {about}" for name, (bit, about) in FLAGS.items()}
    text = io.StringIO()
    with np.printoptions(legacy=False):  # colour-science leaves a style behind that cuts digits off
        table.write(text, format="ascii.ecsv", delimiter=",")
    return text.getvalue().encode()
