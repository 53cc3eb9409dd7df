"""Lenses that cannot be, files that are none: one line that names the thing, its value and its range."""

import os

import pytest
from refusals import refuses

from optics import load_lens, paraxial, read_lens_file
from optics.errors import ConfigError, DomainError
from optics.export.write import write_lens
from optics.rays.marginal_rays import check_axial_rays

STOP = """[[surface]]
stop = true
thickness_mm = 4.6
medium = "air"
semi_diameter_mm = 3.9
"""
TRIPLET = f"""name = "triplet"
source = "a Cooke triplet"
design_wavelength_nm = 587.6
max_field_deg = 20.0

[[surface]]
radius_mm = 22.0
thickness_mm = 3.26
medium = "N-SK16"
semi_diameter_mm = 9.5

[[surface]]
radius_mm = -435.8
thickness_mm = 6.0
medium = "air"
semi_diameter_mm = 9.5

[[surface]]
radius_mm = -22.2
thickness_mm = 1.0
medium = "N-F2"
semi_diameter_mm = 5.0

[[surface]]
radius_mm = 20.3
thickness_mm = 0.2
medium = "air"
semi_diameter_mm = 5.0

{STOP}
[[surface]]
radius_mm = 79.7
thickness_mm = 2.95
medium = "N-SK16"
semi_diameter_mm = 7.5

[[surface]]
radius_mm = -18.4
thickness_mm = 42.2
medium = "air"
semi_diameter_mm = 7.5
"""
ALONE = "\n[stop]\nz_mm = 750.0\nsemi_diameter_mm = 3.9\n"
GLASS = """
[glass.NAME]
source = "none"
B = [1.0, 0.0, 0.0]
C = [0.0, 0.0, 0.0]
range_nm = [300.0, 1000.0]
"""


def loaded(tmp_path, text):
    path = tmp_path / "lens.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_lens(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (STOP, ALONE, r"image plane lies 694\.39 mm in front of the stop; .* check stop\.z_mm"),
        ("= 42.2", "= -1.5", r"image plane lies 1\.5 mm in front of surface 6, the last"),
        ("= 3.26", "= -22.0", r"surface 0: thickness_mm = -22 mm of N-SK16"),
        ("= 6.0", "= -3.0", r"surface 1 and surface 2 cross: at 5 mm from the axis they would overlap by 3\.5"),
        ("= 3.26", "= 0.5", r"surface 0 and surface 1 cross: at 9\.5 mm .* N-SK16 between them would be -1\.7"),
        ("= 7.5", "= 15.0", r"surface 5 and surface 6 cross: at 15 mm .* N-SK16 between them would be -6\.2"),
        ("= 1.0\n", "= 0.0\n", r"N-F2 between surface 2 and surface 3 has no thickness on the axis"),
        ("= 3.9", "= 100.0", r"surface 4, has semi_diameter_mm = 100 mm, .* surface 2 leaves only 4\.9"),
        ("= 22.0", "= 22.0\nasphere = [1.0]", r"surface 0 and surface 1 cross"),
        ("= -18.4", "= -18.4\nasphere = [1.0]", r"surface 6, the last, reaches the image plane, 42\.2 mm"),
        ("= 3.26", "= 3.26e300", r"surface\.0\.thickness_mm = 3\.26e\+300: .*at most 1e\+06"),
        ("= 3.26", "= true", r"surface\.0\.thickness_mm = True: a number is needed"),
        ("= 22.0", "= '22.0'", r"surface\.0\.radius_mm = '22\.0': a number is needed"),
        ("stop = true", "stop = 'yes'", r"surface\.4\.stop = 'yes': true or false is needed"),
        ("= 22.0", "= 22.0\ntilt_deg = [true, 0.0]", r"surface\.0\.tilt_deg\.0 = True: a number is needed"),
        (STOP, STOP + GLASS, r"no surface is of glass\.NAME"),
        (STOP, STOP + GLASS.replace("NAME", "N-F2"), r"glass\.N-F2 has the name of a catalogue glass"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, old, new, said):
    assert old in TRIPLET
    assert loaded(tmp_path, TRIPLET).name == "triplet"
    refuses(ConfigError, said, lambda: loaded(tmp_path, TRIPLET.replace(old, new)))


@pytest.mark.parametrize("pupil", ["f_number = 5.0", "entrance_pupil_diameter_mm = 10.0"])
def test_a_pupil_stands_for_the_radius_of_the_stop(tmp_path, pupil):
    text = TRIPLET.replace("semi_diameter_mm = 3.9\n", "")
    p = paraxial(loaded(tmp_path, f"{text}\n[pupil]\n{pupil}\n"))
    wanted = p.f_number if pupil.startswith("f") else 2.0 * p.entrance_pupil_radius_mm
    assert wanted == pytest.approx(float(pupil.split()[-1]), rel=1e-12)
    refuses(ConfigError, r"the stop needs semi_diameter_mm, or in its place a table \[pupil\]", loaded, tmp_path, text)
    refuses(ConfigError, "not both", loaded, tmp_path, f"{TRIPLET}\n[pupil]\n{pupil}\n")
    refuses(ConfigError, r"surface 2 leaves only", loaded, tmp_path, f"{text}\n[pupil]\nf_number = 1.0\n")


def test_an_expansion_that_no_glass_has_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"glass\.NAME\.cte_per_k = 1e\+300"):
        loaded(tmp_path, TRIPLET.replace('"N-F2"', '"NAME"') + GLASS + "cte_per_k = 1e300\n")


def test_glasses_of_files(tmp_path):
    """F2 of SCHOTT's catalogue by its printed coefficients, as AGF and as refractiveindex.info write them."""
    b, c = (1.34533359, 0.209073176, 0.937357162), (0.00997743871, 0.0470450767, 111.886764)
    pairs = " ".join(f"{x} {y}" for x, y in zip(b, c, strict=True))
    (tmp_path / "mine.AGF").write_text(f"NM F2 2 0 1.62004 36.37\nED 8.2 9.2 3.6 0 0\nCD {pairs}\nLD .32 2.5\n")
    roots = " ".join(f"{x} {y**0.5}" for x, y in zip(b, c, strict=True))
    data = f"DATA:\n  - type: formula 1\n    wavelength_range: 0.32 2.5\n    coefficients: 0 {roots}\n"
    (tmp_path / "f2.yml").write_text(data)
    text = TRIPLET.replace('"N-F2"', '"melt 7"')
    for table in ('file = "mine.AGF"\nname = "F2"', 'file = "f2.yml"'):
        lens = loaded(tmp_path, f'{text}\n[glass."melt 7"]\n{table}\n')
        assert float(lens.glasses["melt 7"].index(587.5618)) == pytest.approx(1.62004, abs=5e-6)
    written = write_lens(read_lens_file(tmp_path / "lens.toml"), tmp_path / "whole.toml")
    assert float(load_lens(written[0]).glasses["melt 7"].index(587.5618)) == pytest.approx(1.62004, abs=5e-6)
    for table, said in (
        ('file = "mine.AGF"', r"glass\.melt 7\.file: unknown glass of catalogue MINE 'melt 7'"),
        ('file = "none.agf"', r"glass\.melt 7\.file: .*none\.agf: no such file"),
        ('file = "f2.txt"', r"f2\.txt: a catalogue \(\.agf\) or a material of refractiveindex\.info"),
        ('file = "f2.yml"\nnd = 1.6', r"glass\.melt 7\.nd is not allowed together with file"),
        ("file = 3", r"glass\.melt 7\.file = 3: text"),
    ):
        refuses(ConfigError, said, loaded, tmp_path, f'{text}\n[glass."melt 7"]\n{table}\n')


def test_an_asphere_beyond_its_range_is_refused_where_light_is_traced(tmp_path):
    shape = 'kind = "even_asphere"\nradius_mm = -18.4\nconic = 0.0\nasphere = [0.0, 0.0, 3e-5]'
    lens = loaded(tmp_path, TRIPLET.replace("radius_mm = -18.4", shape))
    refuses(DomainError, r"rays on the axis from .* mm on are lost at surface 6 \(missed|total", check_axial_rays, lens)
    check_axial_rays(loaded(tmp_path, TRIPLET))


def test_files_that_are_none(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    refuses(ConfigError, "not a regular file", load_lens, tmp_path / "pipe.toml")
    refuses(ConfigError, "NUL character", load_lens, f"{tmp_path}/a\0b.toml")
    refuses(ConfigError, "not valid TOML", loaded, tmp_path, "a = " + "[" * 5000 + "]" * 5000)
    assert loaded(tmp_path, b"\xef\xbb\xbf" + TRIPLET.encode()).name == "triplet"
