"""Rows of `tests/optics/test_refusals.py`: lens files, glass, surfaces, lenses, pages and records."""

import math
import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from lens_texts import (
    BACK,
    FACE,
    GLASS_TEXT,
    MINIMAL,
    PLATE,
    SEQ_SINGLET,
    STOP,
    STOP_TEXT,
    TOML_HEAD,
    TRIPLET,
    ZMX_SINGLET,
    coated,
    loaded,
    measured,
    table_lens,
    written,
)
from refusals import Row, rows

from optics import Conic, Film, LensFile, Plane, Shape, decentre, load_lens, paraxial, read_lens_file, tilt, trace_pupil
from optics.errors import ConfigError, DomainError, StarbenchError
from optics.export.write import write_lens, write_measured_lens
from optics.fits import image_header
from optics.frame_html import Marks, frame_page, save_frame_page
from optics.glass.absolute_index import Environment
from optics.glass.agf import read_agf
from optics.glass.air import air_index
from optics.glass.catalogue import Glass, get_glass, glass_from_table, list_glasses
from optics.glass.dispersion import Dispersion
from optics.glass.index_database import read_material
from optics.glass.thermal_index import ThermalDispersion
from optics.lens.heated_lens import Housing, Mount, ThermalState, heated_lens, with_spacers
from optics.lens.ideal_lens import ideal_lens, measured_lens
from optics.lens.movement import moved_element
from optics.lens.perturb import change_index, change_shape, change_temperature
from optics.lens.shapes import biconic, forbes_asphere, odd_asphere, sphere, thin_lens, toroid, zernike
from optics.lens.shapes.even_asphere import EvenAsphere
from optics.lens.thermal_history import ThermalHistory, first_order_response
from optics.rays.marginal_rays import check_axial_rays
from optics.rays.paraxial import stopped_down
from optics.record_files import read_record, write_record
from optics.stellar_aberration import aberrated
from optics.textfile import LARGEST_BYTES

NAN, INF = math.nan, math.inf


def edited(text: str, name: str, *cases: tuple[Any, ...]) -> list[Row]:
    """Rows of a lens file in which a part is replaced: old, new, words."""
    table = []
    for old, new, *words in cases:
        assert old in text, old
        changed = text.replace(old, new) if name.endswith("toml") else text.replace(old, new, 1)
        table.append((f"{name} {new[:40]!r}", partial(loaded, text=changed, name=name), StarbenchError, words))
    return table


TABLE = {"B": [1.0, 0.2], "C": [0.01, 90.0], "range_nm": [400, 700], "source": "test"}
CURVE = {"transmittance": [0.9, 0.9], "transmittance_nm": [400, 700], "transmittance_mm": 10}


def glass(**change: object) -> Glass:
    return glass_from_table("mine", TABLE | change)


def material(kind: str, *numbers: str) -> Callable[[Path], Any]:
    """A material file of refractiveindex.info with one formula, or with a table of several rows."""
    rows_text = "".join(f"        {row}\n" for row in numbers)
    formula = f"wavelength_range: 0.3 2.5\n    coefficients: {numbers[0]}"
    data = formula if kind.startswith("formula") else f"data: |\n{rows_text}"
    return lambda folder: read_material(written(folder, f"DATA:\n  - type: {kind}\n    {data}", "a.yml"))


def coating_table(**more: object) -> Any:
    table = {"kind": "table", "source": "test", "wavelength_nm": [400.0, 700.0], **more}
    return coated(coating={"ar": table}, default_coating="ar")


AIR = [
    *rows(ConfigError, air_index, (550.0, {"formula": "cidor"}, ["ciddor"]), (550.0, {"humidity": 0.5}, ["ciddor"])),
    *rows(DomainError, air_index,
        (550.0, {"temperature_c": 200.0}, ["200 C", "-100 ... 140"]),
        (550.0, {"pressure_hpa": -1.0}, ["-1 hPa", "0 ... 2000"]),
        (550.0, {"humidity": 1.5, "formula": "ciddor"}, ["1.5", "0 ... 1"]),
        (550.0, {"co2_ppm": -1.0, "formula": "ciddor"}, ["-1 ppm"]),
        ([500.0, 100.0], {}, ["100 nm", "185 ... 10000 nm"])),
    *rows(DomainError, Environment, ({"temperature_c": 200.0}, ["200.0 C"]), ({"pressure_hpa": 3e3}, ["3000.0 hPa"])),
]  # fmt: skip
BK7 = (1.86, 1.31e-8, -1.37e-11, 4.34e-7, 6.27e-10, 0.17)
GLASS = [
    *rows(ConfigError, get_glass, ("N-FK51", {}, ["N-FK51A"])),
    *rows(ConfigError, list_glasses, ("SHOTT", {}, ["SCHOTT"])),
    *rows(DomainError, get_glass("BaF2").absolute_index, (500.0, {"temperature_c": 0.0}, ["BaF2", "dn/dT", "25 C"])),
    *rows(DomainError, get_glass("S-BSL7").absolute_index, (500, {"temperature_c": 95}, ["95 C", "-40 ... 80 C"])),
    *rows(ConfigError, get_glass("N-BK7").relative_index, (500.0, {"medium": "water"}, ["water", "air"])),
    *rows(DomainError, get_glass("N-BK7").index,
        *(([500.0, v], {}, [f"{v:g} nm", "N-BK7", "300 ... 2500 nm"]) for v in (250.0, 3000.0, NAN))),
    *rows(DomainError, get_glass("N-BK7").internal_transmittance, (500.0, -1.0, {}, ["path -1 mm"])),
    *rows(DomainError, get_glass("MgF2").internal_transmittance, (500.0, 1.0, {}, ["no internal transmittance"])),
    *rows(ConfigError, glass,
        ({"rnage_nm": [400, 700]}, ["mine", "range_nm"]),
        ({"source": ""}, ["mine", "source"]),
        ({"dndt": [1e-6, 0.0]}, ["mine", "2 numbers"]),
        ({"transmittance": [0.9]}, ["mine", "together, or none"]),
        ({"formula": "schott"}, ["mine", "either B and C"])),
    *rows(DomainError, glass,
        ({"B": [1.0]}, ["mine", "1 B and 2 C"]),
        ({"B": [1.0, NAN]}, ["mine", "not finite"]),
        ({"B": "abc"}, ["mine", "not a list of numbers"]),
        ({"C": [0.25, 90.0]}, ["mine", "resonance at 500 nm"]),
        ({"B": [-0.5, 0.2]}, ["mine", "falls to"]),
        ({"range_nm": [700, 400]}, ["mine", "range"]),
        ({"reference_temperature_c": 2e301}, ["mine", "-273.15 ... 1000 C"]),
        ({"dndt": [0.0, 0.0, 0.0, 0.0, 0.0, 1e299]}, ["mine", "at most 1000 um"]),
        ({"nd": "high"}, ["mine", "nd"]),
        (CURVE | {"transmittance": [0.9, 1.2]}, ["mine", "1.2"]),
        (CURVE | {"transmittance_nm": [700, 400]}, ["mine", "increase"]),
        (CURVE | {"transmittance_mm": -1}, ["mine", "positive"])),
    *rows(ConfigError, glass_from_table, ("mine", {"B": [1.0]}, {}, ["'C' is missing"]), ("mine", 3, {}, ["B and C"])),
    *rows(DomainError, ThermalDispersion.of, ([NAN, 0.0, 0.0, 0.0, 0.0, 0.2], {}, ["not finite"])),
    *rows(DomainError, ThermalDispersion.of, (BK7, {}, ["more than a tenth in 60 K"])),  # its exponent is missing
    *rows(ConfigError, Dispersion, ("conradi", (1.5,), {}, ["formula"])),
    *rows(ConfigError, partial(replace, get_glass("N-BK7")), ({"transmittance": None}, ["together, or neither"])),
]  # fmt: skip
MATERIALS: list[Row] = [
    (f"material {kind} {words[0]}", material(kind, *numbers), StarbenchError, ["a.yml", *words])
    for kind, numbers, *words in (
        ("tabulated k", ("0.3 3e-6", "-0.0 1e-6", "0.5 1e-6"), "the wavelength", "0 um"),
        ("tabulated nk", ("0.3 1.5 0", "0.4 1.5 0", "-0.5 1.5 0"), "the wavelength -0.5 um"),
        ("tabulated nk", ("0.3 1e300 0", "0.4 1.5 0"), "beyond a million"),
        ("tabulated n", ("0.3 1.5", "0.4 1.9", "0.5 1.5", "0.6 1.9", "0.7 1.5", "0.8 1.9", "0.9 1.5"), "too rough"),
        ("formula 3", ("2 1 -9999",), "(2.0, 1.0, -9999.0)"),
        ("formula 4", ("2 1 0 -1 0.5",), "(2.0, 1.0, 0.0, -1.0, 0.5)"),
        ("formula 6", ("0 1 0",), "(0.0, 1.0, 0.0)"),
        ("formula 7", ("1 2 3",), "larger than that of any glass"),
        ("formula 8", ("1",), "formula 8"),
    )
] + [
    (f"material {text[:9]!r}", lambda f, t=text: read_material(written(f, t, "a.yml")), ConfigError, ["a.yml"])
    for text in ("a: [", "[" * 3000, "5", "DATA: []", "DATA: [{type: formula 2}]")
]
AGF_TEXT = (
    "NM EMPTY 2 0 1.5 60\nCD 0 0 0\nLD .4 .7\nNM OFF 2 0 1.6 60\nCD 1.25 0\nLD .4 .7\nNM NEW 14 0 1.6 60\nCD 1 0\n"
    "NM WIDE 2 0 1.5 60\nCD 1.25 0\n"
)
AGF: list[Row] = [
    (f"AGF {name}", lambda f, n=name: read_agf(written(f, AGF_TEXT, "x.agf")).glass(n), StarbenchError, [word])
    for name, word in (
        ("EMPTY", "all zero"),
        ("OFF", "states 1.6"),
        ("NEW", "formula 14"),
        ("Z", "unknown glass"),
        ("WIDE", "line LD"),
    )
] + [("AGF without glass", lambda f: read_agf(written(f, "CC none", "x.agf")), ConfigError, ["no glass"])]
MIRROR_AR = {**PLATE[0], "medium": "mirror", "thickness_mm": -5.0, "coating": "ar"}
QUARTER = {"ar": {"kind": "quarter_wave", "design_wavelength_nm": 550.0}}
COATINGS = [
    *rows(ConfigError, coating_table,
        ({"reflectance": [[-0.1, 0.0]]}, ["R = -0.1 for s light at 400 nm, 0 deg"]),
        ({"reflectance": [[0.1, 0.2]], "transmittance": [[0.8, 0.9]]}, ["R + T = 1.1 for s light at 700 nm"]),
        ({"reflectance": [[0.1]]}, ["1 rows (angles) of 2 values"]),
        ({"reflectance_s": [[0.1, 0.1]]}, ["give reflectance, or reflectance_s and reflectance_p"]),
        ({}, ["reflectance is missing"]),
        ({"angle_deg": [30.0, 10.0], "reflectance": [[0.1, 0.1]] * 2}, ["angles of incidence must increase"]),
        ({"wavelength_nm": [700.0, 400.0], "reflectance": [[0.1, 0.1]]}, ["positive and increasing"])),
    *rows(ConfigError, coated,
        ({"default_coating": "arr"}, ["coating 'arr'"]),
        ({"coating": {"bare": QUARTER["ar"]}}, ["'bare' is reserved"]),
        ({"surface": [MIRROR_AR], "coating": QUARTER}, ["surface 0: the coating of a mirror is a table"])),
    *rows(ConfigError, Film, ({"thickness_nm": 10.0}, ["either a material or an index"])),
    *rows(DomainError, Film,
        ({"thickness_nm": 10.0, "index": 1.5, "extinction": -1.0}, ["extinction"]),
        ({"thickness_nm": 0.0, "index": 1.5}, ["thickness_nm = 0"])),
]  # fmt: skip


def with_aperture(**table: object) -> Any:
    return table_lens(STOP, {**FACE, "aperture": [table]}, BACK)


def with_map(content: str | None, **face: object) -> Callable[[Path], Any]:
    def call(folder: Path) -> Any:
        if content is not None:
            written(folder, content, "map.txt")
        error = {"file": "map.txt", "width_mm": [20.0, 18.0], "unit": "nm"}
        return table_lens(STOP, {**FACE, "error": error, **face}, BACK, folder=folder)

    return call


class Unfinished(Plane):
    flipped = Shape.flipped


BREAK = {"kind": "coordinate_break", "decentre_mm": [0.5, -0.3]}
M1 = {"radius_mm": -2000.0, "conic": -1.0, "thickness_mm": -700.0, "medium": "mirror"}
POLYGON = {"kind": "polygon", "points_mm": [(0, 0), (1, 1), (2, 2)]}
SURFACES = [
    *rows(DomainError, odd_asphere.OddAsphere, ({"terms": (1e-3,)}, ["a cone"])),
    *rows(DomainError, forbes_asphere.Qcon, ({"norm_radius_mm": 0.0}, ["Qcon.norm_radius_mm = 0.0", "positive"])),
    *rows(DomainError, partial(zernike.Zernike, norm_radius_mm=1.0),
        ({"ordering": "ansi"}, ["'noll' or 'fringe'"]),
        ({"ordering": "fringe", "coefficients_mm": (0.0,) * 38}, ["at most 37"])),
    *rows(DomainError, toroid.Toroid, ({"rotation_radius_mm": 0.0}, ["inf for a cylinder"])),
    *rows(DomainError, biconic.Biconic, ({"radius_x_mm": NAN}, ["Biconic.radius_x_mm = nan"])),
    *rows(DomainError, thin_lens.ThinLens, ({"focal_length_mm": 0.0}, ["0.0"])),
    *rows(DomainError, thin_lens.ThinLens, ({"focal_length_mm": 1.0, "collimated": "no"}, ["'before' or 'after'"])),
    *rows(DomainError, sphere.Sphere, ({"radius_mm": 0.0}, ["other than zero"]), ({"radius_mm": INF}, ["finite"])),
    *rows(DomainError, Conic, ({"radius_mm": 1.0, "conic": NAN}, ["Conic.conic = nan"])),
    *rows(DomainError, EvenAsphere, ({"asphere": (1e-6, INF)}, ["EvenAsphere.asphere[1]"])),
    *rows(DomainError, Plane().changed, ("conic", 0.1, {}, ["plane has no conic", "no parameter"])),
    *rows(DomainError, EvenAsphere(asphere=(1e-6,)).changed, ("radius_mm", 1.0, {}, ["radius cannot be changed"])),
    *rows(TypeError, Unfinished, ({}, ["flipped"])),
    *rows(ConfigError, with_aperture,
        ({"kind": "circel", "radius_mm": 1.0}, ["did you mean circle"]),
        ({"kind": "circle"}, ["radius_mm"]),
        (POLYGON, ["enclose no area"]),
        ({"kind": "rectangle", "half_width_mm": [1.0, 0.0]}, ["above 0"]),
        ({"kind": "circle", "radius_mm": 1.0, "half_width_mm": [1, 1]}, ["half_width_mm"]),
        ({"kind": "spider", "arms": 3, "width_mm": 0.4, "obscures": False}, ["can only block"])),
    ("map absent", with_map(None), StarbenchError, ["map.txt: map cannot be read"]),
    ("map of words", with_map("1 2 x\n"), StarbenchError, ["map.txt: not a table of numbers"]),
    ("map too small", with_map("1 2 3\n4 5 6\n"), StarbenchError, ["(2, 3) points"]),
    ("map with NaN", with_map("nan " * 6 + "\n" + ("1 " * 6 + "\n") * 6), StarbenchError, ["finite"]),
    ("map too narrow", with_map(("1 " * 6 + "\n") * 6, semi_diameter_mm=9.5), ConfigError, ["9.5 mm", "18 mm"]),
    *rows(ConfigError, table_lens,
        (STOP, {**FACE, "carry": "bend"}, BACK, {}, ["carry = 'bend' needs medium = 'mirror'"]),
        (STOP, {**FACE, "cte_per_k": 1e-6}, BACK, {}, ["cte_per_k needs medium = 'mirror'"]),
        (STOP, {"kind": "coordinate_break", "tilt_deg": [90.0, 0.0]}, FACE, BACK, {}, ["edge-on to the light"]),
        (STOP, BACK, {"image": {"tilt_deg": [90.0, 0.0]}}, ["image plane is edge-on"]),
        (STOP, M1, FACE, BACK, {}, ["has the wrong sign"]),
        (STOP, {**BREAK, "medium": "air"}, FACE, BACK, {}, ["medium"]),
        ({**STOP, "stop": False}, M1, BACK, {"stop": {"z_mm": 90.0, "semi_diameter_mm": 1.0}}, ["behind", "mirror"]),
        (STOP, {**FACE, "kind": "conc"}, BACK, {}, ["unknown surface.1.kind 'conc'", "did you mean conic"]),
        (STOP, {**FACE, "kind": "sphere"}, BACK, {}, ["'surface.1.conic'", "kind = 'conic'"])),
    *rows(
        ConfigError,
        lambda: replace(
            mirror := table_lens({**M1, "stop": True, "semi_diameter_mm": 9.0}),
            surfaces=(replace(mirror.surfaces[0], index_offset=0.1),),
        ),
        ({}, ["the medium behind a mirror must be the one in front of it"]),
    ),
]  # fmt: skip
STOP_TABLE = "[stop]\nz_mm = -1.0\nsemi_diameter_mm = 5.0\n"
ALONE = '[[surface]]\nthickness_mm = 4.6\nmedium = "air"\n\n[stop]\nz_mm = 750.0\nsemi_diameter_mm = 3.9\n'
OPEN_STOP = TRIPLET.replace("semi_diameter_mm = 3.9\n", "")
BEYOND = "= -18.4\nasphere = [1.0]"
LENS_TOML = [
    *edited(MINIMAL, "a.toml",
        ('source = "test"\n', "", "source"),
        ("radius_mm = 50.0", "radios_mm = 50.0", "did you mean 'radius_mm'"),
        ("radius_mm = 50.0", "radius_mm = 0.0", "other than zero"),
        ("radius_mm = 50.0", "radius_mm = nan", "surface.0: radius_mm = nan", "other than zero"),
        ("N-BK7", "N-BK77", "did you mean N-BK7"),
        ('"air"', '"N-BK7"', "it must be 'air'"),
        (STOP_TABLE, "", "exactly one is needed"),
        ("thickness_mm = 5.0\n", "thickness_mm = 5.0\nstop = true\n", "exactly one is needed"),
        ("= 6.0\n[[", "= -6.0\n[[", "semi_diameter_mm = -6.0"),
        ("semi_diameter_mm = 6.0", "semi_diameter_mm = 6.0\ninner_semi_diameter_mm = 7.0", "between 0 and"),
        ("max_field_deg = 2.0", "max_field_deg = 95.0", "below 90"),
        ("[[surface]]", "[[surface", "not valid TOML"),
        ("thickness_mm = 5.0", "thickness_mm = -5.0", "surface 0: thickness_mm = -5 mm of N-BK7 has the wrong sign")),
    *edited(TOML_HEAD, "a.toml",
        (TOML_HEAD, f"{TOML_HEAD}surface = 3", "surface = 3: a list of tables is needed, [[surface]] before each"),
        (TOML_HEAD, f"{TOML_HEAD}surface = [3]", "surface.0 = 3: a table is needed"),
        (TOML_HEAD, f"{TOML_HEAD}[surface]\nradius_mm = 3.0", "surface: a list of tables is needed"),
        (TOML_HEAD, "a = " + "[" * 5000 + "]" * 5000, "not valid TOML")),
    *edited(TRIPLET, "a.toml",
        (STOP_TEXT, ALONE, "image plane lies 689.79 mm in front of the stop", "check stop.z_mm"),
        ("= 42.2", "= -1.5", "image plane lies 1.5 mm in front of surface 6, the last"),
        ("= 3.26", "= -22.0", "surface 0: thickness_mm = -22 mm of N-SK16"),
        ("= 6.0", "= -3.0", "surface 1 and surface 2 cross: at 5 mm", "overlap by 3.5"),
        ("= 3.26", "= 0.5", "surface 0 and surface 1 cross: at 9.5 mm", "N-SK16 between them would be -1.7"),
        ("= 1.0\n", "= 0.0\n", "N-F2 between surface 2 and surface 3 has no thickness on the axis"),
        ("= 3.9", "= 100.0", "surface 4, has semi_diameter_mm = 100 mm", "surface 2 leaves only 4.9"),
        ("= -18.4", BEYOND, "surface 6, the last, reaches the image plane, 42.2 mm"),
        ("= 3.26", "= 3.26e300", "surface.0.thickness_mm = 3.26e+300", "at most 1e+06"),
        ("= 3.26", "= true", "surface.0.thickness_mm = True: a number is needed"),
        ("stop = true", "stop = 'yes'", "surface.4.stop = 'yes': true or false is needed"),
        ("= 22.0", "= 22.0\ntilt_deg = [true, 0.0]", "surface.0.tilt_deg.0 = True: a number is needed"),
        (STOP_TEXT, STOP_TEXT + GLASS_TEXT, "no surface is of glass.NAME"),
        (STOP_TEXT, STOP_TEXT + GLASS_TEXT.replace("NAME", "N-F2"), "glass.N-F2 has the name of a catalogue glass"),
        (TRIPLET, OPEN_STOP, "the stop needs semi_diameter_mm, or in its place a table [pupil]"),
        (TRIPLET, f"{TRIPLET}\n[pupil]\nf_number = 5.0\n", "not both"),
        (TRIPLET, f"{OPEN_STOP}\n[pupil]\nf_number = 1.0\n", "surface 2 leaves only"),
        (TRIPLET, f"{OPEN_STOP}\n[pupil]\n", "needs either f_number or entrance_pupil_diameter_mm"),
        (TRIPLET, TRIPLET.replace('"N-F2"', '"NAME"') + GLASS_TEXT + "cte_per_k = 1e300\n", "glass.NAME.cte_per_k"),
        *(
            (TRIPLET, TRIPLET.replace('"N-F2"', '"melt 7"') + f'\n[glass."melt 7"]\n{table}\n', *words)
            for table, *words in (
                ('file = "none.agf"', "glass.melt 7.file", "none.agf: no such file"),
                ('file = "f2.txt"', "f2.txt: a catalogue (.agf) or a material of refractiveindex.info"),
                ('file = "f2.yml"\nnd = 1.6', "glass.melt 7.nd is not allowed together with file"),
                ("file = 3", "glass.melt 7.file = 3: text"),
            )
        )),
    *rows(ConfigError, load_lens, ("star_camera_206", {}, ["did you mean star_camera_206mm"])),
    *rows(ConfigError, read_lens_file, ("star_camera_206mm", {"configuration": 2}, ["to .zmx and .seq files only"])),
]  # fmt: skip


def file_of_bytes(name: str, content: bytes | None) -> Callable[[Path], Any]:
    """Read a lens file of these bytes; None: a folder."""

    def call(folder: Path) -> Any:
        if content is None:
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes(content)
        return load_lens(folder / name)

    return call


def big(read: Callable[[Path], Any]) -> Callable[[Path], Any]:
    def call(folder: Path) -> Any:
        with (folder / "big.zmx").open("wb") as file:
            file.truncate(LARGEST_BYTES + 1)
        return read(folder / "big.zmx")

    return call


def pipe(folder: Path) -> Any:
    os.mkfifo(folder / "pipe.toml")
    return load_lens(folder / "pipe.toml")


def folded_of(**last: object) -> LensFile:
    """A lens file whose last surface has these keys."""
    surfaces = [dict(STOP), FACE, {**BACK, **last}]
    table = {"name": "t", "source": "t", "design_wavelength_nm": 600.0, "max_field_deg": 1.0, "surface": surfaces}
    return LensFile(lens=table_lens(*surfaces), tables=table)


TWO = [{"kind": "circle", "radius_mm": r} for r in (5.0, 6.0)]
FORBES = {"kind": "qbfs", "radius_mm": 90.0, "norm_radius_mm": 50.0, "q_mm": [1e-3]}
SHIFTED = {**TWO[0], "centre_mm": [1.0, 0.0], "obscures": True}
VANES = {"kind": "spider", "arms": 3, "width_mm": 1.0}
CORNERS = {**POLYGON, "points_mm": [(0, 0), (1, 0), (0, 1)]}
MELT = {"source": "t", "B": [1.2], "C": [0.01], "range_nm": [400.0, 900.0]}


def writes(name: str, **last: object) -> Callable[[Path], Any]:
    return lambda folder: write_lens(folded_of(**last), folder / name)


LENS_FILES: list[Row] = [
    *((f"{n} absent", lambda f, n=n: load_lens(f / n), ConfigError, ["no such file"]) for n in ("a.toml", "no.zmx")),
    *(
        (f"{name}", lambda f, n=name: load_lens(f / n), ConfigError, [word])
        for name, word in (("a.zbb", "encrypted"), ("a.zar", "archive"), ("a.zmf", "catalogue"), ("a\0b.zmx", "NUL"))
    ),
    ("long file", file_of_bytes("long.zmx", b"SURF 0\n" * 200_001), ConfigError, ["lines are too many"]),
    ("folder", file_of_bytes("folder.zmx", None), ConfigError, ["regular file"]),
    ("empty", file_of_bytes("empty.zmx", b""), ConfigError, ["empty"]),
    ("noise", file_of_bytes("noise.zmx", bytes(range(256)) * 64), ConfigError, ["text"]),
    ("no surface", file_of_bytes("none.zmx", b"MODE SEQ\n"), ConfigError, ["no surface"]),
    ("big lens", big(load_lens), ConfigError, ["MiB"]),
    ("big catalogue", big(read_agf), ConfigError, ["MiB"]),
    ("pipe", pipe, ConfigError, ["not a regular file"]),
    ("suffix", lambda f: load_lens(written(f, "x", "lens.len")), ConfigError, ["binary lens file of CODE V"]),
    ("write suffix", writes("lens.len"), ConfigError, [".toml"]),
    ("write folder", writes("nowhere/lens.zmx"), ConfigError, ["cannot be written"]),
    ("write measured", lambda f: write_measured_lens(measured(), f / "a.zmx"), ConfigError, [".toml"]),
    ("seq kind", writes("a.seq", **FORBES), ConfigError, ["'qbfs' cannot be written as .seq"]),
    ("seq aperture", writes("a.seq", aperture=[VANES]), ConfigError, ["spider"]),
    ("seq centres", writes("a.seq", semi_diameter_mm=9.0, aperture=[SHIFTED]), ConfigError, ["centre"]),
    ("zmx apertures", writes("a.zmx", aperture=TWO), ConfigError, ["single aperture"]),
    ("zmx rotated", writes("a.zmx", aperture=[{**TWO[0], "angle_deg": 5.0}]), ConfigError, ["rotated aperture"]),
    ("zmx polygon", writes("a.zmx", aperture=[CORNERS]), ConfigError, ["polygon"]),
    *edited(ZMX_SINGLET, "a.zmx",
        ("SURF 2", "SURF 1", "line 29", "missing or repeated"),
        ("UNIT MM", "UNIT FURLONG", "line 4", "'FURLONG'", "INCH"),
        ("N-BK7", "UNOBTAINIUM", "line 27", "'UNOBTAINIUM'"),
        ("DISZ 5.0", "DISZ five", "'five'"),
        ("DISZ 5.0", "DISZ INFINITY", "infinite"),
        ("DISZ 5.0", "DISZ", "is missing"),
        ("ENPD 10.0", "ENPD -3", "aperture of -3"),
        ("ENPD 10.0", "OBNA 0.1", "object-side NA 0.1"),
        ("ENPD 10.0", "ENPD 1e9", "5e+08 mm", "below 1e7 mm"),
        ("WAVM 2 0.5876 2", "WAVM 2 5876 2", "wavelength"),
        ("MODE SEQ", "MODE NSC", "sequential"),
        ("FTYP 0 0 2 3", "FTYP 7 0 2 3", "field type 7"),
        ("FTYP 0 0 2 3", "FTYP 0 0 2000 3", "2000 fields", "at most 200"),
        ("YFLN 0 3", "YFLN 0 95", "95 deg"),
        ("FTYP 0 0 2 3", "FTYP 1 0 2 3", "heights", "infinity"),
        ("PWAV 2", "PWAV 2\nMNUM 2 5", "configuration 5 does not exist; it has 2"),
        ("SURF 2\n", "  PZUP 9 1 0 0\nSURF 2\n", "no surface 9"),
        ("SURF 2\n  TYPE STANDARD\n  CURV -0.01\n", "SURF 2\n  STOP\n  TYPE STANDARD\n  CURV -0.01\n", "both the stop"),
        ("  DISZ 60.0", "  SCBD 0 0 0 1\n  DISZ 60.0", "SCBD"),
        ("  DISZ 60.0", "  UDAP 0\n  DISZ 60.0", "UDAP"),
        ("  DISZ 60.0", "  OBSC 1 2 0\n  DISZ 60.0", "begins at 1 mm"),
        *(
            ("TYPE STANDARD\n  CURV 0.02", f"TYPE {kind}\n  CURV 0.02", "surface 1", kind.split("\n")[0], *words)
            for kind, *words in (
                ("BINARY_2",),
                ("GRINSUR1",),
                ("PARAXIAL", "focal length 0"),
                ("QED_TYPE\n  XDAT 1 2", "type than 0"),
                ("QED_TYPE\n  XDAT 2 300", "300 terms"),
                ("TOROIDAL\n  PARM 9 1", "Zernike terms"),
                ("SZERNSAG\n  PARM 1 1", "aspheric terms"),
                ("XASPHERE\n  XDAT 1 999", "999 coefficients"),
            )
        ),
        # the file counts its object as 0, so the lens's first surface is surface 1
        ("DISZ 5.0", "DISZ -5.0", "surface 1 (line 22): thickness_mm = -5 mm"),
        ("CURV 0.02", "CURV 0.2", "surface 1 (line 22): semi_diameter_mm = 5 mm reaches the rim"),
        ("DIAM 7 1", "DIAM 1e300 1", "surface 2 (line 29): semi_diameter_mm = inf"),
        ("DISZ 60.0", "DISZ -60.0", "in front of surface 2 (line 29)"),
        ("DISZ 5.0", "DISZ 0.1", "surface 1 (line 22) and surface 2 (line 29) cross")),
    *edited(SEQ_SINGLET, "a.seq",
        ("DIM M", "DIM FT", "line 4", "'FT'"),
        ("  CIR 7.0", "  DIF DOE", "line 16", "diffractive"),
        ("  CIR 7.0", "  GRN 1", "gradient"),
        ("  CIR 7.0", "  SPS ZRN", "special"),
        ("  CIR 7.0", "  SPS ODD\n  SCO C40 1", "C40", "C1 to C31"),
        ("  CIR 7.0", "  BAS", "(BAS)"),
        ("  CIR 7.0", "  ADE 5; BEN", "BEN is for mirrors"),
        ("  CIR 7.0", "  REX 5", "rectangle aperture needs both"),
        ("  CIR 7.0", "  REX OBS 5", "other than round"),
        ("  CIR 7.0", "  ARO 5", "rotated aperture (ARO)"),
        ("  CIR 7.0", "  CYL; A 1e-6", "with a polynomial"),
        ("  CIR 7.0", "  ASP\n  A 1E-6 B -2E-10", "'B -2E-10' follows the value"),
        ("SI 0.0 0.0", "", "image (SI)"),
        ("SI 0.0 0.0", "SI 0.0 0.0\nS 1 2", "behind the image"),
        ("SO 0.0 0.1e14", "", "object"),
        ("NBK7_SCHOTT", "XYZ9_SCHOTT", "'XYZ9_SCHOTT'"),
        ("5.0 NBK7", "five NBK7", "'five'"),
        ("WL 656.3 587.6 486.1", "", "wavelength"),
        ("XAN 0.0 0.0", "XOB 0.0 0.0", "angles and by heights"),
        ("EPD 10.0", "EPD 0", "aperture of 0"),
        ("GO\n", "THI S9 5\nGO\n", "no surface S9"),
        ("GO\n", "ZOO 2\nZOO GLA 5\nGO\n", "zoom (ZOO) of GLA"),
        ("GO\n", "PIK THI S2\nGO\n", "pickup is not supported"),
        ("SO 0.0", "PRV\nPWL 500 600\n'MY' 1.5\nEND\nSO 0.0", "1 indices at 2 wavelengths"),
        ("SO 0.0", "PRV\nPWL 500 600\n'MY' 1.5 9.0\nEND\nSO 0.0", "outside the range of any glass"),
        ("SO 0.0", "PRV\n'MY' LAU 1 2 3 4 5 6 7\nEND\nSO 0.0", "7 coefficients")),
]  # fmt: skip


def undecided(folder: Path) -> Any:
    """Numbers that may be radii or curvatures."""
    text = SEQ_SINGLET.replace("RDM;", "").replace("EPD 10.0", "EPD 1").replace("50.0", "0.9").replace("-100.0", "-1.1")
    return loaded(folder, text, "a.seq")


def singlet(folder: Path) -> Any:
    return loaded(folder, ZMX_SINGLET, "a.zmx")


LENS_FILES += [
    ("radii or curvatures", undecided, ConfigError, ["RDM Y"]),
    ("label in shape", lambda f: change_shape(singlet(f), 1, "bend", 0.1), DomainError, ["(line 29)", "bend"]),
    ("label in tilt", lambda f: tilt(singlet(f), 9, 0.5), ConfigError, ["index 9", "surface 1 (line 22)"]),
    ("label in paraxial", lambda f: paraxial(tilt(singlet(f), 1, 0.5)), DomainError, ["surface 2 (line 29) is tilted"]),
]
TRACKER = load_lens("star_tracker_26mm")
BARE = replace(TRACKER, glasses={k: replace(g, cte_per_k=None) for k, g in TRACKER.glasses.items()})
COLD = replace(TRACKER, glasses={k: replace(g, dndt=None) for k, g in TRACKER.glasses.items()})
HOUSING = Housing(expansion_per_k=23.6e-6)
CAMERA = load_lens("star_camera_206mm")
RIM_90 = replace(HOUSING, mounts={"L6": Mount(front_radius_mm=90.0)})
ONE_GAUSSIAN = {"share": 1.0, "sigma_x_um": 4.0, "sigma_y_um": 4.0}
LENSES = [
    *rows(ConfigError, decentre, (TRACKER, "L4", 0.1, {}, ["did you mean L"]), (TRACKER, [], 0.1, {}, ["no surface"])),
    *rows(ConfigError, tilt, (TRACKER, 99, 0.1, {}, ["surfaces 0"])),
    *rows(DomainError, tilt, (TRACKER, 0, 0.1, {"pivot_mm": (0.0,)}, ["pivot_mm = (0.0,)"])),
    *rows(DomainError, change_shape,
        (TRACKER, TRACKER.stop_index, "radius_mm", 1.0, {}, ["plane"]),
        (TRACKER, 0, "radius_mm", -30.0, {}, ["changes sign"])),
    *rows(DomainError, change_index, (TRACKER, 1, 1e-4, {}, ["no glass follows"])),
    *rows(DomainError, decentre, (TRACKER, "L1", NAN, {}, ["finite"])),
    *rows(DomainError, partial(change_temperature, temperature_c=40.0, housing_cte_per_k=1e-5),
        (BARE, {}, ["no expansion coefficient"]),
        (COLD, {}, ["no dn/dT data"])),
    *rows(DomainError, moved_element, (CAMERA, "L2", "roll", 0, 1.0, {}, ["'decentre' or 'tilt'"])),
    *rows(DomainError, ThermalState, ({"axial_k": NAN}, ["axial_k = nan K"])),
    *rows(DomainError, heated_lens,
        (CAMERA, ThermalState(mean_k=200.0), HOUSING, {}, ["outside -100"]),
        (CAMERA, ThermalState(mean_k=110.0, axial_k=40.0), HOUSING, {}, ["outside", "of its dn/dT data"]),
        (CAMERA, ThermalState(mean_k=1.0), RIM_90, {}, ["ends inside this radius"])),
    *rows(ConfigError, heated_lens,
        (CAMERA, ThermalState(mean_k=1.0), with_spacers(HOUSING, L11=1e-6), {}, ["did you mean L1"])),
    *rows(DomainError, Housing,
        ({"expansion_per_k": 0.0, "diameter_mm": 0.0}, ["diameter_mm"]),
        ({"expansion_per_k": 1.0}, ["expansion_per_k = 1.0/K"]),
        ({"expansion_per_k": 0.0, "poisson_ratio": 1.0}, ["poisson_ratio = 1.0"])),
    *rows(DomainError, Mount, ({"front_radius_mm": -1.0}, ["Mount.front_radius_mm = -1.0 mm"])),
    *rows(DomainError, first_order_response, ([1.0], {"step_s": 0.01, "constant_s": 0.0}, ["constant_s = 0"])),
    *rows(DomainError, ThermalHistory, ({"time_s": [0.0, 10.0], "values_k": np.zeros((2, 4))}, ["values_k", "(2, 4)"])),
    *rows(StarbenchError, measured,
        ({"component": [{**ONE_GAUSSIAN, "share": 0.5}]}, ["add up to 1"]),
        ({"component": [{**ONE_GAUSSIAN, "sigma_x_um": 0.0}]}, ["must be positive"]),
        ({"component": [{**ONE_GAUSSIAN, "sigma_x_um": [[[4.0]]]}]}, ["component.0.sigma_x_um"]),
        ({"component": [{**ONE_GAUSSIAN, "correlation": 1.0}]}, ["correlation"]),
        ({"vignetting": {"radius_mm": [0.0], "relative_light": [1.0]}}, ["at least two points"]),
        ({"psf": {"wavelength_nm": [500.0, 700.0], "x_mm": [4.0, -4.0]}}, ["increasing"]),
        ({"camera": {"focal_length": 35.0}}, ["focal_length_mm"])),
    *rows(DomainError, trace_pupil, (measured_lens(measured()), [0.0], [0.0], [600.0], {}, ["needs a prescription"])),
    *rows(DomainError, decentre, (measured_lens(measured()), "lens", 0.1, {}, ["needs a prescription"])),
    *rows(DomainError, stopped_down, (measured_lens(measured()), 4.0, {}, ["needs a prescription"])),
    *rows(DomainError, partial(ideal_lens, focal_length_mm=50.0),
        ({"f_number": 2.0, "spot_um": 3.0, "psf_fwhm_px": 1.0}, ["give one of them"]),
        ({"f_number": 0.4}, ["f_number = 0.4", "above 0.5"]),
        ({"f_number": 2.0, "spot_um": -1.0}, ["spot_um = -1.0"])),
]  # fmt: skip


def beyond_its_range(folder: Path) -> Any:
    shape = 'kind = "even_asphere"\nradius_mm = -18.4\nconic = 0.0\nasphere = [0.0, 0.0, 3e-5]'
    check_axial_rays(loaded(folder, TRIPLET.replace("radius_mm = -18.4", shape)))


def marks(**settings: Any) -> Marks:
    n = np.arange(3.0)
    return Marks(**{"name": "stars", "x_px": n, "y_px": 2 * n, **settings})


TOP = [
    ("asphere beyond its range", beyond_its_range, DomainError, ["rays on the axis from", "lost at surface 6"]),
    *rows(DomainError, partial(frame_page, np.eye(2)),
        ({"flags": {"saturated": np.zeros((3, 3), bool)}}, ["flags"]),
        ({"sky": np.zeros((4, 3))}, ["sky"])),
    *rows(DomainError, frame_page, (np.zeros((2, 3, 4)), {}, ["two dim"]), (np.full((2, 2), NAN), {}, ["finite"])),
    *rows(ConfigError, marks, ({"shape": "star"}, ["circle, square"])),
    *rows(DomainError, marks, ({"columns": {"flux": [1, 2]}}, ["flux has 2 values for 3"])),
    ("page", lambda f: save_frame_page(f / "absent" / "a.html", np.eye(2)), ConfigError, ["cannot be written"]),
    *rows(DomainError, aberrated, ([[0.0, 0, 1]], [3e5, 0, 0], {}, ["300000 km/s", "speed of light"])),
    *rows(DomainError, aberrated, ([0.0, 0, 1], [1.0, 0, 0], {}, ["(n, 3)"])),
    ("record of another", lambda f: read_record(written(f, "{}", "a.json"), dict), ConfigError, ["a.json"]),
    ("no record", lambda f: write_record(f / "a.json", object()), ConfigError, ["object cannot be written"]),
    ("FITS absent", lambda f: image_header(f / "a.fits"), ConfigError, ["no such file"]),
    ("FITS empty", lambda f: image_header(written(f, b"", "a.fits")), ConfigError, ["file is empty"]),
    ("FITS of text", lambda f: image_header(written(f, "x", "a.fits")), ConfigError, ["SIMPLE"]),
    ("FITS zipped", lambda f: image_header(written(f, b"PK\x03\x04  ", "a.fits")), ConfigError, ["packed by zip"]),
]  # fmt: skip
ROOMS = {
    "air": AIR, "glass": [*GLASS, *MATERIALS, *AGF, *COATINGS], "surfaces": SURFACES, "toml": LENS_TOML,
    "files": LENS_FILES, "lenses": LENSES, "top": TOP,
}  # fmt: skip
