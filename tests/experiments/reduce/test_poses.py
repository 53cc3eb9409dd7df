"""Poses of a turntable, drawn with NumPy: camera, star and accuracy of star vectors are what was put in."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from target_frames import readout, spots, write

from experiments.fisher.own_frames import reduce as reduce_vectors
from experiments.fisher.settings import FisherConfig
from experiments.reduce.folder import read_folder
from experiments.reduce.poses import POSES
from experiments.turntable.own_frames import reduce as reduce_table
from optics.errors import ConfigError

F_MM, PITCH_MM, Q1, PRINCIPAL = 24.0, 0.054, -2.5e-4, np.array([3.0, -2.0])  # a camera of 14 x 11 degrees
READING, LEAN = 8.0, 60.0  # arcsec
STAR, INSTALLATION = np.radians([0.3, -0.2]), np.radians([0.4, -0.7, 1.2])  # azimuth and elevation; rotation vector
SIZE = np.array([120, 92])
HEAD = "gain_dn_per_e = 0.4\noffset_dn = 100\nread_noise_e = 8\npixel_arcsec = 464\npixel_pitch_um = 54\n"


def image_px(outer, inner):
    """Where the star is imaged at true angles [rad]: outer axis X, inner axis Y that leans towards it."""
    lean = np.radians(LEAN / 3600)
    table = Rotation.from_rotvec([outer, 0.0, 0.0])
    table *= Rotation.from_rotvec(inner * np.array([np.sin(lean), np.cos(lean), 0.0]))
    azimuth, elevation = STAR
    star = [np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)]
    seen = (Rotation.from_rotvec(INSTALLATION) * table.inv()).apply(star)
    ideal = F_MM * seen[:2] / seen[2]
    return (SIZE - 1) / 2 + PRINCIPAL + ideal * (1 + Q1 * (ideal @ ideal)) / PITCH_MM


@pytest.fixture(scope="module")
def poses(tmp_path_factory):
    """30 poses of two frames that calibrate, 20 of one frame that are evaluated; series in a CSV table."""
    folder = tmp_path_factory.mktemp("poses")
    rng, rows = np.random.default_rng(17), ["files,name,outer_deg,inner_deg,use"]
    for use, columns, lines, frames in (("calibration", 6, 5, 2), ("evaluation", 5, 4, 1)):
        grid = np.stack(np.meshgrid(np.linspace(-5.6, 5.6, columns), np.linspace(-3.7, 3.7, lines)), -1).reshape(-1, 2)
        for number, (inner, outer) in enumerate(grid + rng.uniform(-0.1, 0.1, grid.shape)):
            light = spots(SIZE[::-1], [image_px(np.radians(outer), np.radians(inner))], 30000.0)
            dn = readout(np.stack([light] * frames), rng, gain=0.4, offset=100.0, read=8.0)
            name = f"{use[:3]}{number:02d}"
            write(folder / f"{name}.fits", dn)
            outer_deg, inner_deg = np.array([outer, inner]) + rng.normal(0.0, READING / 3600, 2)
            rows.append(f"{name}.fits,{name},{outer_deg},{inner_deg},{use}")
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    table = f"[table]\naxes = 'xy'\nreading_noise_arcsec = [{READING}]\n"
    (folder / "frames.toml").write_text(f"{HEAD}series_table = 'poses.csv'\n{table}")
    return folder


def test_camera_star_and_star_vectors_are_what_was_put_in(poses):
    """Readings of 8 arcsec; centroids of some 2 arcsec."""
    folder = read_folder(poses, window_px=11, layout=POSES)
    _, table = reduce_table(folder, ("gaussian",))
    unknowns = {unknown.name: unknown.estimate for unknown in table["unknowns"]}
    for name, value in (
        ("focal_length_mm", F_MM),
        ("q1_per_mm2", Q1),
        ("star_azimuth_rad", STAR[0]),
        ("star_elevation_rad", STAR[1]),
    ):
        assert unknowns[name].value == pytest.approx(value, abs=4 * unknowns[name].uncertainty), name
    assert unknowns["focal_length_mm"].uncertainty < 0.02
    assert table["fit"].fit_ratio.value == pytest.approx(1.0, abs=4 * table["fit"].fit_ratio.uncertainty)
    assert table["fit"].coverage > 0.6
    series, fisher = reduce_vectors(folder, ("gaussian",), FisherConfig())
    assert len(series) == 50
    vectors = fisher["vectors"]
    assert vectors.readings_arcsec == pytest.approx(READING, rel=0.02)
    expected = np.hypot(READING, vectors.centroids_arcsec)
    assert vectors.sigma_arcsec == pytest.approx(expected, rel=4 / np.sqrt(4 * 19) + 0.05)
    assert abs(vectors.deviation_sigma) < 4.0
    assert (fisher["distribution"].vectors, fisher["distribution"].outliers) == (20, 0)


@pytest.mark.parametrize(
    ("before", "after", "reduce", "said"),
    [
        ("axes = 'xy'", "axes = 'xyz'", reduce_table, "has 3 axes, a pose then has the readings outer_deg, middle"),
        ("pixel_pitch_um = 54\n", "", reduce_table, "pixel_pitch_um is missing"),
        (",evaluation", ",calibration", reduce_vectors, "no series has use = 'evaluation'"),
    ],
)
def test_poses_that_are_wrong_are_one_line(before, after, reduce, said, poses, tmp_path):
    shutil.copytree(poses, tmp_path, dirs_exist_ok=True)
    for path in (tmp_path / "frames.toml", tmp_path / "poses.csv"):
        path.write_text(path.read_text().replace(before, after))
    with pytest.raises(ConfigError, match=said):
        reduce(read_folder(tmp_path, window_px=11, layout=POSES), ("gaussian",), FisherConfig())
