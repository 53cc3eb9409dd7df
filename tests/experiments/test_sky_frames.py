"""Same configuration and seed, same bytes: digests of frames of the sky and of their truth, for one processor."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from experiments.dataset import frame as dataset_frame
from experiments.dataset import scene as dataset_scene
from experiments.dataset.labels import FrameLabeller
from experiments.dataset.settings import DatasetConfig
from experiments.flight.frames import FlightCamera
from experiments.flight.prediction import build_budget
from experiments.flight.scenario import build_flight
from experiments.flight.settings import FlightConfig
from experiments.harness.progress import Progress
from experiments.skycal import experiment as skycal
from experiments.skycal.settings import SkycalConfig
from optics.rays.paraxial import axial_paraxial

DETECTORS = Path(__file__).parents[2] / "render" / "data" / "detectors"
SMALL = {"lens": "star_tracker_26mm", "exposure_s": 0.2, "defocus_mm": 0.0, "diffraction": "rays"}
SCAN = {  # with jitter, rolling shutter, lag, cosmic rays, Moon and planets, and a uniform sky
    "frames": 3, "seed": 7, "nodes": 3,
    "catalogue": {"faintest_mag": 10.0, "epoch_year": 2025.3, "observer": "earth"},
    "jitter": {
        "frequency_hz": [0.5, 5.0], "psd_x_arcsec2_per_hz": [500.0, 500.0], "psd_y_arcsec2_per_hz": [500.0, 500.0],
    },
    "background": {"moon_planets": True, "uniform_mag_per_arcsec2": 18.0, "extra_e_per_s": 20.0},
    "radiation": {"environment": "solar_flare"},
    "files": {"layers": True},
}  # fmt: skip
TRUTH = ("star_id", "photon_x_px", "photon_y_px", "electrons", "electrons_hidden", "snr", "smear_x_px", "flags")


def digest(*arrays):
    """Of bytes; real numbers to 1e-6, so that the last bits of a processor's functions do not count."""
    sha = hashlib.sha256()
    for array in map(np.asarray, arrays):
        values = np.round(array.astype(float), 6) + 0.0 if array.dtype.kind == "f" else array
        sha.update(np.ascontiguousarray(values).tobytes())
    return sha.hexdigest()[:16]


JUPITER = (36, 3), ("918e33e892a89dca", "533456924ec1e9b0", "743eb85ae618f8f7")  # a point of light
MOON = (43, 3), ("9807921f01fbc624", "ac4a4967ae4bef4c", "2113dbad5aca4d28")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("direction_deg", "count", "digests"), [((78.0, 22.7), *JUPITER), ((293.3, -26.9), *MOON)], ids=["jupiter", "moon"]
)
def test_a_dataset_with_everything(engine, tmp_path, direction_deg, count, digests):
    head, tables = (DETECTORS / "cmv4000.toml").read_text(encoding="utf-8").split("\n[", 1)
    (tmp_path / "lags.toml").write_text(f"{head}\nlag = 0.1\n\n[{tables}", encoding="utf-8")
    chip = {"detector": str(tmp_path / "lags.toml"), "width_px": 128, "height_px": 96, "line_time_us": 10.0}
    turn = {"kind": "scan", "rate_deg_per_s": [0.0, 0.05, 0.02], "frame_rate_hz": 10.0}
    pointing = turn | dict(zip(("ra_deg", "dec_deg"), direction_deg, strict=True))
    scene = dataset_scene.build_scene(DatasetConfig(**SCAN, pointing=pointing, instrument=SMALL | chip))
    calibrated = dataset_frame.FrameRenderer(scene).render(1)
    assert "cosmic_ray" in {label.kind for label in FrameLabeller(scene).labels(1)}
    assert (len(calibrated.truth["star_id"]), np.count_nonzero(calibrated.cosmic_rays)) == count
    assert set(calibrated.layers) == {"stars", "sky", "bodies", "dark"}
    assert digest(calibrated.frame.dn) == digests[0]
    assert digest(*(calibrated.truth[name] for name in TRUTH)) == digests[1]
    assert digest(*calibrated.layers.values()) == digests[2]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("state_k", "image", "numbers"),
    [
        ((0, 0, 0, 0, 0), "239a8e17869ef6ee", "97d9080921381dd9"),
        ((4, 1, 0.5, 0, 0), "d4fdc78af8f94306", "79af3aafeb08c508"),
    ],
)
def test_a_flight_with_a_lens_at_its_temperatures(engine, state_k, image, numbers):
    chip = {"detector": "cmv4000", "width_px": 256, "height_px": 256}
    config = FlightConfig(
        instrument=SMALL | chip, passband={"range_nm": [500.0, 800.0]}, frames={"cosmic_rays": "solar_flare"}
    )
    camera = FlightCamera(build_budget(config, build_flight(config)))
    expected = camera.expected(1000.0, np.array(state_k, float))
    assert digest(expected.electrons) == image
    assert digest(camera.read(expected, 1000.0, 5, "first").dn) == numbers


def test_a_calibration_on_the_sky(engine):
    """Rendered, measured, matched, calibrated: every match is right, the focal length that of the prescription."""
    wide = SkycalConfig().wide
    window = wide.instrument.model_copy(update=SMALL | {"width_px": 768, "height_px": 768})
    settings = {"faintest_mag": 6.5, "instrument": window, "psf_spacing_px": 1000.0, "models": ("brown_conrady",)}
    config = SkycalConfig(
        frames=4, which="wide", wide=wide.model_copy(update=settings), centroid="gaussian", dark_frames=2, map_points=9,
        sky={"nodes": 4},
    )  # fmt: skip
    (camera,) = skycal.run(config, progress=Progress())["cameras"]
    assert (camera.stars, camera.wrong_matches, camera.frames_matched, camera.not_converged) == (106, 0, 4, 0)
    lens, calibrated = camera.calibrated.scene.instrument.camera.lens, camera.calibrated.of("corrected").calibration
    focal_mm = axial_paraxial(lens, lens.design_wavelength_nm).efl_mm  # started 22 % off
    assert calibrated.model.value("focal_length_mm") == pytest.approx(focal_mm, rel=2e-3)
    frames = camera.calibrated.recording.frames
    found = [
        camera.calibrated.recording.example.dn,
        np.concatenate([frame.photon_px for frame in frames]),
        np.concatenate([frame.detections.x_px for frame in frames]),
    ]
    assert [digest(one) for one in found] == ["349934abcf61481e", "34b227f67b3b4257", "ec433a766ea82dd6"]
