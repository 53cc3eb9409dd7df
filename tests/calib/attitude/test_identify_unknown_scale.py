"""Search over fields of view, with a solver that answers within a reach of 3000 px."""

from __future__ import annotations

import numpy as np
import pytest

from calib.attitude import identify_unknown_scale as blind
from calib.attitude.identify import failed
from calib.attitude.identify_unknown_scale import BlindIdentifier

PIXEL, FLUX = np.random.default_rng(1).uniform(0, 500, (100, 2)), np.arange(100.0)


@pytest.fixture
def calls(monkeypatch):
    """Range of fields, detections, focal length and reach of every search."""
    calls = []

    def identify(pixel, model, database, *, flux, focal_length_error, tolerance_px):
        focal = model.value("focal_length_mm")
        calls.append((*database, len(pixel), focal, focal_length_error))
        if abs(3000.0 / focal - 1.0) > focal_length_error:
            return failed("no_match", "")
        result = failed("mirrored" if flux.max() < 50.0 else "identified", "")
        object.__setattr__(result, "scale", 3000.0 / focal)
        return result

    monkeypatch.setattr(blind, "identify", identify)
    monkeypatch.setattr(blind, "kept_database", lambda min_fov_deg, max_fov_deg: (min_fov_deg, max_fov_deg))
    return calls


def test_the_scale_of_the_first_frame_narrows_the_next(calls):
    identifier = BlindIdentifier(512, 512)
    assert identifier.identify(PIXEL, FLUX)[1].value("focal_length_mm") == pytest.approx(3000.0)
    assert identifier.focal_px == pytest.approx(3000.0)  # 9.76 deg: in the field of 11 deg, refined
    identifier.identify(PIXEL, FLUX)
    nominal = 256.0 / np.tan(np.radians(5.5))
    expected = [(nominal, 0.3), (3000.0, 0.02), (3000.0, 0.01)]
    np.testing.assert_allclose(calls, [(5.5, 14.3, 80, *search) for search in expected])


def test_fields_are_tried_until_one_holds(calls):
    assert BlindIdentifier(512, 512, fields_deg=(50.0, 30.0, 10.0)).identify(PIXEL, FLUX)[0].ok
    assert len({call[0] for call in calls}) == 3
    for field, flux, status in ((9.8, FLUX / 3.0, "mirrored"), (20.0, FLUX, "no_match")):
        assert BlindIdentifier(512, 512, field_deg=field).identify(PIXEL, flux)[0].status == status
    assert BlindIdentifier(512, 512).identify(PIXEL[:3], FLUX[:3])[0].status == "too_few"
