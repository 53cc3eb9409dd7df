"""The rendered bench with two benches to draw."""

import pytest

from experiments.cube.bench import build_laboratory
from experiments.cube.settings import CubeMirrorConfig


@pytest.fixture(scope="session")
def laboratory(engine):
    return build_laboratory(CubeMirrorConfig(benches={"count": 2}))
