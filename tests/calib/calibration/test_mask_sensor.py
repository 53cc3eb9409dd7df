"""An aperture-mask sun sensor on a turntable: exact spots, scatter of noisy fits, the beam that is held."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.mask_sensor import NOMINAL_CUBE, calibrate_mask_sensor, mask_sensor_noise
from calib.calibration.table_axes import TableAxes
from calib.cameras import SensorGeometry
from optics.units import ARCSEC_RAD

SENSOR = SensorGeometry(width_px=1280, height_px=1280, pixel_pitch_mm=0.007)
GRID = np.radians(np.stack(np.meshgrid(*[np.linspace(-43, 43, 5)] * 2), axis=-1).reshape(-1, 2))
MOUNT = Rotation.from_rotvec([2e-3, -1e-3, 3e-3])


def spots(angle, lean_arcsec=0.0, mount=MOUNT):
    """Pinhole 3.01 mm in front of the detector, 1.5 and -2 px off its middle."""
    table = TableAxes.create("xy", non_orthogonality_arcsec=lean_arcsec)
    v = mount.apply(table.rotation(angle).inv().apply([0.0, 0.0, 1.0]))
    return [641.0, 637.5] + 3.01 / 0.007 * v[:, :2] / v[:, 2:]


@pytest.mark.parametrize(("lean_arcsec", "free"), [(0.0, False), (30.0, True)])
def test_exact_spots_give_the_sensor_back(lean_arcsec, free):
    table = TableAxes.create("xy")
    found = calibrate_mask_sensor(SENSOR, 3.0, spots(GRID, lean_arcsec), GRID, table, fit_non_orthogonality=free)
    assert (found.rotation * MOUNT.inv()).magnitude() < 1e-8
    assert found.focal_length_mm == pytest.approx(3.01, rel=1e-8)
    assert found.offset_px == pytest.approx([1.5, -2.0], abs=1e-6)
    assert found.lean_rad == pytest.approx(lean_arcsec * ARCSEC_RAD, abs=1e-9)
    assert (found.lean_sigma_rad > 0) == free


@pytest.mark.parametrize("free", [False, True])
def test_noise_is_the_scatter_of_fits(free):
    """N = 60 fits of known noise, readings 20 and 40 arcsec: a standard deviation is known to 9 %, four of those."""
    table = TableAxes.create("xy", reading_noise_arcsec=(20.0, 40.0))
    rng, sigma, turns = np.random.default_rng(5), 0.02, []
    for _ in range(60):
        measured = spots(GRID, mount=Rotation.identity()) + sigma * rng.standard_normal((25, 2))
        read = GRID + table.reading_noise_arcsec * ARCSEC_RAD * rng.standard_normal((25, 2))
        found = calibrate_mask_sensor(SENSOR, 3.0, measured, read, table, fit_non_orthogonality=free)
        turns.append([*found.rotation.as_rotvec(), found.lean_rad])
    expected = mask_sensor_noise(table, GRID, np.full(25, sigma**2), 3.01 / 0.007, fit_non_orthogonality=free)
    effect = -np.array(turns)[:, :3] @ NOMINAL_CUBE.T - np.array(turns)[:, 3:] * [0.0, 0.0, 1.0]
    assert effect.std(0) / np.sqrt(np.diag(expected)) == pytest.approx(np.ones(3), abs=0.36)
    assert (found.free_beam_sigma_rad > 0).all()
