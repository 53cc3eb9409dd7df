import numpy as np
import pytest
from astropy.io import fits
from star_images import frame_of, noisy, star_field

from calib.measure.find import find_stars
from calib.measure.images.sensor_image import image_from_frame, read_image, sensor_image, subtract_dark
from optics.errors import ConfigError


@pytest.fixture
def sky_dn():
    """A star field in DN: offset 500, 0.8 DN/e-, and where the stars are."""
    rng = np.random.default_rng(9)
    x, y = np.array([40.3, 120.8, 77.1]), np.array([30.2, 60.6, 99.9])
    return 500.0 + 0.8 * noisy(star_field(x, y, 2e4, 0.8, (128, 160)) + 30.0, 6.0, rng), x, y


def find(image):
    """Stars, sorted by column."""
    table = find_stars(image, "gaussian")
    return table.select(np.argsort(table.x_px))


def write_odd(path, data, **header):
    """A file as other people's cameras write them: empty primary, keywords of other habits, comments, blanks."""
    hdu = fits.ImageHDU(data)
    hdu.header["GAIN"] = (120, "camera gain setting")
    hdu.header["OBJECT"] = "  lab target No. 5 "
    hdu.header["RDNOISE"] = "unknown"
    hdu.header["HIERARCH some.vendor Key Word"] = 1.5
    hdu.header["COMMENT"] = "nobody here made this"
    hdu.header[""] = "blank card"
    for key, value in header.items():
        hdu.header[key] = value
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(path)


@pytest.mark.parametrize("kind", ["uint16", "int16", "float32", "compressed"])
def test_foreign_files_give_the_stars(tmp_path, sky_dn, kind):
    """uint16 is stored as int16 with BZERO = 32768; everything else unknown is taken from the image."""
    dn, x, y = sky_dn
    path = tmp_path / "odd.fits"
    if kind == "float32":
        data = dn.astype(np.float32)
        data[5:9, 5:9] = np.nan
        data[60, 119] = np.inf
        write_odd(path, data)
    elif kind == "compressed":
        fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(np.rint(dn).astype(np.int32))]).writeto(path)
    else:
        write_odd(path, np.rint(dn).astype(kind))
    if kind == "uint16":
        assert (fits.getheader(path, 1)["BITPIX"], fits.getheader(path, 1)["BZERO"]) == (16, 32768)
    image = read_image(path)
    assert set(image.assumed) == {"gain_dn_per_e", "offset_dn", "read_noise_e"}
    assert image.noise.quantised == (kind != "float32")
    table = find(image)
    assert len(table) == 3
    order = np.argsort(x)
    assert table.x_px == pytest.approx(x[order], abs=0.05)
    assert table.y_px == pytest.approx(y[order], abs=0.05)
    if kind == "float32":
        assert (~image.valid).sum() == 17


def test_keywords_and_arguments_and_a_gain_that_speaks_of_electrons(tmp_path, sky_dn):
    path = tmp_path / "known.fits"
    header = fits.Header([("EGAIN", 1.25, "e-/ADU"), ("RDNOISE", 6.0), ("SATURATE", 9000.0), ("EXPTIME", 0.2)])
    fits.PrimaryHDU(np.rint(sky_dn[0]).astype(np.uint16), header=header).writeto(path)
    image = read_image(path, offset_dn=500.0)
    assert image.noise.gain_dn_per_e == pytest.approx(0.8)
    assert image.noise.read_noise_e == 6.0
    assert image.noise.offset_dn == 500.0
    assert image.assumed == ()
    assert image.exposure_s == 0.2
    assert read_image(path, saturation_dn=1000.0).saturated.sum() > 5
    assert read_image(path, read_noise_e=3.0).noise.read_noise_e == 3.0
    data = np.random.default_rng(1).normal(100, 5, (32, 32)).astype(np.float32)
    for comment, assumed in (("[e-/ADU] conversion", False), ("setting of the amplifier", True)):
        path = tmp_path / f"{assumed}.fits"
        fits.PrimaryHDU(data, header=fits.Header([("GAIN", 2.0, comment)])).writeto(path)
        assert ("gain_dn_per_e" in read_image(path).assumed) == assumed


def test_unknown_noise_is_taken_from_the_background(sky_dn):
    """Background noise 0.8 sqrt(30 + 36) DN; with the offset known, shot noise of 30 e- is taken off."""
    dn, *_ = sky_dn
    blind = sensor_image(dn)
    assert blind.noise.read_noise_e == pytest.approx(0.8 * np.sqrt(66.0), rel=0.03)
    knowing = sensor_image(dn, gain_dn_per_e=0.8, offset_dn=500.0)
    assert knowing.noise.read_noise_e == pytest.approx(6.0, rel=0.05)
    no_offset = sensor_image(dn, gain_dn_per_e=0.8, read_noise_e=6.0)
    assert no_offset.noise.offset_dn == pytest.approx(500.0, abs=0.8 * 66.0 * 0.06)


def test_cubes_need_a_plane(tmp_path):
    path = tmp_path / "cube.fits"
    fits.PrimaryHDU(np.arange(3 * 20 * 30, dtype=np.float32).reshape(3, 20, 30)).writeto(path)
    with pytest.raises(ConfigError, match="cube of 3 images"):
        read_image(path)
    with pytest.raises(ConfigError, match="plane 3 of 3"):
        read_image(path, plane=3)
    with pytest.raises(ConfigError, match="has no extension 7"):
        read_image(path, hdu=7)
    assert read_image(path, plane=1).dn[0, 0] == 600.0


def test_our_own_frame(sky_dn):
    dn, x, _ = sky_dn
    defect = np.zeros(dn.shape, bool)
    defect[10, 10] = True
    frame = frame_of(np.rint(dn), defect=defect, gain_dn_per_e=0.8, offset_dn=500.0, read_noise_e=6.0)
    pattern = np.random.default_rng(2).normal(500.0, 9.0, dn.shape)
    dark = subtract_dark(frame, pattern)  # as bright above the nominal offset as above its own
    np.testing.assert_allclose(dark.dn - 500.0, frame.dn - pattern, rtol=0, atol=1e-9)
    image = image_from_frame(frame)
    assert image.assumed == ()
    assert (~image.valid).sum() == 1
    table = find(image)
    assert table.x_px == pytest.approx(np.sort(x), abs=0.05)
    assert table.flux_e == pytest.approx([2e4] * 3, rel=0.03)
