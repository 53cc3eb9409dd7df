"""Parts of the budget that need no frames: overrides, attitude, sweeps."""

import numpy as np
import pytest

from calib.accuracy import attitude_from_stars
from calib.accuracy.attitude_from_stars import DirectionErrors
from experiments.budget import attitude as attitude_module
from experiments.budget.attitude import attitude_study
from experiments.budget.laboratory import build_laboratory, half_field, perturbed_lens
from experiments.budget.settings import AttitudeConfig, BudgetConfig, MovedConfig
from experiments.harness.config import load_config
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.run import configuration_file
from experiments.harness.sections import described, judged
from experiments.laboratory.settings.published import ACC18_TABLE1_PX
from optics.lens_file import load_lens
from optics.rays.paraxial import axial_paraxial
from render.detector.spec import load_detector
from render.engine.random import Streams
from render.sensor_file.detector import DetectorConfig, overridden


def test_the_chromatic_term_in_x_is_a_slip_and_in_y_is_not():
    """Largest entry of Table 1, a third, 3 sigma, times the 5.5 arcsec of a pixel; its axes are exchanged."""
    y, x = (5.5 * np.abs(column).max() for column in np.transpose(list(ACC18_TABLE1_PX.values())))
    assert y == pytest.approx(0.66)  # printed, 0.12 px
    assert x == pytest.approx(0.0385)  # printed 0.03: 5e-3 px x 5.5" = 0.0275


def test_override_reaches_camera_and_readout():
    lab = build_laboratory(
        load_config(BudgetConfig, settings=["detector.diffusion_sigma_um=2.75", "detector.prnu=0.02"])
    )
    assert lab.instrument.camera.charge_diffusion_px == pytest.approx(0.5)
    detector = load_detector("acc18_mosaic")
    assert (lab.instrument.detector.prnu, lab.instrument.detector.read_noise_e) == (0.02, detector.read_noise_e)
    assert overridden(detector, DetectorConfig()) is detector


def test_moved_element_shifts_the_image_as_its_power_says(star_camera):
    """A decentre towards increasing row moves the image along the row axis only, the same way from both sides."""
    from optics.rays.chief_ray import chief_ray_points

    lens = load_lens("star_camera_206mm")
    assert perturbed_lens(lens, MovedConfig()) is lens
    images = []
    for decentre in (50.0, -50.0):
        moved = perturbed_lens(lens, MovedConfig(element="L2", decentre_y_um=decentre))
        x, y = chief_ray_points(moved, np.zeros(1), np.zeros(1), np.array([600.0]))
        images.append(star_camera.camera.to_pixel(x, y))
    centre = star_camera.camera.centre_px
    (up_x, up_y), (_, down_y) = images
    assert float(up_x[0]) == pytest.approx(centre[0], abs=1e-6)
    assert float(up_y[0] - centre[1]) == pytest.approx(-float(down_y[0] - centre[1]), rel=1e-3)
    assert abs(float(up_y[0] - centre[1])) > 1.0
    assert axial_paraxial(lens, 600.0).efl_mm > 0


def test_named_configuration_changes_the_instrument_alone():
    """Nothing of the laboratory or of its tests is tuned."""
    tuned = load_config(BudgetConfig, file=configuration_file("acc18_tuned"))
    changed = tuned.model_dump(exclude_defaults=True)
    assert changed.keys() == {"source", "instrument", "moved", "centroid", "published_within_fraction"}
    assert (changed["source"].keys(), changed["instrument"].keys()) == ({"signal_e"}, {"defocus_mm"})
    assert configuration_file("nothing_of_that_name") == "nothing_of_that_name"
    assert configuration_file(None) is None


@pytest.mark.parametrize("power", [0.5, 1.0])
def test_verdict_notices_another_power_of_the_number_of_stars(star_camera, monkeypatch, power):
    """Rationale: attitudes are solved, the rule has no part in them. Expected: it holds for sqrt(N), not for N."""
    monkeypatch.setattr(attitude_from_stars, "over_stars", lambda total, stars: total / stars**power)
    settings = AttitudeConfig(stars=4, counts=(2,), trials=500)
    parts = zip(("random", "chromatic", "distortion"), (1.2, 0.3, 0.5), strict=True)
    errors = DirectionErrors(**{f"{name}_arcsec": np.full(2, size) for name, size in parts})
    studies = [attitude_study(half_field(star_camera), errors, settings, Streams(6)) for _ in range(2)]
    np.testing.assert_array_equal(*(study["attitude_curve"][0].error_arcsec for study in studies))
    section, result = {"attitude": attitude_module.SECTIONS["attitude"]}, studies[0]
    quantities = described({**section}, Quantities(), {"attitude": result["attitude"]})
    (criterion,) = judged(section, Outcome(config=None, result=result, data=quantities.dataset))
    assert criterion.passed is (power == 0.5)
