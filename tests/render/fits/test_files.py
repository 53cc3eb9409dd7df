"""Frames through FITS: nothing lost, nothing half written, clear words about broken files."""

import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits
from astropy.nddata import CCDData
from refusals import refuses

from optics.errors import ConfigError
from render.fits.files import read_frame, read_frames, write_frame
from render.records import Frame


def frame() -> Frame:
    rng = np.random.default_rng(1)
    return Frame(
        dn=rng.integers(0, 65536, (7, 11)),
        saturated=rng.random((7, 11)) < 0.2,
        defect=rng.random((7, 11)) < 0.2,
        gain_dn_per_e=0.3,
        offset_dn=40.0,
        read_noise_e=13.0,
        exposure_s=0.1,
        band="600 nm",
        index=17,
    )


def test_frame_comes_back(tmp_path: Path) -> None:
    before = frame()
    after = read_frame(write_frame(before, tmp_path / "a.fits"))
    for name in before.__dataclass_fields__:
        if name == "gain_dn_per_e":
            assert after.gain_dn_per_e == pytest.approx(0.3, rel=1e-14)
        else:
            assert np.array_equal(getattr(before, name), getattr(after, name)), name


def test_what_other_software_sees(tmp_path: Path) -> None:
    """16 bits on disk, the cards of the astronomers, FITS pixel (column + 1, row + 1) for [row, column]."""
    before = frame()
    with fits.open(write_frame(before, tmp_path / "a.fits")) as content:
        content.verify("exception")
        header = content[0].header
        assert (header["BITPIX"], header["NAXIS1"], header["NAXIS2"]) == (16, 11, 7)
        assert (header["EXPTIME"], header["RDNOISE"], header["FILTER"]) == (0.1, 13.0, "600 nm")
        assert header["GAIN"] == pytest.approx(1 / 0.3)
        assert header["PIXOFF"] == 1
        assert content[0].section[2, 5] == before.dn[2, 5]
        assert np.array_equal(content["MASK"].data, before.saturated * 1 + before.defect * 2)


@pytest.mark.parametrize("compression", ["rice", "gzip"])
def test_compressed_frame_comes_back(tmp_path: Path, compression: Any) -> None:
    """Nothing lost, by our reader and as astropy and fitsverify's rules see it; more rows than a tile."""
    rng = np.random.default_rng(5)
    dn, flags = rng.poisson(200, (70, 33)).astype(np.uint16), rng.random((70, 33)) < 0.1
    dn[0, :2] = 0, 65535
    before = dataclasses.replace(frame(), dn=dn, saturated=flags, defect=~flags)
    path = write_frame(before, tmp_path / "a.fits", compression=compression, cards=[("OBJECT", "sky", "")])
    after = read_frame(path)
    assert np.array_equal(after.dn, dn)
    assert np.array_equal(after.saturated, flags)
    assert np.array_equal(after.defect, ~flags)
    assert (after.index, after.band, after.exposure_s) == (17, "600 nm", 0.1)
    with fits.open(path) as content:
        content.verify("exception")
        assert content["FRAME"].header["OBJECT"] == "sky"
        assert content["FRAME"].compression_type == {"rice": "RICE_1", "gzip": "GZIP_2"}[compression]
        assert len(content) == 3
    assert path.stat().st_size % 2880 == 0


def test_masks(tmp_path: Path) -> None:
    """Saturated pixels where there are any; defects only in "always"."""
    before, path = frame(), tmp_path / "a.fits"
    dark = dataclasses.replace(before, saturated=np.zeros((7, 11), bool))
    for mask, held, planes, defects in (
        ("saturated", before, 2, False),
        ("saturated", dark, 1, False),
        ("never", before, 1, False),
        ("always", dark, 2, True),
    ):
        after = read_frame(write_frame(held, path, mask=mask))
        assert np.array_equal(after.saturated, held.saturated & (mask != "never"))
        assert np.array_equal(after.defect, held.defect & defects)
        with fits.open(path) as content:
            assert len(content) == planes


@pytest.mark.parametrize("options", [{}, {"mask": "saturated"}, {"compression": "rice"}])
def test_marks_are_in_the_mask_and_in_no_frame(tmp_path: Path, options: dict[str, Any]) -> None:
    """Expected behaviour: other software sees each mark under the bit that its card names; a measurement does not."""
    held = frame()
    marks = {"COSMIC": held.dn % 3 == 0, "DISK": held.dn % 5 == 0}
    path = write_frame(held, tmp_path / "a.fits", marks=marks, **options)
    with fits.open(path) as content:
        mask, header = content["MASK"].data, content["MASK"].header
        for card, where in {**marks, "SATURATE": held.saturated}.items():
            assert np.array_equal(mask & header[card] != 0, where)
    after = read_frame(path)
    assert np.array_equal(after.saturated, held.saturated)
    assert np.array_equal(after.defect, held.defect & (options.get("mask") != "saturated"))


def test_bytes_depend_on_nothing_else(tmp_path: Path) -> None:
    """Another process, on another day, after other files, writes the same bytes; zero keeps no sign."""
    write_frame(frame(), tmp_path / "other.fits", cards=[("A_2_0", -0.0, ""), ("B", 1, ""), ("C", True, "")])
    options: dict[str, Any] = {"cards": [("A_2_0", 0.0, ""), ("B", 1.0, ""), ("C", 1, ""), ("A", np.float32(0.5), "")]}
    here = [write_frame(frame(), tmp_path / f"{c}.fits", compression=c, **options).read_bytes() for c in (None, "rice")]
    program = (
        "import sys, time, numpy as np; time.time = lambda: 0.0\n"
        "from render.fits.files import read_frame, write_frame\n"
        "frame = read_frame(sys.argv[1])\n"
        "cards = [('A_2_0', 0.0, ''), ('B', 1.0, ''), ('C', 1, ''), ('A', np.float32(0.5), '')]\n"
        "for c in (None, 'rice'): write_frame(frame, sys.argv[1] + str(c), compression=c, cards=cards)\n"
    )
    path = tmp_path / "None.fits"
    root = Path(__file__).resolve().parents[3]
    subprocess.run([sys.executable, "-c", program, str(path)], check=True, cwd=root)
    assert here == [Path(f"{path}{c}").read_bytes() for c in (None, "rice")]


def test_write_replaces_and_leaves_nothing_beside(tmp_path: Path) -> None:
    path = tmp_path / "a.fits"
    path.write_text("old")
    write_frame(frame(), path)
    assert read_frame(path).index == 17
    assert [p.name for p in tmp_path.iterdir()] == ["a.fits"]


def test_foreign_file_with_cards_given(tmp_path: Path) -> None:
    """A float image of whole numbers, in an extension, with a third axis and no card of ours."""
    image = np.arange(12, dtype=np.float32).reshape(1, 3, 4)
    path = tmp_path / "foreign.fits"
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(image)]).writeto(path)
    read = read_frame(path, gain_dn_per_e=2.0, offset_dn=0.0, read_noise_e=3.0, exposure_s=1.0, band="V")
    assert np.array_equal(read.dn, image[0])
    assert (read.gain_dn_per_e, read.band, read.index) == (2.0, "V", 0)
    assert not read.saturated.any()


def test_cube_and_extensions_are_frames(tmp_path: Path) -> None:
    """Planes of a cube and image extensions, each with its mask; ERR is no frame; CCDData masks are of bad pixels."""
    rng = np.random.default_rng(3)
    cube = rng.integers(0, 4095, (3, 5, 6)).astype(np.uint16)
    stated = {"gain_dn_per_e": 0.25, "offset_dn": 64.0, "read_noise_e": 13.0}
    header = fits.Header([("EXPOSURE", 0.2), ("FILTER", "R")])
    fits.PrimaryHDU(cube, header).writeto(tmp_path / "cube.fits")
    read = list(read_frames(tmp_path / "cube.fits", **stated))
    assert [one.index for one in read] == [0, 1, 2]
    assert all(np.array_equal(one.dn, plane) for one, plane in zip(read, cube, strict=True))
    assert (read[2].exposure_s, read[2].band, read[2].gain_dn_per_e) == (0.2, "R", 0.25)
    assert not read[0].defect.any()

    bits = fits.Header([("SATURATE", 4), ("DEFECT", 1)])
    parts: list[Any] = [fits.PrimaryHDU()]
    for version, plane in enumerate(cube[:2], start=1):
        flags = np.zeros(plane.shape, np.uint8)
        flags[version, 0], flags[0, version] = 4, 1
        parts += [
            fits.ImageHDU(plane, name="SCI", ver=version),
            fits.ImageHDU(np.ones(plane.shape), name="ERR", ver=version),
            fits.ImageHDU(flags, bits, name="MASK", ver=version),
        ]
    fits.HDUList(parts).writeto(tmp_path / "many.fits")
    read = list(read_frames(tmp_path / "many.fits", **stated))
    assert len(read) == 2
    for number, one in enumerate(read):
        assert np.array_equal(one.dn, cube[number])
        assert np.argwhere(one.saturated).tolist() == [[number + 1, 0]]
        assert np.argwhere(one.defect).tolist() == [[0, number + 1]]
        assert np.isnan(one.exposure_s)

    data = CCDData(cube[0], unit="adu", mask=cube[0] > 3000)
    data.write(tmp_path / "ccd.fits")
    (one,) = read_frames(tmp_path / "ccd.fits", **stated)
    assert np.array_equal(one.defect, cube[0] > 3000)
    assert not one.saturated.any()


@pytest.mark.parametrize("options", [{}, {"mask": "never"}, {"compression": "rice"}, {"compression": "gzip"}])
@pytest.mark.parametrize("side", [1, 40])
def test_checksums(tmp_path: Path, options: dict[str, Any], side: int) -> None:
    """CHECKSUM and DATASUM as astropy computes them; it warns where one is wrong."""
    rng = np.random.default_rng(side)
    dn, flags = rng.integers(0, 65536, (side, side + 1)), rng.random((side, side + 1)) < 0.3
    path = write_frame(
        dataclasses.replace(frame(), dn=dn, saturated=flags, defect=~flags), tmp_path / "a.fits", **options
    )
    with fits.open(path, checksum=True, disable_image_compression=True) as content:
        parts = [hdu for hdu in content if hdu.header.get("NAXIS", 0)]
        assert parts
        for hdu in parts:
            assert hdu._checksum_valid == 1
            assert hdu._datasum_valid == 1
    damaged = bytearray(path.read_bytes())
    damaged[-2880] ^= 1
    path.write_bytes(damaged)
    with (
        pytest.warns(Warning, match="failed"),
        fits.open(path, checksum=True, disable_image_compression=True) as content,
    ):
        assert len(content)
    refuses(ConfigError, r"damaged or edited since|lies outside its table", read_frame, path)
