"""A wide camera under five frames of the sky, and its stars at the positions of a Brown-Conrady camera."""

import numpy as np
import pytest

from calib.cameras import BrownConrady
from experiments.skycal.scene import build_scene
from experiments.skycal.settings import SkycalConfig
from render.engine.random import Streams

TRUTH = {"x0_px": 3.0, "y0_px": -2.0, "q1_per_mm2": 2e-5}


@pytest.fixture(scope="session")
def config():
    wide = SkycalConfig().wide.model_copy(update={"faintest_mag": 6.0, "models": ("brown_conrady", "pinhole")})
    return SkycalConfig(frames=5, which="wide", wide=wide, motion={"rate_deg_per_s": 3.0})


@pytest.fixture(scope="session")
def scene(config):
    return build_scene("wide", config, Streams(8).child("wide"))


@pytest.fixture(scope="session")
def truth(scene):
    """Parameters of the true camera; the data sheet has neither its principal point nor its distortion."""
    return TRUTH | {"focal_length_mm": scene.instrument.focal_length_mm}


@pytest.fixture(scope="session")
def camera(scene, truth):
    return BrownConrady.create(scene.geometry, **truth)


@pytest.fixture(scope="session")
def stars_of_frame(scene, camera):
    """``stars_of_frame(number)``: rows, directions in cam, positions, magnitudes of the stars on the detector."""

    def stars(number):
        rows, direction = scene.in_cam(number)
        position = camera.project(direction)
        inside = np.all((position > 6) & (position < 1855), axis=1)
        rows = rows[inside]
        return rows, direction[inside], position[inside], scene.sky.magnitude[rows]

    return stars
