"""Star sensors by name: geometry, windows, pass bands, and what is refused."""

import numpy as np
import pytest

from optics.frames import field_angles_deg
from optics.lens_file import load_lens
from optics.rays.chief_ray import chief_ray_points
from render.detector.spec import load_detector
from render.sensor_file.load import load_star_sensor
from render.sky.star_light import star_light
from render.tracing.tracer import Tracer


@pytest.fixture(scope="module")
def sensor():
    return load_star_sensor("star_tracker_26mm", "cmv4000", window_px=(1024, 512))


def test_a_window_is_the_middle_of_camera_and_detector(sensor):
    assert (sensor.camera.width_px, sensor.camera.height_px) == (1024, 512)
    assert sensor.detector.shape == (512, 1024)
    assert sensor.camera.centre_px == pytest.approx([511.5, 255.5])


def test_parts_may_be_given_as_records(sensor):
    same = load_star_sensor(load_lens("star_tracker_26mm"), load_detector("cmv4000"), window_px=(1024, 512))
    wavelength = np.linspace(500, 800, 7)
    assert np.array_equal(same.camera.response_at(wavelength), sensor.camera.response_at(wavelength))


def test_the_pass_band_reaches_over_all_data(sensor):
    low, high = sensor.known_range_nm
    assert sensor.passband().breakpoints_nm[0] == pytest.approx(low)
    assert sensor.passband().breakpoints_nm[-1] == pytest.approx(high)


@pytest.mark.parametrize(
    ("lens", "window_px"),
    [("star_tracker_26mm", 1024), pytest.param("star_tracker_26mm", 1862, marks=pytest.mark.slow)],
)
def test_the_map_of_a_camera_is_where_the_renderer_puts_the_light(lens, window_px):
    """NumPy quadrature at six wavelengths against the renderer's kernel at twelve; the larger window is vignetted."""
    sensor = load_star_sensor(lens, "cmv4000", window_px=window_px, defocus_mm=0.01)
    known = sensor.pixel_map(temperature_k=4000.0)
    some = known.direction[::17]
    stars = star_light([sensor.passband()], nodes=12).stars(some, 5.0, 4000.0)
    np.testing.assert_allclose(Tracer(sensor.camera).bundle_means(stars)[:, 0], known.pixel_px[::17], atol=3e-4)


BARREL = """name = "barrel"
source = "plano-convex singlet behind its stop"
design_wavelength_nm = 600.0
max_field_deg = 40.0
[[surface]]
thickness_mm = 5.0
medium = "air"
semi_diameter_mm = 0.5
stop = true
[[surface]]
thickness_mm = 6.0
medium = "N-BK7"
semi_diameter_mm = 7.5
[[surface]]
radius_mm = -8.0
thickness_mm = 14.0
medium = "air"
semi_diameter_mm = 7.5
"""


def test_directions_of_places_through_a_lens_that_distorts(tmp_path):
    """The chief rays of the directions, traced, land where they were asked to; those of the ideal lens do not."""
    (tmp_path / "barrel.toml").write_text(BARREL)
    wide = load_star_sensor(tmp_path / "barrel.toml", "cmv4000", window_px=1400)
    x, y = (v.ravel() for v in np.meshgrid([0.0, 699.5, 1399.0], [0.0, 650.0, 1399.0]))
    nominal = wide.camera.nominal_direction(x, y, wide.focal_length_mm)
    off_px = []
    for v in (nominal, wide.direction_at(x, y)):
        place = wide.camera.to_pixel(*chief_ray_points(wide.camera.focused_lens, *field_angles_deg(v)))
        off_px.append(np.hypot(place[0] - x, place[1] - y).max())
    assert off_px[0] > 30.0
    assert off_px[1] < 0.01 * 700.0 * np.sqrt(2.0)


def test_a_lens_that_hardly_distorts_keeps_its_nominal_directions(sensor):
    x, y = np.array([0.0, 1023.0]), np.array([0.0, 511.0])
    np.testing.assert_array_equal(
        sensor.direction_at(x, y), sensor.camera.nominal_direction(x, y, sensor.focal_length_mm)
    )
