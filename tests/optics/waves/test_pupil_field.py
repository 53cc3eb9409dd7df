"""Sums of plane waves against closed forms: Airy, annulus, defocus, a stigmatic lens, and the light they hold."""

from dataclasses import replace

import numpy as np
import pytest
from batoid_trace import batoid_trace
from ideal_pupil import INDEX, WAVE_NM, ideal_pupil
from scipy.integrate import quad
from scipy.special import j0, j1

from optics import Rays, load_lens, wavefront, zernike_map, zernikes
from optics.frames import field_direction, light_direction
from optics.waves.image_quality import encircled_energy, peak, strehl, strehl_through_focus, transfer_function
from optics.waves.pupil_field import needed_order, trace_pupil

K = 2.0 * np.pi * INDEX / (WAVE_NM * 1e-6)  # [1/mm]


@pytest.mark.parametrize("hole", [0.0, 0.5])
def test_a_perfect_lens_images_an_airy_pattern_and_an_annulus_the_difference_of_two_amplitudes(hole):
    sine, grid = 0.17, np.linspace(-0.02, 0.02, 40)
    image = ideal_pupil(sine, hole).intensity(grid, grid)
    v = K * sine * np.hypot(*np.meshgrid(grid, grid))
    amplitude = (2.0 * j1(v) / v - hole * 2.0 * j1(hole * v) / v) / (1.0 - hole**2)
    top = np.pi * (INDEX / (WAVE_NM * 1e-6)) ** 2 * sine**2 * (1.0 - hole**2)
    assert np.abs(image - top * amplitude**2).max() < 1e-9 * top


def test_defocus_of_fast_light_is_the_integral_over_the_cone():
    sine, z = 0.3, 0.004
    field = ideal_pupil(sine).shifted(z)
    r = 0.0011
    parts = [
        quad(lambda s, f=f: f(K * z * np.sqrt(1.0 - s * s)) * j0(K * s * r) * s, 0.0, sine, limit=200, epsabs=1e-14)[0]
        for f in (np.cos, np.sin)
    ]
    expected = (parts[0] ** 2 + parts[1] ** 2) * 4.0 * np.pi / sine**2 * (INDEX / (WAVE_NM * 1e-6)) ** 2
    assert field.intensity(np.array([r]), np.zeros(1))[0, 0] == pytest.approx(expected, rel=1e-9)


def test_the_light_in_a_circle_is_that_of_rayleigh():
    """1 - J0^2 - J1^2 within a circle (Born & Wolf, sec. 8.5.2): also fixes the scale of the intensity."""
    sine = 0.17
    radius = np.array([0.001, 0.0035, 0.009])
    v = K * sine * radius
    expected = 1.0 - j0(v) ** 2 - j1(v) ** 2
    assert encircled_energy(ideal_pupil(sine, order=(24, 80)), radius) == pytest.approx(expected, abs=1e-9)


def test_the_transfer_function_of_a_perfect_lens():
    """2 / pi (acos v - v sqrt(1 - v^2)), v = frequency over the cutoff."""
    sine = 0.17
    part = np.array([0.1, 0.4, 0.8, 1.1])
    cutoff = 2.0 * sine * INDEX / (WAVE_NM * 1e-6)
    frequency = cutoff * part[:, None] * np.array([0.6, 0.8])
    v = np.minimum(part, 1.0)
    expected = 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v))
    perfect = ideal_pupil(sine, order=(16, 64))
    assert np.abs(transfer_function(perfect, frequency) - expected).max() < 6e-5
    shift = replace(perfect, x_mm=perfect.x_mm + 0.001)  # the whole image: about its mean nothing changes
    assert transfer_function(shift, frequency[:1], size=64) == pytest.approx(expected[0], abs=1e-3)
    coma = zernike_map([0, 0, 0, 0, 0, 0, 0, 40.0])
    bent = coma.added_to(ideal_pupil(sine, order=(44, 176)))  # against the Fourier transform of its image
    grid = 7e-4 * (np.arange(120) - 59.5)
    image = bent.intensity(grid, grid)
    theirs = [(image * np.exp(-2j * np.pi * (fx * grid + fy * grid[:, None]))).sum() for fx, fy in frequency[:2]]
    assert transfer_function(bent, frequency[:2], size=128) == pytest.approx(theirs / image.sum(), abs=0.02)


@pytest.mark.parametrize(("name", "field"), [("star_camera_206mm", 3.5), ("star_tracker_26mm", 9.0)])
def test_all_light_of_a_traced_pupil_reaches_the_plane_and_keeps_its_centre(name, field):
    """Parseval with the Jacobian; a taper keeps the image inside a window (a hard edge leaves 1 / r outside)."""
    traced = trace_pupil(load_lens(name), field, 0.3 * field, 600.0, order=(48, 192))
    x, y, area = (v[0, 0] for v in (traced.pupil_x, traced.pupil_y, traced.area_mm2))
    centre = (area * x).sum() / area.sum(), (area * y).sum() / area.sum()
    taper = np.exp(-14.0 * ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) * np.pi / area.sum())
    light = replace(traced, area_mm2=(area * taper**2)[None, None], jacobian=traced.jacobian / taper**2)
    mean_x, mean_y = (float(v[0, 0]) for v in light.mean_mm)
    step = 6e-4
    grid = step * (np.arange(100) - 49.5)
    image = light.intensity(mean_x + grid, mean_y + grid) * step**2
    assert image.sum() == pytest.approx(1.0, abs=1e-9)
    assert abs(image.sum(0) @ grid) < 1e-9  # [mm]
    assert abs(image.sum(1) @ grid) < 1e-9


def test_small_errors_lower_the_strehl_ratio_by_marechals_law():
    field = ideal_pupil(0.15, order=(16, 48))
    for nm in (8.0, 16.0):
        with_error = zernike_map([0, 0, 0, 0, nm, 0, nm, 0, 0, 0, 0.5 * nm]).added_to(field)
        sigma = 1.5 * nm / WAVE_NM
        assert wavefront(with_error).rms_waves == pytest.approx(sigma, rel=1e-5)
        assert strehl(with_error) == pytest.approx(np.exp(-((2.0 * np.pi * sigma) ** 2)), abs=4.0 * sigma**3)
        assert wavefront(with_error).marechal == pytest.approx(np.exp(-((2.0 * np.pi * sigma) ** 2)), rel=1e-5)
    assert strehl(field) == pytest.approx(1.0, abs=1e-9)


def test_spherical_aberration_balanced_by_defocus_is_brightest_midway():
    """Born & Wolf, sec. 9.1.3: W = a (r^4 - r^2) is brightest at the mean of paraxial and marginal focus."""
    field = ideal_pupil(0.02, order=(24, 64))
    r2 = (field.l**2 + field.m**2) / 0.02**2
    a = 300e-6  # [mm]
    spherical = field.with_path(a * r2**2)
    marginal = -4.0 * a / 0.02**2 / INDEX  # where the rim's rays cross the axis
    z = np.array([0.4, 0.5, 0.6]) * -marginal
    low, middle, high = strehl_through_focus(spherical, z)
    assert middle > max(low, high)
    turns = 2.0 * np.pi * a / (WAVE_NM * 1e-6)
    parts = [quad(lambda t, f=f: f(turns * (t - 0.5) ** 2), 0.0, 1.0)[0] for f in (np.cos, np.sin)]
    expected = parts[0] ** 2 + parts[1] ** 2
    assert middle == pytest.approx(expected, abs=2e-4)


def test_the_order_that_a_window_asks_for_is_enough_and_no_more_than_that():
    lens = load_lens("star_camera_206mm")
    half = 0.04
    probe = trace_pupil(lens, 3.5, 0.0, 500.0, order=(12, 32))
    order = needed_order(probe, half)
    corner = np.array([half])
    fine, planned, coarse = (trace_pupil(lens, 3.5, 0.0, 500.0, order=o) for o in ((72, 280), order, (38, 124)))
    x, y = (float(v[0, 0]) for v in fine.mean_mm)
    top = peak(fine)[2]
    exact = fine.intensity(x + corner, y + corner)
    assert np.abs(planned.intensity(x + corner, y + corner) - exact).max() < 1e-8 * top
    assert np.abs(coarse.intensity(x + corner, y + corner) - exact).max() > 1e-8 * top
    assert zernikes(np.zeros(1), np.zeros(1), 1)[0, 0] == 1.0


@pytest.mark.slow
@pytest.mark.reference
def test_images_and_wavefronts_agree_with_batoid():
    """Its rays carry equal amplitudes, so ours must too, on a Cartesian grid with a ragged rim: 3e-3 of the peak."""
    batoid = pytest.importorskip("batoid")
    lens = load_lens("star_camera_206mm")
    fields, wave = 3.0, 600.0
    traced = trace_pupil(lens, fields, 0.0, wave)
    side = np.linspace(-35.0, 35.0, 201)
    grid_x, grid_y = (v.ravel() for v in np.meshgrid(side, side))
    inside = np.hypot(grid_x, grid_y) < 35.0
    index = float(lens.indices(wave)[0])
    star = field_direction(fields, 0.0)
    start = Rays.create(x_mm=grid_x[inside], y_mm=grid_y[inside], direction=light_direction(star), wavelength_nm=wave)
    start.opl_mm[...] = index * start.x * start.dx
    rays = batoid_trace(batoid, lens, start, lens.indices(wave), wave)
    x, y = (float(v[0, 0]) for v in traced.mean_mm)
    assert [rays.x.mean(), rays.y.mean()] == pytest.approx([x, y], abs=2e-5)
    # the image, by its waves
    points = 0.0008 * np.arange(-6, 7)
    # batoid counts wavelength and time in one unit of length: its wavelength in metres, lengths here in mm
    scaled = batoid.RayVector(
        1e-3 * rays.x, 1e-3 * rays.y, 1e-3 * rays.z, rays.vx, rays.vy, rays.vz, 1e-3 * rays.t, rays.wavelength
    )
    time = scaled.t.mean()
    places = 1e-3 * np.stack(np.broadcast_arrays(x + points, y + points[:, None], 0.0), axis=-1)
    theirs = np.abs([[scaled.sumAmplitude(place, time) for place in row] for row in places]) ** 2
    equal = replace(traced, jacobian=np.full_like(traced.jacobian, traced.jacobian.mean()))
    ours = equal.intensity(x + points, y + points)
    assert np.abs(theirs / theirs.max() - ours / ours.max()).max() < 3e-3
    # the wavefront about the mean point, on batoid's own rays
    l, m = index * rays.vx * index, index * rays.vy * index  # noqa: E741
    path = rays.t + l * (x - rays.x) + m * (y - rays.y)
    theirs_nm = 1e6 * (path - path.mean())
    error = wavefront(traced, point_mm=(x, y))
    r2 = (grid_x[inside] ** 2 + grid_y[inside] ** 2) / 35.0**2
    fitted = zernikes(grid_x[inside][r2 < 1] / 35.0, grid_y[inside][r2 < 1] / 35.0, 45)
    coefficients = np.linalg.lstsq(fitted.T, theirs_nm[r2 < 1], rcond=None)[0]
    assert error.zernike_nm(45)[1:] == pytest.approx(coefficients[1:], abs=0.5)
    assert error.rms_nm == pytest.approx(float(np.sqrt((theirs_nm**2).mean())), rel=2e-3)


@pytest.mark.reference
def test_images_agree_with_the_matrix_fourier_transform_of_prysm():
    """A slow pupil with coma and astigmatism under a taper, so that a Cartesian grid holds it."""
    fttools = pytest.importorskip("prysm.fttools")
    sine, size, pitch = 0.02, 256, 0.003
    side = np.linspace(-1.0, 1.0, size)
    x, y = np.meshgrid(side, side)

    def taper(r2):
        return np.exp(-16.0 * r2)

    def error_nm(x, y):
        return 300.0 * zernikes(x, y, 8)[7] + 80.0 * zernikes(x, y, 6)[5]

    pupil = taper(x**2 + y**2) * np.exp(2j * np.pi * error_nm(x, y) / WAVE_NM)
    across = INDEX * sine * 2.0 / (WAVE_NM * 1e-6) * pitch  # turns over the pupil from one pixel to the next
    samples = 64
    q = (size - 1) / across / size  # samples of the image per lambda / D; its kernel has the other sign
    theirs = np.abs(fttools.mdft.dft2(pupil.conj(), q, samples)) ** 2
    field = ideal_pupil(sine, order=(40, 120))
    u, v = field.unit_pupil((0, 0))
    bent = field.with_path(1e-6 * error_nm(u, v))
    light = replace(bent, jacobian=bent.jacobian * taper(u**2 + v**2) ** 2)
    grid = pitch * (np.arange(samples) - samples // 2)
    ours = light.intensity(grid, grid)
    assert np.abs(ours / ours.max() - theirs / theirs.max()).max() < 1e-6
