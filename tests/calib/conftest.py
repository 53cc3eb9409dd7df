"""Star lists with known truth; noise of the star images of `star_images`."""

import calibration_scene
import pytest
from star_images import NOISE


@pytest.fixture(scope="session")
def noise():
    return NOISE


@pytest.fixture(scope="session")
def scenes():
    return calibration_scene
