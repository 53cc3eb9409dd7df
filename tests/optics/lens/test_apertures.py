"""Outlines against closed forms and Matplotlib's polygons; what a lens loses to them."""

import math

import numpy as np
import pytest
from lens_texts import BACK, STOP, table_lens
from matplotlib.path import Path as Outline

from optics.arrays import NUMPY
from optics.figures import draw_lens
from optics.lens.apertures import APERTURES, Circle, Ellipse, Polygon, Rectangle, Spider
from optics.rays.trace import OK, VIGNETTED, Rays, trace

STAR = tuple((r * math.cos(a), r * math.sin(a)) for r, a in zip([5, 2] * 5, np.arange(10) * math.pi / 5, strict=True))
EXAMPLES = (
    Circle(radius_mm=3.0, centre_mm=(0.5, -1.0)),
    Ellipse(half_width_mm=(4.0, 1.5), angle_deg=30.0),
    Rectangle(half_width_mm=(3.0, 1.0), centre_mm=(-1.0, 0.5), angle_deg=-20.0),
    Polygon(points_mm=STAR, angle_deg=10.0, centre_mm=(0.3, 0.2)),
    Spider(arms=3, width_mm=0.4, angle_deg=35.0),
)
every_kind = pytest.mark.parametrize("shape", EXAMPLES, ids=lambda shape: shape.kind)


def points(count=4000):
    return np.random.default_rng(7).uniform(-6.0, 6.0, (2, count))


def inside(shape, x, y):
    return shape.inside(shape.parameters(), x, y, NUMPY)


def test_every_listed_kind_has_an_example():
    assert {type(shape) for shape in EXAMPLES} == set(APERTURES)


@every_kind
def test_inside_is_what_the_outline_encloses(shape):
    x, y = points()
    got = inside(shape, x, y)
    if isinstance(shape, Spider):  # distance to the half-lines from the centre
        wanted = np.zeros(x.shape, bool)
        for turn in np.radians(35.0 + 120.0 * np.arange(3)):
            along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
            wanted |= (along > 0) & (np.abs(across) < 0.2)
        np.testing.assert_array_equal(got, wanted)
        return
    (outline,) = shape.outlines()
    wanted = Outline(outline).contains_points(np.column_stack([x, y]))
    # circle and ellipse are drawn by chords: these differ from the curve by up to 4e-3 of its size
    slack = 0.004 if isinstance(shape, Circle | Ellipse) else 0.0
    assert np.mean(got != wanted) <= slack
    assert 0.02 < got.mean() < 0.5


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        (EXAMPLES[0], math.pi * 9.0),
        (EXAMPLES[1], math.pi * 6.0),
        (EXAMPLES[2], 12.0),
        (EXAMPLES[3], 10 * 0.5 * 5 * 2 * math.sin(math.pi / 5)),
    ],
)
def test_its_area(shape, area):
    side = (np.arange(1200) + 0.5) / 100.0 - 6.0
    x, y = np.meshgrid(side, side)
    assert inside(shape, x, y).sum() * 1e-4 == pytest.approx(area, rel=1e-3)


@every_kind
def test_seen_from_behind_and_expanded(shape):
    x, y = points()
    np.testing.assert_array_equal(inside(shape.flipped(), -x, y), inside(shape, x, y))
    np.testing.assert_array_equal(inside(shape.scaled(1.5), 1.5 * x, 1.5 * y), inside(shape, x, y))


@every_kind
def test_numpy_and_drjit_agree(shape):
    llvm = pytest.importorskip("drjit.llvm")
    arrays = pytest.importorskip("render.engine.arrays").DrJitArrays(llvm.Float64)
    x, y = points()
    got = shape.inside(arrays.parameters(shape.parameters()), llvm.Float64(x), llvm.Float64(y), arrays)
    np.testing.assert_array_equal(np.array(got), inside(shape, x, y))


def keys(shape):
    return {"kind": shape.kind, **{name: getattr(shape, name) for name in shape.__dataclass_fields__}}


def lens_with(*apertures, mirror=False):
    along, medium = (-50.0, "mirror") if mirror else (5.0, "N-BK7")
    face = {"radius_mm": 500.0, "thickness_mm": along, "medium": medium, "aperture": apertures}
    return table_lens({**STOP, "semi_diameter_mm": 9.0}, face, *([] if mirror else [BACK]))


def traced(lens, x, y):
    return trace(lens, Rays.create(x_mm=x, y_mm=y, z_mm=0.0, direction=[0, 0, 1.0], wavelength_nm=600.0))


@every_kind
@pytest.mark.parametrize("obscures", [False, True])
def test_light_passes_what_the_file_says(shape, obscures):
    if isinstance(shape, Spider) and not obscures:
        return
    x, y = points()
    for mirror in (False, True):
        out = traced(lens_with({**keys(shape), "obscures": obscures}, mirror=mirror), x, y)
        np.testing.assert_array_equal(out.status, np.where(inside(shape, x, y) != obscures, OK, VIGNETTED))
        assert set(out.failed_at[out.status != OK]) == {1}


def test_all_outlines_count_and_the_order_does_not_matter():
    x, y = points()
    circle, rectangle = keys(EXAMPLES[0]), {**keys(EXAMPLES[2]), "obscures": True}
    one, other = traced(lens_with(circle, rectangle), x, y), traced(lens_with(rectangle, circle), x, y)
    wanted = inside(EXAMPLES[0], x, y) & ~inside(EXAMPLES[2], x, y)
    np.testing.assert_array_equal(one.ok, wanted)
    np.testing.assert_array_equal(other.ok, wanted)
    assert lens_with(circle).surfaces[1].holed
    assert draw_lens(lens_with(circle), fields_deg=[0.0]).axes
