"""Windows about stars on images whose pixels are numbered."""

from __future__ import annotations

import numpy as np

from calib.measure.background import Background
from calib.measure.images.sensor_image import sensor_image
from calib.psf.star_windows import isolated, star_windows, starlit_pixels

POSITION = np.array([[20.3, 30.0], [24.0, 30.0], [40.0, 12.4], [2.0, 20.0], [50.0, 40.0]])
MAGNITUDE = np.array([5.0, 9.5, 4.0, 3.0, 4.5])


def test_isolated_stars_and_masked_disks():
    position = np.array([[0.0, 0.0], [5.0, 0.0], [50.0, 0.0], [54.0, 0.0]])
    np.testing.assert_array_equal(isolated(position, np.array([5.0, 9.0, 5.0, 8.0])), [True, False, False, False])
    assert isolated(position, np.full(4, 5.0), reach_px=1.0).all()
    mask = starlit_pixels((101, 101), np.array([[50.0, 50.0], [-30.0, 5.0]]), np.array([4.0, 2.0]))
    assert mask.sum() == np.count_nonzero(np.hypot(*(np.indices((101, 101)) - 50)) <= 14.0)
    grown = starlit_pixels(
        (101, 101), np.zeros((0, 2)), np.zeros(0), detected_px=np.array([[50.0, 50.0]]), width_px=1.3
    )
    assert grown.sum() == np.count_nonzero(np.hypot(*(np.indices((101, 101)) - 50)) <= 10.0)


def test_windows_hold_the_pixels_about_isolated_linear_stars():
    row, column = np.indices((48, 64)).astype(float)
    dn = 100.0 + row + 0.01 * column
    dn[40, 50] = 1000.0  # as full as any pixel: its star is left out
    image = sensor_image(dn, offset_dn=0.0, gain_dn_per_e=0.5, read_noise_e=1.0, saturation_dn=4000.0)
    mesh = {"centre_x_px": np.array([31.5]), "centre_y_px": np.array([23.5]), "shape": (48, 64)}
    sky = Background(level_e=np.full((1, 1), 200.0), sigma_e=np.ones((1, 1)), **mesh)
    defects = np.zeros((48, 64), bool)
    defects[12, 38] = True
    windows = star_windows(
        [image], [sky], [POSITION], [MAGNITUDE], [np.zeros(5, np.int64)], faintest_mag=9.0, size_px=9, defective=defects
    )
    np.testing.assert_array_equal(windows.star, [0, 2])  # bright, away from the edge, linear
    np.testing.assert_allclose(windows.offset_px, [[0.3, 0.0], [0.0, 0.4]], atol=1e-12)
    np.testing.assert_allclose(windows.dn[1], dn[8:17, 36:45] - 100.0)
    np.testing.assert_array_equal(windows.level_dn, 100.0)
    assert not windows.valid[1, 4, 2]  # the defect
    assert windows.valid[1].sum() == 80
    assert not windows.valid[0, 4, 7]  # nearer to the star of magnitude 9.5
    assert windows.valid[0, 4, 4]
