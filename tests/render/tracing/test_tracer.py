"""Truth against the traced light, the balance of electrons, directions, linearity, reproducibility, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optics.frames import field_angles_deg
from optics.lens.apertures import Spider
from optics.lens.perturb import decentre
from optics.lens_file import load_lens
from optics.rays.chief_ray import chief_ray_points
from render.tracing.convergence import TOLERANCE
from render.tracing.tracer import Tracer

LENSES = ("star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm")
BANDS = ((500.0, 100.0), (600.0, 100.0), (800.0, 100.0))


def rendered(camera, stars, **settings):
    return Tracer(camera, **settings).render(stars, exposure_s=1.0)


def over_the_field(bench, name):
    """Columns and rows of seven stars from the axis to the corner, off the symmetry axes, at various phases."""
    width, height, _, reach = bench.geometry[name]
    part = np.linspace(0.0, reach, 7)
    x = (width - 1) / 2 + part * width / 2 * np.array([1, -1, 1, 1, -1, -1, 1]) + 0.13 * np.arange(7)
    y = (height - 1) / 2 + part * height / 2 * np.array([1, 1, -1, 0.3, -1, 0.2, 1]) + 0.41
    return x, y


@pytest.mark.parametrize(
    ("name", "diffusion_px"),
    [
        (LENSES[0], 0.18),
        pytest.param(LENSES[1], 0.18, marks=pytest.mark.slow),
        pytest.param(LENSES[2], 0.0, marks=pytest.mark.slow),
    ],
)
def test_photon_centroid_is_the_bundle_mean(engine, bench, name, diffusion_px):
    camera = bench.camera_of(name, film=False, charge_diffusion_px=diffusion_px)
    stars = bench.stars_at(camera, *over_the_field(bench, name), bands=BANDS)
    truth = rendered(camera, stars, sobol_log2_rays=14).truth
    assert np.isfinite(truth.photon_x_px).all()
    assert np.hypot(truth.photon_x_px - truth.bundle_x_px, truth.photon_y_px - truth.bundle_y_px).max() < 1e-5


@pytest.mark.parametrize("name", [LENSES[0], pytest.param(LENSES[2], marks=pytest.mark.slow)])
def test_truth_against_a_dense_numpy_bundle(engine, bench, name):
    """Bundle means, variances and vignetting; where apertures cut the bundle, as good as 2^16 Sobol rays are."""
    camera = bench.camera_of(name, film=False)
    x, y = over_the_field(bench, name)
    stars = bench.stars_at(camera, x[[1, 4, 6]], y[[1, 4, 6]], bands=((600.0, 0.0),))
    truth = rendered(camera, stars).truth
    exact = name == "star_camera_206mm"
    for star in range(3):
        rays = bench.bundle(camera, stars, star, 0, rings=120 if exact else 400, arms=400, stagger=not exact)
        mean, light = bench.mean_of(*rays), rays[2].sum()
        spread = np.sqrt(truth.variance_x_px2[star, 0] + truth.variance_y_px2[star, 0])
        tolerance = 1e-6 if exact else 1e-3 * spread  # the error scales with the size of the spot
        assert np.hypot(truth.bundle_x_px[star, 0] - mean[0], truth.bundle_y_px[star, 0] - mean[1]) < tolerance
        variance = rays[2] @ (rays[0] - mean[0]) ** 2 / light
        assert truth.variance_x_px2[star, 0] == pytest.approx(variance, rel=1e-4 if exact else 5e-3)
        arrived = truth.electrons_in[star, 0] - truth.electrons_vignetted[star, 0]
        assert arrived / bench.launched(camera, stars)[star, 0] == pytest.approx(light, abs=1e-12 if exact else 5e-4)


@pytest.mark.slow
def test_light_that_enters_is_what_the_stop_alone_would_pass(engine, bench):
    lens = load_lens("double_gauss_50mm")
    hood = {0: replace(lens.surfaces[0], semi_diameter_mm=11.5)}
    wide = {
        i: replace(s, semi_diameter_mm=s.semi_diameter_mm + 0.6) for i, s in enumerate(lens.surfaces) if not s.is_stop
    }
    truths = []
    for system in (lens.with_surfaces(hood), lens.with_surfaces(wide)):
        camera = bench.camera_of(system, film=False)
        place = bench.stars_at(camera, [1000.0], [500.0], bands=((600.0, 0.0),))
        direction = np.array([[np.sin(0.03), 0.0, np.cos(0.03)]])
        truths.append(rendered(camera, replace(place, direction=direction)).truth)
    cut, free = truths
    assert cut.electrons_in[0, 0] == pytest.approx(free.electrons_in[0, 0], rel=TOLERANCE)
    assert cut.electrons_vignetted[0, 0] > 0.03 * cut.electrons_in[0, 0]
    assert free.electrons_vignetted[0, 0] < 1e-12 * free.electrons_in[0, 0]


def test_means_of_cut_beams(engine, bench):
    """On NumPy where the kernel has no outline (a spider): against a dense bundle."""
    lens = load_lens(LENSES[1])
    stop = lens.surfaces[lens.stop_index]
    vanes = replace(stop, apertures=(Spider(obscures=True, arms=3, width_mm=0.2),))
    camera = bench.camera_of(lens.with_surfaces({lens.stop_index: vanes}), film=False)
    stars = bench.stars_at(camera, [500.0, 800.0], [500.0, 300.0], bands=((600.0, 0.0),))
    means = Tracer(camera).bundle_means(stars, rings=40, arms=90)
    for star in range(2):
        rays = bench.bundle(camera, stars, star, 0, stagger=True)
        assert means[star, 0] == pytest.approx(bench.mean_of(*rays), abs=5e-3)


@pytest.mark.parametrize("name", LENSES[:2])
def test_chief_rays_go_through_the_centre_of_the_stop(engine, bench, name):
    camera = bench.camera_of(name, film=False)
    stars = bench.stars_at(camera, *over_the_field(bench, name), bands=((650.0, 0.0),))
    truth = rendered(camera, stars, sobol_log2_rays=8).truth
    x, y = camera.to_pixel(*chief_ray_points(camera.lens, *field_angles_deg(stars.direction), 650.0))
    assert np.abs(truth.chief_x_px[:, 0] - x).max() < 1e-8
    assert np.abs(truth.chief_y_px[:, 0] - y).max() < 1e-8


@pytest.mark.slow
def test_every_electron_is_accounted_for(engine, bench):
    """Inside, half off each edge, over a corner, far outside; clear, cut by an aperture, with a decentred stop."""
    lens = load_lens("star_camera_206mm")
    last = len(lens.surfaces) - 1
    cut = lens.with_surfaces({last: replace(lens.surfaces[last], semi_diameter_mm=9.0)})
    moved = decentre(lens, lens.stop_index, x_mm=2.0, y_mm=-1.0)
    x = [2000.3, -0.5, 4095.5, 1500.2, 2500.7, -0.9, 4095.9, 4000.0, -40.0]
    y = [1000.4, 700.1, 900.9, -0.5, 2047.5, -0.2, 2047.7, 2000.0, 300.0]
    for system in (lens, cut, moved):
        for defocus_mm in (0.1,) if system is lens else (0.02,):
            camera = bench.camera_of(system, defocus_mm=defocus_mm)
            traced = rendered(camera, bench.stars_at(camera, x, y, bands=BANDS[:2]), sobol_log2_rays=12)
            truth = traced.truth
            total = truth.electrons_image + truth.electrons_vignetted + truth.electrons_off_edge
            assert np.abs(total / truth.electrons_in - 1).max() < 1e-9  # demanded: 1e-6
            on_image = traced.electrons.sum((0, 1), dtype=float)
            assert on_image == pytest.approx(truth.electrons_image.sum(0), rel=1e-6)
            arrived = truth.electrons_image + truth.electrons_off_edge
            assert (truth.electrons_image[0] == arrived[0]).all()
            if system is lens:
                assert (truth.electrons_image[1:5] > 0.1 * arrived[1:5]).all()
                assert (truth.electrons_image[1:5] < 0.9 * arrived[1:5]).all()
            assert (truth.electrons_image[8] == 0).all()
            assert (truth.electrons_vignetted.max() > 0.1 * truth.electrons_in.max()) == (system is cut)


def test_electrons_are_flux_times_area_times_cosine(engine, bench):
    camera = bench.camera_of()
    stars = bench.stars_at(camera, 4000.0, 1023.5, bands=((600.0, 0.0),), rate=7.0)
    truth = Tracer(camera).render(stars, exposure_s=0.25).truth
    cosine = stars.direction[0, 2]
    assert truth.electrons_in[0, 0] == pytest.approx(7.0 * 0.25 * np.pi * 35.0**2 * cosine, rel=1e-12)


def test_directions_on_the_detector(engine, bench):
    camera = bench.camera_of()
    v = np.array([[0, 0, 1.0], [0.02, 0, 1], [0, 0.01, 1], [-0.02, -0.01, 1]])
    stars = bench.stars_at(camera, 0, 0, direction=v / np.linalg.norm(v, axis=1, keepdims=True))
    traced = rendered(camera, stars)
    x, y = traced.truth.bundle_x_px[:, 0], traced.truth.bundle_y_px[:, 0]
    assert (x[0], y[0]) == pytest.approx((2047.5, 1023.5), abs=1e-9)
    assert x[1] > x[0] + 700  # +X_cam: larger column
    assert y[2] > y[0] + 350  # +Y_cam: larger row
    brightest = np.argwhere(traced.electrons[..., 0] > 0.5 * traced.electrons.max())
    for star in range(4):  # image[row, column]
        assert np.hypot(brightest[:, 0] - y[star], brightest[:, 1] - x[star]).min() < 1.5


@pytest.mark.slow
def test_turning_the_camera_and_the_stars_changes_nothing(engine, bench):
    turn = Rotation.from_euler("zyx", [123.0, -40.0, 77.0], degrees=True).as_matrix()
    camera = bench.camera_of(decentre(load_lens("star_camera_206mm"), "L2", x_mm=0.1))
    camera = bench.window(camera, 600, 300, 300)
    stars = bench.stars_at(camera, [300.2, 800.3], [100.4, 500.5])
    turned = replace(camera, rotation_cam_from_world=turn)
    a = rendered(camera, stars)
    b = rendered(turned, replace(stars, direction=stars.direction @ turn))
    assert np.abs(a.truth.bundle_x_px - b.truth.bundle_x_px).max() < 1e-9
    assert np.abs(a.electrons - b.electrons).max() < 1e-6 * a.electrons.max()
    override = Tracer(camera).render(
        replace(stars, direction=stars.direction @ turn), exposure_s=1.0, rotation_cam_from_world=turn
    )
    assert np.array_equal(override.electrons, b.electrons)


@pytest.mark.slow
def test_narrow_band_becomes_a_line(engine, bench):
    camera = bench.window(bench.camera_of(defocus_mm=0.01), 800, 3600, 400)
    place = ([700.3, 90.1], [300.2, 780.9])
    line = rendered(camera, bench.stars_at(camera, *place, bands=((600.0, 0.0),)))
    offset = []
    for width in (40.0, 10.0, 0.01):
        band = rendered(camera, bench.stars_at(camera, *place, bands=((600.0, width),), nodes=4))
        offset.append(np.abs(band.truth.bundle_x_px - line.truth.bundle_x_px).max())
    assert offset[1] / offset[0] == pytest.approx(1 / 16, rel=0.2)  # second order in the width
    assert offset[2] < 1e-8
    assert np.abs(band.electrons - line.electrons).max() < 3e-5 * line.truth.electrons_in.max()


def test_same_seed_same_bytes_whatever_the_threads(engine, bench):
    import drjit as dr

    camera = replace(bench.camera_of(), width_px=900, height_px=900)
    stars = bench.stars_at(camera, *over_the_field(bench, LENSES[0]))
    threads = dr.thread_count()
    try:
        images = []
        for count in (1, 2, 3):
            dr.set_thread_count(count)
            images.append(rendered(camera, stars, sobol_log2_rays=12, sobol_seed=5))
    finally:
        dr.set_thread_count(threads)
    assert images[0].electrons.tobytes() == images[1].electrons.tobytes() == images[2].electrons.tobytes()
    for field in images[0].truth.__dataclass_fields__:
        assert getattr(images[0].truth, field).tobytes() == getattr(images[1].truth, field).tobytes()
    other = rendered(camera, stars, sobol_log2_rays=12, sobol_seed=6)
    assert np.array_equal(other.electrons, images[0].electrons)  # outlines are known: no Sobol points
    bare = replace(camera, charge_diffusion_px=0.0)
    assert np.array_equal(*(rendered(bare, stars, sobol_log2_rays=8, sobol_seed=5).electrons for _ in range(2)))
    assert not np.array_equal(*(rendered(bare, stars, sobol_log2_rays=8, sobol_seed=seed).electrons for seed in (5, 6)))


def test_no_stars_is_an_empty_image(engine, bench):
    camera = bench.camera_of()
    stars = bench.stars_at(camera, np.empty(0), np.empty(0), bands=BANDS)
    traced = rendered(camera, stars)
    assert traced.electrons.shape == (2048, 4096, 3)
    assert traced.electrons.max() == 0
    assert traced.truth.bundle_x_px.shape == (0, 3)
    assert traced.sampling == {}


def test_star_without_flux_has_a_place_but_no_light(engine, bench):
    camera = bench.camera_of()
    traced = rendered(camera, bench.stars_at(camera, 1000.0, 900.0, rate=0.0))
    assert traced.electrons.max() == 0
    assert traced.truth.bundle_x_px[0, 0] == pytest.approx(1000, abs=5)
    assert traced.truth.electrons_in[0, 0] == 0


@pytest.mark.slow
def test_star_whose_rays_all_fail_is_flagged_in_its_truth(engine, bench):
    """Not an error: the light is accounted for as vignetted, positions are NaN, the other stars are untouched."""
    camera = bench.window(bench.camera_of(), 40, 500, 500)
    place = bench.stars_at(camera, [500.2, 200.0], [500.9, 300.0], bands=((650.0, 0.0),))
    direction = np.array([place.direction[0], [np.sin(0.9), 0.0, np.cos(0.9)]])  # 52 deg off axis
    traced = rendered(camera, replace(place, direction=direction), sobol_log2_rays=12)
    truth = traced.truth
    for name in ("bundle_x_px", "bundle_y_px", "photon_x_px", "photon_y_px", "variance_x_px2", "chief_x_px"):
        assert np.isnan(getattr(truth, name)[1, 0])
        assert np.isfinite(getattr(truth, name)[0, 0])
    assert truth.electrons_vignetted[1, 0] == pytest.approx(truth.electrons_in[1, 0], rel=1e-12)
    assert truth.missing.tolist() == [[""], ["apertures of the lens stop all light of the star"]]
    assert traced.electrons.astype(float).sum() == pytest.approx(truth.electrons_image[0, 0], rel=1e-6)
