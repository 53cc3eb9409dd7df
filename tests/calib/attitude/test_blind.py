"""Search over fields of view, with a solver that answers in one of them."""

from __future__ import annotations

import numpy as np
import pytest

from calib.attitude import blind
from calib.attitude.blind import BlindIdentifier
from calib.attitude.identify import Identification, failed

PIXEL = np.random.default_rng(1).uniform(0, 500, (100, 2))
FLUX = np.arange(100.0)


@pytest.fixture
def solver(monkeypatch):
    """Finds a focal length of 3000 px within the stated reach; the sky may be mirrored."""
    calls = []

    def identify(pixel, model, database, *, flux, focal_length_error, tolerance_px):
        focal = model.value("focal_length_mm")
        calls.append((database, len(pixel), focal, focal_length_error))
        if abs(3000.0 / focal - 1.0) > focal_length_error:
            return failed("no_match", "nothing")
        if solver.mirrored:
            return failed("mirrored", "mirrored sky")
        rows = np.arange(len(pixel))
        return Identification(
            status="identified",
            message="",
            attitude=None,
            detected=rows,
            catalogue_id=rows,
            direction=np.zeros((len(rows), 3)),
            scale=3000.0 / focal,
        )

    solver = type("Solver", (), {"calls": calls, "mirrored": False})
    monkeypatch.setattr(blind, "identify", identify)
    monkeypatch.setattr(blind, "kept_database", lambda min_fov_deg, max_fov_deg: (min_fov_deg, max_fov_deg))
    return solver


def test_the_scale_of_the_first_frame_narrows_the_next(solver):
    identifier = BlindIdentifier(512, 512)
    result, model = identifier.identify(PIXEL, FLUX)
    assert result.ok
    assert identifier.focal_px == pytest.approx(3000.0)  # 9.76 deg, in the field of 11 deg: a second search refines
    assert model.value("focal_length_mm") == pytest.approx(3000.0)
    assert [count for _, count, _, _ in solver.calls] == [80, 80]
    assert solver.calls[0][0] == pytest.approx((7.7, 14.3))
    identifier.identify(PIXEL, FLUX)
    assert solver.calls[-1][2:] == pytest.approx((3000.0, 0.01))


def test_fields_are_tried_until_one_holds_and_a_mirrored_sky_is_stated(solver):
    identifier = BlindIdentifier(512, 512, fields_deg=(50.0, 30.0, 10.0))
    assert identifier.identify(PIXEL, FLUX)[0].ok
    assert len({database for database, *_ in solver.calls}) == 3
    solver.mirrored = True
    assert BlindIdentifier(512, 512, field_deg=9.8).identify(PIXEL, FLUX)[0].status == "mirrored"
    assert BlindIdentifier(512, 512, field_deg=20.0).identify(PIXEL, FLUX)[0].status == "no_match"
    assert BlindIdentifier(512, 512).identify(PIXEL[:3], FLUX[:3])[0].status == "too_few"
