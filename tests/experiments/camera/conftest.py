"""The sensor file that commands of the camera are given."""

import pytest

SENSOR = """
name = "{name}"
[instrument]
lens = "star_tracker_26mm"
detector = "cmv4000"
width_px = 800
height_px = 800
exposure_s = {exposure_s}
defocus_mm = 0.0
[passband]
range_nm = [500, 800]
[requirements]
{requirements}
"""


@pytest.fixture(scope="session")
def sensor_file(tmp_path_factory):
    """``sensor_file(requirements, name=..., exposure_s=...)``: path of a small tracker's file."""

    def write(requirements, name="Small tracker", exposure_s=0.2):
        path = tmp_path_factory.mktemp("sensor") / "my.toml"
        path.write_text(SENSOR.format(name=name, exposure_s=exposure_s, requirements=requirements))
        return path

    return write
