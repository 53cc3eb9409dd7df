"""Measured surface errors against SciPy's splines, root finding, and Fermat's principle."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lens_texts import BACK, FACE, STOP, table_lens
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import brentq

from optics import change_temperature, compile_lens, load_lens
from optics.arrays import NUMPY
from optics.lens.sag_map import SagMap
from optics.rays.reverse import retraced, reverse
from optics.rays.trace import MISSED, Rays, trace, trace_program

COLUMNS, ROWS, WIDTH = np.linspace(-10.0, 10.0, 21), np.linspace(-9.0, 9.0, 16), (20.0, 18.0)


def bumps(x, y):
    """A smooth deviation of some 2 um [mm]."""
    return 2e-3 * np.sin(0.4 * x + 0.3) * np.cos(0.5 * y - 0.2) + 1e-5 * x * y


MAP = SagMap(values_mm=bumps(COLUMNS, ROWS[:, None]), width_mm=WIDTH)


def places(count=300, half=8.9):
    return np.random.default_rng(8).uniform(-half, half, (2, count))


def test_the_map_is_the_spline_through_its_points():
    x, y = places()
    spline = RectBivariateSpline(ROWS, COLUMNS, MAP.values_mm)
    height, along_x, along_y, reached = MAP.at(x, y, NUMPY)
    np.testing.assert_allclose(height, spline(y, x, grid=False), atol=1e-16)
    np.testing.assert_allclose(along_x, spline(y, x, dy=1, grid=False), atol=1e-16)
    np.testing.assert_allclose(along_y, spline(y, x, dx=1, grid=False), atol=1e-16)
    assert reached.all()
    corner = MAP.at(np.array([10.0, -10.0, 10.1, 0.0]), np.array([9.0, -9.0, 0.0, -9.1]), NUMPY)
    np.testing.assert_allclose(corner[0][:2], [MAP.values_mm[-1, -1], MAP.values_mm[0, 0]], atol=1e-17)
    assert corner[3].tolist() == [True, True, False, False]


def test_seen_from_behind_and_expanded():
    x, y = places()
    np.testing.assert_allclose(MAP.flipped().at(x, y, NUMPY)[0], -MAP.at(-x, y, NUMPY)[0], atol=1e-17)
    np.testing.assert_allclose(MAP.scaled(1.1).at(1.1 * x, 1.1 * y, NUMPY)[0], 1.1 * MAP.at(x, y, NUMPY)[0], atol=1e-16)


MIRROR = {"kind": "conic", "radius_mm": -200.0, "conic": -1.0, "thickness_mm": -100.0, "medium": "mirror"}


def written(folder, name="map.npy", unit="nm"):
    values = MAP.values_mm / {"nm": 1e-6, "um": 1e-3, "mm": 1.0}[unit]
    (np.save if name.endswith("npy") else np.savetxt)(folder / name, values)
    return {"file": name, "width_mm": list(WIDTH), "unit": unit}


def measured(folder, face=FACE, **more):
    error = written(folder, **more)
    behind = [BACK] if face is FACE else []
    return table_lens(STOP, {**face, "error": error}, *behind, folder=folder)


def bundle(x, y):
    return Rays.create(x_mm=x, y_mm=y, z_mm=0.0, direction=[0.05, 0.03, 1.0], wavelength_nm=600.0)


def sag(r2):
    return r2 / 60.0 / (1.0 + np.sqrt(1.0 - 0.4 * r2 / 3600.0))


def test_a_ray_meets_sag_plus_map_and_is_refracted_at_its_normal(tmp_path):
    lens, spline = measured(tmp_path), RectBivariateSpline(ROWS, COLUMNS, MAP.values_mm)
    x, y = places(12, 5.0)
    points, after = [], []
    program, theta = compile_lens(lens)

    def keep(number, rays):
        if number == 1:
            points.append(np.stack([rays.x, rays.y, rays.z]))
            after.append(np.stack([rays.dx, rays.dy, rays.dz]))

    trace_program(program, NUMPY.parameters(theta), bundle(x, y), NUMPY, keep)
    d = np.array([0.05, 0.03, 1.0]) / np.linalg.norm([0.05, 0.03, 1.0])
    index = lens.indices(600.0)
    for i in range(12):

        def above(path, i=i):
            px, py, pz = np.array([x[i], y[i], -10.0]) + path * d
            return pz - sag(px**2 + py**2) - float(spline(py, px)[0, 0])

        hit = np.array([x[i], y[i], -10.0]) + brentq(above, 5.0, 15.0, xtol=1e-14) * d
        np.testing.assert_allclose(points[0][:, i], hit, atol=2e-13)
        slope = [float(spline(hit[1], hit[0], **{k: 1})[0, 0]) for k in ("dy", "dx")]
        r2, step = hit[0] ** 2 + hit[1] ** 2, 1e-3
        base = (sag(r2 + step) - sag(r2 - step)) / (2 * step)  # dz/d(r^2)
        normal = np.array([-2 * base * hit[0] - slope[0], -2 * base * hit[1] - slope[1], 1.0])
        normal /= np.linalg.norm(normal)
        tangential = index[1] / index[2] * (d - (d @ normal) * normal)
        refracted = tangential + math.sqrt(1 - tangential @ tangential) * normal
        np.testing.assert_allclose(after[0][:, i], refracted, atol=1e-11)


@pytest.mark.parametrize("face", [FACE, MIRROR], ids=["lens", "mirror"])
def test_light_goes_back_the_way_it_came(face, tmp_path):
    lens = measured(tmp_path, face)
    start = bundle(*places(100, 4.5))
    out = trace(lens, start)
    assert out.ok.all()
    back = trace(reverse(lens), retraced(lens, out))
    np.testing.assert_allclose(-back.x, start.x, atol=2e-13)
    np.testing.assert_allclose(back.y, start.y, atol=2e-13)
    np.testing.assert_allclose(back.opl_mm, out.opl_mm, atol=1e-12)


def test_a_mirror_s_error_counts_twice_in_the_path_and_its_slope_twice_in_the_focus(tmp_path):
    """On a parabola, to first order in an error of 20 nm and in the beam's opening."""
    error = {**written(tmp_path), "scale": 0.01}
    flawed = table_lens(STOP, {**MIRROR, "error": error}, folder=tmp_path)
    perfect = table_lens(STOP, MIRROR)
    x, y = places(200, 4.0)
    start = Rays.create(x_mm=x, y_mm=y, z_mm=0.0, direction=[0.0, 0.0, 1.0], wavelength_nm=600.0)
    one, other = trace(flawed, start), trace(perfect, start)
    n = float(perfect.indices(600.0)[0])
    height, along_x, along_y, _ = (0.01 * v for v in MAP.at(x, y, NUMPY))
    to_focus = one.opl_mm - n * (one.x * one.dx + one.y * one.dy)
    np.testing.assert_allclose(to_focus - other.opl_mm, 2.0 * n * height, atol=1e-7)
    np.testing.assert_allclose(one.x - other.x, 2.0 * 100.0 * along_x, atol=5e-6)
    np.testing.assert_allclose(one.y - other.y, 2.0 * 100.0 * along_y, atol=5e-6)


def test_numpy_and_drjit_agree(tmp_path):
    llvm = pytest.importorskip("drjit.llvm")
    arrays = pytest.importorskip("render.engine.arrays").DrJitArrays(llvm.Float64)
    lens = measured(tmp_path)
    start = bundle(*places(100, 5.0))
    program, theta = compile_lens(lens)
    kinds = {"status": llvm.Int, "failed_at": llvm.Int}
    device = Rays(**{k: kinds.get(k, llvm.Float64)(getattr(start, k)) for k in Rays.__dataclass_fields__})
    for _ in range(2):  # the second time its numbers are there already
        got = trace_program(program, arrays.parameters(theta.tolist()), device, arrays)
        expected = trace(lens, start)
        for name in ("x", "y", "dx", "dy", "dz", "opl_mm"):
            np.testing.assert_allclose(np.array(getattr(got, name)), getattr(expected, name), rtol=0, atol=1e-12)


def test_rays_outside_the_map_are_missed(tmp_path):
    lens = measured(tmp_path)
    out = trace(lens, Rays.create(x_mm=0.0, y_mm=9.5, z_mm=0.0, direction=[0, 0, 1.0], wavelength_nm=600.0))
    assert int(out.status) == 3  # outside the stop
    wide = lens.with_surfaces({0: replace(lens.surfaces[0], semi_diameter_mm=20.0)})
    out = trace(wide, Rays.create(x_mm=0.0, y_mm=9.5, z_mm=0.0, direction=[0, 0, 1.0], wavelength_nm=600.0))
    assert (int(out.status), int(out.failed_at)) == (MISSED, 1)


def test_it_is_read_from_text_beside_the_lens_file_in_any_unit_and_grows_with_the_glass(tmp_path):
    lens = measured(tmp_path, name="map.txt", unit="um")
    np.testing.assert_allclose(lens.surfaces[1].error.values_mm, MAP.values_mm, rtol=1e-15)
    warm = change_temperature(lens, 45.0, housing_cte_per_k=23.6e-6).surfaces[1].error
    growth = math.exp(lens.glasses["N-BK7"].cte_per_k * (45.0 - lens.environment.temperature_c))
    np.testing.assert_allclose(warm.values_mm, growth * MAP.values_mm, rtol=1e-14)
    assert warm.width_mm[0] == pytest.approx(20.0 * growth, rel=1e-14)
    written(tmp_path)
    (tmp_path / "lens.toml").write_text(
        'name = "m"\nsource = "t"\ndesign_wavelength_nm = 600.0\nmax_field_deg = 1.0\n'
        '[[surface]]\nstop = true\nradius_mm = 50.0\nthickness_mm = 5.0\nmedium = "N-BK7"\nsemi_diameter_mm = 8.0\n'
        '[surface.error]\nfile = "map.npy"\nwidth_mm = [20.0, 18.0]\nunit = "nm"\n'
        '[[surface]]\nthickness_mm = 90.0\nmedium = "air"\nsemi_diameter_mm = 8.0\n'
    )
    assert load_lens(tmp_path / "lens.toml").surfaces[0].error is not None
