"""Which stars fall on the detector, against chief rays one by one; and what the renderer makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from fields import star_catalog
from scipy.spatial.transform import Rotation

from optics.frames import field_angles_deg
from optics.light.band import TopHat
from optics.rays.chief_ray import chief_ray_points
from render.catalogue.index import build_index
from render.catalogue.motion import Observer, directions_at
from render.catalogue.record import MAS_RAD
from render.catalogue.temperature import star_temperature
from render.sky.field import field_of, field_of_view
from render.sky.star_light import star_light

LENSES = ["star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm"]


def sky_of(count=40000, **changes):
    rng = np.random.default_rng(8)
    fields = {
        "bp_rp_mag": rng.uniform(0, 2, count),
        "proper_motion_rad_per_year": rng.normal(0, 500, (count, 2)) * MAS_RAD,
        "parallax_rad": rng.uniform(1, 100, count) * MAS_RAD,
    }
    return star_catalog(count, **fields | changes)


@pytest.fixture(scope="module")
def index():
    return build_index(sky_of())


def chief_px(camera, v_cam):
    """Pixels of chief rays, ray by ray."""
    return np.stack(camera.to_pixel(*chief_ray_points(camera.focused_lens, *field_angles_deg(v_cam))), axis=-1)


@pytest.mark.parametrize("lens", LENSES)
def test_polynomial_is_the_chief_ray(bench, lens):
    camera = bench.camera_of(lens)
    view = field_of_view(camera)
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-16, camera.width_px + 15, 200), rng.uniform(-16, camera.height_px + 15, 200)
    v = camera.nominal_direction(x, y, bench.focal_length_mm(camera))
    v = v[view.inside(v)]
    np.testing.assert_allclose(view.pixel_of(v), chief_px(camera, v), atol=1e-3)
    assert view.residual_px < 1e-3
    assert len(v) > 150


OFF_AXIS = {"width_px": 512, "height_px": 256, "centre_px": np.array([100.0, 200.0])}


@pytest.mark.parametrize(("lens", "part"), [*((lens, {}) for lens in LENSES), ("star_tracker_26mm", OFF_AXIS)])
def test_all_stars_of_the_frame_and_no_other(bench, index, lens, part):
    camera = replace(bench.camera_of(lens), **part)
    view = field_of_view(camera, margin_px=10.0)
    attitude = Rotation.random(random_state=0)
    field = field_of(index, view, attitude, epoch_year=2030.0)
    v = directions_at(index.catalog, 2030.0) @ attitude.as_matrix().T
    rows = np.flatnonzero(v[:, 2] > np.cos(1.1 * view.radius_rad))
    pixel = chief_px(camera, v[rows])
    size = np.array([camera.width_px, camera.height_px])
    on = ((pixel > -10.5 - 1e-6) & (pixel < size + 9.5 + 1e-6)).all(axis=1)
    assert field.row.tolist() == rows[on].tolist()
    np.testing.assert_allclose(field.pixel_px, pixel[on], atol=1e-3)
    assert (field.stars.id == field.row).all()


def test_margin_and_magnitude(bench, index):
    camera = bench.camera_of("star_tracker_26mm")
    attitude = Rotation.random(random_state=1)
    wide = field_of(index, field_of_view(camera, margin_px=40.0), attitude)
    none = field_of(index, field_of_view(camera, margin_px=0.0), attitude)
    bright = field_of(index, field_of_view(camera, margin_px=0.0), attitude, magnitude_limit=5.0)
    assert set(none.row) < set(wide.row)
    assert set(bright.row) == {row for row in none.row if index.catalog.magnitude[row] <= 5.0}


def test_observer_moves_the_stars(bench, index):
    view = field_of_view(bench.camera_of("star_tracker_26mm"))
    attitude = Rotation.random(random_state=1)
    observer = Observer(position_au=np.array([0.3, 0.9, 0.1]), velocity_km_per_s=np.array([20.0, -20.0, 5.0]))
    field = field_of(index, view, attitude, epoch_year=2026.0, observer=observer)
    np.testing.assert_allclose(
        field.direction, directions_at(index.catalog, 2026.0, observer)[field.row], rtol=0, atol=1e-15
    )
    at_rest = field_of(index, view, attitude, epoch_year=2026.0)
    both, here, there = np.intersect1d(field.row, at_rest.row, return_indices=True)
    shift = np.linalg.norm(field.pixel_px[here] - at_rest.pixel_px[there], axis=1)
    assert len(both) > 0.9 * len(field)
    assert 0.03 < shift.max() < 0.3  # at most 19.9", and a pixel of 79"


def test_no_star_there(bench):
    lonely = build_index(sky_of(1, direction=[[0.0, 0.0, 1.0]]))
    view = field_of_view(bench.camera_of("star_camera_206mm"))
    field = field_of(lonely, view, Rotation.from_euler("x", 90, degrees=True))
    assert len(field) == 0
    light = star_light([TopHat(centre_nm=600, width_nm=100)])
    stars = light.stars(field.direction, field.stars.magnitude, star_temperature(field.stars))
    assert stars.photon_rate.shape == (0, 1, 5)
