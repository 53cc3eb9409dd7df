"""Stars through measured and ideal lenses against GalSim, the camera model and sums by hand."""

import numpy as np
import pytest
from fields import star_field
from scipy.spatial.transform import Rotation

from optics.lens.ideal_lens import measured_lens
from optics.lens.measured import GaussianMixture, MeasuredLens
from optics.response import Response
from render.camera import Camera
from render.forward import StarRenderer
from render.motion.trajectory import ConstantRate
from render.tracing.measured.images import LINE_ERROR, line_nodes
from render.tracing.motion.exposure import exposure_motion
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.tracer import Tracer

PITCH_MM = 0.005
FOCAL_MM = 25.0


def mixture(components, wavelength_nm=(600.0,)):
    """PSF of (share, sigma_x, sigma_y, correlation, offset_x) in px; the same everywhere, wider towards the red."""
    k = len(components)
    share, sx, sy, rho, offset = np.array(components, float).T
    wide = np.linspace(1.0, 1.2, len(wavelength_nm))[:, None] if len(wavelength_nm) > 1 else np.ones((1, 1))
    cov = np.stack([sx**2, sy**2, rho * sx * sy], axis=-1) * wide[..., None] * PITCH_MM**2
    shape = (len(wavelength_nm), 1, 1, k)
    return GaussianMixture(
        wavelength_nm=np.array(wavelength_nm),
        y_mm=np.zeros(1),
        x_mm=np.zeros(1),
        share=np.broadcast_to(share, shape),
        offset_mm=np.broadcast_to(np.stack([offset, 0 * offset], -1) * PITCH_MM, (*shape, 2)),
        covariance_mm2=cov.reshape(*shape, 3),
    )


def camera_of(psf, size=64, **changes):
    settings = {
        "name": "test",
        "source": "test",
        "date": "2026-01-01",
        "focal_length_mm": FOCAL_MM,
        "principal_point_mm": np.array([0.01, -0.02]),
        "distortion": np.array([-2e-4, 0.0, 0.0, 1e-5, -2e-5]),
        "colour_nm": np.zeros(0),
        "colour_scale": np.zeros(0),
        "colour_shift_mm": np.zeros((0, 2)),
        "psf": psf,
        "includes_charge_diffusion": True,
        "vignetting_mm": np.array([0.0, 0.2]),
        "relative_light": np.array([1.0, 0.6]),
        "aperture_mm": 10.0,
        "transmission": Response(
            name="t", source="test", wavelength_nm=np.array([400.0, 900.0]), value=np.array([0.8, 0.8])
        ),
        "reference_wavelength_nm": 600.0,
        "max_field_deg": 5.0,
    }
    lens = measured_lens(MeasuredLens(**{**settings, **changes}))
    return Camera(lens=lens, width_px=size, height_px=size, pixel_pitch_mm=PITCH_MM, diffraction="waves")


def stars_at(camera, x_px, y_px, wavelength_nm=(600.0,), rate=1000.0):
    direction = camera.nominal_direction(np.asarray(x_px, float), np.asarray(y_px, float), FOCAL_MM)
    return star_field(direction, wavelength_nm, rate / len(wavelength_nm))


OBLIQUE = [(0.12, 0.25, 0.25, 0.0, 0.0), (0.74, 0.63, 0.73, 0.5, 0.0), (0.14, 2.2, 1.9, -0.3, 0.4)]


@pytest.mark.slow
@pytest.mark.reference
def test_images_are_those_of_galsim():
    galsim = pytest.importorskip("galsim")
    camera = camera_of(mixture(OBLIQUE))
    image = StarRenderer(camera).render(stars_at(camera, [30.3], [28.8]))
    truth = image.truth
    total = galsim.ImageD(64, 64, xmin=0, ymin=0, scale=1.0)
    for share, sx, sy, rho, offset in OBLIQUE:
        # GalSim's shear about a round Gaussian of the same determinant
        cov = np.array([[sx**2, rho * sx * sy], [rho * sx * sy, sy**2]])
        size = np.linalg.det(cov) ** 0.25
        root = np.linalg.cholesky(cov) / size
        psf = galsim.Transform(galsim.Gaussian(sigma=size), jac=root)
        place = galsim.PositionD(truth.chief_x_px[0, 0] + offset, truth.chief_y_px[0, 0])
        both = galsim.Convolve(
            psf,
            galsim.Pixel(1.0),
            gsparams=galsim.GSParams(folding_threshold=1e-6, maxk_threshold=1e-6, maximum_fft_size=16384),
        )
        total += both.drawImage(total.copy(), method="no_pixel", center=place, add_to_image=False) * share
    electrons = float(truth.electrons_image[0, 0] + truth.electrons_beyond[0, 0])
    np.testing.assert_allclose(image.electrons[..., 0] / electrons, total.array, atol=4e-6)


def test_light_is_kept():
    camera = camera_of(mixture(OBLIQUE))
    stars = stars_at(camera, [31.0, 1.0, 63.4, 200.0], [31.0, 20.0, 63.4, 31.0])
    image = StarRenderer(camera, exposure_s=0.5).render(stars)
    t = image.truth
    parts = t.electrons_image + t.electrons_vignetted + t.electrons_off_edge + t.electrons_hidden + t.electrons_beyond
    np.testing.assert_allclose(parts, t.electrons_in, rtol=1e-9)
    # by hand: photons of both, the aperture, nothing else on the axis
    np.testing.assert_allclose(t.electrons_in, 1000.0 * 0.5 * np.pi * 25.0, rtol=1e-12)
    assert np.abs(t.electrons_beyond[0] / t.electrons_in[0]) < 1e-9
    assert image.electrons.sum() == pytest.approx(t.electrons_image.sum(), rel=1e-6)
    assert t.electrons_image[3] == 0.0


def test_places_are_those_of_the_camera_model():
    camera = camera_of(mixture([(1.0, 0.8, 0.8, 0.0, 0.0)]), size=256)
    stars = stars_at(camera, [20.0, 130.0, 240.0], [30.0, 120.0, 250.0])
    image = StarRenderer(camera).render(stars)
    place = camera.lens.measured.position_mm(stars.direction) / PITCH_MM + camera.centre_px
    for which in ("chief", "bundle", "photon"):
        found = np.stack([getattr(image.truth, f"{which}_{axis}_px")[:, 0] for axis in "xy"], axis=-1)
        np.testing.assert_allclose(found, place, atol=1e-9)
    np.testing.assert_allclose(Tracer(camera).bundle_means(stars)[:, 0], place, atol=1e-9)
    for (x, y), t in zip(place, range(3), strict=True):  # the first moment of pixels of a wide image is unbiased
        rows, columns = np.mgrid[round(y) - 6 : round(y) + 7, round(x) - 6 : round(x) + 7]
        if columns.max() > 255 or rows.max() > 255:
            continue
        light = image.electrons[rows, columns, 0].astype(float)
        assert (light * columns).sum() / light.sum() == pytest.approx(x, abs=2e-6), t
        assert (light * rows).sum() / light.sum() == pytest.approx(y, abs=2e-6)


def test_colours_mix_in_proportion_to_their_light():
    waves = (500.0, 550.0, 700.0)
    shift = {"colour_nm": [500.0, 700.0], "colour_scale": [1.0, 1.0], "colour_shift_mm": [[0.0, 0.0], [2e-3, 0.0]]}
    camera = camera_of(mixture([(1.0, 0.7, 0.7, 0.0, 0.0)], (500.0, 700.0)), **shift)
    white = StarRenderer(camera).render(stars_at(camera, [30.2], [31.0], waves))
    alone = [StarRenderer(camera).render(stars_at(camera, [30.2], [31.0], (w,))) for w in waves]
    np.testing.assert_allclose(white.electrons, sum(one.electrons for one in alone) / 3.0, rtol=1e-5, atol=1e-3)
    expected = np.mean([one.truth.photon_x_px[0, 0] for one in alone])
    assert white.truth.photon_x_px[0, 0] == pytest.approx(expected, abs=1e-12)
    assert alone[2].truth.photon_x_px[0, 0] - alone[0].truth.photon_x_px[0, 0] == pytest.approx(0.4, abs=1e-9)


def test_a_trail_is_a_sum_of_stars_at_rest():
    camera = camera_of(mixture([(1.0, 0.6, 0.8, 0.3, 0.0)]))
    rate = np.array([0.0, 0.004, 0.0])  # 20 px in one second
    turning = ConstantRate(initial=Rotation.from_rotvec(-0.5 * rate), rate_rad_per_s=rate, end_s=1.0)
    motion = exposure_motion(turning, start_s=0.0, exposure_s=1.0, camera=camera)
    stars = stars_at(camera, [31.0], [31.0])
    image = StarRenderer(camera).render(stars, motion=motion)
    node, weight = np.polynomial.legendre.leggauss(60)
    total = np.zeros((64, 64))
    renderer = StarRenderer(camera)
    for t, w in zip(0.5 * (1 + node), 0.5 * weight, strict=True):
        turn = turning.attitude(np.array([t])).as_matrix()[0]
        total += w * renderer.render(stars, rotation_cam_from_world=turn).electrons[..., 0]
    np.testing.assert_allclose(image.electrons[..., 0], total, atol=1e-4 * total.max())
    parts = image.truth.electrons_image + image.truth.electrons_vignetted + image.truth.electrons_beyond
    np.testing.assert_allclose(parts, image.truth.electrons_in, rtol=1e-9)


def test_epsf_is_the_integral_over_pixels():
    from scipy.special import erf

    camera = camera_of(mixture([(1.0, 0.7, 0.9, 0.0, 0.0)]))
    psf = render_epsf(epsf_tracer(camera), stars_at(camera, [31.4], [30.1]), half_size_px=5)[0][0]
    at = (np.arange(psf.values.shape[0]) - psf.values.shape[0] // 2) / psf.oversampling
    x, y = (0.5 * (erf((at + 0.5) / np.sqrt(2) / s) - erf((at - 0.5) / np.sqrt(2) / s)) for s in (0.7, 0.9))
    np.testing.assert_allclose(psf.values, np.outer(y, x), atol=1e-12)


@pytest.mark.parametrize("step", [1, 6, 12, 18])
def test_lines_make_gaussians_of_their_variance(step):
    node, weight = line_nodes(step)
    assert weight @ node**2 == pytest.approx(1.0, rel=1e-12)
    variance = 2.0 * step / 20 / (1.0 - step / 20)
    at = np.linspace(0.0, 4.0, 41) * np.sqrt(1.0 + variance)
    made = np.exp(-0.5 * (at[:, None] - np.sqrt(variance) * node) ** 2) @ weight * np.sqrt(1.0 + variance)
    np.testing.assert_allclose(made, np.exp(-0.5 * at**2 / (1.0 + variance)), atol=LINE_ERROR)
