"""A Brown-Conrady camera on a two-axis table: the bench of the calibrations on coordinates."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, aiming_angles, star_direction
from calib.cameras import BrownConrady, SensorGeometry
from experiments.laboratory.devices.turntable import build_turntable
from experiments.turntable.monte_carlo import Coordinates

SENSOR = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)


@pytest.fixture(scope="session")
def coordinates_of():
    """``coordinates_of(side=7, ...)``: coordinates of a grid of images; keywords as of `build_turntable`."""

    def make(*, side, **table):
        model = BrownConrady.create(SENSOR, focal_length_mm=40.0, x0_px=5.0, y0_px=-3.0, q1_per_mm2=1e-4)
        bench = StarBench(
            table=build_turntable("xy", **table),
            star=star_direction(0.5, -0.4),
            installation=Rotation.from_rotvec([0.01, 0.02, -0.05]),
        )
        direction = model.unproject(SENSOR.grid_px(side))
        return Coordinates(
            model=model,
            bench=bench,
            true_rad=aiming_angles(bench, direction, np.zeros(side**2)),
            covariance_px2=np.tile([[1.0, 0.5], [0.5, 2.0]], (side**2, 1, 1)) * 0.02**2,
            start=model,
            start_star=np.array(bench.star),
        )

    return make
