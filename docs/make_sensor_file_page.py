"""The page of the sensor file: makes docs/sensor_file.md from the model of the configuration.

python docs/make_sensor_file_page.py
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from inspect import cleandoc
from pathlib import Path

from pydantic import BaseModel

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.harness.config import ExperimentConfig
from experiments.harness.registry import found
from experiments.harness.settings_text import about, toml_value
from experiments.laboratory.collimator_settings import FilteredCollimatorConfig
from experiments.laboratory.sensor_file import SensorConfig
from experiments.laboratory.settings import IdealLensConfig

PAGE = Path(__file__).with_name("sensor_file.md")

HEAD = """# Sensor file

<!-- made by docs/make_sensor_file_page.py from the model of the configuration; change that -->

One TOML file describes a star sensor, and every experiment takes it:

    python -m experiments.camera --sensor my.toml      # what this sensor can do: start here
    python -m experiments.chromatic --sensor my.toml

`--defaults` writes a complete one with comments, of whatever the other options say; `--defaults all` writes all
settings of an experiment, for `--config`:

    python -m experiments.camera --set instrument.f_number=4 --defaults > my.toml

[An example](examples/triplet_50mm/sensor.toml) has a lens file and measured filter curves beside it.

* Paths are relative to the file. A name without suffix and folder is something built in.
* A key that is left out of a table has the default below, in every experiment; `centroid`, `window_px` and
  `threshold_sigma` that are left out are the experiment's own.
* A later layer wins, key by key: defaults < `--quick` < `--sensor` < `--config` < `--set` < `--seed`.
* An unknown key is an error that names the nearest one.
* A rolling shutter (`line_time_us`) shows where the image moves during a frame, in `dataset`; `skycal` and `fisher`
  take every frame as exposed at once, targets of the laboratory stand still.
* A curve is a CSV file of wavelength [nm] and transmission as a fraction, with or without a header line; a column that
  is called `transmission_percent` is converted. Tails below a thousandth of the peak are left out.
"""

LABORATORY = """## Not the sensor's: [collimator]

The laboratory's collimator stands in the settings of `chromatic`, `budget`, `temporal`, `hsfe` and `distortion`, not in
the sensor file (`--set collimator.pinhole_um=10`, or a table of a file for `--config`). It comes without errors. Wedges
are for experiments with filters, `chromatic` and `budget`. A refractive collimator, an achromat of 1 m:

    [collimator]
    focal_length_mm = 1000.0
    focus_wavelength_nm = [440.0, 500.0, 555.0, 656.0, 800.0, 910.0]
    focus_um = [900.0, 330.0, 0.0, 430.0, 1500.0, 2200.0]
    offset_mm = [5.0, 0.0]
    pinhole_um = 10.0
    wedge_arcsec = [3.0, 0.0, 5.0]
    wedge_direction_deg = [0.0, 0.0, 90.0]
    vibration_hz = [1.0, 10.0, 200.0]
    vibration_arcsec2_per_hz = [0.02, 0.01, 1e-5]
"""

MEASURED = """
Any number of it can be swept before there is a lens: `--sensor ideal.toml --sweep instrument.lens.f_number=1.4:4:6`.
Coatings, absorption and `defocus_mm` (0 unless it is set) of `[instrument]` change nothing, or the focus alone.

A lens that was **measured** is a file, `lens = "camera.lens.toml"`, with `kind = "measured"`, name, source and date, and:

| table | keys |
|---|---|
| top | `reference_wavelength_nm`, `max_field_deg` (the half field that was measured) |
| `[camera]` | `focal_length_mm`, `principal_point_um`, `q1_per_mm2` ... `p2_per_mm` ([distortion](conventions.md#distortion)); lateral colour: `colour_nm`, `colour_scale`, `colour_shift_um` |
| `[psf]` | `includes_charge_diffusion` (`true`), nodes `wavelength_nm`, `x_mm`, `y_mm` |
| `[[component]]` | Gaussians of the PSF before the pixel: `share`, `sigma_x_um`, `sigma_y_um`, `correlation`, `offset_x_um`, `offset_y_um`; a number, or a table over wavelength, row and column of the nodes |
| `[vignetting]` | `radius_mm`, `relative_light` |
| `[throughput]` | `aperture_mm`, `wavelength_nm`, `transmission` |

A complete one stands at the head of `optics/lens/measured.py`; `optics.export.write.write_measured_lens` writes one from
a record. It is used as it was measured: another focus, F-number, temperature or wavefront is refused, and so is what
needs surfaces.

| | ideal | measured |
|---|---|---|
| acf, camera, dataset, distortion, fisher, hsfe, skycal, temporal, turntable; `observe`, `SkySimulator` | yes | yes |
| budget | yes | no: its terms come from elements that move and warm |
| chromatic, pages of lens files | no: no glass | no |
| scenes of Mitsuba | all | stars by `star_tracer`, without derivatives; not what traces surfaces (`path`, `ptracer`) |
| collimator with errors | yes | no |
"""  # noqa: E501  # rows of a table of the page are one line each


OWN_WAYS = {
    "acf": "focal length, distortion and detector of `[instrument]`, as a Brown-Conrady model fitted to its rays",
    "twin": "pixel pitch of the detector and exposure time of `[instrument]`: what is known before the frames are read",
    "skycal": "runs it as the camera `own`, to the magnitude of `[catalogue]`",
}


def fields(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Rows of the table of one model."""
    yield "| key | default | meaning |"
    yield "|---|---|---|"
    for name, field in model.model_fields.items():
        if not hasattr(field.annotation, "model_fields"):
            default = "" if field.default is None or field.is_required() else f"`{toml_value(field.default)}`"
            yield f"| `{prefix}{name}` | {default} | {about(name, field)} |"


LENS = [
    "",
    "## [instrument.lens]",
    "",
    *(line.strip() for line in cleandoc(IdealLensConfig.__doc__ or "").replace("``", "`").splitlines()),
    "",
    *fields(IdealLensConfig),
    "",
    *cleandoc(MEASURED).splitlines(),
]


def takers() -> Iterator[str]:
    """What each experiment takes, one row each."""
    yield "| experiment | takes |"
    yield "|---|---|"
    for name in found():
        config: type[ExperimentConfig] = import_module(f"experiments.{name}.settings").Config
        common = [key for key in SensorConfig.model_fields if key in config.model_fields]
        whole = {key for key in common if hasattr(SensorConfig.model_fields[key].annotation, "model_fields")}
        takes = ", ".join(f"`[{key}]`" if key in whole else f"`{key}`" for key in common)
        if name in OWN_WAYS:
            takes = OWN_WAYS[name] + (f"; {takes}" if takes else "")
        yield f"| {name} | {takes or 'nothing: it measures no star sensor'} |"


def page() -> str:
    """The page as text."""
    lines = [HEAD, "## Top level", "", *fields(SensorConfig)]
    for name, field in SensorConfig.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            words = (field.annotation.__doc__ or "").strip().partition("\n\n")[0].replace("``", "`")
            lines += ["", f"## [{name}]", "", words, "", *fields(field.annotation)]
            lines += LENS if name == "instrument" else []
    lines += ["", "## What each experiment takes", "", *takers(), "", LABORATORY, *fields(FilteredCollimatorConfig)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
