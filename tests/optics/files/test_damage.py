"""Damaged files: one clear line each, or a lens; never a traceback, never a hang."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from optics import LensFile, StarbenchError, load_lens
from optics.export.seq import seq_text
from optics.export.sequence import sequence
from optics.export.zmx import zmx_text
from optics.glass.agf import read_agf
from optics.lens.prescription import lens_from_table
from optics.textfile import LARGEST_BYTES

FILES = 1000
NUMBERS = (b"0", b"-1", b"1e308", b"nan", b"-inf", b"1e-320", b"99999999999", b"", b"0x10", b"1_0", b"\xc2\xb2", b"1D5")


def mutants(seed_text: bytes, rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """Cut, flipped, numbers replaced, lines doubled, moved or lost, other encodings, very long lines."""
    for _ in range(count):
        data = bytearray(seed_text)
        kind = rng.integers(8)
        at = int(rng.integers(len(data)))
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            for place in rng.integers(len(data), size=8):
                data[place] ^= 1 << int(rng.integers(8))
        elif kind in (2, 3, 4):
            words = bytes(data).split(b" ")
            for _ in range(1 + kind % 3):
                words[int(rng.integers(len(words)))] = NUMBERS[int(rng.integers(len(NUMBERS)))]
            data = bytearray(b" ".join(words))
        elif kind == 5:
            lines = bytes(data).split(b"\n")
            first, second = (int(i) for i in rng.integers(len(lines), size=2))
            lines[first] = lines[second]
            lines.insert(second, lines[int(rng.integers(len(lines)))])
            data = bytearray(b"\n".join(lines))
        elif kind == 6:
            encoding = ("utf-16", "utf-32", "utf-16-be", "cp037")[int(rng.integers(4))]
            data = bytearray(bytes(data).decode("ascii").encode(encoding)[: at * 4])
        else:
            data[at:at] = bytes(rng.integers(256, size=64, dtype=np.uint8)) * int(rng.integers(1, 200))
        yield bytes(data)


def seed(kind: str) -> bytes:
    """A folded lens of several kinds of surface, written by our own writer."""
    tables = {
        "name": "seed",
        "source": "made up",
        "design_wavelength_nm": 587.6,
        "max_field_deg": 3.0,
        "surface": [
            {"kind": "plane", "thickness_mm": 5.0, "medium": "air", "stop": True, "semi_diameter_mm": 6.0},
            {"kind": "conic", "radius_mm": 50.0, "conic": -0.5, "thickness_mm": 5.0, "medium": "N-BK7"},
            {
                "kind": "even_asphere",
                "radius_mm": -80.0,
                "asphere": [1e-6, 1e-9],
                "thickness_mm": 30.0,
                "medium": "air",
            },
            {"kind": "coordinate_break", "tilt_deg": [45.0, 0.0], "axes": "moving"},
            {"kind": "plane", "thickness_mm": 0.0, "medium": "mirror", "semi_diameter_mm": 12.0},
            {"kind": "coordinate_break", "tilt_deg": [45.0, 0.0], "axes": "moving", "thickness_mm": -40.0},
        ],
    }
    file = LensFile(lens=lens_from_table(tables, where="seed"), tables=tables)
    made = sequence(file)
    text = zmx_text(file, made, made.catalogues) if kind == "zmx" else seq_text(file, made, "SEED", 12.0)
    return text.encode("ascii")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["zmx", "seq"])
def test_damaged_files_end_in_one_line_or_in_a_lens(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(14)
    path = tmp_path / f"lens.{kind}"
    told, slowest = [], 0.0
    for data in mutants(seed(kind), rng, FILES // 2):
        path.write_bytes(data)
        start = time.process_time()
        try:
            load_lens(path)
        except StarbenchError as error:
            told.append(str(error))
        slowest = max(slowest, time.process_time() - start)
    assert len(told) > FILES // 10
    for text in told:
        assert all(0 < len(line) < 600 and str(path) in line for line in text.split("\n")), text
    assert slowest < 5.0


def test_files_that_are_too_big_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "big.zmx"
    with path.open("wb") as file:
        file.truncate(LARGEST_BYTES + 1)
    start = time.process_time()
    for read in (load_lens, read_agf):
        refuses(StarbenchError, "MiB", read, path)
    assert time.process_time() - start < 1.0
