"""Lens files that several tests read, as text, and tables of prescriptions that they change."""

from pathlib import Path

from optics import LensSystem, load_lens
from optics.lens.measured import MeasuredLens, measured_from_table
from optics.lens.prescription import lens_from_table

ZMX_SINGLET = """VERS 190513 80 123457 L123457
MODE SEQ
NAME singlet
UNIT MM X W X CM MR CPMM
ENPD 10.0
ENVD 2.0E+1 1 0
GCAT SCHOTT
FTYP 0 0 2 3 0 0 0
XFLN 0 0
YFLN 0 3
FWGN 1 2
VDYN 0 0.1
WAVM 1 0.4861 1
WAVM 2 0.5876 2
WAVM 3 0.6563 1
WAVM 4 0.55 1
PWAV 2
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.02 0 0 0 0 ""
  DISZ 5.0
  GLAS N-BK7 0 0 1.5 40 0 0 0 0 0 0
  DIAM 7.5 0 0 0 1 ""
SURF 2
  TYPE STANDARD
  CURV -0.01
  DISZ 60.0
  DIAM 7 1 0 0 1 ""
SURF 3
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""
ZMX_DOUBLET = """MODE SEQ
NAME doublet <b>
UNIT MM X W X CM MR CPMM
FNUM 5 0
GCAT SCHOTT
FTYP 0 0 2 2 0 0 0
YFLN 0 2
WAVM 1 0.55 1
WAVM 2 0.65 1
PWAV 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.016
  DISZ 6
  GLAS N-BK7
SURF 2
  CURV -0.02
  DISZ 3
  GLAS SSK5 0 0 1.65844 50.88
SURF 3
  CURV -0.004
  DISZ 100
SURF 4
"""
SEQ_SINGLET = """! a comment
RDM;LEN  "VERSION: 11.2"
TITLE 'Singlet'
EPD 10.0 ; DIM M
WL 656.3 587.6 486.1
REF 2 ; WTW 1 2 1
XAN 0.0 0.0
YAN 0.0 &
 3.0
VUY 0.0 0.2; VLY 0.0 0.1
SO 0.0 0.1e14
S  50.0 5.0 NBK7_SCHOTT
  STO
  CCY 0; THC 0
S  -100.0 60.0  ! last
  CIR 7.0
  CIR EDG 8.0
  PIM
SI 0.0 0.0
GO
"""
TOML_HEAD = 'name = "lens"\nsource = "test"\ndesign_wavelength_nm = 587.6\nmax_field_deg = 20.0\n'
STOP_TEXT = '[[surface]]\nstop = true\nthickness_mm = 4.6\nmedium = "air"\nsemi_diameter_mm = 3.9\n'


def surface_text(radius_mm: float, thickness_mm: float, medium: str, semi_diameter_mm: float) -> str:
    return (
        f'[[surface]]\nradius_mm = {radius_mm}\nthickness_mm = {thickness_mm}\nmedium = "{medium}"\n'
        f"semi_diameter_mm = {semi_diameter_mm}\n"
    )


TRIPLET = "".join(
    (
        TOML_HEAD,
        surface_text(22.0, 3.26, "N-SK16", 9.5),
        surface_text(-435.8, 6.0, "air", 9.5),
        surface_text(-22.2, 1.0, "N-F2", 5.0),
        surface_text(20.3, 0.2, "air", 5.0),
        STOP_TEXT,
        surface_text(79.7, 2.95, "N-SK16", 7.5),
        surface_text(-18.4, 42.2, "air", 7.5),
    )
)
"""A Cooke triplet."""
MINIMAL = (
    'name = "one"\nsource = "test"\ndesign_wavelength_nm = 600.0\nmax_field_deg = 2.0\n[stop]\nz_mm = -1.0\n'
    f"semi_diameter_mm = 5.0\n{surface_text(50.0, 5.0, 'N-BK7', 6.0)}"
    '[[surface]]\nthickness_mm = 90.0\nmedium = "air"\nsemi_diameter_mm = 6.0\n'
)
GLASS_TEXT = """
[glass.NAME]
source = "none"
B = [1.0, 0.0, 0.0]
C = [0.0, 0.0, 0.0]
range_nm = [300.0, 1000.0]
"""
TABLE_HEAD = {"name": "test", "source": "closed form", "design_wavelength_nm": 600.0, "max_field_deg": 1.0}
STOP = {"kind": "plane", "thickness_mm": 10.0, "medium": "air", "stop": True, "semi_diameter_mm": 7.0}
FACE = {"kind": "conic", "radius_mm": 60.0, "conic": -0.6, "thickness_mm": 6.0, "medium": "N-BK7"}
BACK = {"kind": "plane", "thickness_mm": 100.0, "medium": "air"}
PLATE = (
    {"kind": "plane", "thickness_mm": 5.0, "medium": "N-BK7", "semi_diameter_mm": 10.0, "stop": True},
    {"kind": "plane", "thickness_mm": 5.0, "medium": "air", "semi_diameter_mm": 10.0},
)
MEASURED = {
    "kind": "measured",
    "name": "test lens",
    "source": "a test",
    "date": "2026-01-01",
    "reference_wavelength_nm": 600.0,
    "max_field_deg": 12.0,
    "camera": {
        "focal_length_mm": 35.0,
        "principal_point_um": [12.0, -7.0],
        "q1_per_mm2": -1.1e-4,
        "q2_per_mm4": 2e-7,
        "p1_per_mm": 3e-6,
        "p2_per_mm": -2e-6,
        "colour_nm": [500.0, 600.0, 800.0],
        "colour_scale": [1.00002, 1.0, 0.99997],
        "colour_shift_um": [[0.1, 0.2], [0.0, 0.0], [-0.1, -0.3]],
    },
    "psf": {"wavelength_nm": [500.0, 700.0], "x_mm": [-4.0, 4.0], "y_mm": [0.0]},
    "component": [
        {"share": 0.75, "sigma_x_um": [[[4.0, 5.0]], [[4.4, 5.4]]], "sigma_y_um": 4.5, "correlation": 0.3},
        {"share": 0.25, "sigma_x_um": 9.0, "sigma_y_um": 8.0, "offset_x_um": 1.0},
    ],
    "vignetting": {"radius_mm": [0.0, 3.0, 7.0], "relative_light": [1.0, 0.9, 0.5]},
    "throughput": {"aperture_mm": 18.4, "wavelength_nm": [400.0, 900.0], "transmission": [0.8, 0.9]},
}


def written(folder: Path, text: str | bytes, name: str = "lens.toml", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return path


def loaded(folder: Path, text: str | bytes, name: str = "lens.toml") -> LensSystem:
    return load_lens(written(folder, text, name))


def table_lens(*surfaces: dict[str, object], folder: Path | str = ".", **more: object) -> LensSystem:
    """Lens of tables of surfaces."""
    return lens_from_table({**TABLE_HEAD, "surface": surfaces, **more}, where="test", folder=folder)


def measured(**changes: object) -> MeasuredLens:
    return measured_from_table({**MEASURED, **changes}, "test")


def coated(**more: object) -> LensSystem:
    """A plane plate with more keys."""
    return table_lens(*(more.pop("surface", PLATE)), **more)  # type: ignore[misc]


def plate_lens(tilt_deg: float = 0.0) -> LensSystem:
    """A plane plate in front of an ideal lens of 50 mm."""
    face = {"kind": "plane", "semi_diameter_mm": 40.0, "tilt_deg": [tilt_deg, 0.0]}
    thin = {"kind": "paraxial", "focal_length_mm": 50.0, "semi_diameter_mm": 5.0, "stop": True}
    return table_lens(
        {**face, "thickness_mm": 5.0, "medium": "N-BK7"},
        {**face, "thickness_mm": 20.0, "medium": "air"},
        {**thin, "thickness_mm": 50.0, "medium": "air"},
        design_wavelength_nm=550.0, max_field_deg=5.0,
    )  # fmt: skip
