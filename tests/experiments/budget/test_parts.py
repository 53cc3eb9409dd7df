"""Parts of the budget that need no frames: sums, overrides, attitude, cubic basis."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.accuracy import error_budget as combine_module
from calib.accuracy.error_budget import TERMS, ErrorTerm, combine
from experiments.budget import attitude as attitude_module
from experiments.budget.attitude import READINGS, DirectionErrors, attitude_study, solved_attitude
from experiments.budget.experiment import chief
from experiments.budget.laboratory import build_laboratory, moved_lens
from experiments.budget.settings import AttitudeConfig, Config, MovedConfig
from experiments.budget.thermal import cubic_basis
from experiments.harness.config import load_config
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.run import configuration_file
from experiments.harness.sections import described, judged
from experiments.laboratory.settings.published import ACC18_TABLE1_PX
from optics.errors import ConfigError
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


def test_detector_overrides():
    detector = load_detector("acc18_mosaic")
    changed = overridden(detector, DetectorConfig(read_noise_e=5.0, diffusion_sigma_um=2.0))
    assert (changed.read_noise_e, changed.diffusion_sigma_mm) == (5.0, pytest.approx(2e-3))
    assert changed.prnu == detector.prnu
    assert overridden(detector, DetectorConfig()) is detector


def test_override_reaches_camera_and_readout():
    lab = build_laboratory(load_config(Config, settings=["detector.diffusion_sigma_um=2.75", "detector.prnu=0.02"]))
    assert lab.instrument.camera.charge_diffusion_px == pytest.approx(0.5)
    assert lab.instrument.detector.prnu == 0.02


def test_moved_element_shifts_the_image_as_its_power_says(star_camera):
    """A decentre towards increasing row moves the image along the row axis only, the same way from both sides."""
    from optics.rays.chief import chief_ray_points

    lens = load_lens("star_camera_206mm")
    assert moved_lens(lens, MovedConfig()) is lens
    places = []
    for decentre in (50.0, -50.0):
        moved = moved_lens(lens, MovedConfig(element="L2", decentre_y_um=decentre))
        x, y = chief_ray_points(moved, np.zeros(1), np.zeros(1), np.array([600.0]))
        places.append(star_camera.camera.to_pixel(x, y))
    middle = star_camera.camera.centre_px
    (up_x, up_y), (_, down_y) = places
    assert float(up_x[0]) == pytest.approx(middle[0], abs=1e-6)
    assert float(up_y[0] - middle[1]) == pytest.approx(-float(down_y[0] - middle[1]), rel=1e-3)
    assert abs(float(up_y[0] - middle[1])) > 1.0
    assert axial_paraxial(lens, 600.0).efl_mm > 0
    with pytest.raises(ConfigError, match="L2"):
        moved_lens(lens, MovedConfig(element="L22"))


def test_named_configuration_changes_the_instrument_alone():
    """Nothing of the laboratory or of its tests is tuned."""
    tuned = load_config(Config, file=configuration_file("acc18_tuned"))
    changed = tuned.model_dump(exclude_defaults=True)
    assert changed.keys() == {"source", "instrument", "moved", "centroid", "published_within_fraction"}
    assert (changed["source"].keys(), changed["instrument"].keys()) == ({"signal_e"}, {"defocus_mm"})
    assert configuration_file("nothing_of_that_name") == "nothing_of_that_name"
    assert configuration_file(None) is None


def _errors(random, chromatic, distortion):
    return DirectionErrors(
        random_arcsec=np.full(2, random),
        chromatic_arcsec=np.full(2, chromatic),
        distortion_arcsec=np.full(2, distortion),
    )


def _study(camera, errors, seed, **settings):
    """Errors (c, reading, component), rule and stated errors (c, component), relative uncertainty."""
    study = attitude_study(camera, errors, AttitudeConfig(**settings), Streams(seed))
    assert study["attitude"].failed == 0
    every = (
        np.array([getattr(n, f"{name}arcsec") for n in study["attitude_curve"]]) for name in ("", "rule_", "stated_")
    )
    return *every, study["attitude"].relative_uncertainty


def test_attitude_of_independent_errors_is_what_the_estimator_states(star_camera):
    settings = {"stars": 10, "counts": (10, 40), "trials": 600}
    error, rule, stated, part = _study(star_camera, _errors(1.5, 0.0, 0.0), 3, **settings)
    np.testing.assert_allclose(error[:, 0], stated, rtol=5 * part)
    # many stars all over the field: the rule holds for every axis, roll included
    np.testing.assert_allclose(error[1, 0], rule[1], rtol=0.05 + 4 * part)


def test_unequal_errors_on_an_oblong_detector_by_hand():
    """Half width 1/20, half height 1/50 of the focal length; 3 and 1 arcsec; 60 stars, whose second moments are known.

    Stars apart along y turn the field by their errors along x, and the other way round.
    """
    camera = SimpleNamespace(width_px=2000, height_px=800, pixel_pitch_mm=0.005)
    instrument, none = SimpleNamespace(camera=camera, focal_length_mm=100.0), np.zeros(2)
    errors = DirectionErrors(random_arcsec=np.array([3.0, 1.0]), chromatic_arcsec=none, distortion_arcsec=none)
    xx, yy = 0.05**2 / 3.0, 0.02**2 / 3.0
    expected = np.array([3.0, 1.0, np.sqrt(9.0 * yy + 1.0 * xx) / (xx + yy)]) / np.sqrt(60.0)
    settings = AttitudeConfig(stars=60, counts=(60,), trials=300)
    study = attitude_study(instrument, errors, settings, Streams(8))
    part = 1.0 / np.sqrt(600.0)
    np.testing.assert_allclose(study["attitude"].rule_arcsec, expected, rtol=1e-9)
    np.testing.assert_allclose(study["attitude_curve"][0].arcsec[0], expected, rtol=0.03 + 4.0 * part)
    np.testing.assert_allclose([one.value for one in study["attitude"].over_expected], 1.0, atol=4.0 * part)


@pytest.mark.parametrize("power", [0.5, 1.0])
def test_verdict_notices_another_power_of_the_number_of_stars(star_camera, monkeypatch, power):
    """Rationale: attitudes are solved, the rule has no part in them. Expected: it holds for sqrt(N), not for N."""
    for module in (combine_module, attitude_module):
        monkeypatch.setattr(module, "over_stars", lambda total, stars: total / stars**power)
    settings, errors = AttitudeConfig(stars=4, counts=(2,), trials=500), _errors(1.2, 0.3, 0.5)
    section = {"attitude": attitude_module.SECTIONS["attitude"]}
    result = {"attitude": attitude_study(star_camera, errors, settings, Streams(6))["attitude"]}
    quantities = described({**section}, Quantities(), result)
    (criterion,) = judged(section, Outcome(config=None, result=result, data=quantities.dataset))
    assert criterion.passed is (power == 0.5)
    terms = {name: ErrorTerm(arcsec=np.ones(2)) for name in TERMS}
    made = combine(terms, stars=4)
    np.testing.assert_allclose(made.attitude.arcsec, made.total.arcsec / 4**power)


def test_attitude_of_a_measured_budget_is_solved(star_camera):
    """Ten stars evenly all over the field: the rule, but for the roll that stars beside the middle bring in."""
    made = combine({name: ErrorTerm(arcsec=np.ones(2)) for name in TERMS}, stars=10)
    solved = solved_attitude(star_camera, made, AttitudeConfig(stars=10, trials=1000), Streams(7))
    ratio = solved.arcsec / (made.total.arcsec / np.sqrt(10.0))
    np.testing.assert_allclose(ratio, 1.03, atol=0.04 + 4.0 / np.sqrt(2000.0))


def test_common_error_does_not_average(star_camera):
    error, rule, _, part = _study(star_camera, _errors(0.0, 0.9, 0.0), 4, stars=10, counts=(10, 40), trials=300)
    common = error[:, list(READINGS).index("common")]
    np.testing.assert_allclose(common[:, :2], 0.9, rtol=6 * part)
    assert np.all(common[:, 2] < 0.1 * rule[:, 2])  # a common shift turns, but does not roll


def test_attitude_depends_on_seed_alone(star_camera):
    one, two = (_study(star_camera, _errors(1.0, 0.2, 0.3), 5, stars=5, counts=(5,), trials=100)[0] for _ in range(2))
    assert np.array_equal(one, two)


def test_cubic_basis_takes_every_cubic_and_no_quartic():
    rng = np.random.default_rng(2)
    place = rng.uniform(-300, 4000, (60, 2))
    basis = cubic_basis(place)
    assert basis.shape == (60, 10)
    x, y = place[:, 0] / 1000, place[:, 1] / 1000
    for target, follows in ((x**3 - 2 * x * y**2 + y, True), (x**4, False)):
        left = target - basis @ np.linalg.lstsq(basis, target, rcond=None)[0]
        assert bool(np.abs(left).max() < 1e-9 * np.abs(target).max()) is follows


def test_root_mean_squares_of_both_axes_are_what_sweeps_show():
    both = {name: SimpleNamespace(arcsec=np.array([3.0, 4.0])) for name in ("total", "TE", "HSFE", "LSFE-S", "LSFE-C1")}
    assert vars_of(chief(SimpleNamespace(budget=both))) == pytest.approx([np.sqrt(12.5)] * 5)


def vars_of(record):
    return [getattr(record, name) for name in type(record).__dataclass_fields__]
