"""Sampling of the pupil: Sobol nets, the order of the quadrature, and which of the two is chosen."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fields import star_field
from scipy import stats
from scipy.stats import qmc

from optics.lens.apertures import Spider
from optics.lens_file import load_lens
from render.tracing.convergence import TOLERANCE
from render.tracing.pupil import points as pupil_points
from render.tracing.pupil.points import SobolPoints
from render.tracing.pupil.quadrature_order import LADDER, bounding_disk, probe_fields, sobol_points, staggered
from render.tracing.tracer import Tracer


def square(types, points, first, count):
    import drjit as dr

    u, v = points.square(types, dr.arange(types.UInt32, count) + first)
    return u.numpy(), v.numpy()


@pytest.mark.parametrize("seed", [0, 7, 12345])
def test_every_block_of_the_sobol_sequence_is_a_net(engine, seed):
    """A (0, m, 2)-net: every elementary interval of area 2^-m holds exactly one of 2^m points."""
    m = 10
    for block in (0, 1, 6):
        u, v = square(engine.types, SobolPoints(m, seed), block << m, 1 << m)
        assert 0 < u.min() < u.max() < 1
        for a in range(m + 1):
            cell = np.floor(u * 2**a) * 2 ** (m - a) + np.floor(v * 2 ** (m - a))
            assert len(np.unique(cell)) == 1 << m


def test_without_scrambling_it_is_the_sobol_sequence(engine, monkeypatch):
    monkeypatch.setattr(pupil_points, "_nested", lambda types, x, seed: x)
    u, v = square(engine.types, SobolPoints(9, 0), 0, 1 << 9)
    got = {(int(a * 512), int(b * 512)) for a, b in zip(u, v, strict=True)}
    reference = qmc.Sobol(2, scramble=False).random_base2(9)
    assert got == {(int(a * 512), int(b * 512)) for a, b in reference}


def test_scrambling_depends_on_the_seed_only(engine):
    first, again = (square(engine.types, SobolPoints(8, 3), 0, 256) for _ in range(2))
    assert np.array_equal(first, again)
    leading = np.array([square(engine.types, SobolPoints(0, seed), 0, 1) for seed in range(200)])[..., 0]
    assert min(stats.kstest(leading[:, axis], "uniform").pvalue for axis in (0, 1)) > 1e-3  # N = 200


def test_sobol_points_fill_the_disk_evenly(engine):
    import drjit as dr

    points = sobol_points(4, 1, 16)  # 4 nodes with 2^14 points each
    assert points.count == 1 << 14
    types = engine.types
    x, y, weight = points.sample(types, types.UInt32(0), types.UInt32(2), dr.arange(types.UInt32, 1 << 14))
    x, y = x.numpy(), y.numpy()
    assert np.array_equal(points.weight, np.full(1 << 14, weight.numpy()[0]))
    # moments of the uniform disk: 1/4, 0, 1/8 = <x^4>, 1/24 = <x^2 y^2>
    for value, expected in ((x, 0), (x * x, 1 / 4), (x * y, 0), (x**4, 1 / 8), (x * x * y * y, 1 / 24)):
        assert abs(value.mean() - expected) < 1e-5


def stamps(tracer, stars, pupil, size=14):
    """Pixels of stars on the image through a given set of pupil points."""
    paths = tracer._in_cam(stars, None)
    light = tracer.light(stars, paths, 1.0)
    corner = np.floor(tracer.bundle_means(stars)) - size // 2 - 0.5
    return tracer.planner.kernel(paths.mid).splat(
        stars=np.arange(len(stars), dtype=np.uint32),
        pupil=pupil,
        wavelength_nm=light.wavelength_nm,
        node_weight=light.weight,
        corner_px=corner,
        stamp_px=size,
    )


def only_group(tracer, stars):
    """The stars, all of whose beams are sampled alike."""
    planner = tracer.planner
    exposure = planner.exposure(tracer._in_cam(stars, None), stars.wavelength_nm)
    group, rest = planner.sampled_by_rays(exposure).groups
    assert (len(group.members), len(rest.members)) == (len(stars), 0)
    return group


@pytest.mark.parametrize("defocus_mm", [0.01, 0.05])
def test_quadrature_converges_exponentially(engine, bench, defocus_mm):
    camera = bench.camera_of(defocus_mm=defocus_mm)
    stars = bench.stars_at(camera, [2047.5, 3000.2, 4010.4], [1023.5, 400.8, 60.1], nodes=1)
    tracer = Tracer(camera)
    exact = stamps(tracer, stars, staggered((80, 160), 1)).pixels
    error = [np.abs(stamps(tracer, stars, staggered(order, 1)).pixels - exact).max() for order in LADDER[:10]]
    # an algebraic rule gains the same factor with every three steps of the ladder; this one gains more and more
    gain = [early / late for early, late in zip(error, error[3:], strict=False)]
    assert gain[0] > 8
    assert max(gain) > 30 * gain[0]
    assert error[-1] < 1e-8


@pytest.mark.parametrize("diffusion_px", [0.18, 0.6])
@pytest.mark.parametrize("defocus_mm", [0.0, 0.02, -0.05])
def test_chosen_order_keeps_its_tolerance(engine, bench, diffusion_px, defocus_mm):
    """Pixel by pixel against a much higher order, at twelve places that the choice did not try."""
    camera = bench.camera_of(defocus_mm=defocus_mm, charge_diffusion_px=diffusion_px)
    rng = np.random.default_rng(3)
    stars = bench.stars_at(camera, rng.uniform(10, 4085, 12), rng.uniform(10, 2037, 12))
    tracer = Tracer(camera)
    group = only_group(tracer, stars)
    assert group.error < TOLERANCE
    fine = stamps(tracer, stars, staggered((60, 120), 3), size=22).pixels
    assert np.abs(stamps(tracer, stars, group.of(group.members), size=22).pixels - fine).max() < TOLERANCE


@pytest.mark.parametrize("tolerance", [1e-4, 1e-5])
def test_order_inside_outlines_is_high_enough_and_not_far_too_high(engine, bench, tolerance):
    """Stop inside the lens: within the tolerance at stars that were not tried; a rule of half the rays is not."""
    camera = bench.camera_of("star_tracker_26mm", fine=2, charge_diffusion_px=0.09)
    rng = np.random.default_rng(4)
    stars = bench.stars_at(camera, *rng.uniform(500, 1540, (2, 12)), bands=((625.0, 400.0),), nodes=6)
    tracer = Tracer(camera, tolerance=tolerance)
    group = only_group(tracer, stars)

    def error(order):
        pixels = stamps(tracer, stars, group.points(order, group.members), size=30).pixels
        return np.abs(pixels - exact).max()

    exact = stamps(tracer, stars, group.points((45, 70), group.members), size=30).pixels
    rings, arms = group.order
    assert error((rings, arms)) < tolerance < error((round(0.7 * rings), round(0.7 * arms)))


@pytest.mark.slow
def test_rule_is_chosen_by_the_pupil(engine, bench):
    """Clear, or with a hole: quadrature. Cut before or behind a stop inside the lens: arcs. Anything else: Sobol."""

    def rule(camera, x, y):
        stars = bench.stars_at(camera, x, y, nodes=1)
        return set(Tracer(camera, sobol_log2_rays=10).render(stars, exposure_s=1.0).sampling)

    lens = load_lens("star_camera_206mm")
    camera = partial(bench.camera_of, film=False)
    assert rule(camera(), [2000, 4090], [1000, 5]) == {"quadrature"}
    tracker = camera("star_tracker_26mm")
    assert rule(tracker, 500, 500) == {"quadrature"}
    assert rule(tracker, [500, 20, 90], [500, 30, 900]) == {"quadrature", "arcs"}
    assert rule(replace(tracker, charge_diffusion_px=0.0), 500, 500) == {"sobol"}
    stop = tracker.lens.surfaces[tracker.lens.stop_index]
    spot = tracker.lens.with_surfaces({tracker.lens.stop_index: replace(stop, inner_semi_diameter_mm=1.0)})
    assert rule(replace(tracker, lens=spot), 500, 500) == {"quadrature"}
    vanes = (Spider(obscures=True, arms=3, width_mm=0.2),)
    spider = tracker.lens.with_surfaces({tracker.lens.stop_index: replace(stop, apertures=vanes)})
    assert rule(replace(tracker, lens=spider), 500, 500) == {"sobol"}
    assert rule(camera(charge_diffusion_px=0.0), 2000, 1000) == {"sobol"}
    assert rule(camera(defocus_mm=1.5), 2000, 1000) == {"sobol"}  # 90 px wide
    last = len(lens.surfaces) - 1
    cut = lens.with_surfaces({last: replace(lens.surfaces[last], semi_diameter_mm=9.0)})
    assert rule(camera(cut), [2047.5, 4090], [1023.5, 5]) == {"quadrature", "sobol"}
    stop = lens.surfaces[lens.stop_index]
    ring = lens.with_surfaces({lens.stop_index: replace(stop, inner_semi_diameter_mm=8.0)})
    assert rule(camera(ring), 2000, 1000) == {"quadrature"}


@pytest.mark.slow
def test_a_beam_with_a_hole_is_the_whole_less_its_middle(engine, bench):
    """Light adds up: what a stop with a hole lets through and what a stop as large as the hole does make the whole."""
    lens, inner_mm = load_lens("star_tracker_26mm"), 2.0
    stop = lens.surfaces[lens.stop_index]

    def traced(**changes):
        changed = lens.with_surfaces({lens.stop_index: replace(stop, **changes)})
        camera = bench.camera_of(changed, charge_diffusion_px=0.3)
        places = np.array([[0.5, 0.7, 0.4], [0.5, 0.4, 0.65]]) * [[camera.width_px], [camera.height_px]]
        return Tracer(camera).render(bench.stars_at(camera, *places), exposure_s=1.0)

    ring, whole, middle = traced(inner_semi_diameter_mm=inner_mm), traced(), traced(semi_diameter_mm=inner_mm)
    assert set(ring.sampling) == {"quadrature"}
    light = whole.truth.electrons_image.min()
    assert middle.truth.electrons_image.min() > 0.05 * light
    assert np.abs(ring.electrons - (whole.electrons - middle.electrons)).max() < 2 * TOLERANCE * light
    np.testing.assert_allclose(
        ring.truth.electrons_image, whole.truth.electrons_image - middle.truth.electrons_image, rtol=1e-5
    )
    np.testing.assert_allclose(ring.truth.electrons_vignetted, middle.truth.electrons_image, rtol=1e-4)


@pytest.mark.slow
def test_a_sliver_cut_from_the_pupil_is_noticed(engine, bench):
    """A thousandth of the light lost at one edge: quadrature over the whole disk would be wrong, so it is not taken."""
    lens = load_lens("star_camera_206mm")
    last = len(lens.surfaces) - 1
    for radius_mm, expected in ((12.60, "quadrature"), (12.55, "arcs"), (12.50, "arcs")):
        cut = lens.with_surfaces({last: replace(lens.surfaces[last], semi_diameter_mm=radius_mm)})
        camera = bench.camera_of(cut, film=False)
        stars = bench.stars_at(camera, 4000.2, 1900.3, bands=((600.0, 0.0),))
        traced = Tracer(camera).render(stars, exposure_s=1.0)
        assert set(traced.sampling) == {expected}
        _, _, weight = bench.bundle(camera, stars, 0, 0, rings=2000, arms=401, stagger=True)
        lost = traced.truth.electrons_vignetted[0, 0] / traced.truth.electrons_in[0, 0]
        assert lost == pytest.approx(1 - weight.sum(), abs=TOLERANCE)
        assert (lost > 5e-4) == (expected == "arcs")


@pytest.mark.slow
def test_a_star_that_loses_light_unforeseen_is_no_matter_of_its_neighbour(engine, bench):
    """Two cut beams of different outlines; the first loses light within its own and goes on to points that fit any."""
    camera = bench.camera_of("star_tracker_26mm")
    wavelength = 675.0 + 230.7588 * np.polynomial.legendre.leggauss(12)[0]
    direction = np.array([[-0.1771494, 0.1728763, 0.9688818], [-0.1674469, 0.1385589, 0.9760958]])
    direction = (direction / np.linalg.norm(direction, axis=1, keepdims=True)) @ camera.rotation_cam_from_world
    images = []
    for some in (direction, direction[:1], direction[1:]):
        stars = star_field(some, wavelength, 1e3)
        images.append(Tracer(camera).render(stars, exposure_s=1.0).electrons)
    np.testing.assert_allclose(images[0], images[1] + images[2], atol=1e-4 * images[0].max())


def test_probes_cover_the_field_and_bounds_the_rim():
    v = probe_fields(0.3)
    assert np.allclose(np.linalg.norm(v, axis=1), 1.0)
    assert np.degrees(np.arccos(v[:, 2]).max()) == pytest.approx(np.degrees(0.3))
    radius = np.linalg.norm(bounding_disk().points[0], axis=1)
    assert radius.max() == pytest.approx(1.0)
    assert np.count_nonzero(radius > 0.999) == 48
