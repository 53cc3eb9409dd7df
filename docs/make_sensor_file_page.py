"""Pages of the sensor file and the detector file: docs/sensor_file.md, docs/detector_file.md from their models.

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
from experiments.harness.registry import experiment_names
from experiments.harness.settings_text import about, toml_value
from experiments.laboratory.settings.collimator import FilteredCollimatorConfig
from experiments.laboratory.settings.sensor_file import SensorConfig
from render.detector.spec import UNSTATED, DarkTable, DetectorFile, ResponseTable, list_detectors, load_detector
from render.sensor_file.tables import IdealLensConfig

PAGE = Path(__file__).with_name("sensor_file.md")
DETECTOR_PAGE = Path(__file__).with_name("detector_file.md")

HEAD = """# Sensor file

<!-- made by docs/make_sensor_file_page.py from the model of the configuration; change that -->

One TOML file describes a star sensor, and every experiment but `cube` takes it:

    python -m experiments.camera --sensor my.toml      # what this sensor can do: start here
    python -m experiments.chromatic --sensor my.toml

`--defaults` prints a complete, commented sensor file that includes the values of the other options;
`--defaults all` prints all settings of an experiment, for `--config`:

    python -m experiments.camera --set instrument.f_number=4 --defaults > my.toml

[An example](examples/triplet_50mm/sensor.toml) includes a lens file and measured filter curves.

* Paths are relative to the file. A name without suffix or folder is a built-in lens or detector.
* A missing key has the default below; only the defaults of `centroid`, `window_px` and `threshold_sigma` depend on
  the experiment.
* Later layers override earlier ones, key by key: defaults < `--quick` < `--sensor` < `--config` < `--set` < `--seed`.
* A key is spelled in the same way in this file, in `--config` files, by `--set` and by `--sweep`: by its tables,
  `instrument.exposure_s`. Its last word is enough where the outermost tables hold it once, `--set exposure_s=0.2`; else
  the message names the candidates. Every message names the file or option that holds the wrong value.
* An unknown key is an error that names the nearest one. Settings of a run, such as the slew rate or the star for
  which the NEA is stated, are not part of the file: `--set slew.rate_deg_per_s=0.1`, `--set star.magnitude_mag=5`, or
  a file for `--config`.
* A rolling shutter (`line_time_us`) has an effect in `dataset` only, where the image moves during a frame; `skycal` and
  `fisher` expose all rows at once, laboratory targets are at rest, and `flight` refuses it.
* A curve is a CSV file of wavelength [nm] and transmission as a fraction (or a column `transmission_percent`), with or
  without a header line. Tails below a thousandth of the peak are left out.
"""

LABORATORY = """## [collimator], in a run's settings

The laboratory's collimator is not part of the sensor file but of the settings of `chromatic`, `budget`, `temporal`,
`hsfe` and `distortion` (`--set collimator.pinhole_um=10`, or a table of a `--config` file). By default the collimator
has no errors; filter wedges exist in `chromatic` and `budget` only. Example: an achromat of 1 m focal length:

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
Each number of this table can be swept: `--sensor ideal.toml --sweep instrument.lens.f_number=1.4:4:6`. With an ideal
lens, coatings and absorption of `[instrument]` have no effect, and `defocus_mm` is 0 by default.

A **measured** lens is a file, `lens = "camera.lens.toml"`, with `kind = "measured"`, name, source and date, and:

| table | keys |
|---|---|
| top | `reference_wavelength_nm`, `max_field_deg` (measured half field) |
| `[camera]` | `focal_length_mm`, `principal_point_um`, `q1_per_mm2` ... `p2_per_mm` ([distortion](conventions.md#distortion)); lateral colour: `colour_nm`, `colour_scale`, `colour_shift_um` |
| `[psf]` | `includes_charge_diffusion` (`true`), nodes `wavelength_nm`, `x_mm`, `y_mm` |
| `[[component]]` | Gaussians of the PSF before the pixel: `share`, `sigma_x_um`, `sigma_y_um`, `correlation`, `offset_x_um`, `offset_y_um`; each a number, or a table over wavelength, row and column of the nodes |
| `[vignetting]` | `radius_mm`, `relative_light` |
| `[throughput]` | `aperture_mm`, `wavelength_nm`, `transmission` |

`optics/lens/measured.py` contains a complete example; `optics.export.write.write_measured_lens` writes a file from a
record. Focus, F-number, temperature and wavefront of a measured lens cannot be set; using it where surfaces are needed
is an error.

| | ideal | measured |
|---|---|---|
| acf, camera, dataset, distortion, fisher, hsfe, skycal, temporal, turntable; `observe`, `SkySimulator` | yes | yes |
| budget | yes | no: the chromatic term and temperature need the elements |
| chromatic, pages of lens files | no: they need glass | no |
| Mitsuba scenes | yes | stars by `star_tracer`, without derivatives; no integrator that traces surfaces (`path`, `ptracer`) |
| collimator with errors | yes | no |
"""  # noqa: E501  # rows of a table of the page are one line each


OWN_WAYS = {
    "acf": "`[instrument]`: the detector, and a Brown-Conrady model fitted to the rays of the lens",
    "twin": "pixel pitch of the detector and exposure time of `[instrument]`; the frames give the rest",
    "skycal": "`[instrument]` as the camera `own`, the faintest magnitude of `[catalogue]`",
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
    for name in experiment_names():
        config: type[ExperimentConfig] = import_module(f"experiments.{name}.settings").experiment.config
        common = [key for key in SensorConfig.model_fields if key in config.model_fields]
        whole = {key for key in common if hasattr(SensorConfig.model_fields[key].annotation, "model_fields")}
        takes = ", ".join(f"`[{key}]`" if key in whole else f"`{key}`" for key in common)
        if name in OWN_WAYS:
            takes = OWN_WAYS[name] + (f"; {takes}" if takes else "")
        yield f"| {name} | {takes or 'no sensor file'} |"


def page() -> str:
    """The page as text."""
    lines = [HEAD, "## Top level", "", *fields(SensorConfig)]
    for name, field in SensorConfig.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            words = (field.annotation.__doc__ or "").strip().partition("\n\n")[0].replace("``", "`")
            lines += ["", f"## [{name}]", "", words, "", *fields(field.annotation)]
            lines += LENS if name == "instrument" else []
            for key, inner in field.annotation.model_fields.items():
                if isinstance(inner.annotation, type) and issubclass(inner.annotation, BaseModel):
                    words = cleandoc(inner.annotation.__doc__ or "").replace("``", "`")
                    lines += ["", f"## [{name}.{key}]", "", words, "", *fields(inner.annotation)]
    lines += ["", "## What each experiment takes", "", *takers(), "", LABORATORY, *fields(FilteredCollimatorConfig)]
    return "\n".join(lines) + "\n"


DETECTOR_HEAD = """# Detector files

<!-- made by docs/make_sensor_file_page.py from the model of the file; change that -->

A detector is a TOML file with the values of its data sheet. `load_detector("my_chip.toml")` reads it;
`instrument.detector = "my_chip.toml"` in a [sensor file](sensor_file.md) gives it to every experiment.
Parameters are defined as in EMVA 1288; [theory](theory/detector.md) gives the order in which they act.

A complete file, from the EMVA 1288 data sheet of a camera:

```toml
name = "my chip"
source = "maker, type, data sheet, issue, page"
assumed = ["dark_current_e_per_s", "dark_reference_c"]   # the sheet does not give these

chip_width_px = 1920
chip_height_px = 1200
pixel_pitch_um = 5.86

full_well_e = 32691.0          # "saturation capacity"
read_noise_e = 6.83            # "temporal dark noise"
gain_dn_per_e = 0.1225         # the sheet says 0.51 e-/DN of 16 bits: 1 / (16 * 0.51) for the 12 bits of the converter
adc_bits = 12

dark_current_e_per_s = 10.0
dark_reference_c = 25.0

[quantum_efficiency]
source = "curve of the sheet, read off"
file = "qe.csv"                # or two lists: wavelength_nm = [400, ...], value = [0.28, ...]
```

* A misspelt key is an error that names the nearest key; a missing required key is an error that names it.
* `base = "cmv4000"` at the head: keys missing in the file have the values of that detector.
* **Nothing is inherited silently**: every report lists the keys that have the base's value, a default or an `assumed`
  value, and warns of a converter that saturates below half the full well (`gain_dn_per_e` too high for `adc_bits`).
  For your own file the list also appears on the terminal; in Python it is `load_detector(...).remarks()`.
* Curves are CSV files, named relative to the detector file, with or without a header line:
  `wavelength_nm, quantum_efficiency` (or `quantum_efficiency_percent`), `temperature_c, e_per_s`.
  Quantum efficiencies include the fill factor. From a responsivity in A/W:
  QE = R h c / (e wavelength) = 1239.84 R / wavelength in nm.
* Dark current is `dark_current_e_per_s` at `dark_reference_c` and doubles every `dark_doubling_c`. A table
  `[dark_current]` replaces `dark_current_e_per_s` and `dark_doubling_c`: the logarithm of the current is interpolated
  linearly in 1/T, and temperatures outside the table are refused. From nA/cm2: e-/s = 62.4 x nA/cm2 x (pitch in um)^2.

## Keys

A key without a default is required, unless `base` supplies it; `base` and `offset_dn` are optional.

"""

SHEET = {
    "base": "",
    "name": "",
    "source": "data sheet, issue, page",
    "assumed": "keys that the sheet does not state",
    "chip_width_px": "active (not total) pixels",
    "chip_height_px": "active (not total) pixels",
    "chips": "",
    "gap_px": "mosaics: gap between the active areas / pixel pitch",
    "pixel_pitch_um": "pixel size",
    "full_well_e": "full well charge; EMVA: saturation capacity; saturation voltage / conversion gain in uV/e-",
    "read_noise_e": "temporal (dark) noise at the gain that is used",
    "read_noise_spread": "rarely given; CMOS about 0.1 to 0.3 (noise histogram)",
    "gain_dn_per_e": "EMVA's K; conversion gain in LSB/e- at `adc_bits`; reciprocal of e-/DN",
    "adc_bits": "bits of the converter, not of the image file",
    "offset_dn": "a register; black level",
    "nonlinearity": "EMVA: linearity error",
    "dark_current_e_per_s": "dark current, typical, beginning of life",
    "dark_reference_c": "temperature of the die, not the ambient, at which the dark current is stated",
    "dark_doubling_c": "doubling temperature; 5 to 8 K for silicon, 6.5 in the CMV sheets",
    "dark_spread_e_per_s": "DSNU in e-/s, or LSB/s / gain",
    "hot_fraction": "defect grade: hot pixels / all pixels",
    "hot_dark_e_per_s": "limit that defines a hot pixel",
    "dead_fraction": "defect grade: dead pixels / all pixels",
    "prnu": "PRNU as a standard deviation, not peak to peak",
    "dsnu_e": "fixed pattern noise in e-, rms; EMVA: DSNU_1288",
    "column_pattern_e": "column fixed pattern noise",
    "diffusion_sigma_um": "MTF at Nyquist divided by 2/pi (pixel) = exp(-2 pi^2 sigma^2 f^2)",
    "crosstalk_horizontal": "crosstalk",
    "crosstalk_vertical": "crosstalk",
    "crosstalk_diagonal": "crosstalk",
    "blooming": "1 without, 0 with anti-blooming drain",
    "lag": "image lag",
    "transfer_line_us": "frame-transfer CCD: vertical clock period",
    "damage_centres_per_px": "radiation test report",
    "damage_dark_e_per_s": "radiation test report",
    "damage_known_e_per_s": "",
    "sensor_seed": "",
}
"""Where a data sheet gives a key."""


def detector_page() -> str:
    """The page of the detector file as text."""
    models = {"quantum_efficiency": ResponseTable, "dark_current": DarkTable}
    lines = [DETECTOR_HEAD + "| key | default | meaning | where a data sheet gives it |", "|---|---|---|---|"]
    for name, field in DetectorFile.model_fields.items():
        if name not in models:
            default = "" if field.is_required() or field.default is None else f"`{toml_value(field.default)}`"
            lines.append(f"| `{name}` | {default} | {about(name, field)} | {SHEET[name]} |")
    for name, model in models.items():
        rows = fields(model)
        lines += ["", f"## [{name}]", "", (model.__doc__ or "").strip(), "", *rows, "| `file` |  | CSV file |"]
    lines += ["", "## Built-in detectors", "", *built_in()]
    return "\n".join(lines) + "\n"


def built_in() -> Iterator[str]:
    """Row by row: what is shipped, and from where."""
    yield "| name | pixels | pitch | full well | noise | dark current | assumed or left out | source |"
    yield "|---|---|---|---|---|---|---|---|"
    for name in list_detectors():
        chip = load_detector(name)
        unsaid = len({*chip.assumed, *chip.from_default} - UNSTATED)
        yield (
            f"| `{name}` | {chip.width_px} x {chip.height_px} | {1e3 * chip.pixel_pitch_mm:g} um "
            f"| {chip.full_well_e:g} e- | {chip.read_noise_e:g} e- "
            f"| {chip.dark_current_e_per_s:.3g} e-/s at {chip.dark_reference_c:g} C | {unsaid} keys | {chip.source} |"
        )
    yield ""
    yield (
        "Compare with your issue of the data sheet. Values of CCD42-40, GSENSE400BSI, IMX174, IMX250 and IMX455 are\n"
        "quoted from secondary sources; for CMV2000 and CMV12000 only the main figures come from the sheet. HAS2,\n"
        "FaintStar2, STAR1000, CCD47-20, IMX249, IMX264 and IMX265 are missing: no data sheet was available."
    )


if __name__ == "__main__":
    DETECTOR_PAGE.write_text(detector_page(), encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")
