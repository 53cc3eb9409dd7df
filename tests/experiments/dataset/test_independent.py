"""Written attitudes judged by pixels: they hold over seeds, and wrong senses, handedness and shifts are noticed."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import f

from calib.cameras import BrownConrady, SensorGeometry
from experiments.dataset.criteria import FALSE_ALARM, PLAIN_FOUND, POINTING_ARCSEC, TURNED_SIGMA
from experiments.dataset.evaluation.independent import (
    LEAST_KEPT,
    TURN_DEG,
    plain_attitude,
    pointing_off_arcsec,
    turn_missed_sigma,
    turned_px,
)
from optics.attitude import attitude_error_arcsec, attitude_from_angles

SIDE, FOCAL_MM, PITCH_MM, SPOT_PX = 384, 26.0, 5.5e-3, 0.8
FOCAL_PX, CENTRE = FOCAL_MM / PITCH_MM, np.full(2, (SIDE - 1) / 2)
GEOMETRY = SensorGeometry(width_px=SIDE, height_px=SIDE, pixel_pitch_mm=PITCH_MM)
MODEL = BrownConrady.create(GEOMETRY, focal_length_mm=FOCAL_MM, q1_per_mm2=-4e-4)
RA, DEC, ROLL = 83.0, 31.0, 25.0


def frame(seed=1):
    """A frame of 60 stars through a distorting lens, with noise: pixels, record, truth."""
    rng = np.random.default_rng(seed)
    attitude = attitude_from_angles(RA, DEC, ROLL)
    pixel = rng.uniform(12, SIDE - 13, (60, 2))
    sky = attitude.inv().apply(MODEL.unproject(pixel))
    row, column = np.mgrid[:SIDE, :SIDE]
    image = rng.normal(100.0, 5.0, (SIDE, SIDE))
    for x, y in pixel:
        near = np.s_[int(y) - 7 : int(y) + 8, int(x) - 7 : int(x) + 8]
        image[near] += 800.0 * np.exp(-0.5 * ((column[near] - x) ** 2 + (row[near] - y) ** 2) / SPOT_PX**2)
    record = SimpleNamespace(quat_xyzw=tuple(attitude.as_quat(canonical=True)), ra_deg=RA, dec_deg=DEC, roll_deg=ROLL)
    truth = {
        "ra_deg": np.degrees(np.arctan2(sky[:, 1], sky[:, 0])),
        "dec_deg": np.degrees(np.arcsin(sky[:, 2])),
        "snr": np.full(60, 50.0),
        "flags": np.zeros(60, int),
    }
    return image, record, truth


def failed(image, record, truth):
    """Criteria that a frame fails."""
    found = plain_attitude(image, record, truth, focal_px=FOCAL_PX, centre_px=CENTRE)
    rms = np.sqrt(np.mean((found.error_arcsec / found.sigma_arcsec) ** 2))
    held = {
        "found": found.found >= PLAIN_FOUND,
        "attitude": rms <= np.sqrt(f.isf(FALSE_ALARM, 3, 2 * LEAST_KEPT - 6)),
        "pointing": pointing_off_arcsec(record) <= POINTING_ARCSEC,
    }
    return {name for name, holds in held.items() if not holds}


def test_a_right_attitude_holds():
    assert not failed(*frame())


@pytest.mark.slow
def test_right_attitudes_hold_over_seeds():
    """20 seeds, a false alarm of 0.1 % each; their RMS is 1 within four standard deviations of 60 numbers."""
    frames = [frame(seed) for seed in range(20)]
    assert not [k for k, one in enumerate(frames) if failed(*one)]
    plain = [plain_attitude(*one, focal_px=FOCAL_PX, centre_px=CENTRE) for one in frames]
    square = [(one.error_arcsec / one.sigma_arcsec) ** 2 for one in plain]
    assert np.sqrt(np.mean(square)) < 1 + 4 / np.sqrt(120)


def with_attitude(record, rotation):
    return SimpleNamespace(**{**vars(record), "quat_xyzw": tuple(rotation.as_quat(canonical=True))})


WRONG = {
    "icrs from cam": (lambda i, r, t: (i, with_attitude(r, Rotation.from_quat(r.quat_xyzw).inv()), t), "found"),
    "roll reversed": (lambda i, r, t: (i, with_attitude(r, attitude_from_angles(RA, DEC, -ROLL)), t), "found"),
    "image mirrored": (lambda i, r, t: (i[:, ::-1], r, t), "found"),
    "columns and rows exchanged": (lambda i, r, t: (i.T, r, t), "found"),
    "light half a pixel off": (lambda i, r, t: ((i + np.roll(i, 1, axis=1)) / 2, r, t), "attitude"),
    "600 arcsec of roll too much": (
        lambda i, r, t: (i, with_attitude(r, Rotation.from_rotvec([0, 0, 3e-3]) * Rotation.from_quat(r.quat_xyzw)), t),
        "attitude",
    ),
    "roll written with the other sign": (
        lambda i, r, t: (i, SimpleNamespace(**{**vars(r), "roll_deg": -ROLL}), t),
        "pointing",
    ),
    "boresight 0.01 arcsec off": (
        lambda i, r, t: (i, SimpleNamespace(**{**vars(r), "dec_deg": DEC + 3e-6}), t),
        "pointing",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_attitude_is_noticed(name):
    change, noticed_by = WRONG[name]
    assert noticed_by in failed(*change(*frame()))


@pytest.mark.parametrize(("sense", "noticed"), [(1.0, False), (-1.0, True)])
def test_a_known_turn_comes_back_with_its_sign(sense, noticed):
    """Attitudes by SciPy from stars whose places were turned."""
    rng = np.random.default_rng(4)
    pixel = rng.uniform(20, SIDE - 21, (40, 2))
    attitude = attitude_from_angles(RA, DEC, ROLL)
    sky = attitude.inv().apply(MODEL.unproject(pixel))
    solved = []
    for place in (pixel, turned_px(pixel, CENTRE, sense * TURN_DEG)):
        found = Rotation.align_vectors(MODEL.unproject(place), sky)[0]
        solved.append(
            SimpleNamespace(error_arcsec=attitude_error_arcsec(found, attitude), sigma_arcsec=np.array([0.2, 0.2, 3.0]))
        )
    assert (turn_missed_sigma(*solved) > TURNED_SIGMA) == noticed
