"""Stray light: bad input in a line, choice of angles, exclusion angle; whole runs are in the slow tests."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from experiments.straylight.experiment import angle_of, changes, exclusion, sun_angles
from experiments.straylight.settings import Config, main
from experiments.straylight.transmittance import Stray, direction, lens_part, transmittance
from optics.errors import DomainError
from optics.light.pst import PointSourceTransmittance, read_pst
from render.bodies.stray_light import BandLight

LIGHT = BandLight(sun_e_per_s=1e10, full_moon_e_per_s=1e4, moon_zero_e_per_s=0.1)


def cliff() -> PointSourceTransmittance:
    """PST of (angle / deg)^-4, a tenth of a millionth of it from 35 deg on."""
    angle = np.array([0.3, 1.0, 10.0, 34.0, 36.0, 90.0])
    value = angle**-4.0 * np.where(angle > 35.0, 1e-3, 1.0)
    shape = (1, 1, len(angle))
    return PointSourceTransmittance(
        angle_deg=angle, azimuth_deg=np.zeros(1), causes=("pst",), value=value.reshape(shape), error=np.zeros(shape)
    )


@dataclass(frozen=True, kw_only=True)
class Frames:
    """What `exclusion` needs of frames: usable below a light."""

    sun_deg: float
    light_e: float
    usable: bool


def looked(angle: float) -> Frames:
    light = 2e9 * float(cliff().at(direction(angle, 0.0)))
    return Frames(sun_deg=angle, light_e=light, usable=light < 700.0)


def test_angles_are_spread_over_the_light() -> None:
    angles = sun_angles(cliff(), 2e9, 8, 1e4)
    assert angles == sorted(angles)
    assert angles[-1] == 90.0
    light = 2e9 * cliff().at(np.stack([direction(a, 0.0) for a in angles[:-1]]))
    assert light.max() == pytest.approx(1e4, rel=0.02)
    assert (np.diff(light) < 0.0).all()
    assert np.abs(np.diff(np.log(light))).max() < 2.5


def test_the_exclusion_angle_is_where_frames_cease_to_be_usable() -> None:
    config = Config()
    stray = Stray(pst=cliff(), direct=np.ones((1, 6)))
    rows = [looked(angle) for angle in (2.0, 20.0, 34.0, 60.0, 90.0)]
    found, more = exclusion(config, stray, LIGHT, rows, looked)
    truth = angle_of(cliff(), 700.0 / 2e9)
    assert found.farthest_unusable_deg <= truth <= found.nearest_usable_deg
    assert found.sun_exclusion_deg == pytest.approx(truth, abs=4.0)
    assert len(more) == len(rows) + 3
    assert found.bounded
    # the Moon's light equals that where its PST is 1e6 times as large
    assert found.moon_exclusion_deg == pytest.approx(angle_of(cliff(), found.critical_e / 2e3), rel=1e-9)


def test_no_angle_and_every_angle() -> None:
    config, stray = Config(), Stray(pst=cliff(), direct=np.ones((1, 6)))
    good, _ = exclusion(
        config, stray, LIGHT, [Frames(sun_deg=a, light_e=1.0, usable=True) for a in (10.0, 90.0)], looked
    )
    assert (good.sun_exclusion_deg, good.bounded) == (0.0, False)
    bad, _ = exclusion(
        config, stray, LIGHT, [Frames(sun_deg=a, light_e=1.0, usable=False) for a in (10.0, 90.0)], looked
    )
    assert (bad.sun_exclusion_deg, bad.bounded) == (180.0, False)


def test_usable_again_nearer_by_does_not_count() -> None:
    """The largest angle at which a rate is passed, however the frames look inside it."""
    rows = [
        Frames(sun_deg=a, light_e=light, usable=ok)
        for a, light, ok in ((10.0, 900.0, False), (20.0, 10.0, True), (30.0, 800.0, False), (60.0, 5.0, True))
    ]
    found, _ = exclusion(
        Config(), Stray(pst=cliff(), direct=np.ones((1, 6))), LIGHT, rows,
        lambda a: Frames(sun_deg=a, light_e=100.0, usable=a > 40.0),
    )  # fmt: skip
    assert 30.0 < found.sun_exclusion_deg < 60.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "baffle.coating=own", "--set", "baffle.diffuse=-0.1"], "diffuse"),
        (["--set", "baffle.shade_deg=5"], "outside the field"),
        (["--set", "baffle.clearance_mm=-2"], "cuts the beam of the field"),
        (["--set", "baffle.mesh=none.ply"], "no such file"),
        (["--set", "instrument.lens={focal_length_mm=30.0, f_number=2.0}"], "surfaces"),
        (["--set", "pst.file=none.csv"], "none.csv"),
    ],
)
def test_bad_input_is_one_line(arguments, words: str, tmp_path, capsys) -> None:
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert words in error
    assert "Traceback" not in error
    assert not (tmp_path / "out").exists()


def small(**settings) -> Config:
    return Config.model_validate(
        {
            "pst": {"angles_deg": [5.0, 20.0, 40.0], "azimuths_deg": [0.0], "points": 3, "rings": 2,
                    "ghost_rings": 4, "ghost_arms": 8, "walls_error": 0.2},
            "what_if": False, **settings,
        }
    )  # fmt: skip


@pytest.mark.slow
def test_causes_follow_what_they_are_caused_by(tmp_path) -> None:
    """Twice the roughness, four times the light; no dust of its level, no detector, no light of theirs."""
    from render.sensor_file.instrument import build_instrument

    def parts(**settings):
        config = small(**settings)
        return config, lens_part(config, build_instrument(config.instrument), lambda: None)

    config, one = parts()
    _, rough = parts(scatter={"roughness_nm": 3.0, "detector_reflectance": 0.0})
    np.testing.assert_allclose(rough.value["polish"], 4.0 * one.value["polish"], rtol=1e-9)
    assert (rough.value["ghosts"][:, 0] < one.value["ghosts"][:, 0]).all()
    _, dusty = parts(contamination={"level": 500.0, "inner_level": 500.0})
    assert (dusty.value["dust"] > 5.0 * one.value["dust"]).all()
    found = transmittance(config, one, config.baffle)
    np.testing.assert_array_equal(found.pst.value[:3, 0, 2], 0.0)  # in the shade
    np.testing.assert_allclose(found.pst.value[:3, 0, 0], [one.value[k][0, 0] for k in ("ghosts", "polish", "dust")])
    assert 0.0 < found.direct[0, 1] < 1.0
    assert (found.pst.value[3:] > 0.0).all()
    bare = transmittance(config, one, config.baffle.model_copy(update={"fitted": False}))
    np.testing.assert_array_equal(bare.pst.value[3:], 0.0)
    with pytest.raises(DomainError, match="baffle: the baffle cuts the beam"):
        transmittance(config, one, config.baffle.model_copy(update={"clearance_mm": -2.0}))


@pytest.mark.slow
def test_what_is_changed_does_what_it_should() -> None:
    """Order of variants: vanes and blacker coatings take light away, dust and rounder edges add it."""
    from render.sensor_file.instrument import build_instrument

    settings = small().pst.model_dump() | {"angles_deg": [5.0, 30.0, 36.0, 41.0, 90.0]}
    config = small(what_if=True, pst=settings)
    lens = lens_part(config, build_instrument(config.instrument), lambda: None)
    stray = transmittance(config, lens, config.baffle)
    rows = changes(config, stray, LIGHT, 100.0, lambda: None)
    outside = {one.change: one.outside_pst for one in rows}
    now = outside["as it is"]
    assert now == float(stray.pst.at(direction(40.0, 0.0)))
    assert outside["coating magic_black"] < 0.5 * now
    assert now < outside["edges twice as round"] < 2.0 * now
    assert now < outside["dust of level 500"] < outside["dust of level 1000"]
    assert 5.0 * now < outside["no vanes"] < outside["no baffle"]
    inside = {one.change: one.inside_pst for one in rows}
    assert inside["no baffle"] > inside["as it is"]
    assert inside["coating magic_black"] == pytest.approx(inside["as it is"], rel=0.02)  # the lens itself leads there


@pytest.mark.slow
def test_a_table_of_ones_own_takes_the_place_of_all(tmp_path) -> None:
    """Frames under a given light: the exclusion angle is where the table says, whatever the lens."""
    (tmp_path / "my.csv").write_text("angle_deg,pst\n1,1e-3\n30,1e-7\n40,1e-9\n90,1e-10\n")
    (tmp_path / "sensor.toml").write_text("[requirements]\nsun_exclusion_deg = 20.0\nnea_arcsec = 1.0\n")
    arguments = ["--sensor", str(tmp_path / "sensor.toml"), "--set", f"pst.file={tmp_path / 'my.csv'}", "--quick"]
    tracker = [
        f"instrument.{key}" for key in ("lens=star_tracker_26mm", "detector=cmv4000", "width_px=512", "height_px=512")
    ]
    arguments += [one for key in (*tracker, "instrument.exposure_s=0.2") for one in ("--set", key)]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    results = json.loads((tmp_path / "out" / "summary.json").read_text())["results"]
    kept = read_pst(tmp_path / "out" / "pst.ecsv")
    critical = results["critical_e"] / results["sun_e"]
    assert results["sun_exclusion_deg"] == pytest.approx(angle_of(kept, critical), abs=1.0)
    assert 30.0 < results["sun_exclusion_deg"] < 45.0
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Exclusion angle of the Sun" in page
    from astropy.table import Table

    asked = Table.read(tmp_path / "out" / "requirements.ecsv")  # what is asked of other experiments is left out
    assert [str(one) for one in asked["label"]] == ["Exclusion angle of the Sun"]
    assert not asked["met"][0]
