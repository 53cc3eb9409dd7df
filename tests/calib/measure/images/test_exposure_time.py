"""When frames were exposed: cards and tags as cameras and programs of others write them."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import tifffile
from astropy.io import fits
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from calib.measure.images.exposure_time import exif_time, header_time, name_time
from calib.measure.images.sensor_image import read_image

START = datetime(2024, 5, 1, 20, 10, 33, tzinfo=UTC)
ISO, DAY = "2024-05-01T20:10:33", "2024-05-01"
MJD = 60431.0 + (20 * 3600 + 10 * 60 + 33) / 86400.0  # 60431: 2024-05-01, IERS Bulletin A

HEADERS = [  # cards, exposure [s], seconds after START, part of the source
    ({"DATE-OBS": ISO}, None, 0, "DATE-OBS"),
    ({"DATE-OBS": ISO + ".5000001Z"}, None, 0.5, "DATE-OBS"),
    ({"DATE-OBS": "2024-05-01T22:10:33+02:00", "TIMESYS": "TT"}, None, 0, "DATE-OBS"),
    ({"DATE-OBS": "2024-5-1T22:10:33.25 +0200"}, None, 0.25, "DATE-OBS"),
    ({"DATE-OBS": "2024-05-01T20:09:60"}, None, -33, "DATE-OBS"),
    ({"DATE-OBS": "2024-05-01T20:10"}, None, -33, "DATE-OBS"),
    ({"DATE-OBS": "2024-05-01 20:10:33 UT"}, None, 0, "DATE-OBS"),
    ({"date-obs": DAY, "time-obs": "20:10:33"}, None, 0, "DATE-OBS + TIME-OBS"),
    ({"DATE_OBS": DAY, "TIME_OBS": "20:10:33.25"}, None, 0.25, "DATE-OBS + TIME-OBS"),
    ({"DATE-OBS": DAY, "UT": "20:10"}, None, -33, "DATE-OBS + UT"),
    ({"DATE-OBS": DAY, "UTSTART": "20h10m33s"}, 120.0, 60, "UTSTART + half the exposure"),
    ({"DATE-OBS": DAY, "UT": 20.175833333}, None, 0, "UT"),
    ({"DATE-OBS": "01/05/2024", "UT": 72633.0}, None, 0, "UT"),
    ({"DATE-OBS": DAY + "T00:00:00", "TIME-OBS": "20:10:33"}, None, 0, "TIME-OBS"),
    ({"DATE-OBS": "2024-05-02T00:00:00", "UT": "unknown"}, None, 13767, "DATE-OBS"),
    ({"DATE-OBS": DAY, "TIME-OBS": ISO}, None, 0, "TIME-OBS"),
    ({"DATE-OBS": DAY, "MJD-OBS": MJD}, None, 0, "MJD-OBS"),
    ({"JD": 2400000.5 + MJD}, 10.0, 5, "JD"),
    ({"MJD-BEG": MJD, "MJD-OBS": 0.0}, None, 0, "MJD-BEG"),
    ({"DATE-BEG": ISO, "DATE-OBS": "2024-05-01T20:12:00"}, None, 0, "DATE-BEG"),
    ({"DATE-BEG": ISO, "DATE-END": "2024-05-01T20:11:33"}, None, 30, "DATE-BEG, DATE-END"),
    ({"DATE-END": ISO}, 60.0, -30, "DATE-END - half the exposure"),
    ({"DATE-AVG": ISO, "DATE-OBS": "2024-05-01T20:09:33"}, 120.0, 0, "DATE-AVG"),
    ({"DATE-OBS": ISO, "TIMESYS": "TAI"}, None, -37, "TAI"),  # 37 leap seconds since 2017; TT = TAI + 32.184 s
    ({"DATE-OBS": ISO, "TIMESYS": "TT"}, None, -69.184, "TT"),
    ({"MJD-OBS": MJD, "TIMESYS": "TDB"}, None, -69.184, "TDB"),
    ({"DATE-OBS": ISO, "TIMESYS": "GPS"}, None, -18, "GPS"),
    ({"DATE-OBS": ISO, "TIMESYS": "UTC(NIST)"}, None, 0, "DATE-OBS"),
]  # fmt: skip


@pytest.mark.parametrize(("cards", "exposure_s", "seconds", "source"), HEADERS)
def test_headers(cards, exposure_s, seconds, source):
    time = header_time(cards, exposure_s)
    assert abs(time.utc - START - timedelta(seconds=seconds)) < timedelta(milliseconds=3)  # TDB - TT: 1.7 ms
    assert source in time.source
    assert time.zone_stated


def test_headers_without_a_time():
    for cards in ({}, {"DATE-OBS": DAY}, {"DATE": ISO}, {"DATE-OBS": "unknown", "UT": "20:10"}, {"MJD-OBS": 0.0}):
        assert header_time(cards) is None
    assert not header_time({"DATE-OBS": ISO, "TIMESYS": "LOCAL"}).zone_stated


TAKEN = "2024:05:01 22:10:33"
GPS = {"GPSDateStamp": "2024:05:01", "GPSTimeStamp": (20.0, 10.0, 31.0)}
TAGS = [  # tags, exposure [s], seconds after START, whether the zone is stated
    ({"DateTimeOriginal": TAKEN, "OffsetTimeOriginal": "+02:00"}, None, 0, True),
    ({"DateTimeOriginal": "2024:05:01 15:40:33", "OffsetTimeOriginal": "-04:30"}, 30.0, 15, True),
    ({"DateTimeOriginal": TAKEN, "OffsetTimeOriginal": "+02:00", "SubsecTimeOriginal": "25"}, None, 0.25, True),
    ({"DateTimeOriginal": TAKEN, "OffsetTime": "+02:00", "DateTime": "2025:01:01 00:00:00"}, None, 0, True),
    ({"DateTimeOriginal": TAKEN, "OffsetTimeOriginal": "   :  "}, None, 7200, False),
    ({"DateTimeDigitized": TAKEN + "\0", **GPS}, None, 0, True),
    ({"DateTimeOriginal": "0000:00:00 00:00:00", "DateTime": TAKEN}, None, 7200, False),
]


@pytest.mark.parametrize(("tags", "exposure_s", "seconds", "zone_stated"), TAGS)
def test_tags(tags, exposure_s, seconds, zone_stated):
    time = exif_time(tags, exposure_s)
    assert time.utc == START + timedelta(seconds=seconds)
    assert time.zone_stated == zone_stated


@pytest.mark.parametrize(
    ("name", "seconds", "zone_stated"),
    [
        ("2024-05-01T201033_Alt40_Azi-135_Try1.tiff", 0, False),
        ("Light_M31_60.0s_Bin1_gain100_20240501-201033_-10.0C_0001.fit", 0, False),
        ("PXL_20240501_201033250.jpg", 0.25, False),
        ("2024-05-01T20-10-33Z.png", 0, True),
        ("20240501_201033_UTC_3.png", 0, True),
        ("20240501T221033+0200.png", 0, True),
        ("20240501_201033-0100.png", 0, False),  # a number in a sequence
        ("IMG_0001.tiff", None, False),
        ("20191399T996199.tiff", None, False),
    ],
)
def test_names(name, seconds, zone_stated):
    time = name_time(name)
    assert (None if time is None else time.utc) == (None if seconds is None else START + timedelta(seconds=seconds))
    assert time is None or time.zone_stated == zone_stated


def picture(path):
    tiff = path.suffix == ".tiff"
    tags = ImageFileDirectory_v2() if tiff else Image.Exif()
    tags[0x8769] = {33434: 30.0, 36867: TAKEN, 36881: "+02:00"}
    Image.fromarray(np.full((8, 9), 7, np.uint8)).save(path, **{"tiffinfo" if tiff else "exif": tags})


FILES = {
    "exif.jpg": picture,
    "exif.png": picture,
    "exif.tiff": picture,
    "tag.tiff": lambda path: tifffile.imwrite(path, np.ones((8, 9), np.uint16), datetime="2024:05:01 20:10:48"),
    "cards.fits": lambda path: fits.HDUList(  # a primary header holds for its extensions
        [fits.PrimaryHDU(header=fits.Header({"DATE-OBS": ISO, "EXPTIME": 30.0})), fits.ImageHDU(np.ones((8, 9)))]
    ).writeto(path),
}


@pytest.mark.parametrize("name", FILES)
def test_files(tmp_path, name):
    FILES[name](tmp_path / name)
    assert read_image(tmp_path / name).conversion.taken.utc == START + timedelta(seconds=15)


def test_lower_case_cards_of_a_file(tmp_path):
    path = tmp_path / "a.fits"
    fits.writeto(path, np.ones((8, 9)), fits.Header({"DATE-OBS": ISO, "EXPTIME": 30.0}))
    path.write_bytes(path.read_bytes().replace(b"DATE-OBS", b"date-obs").replace(b"EXPTIME ", b"exptime "))
    assert read_image(path).conversion.taken.utc == START + timedelta(seconds=15)
