"""Diffuse light through the lens: against Mitsuba's backward rays, closed forms, and the light of stars."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optics.lens_file import load_lens
from optics.light.band import TopHat, band_nodes
from optics.light.spectrum import Blackbody
from optics.response import Response
from render.camera import Camera
from render.catalogue.motion import earth_observer
from render.sky.background import UniformSky, background_map, sky_background
from render.sky.zodiacal import ecliptic_from_icrs, zodiacal_radiance

LINE = (TopHat(centre_nm=600.0, width_nm=1.0),)
SIDE_MM = {"star_camera_206mm": 17.8, "star_tracker_26mm": 10.2, "double_gauss_50mm": 19.8}


def small(name, size=16):
    return Camera(lens=load_lens(name), width_px=size, height_px=size, pixel_pitch_mm=SIDE_MM[name] / size)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["star_tracker_26mm", pytest.param("double_gauss_50mm", marks=pytest.mark.slow)])
def test_etendue_against_rays_that_go_backwards(mi, bench, name):
    """The map is made of rays from the sky; Mitsuba's path integrator starts on the detector."""
    camera = small(name)
    etendue = background_map(camera, LINE, nodes=1).etendue_mm2_sr[..., 0].astype(float)
    sky = {"sky": {"type": "constant", "radiance": 1.0}}
    rendered = bench.path_image(mi, camera, sky, spp=8192, wavelength_nm=600.0)
    ratio = etendue / (rendered * camera.pixel_pitch_mm**2)
    # N = 8192 rays a pixel, of which a third to two thirds arrive: 1.2 % a pixel at worst, so 0.1 % over the 256; the
    # map itself is a grid of 2048 rays, 13 places a side
    assert ratio.mean() == pytest.approx(1.0, abs=2.5e-3)
    assert ratio.std() < 0.02
    rows, columns = np.indices(ratio.shape) - 7.5
    edge = np.hypot(rows, columns) > 8
    assert ratio[edge].mean() == pytest.approx(ratio[~edge].mean(), abs=5e-3)


def test_centre_and_uniform_sky_in_closed_form():
    """On the axis the irradiance of a uniform sky is pi L sin^2: F/2.95 and an aplanatic lens say which."""
    camera = small("star_camera_206mm")
    made = background_map(camera, LINE, nodes=1)
    area = camera.pixel_pitch_mm**2
    f_number = 206.2 / 70.0
    assert made.etendue_mm2_sr[7:9, 7:9].mean() == pytest.approx(np.pi * area / (4 * f_number**2), rel=3e-3)
    # 20 mag per arcsec^2 in the solid angle of a pixel is a star of 20 - 2.5 log(pixel in arcsec^2) over the pupil
    sky = UniformSky(magnitude_per_arcsec2=20.0, spectrum=Blackbody(temperature_k=5800.0))
    got = sky_background(made, Rotation.identity(), zodiacal=False, uniform=sky)[8, 8, 0]
    assert not sky_background(made, Rotation.identity(), zodiacal=False).any()
    arcsec2 = (np.degrees(camera.pixel_pitch_mm / 206.2) * 3600) ** 2
    from optics.light.magnitudes import photon_rate

    star = photon_rate(Blackbody(temperature_k=5800.0), 20.0 - 2.5 * np.log10(arcsec2), wavelength_nm=[600.0])[0]
    assert got == pytest.approx(star * 1.0 * np.pi * 35.0**2, rel=3e-3)


def test_zodiacal_gradient_follows_attitude_band_and_response():
    camera = replace(
        small("star_camera_206mm", 32),
        response=Response(name="half", source="test", wavelength_nm=np.array([400.0, 900.0]), value=np.full(2, 0.5)),
    )
    bands = (TopHat(centre_nm=500.0, width_nm=60.0), TopHat(centre_nm=700.0, width_nm=100.0))
    made = background_map(camera, bands)
    epoch = 2026.3
    place = earth_observer(epoch).from_sun_au
    sun = ecliptic_from_icrs() @ (-place / np.linalg.norm(place))
    away = np.arctan2(sun[1], sun[0]) + np.radians(40.0)  # in the ecliptic, 40 deg from the Sun, ecliptic pole up
    z = np.array([np.cos(away), np.sin(away), 0.0])
    y = np.array([0.0, 0.0, -1.0])
    cam_from_icrs = np.stack([np.cross(y, z), y, z]) @ ecliptic_from_icrs()
    image = sky_background(made, Rotation.from_matrix(cam_from_icrs), epoch_year=epoch)
    assert image.shape == (32, 32, 2)
    assert image.dtype == np.float32
    # every pixel by itself, without splines: the direction that its grid point stands for
    rows, columns = (np.linspace(-0.5, 31.5, n) for n in made.direction.shape[:2])
    rule = band_nodes(bands, 40)
    at = [(0, 0), (0, 31), (15, 15), (31, 5)]
    for row, column in at:
        i, j = np.searchsorted(rows, row) - 1, np.searchsorted(columns, column) - 1
        u, v = (row - rows[i]) / (rows[i + 1] - rows[i]), (column - columns[j]) / (columns[j + 1] - columns[j])
        d = made.direction
        cam = (d[i, j] * (1 - u) + d[i + 1, j] * u) * (1 - v) + (d[i, j + 1] * (1 - u) + d[i + 1, j + 1] * u) * v
        cam = cam / np.linalg.norm(cam)
        for b in range(2):
            radiance = zodiacal_radiance(
                (cam @ cam_from_icrs)[None], from_sun_au=place, wavelength_nm=rule.wavelength_nm[b]
            )[0]
            rate = (radiance * rule.weight_nm[b] * rule.transmission[b]).sum() * 0.5
            # the Sun's lines: forty nodes here, all of its table there
            assert image[row, column, b] == pytest.approx(rate * made.etendue_mm2_sr[row, column, b], rel=3e-3)
    # the Sun is towards smaller longitudes: -X or +X as the axes were laid
    towards_sun = np.sign((cam_from_icrs @ (-place))[0])
    side = image[16, :, 0] if towards_sun > 0 else image[16, ::-1, 0]
    assert side[-1] > 1.2 * side[0]
