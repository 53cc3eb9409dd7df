"""The distortion test from the command line to its report: a marking error that is known gives its own figures."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.distortion.criteria import wide_criteria
from experiments.distortion.settings import Config
from experiments.distortion.wide_field import wide_field
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.laboratory.distortion_statistics import distortion_statistics
from render.engine.random import Streams
from render.sensor import StarSensor

pytestmark = pytest.mark.slow  # a whole run

ROWS, COLUMNS, ORDER, SURVEYS, MARKING_ARCSEC = 4, 5, 2, 100, 2.0


@pytest.fixture(scope="module")
def run(tiny_run):
    """Middle of the field, where the lens has next to no distortion, and a target that is badly surveyed."""
    target = {"target__rows": ROWS, "target__columns": COLUMNS, "target__edge_px": 40}
    study = {"study__rows": [ROWS], "study__orders": [ORDER], "map_rows": 5, "order": ORDER}
    numbers = {"frames": 10, "dark_frames": 40, "surveys": SURVEYS, "draws": 40}
    return tiny_run(
        "distortion", **target, **study, **numbers, compare=["cog"], target__marking_error_arcsec=MARKING_ARCSEC
    )


def test_the_run_is_complete(run):
    assert run.status == 0
    assert (run.folder / "report.html").stat().st_size > 50_000
    names = {
        "wide_field.ecsv",
        "distortion.ecsv",
        "centroiders.ecsv",
        "map.ecsv",
        "forecasts.ecsv",
        "points.ecsv",
        "results.nc",
    }
    assert names < {path.name for path in run.folder.iterdir()}


def test_a_polynomial_divides_marking_error_by_its_degrees_of_freedom(run):
    """Of W points with error s, k terms leave s sqrt((W - k) / (W - 1)) and take s sqrt((k - 1) / (W - 1))."""
    points, terms = ROWS * COLUMNS, (ORDER + 1) * (ORDER + 2) // 2
    error = 3.0 * MARKING_ARCSEC
    numbers = run.results["methods_arcsec_3sigma"]["epsf"]["nominal"]
    for name, freedom in (("sigma_left", points - terms), ("sigma_c1", terms - 1)):
        expected = error * np.sqrt(freedom / (points - 1))
        limit = 4.0 / np.sqrt(2.0 * freedom * SURVEYS) + 0.02  # of an RMS; 2 %: the lens, noise of the frames
        for axis in "xy":
            assert numbers[name]["over_surveys"][axis] == pytest.approx(expected, rel=limit)
    assert run.results["sigma_c1_of_marking_error_alone_arcsec_3sigma"] == pytest.approx(
        error * np.sqrt((terms - 1) / (points - 1)), rel=1e-12
    )


@pytest.mark.parametrize("axis", [0, 1])
def test_a_shifted_centroid_is_noticed(run, failing, axis):
    measured = run.result.measured
    moved = measured.session_px["cog"] + 0.3 * np.eye(2)[axis]
    result = replace(run.result, measured=replace(measured, session_px={**measured.session_px, "cog": moved}))
    names = failing("distortion", result)
    assert [name for name in names if name.startswith("cog: centroid minus noiseless light")]


def test_a_wrong_angle_of_a_pixel_is_noticed(run, failing, monkeypatch):
    right = run.result.instrument.pixel_arcsec
    monkeypatch.setattr(StarSensor, "pixel_arcsec", property(lambda self: 1.01 * right))
    assert "angle of a pixel over that of two traced bundles beside the axis" in failing("distortion", run.result)


def changed(**fields):
    """Another result of eq. 21-30: fields of the right one, changed."""

    def wrong(place, d_px, order):
        right = distortion_statistics(place, d_px, order)
        return replace(right, **{name: change(right) for name, change in fields.items()})

    return wrong


def lower(place, d_px, order):
    return distortion_statistics(place, d_px, order - 1)


def divided_by_w(place, d_px, order):
    factor = np.sqrt((len(place) - 1) / len(place))
    right = distortion_statistics(place, d_px, order)
    numbers = ("sigma_d_px", "sigma_left_px", "sigma_c1_px")
    return replace(right, **{name: factor * getattr(right, name) for name in numbers})


@pytest.mark.parametrize(
    ("mutant", "noticed"),
    [
        pytest.param(changed(sigma_c1_px=lambda s: s.sigma_left_px), "target bent", id="C1: what is left"),
        pytest.param(changed(sigma_c1_px=lambda s: s.sigma_d_px - s.sigma_left_px), "target bent", id="linear"),
        pytest.param(changed(sigma_d_px=lambda s: s.sigma_d_px[::-1]), "target bent", id="x and y exchanged"),
        pytest.param(changed(sigma_d_px=lambda s: np.sqrt((s.d_px**2).mean(0))), "printed equation", id="RMS"),
        pytest.param(lower, "target bent", id="an order too low"),
        pytest.param(divided_by_w, "printed equation", id="divisor W for W - 1"),
    ],
)
def test_a_wrong_equation_is_noticed(run, broken, failing, mutant, noticed):
    broken(distortion_statistics, mutant)
    assert [name for name in failing("distortion", run.result) if noticed in name]


@pytest.fixture(scope="module")
def wide(engine):
    """The wide field of a small run."""
    config = load_config(
        Config, settings=["frames=8", "dark_frames=30", "draws=20", "compare=[]", "wide.instrument.diffraction=rays"]
    )
    return wide_field(config, Streams(3), progress=Progress())


def _failing(wide):
    outcome = SimpleNamespace(result=SimpleNamespace(wide=wide))
    return [criterion.name for criterion in wide_criteria(outcome) if not criterion.passed]


@pytest.mark.parametrize(("factor", "fails"), [(1.0, 0), (1.05, 2), (0.98, 2), (-1.0, 1)])
def test_a_wrong_distortion_in_the_frames_is_noticed(wide, factor, fails):
    """Rationale: frames of another lens. Expected: its distortion times 1.05, 0.98 or -1 fails; its own does not."""
    middle = wide.measured.instrument.camera.centre_px
    place = wide.measured.light.nominal_px - middle
    design = np.zeros((*place.shape, 5))  # shift, scale, roll, cubic
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[..., 2], design[..., 3] = place, np.column_stack([-place[:, 1], place[:, 0]])
    design[..., 4] = place * (place**2).sum(1)[:, None] * 1e-6
    offset = (wide.measured.light.photon_px - wide.measured.light.nominal_px).reshape(-1)
    cubic = np.linalg.lstsq(design.reshape(-1, 5), offset, rcond=None)[0][4] * design[..., 4]
    moved = {m: v + (factor - 1.0) * cubic for m, v in wide.measured.session_px.items()}
    broken = replace(wide, measured=replace(wide.measured, session_px=moved))
    assert len(_failing(broken)) >= fails
    assert bool(_failing(broken)) is (fails > 0)
