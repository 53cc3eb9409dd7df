"""A camera on a turntable before a star, for the tests of its calibration."""

import numpy as np
from scipy.spatial.transform import Rotation

from calib import BrownConrady, SensorGeometry
from calib.calibration.star_bench import StarBench, star_direction
from calib.calibration.table_axes import TableAxes

SENSOR = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
MODEL = BrownConrady.create(SENSOR, focal_length_mm=40.0, x0_px=5.0, y0_px=-3.0, q1_per_mm2=1e-4, p1_per_mm=1e-5)


def star_bench(axes="xy", lean=0.0, reading=0.0, *, azimuth_deg=0.3):
    """Star and camera somewhat off the axes of the table; leans and noise of readings in arcsec."""
    return StarBench(
        table=TableAxes.create(axes, non_orthogonality_arcsec=lean, reading_noise_arcsec=reading),
        star=star_direction(azimuth_deg, -0.2),
        installation=Rotation.from_rotvec([0.01, -0.02, 0.3]),
    )


def square_bench(axes="xy", reading=0.0):
    """Star along +Z, camera square on the table."""
    table = TableAxes.create(axes, reading_noise_arcsec=reading)
    return StarBench(table=table, star=np.array([0.0, 0.0, 1.0]), installation=Rotation.identity())
