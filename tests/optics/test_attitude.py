"""Attitudes from angles, judged by astropy's position angles."""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from optics.attitude import angles_from_attitude, attitude_from_angles


@pytest.mark.parametrize(("ra", "dec", "roll"), [(10.0, 20.0, 0.0), (310.0, -65.0, 37.0), (123.0, 89.5, 300.0)])
def test_roll_is_the_position_angle_of_up(ra, dec, roll):
    attitude = attitude_from_angles(ra, dec, roll)
    back = np.array(angles_from_attitude(attitude))
    assert back[1] == pytest.approx(dec, abs=1e-9)
    assert (back >= (0, -90, 0)).all()
    assert (back < (360, 90.1, 360)).all()
    assert (np.array([back[0] - ra, back[2] - roll]) + 180) % 360 - 180 == pytest.approx(0.0, abs=1e-9)
    up = attitude.inv().apply([0.0, -1e-4, 1.0])  # up in the image is towards smaller rows
    here, there = SkyCoord(ra, dec, unit="deg"), SkyCoord(*up, representation_type="cartesian")
    angle = here.position_angle(SkyCoord(there.spherical.lon, there.spherical.lat)).deg
    assert (angle - roll + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.01)
    east = attitude_from_angles(ra, 0.0, 0.0).inv().apply([-1e-3, 0.0, 1.0])
    assert SkyCoord(*east, representation_type="cartesian").spherical.lon.deg > ra  # east is left
