"""Clear apertures that a file leaves out, and geometry that no lens can have, in files of design programs."""

import math

import numpy as np
import pytest
from refusals import refuses

from optics import chief_ray_points, load_lens, read_lens_file, vignetting
from optics.errors import ConfigError

PLATE = """MODE SEQ
UNIT MM X W X CM MR CPMM
ENPD 10
FTYP 0 0 2 1 0 0 0
XFLN 0 0
YFLN 0 {field}
VDYN 0 {shift}
VCYN 0 {squeeze}
WAVM 1 0.5876 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  DISZ 20
SURF 2
  TYPE PARAXIAL
  PARM 1 50
  DISZ {gap}
SURF 3
  CURV {front}
  DISZ {thick}
  GLAS N-BK7 0 0 1.5168 64.17
{wide}
SURF 4
  CURV {back}
  DISZ {last}
{wide}
SURF 5
"""
USUAL = {"field": 10, "shift": 0, "squeeze": 0, "gap": 5, "front": 0, "thick": 4, "back": 0, "last": 41.4, "wide": ""}


def written(tmp_path, **changes):
    path = tmp_path / "plate.zmx"
    path.write_text(PLATE.format(**{**USUAL, **changes}))
    return path


@pytest.mark.parametrize(("shift", "squeeze"), [(0.0, 0.0), (-0.2, 0.3)])
def test_an_aperture_that_is_left_out_is_as_wide_as_the_light_of_the_fields(tmp_path, shift, squeeze):
    """By hand: after 20 mm the beam of 10 deg stands 20 tan(10 deg) higher; factors make an ellipse of it."""
    file = read_lens_file(written(tmp_path, shift=shift, squeeze=squeeze))
    azimuth = np.linspace(0.0, 2.0 * math.pi, 100001)
    height = 20.0 * math.tan(math.radians(10.0)) + 5.0 * (shift + (1.0 - squeeze) * np.sin(azimuth))
    edges = [5.0, float(np.hypot(5.0 * np.cos(azimuth), height).max())]
    assert file.lens.surfaces[1].semi_diameter_mm == pytest.approx(1.001 * max(edges), rel=1e-3)
    assert file.tables["surface"][1]["semi_diameter_mm"] == file.lens.surfaces[1].semi_diameter_mm
    notes = [line for line in file.report.inexact if line.command == "clear apertures"]
    assert len(notes) == 1
    assert "2: " in notes[0].message
    light = vignetting(file.lens, [0.0, 10.0], [0.0, 0.0], 587.6)
    assert light[1] == pytest.approx(1.0, abs=1e-9) if not squeeze else light[1] < 0.95
    assert np.isinf(read_lens_file(written(tmp_path), strict=True).lens.surfaces[1].semi_diameter_mm)


def test_a_prescription_of_our_own_may_leave_them_out_too(tmp_path):
    def text(size):
        wide = f"semi_diameter_mm = {size}\n" if size else ""
        front = f'[[surface]]\nkind = "paraxial"\nfocal_length_mm = 50.0\nthickness_mm = 50.0\nmedium = "air"\n{wide}'
        return (
            'name = "a"\nsource = "b"\ndesign_wavelength_nm = 600.0\nmax_field_deg = 10.0\n[[surface]]\nstop = true\n'
            f'thickness_mm = 20.0\nmedium = "air"\nsemi_diameter_mm = 5.0\n{front}'
        )

    (tmp_path / "open.toml").write_text(text(0))
    lens = load_lens(tmp_path / "open.toml")
    assert lens.surfaces[1].semi_diameter_mm == pytest.approx(1.002 * (5.0 + 20.0 * math.tan(math.radians(10.0))))
    (tmp_path / "closed.toml").write_text(text(7))
    assert load_lens(tmp_path / "closed.toml").surfaces[1].semi_diameter_mm == 7.0


def test_rims_that_would_cross_are_closed_to_what_light_needs(tmp_path):
    """Edge thickness 4 - 2 h^2/(2 R) = 0 at h = 12.6 mm for R = 40 mm; a stated 20 mm is closed, light needs 8.6."""
    path = written(tmp_path, front=1 / 40, back=-1 / 40, wide='  DIAM 20 1 0 0 1 ""')
    file = read_lens_file(path)
    closed = [s.semi_diameter_mm for s in file.lens.surfaces[2:4]]
    assert max(closed) < 9.0
    notes = [line for line in file.report.inexact if line.command == "clear aperture"]
    assert [line.surface for line in notes] == [3, 4]
    assert all("20 mm, where it would cross" in line.message and line.line > 0 for line in notes)
    refuses(ConfigError, "cross", read_lens_file, path, strict=True)
    beyond = read_lens_file(written(tmp_path, front=1 / 15, wide='  DIAM 16 1 0 0 1 ""'))
    assert beyond.lens.surfaces[2].semi_diameter_mm < 9.0
    assert any("beyond the rim where the surface ends, 15 mm" in line.message for line in beyond.report.inexact)
    assert np.isfinite(chief_ray_points(beyond.lens, 10.0, 0.0, 587.6)[0])
