"""Table of point-source transmittance: kept, read back, looked up."""

import numpy as np
import pytest

from optics.frames import polar_direction
from optics.light.pst import PointSourceTransmittance, read_pst, write_pst


def example() -> PointSourceTransmittance:
    angle, azimuth = np.array([1.0, 10.0, 90.0]), np.array([0.0, 45.0])
    value = np.stack([np.stack([angle**-2.0, 4.0 * angle**-2.0]), np.zeros((2, 3))])
    return PointSourceTransmittance(
        angle_deg=angle, azimuth_deg=azimuth, causes=("ghosts", "walls"), value=value, error=0.1 * value, source="it's"
    )


@pytest.mark.parametrize("suffix", ["csv", "ecsv"])
def test_a_table_comes_back_as_it_was(tmp_path, suffix: str) -> None:
    pst = example()
    back = read_pst(write_pst(tmp_path / f"pst.{suffix}", pst))
    assert back.causes == pst.causes
    for name in ("angle_deg", "azimuth_deg", "value", "error"):
        np.testing.assert_array_equal(getattr(back, name), getattr(pst, name))


def test_power_laws_are_met_between_the_angles() -> None:
    pst = example()
    for angle in (1.0, 2.0, 7.0, 33.0):
        assert pst.at(polar_direction(angle, 0.0)) == pytest.approx(angle**-2.0, rel=1e-12)
        assert pst.at(polar_direction(angle, 135.0)) == pytest.approx(4.0 * angle**-2.0, rel=1e-12)  # its quadrant's
        assert pst.at(polar_direction(angle, -22.5)) == pytest.approx(2.0 * angle**-2.0, rel=1e-12)
    assert pst.at(polar_direction(0.1, 0.0)) == pytest.approx(1.0)
    assert pst.at(polar_direction(95.0, 0.0)) == 0.0
    np.testing.assert_allclose(pst.at(polar_direction([5.0, 100.0], [80.0, 0.0])), [4.0 / 25.0, 0.0])


def cliff() -> PointSourceTransmittance:
    """PST of (angle / deg)^-4, a thousandth of it from 35 deg on."""
    angle = np.array([0.3, 1.0, 10.0, 34.0, 36.0, 90.0])
    value = (angle**-4.0 * np.where(angle > 35.0, 1e-3, 1.0)).reshape(1, 1, -1)
    return PointSourceTransmittance(
        angle_deg=angle, azimuth_deg=np.zeros(1), causes=("pst",), value=value, error=0.0 * value
    )


def test_the_last_angle_of_a_value() -> None:
    found = cliff().last_angle_deg([1e-4, 7.0**-4.0, 1e-12, 1e3, 1e-3 * 60.0**-4])
    np.testing.assert_allclose(found, [10.0, 7.0, 90.0, 0.0, 60.0], rtol=2e-3)
    humped = PointSourceTransmittance(
        angle_deg=np.array([1.0, 10.0, 20.0, 90.0]), azimuth_deg=np.zeros(1), causes=("pst",),
        value=np.array([1e-3, 1e-6, 1e-4, 1e-9]).reshape(1, 1, 4), error=np.zeros((1, 1, 4)),
    )  # fmt: skip
    assert humped.last_angle_deg(1e-5) > 20.0  # dark again nearer by does not count


def test_angles_are_spread_evenly_over_the_light() -> None:
    angles = cliff().angles_by_value(8, 1e-9, 5e-6)
    assert angles == sorted(angles)
    assert angles[-1] == 90.0
    light = cliff().at(polar_direction(angles[:-1]))
    assert light.max() == pytest.approx(5e-6, rel=0.02)
    assert (np.diff(light) < 0.0).all()
    assert np.abs(np.diff(np.log(light))).max() < 2.5
    assert cliff().angles_by_value(4, 1e3, 1e4) == [90.0]  # darker than the least everywhere


def test_plain_tables_are_read_and_astropy_reads_ours(tmp_path) -> None:
    (tmp_path / "my.csv").write_text("# measured\nangle_deg,pst\n30,1e-8\n10,1e-6\n")
    pst = read_pst(tmp_path / "my.csv")
    np.testing.assert_array_equal(pst.total, [[1e-6, 1e-8]])
    (tmp_path / "both.csv").write_text("angle_deg,walls,total\n10,1e-6,2e-6\n")
    assert read_pst(tmp_path / "both.csv").total.item() == 1e-6
    from astropy.table import Table

    table = Table.read(write_pst(tmp_path / "pst.ecsv", example()))
    assert table["angle_deg"].unit == "deg"
    assert table.meta["source"] == "it's"
    assert table["ghosts"][1] == 0.01
