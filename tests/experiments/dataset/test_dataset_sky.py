"""Light that is no star, and what space does to a detector: where it goes, what is told of it, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import SkyCoord, get_body, get_body_barycentric, get_sun
from astropy.time import Time

from experiments.dataset.frame import FrameMaker
from experiments.dataset.plan import build_plan, plan_frame
from experiments.dataset.scene import PLANET_IDS, build_scene
from experiments.dataset.settings import (
    BackgroundConfig,
    ConePointing,
    Config,
    RadiationConfig,
    SkyPointing,
)
from experiments.dataset.truth import FLAGS
from experiments.laboratory.settings import CatalogueConfig, InstrumentConfig
from optics.errors import StarbenchError

EPOCH = 2025.3
CAMERA = {
    "instrument": InstrumentConfig(detector="cmv4000", exposure_s=0.2, width_px=192, height_px=128),
    "nodes": 3,
}


def direction_of(body):
    """Where it is seen from the Earth, to some arcminutes: no light time, no aberration."""
    time = Time(EPOCH, format="jyear", scale="tdb")
    place = get_body_barycentric(body, time, ephemeris="builtin") - get_body_barycentric(
        "earth", time, ephemeris="builtin"
    )
    return SkyCoord(place).spherical


@pytest.mark.slow
def test_a_planet_among_the_stars(engine):
    """Neptune (2.2 arcsec) is a point in the truth; Jupiter (34 arcsec) a disk that saturates."""
    sky = CatalogueConfig(faintest_mag=10.0, epoch_year=EPOCH, observer="earth")
    background = BackgroundConfig(moon_planets=True)
    made = {}
    for planet in ("neptune", "jupiter"):
        place = direction_of(planet)
        cone = ConePointing(ra_deg=place.lon.deg, dec_deg=place.lat.deg, radius_deg=0.0, roll_deg=0.0)
        scene = build_scene(Config(**CAMERA, catalogue=sky, pointing=cone, background=background))
        made[planet] = FrameMaker(scene).make(0)
    truth = made["neptune"].truth
    (row,) = np.flatnonzero(truth["star_id"] == PLANET_IDS["neptune"])
    assert truth["catalogue_row"][row] == -1
    assert abs(truth["magnitude"][row] - 7.8) < 0.1
    middle = np.array([CAMERA["instrument"].width_px - 1, CAMERA["instrument"].height_px - 1]) / 2
    off = np.hypot(truth["photon_x_px"][row] - middle[0], truth["photon_y_px"][row] - middle[1])
    assert off < 20  # aberration, 20 arcsec, and light time, at 5.5 arcsec per pixel
    disk = made["jupiter"].frame.saturated
    assert 15 < disk.sum() < 80  # a disk of 6 px
    where = np.argwhere(disk).mean(0)[::-1]
    assert np.hypot(*(where - middle)) < 20
    assert (made["jupiter"].truth["catalogue_row"] >= 0).all()


@pytest.mark.slow
def test_zodiacal_light_and_uniform_sky(engine):
    cone = ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1)  # the Pleiades are opposite to the Sun in November
    settings = {**CAMERA, "catalogue": CatalogueConfig(faintest_mag=10.0, epoch_year=2025.88), "pointing": cone}
    light = {}
    for name, background in (
        ("dark", BackgroundConfig(extra_e_per_s=1.0)),
        ("zodiacal", BackgroundConfig(extra_e_per_s=1.0, zodiacal=True)),
        ("bright", BackgroundConfig(extra_e_per_s=1.0, uniform_mag_per_arcsec2=13.0)),
        ("brighter", BackgroundConfig(extra_e_per_s=1.0, uniform_mag_per_arcsec2=12.0)),
    ):
        light[name] = FrameMaker(build_scene(Config(**settings, background=background))).make(0)
    expected = {name: made.background_e for name, made in light.items()}
    assert expected["dark"] == pytest.approx(0.2)  # 0.2 s
    assert 0.05 < expected["zodiacal"] - 0.2 < 1.0
    assert (expected["brighter"] - 0.2) / (expected["bright"] - 0.2) == pytest.approx(10**0.4, rel=1e-4)
    level = {name: np.median(made.frame.dn.astype(float)) for name, made in light.items()}
    gained = (expected["brighter"] - expected["dark"]) * light["dark"].frame.gain_dn_per_e
    assert gained > 50
    assert level["brighter"] - level["dark"] == pytest.approx(gained, rel=0.03)  # vignetting, and a median for a mean


@pytest.mark.slow
def test_cosmic_rays_are_flagged(engine):
    settings = {
        **CAMERA,
        "instrument": CAMERA["instrument"].model_copy(update={"exposure_s": 20.0}),
        "catalogue": CatalogueConfig(faintest_mag=10.0),
        "pointing": ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1),
    }
    made = {}
    for name in ("none", "solar_flare"):
        config = Config(**settings, radiation=RadiationConfig(environment=name))
        made[name] = FrameMaker(build_scene(config)).make(0)
    bit = FLAGS["cosmic_ray"][0]
    struck = {name: np.count_nonzero(one.truth["flags"] & bit) for name, one in made.items()}
    assert struck["none"] == 0 < struck["solar_flare"]
    more = made["solar_flare"].frame.dn.astype(int) - made["none"].frame.dn
    assert (more >= 0).all()  # the noise is the same, charge only comes on top
    # some 3000 per cm^2 and s, half of them through a flat layer, each in at least one pixel
    area_cm2 = 192 * 128 * (5.5e-4) ** 2
    assert np.count_nonzero(more) > 0.5 * 3046 * area_cm2 * 20.0


def test_a_dose_makes_hot_pixels():
    scenes = [
        build_scene(Config(**CAMERA, radiation=RadiationConfig(displacement_dose_tev_per_g=dose)))
        for dose in (0.0, 200.0)
    ]
    fresh, old = (scene.instrument.detector for scene in scenes)
    assert old.damage_centres_per_px > fresh.damage_centres_per_px == 0


def test_attitudes_keep_away_from_the_sun():
    pointing = SkyPointing(sun_exclusion_deg=60.0)
    plan = build_plan(Config(frames=300, catalogue=CatalogueConfig(epoch_year=EPOCH), pointing=pointing))
    sun = get_sun(Time(EPOCH, format="jyear")).cartesian  # from the centre of the Earth
    towards = sun.xyz.value / np.linalg.norm(sun.xyz.value)
    boresight = np.array([plan_frame(plan, frame).attitude.as_matrix()[2] for frame in range(300)])
    height = boresight @ towards
    assert height.max() < np.cos(np.radians(59.9))
    assert abs(height.mean() + 0.25) < 4 * 1.5 / np.sqrt(12 * 300)  # uniform from -1 to 0.5
    free = build_plan(Config(frames=300, catalogue=CatalogueConfig(epoch_year=EPOCH)))
    kept = [k for k in range(300) if plan_frame(free, k).attitude.as_matrix()[2] @ towards < 0.499]
    assert len(kept) > 150
    same = [(plan_frame(free, k).attitude * plan_frame(plan, k).attitude.inv()).magnitude() for k in kept]
    assert max(same) < 1e-12  # the others stay where they were


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"background": BackgroundConfig(moon_planets=True)}, "set catalogue.observer = earth"),
        ({"background": BackgroundConfig(zodiacal=True)}, "set pointing.sun_exclusion_deg to at least 16"),
        (
            {
                "background": BackgroundConfig(zodiacal=True),
                "pointing": ConePointing(ra_deg=27.0, dec_deg=11.0, radius_deg=1.0),
            },
            "deg from it",
        ),
        (
            {"pointing": ConePointing(ra_deg=27.0, dec_deg=11.0, radius_deg=1.0, sun_exclusion_deg=30.0)},
            "all of the cone",
        ),
    ],
)
def test_refused(settings, said):
    sky = CatalogueConfig(faintest_mag=9.0, epoch_year=EPOCH)
    with pytest.raises(StarbenchError, match=said):
        build_scene(Config(**{**CAMERA, "catalogue": sky, **settings}))


@pytest.mark.slow
def test_venus_behind_the_moon_gives_no_light():
    """Where astropy's ephemeris, too, has it behind the Moon's disk."""
    then = Time(2019.0834474, format="jyear", scale="tdb")
    moon, planet = get_body("moon", then), get_body("venus", then)
    assert moon.separation(planet).rad < np.arcsin(1737.4 / moon.distance.to_value("km"))
    config = Config.model_validate(
        {
            "frames": 1,
            "catalogue": {"epoch_year": 2019.0834474, "observer": "earth", "faintest_mag": 9.0},
            "background": {"moon_planets": True},
            "instrument": {
                "lens": "star_tracker_26mm",
                "detector": "cmv4000",
                "width_px": 1024,
                "height_px": 1024,
                "exposure_s": 2e-4,
            },
            "pointing": {"kind": "body", "body": "moon"},
        }
    )
    truth = FrameMaker(build_scene(config)).make(0).truth
    venus = np.flatnonzero(truth["star_id"] == -1000299)
    assert len(venus) == 1
    assert truth["electrons"][venus[0]] == 0.0
    assert truth["electrons_hidden"][venus[0]] > 1e4
    assert truth["flags"][venus[0]] & (FLAGS["hidden"][0] | FLAGS["no_light"][0]) == 192
