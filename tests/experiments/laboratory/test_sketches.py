"""Sketches that are to scale show what is rendered."""

import numpy as np

from experiments.harness.plotting import house_style
from experiments.laboratory.instrument import build_instrument
from experiments.laboratory.settings import InstrumentConfig, TargetConfig
from experiments.laboratory.sketches import field_places


def test_the_places_of_the_target_are_those_of_the_test():
    """25 points in every corner, mirror images of each other, the outermost as far from the edge as was asked for."""
    instrument = build_instrument(InstrumentConfig())
    with house_style():
        figure = field_places(TargetConfig(edge_px=150.0), instrument)
    drawn = [line.get_xydata() for line in figure.axes[0].lines if len(line.get_xydata()) == 25]
    points = np.concatenate(drawn)
    assert len(drawn) == 4
    size = np.array([instrument.camera.width_px, instrument.camera.height_px])
    np.testing.assert_allclose(points.min(0), 150.0)
    np.testing.assert_allclose(points.max(0), size - 1 - 150.0)
    assert {(x, y) for x, y in np.round(points, 6)} == {(x, y) for x, y in np.round(size - 1 - points, 6)}
