"""The page "add a surface", followed: its two touches, made in a copy of the program, which then has the new kind."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from optics.glass.catalogue import get_glass

ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "extending" / "add_a_surface.md").read_text(encoding="utf-8")
KINDS = Path("tests", "optics", "lens", "shapes", "test_kinds.py")
REGISTRY = Path("optics", "lens", "shapes", "registry.py")

# the surfaces of the page's lens file, written out once more for an answer that shares no code with the trace
RADIUS, CONIC, A3, A4, THICKNESS, BACK_RADIUS, IMAGE_Z = 60.0, -0.5, 2e-5, -1e-6, 6.0, -300.0, 101.0


def run(folder, *command):
    done = subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """A copy of the program, changed as the page says."""
    folder = tmp_path_factory.mktemp("program")
    no_cache = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "optics", folder / "optics", ignore=no_cache)
    (folder / "render").mkdir()
    (folder / "render" / "__init__.py").write_text("")
    shutil.copytree(ROOT / "render" / "engine", folder / "render" / "engine", ignore=no_cache)
    shape, registry, script, example = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    file = re.search(r"^`(optics/lens/shapes/\w+\.py)`:$", PAGE, re.M)[1]
    (folder / file).write_text(shape, encoding="utf-8")
    listed, count = re.subn(
        r"^SHAPES: .*\n", lambda _: registry, (ROOT / REGISTRY).read_text(encoding="utf-8"), flags=re.M
    )
    assert count == 1
    (folder / REGISTRY).write_text(listed, encoding="utf-8")
    kinds = (ROOT / KINDS).read_text(encoding="utf-8")
    imported = registry.splitlines()[0]
    kinds = kinds.replace("EXAMPLES = (\n", f"{imported}\n\nEXAMPLES = (\n    {example.strip()},\n", 1)
    (folder / KINDS).parent.mkdir(parents=True)
    (folder / KINDS).write_text(kinds, encoding="utf-8")
    shutil.copy(ROOT / "pyproject.toml", folder)
    (folder / "lens.toml").write_text(re.search(r"```toml\n(.*?)```", PAGE, re.S)[1], encoding="utf-8")
    (folder / "script.py").write_text(script, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_the_script_of_the_page_runs_and_draws(program):
    radii_um = [float(number) for number in re.findall(r"\d+\.\d*", run(program, "script.py"))]
    assert len(radii_um) == 2
    assert (program / "lens.png").stat().st_size > 10_000


def sag_of_the_page(r):
    return r**2 / RADIUS / (1.0 + np.sqrt(1.0 - (1.0 + CONIC) * (r / RADIUS) ** 2)) + A3 * r**3 + A4 * r**4


def sag_of_the_back(r):
    return BACK_RADIUS + np.sqrt(BACK_RADIUS**2 - r**2)  # the branch through the vertex of a negative radius


def met(sag, vertex_z, point, direction):
    """Where a ray meets a surface of revolution, and the surface's normal there, by root finding and differences."""

    def above(path):
        x, y, z = point + path * direction
        return z - vertex_z - sag(np.hypot(x, y))

    path = brentq(above, (vertex_z - 3.0 - point[2]) / direction[2], (vertex_z + 3.0 - point[2]) / direction[2])
    hit = point + path * direction
    r, step = np.hypot(*hit[:2]), 1e-3
    slope = (8 * (sag(r + step) - sag(r - step)) - (sag(r + 2 * step) - sag(r - 2 * step))) / (12 * step)
    normal = np.array([-slope * hit[0] / r, -slope * hit[1] / r, 1.0])
    return hit, normal / np.linalg.norm(normal)


def refracted(direction, normal, ratio):
    """Snell's law: the tangential part of n times direction is kept."""
    along = ratio * (direction - (direction @ normal) * normal)
    return along + np.sqrt(1.0 - along @ along) * normal


@pytest.mark.slow
def test_traced_rays_agree_with_root_finding_and_snells_law(program):
    starts = [[0.5, 1.0], [-3.0, 2.0], [2.0, 4.0], [-1.0, -4.5]]
    direction = np.array([0.03, -0.02, 1.0]) / np.linalg.norm([0.03, -0.02, 1.0])
    (program / "trace.py").write_text(f"""
import json
import numpy as np
from optics import Rays, load_lens, trace
x, y = np.array({starts}).T
rays = Rays.create(x_mm=x, y_mm=y, z_mm=-10.0, direction={direction.tolist()}, wavelength_nm=600.0)
out = trace(load_lens("lens.toml"), rays)
assert out.ok.all()
print(json.dumps([out.x.tolist(), out.y.tolist()]))
""")
    traced = np.array(json.loads(run(program, "trace.py"))).T
    glass = get_glass("N-BK7")
    ratio = 1.0 / float(glass.index(600.0))  # catalogue indices are relative to the air the lens stands in
    for (x, y), landed in zip(starts, traced, strict=True):
        point, normal = met(sag_of_the_page, 0.0, np.array([x, y, -10.0]), direction)
        inside = refracted(direction, normal, ratio)
        point, normal = met(sag_of_the_back, THICKNESS, point, inside)
        outside = refracted(inside, normal, 1.0 / ratio)
        point = point + (IMAGE_Z - point[2]) / outside[2] * outside
        np.testing.assert_allclose(landed, point[:2], atol=1e-9)
