import io

import numpy as np
import pytest
from astropy.table import Table
from star_images import image_of

from calib.flags import StarFlag, describe_flags, has_flag
from calib.records import NoiseModel, StarTable


def test_noise_model_gain_and_rounding():
    noise = NoiseModel(read_noise_e=3.0, gain_dn_per_e=0.5, offset_dn=100.0, quantised=True)
    assert noise.to_electrons(np.array([150])) == pytest.approx([100.0])
    # rounding to 1 DN = 2 e-: a uniform distribution of that width has variance 4/12
    assert noise.variance_e2(np.array([20.0])) == pytest.approx([20.0 + 9.0 + 4.0 / 12.0])


def test_empty_table_has_all_columns_and_survives_ecsv():
    table = StarTable.empty().to_table()
    assert len(table) == 0
    assert {"x_px", "y_px", "flux_e", "flags", "sigma_x_px", "correlation_xy"} <= set(table.colnames)
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    back = Table.read(text.getvalue(), format="ascii.ecsv")
    assert back.colnames == table.colnames
    assert str(back["x_px"].unit) == "pix"


def test_misfit_sums_stars_with_pixels_to_spare():
    """Chi-square per degree of freedom times degrees; stars with none, fewer, or a flag say nothing."""
    ones, flags = np.ones(5), np.array([0, 0, 0, 0, int(StarFlag.BLEND)], np.uint32)
    stars = StarTable(
        **dict.fromkeys(("x_px", "y_px", "flux_e", "background_e"), ones),
        covariance=np.tile(np.eye(3), (5, 1, 1)),
        chi2=np.array([1.5, 0.5, 7.0, 9.0, 9.0]),
        iterations=np.ones(5, np.int64),
        freedom=np.array([4, 8, 0, -2, 6]),
        flags=flags,
    )
    assert (stars.misfit.value, stars.misfit.degrees_of_freedom) == (10.0, 12)


def test_records_are_locked_copies():
    dn = np.ones((4, 5))
    image = image_of(dn)
    dn[0, 0] = 7
    assert image.dn[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        image.dn[0, 0] = 2


def test_flags_speak():
    assert describe_flags(0) == ""
    assert describe_flags(int(StarFlag.SATURATED | StarFlag.EDGE)) == "SATURATED|EDGE"
    assert has_flag(np.array([1, 2, 3], np.uint32), StarFlag.EDGE).tolist() == [False, True, True]
