"""Table 1's verdict and the choice of an element, from drawn shifts and given solutions."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refuses

from calib.accuracy.chromatic import band_pairs
from experiments.chromatic.experiment import (
    LensTest,
    calibrate_bands,
    compare_centroiders,
    table1_entries,
    tabulate_point_shifts,
)
from experiments.chromatic.perturbation import select_element
from experiments.chromatic.settings import ChromaticConfig
from experiments.laboratory.chromatic_error import ChromaticMeasurement
from optics.errors import ConvergenceError, DomainError


def solution(element, kind, amount, moves=5.0):
    return SimpleNamespace(
        element=element, kind=kind, amount=amount, unit="um", boresight_px=np.array([0.5 * moves, -moves])
    )


def chosen(*solutions, glasses=("N-BK7",), edge_px=150.0, **changes):
    config = ChromaticConfig.model_validate({"decentre": changes})
    bench = SimpleNamespace(target=SimpleNamespace(edge_px=edge_px), window_px=13)
    return select_element(config, bench, SimpleNamespace(name="lens", glasses=glasses), solutions)


def test_the_element_that_moves_least_is_taken():
    every = (
        solution("L1", "decentre", -200.0),
        solution("L2", "decentre", 90.0),
        solution("L2", "tilt", 1.0),
        solution("L3", "decentre", np.nan),
        solution("L4", "decentre", -80.0),
    )
    assert chosen(*every) is every[4]
    assert chosen(*every, element="L1") is every[0]
    assert chosen(*every, kind="tilt") is every[2]
    refuses(ConvergenceError, "no decentre of element L3", chosen, *every, element="L3")
    refuses(ConvergenceError, "no glass", lambda: chosen(every[3], glasses=()))


@pytest.mark.parametrize(
    ("moves", "edge_px", "fits"), [(80.0, 150.0, True), (81.0, 150.0, False), (14.0, 20.0, False), (13.0, 20.0, True)]
)
def test_the_image_must_stay_within_the_search(moves, edge_px, fits):
    """80 px of search, or what lies between the window of 13 px and the edge."""
    if fits:
        assert chosen(solution("L1", "decentre", 10.0, moves), edge_px=edge_px)
    else:
        with pytest.raises(DomainError, match=f"by {moves:g} px"):
            chosen(solution("L1", "decentre", 10.0, moves), edge_px=edge_px)


PAIRS = band_pairs((500.0, 600.0, 800.0), 1)
BANDS_PX = np.array([[0.1, 0.0], [0.0, 0.0], [0.02, -0.3]])
SIGMA_PX, FRAMES = 0.05, 10


def lens(rng, *, common_px=0.0):
    """Four positions of six points; every band moves all points alike, frames scatter."""
    nominal = np.array([[400.0, 300.0], [1600.0, 300.0], [400.0, 900.0], [1600.0, 900.0]])[:, None]
    nominal = nominal + np.stack(np.meshgrid([-50.0, 0.0, 50.0], [-30.0, 30.0]), axis=-1).reshape(6, 2)
    traced = nominal[:, :, None] + BANDS_PX
    of_mean = SIGMA_PX / np.sqrt(FRAMES) * rng.standard_normal(traced.shape)
    of_mean += common_px / np.sqrt(FRAMES) * rng.standard_normal((4, 1, 3, 2))
    seen = np.hypot(SIGMA_PX, common_px)
    frames = ChromaticMeasurement(
        direction=np.zeros((4, 6, 3)),
        nominal_px=nominal,
        photon_px=traced,
        pixels_px=traced + np.where(np.arange(6) % 2, 0.01, -0.01)[:, None, None] * np.array([0.0, 0.0, 1.0])[:, None],
        mean_px={"epsf": traced + of_mean, "cog": traced + 0.02},
        sigma_px={"epsf": np.full(traced.shape, seen), "cog": np.full(traced.shape, 0.3)},
        noise_px=np.full(traced.shape, SIGMA_PX),
        pattern_px=dict.fromkeys(("epsf", "cog"), np.zeros((1, *traced.shape))),
        frames_used=np.full(traced.shape[:3], FRAMES),
        rms_spot_um=np.ones(3),
        example=None,
        common_px=common_px,
    )  # fmt: skip
    bench = SimpleNamespace(
        methods=("epsf", "cog"), pairs=PAIRS, pair_names=[name for name, *_ in PAIRS], frames=FRAMES
    )
    camera = SimpleNamespace(centre_px=np.array([1000.0, 600.0]))
    instrument = SimpleNamespace(pixel_arcsec=5.5, camera=camera)
    return LensTest(label="centred", bench=bench, instrument=instrument, frames=frames, traced_px=traced)


@pytest.mark.parametrize("common_px", [0.0, 0.04])
def test_table_1_of_frames_that_scatter_as_stated(common_px):
    """Half of the mean shift; stated errors are those of 600 tests, the squared pulls' too (known to 3 %)."""
    rng = np.random.default_rng(6)
    made = [table1_entries(lens(rng, common_px=common_px), published=False) for _ in range(600)]
    one = made[0]
    np.testing.assert_allclose(one.predicted_px, [[-0.05, 0.0], [0.01, -0.15]], atol=1e-12)
    values = np.array([[[cell.value for cell in row] for row in each.measured_px] for each in made])
    sigma = np.array([[cell.uncertainty for cell in row] for row in one.measured_px])
    np.testing.assert_allclose(values.std(0), sigma, rtol=4.0 / np.sqrt(1200))
    assert np.abs(values.mean(0) - one.predicted_px).max() < 4.0 * sigma.max() / np.sqrt(600)
    pulls = np.array([each.mean_squared_pull.value for each in made])
    stated = one.mean_squared_pull.uncertainty
    assert pulls.mean() == pytest.approx(1.0, abs=4.0 * stated / np.sqrt(600))
    assert pulls.std() == pytest.approx(stated, rel=0.2)
    assert (one.published_px, one.published_lsfe_arcsec) == (None, None)
    assert one.frames_per_entry == FRAMES * 24
    largest = np.abs(values[0]).max(0)
    assert [each.value for each in one.lsfe_arcsec] == pytest.approx(5.5 * largest)
    which = np.abs(values[0]).argmax(0)
    assert [each.uncertainty for each in one.lsfe_arcsec] == pytest.approx(5.5 * sigma[which, [0, 1]])


def test_other_numbers_of_one_lens():
    this = lens(np.random.default_rng(7))
    one = table1_entries(this, published=True)
    assert np.shape(one.published_px) == (2, 2)
    cells = np.array([[[cell.value, cell.uncertainty] for cell in row] for row in one.noiseless_pixels_px])
    np.testing.assert_allclose(cells[..., 0], one.predicted_px, atol=1e-12)
    # +- 0.01 px of 24 points in the last band: a standard error of the mean, halved
    np.testing.assert_allclose(
        cells[..., 1], [[0.0] * 2, [0.01 * np.sqrt(24 / 23) / np.sqrt(24) / 2.0] * 2], atol=1e-12
    )
    shift = np.hypot(*(BANDS_PX[2] - BANDS_PX[1]))
    residuals = calibrate_bands(this)
    # an offset: a principal point for the band takes all of it, a focal length nothing of a symmetric target
    assert residuals.traced_residual_px[1] == pytest.approx([shift, 0.0, shift, 0.0], abs=1e-9)
    assert residuals.residual_px[1] == pytest.approx(
        residuals.traced_residual_px[1], abs=4.0 * SIGMA_PX / np.sqrt(FRAMES)
    )
    by = compare_centroiders(this, 1)
    assert by.noise_px == pytest.approx([SIGMA_PX, 0.3])
    assert by.rms_error_px == pytest.approx([SIGMA_PX / np.sqrt(FRAMES), 0.02], rel=0.3)
    assert by.rms_error_px[1] == pytest.approx(0.02)
    np.testing.assert_allclose(by.table1_px[1], one.predicted_px, atol=1e-12)
    np.testing.assert_array_equal(by.mean_shift_px, by.table1_px[..., 1])
    rows = tabulate_point_shifts(this)
    assert rows.nominal_px.shape == (24, 2)
    np.testing.assert_allclose(rows.predicted_shift_px[1], np.tile(BANDS_PX[2] - BANDS_PX[1], (24, 1)), atol=1e-12)
    assert rows.measured_shift_px[0][5][1].uncertainty == pytest.approx(SIGMA_PX * np.sqrt(2.0 / FRAMES))
