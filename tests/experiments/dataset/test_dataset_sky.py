"""What is no star: sky light, planets, the Moon, hot pixels, cosmic rays; what labels say of it, what is refused."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import GCRS, SkyCoord, get_body, get_sun
from astropy.time import Time
from scipy import ndimage

from experiments.dataset.frame import FrameRenderer
from experiments.dataset.job import frame_record, mask_planes
from experiments.dataset.labels import FrameLabeller, body_labels, disk_truth
from experiments.dataset.plan import build_plan, plan_frame
from experiments.dataset.scene import build_scene
from experiments.dataset.settings import (
    BackgroundConfig,
    BodyPointing,
    ConePointing,
    DatasetConfig,
    RadiationConfig,
    SkyPointing,
    VerifyConfig,
)
from experiments.dataset.truth import FLAGS, record_from_text
from render.bodies.solar_system import solar_system
from render.detector.maps import sensor_maps
from render.engine import Engine
from render.observation import BodyDisk
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig

EPOCH = 2025.3


def test_attitudes_keep_away_from_the_sun():
    pointing = SkyPointing(sun_exclusion_deg=60.0)
    plan = build_plan(DatasetConfig(frames=300, catalogue=CatalogueConfig(epoch_year=EPOCH), pointing=pointing))
    sun = get_sun(Time(EPOCH, format="jyear")).cartesian  # from the centre of the Earth
    towards = sun.xyz.value / np.linalg.norm(sun.xyz.value)
    boresight = np.array([plan_frame(plan, frame).attitude.as_matrix()[2] for frame in range(300)])
    height = boresight @ towards
    assert height.max() < np.cos(np.radians(59.9))
    assert abs(height.mean() + 0.25) < 4 * 1.5 / np.sqrt(12 * 300)  # uniform from -1 to 0.5
    free = build_plan(DatasetConfig(frames=300, catalogue=CatalogueConfig(epoch_year=EPOCH)))
    kept = [k for k in range(300) if plan_frame(free, k).attitude.as_matrix()[2] @ towards < 0.499]
    assert len(kept) > 150
    same = [(plan_frame(free, k).attitude * plan_frame(plan, k).attitude.inv()).magnitude() for k in kept]
    assert max(same) < 1e-12  # the others stay where they were


@pytest.mark.slow
def test_venus_behind_the_moon_gives_no_light():
    """Where astropy's ephemeris, too, has it behind the Moon's disk."""
    then = Time(2019.0834474, format="jyear", scale="tdb")
    moon, planet = get_body("moon", then), get_body("venus", then)
    assert moon.separation(planet).rad < np.arcsin(1737.4 / moon.distance.to_value("km"))
    config = DatasetConfig.model_validate(
        {
            "frames": 1,
            "catalogue": {"epoch_year": 2019.0834474, "observer": "earth", "faintest_mag": 9.0},
            "background": {"moon_planets": True},
            "instrument": {
                "lens": "star_tracker_26mm",
                "detector": "cmv4000",
                "width_px": 256,
                "height_px": 256,
                "exposure_s": 1e-6,
            },
            "nodes": 3,
            "pointing": {"kind": "body", "body": "moon", "offset_deg": 0.5},
        }
    )
    truth = FrameRenderer(build_scene(config)).render(0).truth
    venus = np.flatnonzero(truth["star_id"] == -1000299)
    assert len(venus) == 1
    assert truth["electrons"][venus[0]] == 0.0
    assert truth["electrons_hidden"][venus[0]] > 50.0
    assert truth["flags"][venus[0]] & (FLAGS["hidden"][0] | FLAGS["no_light"][0]) == 192


SMALL = InstrumentConfig(
    lens="star_tracker_26mm", detector="cmv4000", exposure_s=2.0, width_px=256, height_px=192, chip_temperature_c=30.0
)


def test_labels_of_hot_pixels_and_cosmic_rays(engine):
    """Expected behaviour: labels hold all charge of the rays in pixels with an electron, and the hottest defects."""
    config = DatasetConfig(
        instrument=SMALL,
        nodes=2,
        pointing=ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1),
        radiation=RadiationConfig(environment="leo_quiet", displacement_dose_tev_per_g=500.0),
    )
    scene = build_scene(config)
    labels, hits = FrameLabeller(scene).labels(0), scene.simulator.hits(0)
    rays = [label for label in labels if label.kind == "cosmic_ray"]
    assert sum(label.pixels.shape[1] for label in rays) == np.count_nonzero(hits.hit_mask)
    strong = hits.charge_e[hits.hit_mask[hits.row, hits.column]]
    assert sum(label.electrons for label in rays) == pytest.approx(strong.sum())
    maps, hot = sensor_maps(scene.instrument.detector), [label for label in labels if label.kind == "hot_pixel"]
    assert 0 < len(hot) < maps.defect.sum()
    assert all(maps.defect[tuple(label.pixels[:, 0])] for label in hot)
    coldest = min(label.electrons for label in hot)
    dark_e = maps.dark_current_e_per_s * scene.instrument.detector.dark_factor(30.0) * 2.0
    assert np.count_nonzero(dark_e[maps.defect] >= coldest) == len(hot)
    assert {(label.box_px[2], label.box_px[3]) for label in hot} == {(1.0, 1.0)}


def hold_disk_to_astropy(disk, made, scene, label):
    """Place, size and phase from astropy's own bodies; the light lies on the Sun's side of the middle."""
    time = Time(scene.config.catalogue.epoch_year, format="jyear", scale="tdb")
    moon, sun = (get_body(name, time, ephemeris="builtin").transform_to(GCRS(obstime=time)) for name in ("moon", "sun"))
    seen = SkyCoord(disk.ra_deg * units.deg, disk.dec_deg * units.deg)
    assert seen.separation(SkyCoord(moon.ra, moon.dec)).arcsec < 0.1
    away = moon.separation(sun).rad
    near, far = moon.distance.to_value(units.km), sun.distance.to_value(units.km)
    phase = np.arctan2(far * np.sin(away), near - far * np.cos(away))
    assert disk.phase_deg == pytest.approx(np.degrees(phase), abs=0.01)
    assert disk.diameter_px == pytest.approx(label.box_px[2], abs=1e-6)
    assert (disk.x_px, disk.y_px) == pytest.approx((label.x_px, label.y_px), abs=1e-9)
    assert (disk.kind, disk.star_id) == ("moon", -1000301)
    towards = np.radians(disk.sun_angle_deg)
    shift = np.array([disk.photon_x_px - disk.x_px, disk.photon_y_px - disk.y_px])
    assert shift @ [np.cos(towards), np.sin(towards)] > 0.02 * disk.diameter_px
    assert disk.electrons > 1e3
    assert disk.noise_share < 0.03
    record = frame_record(made, scene, "frame.fits", "truth.parquet", 0, "0" * 64)
    assert record.disks == (disk,)
    assert record_from_text(record.to_text()) == record


def test_the_label_of_the_moon_is_its_disk():
    """Half a degree wide, 0.3 deg from the boresight; lit on the side of the Sun; nothing is rendered."""
    Engine.start("llvm")
    config = DatasetConfig(instrument=SMALL, nodes=3, pointing=BodyPointing(body="moon", offset_deg=0.3))
    scene, plan = build_scene(config), plan_frame(build_plan(config), 0)
    (label,) = body_labels(scene, plan)
    assert (label.kind, label.name) == ("moon", "moon")
    diameter_px = label.box_px[2]
    assert diameter_px * scene.instrument.pixel_arcsec / 3600.0 == pytest.approx(0.52, abs=0.04)
    assert label.pixels.shape[1] == pytest.approx(np.pi / 4.0 * diameter_px**2, rel=0.02)
    assert np.hypot(label.x_px - 127.5, label.y_px - 95.5) < 0.32 * 3600.0 / scene.instrument.pixel_arcsec
    struck = np.zeros((192, 256), bool)
    frame = SimpleNamespace(plan=plan, cosmic_rays=struck, frame=SimpleNamespace(dn=np.zeros((192, 256))))
    marks = mask_planes(scene, frame)
    assert marks["DISK"].sum() == label.pixels.shape[1]
    assert marks["COSMIC"] is struck
    image = SimpleNamespace(electrons=np.array([5.0]), photon_px=np.array([[1.0, 2.0]]), noise_share=0.0)
    (truth,) = disk_truth(scene, plan, [BodyDisk(name="moon", row=0, image=image)])
    assert (truth.x_px, truth.y_px, truth.diameter_px) == pytest.approx((label.x_px, label.y_px, diameter_px))


@pytest.mark.slow
def test_the_moon_behind_the_earth():
    """A million kilometres behind the Earth, as the Moon sees it: its disk with the air around it, and no Moon."""
    Engine.start("llvm")
    small = SMALL.model_copy(update={"exposure_s": 1e-6, "width_px": 256, "height_px": 256})
    moon = solar_system(DatasetConfig().catalogue.epoch_year, bodies=["moon"]).direction[0]
    away = (float(np.degrees(np.arctan2(moon[1], moon[0]))) % 360.0, float(np.degrees(np.arcsin(moon[2]))))
    background = BackgroundConfig(moon_planets=True, earth_direction_deg=away, earth_distance_km=1e6)
    pointing = BodyPointing(body="moon", offset_deg=0.1)
    scene = build_scene(DatasetConfig(instrument=small, nodes=3, pointing=pointing, background=background))
    made = FrameRenderer(scene).render(0)
    earth, hidden = made.disks
    assert (earth.name, hidden.name) == ("earth", "moon")
    assert earth.image.electrons[0] > 1e3
    assert hidden.image.electrons[0] == 0.0
    (disk,) = disk_truth(scene, made.plan, made.disks)
    assert (disk.name, disk.kind) == ("earth", "planet")


@pytest.mark.slow
def test_a_field_with_the_moon_has_its_disk_where_the_label_says():
    Engine.start("llvm")
    config = DatasetConfig(
        instrument=SMALL.model_copy(update={"exposure_s": 2e-5, "width_px": 512, "height_px": 512}),
        nodes=3,
        pointing=BodyPointing(body="moon", offset_deg=2.0),
        verify=VerifyConfig(frames=0),
    )
    assert config.catalogue.observer == "earth"
    assert config.background.moon_planets
    scene = build_scene(config)
    maker = FrameRenderer(scene)
    labels = FrameLabeller(scene)
    for frame in range(2):
        (moon,) = [one for one in labels.labels(frame) if one.name == "moon"]
        made = maker.render(frame)
        lit = made.disks[0].image.image.electrons[:, :, 0]
        marked = mask_planes(scene, made)["DISK"]  # pixels with their middle on the disk; its limb is blurred
        assert lit[ndimage.binary_dilation(marked, np.ones((3, 3)))].sum() > 0.99 * lit.sum()
        assert lit[ndimage.binary_erosion(~marked, np.ones((3, 3)))].max() < 0.05 * lit.max()
        (disk,) = disk_truth(scene, made.plan, made.disks)
        hold_disk_to_astropy(disk, made, scene, moon)
        dn = made.frame.dn.astype(float)
        bright = dn > np.median(dn) + 0.05 * (dn.max() - np.median(dn))
        rows, columns = np.nonzero(bright)
        left, top, width, height = moon.box_px
        inside = (columns + 0.5 > left - 1) & (columns + 0.5 < left + width + 1)
        inside &= (rows + 0.5 > top - 1) & (rows + 0.5 < top + height + 1)
        assert len(rows) > 50
        assert inside.mean() > 0.99
        # lit or not, the limb reaches the box on the sunlit side
        gaps = (columns.min() - left, left + width - columns.max() - 1, rows.min() - top, top + height - rows.max() - 1)
        assert min(abs(gap) for gap in gaps) < 2.0
