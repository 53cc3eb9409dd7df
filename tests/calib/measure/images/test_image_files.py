"""Files of cameras nobody here knows: what is in them must come out, or one line that says why not."""

import io
from datetime import UTC, datetime

import numpy as np
import pytest
import tifffile
from astropy.io import fits
from PIL import Image

from calib.measure.images.sensor_image import read_image, read_images
from optics.errors import ConfigError


@pytest.fixture
def counts():
    """Twelve bits: a sky of 300 DN with noise and a saturated star of nine pixels."""
    dn = np.random.default_rng(3).normal(300.0, 9.0, (40, 50)).round().astype(np.uint16)
    dn[10:13, 20:23] = 4095
    return dn


def png_of_deep_colours(path, dn):
    cv2 = pytest.importorskip("cv2")
    path.write_bytes(cv2.imencode(".png", np.repeat(dn[:, :, None], 3, axis=2))[1].tobytes())


def planes(path, dn):
    tifffile.imwrite(path, np.repeat(dn[None], 3, axis=0), planarconfig="separate", photometric="rgb")


def numpy_file(path, dn):
    with path.open("wb") as stream:
        np.save(stream, dn)


STEPS = "12 bit in steps of 16; saturated from 65520"
COLOURS = f"uint16, mean of red, green and blue; {STEPS}"
STORED = {  # writer, what it makes of 12 bits, what is said
    "tiff, full at 65535": (
        tifffile.imwrite,
        lambda dn: np.where(dn == 4095, 65535, dn * 16),
        f"TIFF, uint16; {STEPS}",
    ),
    "tiff, repeated": (tifffile.imwrite, lambda dn: dn << 4 | dn >> 8, "upper bits repeated in the lower ones"),
    "tiff, lower bits": (tifffile.imwrite, lambda dn: dn, "TIFF, uint16; 12 bit; saturated from 4095"),
    "tiff, colours": (planes, lambda dn: dn * 16, f"TIFF, {COLOURS}"),
    "png": (lambda path, dn: Image.fromarray(dn).save(path, "PNG"), lambda dn: dn * 16, f"PNG, uint16; {STEPS}"),
    "png, colours": (png_of_deep_colours, lambda dn: dn * 16, f"PNG, {COLOURS}"),
    "fits": (
        lambda path, dn: fits.PrimaryHDU(dn).writeto(path, checksum=True),
        lambda dn: dn * 16,
        f"FITS, uint16; {STEPS}",
    ),
    "numpy": (numpy_file, lambda dn: dn * 16, f"NumPy, uint16; {STEPS}"),
}


@pytest.mark.parametrize("kind", STORED)
def test_counts_of_the_converter_and_its_saturation(tmp_path, counts, kind):
    """The suffix is wrong on purpose: the content tells."""
    path = tmp_path / "frame.tiff"
    write, scaled, said = STORED[kind]
    write(path, scaled(counts).astype(np.uint16))
    image = read_image(path)
    assert said in str(image.conversion)
    faint = ~image.saturated
    np.testing.assert_allclose(image.dn[faint], counts[faint])
    np.testing.assert_array_equal(image.saturated, counts == 4095)


@pytest.mark.parametrize("full", [200, 255, 1023, 4095, 16383, 65535])
@pytest.mark.parametrize("kind", ["P2", "P3", "P5", "P6"])
def test_portable_maps_in_native_steps(tmp_path, kind, full):
    """Any full scale, comments in the header, big-endian; what reaches the full scale is saturated."""
    shape = (20, 30, 3) if kind in ("P3", "P6") else (20, 30)
    values = np.random.default_rng(1).integers(0, full // 2, shape)
    values[3, 4] = full
    head = f"{kind}\n# camera 7, 5 ms\n30 # columns\n20\n{full}\n".encode()
    text = " ".join(map(str, values.ravel())).encode()
    raster = text if kind in ("P2", "P3") else values.astype(np.uint8 if full < 256 else ">u2").tobytes()
    (tmp_path / "a.pgm").write_bytes(head + raster)
    image = read_image(tmp_path / "a.pgm")
    np.testing.assert_allclose(image.dn, values if values.ndim == 2 else values.mean(axis=2))
    assert list(zip(*np.nonzero(image.saturated), strict=True)) == [(3, 4)]


@pytest.mark.parametrize(
    ("camera", "gain_dn_per_e", "said"),
    [("ZWO ASI1600MM Pro", 1.0 / 1.6, "per step of the converter"), ("QHY600M", 0.1 / 1.6, "per stored number")],
)
def test_gain_of_padded_numbers(tmp_path, counts, camera, gain_dn_per_e, said):
    """12 bits in steps of 10 (a digital gain): EGAIN counts those of the converter where that is the driver's habit."""
    header = fits.Header({"EGAIN": 1.6, "INSTRUME": camera})
    fits.writeto(tmp_path / "a.fits", (counts * 10).astype(np.uint16), header)
    image = read_image(tmp_path / "a.fits")
    assert image.noise.gain_dn_per_e == pytest.approx(gain_dn_per_e)
    assert f"EGAIN = 1.6 e- read {said}" in str(image.conversion)
    unscaled = read_image(tmp_path / "a.fits", step=1)
    assert unscaled.noise.gain_dn_per_e == pytest.approx(10.0 * gain_dn_per_e)


def test_pictures_of_telephones(tmp_path):
    """A second image in a JPEG (MPO) is a preview."""
    first, second = (Image.fromarray(np.full((16, 24), level, np.uint8)) for level in (50, 200))
    first.save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=[second])
    image = read_image(tmp_path / "a.jpg")
    assert np.abs(image.dn - 50.0).max() <= 1.0
    assert image.conversion.kind == "JPEG"


def test_eight_bit_colours_alpha_and_exposure(tmp_path):
    rgba = np.random.default_rng(1).integers(10, 90, (30, 40, 4)).astype(np.uint8)
    rgba[..., 3] = 255
    rgba[5, 6] = 0, 0, 0, 0
    rgba[7, 8, 1] = 255
    Image.fromarray(rgba).save(tmp_path / "a.png")
    image = read_image(tmp_path / "a.png")
    np.testing.assert_allclose(image.dn[~image.saturated], rgba[..., :3].mean(axis=2)[~image.saturated])
    assert list(zip(*np.nonzero(~image.valid), strict=True)) == [(5, 6)]
    assert list(zip(*np.nonzero(image.saturated), strict=True)) == [(7, 8)]
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", channel="blue").dn[7], rgba[7, :, 2])
    exif = Image.Exif()
    exif.get_ifd(0x8769)[33434] = 0.25
    exif.get_ifd(0x8769)[36867] = "2019:07:29 20:47:26"
    Image.fromarray(rgba[..., :3]).save(tmp_path / "a.jpg", exif=exif)
    image = read_image(tmp_path / "a.jpg")
    assert image.exposure_s == 0.25
    assert image.conversion.taken.utc == datetime(2019, 7, 29, 20, 47, 26, 125_000, tzinfo=UTC)
    assert "gamma" in str(image.conversion)


def bad_files(folder, counts):
    tifffile.imwrite(folder / "good.tiff", counts)
    whole = (folder / "good.tiff").read_bytes()
    (folder / "cut.tiff").write_bytes(whole[: len(whole) // 2])
    packed = io.BytesIO()
    Image.fromarray((counts % 251).astype(np.uint8)).save(packed, "PNG")
    (folder / "cut.png").write_bytes(packed.getvalue()[:700])
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "words.png").write_text("no picture at all, but quite some words about stars and their frames")
    (folder / "cut.pgm").write_bytes(b"P5 9 9 1023\n" + bytes(100))
    (folder / "over.pgm").write_bytes(b"P2 2 1 1023 5 1024")
    (folder / "head.pgm").write_bytes(b"P5 9 x 1023\n")
    np.save(folder / "objects.npy", np.array([{}, {}]), allow_pickle=True)
    np.savez(folder / "two.npz", a=counts, b=counts)
    (folder / "folder.png").mkdir()
    fits.PrimaryHDU(counts).writeto(folder / "sum.fits", checksum=True)
    content = bytearray((folder / "sum.fits").read_bytes())
    content[2880 + 100] ^= 1
    (folder / "sum.fits").write_bytes(content)
    (folder / "cut.fits").write_bytes(content[:4000])
    fits.PrimaryHDU().writeto(folder / "none.fits")
    table = fits.BinTableHDU.from_columns([fits.Column(name="a", format="E", array=np.ones(3))])
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(folder / "table.fits")
    return {
        "cut.tiff": "truncated",
        "cut.png": "truncated",
        "empty.jpg": "empty",
        "words.png": "no image",
        "cut.pgm": "truncated",
        "over.pgm": "full scale is 1023",
        "head.pgm": "header is damaged",
        "objects.npy": "not a readable",
        "two.npz": "2 arrays",
        "folder.png": "a folder",
        "absent.png": "no such file",
        "sum.fits": "verification failed",
        "cut.fits": "cut.fits",
        "none.fits": "holds no image",
        "table.fits": "holds no image",
    }


def test_what_is_no_image_is_one_line(tmp_path, counts):
    for name, said in bad_files(tmp_path, counts).items():
        with pytest.raises(ConfigError, match=said) as caught:
            read_image(tmp_path / name)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_frames_of_one_camera(tmp_path, counts):
    """A frame with few numbers has larger common steps by chance; one of another size or depth is another camera's."""
    few = counts // 2 * 2
    paths = [tmp_path / f"{name}.tiff" for name in ("first", "few", "other")]
    for path, dn in zip(paths, (counts * 16, few * 16, counts[:, :30] * 16), strict=True):
        tifffile.imwrite(path, dn)
    first, second = read_images(paths[:2])
    assert second.conversion.step == first.conversion.step == 16.0
    np.testing.assert_array_equal(second.dn, few)
    with pytest.raises(ConfigError, match=r"other.tiff: 30 x 40 px, first.tiff has 50 x 40"):
        list(read_images(paths))
    tifffile.imwrite(paths[2], counts * 8)
    with pytest.raises(ConfigError, match="steps of 8"):
        list(read_images(paths))
