"""Figures hold the numbers of the Dataset: positions of points, lines, bars, colours and arrows."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.harness.drawings import arrows, bars, cloud, curves, maps
from experiments.harness.plotting import house_style
from experiments.harness.quantities import Outcome, Quantities

FIELD, METHODS = [1.0, 2.0, 5.0], ["cog", "epsf"]
NOISE = np.array([[0.3, 0.1], [0.4, 0.2], [0.5, 0.3]])
VECTORS = np.array([[3.0, 4.0], [0.3, -0.4], [0.0, 1.0]])


@pytest.fixture(scope="module")
def draw():
    """``draw(figure)``: panels of a figure of a small outcome."""
    q = Quantities()
    q.axis("field", FIELD, "Field", unit="deg")
    q.axis("method", METHODS, "Method")
    q.axis("axis", ["x", "y"])
    q.add("noise_px", NOISE, "Noise", unit="px", dims=("field", "method"), error=0.1 * NOISE)
    q.add("bound_px", 0.5 * NOISE[:, 1], "Bound", unit="px", dims="field")
    q.add("published_px", 0.25, "Published", unit="px")
    q.add("lens", ["a", "a", "b"], "Lens", dims="field")
    q.add("position_px", [[10.0, 20.0], [30.0, 40.0], [50.0, 60.0]], dims=("field", "axis"))
    q.add("error_arcsec", VECTORS, "Error", unit="arcsec", dims=("field", "axis"))
    q.add("size_px", [100.0, 80.0], dims="axis")
    outcome = Outcome(config=SimpleNamespace(), result=None, data=q.dataset)

    def panels(figure):
        with house_style():
            return figure(outcome).axes

    return panels


def test_curves(draw):
    (panel,) = draw(curves("field", points="noise_px", lines="bound_px", by="method", floor="bound_px", log="xy"))
    measured = [container.lines[0].get_ydata() for container in panel.containers]
    np.testing.assert_array_equal(measured, NOISE.T)
    np.testing.assert_array_equal(panel.lines[0].get_xydata(), np.column_stack([FIELD, 0.5 * NOISE[:, 1]]))
    assert (panel.get_xscale(), panel.get_ylabel()) == ("log", "Noise [px]")
    assert [p.get_title("left") for p in draw(curves("field", points="noise_px", panels="method"))] == METHODS
    (panel,) = draw(curves("field", lines="noise_px bound_px", at={"method": "epsf"}, dashes="published_px", level=0.2))
    np.testing.assert_array_equal(panel.lines[1].get_ydata(), NOISE[:, 1])
    assert [text.get_text() for text in panel.texts] == ["published 0.25"]
    (panel,) = draw(curves("field", points="bound_px", by="lens", level=0.0))
    assert [len(container.lines[0].get_xdata()) for container in panel.containers] == [2, 1]


def test_bars(draw):
    (panel,) = draw(bars("field", bars="noise_px", points="bound_px", by="method"))
    assert sorted(bar.get_width() for bar in panel.patches) == sorted(NOISE.ravel())
    assert len(panel.lines) == 2  # predictions of each method
    assert len(draw(bars("field", bars="absent", points="noise_px", panels="method"))) == 2


def test_maps(draw):
    panel, colours = draw(maps("noise_px", zero=True))
    np.testing.assert_array_equal(np.ravel(panel.collections[0].get_array()), NOISE.ravel())
    assert colours.get_ylim() == (-0.5, 0.5)
    panel, *_ = draw(maps("noise_px", place="position_px", panels="method"))
    np.testing.assert_array_equal(panel.collections[0].get_offsets()[:, 0], [10.0, 30.0, 50.0])


def test_clouds_and_arrows(draw):
    (panel,) = draw(cloud("error_arcsec", ellipses="published_px"))
    np.testing.assert_array_equal(panel.lines[0].get_xydata(), VECTORS)
    np.testing.assert_allclose(np.hypot(*panel.lines[1].get_data()), 0.25)
    (panel,) = draw(arrows("position_px", "error_arcsec", frame="size_px"))
    assert panel.get_title("left") == "Error: longest 5 ″"
    assert panel.collections[0].scale == pytest.approx(5.0 / (0.08 * 100.0))
