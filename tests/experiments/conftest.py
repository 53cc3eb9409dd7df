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


@pytest.fixture(scope="session")
def engine():
    """The processor."""
    from render.engine import Engine

    return Engine.start("llvm")


@pytest.fixture(scope="session")
def star_camera():
    """The default instrument of the experiments."""
    from experiments.laboratory.instrument import build_instrument
    from experiments.laboratory.settings import InstrumentConfig

    return build_instrument(InstrumentConfig())


@pytest.fixture(scope="session")
def bench_of():
    """A laboratory with three filters; keywords change it."""
    from experiments.laboratory.bench import Bench
    from experiments.laboratory.settings import TargetConfig
    from optics.light.band import TopHat
    from optics.light.spectrum import Blackbody

    def make(rows=2, columns=2, centres_nm=(500.0, 600.0, 800.0), reference=1, edge_px=150.0, **changes):
        settings = {
            "target": TargetConfig(rows=rows, columns=columns, edge_px=edge_px),
            "lamp": Blackbody(temperature_k=3000.0),
            "filters": [TopHat(centre_nm=c, width_nm=100.0, edge_nm=10.0, name=f"{c:g} nm") for c in centres_nm],
            "reference": reference,
            "signal_e": 6000.0,
            "frames": 8,
            "dark_frames": 20,
            "window_px": 13,
            "methods": ("epsf",),
        }
        return Bench(**(settings | changes))

    return make


@pytest.fixture(scope="session")
def small_detector(tmp_path_factory):
    """Data file of a smaller detector of the same make: frames that take a test less time and memory."""
    path = tmp_path_factory.mktemp("detector") / "small.toml"
    path.write_text('base = "cmv4000"\nname = "small"\nchip_width_px = 3072\nchip_height_px = 1536\n')
    return path


@pytest.fixture(scope="session")
def small_camera(small_detector):
    """The default lens in front of the small detector."""
    from experiments.laboratory.instrument import build_instrument
    from experiments.laboratory.settings import InstrumentConfig

    return build_instrument(InstrumentConfig(detector=str(small_detector)))
