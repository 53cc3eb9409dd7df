"""Lens files with a pupil in place of a stop radius, and with glasses from files."""

import pytest
from lens_texts import TRIPLET, loaded
from refusals import refuses

from optics import load_lens, paraxial, read_lens_file
from optics.errors import ConfigError
from optics.export.write import write_lens


@pytest.mark.parametrize("pupil", ["f_number = 5.0", "entrance_pupil_diameter_mm = 10.0"])
def test_a_pupil_stands_for_the_radius_of_the_stop(tmp_path, pupil):
    text = TRIPLET.replace("semi_diameter_mm = 3.9\n", "")
    p = paraxial(loaded(tmp_path, f"{text}\n[pupil]\n{pupil}\n"))
    wanted = p.f_number if pupil.startswith("f") else 2.0 * p.entrance_pupil_radius_mm
    assert wanted == pytest.approx(float(pupil.split()[-1]), rel=1e-12)


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
    refuses(ConfigError, r"glass\.melt 7\.file: unknown glass of catalogue MINE 'melt 7'", loaded, tmp_path,
            f'{text}\n[glass."melt 7"]\nfile = "mine.AGF"\n')  # fmt: skip
