"""Noise of the star images of `star_images`."""

import pytest
from star_images import NOISE


@pytest.fixture(scope="session")
def noise():
    return NOISE
