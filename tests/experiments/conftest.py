"""The small real experiment that the tests of the frame run, loaded from its file."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shot_noise():
    """The module ``shot_noise.py`` of this folder."""
    path = Path(__file__).with_name("shot_noise.py")
    spec = importlib.util.spec_from_file_location("shot_noise_for_tests", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
