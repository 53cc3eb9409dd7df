"""Motion during the exposure: against sums of images at rest, row by row for a rolling shutter, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.motion.trajectory import ConstantRate, SampledAttitude
from render.tracing.motion.exposure import exposure_motion
from render.tracing.motion.paths import pick_times, star_paths
from render.tracing.motion.rolling_shutter import recorded, recorded_gaussians
from render.tracing.tracer import Tracer

EXPOSURE_S = 0.4


def turning(camera, px_per_s, angle=0.7, roll_rad_per_s=0.0, end_s=2.0):
    """A camera whose image moves with so many pixels per second along (cos, sin)(angle) in its middle."""
    scale = px_per_s * camera.pixel_pitch_mm / abs(_focal_mm(camera))
    rate = np.array([-np.sin(angle) * scale, np.cos(angle) * scale, roll_rad_per_s])
    return ConstantRate(initial=Rotation.from_rotvec(-0.5 * EXPOSURE_S * rate), rate_rad_per_s=-rate, end_s=end_s)


def _focal_mm(camera):
    from optics.rays.paraxial import axial_paraxial

    return axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm


def small(bench, name, size=44, x=700.0, y=300.0):
    """A small film far from the axis, and the camera that it is a part of."""
    whole = bench.camera_of(name)
    return bench.window(whole, size, x, y), whole


def images_at(tracer, stars, trajectory, times):
    """Images at rest (t, h, w) at given times."""
    attitudes = trajectory.attitude(times).as_matrix()
    renders = [tracer.render(stars, exposure_s=EXPOSURE_S, rotation_cam_from_world=a) for a in attitudes]
    return np.stack([r.electrons[..., 0].astype(float) for r in renders]), renders[0].truth.electrons_in.max()


@pytest.mark.slow
def test_image_is_the_mean_of_images_at_rest(engine, bench):
    px = 3.0
    camera, whole = small(bench, "star_tracker_26mm")
    stars = bench.stars_at(whole, [699.3, 707.2], [301.4, 290.9], nodes=2, rate=[100.0, 30.0])
    trajectory = turning(whole, px / EXPOSURE_S, roll_rad_per_s=0.01)
    tracer = Tracer(camera)
    motion = exposure_motion(trajectory, start_s=0.0, exposure_s=EXPOSURE_S, camera=camera)
    assert 1 < len(motion.weight) < 40
    traced = tracer.render(stars, exposure_s=EXPOSURE_S, motion=motion)
    assert set(traced.sampling) == {"quadrature"}
    times = EXPOSURE_S * (np.arange(50) + 0.5) / 50  # of a midpoint rule, 0.06 px apart
    expected, light = images_at(tracer, stars, trajectory, times)
    edges = 1.0 / 24 / 50**2  # of the midpoint rule: h^2 / 24 times the change of the slope
    assert np.abs(traced.electrons[..., 0] - expected.mean(0)).max() < (6e-5 + 4 * edges * px) * light
    total = traced.truth.electrons_image + traced.truth.electrons_vignetted + traced.truth.electrons_off_edge
    assert np.abs(total / traced.truth.electrons_in - 1).max() < 1e-9


def test_moments_of_a_streak(engine, bench):
    """Uniform motion adds L^2 / 12, with L from mean positions at rest at both ends; the mean is that of the middle."""
    camera = bench.camera_of("star_tracker_26mm", film=False)
    stars = bench.stars_at(camera, [511.2, 620.4], [511.9, 400.3], nodes=2)
    tracer = Tracer(camera)
    for px in (0.5, 4.0):
        trajectory = turning(camera, px / EXPOSURE_S)
        moved, back = (
            tracer.render(
                stars,
                exposure_s=EXPOSURE_S,
                motion=exposure_motion(path, start_s=0.0, exposure_s=EXPOSURE_S, camera=camera),
            ).truth
            for path in (trajectory, _reversed(trajectory))
        )
        first, mid, last = (
            tracer.render(
                stars, exposure_s=EXPOSURE_S, rotation_cam_from_world=trajectory.attitude(t).as_matrix()
            ).truth
            for t in (0.0, EXPOSURE_S / 2, EXPOSURE_S)
        )
        for axis in "xy":
            length = getattr(last, f"bundle_{axis}_px") - getattr(first, f"bundle_{axis}_px")
            added = getattr(moved, f"variance_{axis}_px2") - getattr(mid, f"variance_{axis}_px2")
            assert added == pytest.approx(length**2 / 12, abs=2e-5 * px + 1e-5)
            assert np.abs(getattr(moved, f"chief_{axis}_px") - getattr(mid, f"chief_{axis}_px")).max() < 1e-9
            # the path bends by (L/f)^2 only
            assert np.abs(getattr(moved, f"bundle_{axis}_px") - getattr(mid, f"bundle_{axis}_px")).max() < 1e-4 * px
            assert np.abs(getattr(moved, f"photon_{axis}_px") - getattr(moved, f"bundle_{axis}_px")).max() < 1e-5
            assert np.abs(getattr(moved, f"bundle_{axis}_px") - getattr(back, f"bundle_{axis}_px")).max() < 3e-5
        assert moved.electrons_in == pytest.approx(mid.electrons_in, rel=1e-6)
        assert moved.electrons_vignetted == pytest.approx(mid.electrons_vignetted, abs=1e-5 * mid.electrons_in.max())


def _reversed(trajectory):
    """The same path the other way round, within the exposure."""
    times = np.linspace(0.0, EXPOSURE_S, 9)
    return SampledAttitude(samples_s=times, attitudes=trajectory.attitude(times[::-1]))


@pytest.mark.slow
def test_rolling_shutter_row_by_row(engine, bench):
    """Every row is the mean of images at rest over its own time."""
    camera, whole = small(bench, "star_tracker_26mm", size=28)
    stars = bench.stars_at(whole, [699.3], [301.4], nodes=1)
    speed, line_time_s = 3.0 / EXPOSURE_S, 5e-4
    trajectory = turning(whole, speed, angle=1.0)
    tracer = Tracer(camera)
    motion = exposure_motion(trajectory, start_s=0.0, exposure_s=EXPOSURE_S, camera=camera, line_time_s=line_time_s)
    traced = tracer.render(stars, exposure_s=EXPOSURE_S, motion=motion)
    step = EXPOSURE_S / 50  # 0.06 px
    cells = np.arange(53) * step
    images, light = images_at(tracer, stars, trajectory, cells + 0.5 * step)
    start = np.arange(28)[:, None] * line_time_s
    overlap = np.minimum(cells + step, start + EXPOSURE_S) - np.maximum(cells, start)
    rows = np.einsum("rt,trx->rx", np.maximum(overlap, 0.0) / EXPOSURE_S, images)
    assert (
        np.abs(traced.electrons[..., 0] - rows).max() < 1.5e-4 * light
    )  # 0.003 px per line: see `render.tracing.motion.paths`
    # the shutter follows the star, which gets more time
    velocity = speed * np.sin(1.0)
    assert traced.truth.electrons_in[0, 0] / light == pytest.approx(1.0 / (1.0 - velocity * line_time_s), abs=1e-4)
    assert traced.electrons.sum(dtype=float) / rows.sum() == pytest.approx(1.0, abs=3e-5)


def test_skew_of_a_rolling_shutter(engine, bench):
    """Stars are where the camera points when their row is exposed: y line times later than the first row."""
    camera = bench.camera_of("star_camera_206mm", film=False)
    camera = replace(camera, height_px=2048)  # no image, but rows
    stars = bench.stars_at(camera, [2000.3, 2100.2, 1900.1], [20.4, 1000.7, 2030.2], nodes=1)
    speed, line_time_s = 30.0, 2e-5
    trajectory = turning(camera, speed, angle=0.3)
    motion = exposure_motion(trajectory, start_s=0.0, exposure_s=EXPOSURE_S, camera=camera, line_time_s=line_time_s)
    tracer = Tracer(camera)
    truth = tracer.render(stars, exposure_s=EXPOSURE_S, motion=motion).truth
    for star in range(3):
        one = replace(stars, direction=stars.direction[[star]], photon_rate=stars.photon_rate[[star]])
        time = EXPOSURE_S / 2 + truth.chief_y_px[star, 0] * line_time_s
        rotation = trajectory.attitude(time).as_matrix()
        still = tracer.render(one, exposure_s=EXPOSURE_S, rotation_cam_from_world=rotation).truth
        assert truth.chief_x_px[star, 0] == pytest.approx(still.chief_x_px[0, 0], abs=1e-5)
        assert truth.chief_y_px[star, 0] == pytest.approx(still.chief_y_px[0, 0], abs=1e-5)
        assert truth.bundle_x_px[star, 0] == pytest.approx(still.bundle_x_px[0, 0], abs=1e-3)
    shift = speed * (truth.chief_y_px[2, 0] - truth.chief_y_px[0, 0]) * line_time_s
    assert shift > 1.0


def test_stars_that_leave_the_frame(engine, bench):
    camera = bench.camera_of("star_camera_206mm")
    camera = bench.window(camera, 60, 2000, 1000)
    stars = bench.stars_at(camera, [29.5, 55.0, 64.0], [29.5, 40.0, 10.0], nodes=1)
    trajectory = turning(camera, 12.0 / EXPOSURE_S, angle=0.0)
    motion = exposure_motion(trajectory, start_s=0.0, exposure_s=EXPOSURE_S, camera=camera)
    traced = Tracer(camera).render(stars, exposure_s=EXPOSURE_S, motion=motion)
    truth = traced.truth
    off = truth.electrons_off_edge[:, 0] / truth.electrons_in[:, 0]
    # from -6 to 6 px about their middle: all on, (55 + 6 - 59.5) / 12 off, (64 + 6 - 59.5) / 12 off
    assert off == pytest.approx([0.0, 1.5 / 12, 10.5 / 12], abs=3e-3)
    assert traced.electrons.sum(dtype=float) == pytest.approx(truth.electrons_image.sum(), rel=1e-6)


def test_number_of_nodes_follows_the_path(bench):
    camera = bench.camera_of("star_tracker_26mm")
    counts = []
    for px in (1e-5, 0.1, 1.0, 10.0, 60.0):
        motion = exposure_motion(turning(camera, px / EXPOSURE_S), start_s=0, exposure_s=EXPOSURE_S, camera=camera)
        assert motion.length_px == pytest.approx(px, rel=0.3)  # longer in the corners
        assert motion.weight.sum() == pytest.approx(1.0, rel=1e-14)
        counts.append(len(motion.weight))
    assert counts[0] == 1
    assert counts == sorted(counts)
    assert counts[-1] > 100


def test_paths_are_led_by_few_directions(bench):
    """What is quadratic in the direction is interpolated exactly along a straight path, and nearly along any."""
    camera = bench.camera_of("star_tracker_26mm")
    motion = exposure_motion(turning(camera, 100.0), start_s=0.0, exposure_s=EXPOSURE_S, camera=camera)
    directions = bench.stars_at(camera, [300.0, 700.0], [500.0, 200.0]).direction
    paths = star_paths(motion, directions, camera)
    picked, factor = pick_times(paths)
    assert factor.shape == (2, len(motion.weight), 3)

    def value(v):
        return 1.0 + 3.0 * v[..., 0] - v[..., 1] ** 2 + v[..., 0] * v[..., 1]

    assert np.einsum("ntp,np->nt", factor, value(picked)) == pytest.approx(value(paths.nodes), abs=3e-5)


def test_recorded_gaussians_have_the_moments_of_recorded_points():
    """Points of a Gauss-Hermite rule, whose moments are those of the Gaussian, recorded one by one."""
    mean, shear = np.array([3.0, 7.0]), np.array([6.0, 0.05, -0.1])
    root = np.array([[0.6, 0.0], [0.3, 0.8]])
    covariance = (root @ root.T)[[0, 1, 0], [0, 1, 1]]
    node, weight = np.polynomial.hermite_e.hermegauss(4)
    points = mean + np.stack(np.meshgrid(node, node), axis=-1).reshape(-1, 2) @ root.T
    weights = np.outer(weight, weight).ravel() / weight.sum() ** 2
    landed = np.stack(recorded(*points.T, *shear))
    centre, (xx, yy, xy) = recorded_gaussians(mean, covariance, shear)
    assert centre == pytest.approx(landed @ weights)
    assert np.cov(landed, aweights=weights, ddof=0) == pytest.approx(np.array([[xx, xy], [xy, yy]]))
