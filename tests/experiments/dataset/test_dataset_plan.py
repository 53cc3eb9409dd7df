"""Attitudes, motions and splits: what each frame is depends on its number alone, and means what the columns say."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from scipy.spatial.transform import Rotation

from experiments.dataset.plan import build_plan, plan_frame, read_attitudes
from experiments.dataset.settings import (
    ConePointing,
    DatasetConfig,
    FixedRate,
    JitterSpectrumConfig,
    ListPointing,
    RandomRate,
    ScanPointing,
    SkyPointing,
    SplitsConfig,
)
from optics.attitude import angles_from_attitude

N = 500


def frames_of(count=N, diagonal_deg=0.0, **settings):
    plan = build_plan(DatasetConfig(frames=count, **settings), diagonal_deg=diagonal_deg)
    return [plan_frame(plan, frame) for frame in range(count)]


def test_random_attitudes_are_uniform():
    axes = np.array([one.attitude.as_matrix() for one in frames_of()])  # every axis uniform over the sphere
    assert np.abs(axes.mean(0)).max() < 4.5 / np.sqrt(3 * N)
    assert np.abs((axes**2).mean(0) - 1 / 3).max() < 4.5 * np.sqrt(4 / 45 / N)


def test_cone_is_filled_evenly():
    frames = frames_of(pointing=ConePointing(ra_deg=200.0, dec_deg=-80.0, radius_deg=30.0))
    centre = SkyCoord(200.0, -80.0, unit="deg").cartesian.xyz.value
    height = np.array([one.attitude.as_matrix()[2] @ centre for one in frames])
    low = np.cos(np.radians(30.0))
    assert height.min() >= low
    assert abs(height.mean() - (1 + low) / 2) < 4 * (1 - low) / np.sqrt(12 * N)  # equal heights are equal areas


def test_a_scan_is_one_motion():
    rate = np.radians([0.2, -0.5, 0.1])
    scan = ScanPointing(rate_deg_per_s=tuple(np.degrees(rate)), frame_rate_hz=4.0)
    first, second = frames_of(9, pointing=scan)[7:9]
    assert (second.attitude * first.attitude.inv()).as_rotvec() == pytest.approx(-rate / 4.0, abs=1e-12)
    assert first.trajectory is second.trajectory
    middle = first.trajectory.attitude(first.start_s + DatasetConfig().instrument.exposure_s / 2)
    assert (middle * first.attitude.inv()).magnitude() < 1e-12


def test_rates():
    fixed = frames_of(4, rate=FixedRate(rate_deg_per_s=(0.0, 1.0, 0.0)))[3]
    middle = fixed.trajectory.attitude(DatasetConfig().instrument.exposure_s / 2)
    assert (middle * fixed.attitude.inv()).magnitude() < 1e-12
    free = frames_of(4)[3]
    assert free.trajectory is None
    assert (free.attitude * fixed.attitude.inv()).magnitude() < 1e-12  # the rate changes no attitude
    random = RandomRate(distribution="log_uniform", lowest_deg_per_s=0.01, highest_deg_per_s=1.0)
    size = np.degrees([np.linalg.norm(one.rate_rad_per_s) for one in frames_of(rate=random)])
    assert 0.01 <= size.min() <= size.max() <= 1.0
    assert abs(np.log10(size).mean() + 1.0) < 4 * 2 / np.sqrt(12 * N)
    even = RandomRate(distribution="uniform", lowest_deg_per_s=2.0, highest_deg_per_s=6.0)
    size = np.degrees([np.linalg.norm(one.rate_rad_per_s) for one in frames_of(rate=even)])
    assert 2.0 <= size.min() <= size.max() <= 6.0
    assert abs(size.mean() - 4.0) < 4 * 4 / np.sqrt(12 * N)


def test_jitter():
    """Attitudes scatter about those without it by what the spectrum says; frames of a scan share one motion."""
    jitter = JitterSpectrumConfig(
        frequency_hz=(0.5, 50.0), psd_x_arcsec2_per_hz=(4.0, 4.0), psd_z_arcsec2_per_hz=(16.0, 16.0)
    )
    still, moved = frames_of(150), frames_of(150, jitter=jitter)
    off = np.array([(b.attitude * a.attitude.inv()).as_rotvec() for a, b in zip(still, moved, strict=True)])
    rms = np.degrees(np.sqrt((off**2).mean(0))) * 3600
    wanted = np.sqrt(np.array([4.0, 0.0, 16.0]) * 49.5)
    assert rms == pytest.approx(wanted, rel=4 / np.sqrt(2 * 150), abs=1e-6)
    assert moved[3].rate_rad_per_s.any()
    assert moved[3].trajectory is not None
    scan = frames_of(7, pointing=ScanPointing(), jitter=jitter)
    assert scan[5].trajectory is scan[6].trajectory


def test_splits_are_shared_out_in_blocks():
    splits = SplitsConfig(by="frame", train_fraction=0.7, validation_fraction=0.2, test_fraction=0.1)
    names = [one.split for one in frames_of(splits=splits)]
    for block in range(0, N, 100):
        part = names[block : block + 100]
        assert [part.count(name) for name in ("train", "validation", "test")] == [70, 20, 10]
    assert names[:100] != names[100:200]


def listed(tmp_path):
    """Attitudes of an oblong patch, in a file."""
    ra, dec = np.random.default_rng(5).uniform(-1.0, 1.0, (2, 100)) * np.array([[40.0], [10.0]])
    Table({"ra_deg": ra % 360.0, "dec_deg": dec, "roll_deg": np.zeros(100)}).write(tmp_path / "list.csv")
    return ListPointing(file=str(tmp_path / "list.csv"))


def test_every_kind_of_pointing_has_its_splits(tmp_path):
    """By the sky for random attitudes, cones and lists, by arcs for a scan; more frames change nothing."""
    cone = ConePointing(ra_deg=350.0, dec_deg=80.0, radius_deg=40.0)
    for by, pointing in (("sky", SkyPointing()), ("sky", cone), ("sky", listed(tmp_path)), ("arc", ScanPointing())):
        plan = build_plan(DatasetConfig(frames=100, pointing=pointing), diagonal_deg=8.0)
        assert (plan.splits.by, plan.splits.gap_deg) == (by, pytest.approx(8.0))
        names = [plan_frame(plan, frame).split for frame in range(100)]
        assert names.count("train") > 30
        assert names[:50] == [one.split for one in frames_of(50, 8.0, pointing=pointing)]


@pytest.mark.parametrize(("pointing", "diagonal_deg"), [(ConePointing(), 17.7), (SkyPointing(), 120.0)])
def test_frames_are_split_at_random_if_the_gaps_leave_too_few(pointing, diagonal_deg):
    frames = frames_of(100, diagonal_deg, pointing=pointing)
    assert {frame.split for frame in frames} == {"train", "validation", "test"}


def test_attitudes_from_files(tmp_path):
    rotation = Rotation.random(30, random_state=4)
    ra, dec, roll = np.array([angles_from_attitude(one) for one in rotation]).T
    quaternion = dict(zip(("quat_x", "quat_y", "quat_z", "quat_w"), rotation.as_quat().T, strict=True))
    tables = {
        "angles.csv": Table({"ra_deg": ra, "dec_deg": dec, "roll_deg": roll}),
        "radians.ecsv": Table(
            {"ra": np.radians(ra), "dec": np.radians(dec), "roll": np.radians(roll)}, units=["rad"] * 3
        ),
        "quaternions.csv": Table(quaternion),
    }
    for name, table in tables.items():
        table.write(tmp_path / name)
        read = read_attitudes(str(tmp_path / name))
        assert (read * rotation.inv()).magnitude().max() < 1e-9, name
