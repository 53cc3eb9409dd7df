"""Nights of a pinhole camera: notes on faulty frames, and the twin of good ones."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from calib.attitude.identify_unknown_scale import BlindIdentifier
from calib.measure.images.sensor_image import sensor_image
from calib.photometry.atmosphere import airmass, refracted, zenith_directions
from experiments.harness.progress import Progress
from experiments.harness.run import run_experiment
from experiments.twin.experiment import files
from experiments.twin.faults import likely_fault, shape_fault
from experiments.twin.folder import NightFrame
from experiments.twin.night import solve_all
from experiments.twin.pipeline import measure_night, stated_pitch_mm
from experiments.twin.report import pictures
from experiments.twin.settings import TwinConfig, experiment
from optics.errors import DomainError
from render import load_star_sensor
from render.sky.sky import load_sky

SIZE, FOCAL_PX, LEVEL = 512, 2600.0, 300.0
FIELD_DEG = 2.0 * np.degrees(np.arctan(SIZE / 2.0 / FOCAL_PX))


@lru_cache
def sky(faintest_mag=8.5, **options):
    return load_sky(faintest_mag=faintest_mag, **options)


def pixels_of(v, flux, size, focal_px, sigma_px=0.9, around=((0.0, 0.0),)):
    """Light of stars (n,) in directions (n, 3) in cam through a pinhole, each a number of Gaussians."""
    star_px = focal_px * v[:, :2] / np.maximum(v[:, 2:], 1e-6) + (size - 1) / 2.0
    position_px = (star_px[:, None] + np.asarray(around)).reshape(-1, 2)
    centre = np.rint(position_px).astype(int)
    inside = np.repeat(v[:, 2] > 0.5, len(around)) & ((centre >= 4) & (centre < size - 4)).all(axis=1)
    electrons = np.repeat(flux / len(around), len(around))[inside]
    position_px, pixels = position_px[inside], centre[inside, :, None] + np.arange(-4, 5)
    profile = np.exp(-0.5 * ((pixels - position_px[:, :, None]) / sigma_px) ** 2)
    profile *= (electrons[:, None] ** 0.5 / profile.sum(axis=2))[:, :, None]
    image = np.zeros((size, size))
    np.add.at(image, (pixels[:, 1, :, None], pixels[:, 0, None]), profile[:, 1, :, None] * profile[:, 0, None])
    return image


def light_of(seed, *, focal_px=FOCAL_PX, trail_px=0.0, disk_px=0.0):
    """Light of the catalogue's stars in a random attitude, each a trail of pixels, a disk or a Gaussian."""
    turn = Rotation.random(rng=np.random.default_rng(seed))
    rng = np.random.default_rng(seed + 1)
    radius, angle = disk_px * np.sqrt(rng.uniform(size=120)), rng.uniform(0, 2 * np.pi, 120)
    around = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    around += trail_px * np.outer(np.linspace(-0.5, 0.5, 120), [0.8, 0.6])
    flux = 4e4 * 10.0 ** (-0.4 * (np.array(sky().magnitude) - 5.0))
    return pixels_of(turn.apply(np.array(sky().direction)), flux, SIZE, focal_px, around=around)


def frame(light, seed=3, level=LEVEL, **options):
    rng = np.random.default_rng(seed)
    return sensor_image(rng.poisson(light + level).astype(float), saturation_dn=65535.0, source="frame", **options)


def solved(image):
    pytest.importorskip("tetra3rs")
    identifier = BlindIdentifier(SIZE, SIZE, field_deg=round(FIELD_DEG, 1))
    return solve_all(["a"], [image], identifier, Progress())[0]


def test_a_good_frame_is_solved_and_has_no_fault():
    solution = solved(frame(light_of(1)))
    assert solution.attitude is not None
    assert solution.focal_px == pytest.approx(FOCAL_PX, rel=2e-3)
    assert "identified, residual 0.0" in solution.summary
    assert shape_fault(solution.image, solution.detected) == ""


@pytest.mark.parametrize(
    ("options", "words"),
    [({"trail_px": 14.0}, "trailed: stars are"), ({"disk_px": 9.0}, "out of focus: stars are")],
)
def test_images_that_are_no_points(options, words):
    solution = solved(frame(light_of(2, **options)))
    assert solution.attitude is not None or words in likely_fault(solution)
    assert words in shape_fault(solution.image, solution.detected)


@pytest.mark.slow
def test_a_mirrored_sky_is_stated():
    words = likely_fault(solved(frame(light_of(1)[:, ::-1])))
    assert "mirrored" in words
    assert "background 300" in words


def test_clouds_over_a_part_of_the_frame():
    light = light_of(1)
    cover = gaussian_filter((np.indices(light.shape)[1] > 150).astype(float), 30.0)
    solution = solved(frame(light * (1.0 - 0.995 * cover) + 60.0 * cover))
    failed = replace(solution.identification, status="no_match", message="no match")
    unsolved = replace(solution, identification=failed)
    assert "of the frame has no star" in likely_fault(unsolved)
    assert "not solved: no match" in unsolved.summary


@pytest.mark.slow
def test_frames_of_two_cameras_and_clouds_are_notes_of_a_night():
    lights = [light_of(k) for k in range(3)]
    covered = light_of(3)
    covered[:, SIZE // 2 :] *= 0.03
    levels = (150.0, 400.0, 900.0, 300.0)
    images = [frame(light, k, level) for k, (light, level) in enumerate(zip([*lights, covered], levels, strict=True))]
    images.append(frame(light_of(5, focal_px=2950.0), 9))
    frames = [NightFrame(name=f"f{k}", image=image) for k, image in enumerate(images)]
    config = TwinConfig(camera={"field_deg": round(FIELD_DEG, 1)}, orders=("pinhole",))
    pytest.importorskip("tetra3rs")
    night, _ = measure_night(frames, config, Progress())
    notes = "\n".join(night.notes)
    assert "f4: frames of two cameras: solved with 29" in notes
    assert "f3: clouds or an obstacle over about" in notes
    assert len(night.rows) == 4


def test_a_pitch_that_the_stars_contradict_is_stated():
    notes = []
    config = TwinConfig(camera={"pixel_pitch_um": 3.45, "focal_length_mm": 35.3})
    assert stated_pitch_mm(config, 5117.0, notes) == pytest.approx(3.45e-3)
    assert "pitch of 6.9 um, pixel_pitch_um = 3.45 is stated (binning?)" in notes[0]
    focal = TwinConfig(camera={"focal_length_mm": 35.3})
    assert stated_pitch_mm(focal, 5117.0, []) == pytest.approx(6.9e-3, rel=1e-3)


def test_nothing_but_trails_is_refused_in_a_sentence():
    frames = [NightFrame(name="a", image=frame(light_of(2, trail_px=30.0)))]
    pytest.importorskip("tetra3rs")
    with pytest.raises(DomainError, match="trailed: stars are"):
        measure_night(frames, TwinConfig(camera={"field_deg": round(FIELD_DEG, 1)}), Progress())


EXTINCTION, SMALL_PX, SHORT_PX = 0.3, 448, 1150.0


def wide_frame(number, when, altitude_deg):
    """A short camera at a site, 22 deg wide: refraction, extinction, the sky of that night as seen from the Earth."""
    stars = sky(8.5, epoch_year=2019.57, observer="earth")
    zenith = zenith_directions(52.0, 4.4, [when])[0]
    v = refracted(np.array(stars.direction), zenith, 58.3)
    side = np.cross(zenith, [0.3, 1.0, 0.2 + number])
    altitude = np.radians(altitude_deg)
    boresight = np.sin(altitude) * zenith + np.cos(altitude) * side / np.linalg.norm(side)
    across = np.cross(boresight, zenith + 0.1)
    across /= np.linalg.norm(across)
    turned = v @ np.stack([across, np.cross(boresight, across), boresight], axis=1)
    magnitude = np.array(stars.magnitude) + EXTINCTION * airmass(v, zenith)
    light = pixels_of(turned, 6e3 * 10.0 ** (-0.4 * (magnitude - 5.0)), SMALL_PX, SHORT_PX, sigma_px=0.65)
    dn = np.random.default_rng(number).poisson(light + 300.0 * 1.8**number)
    return np.minimum(dn, 20000).astype(np.uint16)


def test_twin_of_a_folder(tmp_path):
    """Four frames of 1 e-/DN with times and a site: the whole sequence, and files that can be read."""
    pytest.importorskip("tetra3rs")
    for number, altitude in enumerate((75.0, 60.0, 45.0, 40.0)):
        when = datetime(2019, 7, 29, 20, 47, number, tzinfo=UTC)
        np.save(tmp_path / f"{when:%Y-%m-%dT%H%M%S}.npy", wide_frame(number, when, altitude))
    settings = {
        "frames": str(tmp_path),
        "camera.field_deg": 22.0,
        "camera.pixel_pitch_um": 5.0,
        "camera.black_level_dn": 0.0,
        "site.latitude_deg": 52.0,
        "site.longitude_deg": 4.4,
        "orders": ["pinhole"],
        "realisations": 2,
    }
    run = run_experiment(experiment, settings)
    numbers = run.result["camera"]
    assert numbers.order == "pinhole"
    for measured, true in (
        (numbers.gain_e_per_dn, 1.0),
        (numbers.extinction_mag, EXTINCTION),
        (numbers.zero_point_mag, 5.0 + 2.5 * np.log10(6e3)),
        (numbers.focal_length_px, SHORT_PX),
    ):
        assert abs(measured.value - true) < 4.0 * measured.uncertainty
    assert numbers.latitude_deg.value == 52.0
    assert [criterion.name for criterion in run.criteria if criterion.failed] == []
    assert len(run.result["frames"]) == 4
    files(run.result, tmp_path)
    sensor = load_star_sensor(tmp_path / "sensor.toml")
    assert sensor.focal_length_mm == pytest.approx(SHORT_PX * 5e-3, rel=1e-3)
    assert sensor.detector.gain_dn_per_e == pytest.approx(1.0 / numbers.gain_e_per_dn.value)
    compared = tomllib.loads((tmp_path / "sensor.toml").read_text())["compared"]
    assert compared[0].startswith("stars in all frames, 5 sigma: real ")
    assert pictures(run.outcome, 0, half_px=20).axes[1].get_title() == "twin"
