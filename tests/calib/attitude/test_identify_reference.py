"""Blind identification through tetra3rs: attitude, parity, false detections, distortion, clear refusals."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.identify import build_database, identify, load_database
from calib.attitude.star_attitude import star_patterns
from calib.cameras import BrownConrady, SensorGeometry
from optics.attitude import attitude_error_arcsec
from optics.errors import ConfigError
from render.sky.sky import load_sky

pytestmark = pytest.mark.reference

GEOMETRY = SensorGeometry(width_px=1024, height_px=1024, pixel_pitch_mm=0.01)
FOCAL_MM = 512 / np.tan(np.radians(6.0)) * 0.01
PINHOLE = BrownConrady.create(GEOMETRY, focal_length_mm=FOCAL_MM)
LENS = BrownConrady.create(GEOMETRY, focal_length_mm=FOCAL_MM, x0_px=20.0, y0_px=-15.0, q1_per_mm2=1e-4)


@pytest.fixture(scope="module")
def database():
    pytest.importorskip("tetra3rs")
    return build_database(min_fov_deg=11.0, max_fov_deg=13.0, magnitude_limit=7.0)


@pytest.fixture(scope="module")
def stars(database):
    """Identifier, direction and brightness of the database's stars."""
    rows = [database.get_star(k) for k in range(database.num_stars)]
    ra, dec = np.radians([[s.ra_deg, s.dec_deg] for s in rows]).T
    direction = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    return np.array([s.id for s in rows]), direction, 10 ** (-0.4 * np.array([s.magnitude for s in rows]))


def frame(stars, seed, *, model=PINHOLE, false=0, noise_px=0.05):
    rng = np.random.default_rng(seed)
    attitude = Rotation.random(rng=rng)
    seen = np.flatnonzero(model.visible(attitude.apply(stars[1])))
    pixel = model.project(attitude.apply(stars[1][seen])) + noise_px * rng.standard_normal((len(seen), 2))
    flux = stars[2][seen]
    pixel = np.concatenate([pixel, rng.uniform(0, 1023, (false, 2))])
    flux = np.concatenate([flux, np.full(false, flux.min())])
    order = rng.permutation(len(pixel))
    return attitude, pixel[order], flux[order], np.concatenate([seen, np.full(false, -1)])[order]


@pytest.mark.parametrize("seed", range(8))
def test_attitude_and_stars(database, stars, seed):
    attitude, pixel, flux, truth = frame(stars, seed, false=5)
    found = identify(pixel, PINHOLE, database, flux=flux)
    assert found.ok, found.message
    assert (np.abs(attitude_error_arcsec(found.attitude.rotation, attitude)) < 5 * found.attitude.sigma_arcsec).all()
    assert found.attitude.parity == 1
    # What is not the star itself is its companion within a fraction of a pixel.
    same = stars[0][truth[found.detected]] == found.catalogue_id
    assert same.mean() > 0.9
    apart = np.linalg.norm(stars[1][truth[found.detected]] - found.direction, axis=1)
    assert (apart[truth[found.detected] >= 0] < np.radians(12 / 1024)).all()
    assert found.scale == pytest.approx(1, abs=1e-3)
    assert found.false_match_probability < 1e-5


@pytest.mark.parametrize("seed", range(100, 104))
def test_mirrored_sky_is_refused(database, stars, seed):
    _, pixel, flux, _ = frame(stars, seed)
    for flipped in (np.column_stack([1023 - pixel[:, 0], pixel[:, 1]]), pixel[:, ::-1]):
        found = identify(flipped, PINHOLE, database, flux=flux)
        assert found.status == "mirrored"
        assert found.attitude is None
        assert len(found.detected) == 0


def test_turned_image_is_not_a_mirrored_one(database, stars):
    attitude, pixel, flux, _ = frame(stars, 3)
    found = identify(1023 - pixel, PINHOLE, database, flux=flux)
    turned = Rotation.from_rotvec([0, 0, np.pi]) * attitude
    assert found.ok
    assert (np.abs(attitude_error_arcsec(found.attitude.rotation, turned)) < 5 * found.attitude.sigma_arcsec).all()


def test_distorted_lens(database, stars):
    """The true model to its noise; a pinhole in its place still finds the stars, and says how far they lie off."""
    attitude, pixel, flux, _ = frame(stars, 4, model=LENS)
    found = identify(pixel, LENS, database, flux=flux)
    assert found.ok
    assert (np.abs(attitude_error_arcsec(found.attitude.rotation, attitude)) < 5 * found.attitude.sigma_arcsec).all()
    assert identify(pixel, PINHOLE, database, flux=flux, tolerance_px=5.0).ok
    assert identify(pixel, PINHOLE, database, flux=flux, tolerance_px=0.2).status == "inconsistent"


def test_order_stands_for_brightness_and_better_directions_may_be_handed_in(database, stars):
    _, pixel, flux, truth = frame(stars, 5, false=10)
    order = np.argsort(-flux)
    found = identify(pixel[order], PINHOLE, database)
    assert found.ok
    assert (truth[order][found.detected] >= 0).all()
    _, pixel, flux, _ = frame(stars, 6)
    bright = dict(zip(stars[0][:9000].tolist(), stars[1][:9000], strict=True))
    found = identify(pixel, PINHOLE, database, flux=flux, catalogue=bright)
    assert found.ok
    assert all(int(i) in bright for i in found.catalogue_id)
    assert identify(pixel, PINHOLE, database, flux=flux, catalogue={}).status == "no_match"


def test_nothing_to_find(database):
    rng = np.random.default_rng(7)
    assert identify(rng.uniform(0, 1023, (25, 2)), PINHOLE, database).status in ("no_match", "timeout")
    assert identify(rng.uniform(0, 1023, (3, 2)), PINHOLE, database).status == "too_few"
    assert identify(np.full((30, 2), np.nan), PINHOLE, database).status == "too_few"
    assert identify(np.empty((0, 2)), PINHOLE, database).status == "too_few"


def test_database_is_kept_with_its_epoch(database, stars, tmp_path):
    database.save_to_file(str(tmp_path / "stars.bin"))
    _, pixel, flux, _ = frame(stars, 8)
    assert identify(pixel, PINHOLE, load_database(tmp_path / "stars.bin"), flux=flux).ok
    (tmp_path / "broken.bin").write_bytes(b"no stars")
    with pytest.raises(ConfigError, match="not a star pattern database"):
        load_database(tmp_path / "broken.bin")
    # the columns called proper motion hold magnitudes; carrying positions by them would move every star
    assert database.parameters["epoch_proper_motion_year"] == 2016.0


@pytest.mark.parametrize(
    ("size", "field_deg", "false", "pattern_stars"),
    [((1280, 960), 27.0, 15, 24), ((1920, 1080), 20.2, 15, 24), ((1920, 1080), 20.2, 40, 60)],
)
def test_frames_longer_than_high_are_identified_by_the_patterns_of_the_camera(size, field_deg, false, pattern_stars):
    """30 random frames with false stars as bright as the real ones. Patterns as large as the long side reach beyond
    the short one: of frames of 16:9 one in seven was not identified with those from 0.94 of the field on."""
    pytest.importorskip("tetra3rs")
    geometry = SensorGeometry(width_px=size[0], height_px=size[1], pixel_pitch_mm=0.01)
    camera = BrownConrady.create(geometry, focal_length_mm=size[0] / 200 / np.tan(np.radians(field_deg / 2)))
    patterns, sky = star_patterns(camera), load_sky(faintest_mag=7.5)
    direction = np.array(sky.direction)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        attitude = Rotation.random(rng=rng)
        row = np.flatnonzero(camera.visible(attitude.apply(direction)))
        pixel = camera.project(attitude.apply(direction[row])) + rng.normal(0.0, 0.15, (len(row), 2))
        magnitude = np.append(sky.magnitude[row] + rng.normal(0.0, 0.2, len(row)), rng.uniform(2.0, 7.0, false))
        pixel = np.vstack([pixel, rng.uniform(0.0, np.array(size) - 1.0, (false, 2))])
        identified = identify(pixel, camera, patterns, flux=10 ** (-0.4 * magnitude), pattern_stars=pattern_stars)
        assert identified.ok, (seed, identified.message)
        error = attitude_error_arcsec(identified.attitude.rotation, attitude)
        assert (np.abs(error) < 5 * identified.attitude.sigma_arcsec).all()


def test_without_tetra3rs_it_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "tetra3rs", None)
    for call in (
        lambda: build_database(min_fov_deg=11, max_fov_deg=13),
        lambda: identify(np.zeros((5, 2)), PINHOLE, None),
        lambda: load_database(__file__),
    ):
        with pytest.raises(ConfigError, match="tetra3rs, which is not installed; pip install"):
            call()
