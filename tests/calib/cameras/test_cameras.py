"""Camera models: inverses, derivatives, conventions, refusals."""

import numpy as np
import pytest
from calibration_scene import CAMERA, DISTORTION, GEOMETRY

from calib.cameras import BrownConrady, PerBand, Polynomial, SensorGeometry, unproject_jacobian

OBLONG = SensorGeometry(width_px=1500, height_px=900, pixel_pitch_mm=0.0055)


def strong():
    """Pincushion and decentring that move the corner by more than 100 px."""
    return BrownConrady.create(
        OBLONG, focal_length_mm=8.0, x0_px=-30.0, y0_px=21.0, q1_per_mm2=8e-3, p1_per_mm=1.5e-3, p2_per_mm=-1e-3
    )


def barrel():
    """Compression towards the corner, close to but short of the fold."""
    return BrownConrady.create(GEOMETRY, focal_length_mm=25.6, q1_per_mm2=-2.2e-3)


def bands():
    return PerBand.create(
        GEOMETRY,
        focal_length_mm=[25.6, 25.605, 25.61],
        x0_px=[10.0, 10.2, 10.3],
        y0_px=[-10.0, -9.9, -9.8],
        **DISTORTION,
    )


def polynomial(degree, scatter_px=1.0, geometry=OBLONG):
    model = Polynomial.create(geometry, focal_length_mm=20.0, degree=degree, anchor_px=(3.0, -5.0))
    change = np.random.default_rng(degree).normal(0.0, scatter_px, len(model.parameters))
    change[0] = 0.05
    return model.with_parameters(model.parameters + change)


MODELS = {
    "acf17": CAMERA,
    "strong": strong(),
    "barrel": barrel(),
    "pinhole": BrownConrady.create(OBLONG, focal_length_mm=206.2),
    "bands": bands(),
    "linear": polynomial(1),
    "cubic": polynomial(3),
    "quintic": polynomial(5),
    "septic": polynomial(7, 0.3),
    "septic, bound fails": polynomial(7, 3.0),
}
ALL = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())


def band_of(model, count):
    return np.arange(count) % model.bands if isinstance(model, PerBand) else None


@ALL
def test_unproject_and_project_are_inverse(model):
    pixel = np.concatenate([model.geometry.grid_px(25), model.geometry.corners_px])
    band = band_of(model, len(pixel))
    direction = model.unproject(pixel, band)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, rtol=0, atol=4e-16)
    np.testing.assert_allclose(model.project(direction, band), pixel, rtol=0, atol=2e-12)
    again = model.unproject(model.project(direction, band), band)
    np.testing.assert_allclose(again, direction, rtol=0, atol=1e-12)


@ALL
def test_jacobian_agrees_with_project_and_central_differences(model):
    pixel = model.geometry.grid_px(6)
    band = band_of(model, len(pixel))
    direction = model.unproject(pixel, band) * np.linspace(0.5, 3.0, len(pixel))[:, None]
    projection = model.project_jacobian(direction, band)
    np.testing.assert_allclose(projection.pixel_px, model.project(direction, band), rtol=0, atol=1e-12)
    h = 1e-5
    for axis in range(3):
        step = h * np.eye(3)[axis]
        slope = (model.project(direction + step, band) - model.project(direction - step, band)) / (2 * h)
        np.testing.assert_allclose(projection.by_direction[:, :, axis], slope, rtol=0, atol=1e-8 * np.abs(slope).max())
    for k, scale in enumerate(model.parameter_scales):
        step = np.zeros(len(model.parameters))
        step[k] = 1e-2 * scale
        ahead, behind = (model.with_parameters(model.parameters + s * step) for s in (1, -1))
        slope = (ahead.project(direction, band) - behind.project(direction, band)) / 2e-2
        assert np.abs(slope).max() > 0.05, model.parameter_names[k]
        np.testing.assert_allclose(scale * projection.by_parameter[:, :, k], slope, rtol=0, atol=1e-8)


@ALL
def test_unproject_jacobian_agrees_with_central_differences(model):
    pixel = model.geometry.grid_px(5)
    band = band_of(model, len(pixel))
    direction, by_pixel, by_parameter = unproject_jacobian(model, pixel, band)
    scale = np.abs(by_pixel).max()
    for axis in range(2):
        step = 0.05 * np.eye(2)[axis]
        slope = (model.unproject(pixel + step, band) - model.unproject(pixel - step, band)) / 0.1
        np.testing.assert_allclose(by_pixel[:, :, axis], slope, rtol=0, atol=2e-7 * scale)
    count = len(model.parameters)
    for k in range(0, count, 1 + count // 20):
        size = model.parameter_scales[k]
        step = np.zeros(count)
        step[k] = 1e-3 * size
        ahead, behind = (model.with_parameters(model.parameters + s * step) for s in (1, -1))
        slope = (ahead.unproject(pixel, band) - behind.unproject(pixel, band)) / 2e-3
        np.testing.assert_allclose(size * by_parameter[:, :, k], slope, rtol=0, atol=1e-6 * scale)
    np.testing.assert_allclose(np.einsum("ni,nip->np", direction, by_parameter), 0.0, atol=1e-12)


@ALL
def test_a_star_towards_x_lands_at_a_larger_column_and_towards_y_at_a_larger_row(model):
    step = 0.01
    column, row = model.project([[step, 0.0, 1.0], [0.0, step, 1.0]]) - model.project([[0.0, 0.0, 1.0]])
    assert column[0] > 0
    assert abs(column[1]) < 0.2 * column[0]
    assert row[1] > 0
    assert abs(row[0]) < 0.2 * row[1]


def test_a_pinhole_is_the_tangent_and_the_grid_spans_pixel_centres():
    camera = BrownConrady.create(SensorGeometry(width_px=101, height_px=51, pixel_pitch_mm=0.01), focal_length_mm=10.0)
    pixel = camera.project([[0.0, 0.0, 1.0], [np.tan(0.02), 0.0, 1.0], [0.0, -0.02, 2.0]])
    np.testing.assert_allclose(pixel, [[50.0, 25.0], [50.0 + 1000.0 * np.tan(0.02), 25.0], [50.0, 15.0]], atol=1e-12)
    grid = OBLONG.grid_px(3)
    np.testing.assert_array_equal(grid[:3], [[0.0, 0.0], [749.5, 0.0], [1499.0, 0.0]])
    np.testing.assert_array_equal(grid[-1], [1499.0, 899.0])
    np.testing.assert_array_equal(OBLONG.centre_px, grid[4])
    np.testing.assert_array_equal(OBLONG.corners_px.mean(axis=0), OBLONG.centre_px)


@pytest.mark.parametrize(
    ("name", "value", "moved_mm"),
    [
        # displacement of the point (2, -1) mm, by hand from ACF17 eq. 4: s = 5 mm^2
        ("q1_per_mm2", 1e-3, (10e-3, -5e-3)),
        ("q2_per_mm4", 1e-4, (50e-4, -25e-4)),
        ("q3_per_mm6", 1e-5, (250e-5, -125e-5)),
        ("p1_per_mm", 1e-3, (13e-3, -4e-3)),
        ("p2_per_mm", 1e-3, (-4e-3, 7e-3)),
    ],
)
def test_roles_and_units_of_the_coefficients(name, value, moved_mm):
    plain = BrownConrady.create(GEOMETRY, focal_length_mm=20.0)
    changed = BrownConrady.create(GEOMETRY, focal_length_mm=20.0, **{name: value})
    moved = changed.project([[0.1, -0.05, 1.0]]) - plain.project([[0.1, -0.05, 1.0]])
    np.testing.assert_allclose(moved[0] * 0.01, moved_mm, atol=1e-14)


@ALL
def test_directions_behind_the_camera_have_no_pixel(model):
    direction = [[0.0, 0.0, 1.0], [0.1, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1e-200]]
    pixel = model.project(direction)
    assert np.isfinite(pixel[0]).all()
    assert np.isnan(pixel[1:4]).all()
    assert not GEOMETRY.contains(pixel[1:]).any()
    projection = model.project_jacobian(direction)
    np.testing.assert_array_equal(np.isnan(projection.pixel_px[:4]), np.isnan(pixel[:4]))
    assert np.isnan(projection.by_direction[1:4]).all()


@ALL
def test_a_focal_length_that_is_not_positive_gives_nothing(model):
    lengths = [name.startswith("focal_length") for name in model.parameter_names]
    broken = model.with_parameters(np.where(lengths, -1.0, model.parameters))
    assert np.isnan(broken.project([[0.0, 0.1, 1.0]])).all()
    assert np.isnan(broken.unproject([[400.0, 300.0]])).all()


@pytest.mark.parametrize("model", [barrel(), polynomial(3, 1.0), strong()], ids=["barrel", "polynomial", "pincushion"])
def test_no_star_no_pixel_empty_arrays(model):
    assert model.project(np.empty((0, 3))).shape == (0, 2)
    assert model.unproject(np.empty((0, 2))).shape == (0, 3)
    assert unproject_jacobian(model, np.empty((0, 2))).by_parameter.shape == (0, 3, len(model.parameters))


def test_beyond_the_first_fold_there_is_no_direction():
    """x (1 - x^2 / 300) is largest at x = 10 mm, where it is 20/3 mm; within, the inverse is exact."""
    camera = BrownConrady.create(GEOMETRY, focal_length_mm=10.0, q1_per_mm2=-1.0 / 300.0)
    centre, turn = GEOMETRY.centre_px, 2000.0 / 3.0
    for angle in np.radians([0.0, 40.0, 135.0, 250.0]):
        towards = np.array([np.cos(angle), np.sin(angle)])
        inside = centre + (turn - 1e-3) * towards
        direction = camera.unproject([inside])
        np.testing.assert_allclose(camera.project(direction)[0], inside, atol=1e-9)
        assert 0 < np.hypot(*direction[0, :2]) / direction[0, 2] < 1.0
        assert np.isnan(camera.unproject([centre + (turn + 1e-3) * towards, centre + 3000.0 * towards])).all()
    # beyond a fold the distortion may grow again and look regular; such solutions are refused
    camera = BrownConrady.create(GEOMETRY, focal_length_mm=10.0, q1_per_mm2=-5e-3, q2_per_mm4=0.8e-5)
    radius = np.linspace(0.0, 25.0, 20_001)
    image = np.abs((camera.project(np.stack([radius / 10, 0 * radius, 1 + 0 * radius], 1)) - GEOMETRY.centre_px)[:, 0])
    first_fold = np.argmax(np.diff(image) < 0)
    assert 0 < first_fold < 20_000
    assert image[-1] > image[first_fold]
    pixel = GEOMETRY.centre_px + np.array([[image[first_fold] - 0.1, 0.0], [image[first_fold] + 0.1, 0.0]])
    back = camera.unproject(pixel)
    assert 10.0 * back[0, 0] / back[0, 2] < radius[first_fold]
    assert np.isnan(back[1]).all()


def test_visible_ends_at_the_edge_of_the_last_pixel_and_at_the_fold():
    camera = BrownConrady.create(GEOMETRY, focal_length_mm=25.6)
    direction = camera.unproject([[1023.49, 5.0], [1023.51, 5.0], [-0.51, 5.0], [1025.0, 5.0]])
    assert camera.visible(direction).tolist() == [True, False, False, False]
    assert camera.visible(direction, margin_px=0.1).tolist() == [True, True, True, False]
    assert bands().visible(bands().unproject([[5.0, 5.0]] * 3, [0, 1, 2]), [0, 1, 2]).all()
    # A direction behind the fold has a pixel on the detector; that pixel belongs to another direction
    camera = BrownConrady.create(GEOMETRY, focal_length_mm=10.0, q1_per_mm2=-1.0 / 300.0)
    ghost, star = [1.6, 0.0, 1.0], [0.2, 0.0, 1.0]
    assert GEOMETRY.contains(camera.project([ghost])).all()
    assert camera.visible([ghost, star, [0.0, 0.0, -1.0]]).tolist() == [False, True, False]


def test_bands_have_their_own_focal_length_and_principal_point():
    model = bands()
    direction = CAMERA.unproject(GEOMETRY.grid_px(4))
    for k, f in enumerate([25.6, 25.605, 25.61]):
        single = BrownConrady.create(
            GEOMETRY, focal_length_mm=f, x0_px=[10.0, 10.2, 10.3][k], y0_px=[-10.0, -9.9, -9.8][k], **DISTORTION
        )
        np.testing.assert_array_equal(model.project(direction, k), single.project(direction))
        np.testing.assert_array_equal(model.project(direction, np.full(16, k)), single.project(direction))
    np.testing.assert_array_equal(model.project(direction), model.project(direction, 0))
    assert model.value("focal_length_band2_mm") == 25.61


def scaled_condition(model, turns):
    """Condition number of the normalised derivatives by the parameters, and by small turns of the camera if wanted."""
    direction = model.unproject(model.geometry.grid_px(21))
    jacobian = model.project_jacobian(direction)
    columns = jacobian.by_parameter
    if turns:
        by_turn = np.stack(
            [np.einsum("nij,nj->ni", jacobian.by_direction, np.cross(axis, direction)) for axis in np.eye(3)], axis=2
        )
        columns = np.concatenate([columns, by_turn], axis=2)
    columns = columns.reshape(2 * len(direction), -1)
    columns = columns / np.linalg.norm(columns, axis=0)
    value = np.linalg.eigvalsh(columns.T @ columns)
    return np.sqrt(value[-1] / max(value[0], 1e-30))


@pytest.mark.parametrize("degree", [3, 6, 9])
def test_the_polynomial_is_well_conditioned_and_no_parameter_stands_for_a_turn(degree):
    model = Polynomial.create(GEOMETRY, focal_length_mm=25.6, degree=degree)
    assert scaled_condition(model, turns=False) < 3.0
    assert scaled_condition(model, turns=True) < 100.0


def test_with_parameters_keeps_the_camera_and_locks_the_copy():
    model = polynomial(4)
    values = model.parameters + 0.1
    other = model.with_parameters(values)
    assert (other.degree, other.geometry) == (4, model.geometry)
    np.testing.assert_array_equal(other.anchor_px, model.anchor_px)
    values[0] = 99.0
    assert other.parameters[0] != 99.0
    with pytest.raises(ValueError, match="read-only"):
        other.parameters[0] = 1.0


@ALL
def test_names_end_in_units_and_cover_the_parameters(model):
    assert len(set(model.parameter_names)) == len(model.parameters) == len(model.parameter_scales)
    assert all(name.split("_")[-1] in {"px", "mm", "mm2", "mm4", "mm6"} for name in model.parameter_names)
    assert set(model.pinhole_names) <= set(model.parameter_names)
