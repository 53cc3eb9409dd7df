"""Labels of a frame against the detector's own charge, and the Moon against its rendered disk."""

import numpy as np
import pytest

from experiments.dataset.frames.maker import FrameMaker
from experiments.dataset.frames.scene import build_scene
from experiments.dataset.settings import (
    BodyPointing,
    ConePointing,
    Config,
    RadiationConfig,
    VerifyConfig,
)
from experiments.dataset.truth.labels import LabelMaker
from experiments.laboratory.settings import InstrumentConfig
from render.detector.cosmic_rays import cosmic_ray_hits
from render.detector.maps import sensor_maps
from render.engine import Engine
from render.engine.random import Streams

SMALL = InstrumentConfig(
    lens="star_tracker_26mm", detector="cmv4000", exposure_s=2.0, width_px=256, height_px=192, chip_temperature_c=30.0
)


@pytest.fixture(scope="module")
def shot():
    Engine.start("llvm")
    scene = build_scene(
        Config(
            instrument=SMALL,
            nodes=3,
            pointing=ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1),
            radiation=RadiationConfig(displacement_dose_tev_per_g=500.0),
            verify=VerifyConfig(frames=0),
        )
    )
    return scene, FrameMaker(scene)


def test_every_struck_pixel_is_in_one_track_and_no_charge_is_lost(shot):
    scene, _ = shot
    hits = cosmic_ray_hits(
        scene.instrument.detector,
        "deep_space_solar_minimum",
        streams=Streams(3),
        frame=0,
        exposure_s=600.0,
        depth_um=10.0,
    )
    tracks = [one for one in LabelMaker(scene, lambda _: hits).labels(3) if one.kind == "cosmic_ray"]
    strong = hits.charge_e >= 1.0
    assert 10 < len(tracks) < 500
    assert sum(one.electrons for one in tracks) == pytest.approx(hits.charge_e[strong].sum(), rel=1e-9)
    boxes = np.array([one.box_px for one in tracks])
    row, column = hits.row[strong] + 0.5, hits.column[strong] + 0.5
    inside = (column[:, None] > boxes[:, 0]) & (column[:, None] < boxes[:, 0] + boxes[:, 2])
    inside &= (row[:, None] > boxes[:, 1]) & (row[:, None] < boxes[:, 1] + boxes[:, 3])
    assert inside.any(1).all()


def test_hot_pixels_stand_out_of_frames_without_light(shot):
    scene, maker = shot
    hot = [one for one in LabelMaker(scene, maker.hits).labels(0) if one.kind == "hot_pixel"]
    defect = sensor_maps(scene.instrument.detector).defect
    assert 0 < len(hot) <= defect.sum()
    frames = np.stack([maker.make(k).frame.dn for k in range(6)]).astype(float)
    middle = np.median(frames, axis=0)
    x, y = np.array([(one.x_px, one.y_px) for one in hot], int).T
    assert np.median(middle[y, x]) > np.median(middle) + 3.0 * np.std(frames - middle)


@pytest.mark.slow
def test_a_field_with_the_moon_has_its_disk_where_the_label_says():
    Engine.start("llvm")
    config = Config(
        instrument=SMALL.model_copy(update={"exposure_s": 1e-4, "width_px": 1024, "height_px": 1024}),
        nodes=3,
        pointing=BodyPointing(body="moon", offset_deg=3.0),
        verify=VerifyConfig(frames=0),
    )
    assert config.catalogue.observer == "earth"
    assert config.background.moon_planets
    scene = build_scene(config)
    maker = FrameMaker(scene)
    labels = LabelMaker(scene, maker.hits)
    for frame in range(2):
        (moon,) = [one for one in labels.labels(frame) if one.name == "moon"]
        dn = maker.make(frame).frame.dn.astype(float)
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
