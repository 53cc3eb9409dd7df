"""A Maksutov, a Mangin mirror, tilted and folded lenses against optiland, which keeps rays in global coordinates."""

import warnings

import numpy as np
import pytest
from lens_texts import table_lens

from optics.glass.air import air_index
from optics.rays.trace import Rays, trace

pytestmark = [pytest.mark.reference, pytest.mark.slow]

STOP = {"kind": "plane", "thickness_mm": 20.0, "medium": "air", "stop": True, "semi_diameter_mm": 40.0}
MENISCUS = [
    {"radius_mm": -105.0, "thickness_mm": 10.0, "medium": "N-BK7"},
    {"radius_mm": -109.0, "thickness_mm": 180.0, "medium": "air"},
]
# through the meniscus to the primary, back to an aluminised spot on the meniscus's second face, and out
MAKSUTOV = [
    STOP,
    *MENISCUS,
    {"radius_mm": -480.0, "conic": 0.1, "thickness_mm": -180.0, "medium": "mirror"},
    {"radius_mm": -109.0, "thickness_mm": 230.0, "medium": "mirror"},
]
# a mirror of glass, silvered behind: light passes the same face twice
MANGIN = [
    STOP,
    {"radius_mm": -300.0, "thickness_mm": 8.0, "medium": "N-BK7"},
    {"radius_mm": -420.0, "thickness_mm": -8.0, "medium": "mirror"},
    {"radius_mm": -300.0, "thickness_mm": -250.0, "medium": "air"},
]


def ours(surfaces, start, direction):
    lens = table_lens(*surfaces)
    x, y = start
    rays = Rays.create(x_mm=x, y_mm=y, z_mm=-10.0, direction=direction, wavelength_nm=600.0)
    return lens, trace(lens, rays)


def theirs(lens, surfaces, poses, start, direction):
    """The same rays through optiland, in its global frame; lengths in mm."""
    optic_module = pytest.importorskip("optiland.optic")  # three seconds, which no collection should take
    materials = pytest.importorskip("optiland.materials")
    n_air = float(air_index(600.0, 20.0, 1013.25))
    optic = optic_module.Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    for i, (table, pose) in enumerate(zip(surfaces, poses, strict=True), 1):
        glass = table["medium"]
        material = "mirror" if glass == "mirror" else materials.IdealMaterial(n=1.0)
        if glass not in ("mirror", "air"):
            material = materials.IdealMaterial(n=float(lens.glasses[glass].index(600.0)))
        optic.surfaces.add(
            index=i, radius=table.get("radius_mm", np.inf), conic=table.get("conic", 0.0), material=material,
            is_stop=i == 1, **pose,
        )  # fmt: skip
    optic.surfaces.add(index=len(surfaces) + 1, z=1e3)
    from optiland.rays import RealRays

    x, y = start
    d = np.broadcast_to(np.array(direction) / np.linalg.norm(direction), (len(x), 3)).T.copy()
    rays = RealRays(x.copy(), y.copy(), np.full(len(x), -10.0), *d, np.ones(len(x)), np.full(len(x), 0.6))
    for surface in list(optic.surfaces)[1:-1]:
        rays = surface.trace(rays)
    return np.array([rays.x, rays.y, rays.z]), np.array([rays.L, rays.M, rays.N]), n_air * np.array(rays.opd)


def agree(lens, out, surfaces, poses, start, direction):
    """Optiland's last points, carried on to our image plane, are ours in its frame, paths and directions too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        point, along, opd = theirs(lens, surfaces, poses, start, direction)
    assert out.ok.all()
    local = lens.image_rotation.T @ (point - lens.image_position_mm[:, None])
    along = lens.image_rotation.T @ along
    path = -local[2] / along[2]
    np.testing.assert_allclose([out.x, out.y], (local + path * along)[:2], atol=1e-10)
    np.testing.assert_allclose([out.dx, out.dy], along[:2], atol=1e-13)
    np.testing.assert_allclose(out.opl_mm, opd + float(lens.indices(600.0)[0]) * path, atol=1e-9)


def bundle(half):
    side = np.linspace(-half, half, 9)
    return tuple(v.ravel() for v in np.meshgrid(side, side))


@pytest.mark.parametrize(("surfaces", "half"), [(MAKSUTOV, 27.0), (MANGIN, 27.0)], ids=["maksutov", "mangin"])
@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.01, -0.015, 1.0)])
def test_catadioptric_rays_agree_with_optiland(surfaces, half, direction):
    start = bundle(half)
    lens, out = ours(surfaces, start, direction)
    z = np.concatenate([[0.0], np.cumsum([s["thickness_mm"] for s in surfaces])])
    agree(lens, out, surfaces, [{"z": float(v)} for v in z[:-1]], start, direction)


def spun(x_deg, y_deg, z_deg):
    """Optiland's rotation: about the fixed x, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians([x_deg, y_deg, z_deg])) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def pose(origin, angles):
    return {**dict(zip("xyz", map(float, origin), strict=True)),
            **dict(zip(("rx", "ry", "rz"), np.radians(angles).tolist(), strict=True))}  # fmt: skip


LENS = [{"radius_mm": 120.0, "thickness_mm": 9.0, "medium": "N-BK7"},
        {"radius_mm": -90.0, "conic": -0.8, "thickness_mm": 60.0, "medium": "air"}]  # fmt: skip


@pytest.mark.parametrize("angles", [(3.0, 5.0, 0.0), (3.0, 5.0, 10.0), (-8.0, 2.0, 30.0)])
def test_a_tilted_and_decentred_lens_agrees_with_optiland(angles):
    table = [STOP, {"kind": "coordinate_break", "decentre_mm": [0.5, -0.3], "tilt_deg": list(angles)}, *LENS]
    start = bundle(20.0)
    lens, out = ours(table, start, (0.02, 0.01, 1.0))
    turn, origin = spun(*angles), np.array([0.5, -0.3, 20.0])
    poses = [pose([0.0, 0.0, 0.0], (0.0, 0.0, 0.0)), pose(origin, angles), pose(origin + 9.0 * turn[:, 2], angles)]
    agree(lens, out, [STOP, *LENS], poses, start, (0.02, 0.01, 1.0))


def test_a_lens_behind_a_fold_mirror_agrees_with_optiland():
    """The beam goes down to -y; behind the mirror thicknesses are negative and radii count in the file's frame."""
    fold = {"kind": "plane", "tilt_deg": [45.0, 0.0], "carry": "bend", "thickness_mm": -30.0, "medium": "mirror"}
    behind = [{**s, "radius_mm": -s["radius_mm"], "thickness_mm": -s["thickness_mm"]} for s in LENS]
    start = bundle(15.0)
    lens, out = ours([STOP, fold, *behind], start, (0.02, 0.01, 1.0))
    mirror, axis = np.array([0.0, 0.0, 20.0]), spun(90.0, 0.0, 0.0)[:, 2]
    square = (90.0, 0.0, 0.0)
    poses = [pose([0.0, 0.0, 0.0], (0.0, 0.0, 0.0)), pose(mirror, (45.0, 0.0, 0.0)),
             pose(mirror - 30.0 * axis, square), pose(mirror - 39.0 * axis, square)]  # fmt: skip
    agree(lens, out, [STOP, fold, *behind], poses, start, (0.02, 0.01, 1.0))
