"""Read, write, read: the same rays, whatever the format."""

import re
from pathlib import Path

import numpy as np
import pytest
from lens_texts import BACK, FACE, STOP, TABLE_HEAD, table_lens
from refusals import refuses

from optics import LensFile, LensSystem, Rays, list_lenses, read_lens_file, trace
from optics.errors import ConfigError
from optics.export.write import write_lens
from optics.lens.prescription import lens_from_table

MIRRORS = [
    {"kind": "plane", "thickness_mm": 5.0, "medium": "air", "stop": True, "semi_diameter_mm": 20.0,
     "inner_semi_diameter_mm": 2.0, "decentre_mm": [0.5, -0.3], "tilt_deg": [3.0, 5.0], "axes": "fixed"},
    {"kind": "coordinate_break", "decentre_mm": [1.0, 2.0, 3.0], "tilt_deg": [4.0, -6.0, 20.0], "axes": "moving"},
    {"kind": "odd_asphere", "radius_mm": 300.0, "conic": -0.5, "terms": [0.0, 1e-5, 2e-7], "thickness_mm": 4.0,
     "medium": "own glass"},
    {"kind": "coordinate_break", "tilt_deg": [4.0, 7.0, 0.0], "axes": "fixed", "first": "tilt", "thickness_mm": 1.0},
    {"kind": "conic", "radius_mm": -250.0, "conic": 0.3, "thickness_mm": 40.0, "medium": "air",
     "tilt_deg": [1.0, 2.0], "carry": "forward"},
    {"kind": "sphere", "radius_mm": -700.0, "thickness_mm": -60.0, "medium": "mirror", "tilt_deg": [12.0, 3.0, 0.0],
     "decentre_mm": [0.0, 1.0], "carry": "bend"},
    {"kind": "even_asphere", "radius_mm": -900.0, "conic": 1.0, "asphere": [1e-9, 0.0, 3e-16], "thickness_mm": 50.0,
     "medium": "mirror", "semi_diameter_mm": 40.0},
]  # fmt: skip
GLASS = {"source": "made up", "formula": "shifted_sellmeier", "range_nm": [400.0, 900.0]}
FOLDED = {
    **TABLE_HEAD,
    "surface": MIRRORS,
    "image": {"tilt_deg": [2.0, 1.0], "decentre_mm": [0.1, 0.2]},
    "glass": {"own glass": {**GLASS, "coefficients": [0.0, 1.25, 0.012]}},
}


def bundle(lens: LensSystem) -> Rays:
    radius = lens.surfaces[lens.stop_index].semi_diameter_mm
    x, y = map(np.ravel, np.meshgrid(*(np.linspace(-1.0, 1.0, 9) * radius,) * 2))
    slope = np.radians(0.3 * min(lens.max_field_deg, 20.0))
    direction = [0.3 * np.sin(slope), np.sin(slope), np.cos(slope)]
    return Rays.create(x_mm=x, y_mm=y, z_mm=-10.0, direction=direction, wavelength_nm=lens.design_wavelength_nm)


def largest_difference(lens: LensSystem, again: LensSystem) -> float:
    first, second = trace(lens, bundle(lens)), trace(again, bundle(lens))
    assert np.array_equal(first.status, second.status)
    assert np.count_nonzero(first.ok) > 8
    values = [np.where(first.ok, getattr(first, k) - getattr(second, k), 0.0) for k in ("x", "y", "dx", "dy", "opl_mm")]
    return float(np.abs(values).max())


@pytest.mark.parametrize("suffix", ["toml", "zmx", "seq"])
def test_built_in_lenses_come_back(suffix: str, tmp_path: Path) -> None:
    for name in list_lenses():
        file = read_lens_file(name)
        write_lens(file, tmp_path / f"{name}.{suffix}")
        assert largest_difference(file.lens, read_lens_file(tmp_path / f"{name}.{suffix}").lens) < 1e-12, name


@pytest.mark.parametrize("suffix", ["toml", "zmx", "seq"])
def test_tilts_mirrors_and_own_glass_come_back(suffix: str, tmp_path: Path) -> None:
    file = LensFile(lens=lens_from_table(FOLDED, where="test"), tables=FOLDED)
    written = write_lens(file, tmp_path / f"folded.{suffix}")
    assert len(written) == (1 if suffix == "toml" else 2)
    assert largest_difference(file.lens, read_lens_file(written[-1]).lens) < 1e-12


@pytest.mark.parametrize(("kind", "number"), [("qbfs", "0"), ("qcon", "1")])
def test_forbes_aspheres_are_told_apart_by_their_type(kind: str, number: str, tmp_path: Path) -> None:
    """XDAT 1 of QED_TYPE: 0 is Qbfs on a conic, 1 Qcon; Thorlabs ASL5040-UV has f = 37.0 for 40.0 mm by Qcon."""
    forbes = {"kind": kind, "radius_mm": -400.0, "conic": -0.6, "norm_radius_mm": 50.0, "q_mm": [1e-3, -2e-4]}
    surface = {key: value for key, value in MIRRORS[-1].items() if key not in ("asphere", "conic")}
    tables = {**FOLDED, "surface": [*MIRRORS[:-1], {**surface, **forbes}]}
    file = LensFile(lens=lens_from_table(tables, where="test"), tables=tables)
    (path,) = [one for one in write_lens(file, tmp_path / "lens.zmx") if one.suffix == ".zmx"]
    assert re.search(rf"XDAT 1 {number}(\.0)?\b", path.read_text(encoding="utf-8"))
    assert largest_difference(file.lens, read_lens_file(path).lens) < 1e-12


def test_a_toml_file_that_would_be_refused_is_not_written(tmp_path: Path) -> None:
    """Rims that cross are borne where the object is near; a .toml with such a lens could not be read again."""
    rows = [
        "MODE SEQ", "UNIT MM", "ENPD 4", "FTYP 0 0 1 1 0 0 0", "XFLN 0", "YFLN 0", "WAVM 1 0.55 1", "SURF 0",
        "  DISZ 100", "SURF 1", "  STOP", "  DISZ 1", "SURF 2", "  CURV 0.02", "  DISZ 2", "  GLAS N-BK7 0 0 1.5 40",
        "  DIAM 20 1 0 0 1", "SURF 3", "  CURV -0.02", "  DISZ 90", "  DIAM 20 1 0 0 1", "SURF 4", "  DISZ 0",
    ]  # fmt: skip
    (tmp_path / "near.zmx").write_text("\n".join(rows))
    file = read_lens_file(tmp_path / "near.zmx")
    refuses(ConfigError, r"cross.*allowed in \.zmx", write_lens, file, tmp_path / "again.toml")
    assert not (tmp_path / "again.toml").exists()
    assert largest_difference(file.lens, read_lens_file(*write_lens(file, tmp_path / "again.zmx")).lens) < 1e-12


NORM = {"radius_mm": 80.0, "conic": -0.4, "norm_radius_mm": 9.0}
KINDS = [
    {"kind": "odd_asphere", "radius_mm": 90.0, "conic": 0.2, "terms": [0.0, 1e-5, 2e-7]},
    {"kind": "even_asphere", "radius_mm": 90.0, "conic": 0.2, "asphere": [10.0 ** -(7 + 2 * i) for i in range(9)]},
    {"kind": "zernike", **NORM, "ordering": "noll", "coefficients_mm": [1e-3, 0.0, 2e-3, 1e-3]},
    {"kind": "zernike", **NORM, "ordering": "fringe", "coefficients_mm": [1e-3, 0.0, 2e-3, 1e-3]},
    {"kind": "polynomial", **NORM, "coefficients_mm": [1e-3, 2e-3, 1e-3]},
    {"kind": "toroid", "radius_mm": 70.0, "terms": [1e-5], "rotation_radius_mm": 120.0},
    {"kind": "cylinder", "radius_mm": 70.0, "conic": 0.1},
    {"kind": "biconic", "radius_x_mm": 60.0, "radius_y_mm": 90.0, "conic_x": 0.1, "conic_y": 0.1},
    {"kind": "paraxial", "focal_length_mm": 90.0},
]
OUTLINES = [
    {"kind": "rectangle", "half_width_mm": [5.0, 4.0]},
    {"kind": "ellipse", "half_width_mm": [5.0, 4.0], "centre_mm": [0.5, 0.2]},
    {"kind": "circle", "radius_mm": 2.0, "obscures": True},
    {"kind": "circle", "radius_mm": 6.0},
    {"kind": "spider", "arms": 3, "width_mm": 0.4},
]
NOT_IN_SEQ = ("zernike", "polynomial", "toroid", "paraxial", "spider")


@pytest.mark.parametrize(
    ("table", "suffix"),
    [
        pytest.param(table, suffix, id=f"{table['kind']} {suffix}")
        for table in (*KINDS, *OUTLINES)
        for suffix in ("toml", "zmx", "seq")
        if suffix != "seq" or table["kind"] not in NOT_IN_SEQ
    ],
)
def test_every_kind_of_surface_and_aperture_comes_back(table: dict[str, object], suffix: str, tmp_path: Path) -> None:
    face = {**FACE, "aperture": [table]} if table in OUTLINES else {**table, "thickness_mm": 6.0, "medium": "N-BK7"}
    surfaces = [{**STOP, "semi_diameter_mm": 6.0}, face, BACK]
    lens = table_lens(*surfaces)
    (path,) = write_lens(LensFile(lens=lens, tables={**TABLE_HEAD, "surface": surfaces}), tmp_path / f"a.{suffix}")
    assert largest_difference(lens, read_lens_file(path).lens) < 1e-12
