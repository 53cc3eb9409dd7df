"""The truth of a frame: against rays of the other trace, the frame itself and astropy; cameras that turn; refusals."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from calib.measure.centroid_error.cramer_rao_bound import flux_snr
from calib.measure.detection.footprints import footprint_px
from experiments.dataset.frame import FrameRenderer
from experiments.dataset.job import frame_record
from experiments.dataset.scene import build_scene, stars_of
from experiments.dataset.settings import ConePointing, DatasetConfig, FixedRate, ScanPointing
from experiments.dataset.truth import FLAGS, record_from_text
from optics.frames import field_angles_deg
from optics.rays.chief_ray import chief_ray_points
from render.forward import StarRenderer
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig

SMALL = {
    "instrument": InstrumentConfig(detector="cmv4000", exposure_s=0.2, width_px=256, height_px=192),
    "nodes": 3,
    "catalogue": CatalogueConfig(faintest_mag=10.0),
    "pointing": ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1),
}


@pytest.fixture(scope="module")
def maker(engine):
    return FrameRenderer(build_scene(DatasetConfig(**SMALL)))


@pytest.fixture(scope="module")
def made(maker):
    return maker.render(0)


@pytest.mark.slow
def test_chief_rays_of_the_other_trace(maker, made):
    """The columns ra and dec, turned by the attitude and traced by NumPy, land on the columns chief_x and chief_y."""
    truth, camera = made.truth, maker.scene.instrument.camera
    seen = SkyCoord(truth["ra_deg"], truth["dec_deg"], unit="deg").cartesian.xyz.value.T
    angles = field_angles_deg(made.plan.attitude.apply(seen))
    wavelength = float(maker.scene.light.wavelength_nm.mean())
    x, y = camera.to_pixel(*chief_ray_points(camera.focused_lens, *angles, wavelength))
    assert len(x) >= 8
    assert np.hypot(truth["chief_x_px"] - x, truth["chief_y_px"] - y).max() < 1e-5


def test_light_is_where_the_truth_says(maker, made):
    """Bright stars of the frame: charge near the photon centroid adds up to the expected electrons."""
    truth, frame = made.truth, made.frame
    electrons = (frame.dn.astype(float) - frame.offset_dn) / frame.gain_dn_per_e
    flags = truth["flags"]
    clean = (flags & ~FLAGS["defect"][0] & 0xFF) == 0
    tested = np.flatnonzero(clean & (truth["snr"] > 50))
    assert len(tested) >= 2
    for i in tested:
        x, y = (round(float(truth[f"photon_{axis}_px"][i])) for axis in "xy")
        part = electrons[y - 7 : y + 8, x - 7 : x + 8] - np.median(electrons)
        sigma = np.sqrt(truth["electrons"][i] + part.size * 13.0**2)
        # fixed pattern of offsets (a few e-) and of the response (1 %) come on top of the noise
        assert abs(part.sum() - truth["electrons"][i]) < 5 * sigma + 0.05 * truth["electrons"][i]
    kept = sum(
        truth[f"electrons{part}"] for part in ("", "_vignetted", "_off_edge", "_beyond", "_absorbed", "_scattered")
    )
    assert kept == pytest.approx(truth["electrons_in"], rel=1e-9)


def test_flags(made):
    truth, bit = made.truth, {name: number for name, (number, _) in FLAGS.items()}
    saturated = np.argwhere(made.frame.saturated)[:, ::-1]
    assert len(saturated)
    half = footprint_px(truth["variance_x_px2"], truth["variance_y_px2"], 0.0)
    centre = np.stack([truth["photon_x_px"], truth["photon_y_px"]], axis=1)
    for i in np.flatnonzero(truth["flags"] & bit["no_light"] == 0):
        inside = (np.abs(saturated - centre[i]) <= half[:, i]).all(1).any()
        assert not inside or truth["flags"][i] & bit["saturated"]  # the real footprint is a little larger
        near = np.hypot(*(saturated - centre[i]).T).min() < 3 * half[:, i].max()
        assert near or not truth["flags"][i] & bit["saturated"]
    assert made.saturated == np.count_nonzero(truth["flags"] & bit["saturated"])
    dark = truth["flags"] & bit["no_light"] != 0
    assert (truth["electrons"][dark] < 1e-3).all()
    beside = truth["electrons_off_edge"] > 0.5 * truth["electrons_in"]
    assert (truth["flags"][beside] & bit["off_edge"] != 0).all()


def test_snr_is_that_of_optimal_weights_on_the_stars_own_pixels(maker):
    """Each star rendered alone without noise, at three places: root of the sum over pixels of signal^2 / variance."""
    camera, noise_e2 = maker.scene.instrument.camera, 250.0
    place = camera.centre_px + np.array([[0.3, -0.2], [64.1, 19.4], [-102.0, 70.5]])
    renderer = StarRenderer(camera, exposure_s=1.0)
    for magnitude in (4.0, 8.0, 11.0):
        for direction in camera.nominal_direction(*place.T, maker.scene.instrument.focal_length_mm):
            traced = renderer.trace(
                maker.scene.light.stars(direction[None], magnitude, 6000.0), rotation_cam_from_world=np.eye(3)
            )
            pixels, truth = traced.electrons[:, :, 0].astype(float), traced.truth
            weighted = np.sqrt((pixels**2 / (pixels + noise_e2)).sum())
            found = flux_snr(truth.electrons_image[0], truth.noise_area_px2[0], noise_e2=noise_e2)[0]
            assert found == pytest.approx(weighted, rel=0.05)  # spots that are no Gaussians: 3.5 % at most
            faint = np.sqrt((pixels**2).sum() / 1e12)
            assert flux_snr(pixels.sum(), truth.noise_area_px2[0], noise_e2=1e12)[0] == pytest.approx(
                faint, rel=2e-3
            )  # edges cut far images


def test_a_record_says_the_same_in_text_and_in_angles(maker, made):
    record = frame_record(made, maker.scene, "frames/a.fits", "truth/a.parquet", 7, "0" * 64)
    assert record_from_text(record.to_text()) == record
    x, y, z, w = record.quat_xyzw
    assert w >= 0
    boresight = SkyCoord(record.ra_deg, record.dec_deg, unit="deg").cartesian.xyz.value
    turned = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])  # third row, scalar last
    assert turned == pytest.approx(boresight, abs=1e-12)
    down = np.array([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)])  # rows count downwards
    here, up = (SkyCoord(*v, representation_type="cartesian") for v in (boresight, boresight - 1e-6 * down))
    here, up = (SkyCoord(one.spherical.lon, one.spherical.lat) for one in (here, up))
    off = here.position_angle(up).rad - np.radians(record.roll_deg)
    assert (off + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0.0, abs=1e-5)


def test_no_light_at_all(engine):
    """A field without stars is a frame like any other: noise, and a table without rows."""
    config = DatasetConfig(**{**SMALL, "pointing": ConePointing(ra_deg=192.9, dec_deg=27.1, radius_deg=2.0)}, frames=50)
    maker = FrameRenderer(build_scene(config))
    empty = next(k for k in range(50) if not len(stars_of(maker.scene, k)))
    made = maker.render(empty)
    assert made.stars == made.saturated == 0
    assert len(made.truth["star_id"]) == 0
    assert made.frame.dn.std() > 1.0


RATE_DEG_PER_S = (0.01, -0.015, 0.05)


def chief_px(scene, direction, attitude, wavelength_nm):
    """Pixels (n, 2) of chief rays by NumPy."""
    camera = scene.instrument.camera
    angles = field_angles_deg(attitude.apply(direction))
    return np.stack(camera.to_pixel(*chief_ray_points(camera.focused_lens, *angles, wavelength_nm)), axis=1)


@pytest.mark.parametrize(("scanned", "line_time_us"), [(False, 200.0), pytest.param(True, 0.0, marks=pytest.mark.slow)])
def test_smear_and_place(engine, scanned, line_time_us):
    sensor = {"detector": "cmv4000", "exposure_s": 0.2, "width_px": 256, "height_px": 192, "line_time_us": line_time_us}
    pleiades = {"ra_deg": 56.75, "dec_deg": 24.12, "roll_deg": 20.0}
    if scanned:
        scan = ScanPointing(**pleiades, rate_deg_per_s=RATE_DEG_PER_S, frame_rate_hz=20.0)
        settings = {"pointing": scan}
    else:
        cone = ConePointing(**pleiades, radius_deg=0.0)
        settings = {"pointing": cone, "rate": FixedRate(rate_deg_per_s=RATE_DEG_PER_S)}
    scene = build_scene(
        DatasetConfig(
            instrument=InstrumentConfig(**sensor), nodes=3, catalogue=CatalogueConfig(faintest_mag=8.0), **settings
        )
    )
    made = FrameRenderer(scene).render(2)
    truth, plan = made.truth, made.plan
    assert np.degrees(made.plan.rate_rad_per_s) == pytest.approx(RATE_DEG_PER_S)
    direction = SkyCoord(truth["ra_deg"], truth["dec_deg"], unit="deg").cartesian.xyz.value.T.copy()
    wavelength = float(scene.light.wavelength_nm.mean())
    starts = plan.start_s + np.clip(truth["chief_y_px"], 0, 191) * line_time_us * 1e-6
    ends = [
        np.concatenate(
            [
                chief_px(scene, direction[i : i + 1], plan.trajectory.attitude(starts[i] + part * 0.2), wavelength)
                for i in range(len(starts))
            ]
        )
        for part in (0.0, 0.5, 1.0)
    ]
    lit = truth["electrons"] > 0.5 * truth["electrons_in"]
    smear = np.stack([truth["smear_x_px"], truth["smear_y_px"]], axis=1)
    assert np.linalg.norm(smear, axis=1).max() > 2.0
    assert len(smear[lit]) >= 4
    assert smear[lit] == pytest.approx((ends[2] - ends[0])[lit], abs=2e-3)  # at another wavelength
    chief = np.stack([truth["chief_x_px"], truth["chief_y_px"]], axis=1)
    assert chief[lit] == pytest.approx(ends[1][lit], abs=2e-3)
    spot = np.stack([truth["variance_x_px2"], truth["variance_y_px2"]], axis=1) - smear**2 / 12.0
    assert (spot[lit] > 0).all()  # a uniform path of length s has the variance s^2 / 12
    assert (spot[lit] < 1.5).all()
    middle = plan.trajectory.attitude(plan.start_s + 0.5 * (0.2 + 191 * line_time_us * 1e-6))
    assert (middle * plan.attitude.inv()).magnitude() < 1e-12
