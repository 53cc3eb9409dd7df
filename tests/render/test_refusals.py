"""What render refuses: kind of error, and the name, value or range that its message of one line holds."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from optics.errors import ConfigError, DomainError
from render.motion.orbit import sgp4_orbit
from render.sensor_file.file import read_sensor

LENS_FILES = {
    "lens.toml": "design_wavelength_nm = 650.0\n[[surface]]\nradius_mm = 20.0\n",
    "lens.zmx": "VERS 1\n",
    "measured.toml": 'kind = "measured"\n',
    "bare.toml": "[instrument]\ndetector = detector.toml\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in LENS_FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def sensor_file(name: str) -> Callable[[Path], Any]:
    return lambda folder: read_sensor(folder / name)


def elements_with_a_wrong_checksum(_: Path) -> Any:
    pytest.importorskip("sgp4")
    first = "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9995"
    return sgp4_orbit(first, "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482")


SENSOR_FILES = [
    ("lens file", sensor_file("lens.toml"), ConfigError, ["lens file", 'lens = "lens.toml"']),
    ("Zemax file", sensor_file("lens.zmx"), ConfigError, ["lens file", 'lens = "lens.zmx"']),
    ("measured lens", sensor_file("measured.toml"), ConfigError, ["lens file", 'lens = "measured.toml"']),
    ("bare text", sensor_file("bare.toml"), ConfigError, ["line 2", 'quote it: detector = "detector.toml"']),
]
MOTION = [
    ("checksum of two-line elements", elements_with_a_wrong_checksum, DomainError, ["two-line elements", "checksum"]),
]


@pytest.mark.parametrize(
    ("call", "kind", "words"), [pytest.param(*row[1:], id=row[0]) for row in (*SENSOR_FILES, *MOTION)]
)
def test_refusals(call: Callable[[Path], Any], kind: type[Exception], words: list[str], folder: Path) -> None:
    with pytest.raises(kind) as error:
        call(folder)
    message = str(error.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []
