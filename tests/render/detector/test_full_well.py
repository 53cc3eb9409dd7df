"""Smear, lag and blooming against closed forms; nothing changes where a detector names none of them."""

import dataclasses

import numpy as np
import pytest
from detectors import ideal_detector

from render.detector.full_well import bloomed
from render.detector.readout import expose
from render.engine.random import Streams

PLAIN = ideal_detector(64, 32, offset_dn=0.0, full_well_e=10000.0)


def read(electrons, **changes):
    options = {k: changes.pop(k) for k in ("exposure_s", "before", "frame") if k in changes}
    detector = dataclasses.replace(PLAIN, **changes)
    return expose(electrons.astype(np.float32), detector, streams=Streams(3), **({"exposure_s": 0.1} | options))


def spot(value, row=30, column=16):
    image = np.zeros(PLAIN.shape)
    image[row, column] = value
    return image


def test_smear_is_the_columns_light_times_line_time_over_exposure():
    image = spot(1e6) + spot(5e5, row=10)
    frames = [read(image, transfer_line_us=2.0, exposure_s=0.01, frame=k).dn for k in range(40)]
    mean = np.mean(frames, axis=0)
    # 1.5e6 e- x 2 us / 10 ms = 300 e- in every pixel of the column; 40 frames of 62 pixels: 0.35 e-
    dark = np.delete(mean[:, 16], [10, 30])
    assert dark.mean() == pytest.approx(300.0, abs=1.5)
    assert np.abs(dark - 300.0).max() < 5 * np.sqrt(300.0 / 40)
    assert not np.delete(mean, 16, axis=1).any()


def test_lag_leaves_its_share_up_to_the_full_well():
    before = spot(6000.0) + spot(1e6, row=40)
    dn = np.mean([read(np.zeros(PLAIN.shape), lag=0.02, before=before, frame=k).dn for k in range(100)], axis=0)
    assert dn[30, 16] == pytest.approx(120.0, abs=5.0)
    assert dn[40, 16] == pytest.approx(200.0, abs=6.0)
    assert dn.sum() == pytest.approx(dn[30, 16] + dn[40, 16])
    assert not read(np.zeros(PLAIN.shape), lag=0.02).dn.any()


@pytest.mark.parametrize(("share", "length"), [(0.0, 1), (0.5, 11), (1.0, 21)])
def test_blooming_fills_wells_up_and_down_the_column(share, length):
    """Twenty wells beyond its own: so many of them, times the share that no drain takes, are filled by it."""
    charge = bloomed(spot(21.0 * 1e4), dataclasses.replace(PLAIN, blooming=share))
    full = charge[:, 16] >= 1e4
    assert full.sum() == length
    assert np.flatnonzero(full).mean() == 30
    frame = read(spot(21.0 * 1e4), blooming=share)
    assert np.array_equal(np.flatnonzero(frame.saturated[:, 16]), np.flatnonzero(full))
    assert frame.saturated.sum() == length


def test_blooming_keeps_charge_until_it_reaches_the_ends():
    rng = np.random.default_rng(1)
    image = rng.uniform(0.0, 6000.0, PLAIN.shape)
    image[20:24, 3] = 4e4
    charge = np.minimum(bloomed(image, dataclasses.replace(PLAIN, blooming=1.0)), 1e4)
    assert charge.sum() == pytest.approx(image.sum(), rel=1e-12)
    image[32, 5] = 1e8
    charge = np.minimum(bloomed(image, dataclasses.replace(PLAIN, blooming=1.0)), 1e4)
    assert (charge[:, 5] == 1e4).all()
    assert charge.sum() < image.sum()
