"""Lenses as built, with a linear lens of known sensitivities in place of the traced one; places and targets by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf

from experiments.budget import laboratory, tolerances
from experiments.budget.laboratory import places_px
from experiments.budget.predict import _coarse
from experiments.budget.settings import Config
from experiments.laboratory.points import nominal_px
from optics.errors import DomainError
from render.engine.random import Streams

PIXEL_ARCSEC, ELEMENTS = 5.5, 3
PLACE_PX = np.stack(np.meshgrid(np.linspace(0, 4000, 9), np.linspace(0, 2000, 7)), axis=-1).reshape(-1, 2)
SENSITIVITY = np.random.default_rng(5).normal(0.0, 0.02, (ELEMENTS, 5, 2, 2))  # of two entries along two axes
DESIGN = np.array([[0.01, -0.03], [0.02, 0.005]])
FIFTH = 1e-3 * ((PLACE_PX - [2000.0, 1000.0]) / [2000.0, 1000.0]) ** 5  # no cubic takes all of it
AMOUNTS = []


class Linear:
    """Traces amounts of movement: what a real probe reads from a lens."""

    def __init__(self, lab):
        self.grid_px = PLACE_PX

    def trace(self, amounts):
        signed = DESIGN + np.einsum("em,empa->pa", amounts, SENSITIVITY)
        AMOUNTS.append(amounts)
        from_middle = PLACE_PX - PLACE_PX.mean(0)
        turned = 1e-5 * amounts[0, 0] * np.stack([-from_middle[:, 1], from_middle[:, 0]], axis=1)
        shift = 0.3 * amounts[1, 1] * np.array([1.0, -2.0])
        return tolerances._Traced(signed, FIFTH * (1.0 + 0.1 * amounts[2, 2]) + turned + shift)


@pytest.fixture
def study(monkeypatch):
    monkeypatch.setattr(tolerances, "_Probe", Linear)
    monkeypatch.setattr(tolerances, "built", lambda lens, config, amounts: np.zeros((ELEMENTS, 5)) + amounts)
    lens = SimpleNamespace(elements=("L1", "L2", "L3"))
    monkeypatch.setattr(Linear, "trace", trace_of(Linear.trace))
    settings = SimpleNamespace(draws=400, limit_px=1e3, decentre_um=1.0, tilt_arcmin=1.0, despace_um=1.0)
    instrument = SimpleNamespace(camera=SimpleNamespace(lens=lens), pixel_arcsec=PIXEL_ARCSEC)
    lab = SimpleNamespace(config=SimpleNamespace(tolerances=settings), instrument=instrument)
    AMOUNTS.clear()
    return tolerances.tolerance_study(lab, Streams(3))


def trace_of(trace):
    """The design is traced as a lens, all others as amounts."""
    return lambda self, one: trace(self, one if isinstance(one, np.ndarray) else np.zeros((ELEMENTS, 5)))


def test_statistics_of_built_lenses_are_those_of_the_linear_lens(study):
    drawn = np.array(AMOUNTS[1:401])
    entries = PIXEL_ARCSEC * (DESIGN + np.einsum("nem,empa->npa", drawn, SENSITIVITY))
    assert study.signed_arcsec == pytest.approx(entries)
    assert study.nominal_arcsec == pytest.approx(PIXEL_ARCSEC * DESIGN)
    chromatic = np.percentile(np.abs(entries).max(axis=1), tolerances.PERCENT, axis=0)
    assert study.built_arcsec[0] == pytest.approx(chromatic)
    assert study.linear_arcsec == pytest.approx(PIXEL_ARCSEC * np.sqrt((SENSITIVITY**2).sum((0, 1))))
    assert entries.std(axis=0) == pytest.approx(study.linear_arcsec, rel=5.0 / np.sqrt(2 * 400))
    largest = np.sqrt((SENSITIVITY**2).sum(3).max(2))
    assert study.sensitivity_arcsec == pytest.approx(PIXEL_ARCSEC * largest)
    e, m = np.unravel_index(largest.argmax(), largest.shape)
    assert study.largest_cause == f"{tolerances.MOVES[m]} of L{e + 1}"
    assert study.lost == 0


def test_shift_and_roll_are_no_error_and_a_cubic_takes_its_degrees_of_freedom(study):
    """Of x^5 a cubic leaves the same in every lens, but for the scale; of what moved, shift and roll are taken."""
    drawn = np.array(AMOUNTS[1:401])
    x, y = ((PLACE_PX - [2000.0, 1000.0]) / [2000.0, 1000.0]).T
    cubic = np.array([x**i * y**j for i in range(4) for j in range(4) if i + j < 4]).T
    left = FIFTH - cubic @ np.linalg.pinv(cubic) @ FIFTH
    alone = 3.0 * PIXEL_ARCSEC * np.sqrt((left**2).sum(0) / (len(PLACE_PX) - 10))
    assert study.design_arcsec[0] == pytest.approx(PIXEL_ARCSEC * np.abs(DESIGN).max(axis=0))
    assert study.design_arcsec[1] == pytest.approx(alone)
    assert study.design_arcsec[2] == pytest.approx(np.hypot(*study.design_arcsec[:2]))
    scale = np.abs(1.0 + 0.1 * drawn[:, 2, 2])
    roll = PLACE_PX - PLACE_PX.mean(0)
    roll = np.stack([-roll[:, 1], roll[:, 0]], axis=1) / 1e3
    taken = 1e-5 * 1e3 * drawn[:, 0, 0]  # what a turn of all points by as much is, per px of roll's unit
    rest = FIFTH - (FIFTH * roll).sum() / (roll**2).sum() * roll  # x^5 has no mean
    after = 3.0 * PIXEL_ARCSEC * 0.1 * np.abs(drawn[:, 2, 2])[:, None] * np.sqrt((rest**2).mean(axis=0))
    assert taken.std() > 0.0
    assert study.built_arcsec[3] == pytest.approx(np.percentile(after, tolerances.PERCENT, axis=0), rel=1e-6)
    # roll is no cubic of each axis alone to 1e-12: it is linear, and so taken too
    assert study.built_arcsec[1] == pytest.approx(
        np.percentile(scale[:, None] * alone, tolerances.PERCENT, axis=0), rel=1e-6
    )


def test_targets_of_three_by_three_points_and_their_factor():
    """1 - 1/stars of 25 and of 9 points, the same extent to a pixel; targets that are not square stay."""
    config = Config(target={"rows": 5, "columns": 5, "pitch_px": 150.0})
    few, factor = _coarse(config)
    assert (few.target.rows, few.target.columns) == (3, 3)
    assert factor == pytest.approx(np.sqrt((1 - 1 / 25) / (1 - 1 / 9)))
    assert abs(2 * few.target.pitch_px - 4 * 150.0) < 3.0
    for rows, columns in ((4, 5), (3, 3)):
        same = Config(target={"rows": rows, "columns": columns})
        assert _coarse(same) == (same, 1.0)


def test_places_of_the_step_test_begin_in_the_middle_of_the_first_chip():
    target = SimpleNamespace(columns=5, pitch_px=150.0)
    lab = SimpleNamespace(
        instrument=SimpleNamespace(
            detector=SimpleNamespace(chip_width_px=2048, chip_height_px=1024),
            camera=SimpleNamespace(width_px=4096),
        ),
        config=SimpleNamespace(target=target, steps=SimpleNamespace(places=6)),
    )
    found = places_px(lab)
    assert found[0].tolist() == [1023.5, 511.5]
    assert found.shape == (6, 2)
    assert (np.abs(found[:, 0] - 2047.5) + 300.0 + 100.0 < 2048.0).all()  # the whole target and 100 px
    assert len({round(one % 1.0, 3) for one in found[:, 1]}) == 6


def test_places_that_a_built_lens_is_traced_at(star_camera, bench_of):
    """Corners of the target first, then a grid over the detector, in rows."""
    bench = bench_of()
    probe = tolerances._Probe(SimpleNamespace(instrument=star_camera, filtered=bench))
    place = nominal_px(star_camera, probe.stars.direction)[probe.corners.shape[0] * probe.corners.shape[1] :]
    np.testing.assert_allclose(place, probe.grid_px, atol=1e-6)
    size = np.array([star_camera.camera.width_px, star_camera.camera.height_px])
    np.testing.assert_allclose(probe.grid_px[0] + probe.grid_px[-1], size - 1)
    assert (probe.grid_px[1] - probe.grid_px[0])[1] == 0.0


@pytest.mark.parametrize("radius_px", [1.5, 3.0])
def test_points_that_saturate_are_refused(star_camera, monkeypatch, radius_px):
    """The middle pixel of a Gaussian spot, by error functions; the rule of thumb is within 15 %."""
    chip, sigma = star_camera.detector, np.hypot(radius_px / np.sqrt(2.0), star_camera.camera.blur_px)
    share = erf(0.5 / (np.sqrt(2.0) * sigma)) ** 2
    most = min(chip.full_well_e, (chip.largest_dn - chip.offset_dn) / chip.gain_dn_per_e) / share
    monkeypatch.setattr(laboratory, "check_light", lambda *_: None)
    monkeypatch.setattr(laboratory, "corner_directions", lambda *_: None)
    monkeypatch.setattr(laboratory, "expected_spots", lambda *_: (None, np.array([radius_px, 9.0]), None))
    lab = SimpleNamespace(instrument=star_camera, config=SimpleNamespace(target=None), filtered=None)
    lab.signal = SimpleNamespace(signal_e=0.85 * most)
    laboratory.check_laboratory(lab)
    lab.signal = SimpleNamespace(signal_e=1.15 * most)
    with pytest.raises(DomainError, match="saturates its brightest pixel"):
        laboratory.check_laboratory(lab)
