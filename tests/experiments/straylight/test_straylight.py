"""Stray light: exclusion angles, variants, frames of a small sensor, section of its baffle."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.harness.progress import Progress
from experiments.straylight import drawing, experiment
from experiments.straylight.experiment import compare_variants, find_exclusion
from experiments.straylight.settings import StraylightConfig
from experiments.straylight.transmittance import bare_lens, behind_baffle, check_baffle
from optics.frames import polar_direction
from optics.light.pst import PointSourceTransmittance, read_pst
from render.baffle.transmittance import SensorTransmittance
from render.bodies.stray_light import BandLight
from render.sensor_file.instrument import build_instrument

LIGHT = BandLight(sun_e_per_s=1e10, full_moon_e_per_s=1e4, moon_zero_e_per_s=0.1)
SINGLET = """name = "singlet"
source = "test"
design_wavelength_nm = 600.0
max_field_deg = 10.0
surface = [
  {radius_mm = 25.0, thickness_mm = 3.0, medium = "N-BK7", semi_diameter_mm = 5.0, stop = true},
  {radius_mm = inf, thickness_mm = 46.0, medium = "air", semi_diameter_mm = 6.0},
]
"""


def cliff() -> SensorTransmittance:
    """PST of (angle / deg)^-4, a thousandth of it from 35 deg on."""
    angle = np.array([0.3, 1.0, 10.0, 34.0, 36.0, 90.0])
    value = (angle**-4.0 * np.where(angle > 35.0, 1e-3, 1.0)).reshape(1, 1, -1)
    pst = PointSourceTransmittance(
        angle_deg=angle, azimuth_deg=np.zeros(1), causes=("pst",), value=value, error=0.0 * value
    )
    return SensorTransmittance(pst=pst, direct=np.ones((1, 6)))


def frames(angle: float, stray_light_e: float, usable: bool) -> SimpleNamespace:
    """Fields of `SunAngle` that `exclusion` reads."""
    return SimpleNamespace(sun_deg=angle, stray_light_e=stray_light_e, usable=usable)


def observed(angle: float) -> SimpleNamespace:
    light = 2e9 * float(cliff().pst.at(polar_direction(angle)))
    return frames(angle, light, light < 700.0)


def test_the_exclusion_angle_is_where_frames_cease_to_be_usable() -> None:
    stray, rows = cliff(), [observed(angle) for angle in (2.0, 20.0, 34.0, 60.0, 90.0)]
    found, more = find_exclusion(StraylightConfig(), stray, LIGHT, rows, observed)
    truth = stray.pst.last_angle_deg(700.0 / 2e9)
    assert found.farthest_unusable_deg <= truth <= found.nearest_usable_deg
    assert found.sun_exclusion_deg == pytest.approx(truth, abs=4.0)
    assert len(more) == len(rows) + 3
    assert found.bounded
    # the Moon's light equals that where its PST is 1e6 times as large
    assert found.moon_exclusion_deg == pytest.approx(
        stray.pst.last_angle_deg(found.critical_stray_light_e / 2e3), rel=1e-9
    )


@pytest.mark.parametrize(("usable", "angle"), [(True, 0.0), (False, 180.0)])
def test_no_angle_and_every_angle(usable: bool, angle: float) -> None:
    found, _ = find_exclusion(
        StraylightConfig(), cliff(), LIGHT, [frames(a, 1.0, usable) for a in (10.0, 90.0)], observed
    )
    assert (found.sun_exclusion_deg, found.bounded) == (angle, False)


def test_usable_frames_inside_the_exclusion_angle_do_not_count() -> None:
    """The largest angle at which a rate is exceeded bounds the exclusion angle."""
    rows = [
        frames(a, light, ok)
        for a, light, ok in ((10.0, 900.0, False), (20.0, 10.0, True), (30.0, 800.0, False), (60.0, 5.0, True))
    ]
    found, _ = find_exclusion(StraylightConfig(), cliff(), LIGHT, rows, lambda a: frames(a, 100.0, a > 40.0))
    assert 30.0 < found.sun_exclusion_deg < 60.0


def test_variants_change_one_thing_at_a_time(monkeypatch) -> None:
    """Each with its baffle and dust, at the angles near the shade; twice the light reaches 2^(1/4) as far inside."""
    computed, stray = [], cliff()
    stray = SensorTransmittance(pst=stray.pst, direct=stray.direct, lens=SimpleNamespace(value={"dust 500": None}))

    def twice(config, lens, baffle, *, dust, chosen):
        computed.append((baffle.fitted, baffle.vanes, baffle.coating, baffle.edge_radius_um, dust))
        pst = stray.pst
        return SimpleNamespace(pst=PointSourceTransmittance(
            angle_deg=pst.angle_deg, azimuth_deg=pst.azimuth_deg, causes=pst.causes, value=2.0 * pst.value,
            error=pst.error,
        ))  # fmt: skip

    monkeypatch.setattr(experiment, "behind_baffle", twice)
    ticks = []
    rows = compare_variants(StraylightConfig(), stray, LIGHT, 700.0, lambda: ticks.append(1))
    assert [row.change for row in rows] == [
        "as it is", "dust of level 500", "coating black_anodised", "coating magic_black", "edges twice as round",
        "no vanes", "no baffle",
    ]  # fmt: skip
    assert len(ticks) == len(rows)
    assert computed == [
        (True, None, "z306", 20.0, "dust 500"), (True, None, "black_anodised", 20.0, "dust"),
        (True, None, "magic_black", 20.0, "dust"), (True, None, "z306", 40.0, "dust"),
        (True, 0, "z306", 20.0, "dust"), (False, None, "z306", 20.0, "dust"),
    ]  # fmt: skip
    assert rows[0].outside_pst == float(stray.pst.at(polar_direction(40.0)))
    assert rows[1].outside_pst == pytest.approx(2.0 * rows[0].outside_pst)
    assert rows[1].inside_pst == pytest.approx(2.0 * rows[0].inside_pst)
    assert rows[0].outside_e == pytest.approx(2e9 * rows[0].outside_pst)
    assert rows[1].exclusion_deg > rows[0].exclusion_deg > 0.0


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Frames of a small sensor with a tabulated PST."""
    file = tmp_path_factory.mktemp("pst") / "my.csv"
    file.write_text("angle_deg,pst\n1,1e-3\n30,1e-7\n40,1e-9\n90,1e-10\n")
    chip = {"lens": "star_tracker_26mm", "detector": "cmv4000", "width_px": 256, "height_px": 256, "exposure_s": 0.2}
    config = StraylightConfig.model_validate(
        {
            "instrument": {**chip, "diffraction": "rays", "defocus_mm": 0.0}, "passband": {"range_nm": [500, 800]},
            "centroid": "gaussian", "pst": {"file": str(file)}, "dark_frames": 2,
            "frames": {"attitudes": 2, "levels": 4, "faintest_mag": 7}, "requirements": {"sun_exclusion_deg": 10.0},
        }
    )  # fmt: skip
    return experiment.run(config, progress=Progress())


def test_frames_with_a_tabulated_pst(result, tmp_path) -> None:
    rows, excluded, scale = result["frames"], result["exclusion"], result["sensor"].sun_e_at_unit_pst
    for row in rows:
        assert row.stray_light_e == pytest.approx(scale * result["sensor"].stray.pst.at(polar_direction(row.sun_deg)))
    largest, smallest = rows[-1], rows[0]
    assert largest.usable
    assert (largest.lost_percent.value, largest.false_per_frame.value, largest.solved_percent) == (0.0, 0.0, 100.0)
    assert largest.centroid_error_px < 0.2
    assert largest.attitude_cross_arcsec < 30.0
    assert not smallest.usable
    assert smallest.stars_per_frame.value < largest.stars_per_frame.value
    assert smallest.saturated_percent == 100.0
    assert excluded.farthest_unusable_deg < excluded.sun_exclusion_deg < excluded.nearest_usable_deg
    exclusion_deg = result["sensor"].stray.pst.last_angle_deg(excluded.critical_stray_light_e / scale)
    assert excluded.sun_exclusion_deg == pytest.approx(exclusion_deg, abs=2.0)
    experiment.save_table(result, tmp_path)
    np.testing.assert_array_equal(read_pst(tmp_path / "pst.ecsv").total, [[1e-3, 1e-7, 1e-9, 1e-10]])
    assert result["sensor"].baffle == "part of the table"
    assert not result["requirements"][0].met
    assert [row.limb_deg for row in result["limb"]] == sorted(row.limb_deg for row in result["limb"])
    assert all(a.earth_e > b.earth_e for a, b in zip(result["limb"], result["limb"][1:], strict=False))
    assert [row.sun_e[0] for row in result["pst"]] == pytest.approx(scale * np.array([1e-3, 1e-7, 1e-9, 1e-10]))


def test_figures_of_the_frames(result) -> None:
    outcome = SimpleNamespace(result=result)
    assert len(drawing.draw_frames(outcome).axes) == 3
    panel = drawing.draw_causes(outcome).axes[0]
    assert [line.get_label() for line in panel.lines][:2] == ["pst", "total"]


def test_lens_and_baffle_of_a_sensor_file(tmp_path, monkeypatch) -> None:
    """A singlet behind its default baffle: lit inside the shade, dark outside but for walls; drawn in section."""
    for name, few in (("LOG2_PASS", 12), ("MOST_PASSES", 2), ("FEWEST_PASSES", 2)):
        monkeypatch.setattr(f"render.baffle.light.{name}", few)
    (tmp_path / "singlet.toml").write_text(SINGLET)
    chip = {"lens": str(tmp_path / "singlet.toml"), "detector": "cmv4000", "width_px": 256, "height_px": 256}
    pst = {"angles_deg": [5.0, 20.0, 40.0], "azimuths_deg": [0.0], "points": 3, "rings": 2, "ghost_rings": 4,
           "ghost_arms": 8, "walls_error": 0.99}  # fmt: skip
    config = StraylightConfig.model_validate(
        {"instrument": {**chip, "absorption": False, "defocus_mm": 0.0}, "pst": pst}
    )
    instrument, ticks = build_instrument(config.instrument), []
    check_baffle(config, instrument)
    lens = bare_lens(config, instrument, lambda: ticks.append(1))
    assert len(ticks) == 3
    assert set(lens.value) == {"ghosts", "polish", "dust", "dust 100", "dust 500", "dust 1000"}
    assert (lens.value["dust 1000"][:, :2] > lens.value["dust"][:, :2]).all()
    stray = behind_baffle(config, lens, config.baffle)
    assert 0.0 < stray.direct[0, 1] < stray.direct[0, 0] < 1.0
    np.testing.assert_array_equal(stray.pst.value[:3, 0, 2], 0.0)  # in the shade
    assert (stray.pst.value[3:] > 0.0).all()
    sensor = experiment._baffled_sensor(config, instrument, stray, 2e9)
    assert sensor.shade_deg == pytest.approx(35.0)
    assert sensor.vanes > 2
    assert sensor.worst_deg == pytest.approx(40.0)
    outcome = SimpleNamespace(result={"sensor": sensor})
    assert len(drawing.draw_baffle(outcome).axes[0].lines) > 2 * sensor.vanes + len(sensor.worst.fraction)
    labels = {line.get_label() for line in drawing.draw_causes(outcome).axes[0].lines}
    assert labels > {"polish", "dust", "walls, vanes", "vane edges", "total"}
    unbaffled = behind_baffle(config, lens, config.baffle.model_copy(update={"fitted": False}))
    np.testing.assert_array_equal(unbaffled.pst.value[3:], 0.0)
