"""One sensor file for every experiment: read, written out, refused with the nearest name."""

from __future__ import annotations

import shutil
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from experiments.__main__ import main as starbench
from experiments.harness.config import load_config
from experiments.harness.registry import experiment_names
from experiments.laboratory.settings.sensor_file import SensorConfig
from optics.errors import ConfigError

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "triplet_50mm" / "sensor.toml"
WITHOUT_SENSOR = {"cube"}
OF_ONE_CAMERA = [name for name in experiment_names() if name not in {*WITHOUT_SENSOR, "acf", "skycal", "twin"}]


def config_class(name):
    return import_module(f"experiments.{name}.settings").experiment.config


def printed(name, capsys, *options):
    assert starbench([name, *options]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", experiment_names())
def test_the_whole_configuration_reads_back_the_same(name, tmp_path, capsys):
    file = tmp_path / "all.toml"
    file.write_text(printed(name, capsys, "--defaults", "all", "--seed", "7"), encoding="utf-8")
    model = config_class(name)
    assert load_config(model, file=file) == load_config(model, seed=7)


@pytest.mark.parametrize("name", OF_ONE_CAMERA)
def test_the_sensor_of_an_experiment_reads_back_the_same(name, tmp_path, capsys):
    file, settings = tmp_path / "sensor.toml", ["instrument.exposure_s=0.25", "instrument.housing=invar_36"]
    file.write_text(printed(name, capsys, "--defaults", *(f"--set={one}" for one in settings)), encoding="utf-8")
    model = config_class(name)
    assert load_config(model, sensor=file) == load_config(model, settings=settings)


@pytest.mark.parametrize("name", sorted({*experiment_names()} - WITHOUT_SENSOR))
def test_a_sensor_file_is_written_out_in_full_and_means_the_same(name, tmp_path, capsys):
    """Every key of the model is there, set or as a comment; reading it again changes nothing, from any folder."""
    text = printed(name, capsys, "--sensor", str(EXAMPLE), "--defaults")
    given = tomllib.loads(text)
    for table, field in SensorConfig.model_fields.items():
        keys = getattr(field.annotation, "model_fields", None)
        assert table in given
        for key in keys or ():
            assert key in given[table] or f"# {key} =" in text
    file = tmp_path / "full.toml"
    file.write_text(text, encoding="utf-8")
    assert printed(name, capsys, "--sensor", str(file), "--defaults") == text
    again, first = (load_config(config_class(name), sensor=path).model_dump() for path in (file, EXAMPLE))
    known = set(first) & {"instrument", "passband", "filters", "catalogue", "camera", "own", "centroid"}
    assert known
    for key in known:
        assert without_folders(again[key]) == without_folders(first[key])


def without_folders(value):
    if isinstance(value, dict):
        return {key: without_folders(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_folders(one) for one in value]
    return Path(value).name if isinstance(value, str) else value


def test_filters_are_measured_curves_and_keep_their_nominal_centres():
    from render.sensor_file.filters import interference_filters

    filters = interference_filters(load_config(config_class("chromatic"), sensor=EXAMPLE).filters)
    assert [one.centre_nm for one in filters] == [490.0, 580.0, 700.0]
    for one, half_nm in zip(filters, (40.0, 40.0, 50.0), strict=True):
        at = one.centre_nm + np.array([-half_nm, 0.0, half_nm])
        assert one.transmission(at) == pytest.approx([0.465, 0.93, 0.465], abs=1e-3)


def test_acf_takes_a_camera_that_images_as_the_lens_does():
    """Chief rays of another trace, at places between those of the fit."""
    from experiments.acf.settings import AcfConfig
    from experiments.acf.simulate import build_camera
    from optics.frames import field_direction
    from optics.lens.perturb import refocus
    from optics.lens_file import load_lens
    from optics.rays.chief_ray import chief_ray_points

    model = build_camera(load_config(AcfConfig, sensor=EXAMPLE))
    field = np.array([[0.3, 0.2], [3.1, -2.2], [-5.0, 5.0], [6.2, 0.0]])
    x_mm, y_mm = chief_ray_points(refocus(load_lens(EXAMPLE.parent / "lens.toml"), 0.06), *field.T)
    expected = 1023.5 + np.column_stack([x_mm, -y_mm]) / 0.0055
    assert model.project(field_direction(*field.T)) == pytest.approx(expected, abs=0.01)


def test_skycal_runs_the_camera_of_the_file_alone():
    config = load_config(config_class("skycal"), sensor=EXAMPLE)
    assert list(config.cameras) == ["own"]
    assert config.own.faintest_mag == 7.0


def test_keys_of_the_sensor_file_are_taken_where_the_configuration_holds_them_elsewhere(tmp_path):
    """skycal's camera ``own`` and twin's exposure time are of the sensor file, by whose keys they are set too."""
    (tmp_path / "run.toml").write_text("[catalogue]\nfaintest_mag = 6.5\n")
    config = load_config(
        config_class("skycal"), sensor=EXAMPLE, file=tmp_path / "run.toml", settings=["instrument.exposure_s=0.7"]
    )
    assert (config.own.instrument.exposure_s, config.own.faintest_mag) == (0.7, 6.5)
    short = load_config(config_class("skycal"), sensor=EXAMPLE, settings=["exposure_s=0.7"])
    assert short.own.instrument.exposure_s == 0.7
    twin = load_config(config_class("twin"), sensor=EXAMPLE, settings=["instrument.exposure_s=0.7"])
    assert twin.camera.exposure_s == 0.7
    (tmp_path / "my.toml").write_text("faintest_mag = 12")
    with pytest.raises(ConfigError, match=r"my\.toml: catalogue\.faintest_mag = 12"):
        load_config(config_class("skycal"), sensor=tmp_path / "my.toml")
    with pytest.raises(ConfigError, match=r"narrow\.instrument\.exposure_s or wide\.instrument\.exposure_s or own"):
        load_config(config_class("skycal"), settings=["exposure_s=1"])


def test_cube_says_why_it_takes_no_sensor(capsys):
    assert starbench(["cube", "--sensor", str(EXAMPLE)]) == 2
    assert "cube measures a sun sensor" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[instrument]\nlense = 'x'", "unknown key 'instrument.lense'; did you mean 'lens'?"),
        ("[instrument]\nexposure_s = -1", r"instrument.exposure_s = -1: .*\(allowed: above 0 and at most 10000"),
        ("[instrument]\nhousing = 'aluminium'", "instrument.housing.material = 'aluminium': .*did you mean aluminium_"),
        ("[filters]\nfiles = ['a.csv']", "1 files for 3 centres_nm"),
        ("window_px = 12", "12 px is even"),
        ("centroid = 'gausian'", "did you mean gaussian"),
        ("[passband]\nrange_nm = [900, 450]", "two increasing wavelengths"),
        ("pixel_pitch_um = 5.5", r'a detector file where .*: \[instrument\] detector = "my.toml"'),
    ],
)
def test_what_is_wrong_in_a_file_is_said(text, said, tmp_path):
    (tmp_path / "my.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=f"my.toml(:| is) .*{said}"):
        load_config(config_class("chromatic"), sensor=tmp_path / "my.toml")


def test_layers_lie_over_one_another(tmp_path):
    """quick < sensor < --config < --set; paths in a file are relative to it."""
    shutil.copytree(EXAMPLE.parent, tmp_path / "triplet")
    (tmp_path / "more.toml").write_text("frames = 8\n[instrument]\nexposure_s = 0.3\n", encoding="utf-8")
    config = load_config(
        config_class("chromatic"),
        quick={"frames": 6, "instrument.exposure_s": 0.1, "instrument.defocus_mm": 0.5},
        sensor=tmp_path / "triplet" / "sensor.toml",
        file=tmp_path / "more.toml",
        settings=["instrument.f_number=8"],
    )
    assert (config.frames, config.instrument.exposure_s, config.instrument.f_number) == (8, 0.3, 8.0)
    assert config.instrument.defocus_mm == 0.06
    assert config.instrument.lens == str(tmp_path / "triplet" / "lens.toml")
    assert config.filters.files[0] == str(tmp_path / "triplet" / "blue.csv")


@pytest.mark.slow
def test_a_strangers_sensor_is_measured(tmp_path, capsys):
    """To the end: criteria may fail, but points are found where this lens puts them, 6 px from a pinhole's places."""
    rays = ["--set", "instrument.diffraction=rays"]
    status = starbench(["chromatic", "--quick", *rays, "--sensor", str(EXAMPLE), "--out", str(tmp_path / "out")])
    assert status in (0, 1), capsys.readouterr().err
    text = (tmp_path / "out" / "summary.json").read_text(encoding="utf-8")
    assert '"lens.toml"' in text
    assert str(EXAMPLE.parent) not in text
