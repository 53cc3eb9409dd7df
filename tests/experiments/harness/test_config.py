"""Configuration: layers, typing of ``--set``, names with units, one clear line for each mistake."""

from typing import Literal

import pytest
from pydantic import Field, model_validator
from refusals import refuses

from experiments.harness.config import ExperimentConfig, load_config
from optics.errors import ConfigError
from optics.settings import StrictModel
from optics.validate import full_key


class Lens(StrictModel):
    name: str = "double_gauss"
    defocus_um: float = 0.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)


class Disc(StrictModel):
    kind: Literal["disc"] = "disc"
    radius_mm: float = 1.0


class Slit(StrictModel):
    kind: Literal["slit"] = "slit"
    width_um: float = 10.0


class Move(StrictModel):
    kind: Literal["decentre", "tilt"] = "decentre"  # a plain choice, not another sort of table
    range_um: float = 1.0


class Config(ExperimentConfig):
    frames: int = Field(default=30, ge=1, description="frames per position")
    lens: Lens = Lens(defocus_um=12.0)
    filters: tuple[Lens, ...] = (Lens(name="a"), Lens(name="b"))
    mask: Disc | Slit = Field(default=Disc(), discriminator="kind")
    move: Move = Move(range_um=50.0)
    label: str = ""
    magnitudes_mag: list[float] = Field(default_factory=lambda: [5.0, 6.0])
    cooled: bool = False


def test_later_layers_win_and_only_where_they_speak(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("frames = 7\n[lens]\nname = 'triplet'\n")
    config = load_config(
        Config, quick={"frames": 2, "lens.tilt_deg": (0.1, 0.0)}, file=file, settings=["seed=5", "label=x"], seed=9
    )
    assert config.frames == 7
    assert config.lens.name == "triplet"
    assert config.lens.tilt_deg == (0.1, 0.0)
    assert config.lens.defocus_um == 12.0  # the default of the run, not of the Lens class
    assert config.seed == 9
    assert config.label == "x"


@pytest.mark.parametrize(
    ("setting", "read"),
    [
        ("frames=12", lambda c: c.frames == 12),
        ("label=500", lambda c: c.label == "500"),
        ("label=a=b", lambda c: c.label == "a=b"),
        ("cooled=true", lambda c: c.cooled is True),
        ("lens.tilt_deg=[1, 2.5]", lambda c: c.lens.tilt_deg == (1.0, 2.5)),
        ("filters.1.name=600", lambda c: [f.name for f in c.filters] == ["a", "600"]),
        ("magnitudes_mag.0=4.5", lambda c: c.magnitudes_mag == [4.5, 6.0]),
    ],
)
def test_set_is_typed_by_the_model(setting, read):
    assert read(load_config(Config, settings=[setting]))


def test_another_kind_of_table_takes_the_place(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("[mask]\nkind = 'slit'\nwidth_um = 25\n")
    assert load_config(Config, file=file).mask == Slit(width_um=25.0)
    assert load_config(Config, settings=["mask.kind=slit", "mask.width_um=30"]).mask == Slit(width_um=30.0)


def test_plain_choice_called_kind_keeps_its_neighbours(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("[move]\nkind = 'tilt'\n")
    assert load_config(Config, file=file).move == Move(kind="tilt", range_um=50.0)
    settings = ["move.range_um=7", "move.kind=tilt"]
    assert load_config(Config, settings=settings).move == Move(kind="tilt", range_um=7.0)


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("framse=3", "did you mean 'frames'"),
        ("frames=0", "at least 1"),
        ("frames", "key=value is needed"),
        ("lens.defocus_um=nan", "finite"),
        ("filters.2.name=c", "items 0 to 1"),
        ("magnitudes_mag.0.x=c", "no table; it has no key 'x'"),
        ("lens=3", "lens"),
    ],
)
def test_bad_setting_is_one_line(setting, expected):
    message = refuses(ConfigError, "--set", load_config, Config, settings=[setting])
    assert expected in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("content", "settings", "source"),
    [
        ("frames = 3\n", ["seed=2", "frames=0", "label=a"], "--set frames=0: frames = 0"),
        ("[lens]\ntilt_deg = [1.0, 2.0]\ndefocus_mm = 3\n", ["frames=2"], "run.toml: unknown key 'lens.defocus_mm'"),
        ("frames = 3\n", ["defocus_um=a", "seed=2"], "--set defocus_um=a: lens.defocus_um = 'a'"),
        ("defocus_um = 'a'\n", ["seed=2"], "run.toml: lens.defocus_um = 'a'"),
    ],
)
def test_the_source_of_a_wrong_value_is_named_alone(tmp_path, content, settings, source):
    file = tmp_path / "run.toml"
    file.write_text(content)
    message = refuses(ConfigError, ".", load_config, Config, file=file, settings=settings, options={"label": "label=x"})
    assert message.removeprefix(f"{tmp_path}/").startswith(source)
    assert "--label" not in message


class Range(ExperimentConfig):
    first_nm: float = 400.0
    last_nm: float = 500.0

    @model_validator(mode="after")
    def ordered(self):
        if not self.first_nm < self.last_nm:
            raise ValueError(f"first_nm = {self.first_nm} nm is not below last_nm = {self.last_nm} nm")
        return self


def test_settings_that_are_valid_only_together(tmp_path):
    (tmp_path / "half.toml").write_text("first_nm = 600")
    assert load_config(Range, settings=["first_nm=600", "last_nm=700"]).last_nm == 700.0
    assert load_config(Range, file=tmp_path / "half.toml", settings=["last_nm=700"]).last_nm == 700.0
    message = refuses(ConfigError, ".", load_config, Range, settings=["first_nm=600", "seed=2"], seed=3)
    assert message == "--set first_nm=600: first_nm = 600.0 nm is not below last_nm = 500.0 nm"
    message = refuses(ConfigError, ".", load_config, Range, file=tmp_path / "half.toml", settings=["last_nm=3"], seed=3)
    assert message.removeprefix(f"{tmp_path}/").startswith("half.toml, --set last_nm=3: first_nm = 600.0 nm")


def test_a_key_has_one_spelling_and_one_short_form_in_all_layers(tmp_path):
    """Expected behaviour: the last words of a key mean the same to ``--set``, to files and to the resolver."""
    for text in ("tilt_deg = [1, 2]", "lens.tilt_deg = [1, 2]", "[lens]\ntilt_deg = [1, 2]"):
        (tmp_path / "run.toml").write_text(text)
        assert load_config(Config, file=tmp_path / "run.toml").lens == Lens(defocus_um=12.0, tilt_deg=(1.0, 2.0))
    assert load_config(Config, settings=["tilt_deg=[1, 2]", "tilt_deg.0=3"]).lens.tilt_deg == (3.0, 2.0)
    assert [full_key(Config, name) for name in ("label", "defocus_um", "tilt_deg.0", "lens.x", "kin")] == [
        "label", "lens.defocus_um", "lens.tilt_deg.0", "lens.x", "kin",
    ]  # fmt: skip
    (tmp_path / "run.toml").write_text("kind = 'disc'")
    for layer in ({"settings": ["kind=disc"]}, {"file": tmp_path / "run.toml"}):
        refuses(ConfigError, "key 'kind' is ambiguous: mask.kind or move.kind", load_config, Config, **layer)
    (tmp_path / "run.toml").write_text("defocus_um = 1\nlens.defocus_um = 2")
    refuses(ConfigError, "lens.defocus_um is stated twice", load_config, Config, file=tmp_path / "run.toml")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("frames = = 3", "not valid TOML"),
        ("\xff", "TOML"),
        ("lens = 1", "lens = 1: a table is needed"),
        (f"{'a.' * 3000}a = 1", "levels"),
        (f"a = {'[' * 3000}{']' * 3000}", "not valid TOML"),
    ],
)
def test_bad_file_is_one_line(tmp_path, content, expected):
    """Expected behaviour: one line that names the file; nothing of it passes because ``--set`` comes later."""
    file = tmp_path / "wrong.toml"
    file.write_text(content, encoding="latin-1")
    message = refuses(
        ConfigError, r"wrong\.toml", load_config, Config, file=file, settings=["lens.defocus_um=1", "frames=4"]
    )
    assert expected in message
    assert "\n" not in message


def test_real_number_without_a_unit_in_its_name_is_refused():
    with pytest.raises(TypeError, match="defocus holds real numbers"):

        class Bad(StrictModel):
            defocus: float = 0.0

    with pytest.raises(TypeError, match="pair"):

        class Worse(StrictModel):
            pair: tuple[float, float] | None = None

    class Good(StrictModel):
        dimensionless = frozenset({"conic"})
        conic: float = -1.0
        fill_fraction: float = 0.5
        rate_e_per_s: float = 1.0

    assert Good().conic == -1.0
