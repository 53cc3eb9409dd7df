"""Three lenses as .zmx files against OpticStudio's own numbers, to the digits that were printed.

Ansys Zemax OpticStudio 2025 R2.02, reported by D. Reed (singlet) and "RayPragma" (double Gauss) in optiland issue 710;
2023 R1.02 by "RayPragma" (Hubble Space Telescope; optiland pull request 714). The fourth system of the issue, a Cooke
triplet, has no column of OpticStudio's yet.
"""

import numpy as np
import pytest

from optics import Rays, read_lens_file, trace
from optics.rays.paraxial import axial_paraxial

HEAD = "MODE SEQ\nNAME {name}\nUNIT MM X W X CM MR CPMM\n{aperture}\nGCAT {glass}\nFTYP 0 0 3 3 0 0 0\nXFLN 0 0 0\n"
SINGLET = (63.73364157, 10.0, "LAC9"), (653.29392320, 92.73834630, "STOP")
DOUBLE_GAUSS = (
    (56.20238, 8.75, "N-SSK2"), (152.28580, 0.5, ""), (37.68262, 12.5, "N-SK2"), (0.0, 3.8, "F5"),
    (24.23130, 16.369445, ""), (0.0, 13.747957, "STOP"), (-28.37731, 3.8, "F5"), (0.0, 11.0, "N-SK16"),
    (-37.92546, 0.5, ""), (177.41176, 7.0, "N-SK16"), (-79.41143, 61.487536, ""),
)  # fmt: skip
# M. Laikin, Lens Design, 4th ed. (2007), p. 200: curvature, thickness, glass, conic
HUBBLE = (
    (0.0, 4910.01016, "", 0.0), (1 / -11040.02286, -4910.01016, "MIRROR", -1.001152),
    (1 / -1349.31166, 6365.20955, "MIRROR", -1.483014),
)  # fmt: skip
HUBBLE_RAYS = (  # as RAYS; the image is a sphere
    ((0.0, 0.0), (0.0, 1.0), (0.0, 0.000292798, 0.0, -0.020832193)),
    ((0.0, 0.0), (0.0, 0.7), (0.0, 0.000224337, 0.0, -0.014582932)),
    ((0.0, 1.0), (0.0, 0.0), (0.0, 150.423380108, 0.0, 0.021668821)),
    ((0.0, 1.0), (0.0, 1.0), (0.0, 150.415481283, 0.0, 0.000731952)),
    ((0.0, 1.0), (0.0, -1.0), (0.0, 150.483684128, 0.0, 0.042499115)),
    ((0.0, 0.7), (0.7, 0.0), (0.011252785, 105.43303112, -0.014598926, 0.015153183)),
)
# HOYA LAC9: n^2 = A0 + A1 l^2 + A2 l^-2 + ... as in the maker's catalogue
HOYA = """CC HOYA
NM LAC9 1 691547 1.690996 54.698047 0 3 5
CD 2.808152300 -1.416788500E-002 1.769370700E-002 7.678875900E-004 -7.488617400E-005 4.704475600E-006
LD 0.365 1.014
"""
RAYS = (  # normalised field (angle) and pupil; x, y [mm], L, M in the image surface
    ((0.0, 0.0), (0.0, 1.0), (0.0, -0.018003289, 0.0, -0.100148243)),
    ((0.0, 0.0), (0.0, 0.7), (0.0, -0.006469740, 0.0, -0.070053570)),
    ((0.0, 1.0), (0.0, 0.0), (0.0, 24.669769254, 0.0, 0.198075144)),
    ((0.0, 1.0), (0.0, 1.0), (0.0, 24.623905450, 0.0, 0.102966617)),
    ((0.0, 1.0), (0.0, -1.0), (0.0, 24.713715770, 0.0, 0.292811109)),
    ((0.0, 0.7), (0.7, 0.0), (-0.024622880, 17.191430724, -0.069514854, 0.144119690)),
)


def read(tmp_path, name, rows, aperture, glass, fields, waves):
    lines = [HEAD.format(name=name, aperture=aperture, glass=glass) + f"YFLN {' '.join(map(str, fields))}"]
    lines += [f"WAVM {i} {wave} 1" for i, wave in enumerate(waves, 1)] + ["PWAV 2", "SURF 0", "  DISZ INFINITY"]
    for i, (radius, thickness, what) in enumerate(rows, 1):
        lines += [f"SURF {i}", f"  CURV {1.0 / radius if radius else 0.0!r}", f"  DISZ {thickness}"]
        lines += ["  STOP"] if what == "STOP" else [f"  GLAS {what} 0 0 1.5 40"] if what else []
    (tmp_path / "HOYA.AGF").write_text(HOYA)
    path = tmp_path / f"{name}.zmx"
    path.write_text("\n".join([*lines, f"SURF {len(rows) + 1}", "  DISZ 0"]))
    return read_lens_file(path)


def test_first_order_of_a_singlet_with_its_stop_behind(tmp_path):
    waves = (0.48613270, 0.58756180, 0.65627250)
    file = read(tmp_path, "singlet", SINGLET, "ENPD 25", "HOYA", (0.0, 3.5, 5.0), waves)
    p, image_z = axial_paraxial(file.lens, 587.56180), float(file.lens.image_position_mm[2])
    assert p.efl_mm == pytest.approx(101.501826, abs=5e-7)
    assert 2.0 * p.entrance_pupil_radius_mm == pytest.approx(25.0, abs=5e-7)
    assert p.entrance_pupil_z_mm == pytest.approx(6.318809, abs=5e-7)
    assert 2.0 * p.exit_pupil_radius_mm == pytest.approx(23.39711, abs=5e-6)
    assert p.exit_pupil_z_mm - image_z == pytest.approx(-92.73835, abs=5e-6)
    assert p.f_number == pytest.approx(4.060073, abs=5e-7)
    assert p.rear_focus_z_mm - image_z == pytest.approx(2.255622, abs=5e-7)
    assert p.rear_principal_z_mm - image_z == pytest.approx(-99.246204, abs=5e-7)


def test_real_rays_of_a_double_gauss(tmp_path):
    """Without ray aiming: rays start in the paraxial entrance pupil. Nine decimals of positions and cosines."""
    file = read(tmp_path, "gauss", DOUBLE_GAUSS, "FNUM 5 0", "SCHOTT", (0.0, 10.0, 14.0), (0.4861, 0.5876, 0.6563))
    lens = file.lens
    p = axial_paraxial(lens, 587.6)
    for (_, field), (px, py), printed in RAYS:
        slope = np.tan(np.radians(14.0 * field))
        start = p.entrance_pupil_radius_mm * np.array([px, py])
        ray = trace(lens, Rays.create(x_mm=start[0], y_mm=start[1], z_mm=p.entrance_pupil_z_mm,
                                      direction=[0.0, slope, 1.0], wavelength_nm=587.6))  # fmt: skip
        assert [float(v) for v in (ray.x, ray.y, ray.dx, ray.dy)] == pytest.approx(printed, rel=0, abs=5.05e-10)


def test_first_order_and_real_rays_of_the_hubble_telescope(tmp_path):
    """Mirrors, conics, a curved image (rays go on from its vertex plane to the sphere). Rays: one of the ninth decimal.
    The focal length was printed from a file of nine digits, which moves it by 1e-3 mm."""
    lines = [
        "MODE SEQ\nUNIT MM X W X CM MR CPMM\nENPD 2400\nFTYP 0 0 2 1 0 0 0\nXFLN 0 0\nYFLN 0 0.15\nWAVM 1 0.55 1",
        "SURF 0\n  DISZ INFINITY",
    ]
    for i, (curvature, thickness, glass, conic) in enumerate(HUBBLE, 1):
        lines += [f"SURF {i}", f"  CURV {curvature!r}", f"  CONI {conic}", f"  DISZ {thickness}"]
        lines += [f"  GLAS {glass} 0 0 1.5 40"] if glass else []
        lines += ["  STOP", "  CLAP 177.80035 1200 0"] if i == 2 else []
    radius = -635.38227
    (tmp_path / "hubble.zmx").write_text("\n".join([*lines, "SURF 4", f"  CURV {1.0 / radius!r}", "  DISZ 0"]))
    lens = read_lens_file(tmp_path / "hubble.zmx").lens
    p, image_z = axial_paraxial(lens, 550.0), float(lens.image_position_mm[2])
    assert p.efl_mm == pytest.approx(57600.079948, abs=2e-3)
    assert p.f_number == pytest.approx(24.00003, abs=5e-6)
    assert p.entrance_pupil_z_mm == pytest.approx(4910.01, abs=5e-3)
    assert 2.0 * p.exit_pupil_radius_mm == pytest.approx(289.9321, abs=5e-5)
    assert p.exit_pupil_z_mm - image_z == pytest.approx(-6958.364, abs=5e-4)
    assert p.rear_focus_z_mm - image_z == pytest.approx(0.01686423, abs=1e-6)
    for (_, field), (px, py), printed in HUBBLE_RAYS:
        ray = trace(lens, Rays.create(x_mm=1200.0 * px, y_mm=1200.0 * py, z_mm=p.entrance_pupil_z_mm,
                                      direction=[0.0, np.tan(np.radians(0.15 * field)), 1.0],
                                      wavelength_nm=550.0))  # fmt: skip
        along = float(ray.x * ray.dx + ray.y * ray.dy - radius * ray.dz)
        height2 = float(ray.x**2 + ray.y**2)
        path = -height2 / (along + np.copysign(np.sqrt(along**2 - height2), along))
        traced = [ray.x + path * ray.dx, ray.y + path * ray.dy, ray.dx, ray.dy]
        assert [float(v) for v in traced] == pytest.approx(printed, rel=0, abs=1e-9)
