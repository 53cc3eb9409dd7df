"""What frames are compared with, on drawn errors; what the page says of the optics, on plain arrays."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import c, h, k

from experiments.camera.comparison import compare
from experiments.camera.settings import Config
from experiments.harness.range import with_value
from experiments.laboratory.sensor_prediction import optical_state, predict_camera
from optics.rays.spots import trace_spots
from render.field_response import COLD_K, HOT_K

READOUTS, STARS, FRAMES, DRAWS = 3, 24, 20, 200


@pytest.fixture(scope="module")
def tracker():
    chip = {"lens": "star_tracker_26mm", "detector": "cmv4000", "width_px": 1862, "height_px": 1862, "defocus_mm": 0.03}
    return predict_camera(
        Config(
            instrument={**chip, "diffraction": "rays"},
            passband={"range_nm": [500.0, 800.0]},
            sky={"attitudes": FRAMES},
        )
    )


def drawn(prediction, rng, worse=1.0, fainter_mag=0.0):
    """Frames as they come out if the prediction is right, or noise ``worse``, or stars ``fainter_mag`` fainter."""
    star, forecast = prediction.stars, prediction.attitude
    radius = np.tile(np.linspace(20.0, 1200.0, STARS), 2)
    limit, bright_mag = prediction.value("limiting_magnitude_mag"), 5.0
    magnitude = np.r_[np.full(STARS, bright_mag), limit + np.linspace(-0.6, 0.6, STARS)]
    electrons = prediction.electrons(magnitude, prediction.config.star.temperature_k, radius)
    sigma = star.sigma_at(star.centroid.noise_px, electrons[:STARS], radius[:STARS])  # along both axes alike
    error = np.full((READOUTS, 2 * STARS, 2), np.nan)
    error[:, :STARS] = worse * sigma[:, None] * rng.standard_normal((READOUTS, STARS, 2))
    share = star.detected_at(electrons * 10.0 ** (-0.4 * fainter_mag), radius)
    alarms = rng.poisson(prediction.value("false_alarms_per_frame"), READOUTS + FRAMES)
    chart = SimpleNamespace(
        magnitude=magnitude,
        bright_mag=bright_mag,
        electrons=electrons,
        radius_px=radius,
        error_px=error,
        found=rng.random((READOUTS, 2 * STARS)) < share,
        false_alarms=alarms[:READOUTS],
    )
    sky = SimpleNamespace(
        error_arcsec=worse * forecast.total_arcsec * rng.standard_normal(forecast.total_arcsec.shape),
        found=forecast.found,
        fit=forecast.stars,
        false_alarms=alarms[READOUTS:],
    )
    rendered = SimpleNamespace(chart=chart, sky=sky, moving=None)
    return {one.comparison: one for one in compare(prediction, rendered)}


@pytest.fixture(scope="module")
def pulls(tracker):
    rng = np.random.default_rng(7)
    runs = [drawn(tracker, rng) for _ in range(DRAWS)]
    return {name: np.array([run[name].pull.value for run in runs]) for name in runs[0]}


@pytest.mark.parametrize(
    ("name", "least"),
    # the stated errors of NEA and limit count the prediction's own, those of stars one star and so many per cent more
    [("nea", 0.6), ("limiting_magnitude", 0.6), ("attitude_cross", 0.9), ("attitude_roll", 0.9)],
)
def test_right_frames_scatter_as_the_stated_errors(pulls, name, least):
    pull = pulls[name]
    assert abs(pull.mean()) < 0.3
    assert least < np.sqrt((pull**2).mean()) < 1.12


def test_counts_of_detections_scatter_less_than_stated(pulls):
    """Drawn alarms are new in every frame; the stated error counts dark frames that repeat."""
    assert 0.0 < np.sqrt((pulls["false_alarms"] ** 2).mean()) < 1.1
    assert np.abs(pulls["stars"]).max() < 1e-9


def test_sizes_of_samples_and_errors_by_hand(tracker):
    found = drawn(tracker, np.random.default_rng(1))
    assert found["nea"].n == 2 * STARS * (READOUTS - 1)
    assert found["attitude_cross"].n == 2 * FRAMES
    assert found["attitude_roll"].n == FRAMES
    assert found["electrons"].pull.value == pytest.approx(0.0, abs=1e-6)
    sampling = found["nea"].predicted / np.sqrt(2.0 * found["nea"].n)
    assert sampling < found["nea"].error < 1.6 * sampling
    mag = found["limiting_magnitude"]
    assert mag.whole == pytest.approx(1.0857 / mag.error, rel=1e-3)  # 2.5 / ln 10: an error of 1 in the light


def test_wrong_frames_show(tracker):
    rng = np.random.default_rng(3)
    many = [drawn(tracker, rng, worse=1.3, fainter_mag=0.4) for _ in range(20)]
    ratio = {name: np.mean([one[name].measured / one[name].predicted for one in many]) for name in ("nea",)}
    assert ratio["nea"] == pytest.approx(1.3, rel=0.03)
    for name in ("attitude_cross", "attitude_roll"):
        square = np.mean([(one[name].measured / one[name].predicted) ** 2 for one in many])
        assert square == pytest.approx(1.69, rel=0.25)
    shift = np.mean([one["limiting_magnitude"].measured - one["limiting_magnitude"].predicted for one in many])
    assert shift == pytest.approx(-0.4, abs=0.05)


def planck(wavelength_nm, kelvin):
    """Photons, up to a factor."""
    metre = np.asarray(wavelength_nm) * 1e-9
    return metre**-4 / np.expm1(h * c / (metre * k * kelvin))


def test_optics_of_the_page_by_other_sums(tracker):
    """Vignetting, colour of stars and lateral colour, from the rays, black bodies of SciPy's constants."""
    state, pitch = tracker.state, 0.0055
    wave, lens = state.light.wavelength_nm[0], state.sensor.camera.focused_lens
    field = np.degrees(np.arctan(state.radius_px * pitch / state.sensor.focal_length_mm))
    spots = trace_spots(lens, field, np.zeros_like(field), wave, order=(32, 64))
    area, x = spots.area_mm2.sum(-1), (spots.area_mm2 * spots.rays.x).sum(-1) / spots.area_mm2.sum(-1)

    def light(kelvin):
        return planck(wave, kelvin) / planck(wave, 5800.0) * state.fraction  # nodes hold band, response and step

    def place(kelvin):
        weight = light(kelvin) * area
        return (weight * x).sum(1) / weight.sum(1)

    white = (area * state.fraction).sum(1) * np.cos(np.radians(field))  # cross-section of the beam, not of the stop
    lost = 100.0 * (1.0 - (white / white[0]).min())
    assert tracker.value("vignetting_percent") == pytest.approx(lost, rel=2e-3)
    assert tracker.value("vignetting_percent") > 3.0
    kelvin = state.temperatures_k
    cold, hot = (kelvin[np.abs(np.log(kelvin / t)).argmin()] for t in (COLD_K, HOT_K))
    moved = np.abs(place(hot) - place(cold)).max() / pitch
    assert tracker.value("star_colour_px") == pytest.approx(moved, rel=0.05)
    assert tracker.value("lateral_colour_px") == pytest.approx(np.ptp(x, axis=1).max() / pitch, rel=1e-3)
    left = (
        spots.rays.x
        - ((area * state.fraction)[..., None] * spots.rays.x * spots.area_mm2 / area[..., None]).sum(
            (1, 2), keepdims=True
        )
        / (area * state.fraction).sum(1)[:, None, None]
    )
    right = spots.rays.y
    square = ((left**2 + right**2) * spots.area_mm2 * state.fraction[:, None]).sum((1, 2)) / (
        area * state.fraction
    ).sum(1)
    assert tracker.value("spot_um") == pytest.approx(1e3 * np.sqrt(square.max()), rel=1e-3)


@pytest.mark.slow
def test_width_of_a_trail_by_hand(tracker):
    """A uniform trail of length L adds L²/12 along it: L²/24 to the mean of both axes."""
    slewing = with_value(tracker.config, "slew.rate_deg_per_s", 0.2)
    state, rest = optical_state(slewing), tracker.state
    length_px = np.radians(0.2 * slewing.instrument.exposure_s) * state.sensor.focal_length_mm / 0.0055
    assert np.hypot(*state.trail_px) == pytest.approx(length_px, rel=5e-3)
    assert length_px > 1.0
    grown = (state.fwhm_px**2 - rest.fwhm_px**2) / 2.3548**2
    assert grown == pytest.approx(length_px**2 / 24.0, rel=0.01)
